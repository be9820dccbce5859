"""The faces of a fluid shape that lie along a wall: they are no interface, and the shape goes on behind them.

A slug that ends where a plate begins has faces along the plates. The signed distance to its surface is small beside
them, and a run would carry an interface along the walls: between plates ten spacings apart such a slug moved along
them at Ca 3e-3, and the volume of its fluid was 3 % too small.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .bodies import Box, Cylinder, HalfSpace, Region, Sphere, nearest_image
from .faces import block_distance

SAMPLES = 32  # sample points, at least, along each direction of a face: they decide what lies on its sides
MOST = {2: 4096, 3: 512}  # most sample points along a direction, by dimension: 512 x 512 take a second per face
BESIDE = 1e-6  # of the largest side of the box: distance of the sample points from their face
Phases = Callable[[np.ndarray], np.ndarray]
Crossing = Callable[[np.ndarray, np.ndarray], np.ndarray]


class FluidFaces:
    """The faces of a body of fluid. box: (lower, upper) corners (dim,), m; period: (dim,) m, infinite along axes that
    are not periodic; phase: fluid (n,) of points, -1 of solids; spacing: m, openings in a face that are narrower than
    half of it may be missed. kept: of each face, whether there is fluid on both its sides anywhere."""

    def __init__(self, body: Region, box: tuple[np.ndarray, np.ndarray], period: np.ndarray, phase: Phases,
                 spacing: float):
        self.body, self.period = body, period
        lower, upper = box
        longest = float((upper - lower).max())
        samples = int(np.clip(math.ceil(2.0 * longest / spacing), SAMPLES, MOST[len(lower)]))
        self.off, kept = BESIDE * longest, []
        for points, normals in _faces(body, lower, upper, period, samples):
            sides = np.stack([phase(points + sign * self.off * normals) for sign in (-1.0, 1.0)])
            kept.append(bool((sides >= 0).all(axis=0).any()))
        self.kept = kept

    @property
    def whole(self) -> bool:
        """Whether no face lies along a wall."""
        return all(self.kept)

    def signed_distance(self, x: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the surface, m, < 0 inside, as if the faces along walls were infinitely far
        off."""
        body = self.body
        if self.whole:
            return body.signed_distance(x, self.period)
        if isinstance(body, Box):
            lower, upper = np.asarray(body.lower, float), np.asarray(body.upper, float)
            q = _between(x, lower, upper, self.period, np.reshape(self.kept, (-1, 2)))
        elif isinstance(body, Cylinder) and body.ends is not None:
            along = [body.axis]
            side = Cylinder(body.axis, body.centre, body.radius).signed_distance(x, self.period)
            ends = _between(x[:, along], np.array(body.ends[:1]), np.array(body.ends[1:]), self.period[along],
                            np.reshape(self.kept[1:], (1, 2)))
            q = np.stack([side if self.kept[0] else np.full(len(x), -np.inf), ends[:, 0]], axis=1)
        else:
            return np.full(len(x), -np.inf)
        return block_distance(q)

    def in_sight(self, x: np.ndarray, crossing: Crossing) -> np.ndarray:
        """`signed_distance` (n,) of fluid points x (n, dim), m; infinite where the walls along which faces lie
        hide the body from a point. crossing: as `Geometry.crossing`."""
        d, body = self.signed_distance(x), self.body
        if self.whole:
            return d
        true = body.signed_distance(x, self.period)
        beyond = np.flatnonzero((true > 0.0) & (d < true))  # leaving out faces along walls changes these
        away, steps = x[beyond], self.off * np.eye(x.shape[1])
        rise = [body.signed_distance(away + step, self.period) - body.signed_distance(away - step, self.period)
                for step in steps]
        nearest = away - true[beyond, None] * np.stack(rise, axis=1) / (2.0 * self.off)
        hidden = (d[beyond] <= 0.0) | (crossing(away, nearest) < 1.0)
        d[beyond[hidden]] = np.inf
        return d


def _between(x: np.ndarray, lower: np.ndarray, upper: np.ndarray, period: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """(n, k) distance of x (n, k) beyond the nearer of two planes across each axis, < 0 between them; kept: (k, 2)
    bool, which of them are there. A space that fills the period has none."""
    offset = nearest_image(x - (lower + upper) / 2, period)
    half = (upper - lower) / 2
    planes = np.stack([-half - offset, offset - half], axis=2)
    return np.where(kept & (2.0 * half < period)[:, None], planes, -np.inf).max(axis=2)


def _faces(body: Region, lower: np.ndarray, upper: np.ndarray,
           period: np.ndarray, samples: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(points (m, dim), normals (m, dim)) on each face of a body, within the box; none of other kinds of bodies."""
    if isinstance(body, Box):
        return _faces_of_block(body, lower, upper, period, samples)
    if isinstance(body, Cylinder):
        return _faces_of_cylinder(body, lower, upper, period, samples)
    if isinstance(body, Sphere):
        normals = _directions(len(lower), samples)
        return [_inside(np.asarray(body.centre, float) + body.radius * normals, normals, lower, upper, period)]
    if isinstance(body, HalfSpace):
        normal = body.unit_normal
        axis = int(np.argmax(np.abs(normal)))
        points = _grid(lower, upper, samples, axis)
        points[:, axis] -= body.signed_distance(points, period) / normal[axis]
        return [_inside(points, np.broadcast_to(normal, points.shape), lower, upper, np.full(len(lower), np.inf))]
    return []


def _faces_of_block(body: Box, lower: np.ndarray, upper: np.ndarray,
                    period: np.ndarray, samples: int) -> list[tuple[np.ndarray, np.ndarray]]:
    corners = np.array([body.lower, body.upper], float)
    around = np.isfinite(period)
    # the part of it that the box holds; along periodic axes all of it may be in the box
    first = np.where(around, corners[0], np.maximum(corners[0], lower))
    last = np.where(around, np.minimum(corners[1], corners[0] + period), np.minimum(corners[1], upper))
    faces = []
    for axis in range(len(lower)):
        for side in (0, 1):
            points = _grid(first, last, samples, axis)
            points[:, axis] = corners[side, axis]
            normals = np.zeros_like(points)
            normals[:, axis] = 2.0 * side - 1.0
            faces.append(_inside(points, normals, lower, upper, period))
    return faces


def _faces_of_cylinder(body: Cylinder, lower: np.ndarray, upper: np.ndarray,
                       period: np.ndarray, samples: int) -> list[tuple[np.ndarray, np.ndarray]]:
    axis, ends = body.axis, body.ends or (float(lower[body.axis]), float(upper[body.axis]))
    across = [a for a in range(3) if a != axis]
    angle = 2.0 * math.pi * (np.arange(2 * samples) + 0.5) / (2 * samples)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = ends[0] + (ends[1] - ends[0]) * (np.arange(samples) + 0.5) / samples
    normals = np.zeros((samples, 2 * samples, 3))
    normals[:, :, across] = ring
    points = np.asarray(body.centre, float) + body.radius * normals
    points[:, :, axis] = along[:, None]
    faces = [_inside(points.reshape(-1, 3), normals.reshape(-1, 3), lower, upper, period)]
    for end, sign in zip(ends, (-1.0, 1.0)) if body.ends is not None else ():
        radii = body.radius * np.sqrt((np.arange(samples) + 0.5) / samples)
        points = np.asarray(body.centre, float) + np.zeros((samples, 2 * samples, 3))
        points[:, :, across] += radii[:, None, None] * ring
        points[:, :, axis] = end
        normals = np.zeros_like(points)
        normals[:, :, axis] = sign
        faces.append(_inside(points.reshape(-1, 3), normals.reshape(-1, 3), lower, upper, period))
    return faces


def _grid(lower: np.ndarray, upper: np.ndarray, samples: int, flat: int) -> np.ndarray:
    """(m, dim) points all over a block across the axis `flat`, m."""
    steps = (np.arange(samples) + 0.5) / samples
    axes = [lower[a] + (upper[a] - lower[a]) * (steps if a != flat else steps[:1]) for a in range(len(lower))]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(lower))


def _directions(dim: int, samples: int) -> np.ndarray:
    """(m, dim) unit vectors, spread evenly."""
    count = 8 * samples if dim == 2 else 2 * samples * samples
    turn = np.arange(count) + 0.5
    if dim == 2:
        return np.stack([np.cos(2.0 * math.pi * turn / count), np.sin(2.0 * math.pi * turn / count)], axis=1)
    height, angle = 1.0 - 2.0 * turn / count, math.pi * (1.0 + math.sqrt(5.0)) * turn
    flat = np.sqrt(1.0 - height * height)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)


def _inside(points: np.ndarray, normals: np.ndarray, lower: np.ndarray, upper: np.ndarray,
            period: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points and normals whose points, wrapped along periodic axes, lie in the box."""
    there = (np.isfinite(period) | ((points >= lower) & (points <= upper))).all(axis=1)
    return points[there], normals[there]
