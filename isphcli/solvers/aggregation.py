"""Set-up of smoothed aggregation (Vanek, Mandel and Brezina 1996): prolongations, coarse matrices, on all threads.

They are those of PyAMG with Jacobi smoothing by Gershgorin's bounds, of filtered entries, and one vector that the
matrix hardly changes. PyAMG makes them in block form with blocks of one, on one thread, and spends more than half of
the time on conversions between forms.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..domain.row_threads import counted_rows, over_rows

SMOOTHING = 4.0 / 3.0  # of the tentative prolongation, over the largest eigenvalue as the rows bound it


def prolongation(matrix: sp.csr_matrix, near_null: np.ndarray, strength: float) -> tuple[sp.csr_matrix, np.ndarray]:
    """The smoothed prolongation (n, aggregates) of a matrix (n, n), and what the coarse matrix hardly changes,
    (aggregates,).

    near_null: (n,) what the matrix hardly changes; strength: threshold of the connections that are aggregated, over
    the square root of the product of the diagonals.
    """
    n, bound = matrix.shape[0], (np.abs(matrix.diagonal()), strength**2)

    def connect(fill: bool, *found: np.ndarray) -> None:
        over_rows(_strong, n, arrays_of(matrix), bound, fill, found)

    aggregate, count = aggregates(sp.csr_matrix(counted_rows(n, connect), (n, n)))
    inside = aggregate >= 0
    length = np.sqrt(np.bincount(aggregate[inside], near_null[inside] ** 2, count))
    inside &= length[aggregate] > 0.0  # where the vector vanishes on all of an aggregate nothing is left of it
    aggregate[~inside] = -1
    tentative = np.divide(near_null, length[aggregate], out=np.zeros(n), where=inside)
    longest = int(np.diff(matrix.indptr).max(initial=0)) + 1
    # aggregates depend on the order of columns: those of coarse matrices on that of the prolongation
    ordered = matrix if matrix.has_sorted_indices else matrix.sorted_indices()

    def smooth(fill: bool, *found: np.ndarray) -> None:
        over_rows(_smoothed, n, arrays_of(ordered), bound, (aggregate, tentative, length), fill, found,
                  work=lambda: (np.empty(longest, np.int32), np.empty(longest)))

    return sp.csr_matrix(counted_rows(n, smooth), (n, count)), length


def aggregates(strong: sp.csr_matrix) -> tuple[np.ndarray, int]:
    """The aggregate of each row of a pattern of strong connections, (n,) int32, -1 of those in none, and how many there
    are, one at least."""
    from pyamg.aggregation import standard_aggregation

    members, _ = standard_aggregation(strong)
    found = np.full(strong.shape[0], -1, np.int32)
    found[np.diff(members.indptr) > 0] = members.indices
    return found, members.shape[1]


def coarse_matrix(restriction: sp.csr_matrix, matrix: sp.csr_matrix, prolongation: sp.csr_matrix) -> sp.csr_matrix:
    """The product of the three. Ranges of its rows are independent; SciPy's products do not hold up other threads."""
    def part(rows: tuple[int, int]) -> sp.csr_matrix:
        return (restriction[rows[0] : rows[1]] @ matrix) @ prolongation

    return sp.vstack(over_rows(part, restriction.shape[0]), format="csr")


def arrays_of(matrix: sp.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row pointers, columns and entries, as kernels take them."""
    return matrix.indptr, matrix.indices, matrix.data


@njit(cache=True, nogil=True)
def _strong(rows, entries, bound, fill, found):
    """Strong connections and the diagonal into index, or their numbers into first[1:]."""
    (indptr, indices, data), (diagonal, square), (first, index, _) = entries, bound, found
    for i in range(rows[0], rows[1]):
        at = first[i] if fill else 0
        for q in range(indptr[i], indptr[i + 1]):
            j = indices[q]
            if j == i or data[q] * data[q] >= square * diagonal[i] * diagonal[j]:
                if fill:
                    index[at] = j
                at += 1
        if not fill:
            first[i + 1] = at


@njit(cache=True, nogil=True)
def _smoothed(rows, work, entries, bound, aggregates, fill, found):
    """T - U of the tentative prolongation T: U = omega D^-1 F T with F the strong connections and D the sums of its
    rows, without what it does to the vector that the matrix hardly changes. Into index and data, or the numbers of
    entries into first[1:]. The column of the own aggregate is the last of a row, as it is in PyAMG's."""
    (indptr, indices, data), (diagonal, square), (aggregate, tentative, length) = entries, bound, aggregates
    (first, index, out), (column, value) = found, work
    for i in range(rows[0], rows[1]):
        count, total = 0, 0.0
        for q in range(indptr[i], indptr[i + 1]):
            j, a = indices[q], data[q]
            if j != i and a * a < square * diagonal[i] * diagonal[j]:
                continue
            total += abs(a)
            if aggregate[j] < 0:
                continue
            k = 0
            while k < count and column[k] != aggregate[j]:
                k += 1
            if k == count:
                column[k], value[k] = aggregate[j], 0.0
                count += 1
            value[k] += a * tentative[j]
        if not fill:
            first[i + 1] = count
            continue
        omega = SMOOTHING / total if total > 0.0 else 0.0
        constant = square_length = 0.0
        for k in range(count):
            value[k] *= omega
            constant += value[k] * length[column[k]]
            square_length += length[column[k]] ** 2
        at = first[i]
        for k in range(count):
            entry, where = constant / square_length * length[column[k]] - value[k], at
            if column[k] == aggregate[i]:
                entry, where = entry + tentative[i], first[i + 1] - 1
            else:
                at += 1
            index[where], out[where] = column[k], entry
