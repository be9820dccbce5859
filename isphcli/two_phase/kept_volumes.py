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
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numba import njit
from scipy.sparse.csgraph import connected_components
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
    count, part = _parts(neighbours, phi, spacing, exchange)
    return _shared(_volumes(cut, exchange.forward(part), count), part)


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
    count, part = _parts(neighbours, phi, spacing, exchange)
    everyone = exchange.forward(part)
    across = np.full(len(phi), -1)
    over_rows(_nearest_across, len(phi), neighbours, exchange.forward(phi), across)
    wanted = reduce.total_by(part, volume, count)
    between = _areas(cut, everyone, count)
    level = _levels(wanted - _volumes(cut, everyone, count), between, wanted)
    moved = np.abs(new) < BAND * spacing
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
    there = reduce.total_by(now, None, count) > 0
    for gone in np.flatnonzero((reduce.total_by(part, None, count) > 0) & ~there):
        # smaller than a particle: what it had goes to the part of its fluid that is next to what is there now
        around = reduce.total_by(now[part == gone], None, count).argmax()
        kin = _areas(everywhere, everyone, count)[[around]].toarray()[0]
        kin[~there] = 0.0
        wanted[kin.argmax() if kin.max() > 0.0 else around] += wanted[gone]
    return new, _shared(wanted, now)


def _within(x: np.ndarray, sample: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Which points x (n, dim), m, are in a box of corners (dim,), (n,) bool."""
    return np.asarray(np.all((x >= sample[0]) & (x <= sample[1]), axis=1))


def _parts(neighbours: Neighbourhood, phi: np.ndarray, spacing: float, exchange: Exchange) -> tuple[int, np.ndarray]:
    """How many parts there are, and that of each particle (n,)."""
    like = np.zeros(len(neighbours.column), np.bool_)
    over_rows(_like, len(phi), neighbours, exchange.forward(phi), (LINKED * spacing) ** 2, like)
    return pair_components(neighbours.start, neighbours.column, like, exchange)


def _shared(volumes: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Volumes of the parts, shared out evenly among the particles of each, (n,)."""
    return (volumes / np.maximum(reduce.total_by(part, None, len(volumes)), 1))[part]


def _volumes(cut: CutCells, part: np.ndarray, count: int) -> np.ndarray:
    """Volume of each of so many parts, m^dim. part: (n + remote,) of the particles."""
    seen = cut.nearest >= 0
    volume = np.stack([cut.volume, cut.cells.fluid - cut.volume], axis=1)
    return reduce.total_by(part[cut.nearest[seen]], volume[seen], count)


def _areas(cut: CutCells, part: np.ndarray, count: int) -> sp.csr_matrix:
    """Area of the interface between each two of so many parts, m^(dim - 1)."""
    both = cut.area > 0.0
    first, other = part[cut.nearest[both]].T.astype(np.int64)
    pair, place = np.unique(first * count + other, return_inverse=True)
    # between parts, of which there are few, not between cells
    pair, area = (reduce.together(values) for values in (pair, np.bincount(place, cut.area[both], len(pair))))
    first, other = np.divmod(pair, count)
    ends = np.concatenate([first, other]), np.concatenate([other, first])
    return sp.csr_matrix((np.concatenate([area, area]), ends), shape=(count, count))


def _levels(lacking: np.ndarray, between: sp.csr_matrix, wanted: np.ndarray) -> np.ndarray:
    """m of the parts, m, from what they lack, m^dim, the areas between them, and what they are to have, m^dim."""
    # what the parts round one do not lack they cannot give: of those that have area between them, which are all but for
    # what lies outside of a sample, the largest one is what surrounds the others, and has what is left over
    joined, group = connected_components(between, directed=False)
    surrounding = np.zeros(joined, np.int64)
    order = np.argsort(wanted, kind="stable")
    surrounding[group[order]] = order  # the largest last
    lacking = lacking.copy()
    lacking[surrounding] -= np.bincount(group, lacking, joined)
    diagonal = np.asarray(between.sum(axis=1)).ravel()
    alone = diagonal <= 0.0
    if alone.all():
        return np.zeros(len(diagonal))
    off, own = between.tocoo(), np.arange(len(diagonal))
    values = np.concatenate([-off.data, diagonal + LEVELS_RIDGE * diagonal.max()])
    places = np.concatenate([off.row, own]), np.concatenate([off.col, own])
    level = np.asarray(spsolve(sp.csc_matrix((values, places), shape=between.shape), np.where(alone, 0.0, lacking)))
    return np.where(alone, 0.0, level)


@njit(cache=True, nogil=True)
def _like(rows, neighbours, phi, most, like):
    """Which pairs are of one fluid and within a distance whose square is `most`, (n_pairs,)."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            if (phi[column[p]] > 0.0) == (phi[i] > 0.0):
                r2 = 0.0
                for k in range(x.shape[1]):
                    r2 += (x[row[p], k] - x[i, k]) ** 2
                like[p] = r2 < most


@njit(cache=True, nogil=True)
def _nearest_across(rows, neighbours, phi, across):
    """The nearest particle of the other fluid that each one sees, (n,)."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    dim = x.shape[1]
    for i in range(rows[0], rows[1]):
        least = math.inf
        for p in range(start[i], start[i + 1]):
            j = column[p]
            if (phi[j] > 0.0) != (phi[i] > 0.0):
                r2 = 0.0
                for k in range(dim):
                    r2 += (x[row[p], k] - x[i, k]) ** 2
                if r2 < least:
                    least = r2
                    across[i] = j
