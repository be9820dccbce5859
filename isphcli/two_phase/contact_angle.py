"""The contact angle: what walls carry on of an interface that meets them.

Eqs 18-22 turn the normals of the fluid near a wall towards the contact angle; asked for 150 degrees, a drop then
settles at 84. Here the dummies carry the interface on: each one near a contact line has

    a normal  n_D = t sin(theta) - p cos(theta),     p into the fluid, t along the wall into the first fluid, and
    a colour  c_D = c(x_D + L (p + t cot(theta))),   L = d_D + dx: that of the fluid where the line that meets the wall
                                                     at theta comes out of it,

and the colour gradient and the curvature of the fluid particles see them. theta is measured through the first fluid.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from ..operators.kernel import shape
from .normals import Ghosts, dilate, find_band

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..geometry.protocol import Geometry
    from ..operators.pair_weights import Operators

STEEPEST = math.radians(20.0)  # the line is not carried on flatter than this: the colour would come from afar
SIDEWAYS = 0.3  # of a normal that lies along the wall: below this part the interface runs along the wall, not into it
SAMPLES = 6  # fluid particles from which the colour of a dummy is averaged


class SlipAtLine:
    """Walls near a contact line slip, so that the line can move as particles become many. phase: (n,) of the fluid
    particles; length: Navier slip length, m."""

    def __init__(self, phase: np.ndarray, length: float):
        self.phase, self.length = phase, length

    def wall_table(self, geometry: Geometry, wall: np.ndarray,
                   neighbours: Neighbourhood) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """(wall (n_rows,), velocity, slip length, spin) of the walls, each there twice: as it is, and near a line.

        wall: (n_rows,) nearest wall of each row; neighbours: of the fluid particles, dummies included.
        """
        n, owner = len(self.phase), neighbours.owner
        sees = _fluids_in_sight(neighbours.start, neighbours.column, self.phase, int(owner.max()) + 1)
        wall = wall + len(geometry.slip_length) * ((owner >= n) & sees[owner].all(axis=1)).astype(wall.dtype)
        slip = np.concatenate([geometry.slip_length, np.maximum(geometry.slip_length, self.length)])
        spin = None if geometry.wall_spin is None else np.concatenate([geometry.wall_spin] * 2)
        return wall, np.concatenate([geometry.wall_velocity] * 2), slip, spin


class WallDummies(NamedTuple):
    """x: (n_dummy, dim) m; depth: (n_dummy,) below the wall, m; normal: (n_dummy, dim) of the wall, into the fluid;
    volume: of each, m^dim; neutral: (n_dummy,) bool, of walls that both fluids wet alike (90 degrees), or None."""

    x: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    volume: float
    neutral: np.ndarray | None = None


class ContactAngle:
    """angle: degrees through the first fluid; dummies: those of the walls; kind: kernel number; support, spacing: m."""

    def __init__(self, angle: float, dummies: WallDummies, kind: int, support: float, spacing: float):
        self.angle, self.dummies = math.radians(angle), dummies
        self.kind, self.support, self.spacing = kind, support, spacing

    def ghosts(self, ops: Operators, neighbours: Neighbourhood, colour: np.ndarray, near: np.ndarray) -> Ghosts | None:
        """Ghosts of one configuration, or None where the interface meets no wall. Arguments as those of
        `SurfaceTension.force`."""
        n, x, reach = len(colour), neighbours.x, near
        for _ in range(2):
            reach = dilate(ops.start, ops.column, reach)
        assert ops.walls is not None
        reach &= ops.walls.near_wall
        start, at, dummy = _seen(neighbours, reach, n)
        if len(at) == 0:
            return None
        band = find_band(ops, colour, near, self.spacing, wanted=reach)
        particle = np.repeat(np.arange(n), np.diff(start))
        offset = x[at] - x[particle]
        seen = np.zeros(len(self.dummies.x), np.bool_)
        seen[dummy] = True
        used, where = np.flatnonzero(seen), (np.cumsum(seen) - 1)[dummy]
        along = _sum_normals(particle, offset, where, len(used), band.normal, band.strength, (self.kind, self.support))
        p = self.dummies.normal[used]  # in place of eq. 19: of the wall distance
        along -= (along * p).sum(axis=1, keepdims=True) * p  # eq. 20, of the normals around the dummy
        size = np.linalg.norm(along, axis=1)
        meets = size > SIDEWAYS
        if self.dummies.neutral is not None:
            meets &= ~self.dummies.neutral[used]
        t = np.where(meets[:, None], along / np.where(size > 0.0, size, 1.0)[:, None], 0.0)
        # eq. 18, on the dummies; the fluid sees them, and no normal is blended (eqs 21-22)
        normal = np.where(meets[:, None], math.sin(self.angle) * t - math.cos(self.angle) * p, 0.0)
        steep = min(max(self.angle, STEEPEST), math.pi - STEEPEST)
        rise = (self.dummies.depth[used] + self.spacing)[:, None]
        carried = self._colour_at(self.dummies.x[used] + rise * (p + t / math.tan(steep)), x, neighbours.owner, colour)
        return Ghosts(start, offset, carried[where], normal[where], self.dummies.volume)

    def _colour_at(self, points: np.ndarray, x: np.ndarray, owner: np.ndarray, colour: np.ndarray) -> np.ndarray:
        """Kernel average of the colour of the fluid nearest to points (m, dim)."""
        rows = np.flatnonzero(owner < len(colour))
        count = min(SAMPLES, len(rows))
        distance, index = cKDTree(x[rows]).query(points, k=count)
        distance, index = distance.reshape(len(points), count), index.reshape(len(points), count)
        # the nearest always counts, however far
        weight = np.maximum(1.0 - (distance / (1.5 * np.maximum(distance[:, :1], self.spacing))) ** 2, 0.0) ** 2
        return (weight * colour[owner[rows[index]]]).sum(axis=1) / weight.sum(axis=1)


@njit(cache=True)
def _fluids_in_sight(start, column, phase, count):
    """(count, 2) bool, whether a particle or dummy has either fluid within its support."""
    sees = np.zeros((count, 2), np.bool_)
    for i in range(len(start) - 1):
        for p in range(start[i], start[i + 1]):
            sees[column[p], phase[i]] = True
    return sees


@njit(cache=True)
def _seen(neighbours, mark, n):
    """(row pointers (n + 1,), table rows, dummies) of what the marked particles see of the walls."""
    start, column, row = neighbours.start, neighbours.column, neighbours.row
    new_start = np.zeros(n + 1, np.int64)
    for i in range(n):
        new_start[i + 1] = new_start[i]
        if mark[i]:
            for p in range(start[i], start[i + 1]):
                new_start[i + 1] += column[p] >= n
    at, dummy = np.empty(new_start[n], np.int64), np.empty(new_start[n], np.int64)
    count = 0
    for i in range(n):
        if mark[i]:
            for p in range(start[i], start[i + 1]):
                if column[p] >= n:
                    at[count], dummy[count] = row[p], column[p] - n
                    count += 1
    return new_start, at, dummy


@njit(cache=True)
def _sum_normals(particle, offset, where, count, normal, strength, kernel):
    """Kernel average of the fluid's normals round each dummy, (count, dim)."""
    dim = offset.shape[1]
    total, out = np.zeros(count), np.zeros((count, dim))
    for p in range(len(particle)):
        i, d = particle[p], where[p]
        if strength[i] > 0.0:
            r2 = 0.0
            for k in range(dim):
                r2 += offset[p, k] ** 2
            w = strength[i] * shape(kernel[0], math.sqrt(r2) / kernel[1])
            total[d] += w
            for k in range(dim):
                out[d, k] += w * normal[i, k]
    for d in range(count):
        if total[d] > 0.0:
            for k in range(dim):
                out[d, k] /= total[d]
    return out
