"""The class of each neighbourhood beside walls (`neighbourhood_class`), and the pressure of isolated particles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.components import pair_components
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..domain.row_threads import over_rows
from .crossings import IN_SIGHT, MEETS_WALL, SHARES_PRESSURE, in_sight
from .kernel import slope
from .moments import extremes_2d, extremes_3d
from .neighbourhood_class import FULL, ISOLATED, NARROW, NARROW_SHARE, NARROW_SHARE_FIXED, THIN, WALL

if TYPE_CHECKING:
    from .crossings import WallStencils
    from .pair_weights import Operators


def classify_neighbourhoods(stencils: WallStencils, exchange: Exchange = NO_EXCHANGE) -> np.ndarray:
    """Class of each particle, (n,) int8; pairs that share no pressure are marked in `stencils.links` in place.
    exchange: of the remote particles.

    Nobody shares the pressure with isolated particles: they have no gradient, no force (the body force is taken with
    the same weights) and no divergence, and move as the fluid around them drags them. Else one weak pair that
    changes as particles move would set the pressure of one or two of them: it reaches 1e4 times that of the fluid
    around, and throws them out once the pair grows a little stronger.
    """
    neighbours, link = stencils.neighbours, stencils.links.link
    start, column = neighbours.start, neighbours.column
    smallest, largest, walled = _shares_of(stencils)
    found = np.where(walled, WALL, FULL).astype(np.int8)
    found[smallest < NARROW_SHARE] = NARROW
    isolated = largest < THIN
    if reduce.any_true(isolated):
        over_rows(_share_no_pressure, neighbours.n, start, column, link, exchange.forward(isolated))
        isolated |= _behind(start, column, link, exchange) & ~isolated
        over_rows(_share_no_pressure, neighbours.n, start, column, link, exchange.forward(isolated))
        found[isolated] = ISOLATED
    return found


def fixed_classes(stencils: WallStencils) -> np.ndarray:
    """Class of each particle of a steady solve, (n,) int8; none is isolated (`NARROW_SHARE_FIXED`)."""
    smallest, _, walled = _shares_of(stencils)
    found = np.where(walled, WALL, FULL).astype(np.int8)
    found[walled & ~(smallest > NARROW_SHARE_FIXED)] = NARROW
    return found


def _shares_of(stencils: WallStencils) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See `_shares`."""
    n = stencils.neighbours.n
    found = np.ones(n), np.ones(n), np.zeros(n, np.bool_)
    over_rows(_shares, n, stencils.neighbours, stencils.links.link, stencils.volume, *found)
    return found


def _behind(start: np.ndarray, column: np.ndarray, link: np.ndarray, exchange: Exchange) -> np.ndarray:
    """Particles (n,) in clusters smaller than a neighbourhood that only isolated particles join with the rest."""
    seen, sight = in_sight(start, link), link != MEETS_WALL
    begin, fluid, shared = np.concatenate([[0], np.cumsum(seen)]), column[sight], link[sight] == SHARES_PRESSURE
    (wholes, whole), (parts, part) = (pair_components(begin, fluid, joined, exchange) for joined in (None, shared))
    size, all_in_sight = reduce.total_by(part, labels=parts)[part], reduce.total_by(whole, labels=wholes)[whole]
    return (size < all_in_sight) & (size < np.diff(start))


@njit(cache=True, nogil=True, error_model="numpy")
def _shares(rows, neighbours, link, volume, smallest, largest, walled):
    """Smallest and largest eigenvalue of the moments of the neighbours in sight, over the mean one of all neighbours,
    and whether some are not in sight, into arrays (n,) of ones and of False; 0 where there are none."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, support = neighbours.kind, neighbours.support
    dim = x.shape[1]
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            if link[p] == MEETS_WALL:
                walled[i] = True
        if start[i] == start[i + 1]:
            smallest[i], largest[i] = 0.0, 0.0
        if walled[i]:
            whole, xx, yy, zz, yz, xz, xy, dz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for p in range(start[i], start[i + 1]):
                j = row[p]
                dx, dy = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1]
                if dim == 3:
                    dz = x[j, 2] - x[i, 2]
                r = math.sqrt(dx * dx + dy * dy + dz * dz)
                w = volume[column[p]] * slope(kind, r / support) / r if r > 0.0 else 0.0
                whole += w * r * r / dim
                if link[p] != MEETS_WALL:
                    xx, yy, zz = xx + w * dx * dx, yy + w * dy * dy, zz + w * dz * dz
                    yz, xz, xy = yz + w * dy * dz, xz + w * dx * dz, xy + w * dx * dy
            low, high = extremes_2d(xx, yy, xy) if dim == 2 else extremes_3d(xx, yy, zz, yz, xz, xy)
            smallest[i], largest[i] = low / whole, high / whole


@njit(cache=True, nogil=True)
def _share_no_pressure(rows, start, column, link, isolated):
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            if link[p] != MEETS_WALL and (isolated[i] or isolated[column[p]]):
                link[p] = IN_SIGHT


def extrapolate_pressure(ops: Operators, p: np.ndarray) -> None:
    """Sets the pressure p (n,) of isolated particles to the mean over their neighbours in sight, in place, from the
    mouth of a dead end inwards. A particle that comes out of the dead end starts from it, and files hold it."""
    assert ops.walls is not None
    known, more = ~ops.walls.isolated, True
    while more:
        found, forward = known.copy(), ops.exchange.forward
        _extrapolate_pressure(ops.start, ops.column, forward(known), forward(p.copy()), p, found)
        known, more = found, reduce.any_true(found & ~known)


@njit(cache=True)
def _extrapolate_pressure(start, column, known, given, p, found):
    for i in range(len(p)):
        if not known[i]:
            count, total = 0, 0.0
            for q in range(start[i], start[i + 1]):
                if known[column[q]]:
                    count += 1
                    total += given[column[q]]
            if count > 0:
                p[i], found[i] = total / count, True
