"""The neighbours that the fit of the distance takes: SIGHT distances of particles, farther than the operators in 3D.

A quadratic function has ten unknowns in space. Over the 2.1 spacings of the operators a cubic lattice hardly has more
neighbours with a weight to speak of (one two spacings away weighs 2.5e-5 of the particle itself): the fit follows
roughness, of white noise it keeps 0.8, and curvature is as rough. Over 2.8 spacings, 80 neighbours, it keeps a half, as
in the plane. A body-centred lattice, two particles in a spacing cubed, has as many within 2.2 spacings. Only particles
that know their distance are looked through, and no operator has these neighbours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from ..domain.neighbours import Neighbourhood, find_pairs

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry
    from ..operators.pair_weights import Operators

# Distances of particles, the root of the volume of a site, that a curvature is fitted over at least: what 2D has. Ca of
# a meniscus between plates in 3D, 10 across, after t = 15, and of a cap of 5 in radius after t = 3: 1e-3 and 3e-4 with
# 2.1, 8e-6 and 1e-4 with 2.5, 2e-6 and 6e-5 with 2.8 (cubic).
SIGHT = 2.8


@dataclass(frozen=True)
class Sight:
    """reach: m, how far particles see others that know their distance; geometry: what hides them, or None."""

    reach: float
    geometry: Geometry | None = None

    def neighbours(self, ops: Operators, everyone: Neighbourhood,
                   known: np.ndarray) -> tuple[Neighbourhood, Neighbourhood]:
        """(fluid neighbours that no wall hides, all of them, dummies included) of the particles that are `known`
        (n,), among these. ops: Operators; everyone: neighbours within its support, dummies included."""
        if not self.reach > everyone.support or len(known) == 0:  # a process that sees nobody
            return ops.neighbours, everyone
        owner, n = everyone.owner, len(known)
        rows = np.flatnonzero((owner >= n) | known[np.minimum(owner, n - 1)]).astype(np.int32)
        own = rows[: np.searchsorted(rows, ops.n)]
        pairs = find_pairs(everyone.x[rows], len(own), self.reach)
        count = np.zeros(ops.n + 1, np.int64)
        count[1 + own] = pairs.count
        row = rows.take(pairs.index)
        far = Neighbourhood(np.cumsum(count), owner.take(row), row, everyone.x, owner, everyone.kind, self.reach)
        if ops.walls is None:  # nothing hides any, and there are no dummies
            return far, far
        assert self.geometry is not None
        seen = far.column < n
        self._hide(ops, everyone, far, seen)
        start = far.start - np.searchsorted(np.flatnonzero(~seen), far.start)  # few are not seen
        which = np.flatnonzero(seen)
        return far._replace(start=start, column=far.column.take(which), row=row.take(which)), far

    def _hide(self, ops: Operators, everyone: Neighbourhood, far: Neighbourhood, seen: np.ndarray) -> None:
        """Takes those behind a wall out of seen (n_pairs,), of the pairs `far`. Within the support `ops` knows."""
        assert self.geometry is not None and ops.walls is not None
        ask = np.zeros(len(seen), np.bool_)
        _known_or_asked(ops.neighbours, everyone, far, ops.walls.distance, seen, ask)
        asked = np.flatnonzero(ask)
        particle = np.searchsorted(far.start, asked, side="right") - 1
        seen[asked] = self.geometry.crossing(far.x[particle], far.x[far.row[asked]]) >= 1.0


@njit(cache=True)
def _known_or_asked(in_sight, everyone, far, distance, seen, ask):
    """Of the pairs `far` those that a wall hides by what is known, taken out of seen (n_pairs,), and those that it may
    hide, in ask (n_pairs,): no free balls round particles, distance (n,) m, cover the way."""
    mark, n, x, last = np.zeros(len(far.x), np.int64), len(distance), far.x, far.x.shape[1] - 1
    deep = 1.0 if last == 2 else 0.0
    for i in range(len(far.start) - 1):
        if far.start[i] == far.start[i + 1] or distance[i] > far.support:  # nobody, or all in a ball of fluid
            continue
        # 2 i + 2: a neighbour of i in sight; 2 i + 1: hidden
        for p in range(np.uint64(everyone.start[i]), np.uint64(everyone.start[i + 1])):
            mark[np.uint32(everyone.row[p])] = 2 * i + 1
        for p in range(np.uint64(in_sight.start[i]), np.uint64(in_sight.start[i + 1])):
            mark[np.uint32(in_sight.row[p])] = 2 * i + 2
        x0, x1, x2, here = x[i, 0], x[i, 1], x[i, last], max(distance[i], 0.0)
        for p in range(np.uint64(far.start[i]), np.uint64(far.start[i + 1])):
            j = np.uint32(far.row[p])
            if far.column[p] >= n:
                continue
            if mark[j] > 2 * i:
                seen[p] = mark[j] == 2 * i + 2
                continue
            r = math.sqrt((x[j, 0] - x0) ** 2 + (x[j, 1] - x1) ** 2 + deep * (x[j, last] - x2) ** 2)
            there = r - max(distance[np.uint32(far.column[p])], 0.0)
            ask[p] = there > here * (1.0 + 1e-9) and not _free(i, r, j, (here, there), x, distance, in_sight)


@njit(cache=True, forceinline=True)
def _free(i, r, there, ends, x, distance, in_sight):
    """Whether a free ball round a neighbour covers the way of length r from particle i to the row `there` of x between
    the ends of those round both: sqrt(distance^2 - h^2) of the way to either side, h from the middle of the ball."""
    last, deep = x.shape[1] - 1, 1.0 if x.shape[1] == 3 else 0.0
    w0, w1, w2 = x[there, 0] - x[i, 0], x[there, 1] - x[i, 1], deep * (x[there, last] - x[i, last])
    for q in range(np.uint64(in_sight.start[i]), np.uint64(in_sight.start[i + 1])):
        j, free = np.uint32(in_sight.row[q]), distance[np.uint32(in_sight.column[q])]
        d0, d1, d2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], deep * (x[j, last] - x[i, last])
        along = (d0 * w0 + d1 * w1 + d2 * w2) / r
        half = max(free, 0.0) ** 2 - max(d0 * d0 + d1 * d1 + d2 * d2 - along * along, 0.0)
        if half > 0.0:
            half = (1.0 - 1e-9) * math.sqrt(half)
            if along - half <= ends[0] and along + half >= ends[1]:
                return True
    return False
