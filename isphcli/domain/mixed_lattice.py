"""Particles of two spacings: a lattice some of whose cells are cut in two along every axis, and their pairs.

The support of a pair of both kinds is that of the mean of their spacings, for either particle, so that weights times
volumes stay symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from .lattice import Lattice
from .neighbours import Pairs, find_pairs

MIXED = 0.75  # mean of both spacings over the larger one


def grown(cells: np.ndarray, by: int) -> np.ndarray:
    """The cells of a lattice, (counts) bool, and those within `by` of them along every axis, across its ends too."""
    return np.asarray(ndimage.maximum_filter(cells, 2 * by + 1, mode="wrap"))


def cells_of(lattice: Lattice, x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Index of the cell that holds each of x (n, dim), one array (n,) an axis."""
    index = np.floor((x - lattice.corner) / lattice.cell).astype(np.int64)
    return tuple(np.mod(index, lattice.counts).T)


def sites_of_two(lattice: Lattice, cut: np.ndarray,
                 support: float) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(x (k, dim) m, half (k,) bool, beside (k,) bool) of the sites, in slabs; of a lattice with one site per cell.

    cut: (counts) bool, cells that are cut; support: m, of the larger spacing; half: sites of half the spacing; beside:
    those that may see the other kind, all of them and some more.
    """
    dim = len(lattice.counts)
    sight = math.ceil(MIXED * support / float(lattice.cell.min()) - 0.75)  # cells between: sites are in their middles
    beside = grown(cut, sight) & grown(~cut, sight)
    parts = np.stack(np.meshgrid(*[[-0.25, 0.25]] * dim, indexing="ij"), axis=-1).reshape(-1, dim) * lattice.cell
    for index in lattice.cells(np.zeros(dim, int), lattice.counts):
        whole, at = lattice.at(index), tuple(index.T)
        fine, near = cut[at], beside[at]
        small = (whole[fine][:, None] + parts).reshape(-1, dim)
        yield (np.concatenate([whole[~fine], small]), np.arange((~fine).sum() + len(small)) >= (~fine).sum(),
               np.concatenate([near[~fine], np.repeat(near[fine], len(parts))]))


def pairs_of_two(x: np.ndarray, n: int, half: np.ndarray, beside: np.ndarray, support: float) -> Pairs:
    """As `find_pairs`. half, beside: (n_rows,) bool, see `sites_of_two`; support: m, of the larger spacing."""
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
