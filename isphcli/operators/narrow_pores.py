"""Neighbourhoods that see few of their neighbours: which particles lie in narrow pores, and which in dead ends that
share no pressure with the rest (docs/method.md 7).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.components import pair_components
from .crossings import IN_SIGHT, MEETS_WALL, SHARES_PRESSURE, in_sight

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from .pair_weights import Operators

FEW = 0.5  # of the neighbours
NARROW = 0.65  # the same in scenes with dead ends: with 0.5 a pack held 110 steps. Flat walls leave two thirds
ISOLATED = 0.1  # of the neighbours: three of 32; with two, three particles in a dead end still blew up


def classify_neighbourhoods(neighbours: Neighbourhood,
                            link: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Particles that see few of their neighbours: (narrow, isolated), (n,) bool each; None where none is isolated.

    neighbours: all of them; link: (n_pairs,), see `Links`, where pairs that share no pressure are marked in place.

    narrow: less than NARROW of them, in pores as narrow as a particle. Their divergence is that of
    `adjoint_divergence`. The corners of a wide scene see no more: without dead ends `flux_form` stays.
    isolated: less than ISOLATED, in dead ends beside points of contact, and what only such particles join with the rest
    if it is less than a neighbourhood. Nobody shares the pressure with them: they have no
    gradient, no force (the body force is taken with the same weights) and no divergence, and move as the fluid
    around them drags them. Else the pressure of one or two particles hangs on a thread, of which shape and length
    change as they move: it reached 1e4 times that of the fluid around them, and where the thread grew a little
    stronger it threw them out.
    """
    start, column = neighbours.start, neighbours.column
    seen, count = in_sight(start, link), np.diff(start)
    narrow, isolated = seen < NARROW * count, seen < ISOLATED * count
    if not reduce.any_true(isolated):
        return None, None
    _share_no_pressure(start, column, link, isolated)
    sight, begin = link != MEETS_WALL, np.concatenate([[0], np.cumsum(seen)])
    fluid, shared = column[sight], link[sight] == SHARES_PRESSURE
    whole, part = (pair_components(begin, fluid, joined)[1] for joined in (None, shared))
    size, all_in_sight = reduce.total_by(part)[part], reduce.total_by(whole)[whole]
    behind = (size < all_in_sight) & (size < count) & ~isolated
    if reduce.any_true(behind):
        isolated |= behind
        _share_no_pressure(start, column, link, isolated)
    return narrow, isolated


@njit(cache=True)
def _share_no_pressure(start, column, link, isolated):
    for i in range(len(isolated)):
        for p in range(start[i], start[i + 1]):
            if link[p] != MEETS_WALL and (isolated[i] or isolated[column[p]]):
                link[p] = IN_SIGHT


def extrapolate_pressure(ops: Operators, p: np.ndarray) -> None:
    """Gives p (n,) of particles that share it with nobody the mean of what they see, in place, deep in a dead end step
    by step: what they start from when they see more, and what is written."""
    assert ops.walls is not None
    _extrapolate_pressure(ops.start, ops.column, ops.walls.isolated, p)


@njit(cache=True)
def _extrapolate_pressure(start, column, isolated, p):
    for i in range(len(p)):
        if isolated[i]:
            count, total = 0, 0.0
            for q in range(start[i], start[i + 1]):
                count += 1
                total += p[column[q]]
            if count > 0:
                p[i] = total / count
