"""The volume of each part of either fluid, kept over a run by the level of phi.

A part is a connected region of one fluid: a ganglion, or the fluid around ganglia. Its volume is made or lost where phi
moves otherwise than the fluid: eq. 3 leaves a divergence, shifted particles take phi from its Taylor series, and what
is smoothed out of a thin layer was part of it. Particles carry it: each holds an even share of the volume of its part
(`State.volume`). Parts that join or split have the shares of their particles, and over the seam between two reservoirs
as much of one fluid comes in as of the other leaves. A particle that the interface moves past leaves its share behind:
phi says where a fluid is, the shares how much of it there is.

What a part has too little, r, comes back along its interfaces, from the parts that it touches there: the level between
parts a and b is moved by m_a - m_b with

    sum_b area_ab (m_a - m_b) = r_a,        or   - sum_a area_ab (m_a - m_b) = r_b   of the other fluid,

which is the least motion of the interface that does it. Only interfaces in the sample are moved: in clear layers and
reservoirs the flow is smooth and phi goes with it, and the plane at a seam stays. If those moved too, volume lost in
the rock would come back at the inlet, where more fluid would then come in than the flux that is held. Nothing goes from
one ganglion to another but through what lies between them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp
from numba import njit
from scipy.sparse.linalg import spsolve

from ..domain import reduce
from ..domain.components import pair_components
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..domain.row_threads import over_rows

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from .cut_cells import CutCells

LINKED = 1.5  # spacings that like particles of one part are apart at most
RETURN_RATE = 0.5  # part of what is lacking that comes back in a step
LARGEST_MOVE = 0.05  # spacings that a level is moved in a step at most
BAND = 1.5  # spacings on either side of the interface where phi is moved
LEVELS_RIDGE = 1e-9  # of the largest diagonal entry: only differences of m count; parts without an interface have none


def first_shares(cut: CutCells, neighbours: Neighbourhood, phi: np.ndarray, spacing: float,
                 exchange: Exchange = NO_EXCHANGE) -> np.ndarray:
    """`State.volume` (n,), m^dim, of particles that begin with phi (n,), m: what the parts have there."""
    count, part = _parts(neighbours, exchange.forward(phi), spacing, exchange)
    volumes, particles = reduce.totals_by(count, _of_cells(cut, exchange.forward(part)), (part, None))
    return _shared(volumes, particles, part)


def kept_volumes(cut: CutCells, neighbours: Neighbourhood, phi: np.ndarray, new: np.ndarray,
                 volume: np.ndarray, spacing: float,
                 exchange: Exchange = NO_EXCHANGE) -> tuple[np.ndarray, np.ndarray]:
    """(phi, `State.volume`) after a step, (n,) m and (n,) m^dim.

    cut: CutCells of phi (n,), m, before the step; new: (n,) what becomes of phi in it; volume: (n,) of the step before;
    neighbours: of the fluid particles; exchange: of the remote ones among them.
    """
    sample, everywhere = cut.sample, cut
    if sample is not None:
        cut = cut._replace(area=np.where(_within(cut.cells.middle, sample), cut.area, 0.0))
    distance = exchange.forward(phi)
    count, part = _parts(neighbours, distance, spacing, exchange)
    everyone = exchange.forward(part)
    across, moved = np.full(len(phi), -1), np.abs(new) < BAND * spacing
    asked = moved | ((new > 0.0) != (phi > 0.0))
    over_rows(_nearest_across, len(phi), neighbours, distance > 0.0, asked, across)
    wanted, have, particles = reduce.totals_by(count, (part, volume), _of_cells(cut, everyone), (part, None))
    level = _levels(wanted - have, _areas(cut, everyone, count), wanted)
    moved &= across >= 0
    if sample is not None:
        moved &= _within(neighbours.x[: len(phi)], sample)
    other = everyone[across]
    first = phi > 0.0
    rise = np.where(first, level[part] - level[other], level[other] - level[part])
    new = np.where(moved, new + np.clip(RETURN_RATE * rise, -LARGEST_MOVE * spacing, LARGEST_MOVE * spacing), new)
    changed = (new > 0.0) != first
    alone = changed & (across < 0)  # no interface is near that could have moved past them
    new[alone], changed = phi[alone], changed & ~alone
    now = np.where(changed, other, part)
    remain = reduce.total_by(now, None, count)
    there = remain > 0
    for gone in np.flatnonzero((particles > 0) & ~there):
        # smaller than a particle: what it had goes to the part of its fluid that is next to what is there now
        around = reduce.total_by(now[part == gone], None, count).argmax()
        kin = _areas(everywhere, everyone, count).beside(int(around), count)
        kin[~there] = 0.0
        wanted[kin.argmax() if kin.max() > 0.0 else around] += wanted[gone]
    return new, _shared(wanted, remain, now)


def _within(x: np.ndarray, sample: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Which points x (n, dim), m, are in a box of corners (dim,), (n,) bool."""
    return np.asarray(np.all((x >= sample[0]) & (x <= sample[1]), axis=1))


def _parts(neighbours: Neighbourhood, phi: np.ndarray, spacing: float, exchange: Exchange) -> tuple[int, np.ndarray]:
    """How many parts there are, and that of each particle (n,). phi: (n + remote,) m."""
    like = np.empty(len(neighbours.column), np.bool_)
    over_rows(_like, neighbours.n, neighbours, phi > 0.0, (LINKED * spacing) ** 2, like)
    return pair_components(neighbours.start, neighbours.column, like, exchange)


def _shared(volumes: np.ndarray, particles: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Volumes of the parts, shared out evenly among the particles of each, of which there are so many, (n,)."""
    return (volumes / np.maximum(particles, 1))[part]


def _of_cells(cut: CutCells, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(part, volume, m^dim) of both sides of the cells: as many for each part as it fills. part: (n + remote,) of the
    particles."""
    seen = cut.nearest >= 0
    volume = np.stack([cut.volume, cut.cells.fluid - cut.volume], axis=1)
    return part[cut.nearest[seen]], volume[seen]


class Touching(NamedTuple):
    """Parts of the two fluids that touch, (m,) each: one of the first fluid, one of the other, area between them,
    m^(dim - 1). Two that touch on several processes are there for each of these."""

    one: np.ndarray
    other: np.ndarray
    area: np.ndarray

    def beside(self, part: int, count: int) -> np.ndarray:
        """Area between a part and each of all, (count,) m^(dim - 1)."""
        here, there = self.one == part, self.other == part
        kin = np.concatenate([self.other[here], self.one[there]])
        return np.bincount(kin, np.concatenate([self.area[here], self.area[there]]), count)

    def groups(self, count: int) -> np.ndarray:
        """Number (count,) of the group of parts that touch, of each part: the smallest one in it."""
        group = np.arange(count)
        while True:
            least, before = np.minimum(group[self.one], group[self.other]), group.copy()
            np.minimum.at(group, self.one, least)
            np.minimum.at(group, self.other, least)
            if (group == before).all():
                return group


def _areas(cut: CutCells, part: np.ndarray, count: int) -> Touching:
    """Area of the interface between so many parts."""
    both = cut.area > 0.0
    first, other = part[cut.nearest[both]].T.astype(np.int64)
    pair, place = np.unique(first * count + other, return_inverse=True)
    # between parts, of which there are few, not between cells
    pair, area = reduce.together(pair, np.bincount(place, cut.area[both], len(pair)))
    return Touching(*np.divmod(pair, count), area)


def _levels(lacking: np.ndarray, between: Touching, wanted: np.ndarray) -> np.ndarray:
    """m of the parts, m, from what they lack, m^dim, the areas between them, and what they are to have, m^dim."""
    # the equations have a solution where what the parts of a group that touch lack adds up to zero: the largest part of
    # each group, which surrounds the others, takes what is left over
    count = len(lacking)
    group, surrounding = between.groups(count), np.arange(count)
    order = np.argsort(wanted, kind="stable")
    surrounding[group[order]] = order  # the largest last
    lacking = lacking - np.bincount(surrounding[group], lacking, count)
    one, other, area = between
    diagonal = np.bincount(one, area, count) + np.bincount(other, area, count)
    alone = diagonal <= 0.0
    if alone.all():
        return np.zeros(count)
    own = np.arange(count)
    values = np.concatenate([-area, -area, diagonal + LEVELS_RIDGE * diagonal.max()])
    places = np.concatenate([one, other, own]), np.concatenate([other, one, own])
    level = np.asarray(spsolve(sp.csc_matrix((values, places), shape=(count, count)), np.where(alone, 0.0, lacking)))
    return np.where(alone, 0.0, level)


@njit(cache=True, nogil=True)
def _like(rows, neighbours, first, most, like):
    """Which pairs are of one fluid, first (n,) bool that of particles, and within a distance whose square is `most`,
    (n_pairs,)."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    last, deep = x.shape[1] - 1, 1.0 if x.shape[1] == 3 else 0.0
    for i in range(rows[0], rows[1]):
        x0, x1, x2, own = x[i, 0], x[i, 1], x[i, last], first[i]
        for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            j = np.uint32(row[p])
            r2 = (x[j, 0] - x0) ** 2 + (x[j, 1] - x1) ** 2 + deep * (x[j, last] - x2) ** 2
            like[p] = (first[np.uint32(column[p])] == own) & (r2 < most)


@njit(cache=True, nogil=True)
def _nearest_across(rows, neighbours, first, asked, across):
    """The nearest particle of the other fluid that each one that is `asked` (n,) sees, (n,); first: (n,) bool."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    last, deep = x.shape[1] - 1, 1.0 if x.shape[1] == 3 else 0.0
    for i in range(rows[0], rows[1]):
        if asked[i]:
            least, x0, x1, x2, own = math.inf, x[i, 0], x[i, 1], x[i, last], first[i]
            for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                there = np.uint32(column[p])
                if first[there] != own:
                    j = np.uint32(row[p])
                    r2 = (x[j, 0] - x0) ** 2 + (x[j, 1] - x1) ** 2 + deep * (x[j, last] - x2) ** 2
                    if r2 < least:
                        least = r2
                        across[i] = there
