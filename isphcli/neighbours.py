"""Neighbour search: a cell list and rows of neighbours in CSR form."""

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

CHUNKS = 64  # rows are handed to threads in this many pieces


@dataclass(frozen=True)
class Pairs:
    """Neighbours of the first n rows of a table of positions, without the particle itself.

    start: (n + 1,) int64; index: (n_pairs,) int32 rows of the table.
    """

    start: np.ndarray
    index: np.ndarray

    @property
    def count(self):
        return np.diff(self.start)


def find_pairs(x, n, support):
    """All pairs closer than the support radius, rows sorted by cell.

    x: (n_rows, dim) positions, owned particles first, then halo and dummies; n: rows that get neighbours;
    support: m.
    """
    lower = x.min(axis=0)
    cells = np.clip(np.floor((x.max(axis=0) - lower) / support), 1, 2**20).astype(np.int64)
    # never more cells than particles: a sparse scene in a huge box must not allocate the box
    while cells.prod() > max(64, 4 * len(x)):
        cells = np.maximum(1, cells // 2)
    width = np.maximum((x.max(axis=0) - lower) / cells, support) * (1.0 + 1e-12)
    three = np.ones(3, dtype=np.int64)
    three[: x.shape[1]] = cells
    order, first = _bin(x, lower, width, three)
    counts = _count(x, order, first, lower, width, three, n, support)
    start = np.zeros(n + 1, dtype=np.int64)
    np.cumsum(counts, out=start[1:])
    index = np.empty(start[-1], dtype=np.int32)
    _fill(x, order, first, lower, width, three, n, support, start, index)
    return Pairs(start, index)


@njit(cache=True, inline="always")
def _cell(x, k, axis, lower, width, cells):
    if axis >= x.shape[1]:
        return 0
    c = int((x[k, axis] - lower[axis]) / width[axis])
    return min(max(c, 0), cells[axis] - 1)


@njit(cache=True)
def _bin(x, lower, width, cells):
    """Counting sort of the rows by cell: (order, first row of each cell)."""
    n = x.shape[0]
    cell = np.empty(n, np.int64)
    first = np.zeros(cells[0] * cells[1] * cells[2] + 1, np.int64)
    for k in range(n):
        c = (_cell(x, k, 2, lower, width, cells) * cells[1] + _cell(x, k, 1, lower, width, cells)) * cells[0]
        c += _cell(x, k, 0, lower, width, cells)
        cell[k] = c
        first[c + 1] += 1
    for c in range(len(first) - 1):
        first[c + 1] += first[c]
    order = np.empty(n, np.int32)
    cursor = first[:-1].copy()
    for k in range(n):
        order[cursor[cell[k]]] = k
        cursor[cell[k]] += 1
    return order, first


@njit(cache=True, inline="always")
def _scan(x, i, order, first, lower, width, cells, support2, index, at):
    """Visit the neighbours of row i; write them to index from `at` on if index is not empty. Returns how many."""
    dim = x.shape[1]
    cx, cy, cz = (_cell(x, i, 0, lower, width, cells), _cell(x, i, 1, lower, width, cells),
                  _cell(x, i, 2, lower, width, cells))
    found = 0
    write = len(index) > 0
    x0, x1 = x[i, 0], x[i, 1]
    x2 = x[i, 2] if dim == 3 else 0.0
    for z in range(max(cz - 1, 0), min(cz + 2, cells[2])):
        for y in range(max(cy - 1, 0), min(cy + 2, cells[1])):
            row = (z * cells[1] + y) * cells[0]
            # cells that are neighbours along x are contiguous
            for k in range(first[row + max(cx - 1, 0)], first[row + min(cx + 2, cells[0])]):
                j = order[k]
                d0, d1 = x[j, 0] - x0, x[j, 1] - x1
                r2 = d0 * d0 + d1 * d1
                if dim == 3:
                    d2 = x[j, 2] - x2
                    r2 += d2 * d2
                if r2 < support2 and j != i:
                    if write:
                        index[at + found] = j
                    found += 1
    return found


@njit(cache=True, parallel=True)
def _count(x, order, first, lower, width, cells, n, support):
    counts = np.empty(n, np.int64)
    nothing = np.empty(0, np.int32)
    for i in prange(n):
        counts[i] = _scan(x, i, order, first, lower, width, cells, support * support, nothing, 0)
    return counts


@njit(cache=True, parallel=True)
def _fill(x, order, first, lower, width, cells, n, support, start, index):
    for i in prange(n):
        _scan(x, i, order, first, lower, width, cells, support * support, index, start[i])
