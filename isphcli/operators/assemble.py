"""Sparse matrices of pair weights."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..domain.row_threads import over_rows


def assemble(start: np.ndarray, column: np.ndarray, weights: np.ndarray, shift: float | np.ndarray, scale: float,
             diagonal: np.ndarray | None = None, remote: int = 0) -> sp.csr_matrix:
    """The matrix  shift - scale * L  in canonical CSR form, L f_i = sum_j w_ij (f_j - f_i) - diagonal_i f_i.

    weights: (n_pairs,); shift: a number or (n,); scale: a number; diagonal: (n,) wall sums or None; remote: columns of
    remote particles, behind the n.
    """
    n, size = len(start) - 1, len(column) + len(start) - 1
    # scipy takes 4-byte row pointers only together with 4-byte columns
    first = (start + np.arange(n + 1)).astype(np.int32 if size < 2**31 else np.int64)
    index, entries = np.empty(size, first.dtype), np.empty(size)
    walls = np.zeros(0) if diagonal is None else diagonal
    shifts = np.full(n, shift, float)
    twice = over_rows(_put_rows, n, (start, column, weights), walls, shifts, scale, (index, entries))
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


@njit(cache=True, nogil=True)
def _put_rows(rows, pairs, walls, shifts, scale, out):
    """Columns, sorted, and entries of rows; returns whether a column occurs twice in one."""
    start, column, weights = pairs
    index, entries = out
    twice = False
    for i in range(rows[0], rows[1]):
        begin = start[i] + i
        end, total = begin + 1, walls[i] if len(walls) > 0 else 0.0
        index[begin], entries[begin] = i, 0.0
        for p in range(start[i], start[i + 1]):
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
