"""Sparse matrices of pair weights."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..domain.row_threads import REDUCE, over_rows


def assemble(start: np.ndarray, column: np.ndarray, weights: np.ndarray, shift: float | np.ndarray, scale: float,
             diagonal: np.ndarray | None = None, remote: int = 0) -> sp.csr_matrix:
    """The matrix  shift - scale * L  in canonical CSR form, L f_i = sum_j w_ij (f_j - f_i) - diagonal_i f_i.

    weights: (n_pairs,); shift: a number or (n,); scale: a number; diagonal: (n,) wall sums or None; remote: columns of
    remote particles, behind the n.
    """
    walls = np.zeros(0) if diagonal is None else diagonal
    return _assembled((start, column, weights, weights), walls, shift, (scale, 0.0), remote)


def assemble_near(start: np.ndarray, column: np.ndarray, weights: np.ndarray, sizes: np.ndarray, least: float,
                  remote: int = 0) -> sp.csr_matrix:
    """-L as `assemble` makes it, without pairs whose size, sizes (n_pairs,), is below the part `least` of the sum of
    the sizes of its row."""
    return _assembled((start, column, weights, sizes), np.zeros(0), 0.0, (1.0, least), remote)


def _assembled(pairs: tuple[np.ndarray, ...], walls: np.ndarray, shift: float | np.ndarray,
               scales: tuple[float, float], remote: int) -> sp.csr_matrix:
    """pairs: start, column, weights, sizes; walls: (n,) or (0,); scales: scale, least."""
    n = len(pairs[0]) - 1
    given = pairs, walls, np.full(n, shift, float), scales
    # scipy takes 4-byte row pointers only together with 4-byte columns
    first = np.zeros(n + 1, np.int32 if len(pairs[1]) + n < 2**31 else np.int64)
    over_rows(_put_rows, n, *given, False, (first, np.empty(0, first.dtype), np.empty(0)))
    np.cumsum(first, out=first)
    index, entries = np.empty(first[-1], first.dtype), np.empty(first[-1])
    twice = over_rows(_put_rows, n, *given, True, (first, index, entries))
    matrix = sp.csr_matrix((entries, index, first), shape=(n, n + remote))
    matrix.has_sorted_indices, matrix.has_canonical_format = True, not any(twice)
    matrix.sum_duplicates()  # of a neighbour that is seen through two sides of a thin box
    return matrix


def row_sums(start: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums of the entries of each row, (n,); empty rows give zero."""
    total = np.empty(len(start) - 1)
    over_rows(_row_sums, len(total), start, values, total)
    return total


@njit(cache=True, nogil=True)
def _row_sums(rows, start, values, total):
    for i in range(rows[0], rows[1]):
        s = 0.0
        for p in range(start[i], start[i + 1]):
            s += values[p]
        total[i] = s


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _put_rows(rows, pairs, walls, shifts, scales, fill, matrix):
    """Columns, sorted, and entries of rows, or their numbers into first[1:]; returns whether a column occurs twice."""
    (start, column, weights, sizes), (scale, least), (first, index, entries) = pairs, scales, matrix
    twice = False
    for i in range(rows[0], rows[1]):
        bound = 0.0
        if least > 0.0:
            for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                bound += least * abs(sizes[p])
        if not fill:
            count = 1
            for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                count += not abs(sizes[p]) < bound  # NaN stays
            first[i + 1] = count
            continue
        begin, total = first[i], walls[i] if len(walls) > 0 else 0.0
        end = begin + 1
        index[begin], entries[begin] = i, 0.0
        for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            if abs(sizes[p]) < bound:
                continue
            total += weights[p]
            j, at = column[p], end
            while at > begin and index[at - 1] > j:  # most neighbours come in runs of rising columns
                index[at], entries[at] = index[at - 1], entries[at - 1]
                at -= 1
            twice |= at > begin and index[at - 1] == j
            index[at], entries[at] = j, -scale * weights[p]
            end += 1
        for at in range(begin, end):
            if index[at] == i:
                entries[at] += shifts[i] + scale * total
                break
    return twice
