"""Neighbour search: a cell list and rows of neighbours in CSR form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from .row_threads import over_blocks, over_rows, over_slices

AT_ONCE = 1_000_000  # neighbours found before they are copied to the result; of int32: 4 MB
# Cells are shorter by this factor along the last axis, along which they are contiguous: fewer candidates are too far.
# Particles are numbered along that axis first (`domain.lattice`): neighbours then come in rising numbers.
FINE = 3


@dataclass(frozen=True)
class Pairs:
    """Neighbours of the first n rows of a table of positions, without the particle itself.

    start: (n + 1,) int64; index: (n_pairs,) int32 rows of the table.
    """

    start: np.ndarray
    index: np.ndarray

    @property
    def count(self) -> np.ndarray:
        """Neighbours of each particle, (n,)."""
        return np.diff(self.start)

    @property
    def longest(self) -> int:
        """Neighbours that a particle has at most."""
        return _longest(self.start)


class Neighbourhood(NamedTuple):
    """The neighbours of the n fluid particles, as kernels take them.

    start: (n + 1,) int64 row pointers; column: (n_pairs,) int32 particle that each neighbour is or images; row:
    (n_pairs,) int32 its row in the table of positions; x: (n_rows, dim) that table, m: fluid particles, dummies,
    periodic images; owner: (n_rows,) int32 particle that each row is or images; kind: kernel number; support: m.

    One holds all neighbours, dummies included (their columns are n and more), the other those fluid neighbours that no
    wall hides (`Operators.neighbours`).
    """

    start: np.ndarray
    column: np.ndarray
    row: np.ndarray
    x: np.ndarray
    owner: np.ndarray
    kind: int
    support: float

    @property
    def n(self) -> int:
        """Number of fluid particles."""
        return len(self.start) - 1

    @property
    def longest(self) -> int:
        """Neighbours that a particle has at most."""
        return _longest(self.start)


class CellList(NamedTuple):
    """The rows of a table of positions sorted by cell, as kernels take them; axes from the last to the first one.

    order: (n_rows,) int32 rows in the order of their cells; first: first place of each cell in it; cell: (n_rows, 3)
    int32 of each row; x: (3, n_rows) coordinates in that order, m: neighbours in space are neighbours in memory; cells:
    (3,) number of them along each axis.
    """

    order: np.ndarray
    first: np.ndarray
    cell: np.ndarray
    x: np.ndarray
    cells: np.ndarray


def neighbourhood(x: np.ndarray, owner: np.ndarray, n: int, kind: int, support: float) -> Neighbourhood:
    """All neighbours of the first n rows of the table x (n_rows, dim), m. owner: (n_rows,) int32; support: m."""
    pairs = find_pairs(x, n, support)
    column = np.empty(len(pairs.index), owner.dtype)

    def put(part: slice) -> None:  # clip: with any other mode numpy makes a copy first
        owner.take(pairs.index[part], out=column[part], mode="clip")

    over_slices(put, len(column))
    return Neighbourhood(pairs.start, column, pairs.index, x, owner, kind, support)


def find_pairs(x: np.ndarray, n: int, support: float) -> Pairs:
    """All pairs closer than the support radius, rows sorted by cell.

    x: (n_rows, dim) positions, owned particles first, then halo and dummies; n: rows that get neighbours;
    support: m.
    """
    if n == 0:  # a process without particles
        return Pairs(np.zeros(1, np.int64), np.zeros(0, np.int32))
    return pairs_of(x, cell_list(x, support), (0, n), support)


def cell_list(x: np.ndarray, support: float) -> CellList:
    """The rows of a table x (n_rows, dim) by cells, for searches within a support, m."""
    columns = x.T[::-1]
    lower, upper = np.zeros(3), np.zeros(3)
    if len(x):
        lower[: len(columns)] = [column.min() for column in columns]
        upper[: len(columns)] = [column.max() for column in columns]
    narrowest = support / np.array([FINE, 1, 1])
    # clipped: the number of cells of a sparse scene in a huge box must not overflow
    cells = np.clip(np.floor((upper - lower) / narrowest), 1, 2**20).astype(np.int64)
    # nor must memory be allocated for all cells of such a box
    while cells.prod() > max(64, 4 * len(x)):
        cells = np.maximum(1, cells // 2)
    width = np.maximum((upper - lower) / cells, narrowest) * (1.0 + 1e-12)
    # arrays made in a kernel are compiled
    grid = CellList(np.empty(len(x), np.int32), np.zeros(cells.prod() + 1, np.int64), np.zeros((len(x), 3), np.int32),
                    np.zeros((3, len(x))), cells)
    _bin(x, lower, 1.0 / width, np.empty(len(x), np.int64), grid)
    grid.first[1:], grid.first[0] = grid.first[:-1].copy(), 0  # where each cell has ended is where the next one begins
    return grid


def pairs_of(x: np.ndarray, grid: CellList, rows: tuple[int, int], support: float) -> Pairs:
    """The pairs of `find_pairs` of a range of rows, begin and end, by the `cell_list` of x and support."""
    first = grid.first
    reach = min(2 * FINE + 1, grid.cells[0])
    candidates = int((first[reach:] - first[:-reach]).max(initial=0))  # of one line of cells
    counts = np.zeros(rows[1] - rows[0] + 1, dtype=np.int64)

    def fill(part: tuple[int, int]) -> list[np.ndarray]:
        begin, end = part[0] + rows[0], part[1] + rows[0]
        parts: list[np.ndarray] = []
        scratch = np.empty(9 * candidates + 2, np.int32), np.empty(candidates, np.uint8), np.empty((9, 2), np.int64)
        while begin < end:
            found = np.empty(max(AT_ONCE, len(scratch[0])), np.int32)
            begin, count = _fill((begin, end), x, grid, support * support, scratch, (rows[0], counts[1:]), found)
            parts.append(found[:count])
        return parts

    parts = [part for some in over_rows(fill, rows[1] - rows[0]) for part in some]
    ends = np.cumsum([0, *map(len, parts)])
    index = np.empty(ends[-1], np.int32)

    def put(blocks: tuple[int, int], ends: np.ndarray) -> None:
        for k in range(*blocks):
            index[ends[k] : ends[k + 1]] = parts[k]

    over_blocks(put, ends)
    return Pairs(np.cumsum(counts), index)


def _longest(start: np.ndarray) -> int:
    """Entries of the longest row."""
    return int(np.diff(start).max(initial=0))


@njit(cache=True)
def _bin(x, lower, per_width, flat, grid):
    """Counting sort of the rows by cell into a CellList; its `first` come as zeros and become the ends of the cells.
    flat: (n_rows,) int64, scratch."""
    n, dim = x.shape
    order, first, cell, sorted_x, cells = grid
    for k in range(n):
        for axis in range(dim):
            cell[k, axis] = min(max(int((x[k, dim - 1 - axis] - lower[axis]) * per_width[axis]), 0), cells[axis] - 1)
        flat[k] = (cell[k, 2] * cells[1] + cell[k, 1]) * cells[0] + cell[k, 0]
        first[flat[k] + 1] += 1
    for c in range(len(first) - 1):
        first[c + 1] += first[c]
    for k in range(n):
        place = first[flat[k]]
        first[flat[k]] += 1
        order[place] = k
        for axis in range(dim):
            sorted_x[axis, place] = x[k, dim - 1 - axis]


@njit(cache=True)
def _runs(cx, cy, cz, first, cells, runs):
    """Sorted rows near a cell into runs[:, 0:2], begin and end; returns how many runs: cells in line along
    the first axis of `CellList` are contiguous."""
    count = 0
    left, right = max(cx - FINE, 0), min(cx + FINE + 1, cells[0])
    for z in range(max(cz - 1, 0), min(cz + 2, cells[2])):
        for y in range(max(cy - 1, 0), min(cy + 2, cells[1])):
            line = (z * cells[1] + y) * cells[0]
            runs[count, 0], runs[count, 1] = first[line + left], first[line + right]
            count += 1
    return count


# Unsigned loops spare the check for negative indices, which keeps LLVM from vectorising.


@njit(cache=True)
def _fill_run(run, point, sorted_x, order, reach2, scratch, found):
    """Appends those rows to row[0:found]; returns the new number. run: begin, end; scratch: row, inside, runs."""
    (begin, end), (x0, x1, x2), (xs, ys, zs), (row, inside, _) = run, point, sorted_x, scratch
    begin, end, found = np.uint64(begin), np.uint64(end), np.uint64(found)
    for k in range(begin, end):
        d0, d1, d2 = xs[k] - x0, ys[k] - x1, zs[k] - x2
        inside[k - begin] = d0 * d0 + d1 * d1 + d2 * d2 < reach2
    for k in range(begin, end):
        row[found] = order[k]  # overwritten by the next row unless this one is inside: no branch to mispredict
        found += np.uint64(inside[k - begin])
    return np.int64(found)


@njit(cache=True, nogil=True)
def _fill(rows, x, grid, reach2, scratch, counts, index):
    """Neighbours of rows of x (n_rows, dim) one after the other into index, until it may be too short for the next row;
    returns that row and the number of neighbours. counts: a row, and numbers of neighbours (n,) from that row on;
    scratch: see `_fill_run`."""
    order, first, cell, cells, row = grid.order, grid.first, grid.cell, grid.cells, scratch[0]
    counted, count = counts
    sorted_x = grid.x[0], grid.x[1], grid.x[2]
    runs, at, last = scratch[2], 0, x.shape[1] - 1
    for i in range(rows[0], rows[1]):
        if at + len(row) > len(index):
            return i, at
        found, begin = np.int64(0), at  # a literal 0 would be a type of its own
        point = x[i, last], x[i, last - 1], x[i, 0] if last == 2 else 0.0
        for r in range(_runs(cell[i, 0], cell[i, 1], cell[i, 2], first, cells, runs)):
            found = _fill_run((runs[r, 0], runs[r, 1]), point, sorted_x, order, reach2, scratch, found)
        for k in range(found):
            if row[k] != i:  # the particle itself is not its neighbour
                index[at] = row[k]
                at += 1
        count[i - counted] = at - begin
    return rows[1], at
