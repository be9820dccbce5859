"""Lattices of sites over a box, and the particles of a scene: fluid particles, then dummies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from . import reduce
from .cut import Share
from .row_threads import over_slices

MOST = 9  # most lattice sites, as a power of ten: far more than fit into the memory of a machine
CLASSIFY_AT_ONCE = 2_000_000  # lattice sites that the geometry classifies per call: bounds the memory of large scenes


class ParticleError(ValueError):
    """A lattice that holds no fluid, or does not fit its box."""


@dataclass(frozen=True)
class Lattice:
    """basis: (m, dim) sites of a cell in units of it; cell: (dim,) edges, m; counts: (dim,) cells;
    corner: (dim,) of the first cell, m."""

    basis: np.ndarray
    cell: np.ndarray
    counts: np.ndarray
    corner: np.ndarray

    @property
    def sites(self) -> int:
        """Number of sites."""
        return int(self.counts.prod()) * len(self.basis)

    @property
    def site_volume(self) -> float:
        """m^dim of one site."""
        return float(self.cell.prod()) / len(self.basis)

    @property
    def thick(self) -> np.ndarray:
        """(dim,) m, of the layers of sites across each axis."""
        return self.cell / np.array([len(np.unique(places)) for places in self.basis.T])

    def within(self, first: np.ndarray, end: np.ndarray) -> Lattice:
        """Itself: every process knows all of its cells, not those from `first` to before `end`, (dim,) each, alone."""
        return self

    def slabs(self) -> Iterator[np.ndarray]:
        """Positions of the sites, (k, dim) at a time, in slabs along the first axis."""
        for index in self.cells(np.zeros(len(self.counts), int), self.counts):
            yield self.at(index)

    def cells(self, first: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
        """Indices (k, dim) of the cells from `first` to before `end`, (dim,) each, in slabs along the first axis."""
        rest = [np.arange(low, high) for low, high in zip(first[1:], end[1:])]
        per_layer = math.prod(len(r) for r in rest) * len(self.basis)
        thick = max(1, CLASSIFY_AT_ONCE // max(per_layer, 1))
        for low in range(int(first[0]), int(end[0]), thick):
            own = np.arange(low, min(low + thick, int(end[0])))
            grid = np.meshgrid(own, *rest, indexing="ij", sparse=True)
            index = np.empty((*(g.size for g in grid), len(grid)), dtype=own.dtype)
            for axis, along in enumerate(grid):
                index[..., axis] = along
            yield index.reshape(-1, len(grid))

    def at(self, index: np.ndarray) -> np.ndarray:
        """Positions (k m, dim) of the m sites of each of the cells (k, dim)."""
        x = np.empty((len(index), *self.basis.shape))

        def fill(part: slice) -> None:  # and axis by axis: rows of three are slow to broadcast over
            for axis, (corner, cell) in enumerate(zip(self.corner, self.cell)):
                for k, place in enumerate(self.basis[:, axis]):
                    x[part, k, axis] = corner + (index[part, axis] + place) * cell

        over_slices(fill, len(index))
        return x.reshape(-1, len(self.counts))

    def numbers(self, index: np.ndarray) -> np.ndarray:
        """(k m,) int64 number of the sites of the cells (k, dim) in the lattice."""
        cell = np.ravel_multi_index(tuple(index.T), tuple(self.counts))
        return (cell[:, None] * len(self.basis) + np.arange(len(self.basis))).ravel()


# Sites of a cell, in edges of the cell, by the name of the lattice
BASES = {
    "square": np.array([[0.5, 0.5]]),
    "hexagonal": np.array([[0.25, 0.25], [0.75, 0.75]]),
    "cubic": np.array([[0.5, 0.5, 0.5]]),
    "bcc": np.array([[0.25, 0.25, 0.25], [0.75, 0.75, 0.75]]),
}


def make_lattice(kind: str, lower: Sequence[float] | np.ndarray, upper: Sequence[float] | np.ndarray,
                 periodic: Sequence[bool], spacing: float, margin: float,
                 offset: Sequence[float] | None = None) -> Lattice:
    """Lattice over a box, continued by `margin` beyond its non-periodic faces.

    spacing: m, edge of the cell (hexagonal: nearest-neighbour distance, cell spacing x sqrt(3) spacing). Along
    periodic axes the cell is stretched to fit the box a whole number of times; along the others it is exact and
    starts at the lower face. offset: (dim,) shift in spacings. Raises ParticleError if the box is thinner than a cell.
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    dim = len(lower)
    cell = np.full(dim, float(spacing))
    if kind == "hexagonal":
        cell[1] *= np.sqrt(3.0)
    length = upper - lower
    if not np.log10((length + 2.0 * margin) / cell).sum() < MOST:  # an image may be of any size
        edges = " x ".join(f"{edge:g}" for edge in length)
        raise ParticleError(f"a box of {edges} has more than 1e{MOST} sites at the spacing {spacing:g}; are both in "
                            f"the same unit?")
    shift = np.zeros(dim) if offset is None else np.asarray(offset, float) * spacing
    counts, corner = np.empty(dim, np.int64), lower + shift
    for axis in range(dim):
        cells = length[axis] / cell[axis]
        if periodic[axis]:
            counts[axis] = max(1, round(cells))
            if cells < 0.75:
                raise ParticleError(f"the spacing {spacing:g} does not fit the box, {length[axis]:g} along axis "
                                    f"{'xyz'[axis]}; take a smaller particles.spacing")
            cell[axis] = length[axis] / counts[axis]
        else:
            before = int(np.ceil((margin + shift[axis]) / cell[axis]))
            after = int(np.ceil((length[axis] + margin - shift[axis]) / cell[axis] - 1e-9))
            counts[axis] = before + after
            corner[axis] -= before * cell[axis]
    return Lattice(BASES[kind], cell, counts, corner)


@dataclass(frozen=True)
class Particles:
    """The particles of a scene: n_fluid fluid particles, then dummies.

    x: (n, dim) m; phase: (n_fluid,) int8 index of the fluid; site_volume: m^dim; sites: lattice sites inside the box;
    left_out: sites in solids that no fluid sees. All are those of this process; share: the particles of other processes
    that it needs, None of a single process.
    """

    x: np.ndarray
    phase: np.ndarray
    site_volume: float
    sites: int
    left_out: int
    share: Share | None = None

    @property
    def n_fluid(self) -> int:
        """Fluid particles; in `x` they come first."""
        return len(self.phase)

    @property
    def n_dummy(self) -> int:
        """Dummies; in `x` they come last."""
        return len(self.x) - len(self.phase)

    @property
    def dummies_in_sight(self) -> np.ndarray:
        """(m, dim) m, dummies that the fluid of this process may see: its own, then those of others."""
        own = self.x[self.n_fluid :]
        return own if self.share is None else np.concatenate([own, self.share.dummies])

    @property
    def two_fluids(self) -> bool:
        """Whether the particles of all processes are of more than one fluid."""
        return bool(reduce.largest(self.phase) > reduce.smallest(self.phase))
