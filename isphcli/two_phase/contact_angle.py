"""The contact angle: the slope of the signed distance that walls ask for where an interface meets them.

The fit of `quadratic_fit` takes the angle in as a boundary condition. With theta measured through the first fluid and
p the normal of the wall, into the fluid, it is

    p . grad phi = -cos(theta) |grad phi| / (1 - kappa phi)     at the wall points above the dummies, near the line
                                                                where phi = 0 meets the wall,

|grad phi| and kappa those of the fit without them. The angle is that of the interface: the other levels of the distance
to a round interface have the same centre, and meet the wall at other angles. kappa is the curvature of the interface in
the plane of its normal and p, across the line: along the line the angle does not change. Without it the curvature
beside walls is 20 % off at every resolution, and drives the largest spurious velocities.

Normals and curvature beside the wall, and the smoothing of phi, follow from the fit. This is in the place of eqs 18-22,
which turn the normals of the fluid near a wall towards the angle: with them a drop asked for 150 degrees settles at 84.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..flow.state import phase_of
from ..operators.kernel import shape
from .quadratic_fit import FLATTEST, QuadraticFit, SlopesAtWalls, quadratic_fit

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..geometry.protocol import Geometry
    from ..operators.pair_weights import Operators

NEAR_LINE = 2.0  # spacings: wall points are given the angle less and less up to this distance from the interface
SHALLOW = 1.01  # spacings: dummies deeper than this have wall points that others have too
WEIGHT = 1.0  # of a slope at a wall point, times the support, over that of a value of a neighbour there


class SlipAtLine:
    """Walls near a contact line slip, so that the line can move as particles become many. length: Navier slip length,
    m; phase: (n,) of the fluid particles, once it is known; exchange: of the dummies."""

    def __init__(self, length: float, phase: np.ndarray | None = None, exchange: Exchange = NO_EXCHANGE):
        self.length, self.phase, self.exchange = length, phase, exchange

    def at(self, phi: np.ndarray) -> SlipAtLine:
        """The same for particles of signed distances phi (n,) to the interface."""
        return SlipAtLine(self.length, phase_of(phi), self.exchange)

    def wall_table(self, geometry: Geometry, wall: np.ndarray, neighbours: Neighbourhood,
                   particles: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """(wall (n_rows,), velocity, slip length, spin) of the walls, each listed twice: away from a contact line, and
        near one.

        wall: (n_rows,) nearest wall of each row; neighbours: of the fluid particles, dummies included; particles: how
        many there are before the dummies.
        """
        assert self.phase is not None
        owner = neighbours.owner
        sees = _fluids_in_sight(neighbours.start, neighbours.column, self.phase, int(owner.max(initial=-1)) + 1)
        sees[:particles] = 0  # no walls
        sees[particles:] = self.exchange.summed(sees[particles:])
        wall = wall + len(geometry.slip_length) * (sees[owner] > 0).all(axis=1).astype(wall.dtype)
        slip = np.concatenate([geometry.slip_length, np.maximum(geometry.slip_length, self.length)])
        spin = None if geometry.wall_spin is None else np.concatenate([geometry.wall_spin] * 2)
        return wall, np.concatenate([geometry.wall_velocity] * 2), slip, spin


class WallDummies(NamedTuple):
    """x: (n_dummy, dim) m; depth: (n_dummy,) below the wall, m, infinite below a concave edge, without normal and
    angle; normal: (n_dummy, dim) of the wall, into the fluid; neutral: (n_dummy,) bool, of walls that both fluids wet
    alike (90 degrees), or None; exchange: of those of other processes, which are the last ones."""

    x: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    neutral: np.ndarray | None = None
    exchange: Exchange = NO_EXCHANGE


class ContactAngle:
    """angle: degrees through the first fluid; dummies: those of the walls; spacing: m."""

    def __init__(self, angle: float, dummies: WallDummies, spacing: float):
        self.angle, self.dummies, self.spacing = math.radians(angle), dummies, spacing

    def _slope_of(self, dummy: np.ndarray) -> np.ndarray:
        """p . n at the wall points above dummies (m,)."""
        slope = np.full(len(dummy), -math.cos(self.angle))
        if self.dummies.neutral is not None:
            slope[self.dummies.neutral[dummy]] = 0.0
        return slope

    def at_walls(self, ops: Operators, seen: tuple[Neighbourhood, Neighbourhood], phi: np.ndarray, known: np.ndarray,
                 free: QuadraticFit) -> QuadraticFit:
        """The QuadraticFit `free` with those of particles that see wall points near a contact line made anew, with the
        angle there. ops: Operators; seen: neighbours that the fit takes, and all of them, dummies included; phi, known:
        (n + remote,) m, bool."""
        assert ops.walls is not None
        fitted, neighbours = seen
        shallow = self.dummies.depth < SHALLOW * self.spacing
        start, at, dummy = _seen(neighbours, known[: ops.n] & ops.walls.near_wall, shallow, len(phi))
        if not reduce.number(at):
            return free
        normal = self.dummies.normal[dummy]
        particle = np.repeat(np.arange(ops.n), np.diff(start))
        offset = neighbours.x[at] + self.dummies.depth[dummy][:, None] * normal - neighbours.x[particle]
        count = len(self.dummies.x)
        at_points = particle, offset, dummy
        sums = self.dummies.exchange.summed(_at_wall_points(at_points, normal, count, free, neighbours))
        distance, steepness, curvature = _means(sums)
        part = np.maximum(1.0 - (distance / (NEAR_LINE * self.spacing)) ** 2, 0.0) ** 2
        sharpest = 0.5 / (NEAR_LINE * self.spacing)  # kappa phi stays below a half
        bent = np.clip(curvature, -sharpest, sharpest) * np.where(part > 0.0, distance, 0.0)
        steepness /= 1.0 - bent
        touched = np.zeros(ops.n, np.bool_)
        touched[particle[part[dummy] > 0.0]] = True
        # in place of eqs 18-22
        slopes = SlopesAtWalls(start, offset, normal, steepness[dummy] * self._slope_of(dummy), WEIGHT * part[dummy])
        bound = quadratic_fit(fitted, phi, known, touched, ops.exchange.forward(free.slope), self.spacing, slopes)
        return QuadraticFit(*(np.where(touched if old.ndim == 1 else touched[:, None], new, old)
                              for old, new in zip(free, bound)))


@njit(cache=True)
def _fluids_in_sight(start, column, phase, count):
    """(count, 2) int32, above zero where a particle or dummy has either fluid within its support."""
    sees = np.zeros((count, 2), np.int32)
    for i in range(len(start) - 1):
        for p in range(start[i], start[i + 1]):
            sees[column[p], phase[i]] = 1
    return sees


@njit(cache=True)
def _seen(neighbours, mark, shallow, n):
    """(row pointers (rows + 1,), table rows, dummies) of the shallow dummies that the marked particles (rows,) see;
    n particles are before the dummies."""
    start, column, row = neighbours.start, neighbours.column, neighbours.row
    new_start = np.zeros(len(mark) + 1, np.int64)
    for i in range(len(mark)):
        new_start[i + 1] = new_start[i]
        if mark[i]:
            for p in range(start[i], start[i + 1]):
                new_start[i + 1] += column[p] >= n and shallow[column[p] - n]
    at, dummy = np.empty(new_start[-1], np.int64), np.empty(new_start[-1], np.int64)
    count = 0
    for i in range(len(mark)):
        if mark[i]:
            for p in range(start[i], start[i + 1]):
                if column[p] >= n and shallow[column[p] - n]:
                    at[count], dummy[count] = row[p], column[p] - n
                    count += 1
    return new_start, at, dummy


@njit(cache=True, error_model="numpy")
def _at_wall_points(at_points, normal, count, fit, neighbours):
    """Kernel sums (count, 4) over the particles that see the wall point above each dummy: of one, of what they make of
    phi there, m, of |grad phi| and of the curvature across the line, 1/m."""
    particle, offset, dummy = at_points
    dim = offset.shape[1]
    sums = np.zeros((count, 4))
    for p in range(len(particle)):
        i, r2, square, there = particle[p], 0.0, 0.0, fit.value[particle[p]]
        for k in range(dim):
            r2 += offset[p, k] ** 2
            square += fit.slope[i, k] ** 2
            there += fit.slope[i, k] * offset[p, k]
        w = shape(neighbours.kind, math.sqrt(r2) / neighbours.support)
        d = dummy[p]
        sums[d, 0] += w
        sums[d, 1] += w * there
        sums[d, 2] += w * math.sqrt(square)
        sums[d, 3] += w * _across_line(fit, i, normal[p])
    return sums


def _means(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """phi (count,), m, |grad phi| and the curvature across the line, 1/m, of the interface at wall points, of the sums
    of `_at_wall_points`: infinite and zero where no particle sees it."""
    seen = sums[:, 0] > 0.0
    means = sums[:, 1:] / np.where(seen, sums[:, 0], 1.0)[:, None]
    return np.where(seen, means[:, 0], np.inf), means[:, 1], means[:, 2]


@njit(cache=True, error_model="numpy")
def _across_line(fit, i, normal):
    """Curvature, 1/m, of the interface in the plane of its normal n and that of a wall, p (dim,), as particle i knows
    it: along m = p - (p . n) n, and at phi = 0 as in `quadratic_fit._curvature`."""
    dim, form = len(normal), fit.form[i]
    along, square = 0.0, 0.0
    for k in range(dim):
        along += normal[k] * fit.slope[i, k]
        square += fit.slope[i, k] ** 2
    bent, size = 0.0, 0.0
    for a in range(dim):
        m = normal[a] - along * fit.slope[i, a] / square
        size += m * m
        for b in range(dim):
            bent -= m * form[a * dim + b] * (normal[b] - along * fit.slope[i, b] / square)
    if not size > 0.0:
        return 0.0
    bent /= size
    return bent / max(1.0 + bent * fit.value[i] / math.sqrt(square), FLATTEST)
