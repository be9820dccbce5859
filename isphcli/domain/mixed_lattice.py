"""Particles of two spacings: a lattice some of whose cells are cut in two along every axis, and their pairs.

The support of a pair of both kinds is that of the mean of their spacings, for either particle, so that weights times
volumes stay symmetric. No process knows which cells are cut in the whole lattice: each has some of them, and gets those
near the cells that it asks for (`MixedLattice.within`).
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import ndimage

from .communicator import current
from .exchange import deliver
from .lattice import Lattice
from .neighbours import Pairs, find_pairs

MIXED = 0.75  # mean of both spacings over the larger one


def grown(cells: np.ndarray, by: int) -> np.ndarray:
    """The cells of a lattice, (counts) bool, and those within `by` of them along every axis, across its ends too."""
    return np.asarray(ndimage.maximum_filter(cells, 2 * by + 1, mode="wrap"))


def cells_of(lattice: Lattice, x: np.ndarray) -> np.ndarray:
    """Index (n, dim) int64 of the cell that holds each of x (n, dim)."""
    return np.mod(np.floor((x - lattice.corner) / lattice.cell).astype(np.int64), lattice.counts)


class MixedLattice:
    """A lattice of one site a cell some of whose cells are cut; it has what `scene.place` asks of a `Lattice`.

    lattice: of the whole cells; chosen: (m, dim) int64 cells, of which each process has some and all have all; `buffer`
    more round them are cut too; support: m, of the larger spacing. Which cells are cut is known within a part of the
    lattice alone, see `within`.
    """

    def __init__(self, lattice: Lattice, chosen: np.ndarray, support: float, buffer: int = 0):
        self.lattice, self.chosen, self.buffer = lattice, chosen, buffer
        self.cell, self.counts, self.corner = lattice.cell, lattice.counts, lattice.corner
        self.site_volume = lattice.site_volume
        # cells between sites that see each other: they are in the middles of their cells
        self._sight = math.ceil(MIXED * support / float(lattice.cell.min()) - 0.75)
        dim = len(lattice.counts)
        self._parts = np.array(list(itertools.product([0.25, 0.75], repeat=dim)))
        self._first = np.zeros(dim, np.int64)
        self._cut = self._beside = np.zeros((0,) * dim, bool)

    def within(self, first: np.ndarray, end: np.ndarray) -> MixedLattice:
        """The same lattice, which knows the cells from `first` to before `end`, (dim,) each; these may lie beyond the
        ends of the lattice, and are then those at the other end. All processes call it together."""
        far = self.buffer + self._sight
        first, size = first - far, np.minimum(end - first + 2 * far, self.counts)
        near = np.mod(self._near(first, size) - first, self.counts)
        cut = np.zeros(tuple(size), bool)
        cut[tuple(near.T)] = True
        found = copy.copy(self)
        cut = grown(cut, self.buffer)  # wrong within `far` of the ends of the part, which nobody asks for
        found._first, found._cut, found._beside = first, cut, grown(cut, self._sight) & grown(~cut, self._sight)
        return found

    def _near(self, first: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Chosen cells (k, dim) of all processes, of `size` (dim,) cells from `first` on."""
        wanted = np.array(current().collect((first, size)))
        seen = [np.flatnonzero((np.mod(self.chosen - low, self.counts) < many).all(axis=1)) for low, many in wanted]
        if current().size == 1:
            return self.chosen[seen[0]]
        to = np.repeat(np.arange(len(seen)), [len(rows) for rows in seen])
        return deliver(current().raw, to, self.chosen[np.concatenate(seen)])[0]  # type: ignore[attr-defined]

    def _at(self, known: np.ndarray, index: np.ndarray) -> np.ndarray:
        """What is `known` of the cells (k, dim), (k,) bool."""
        return known[tuple(np.mod(index - self._first, self.counts).T)]

    def half(self, x: np.ndarray) -> np.ndarray:
        """(n,) bool: whether x (n, dim) lie in cells that are cut, whose particles have half the spacing."""
        return self._at(self._cut, cells_of(self.lattice, x))

    def beside(self, x: np.ndarray) -> np.ndarray:
        """(n,) bool: whether particles at x (n, dim) may see those of the other kind: all that do, and some more."""
        return self._at(self._beside, cells_of(self.lattice, x))

    def slabs(self) -> Iterator[np.ndarray]:
        """See `Lattice`."""
        for index in self.cells(np.zeros(len(self.counts), int), self.counts):
            yield self.at(index)

    def cells(self, first: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
        """See `Lattice`; slabs have as many sites as those of one spacing have where all cells are cut."""
        return replace(self.lattice, basis=self._parts).cells(first, end)

    def at(self, index: np.ndarray) -> np.ndarray:
        """Positions (n, dim) of the sites of the cells (k, dim): of those that are not cut, then of the others."""
        cut = self._at(self._cut, index)
        return np.concatenate([self.lattice.at(index[~cut]), replace(self.lattice, basis=self._parts).at(index[cut])])

    def numbers(self, index: np.ndarray) -> np.ndarray:
        """(n,) int64 numbers of these sites."""
        cut, parts = self._at(self._cut, index), len(self._parts)
        small = replace(self.lattice, basis=self._parts).numbers(index[cut])
        return np.concatenate([parts * self.lattice.numbers(index[~cut]), small])


def pairs_of_two(x: np.ndarray, n: int, half: np.ndarray, beside: np.ndarray, support: float) -> Pairs:
    """As `find_pairs`. half, beside: (n_rows,) bool, see `MixedLattice`; support: m, of the larger spacing."""
    first, second = [], []

    def find(some: np.ndarray, reach: float, mixed: bool) -> None:
        rows = np.flatnonzero(some)  # particles that get neighbours come first
        pairs = find_pairs(np.ascontiguousarray(x[rows]), int(np.searchsorted(rows, n)), reach)
        i, j = np.repeat(rows[: len(pairs.start) - 1], pairs.count), rows[pairs.index]
        kept = (half[i] != half[j]) == mixed
        first.append(i[kept])
        second.append(j[kept])

    find(~half, support, False)
    find(half, 0.5 * support, False)
    find(beside, MIXED * support, True)
    i, j = np.concatenate(first), np.concatenate(second)
    start = np.zeros(n + 1, np.int64)
    np.add.at(start, i + 1, 1)
    return Pairs(np.cumsum(start), j[np.argsort(i, kind="stable")].astype(np.int32))
