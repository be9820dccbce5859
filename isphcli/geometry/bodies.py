"""Bodies with exact signed distances: spheres, boxes, cylinders and half-spaces, and the solid or fluid in them.

Solids join by min and fluid shapes carve by max of the signed distances. That is exact in the fluid round unions of
solids; elsewhere it is a lower bound that is 0 on every surface, also where two shapes of a kind touch and there is no
wall. There `nearest_wall` looks for the nearest point of a wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from ..domain.row_threads import over_rows, threads_here
from .faces import block_distance
from .nearest_ball import BallLists, put_nearest

ROUND_OFF = 1e-12  # of the largest side of the box: points closer than this to a wall are on it
BALL, BLOCK, CYLINDER, HALF_SPACE = range(4)  # convex pieces of bodies, see `Region.pieces`


class ShapeError(ValueError):
    """A shape or a file of shapes that cannot be used: what is wrong and what to do."""


class Region(Protocol):
    """A region of space; periodic images are taken along the axes where `period` is finite."""

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the surface of the region and its images of period (dim,)."""
        ...

    def pieces(self, period: np.ndarray) -> np.ndarray:
        """(m, 8) convex pieces: kind, centre (3,), size (3,), axis; z is 0 in 2D. Size: of a ball its radius;
        of a block its half sides; of a cylinder radius and half length; of a half-space its unit normal."""
        ...


@dataclass(frozen=True)
class Sphere:
    """Ball of a centre (dim,) and a radius; a disk in 2D."""

    centre: Sequence[float]
    radius: float

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the nearest image of the surface, m, < 0 inside; exact."""
        return (
            np.linalg.norm(nearest_image(x - np.asarray(self.centre, float), period), axis=1) - self.radius
        )

    def pieces(self, period: np.ndarray) -> np.ndarray:
        """A ball, (1, 8): see `Region.pieces`."""
        return _pieces(BALL, [self.centre], [[self.radius]])


Disk = Sphere


@dataclass(frozen=True, eq=False)
class Spheres:
    """Many balls, overlapping or not: centres (m, dim), radii a number or (m,).

    columns: how the columns of the file were understood, where they are not in m or not in the usual order.
    """

    centres: np.ndarray
    radii: np.ndarray | float
    columns: str = ""
    _near: dict[bytes, BallLists] = field(default_factory=dict, repr=False)
    _trees: dict = field(default_factory=dict, repr=False)

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the nearest surface of a ball or image, m, < 0 inside; inside balls that
        overlap a lower bound of the depth."""
        d, x = np.full(len(x), np.inf), np.ascontiguousarray(_into_box(x, period))
        over_rows(put_nearest, len(x), x, self._lists(period), d)
        far = np.flatnonzero(np.isnan(d))
        if len(far):
            least = np.full(len(far), np.inf)
            for tree, radii in self._classes(period):
                _lower_to_nearest(least, x[far], tree, radii)
            d[far] = least
        return d

    def pieces(self, period: np.ndarray) -> np.ndarray:
        """A ball each, (m, 8): see `Region.pieces`."""
        centres = np.atleast_2d(np.asarray(self.centres, float))
        return _pieces(BALL, centres, np.broadcast_to(np.asarray(self.radii, float), len(centres))[:, None])

    def _lists(self, period: np.ndarray) -> BallLists:
        """Lists of the balls that may be nearest; made once per box."""
        key = period.tobytes()
        if key not in self._near:
            centres = np.atleast_2d(np.asarray(self.centres, float))
            radii = np.broadcast_to(np.asarray(self.radii, float), len(centres))
            self._near[key] = BallLists.of(_into_box(centres, period), radii, period)
        return self._near[key]

    def _classes(self, period: np.ndarray) -> list[tuple[cKDTree, np.ndarray]]:
        """Search trees of balls of like radius, the largest first; built once per box."""
        key = period.tobytes()
        if key not in self._trees:
            centres = np.atleast_2d(np.asarray(self.centres, float))
            radii = np.broadcast_to(np.asarray(self.radii, float), len(centres))
            boxsize = np.where(np.isfinite(period), period, 0.0)
            groups = _radius_classes(radii)
            self._trees[key] = [
                (cKDTree(_into_box(centres[g], period), boxsize=boxsize), radii[g]) for g in groups
            ]
        return self._trees[key]


@dataclass(frozen=True)
class Box:
    """Block between two corners (dim,)."""

    lower: Sequence[float]
    upper: Sequence[float]

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the nearest image of the surface, m, < 0 inside; exact. An axis along which
        the box fills the period has no faces."""
        lower, upper = np.asarray(self.lower, float), np.asarray(self.upper, float)
        q = np.abs(nearest_image(x - (lower + upper) / 2, period)) - (upper - lower) / 2
        return block_distance(np.where(upper - lower >= period * (1 - ROUND_OFF), -np.inf, q))

    def pieces(self, period: np.ndarray) -> np.ndarray:
        """A block, (1, 8), infinite along axes that it fills: see `Region.pieces`."""
        lower, upper = np.asarray(self.lower, float), np.asarray(self.upper, float)
        half = np.where(upper - lower >= period * (1 - ROUND_OFF), np.inf, (upper - lower) / 2)
        return _pieces(BLOCK, [(lower + upper) / 2], [[*half, np.inf][:3]])


@dataclass(frozen=True)
class Cylinder:
    """Cylinder along an axis (0 x, 1 y, 2 z) through a centre (3,) (its entry along the axis is ignored),
    infinite, or between ends = (lower, upper) along the axis."""

    axis: int
    centre: Sequence[float]
    radius: float
    ends: tuple[float, float] | None = None

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, 3) to the nearest image of the surface, m, < 0 inside; exact."""
        across = [a for a in range(x.shape[1]) if a != self.axis]
        centre = np.asarray(self.centre, float)
        radial = (
            np.linalg.norm(nearest_image(x[:, across] - centre[across], period[across]), axis=1)
            - self.radius
        )
        if self.ends is None or self.ends[1] - self.ends[0] >= period[self.axis] * (1 - ROUND_OFF):
            return radial
        middle, half = (self.ends[0] + self.ends[1]) / 2, (self.ends[1] - self.ends[0]) / 2
        axial = np.abs(nearest_image(x[:, [self.axis]] - middle, period[[self.axis]]))[:, 0] - half
        return block_distance(np.stack([radial, axial], axis=1))

    def pieces(self, period: np.ndarray) -> np.ndarray:
        """A cylinder, (1, 8), of infinite half length without ends: see `Region.pieces`."""
        centre, half = np.array(self.centre, float), np.inf
        if self.ends is not None and self.ends[1] - self.ends[0] < period[self.axis] * (1 - ROUND_OFF):
            centre[self.axis], half = (self.ends[0] + self.ends[1]) / 2, (self.ends[1] - self.ends[0]) / 2
        return _pieces(CYLINDER, [centre], [[self.radius, half]], self.axis)


@dataclass(frozen=True)
class HalfSpace:
    """Everything behind the plane through a point whose normal (any length) points out of the region.

    It has no periodic images: points are wrapped into the box first.
    """

    point: Sequence[float]
    normal: Sequence[float]

    @property
    def unit_normal(self) -> np.ndarray:
        """The normal (dim,) with length one, out of the region."""
        normal = np.asarray(self.normal, float)
        normal = normal / np.abs(normal).max()  # squares of very small and very large numbers are 0 and inf
        return normal / np.linalg.norm(normal)

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the plane, m, < 0 behind it; `period` does not matter."""
        return (x - np.asarray(self.point, float)) @ self.unit_normal

    def pieces(self, period: np.ndarray) -> np.ndarray:
        """A half-space, (1, 8): see `Region.pieces`."""
        return _pieces(HALF_SPACE, [self.point], [self.unit_normal])


@dataclass(frozen=True)
class Shape:
    """A body and what fills it: phase -1 for solid, else index of a fluid; `outside` fills its complement.
    microporous: index of the rock that the fluid seeps through, -1 for clear fluid."""

    body: Region
    phase: int = -1
    outside: bool = False
    velocity: Sequence[float] | np.ndarray | None = None  # of the wall, m/s; None: at rest
    slip_length: float | None = None  # m; None: that of the geometry
    angular_velocity: float | None = None  # rad/s of a cylinder about its axis, of a disk about its centre
    microporous: int = -1

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the surface, m, < 0 in what the shape fills; period (dim,): m."""
        d = self.body.signed_distance(x, period)
        return -d if self.outside else d


def _pieces(kind: int, centres: Sequence[Sequence[float] | np.ndarray] | np.ndarray,
            sizes: Sequence[Sequence[float] | np.ndarray] | np.ndarray, axis: int = 0) -> np.ndarray:
    """Rows of `Region.pieces`; missing entries of centres and sizes are 0."""
    centres, sizes = np.asarray(centres, float), np.asarray(sizes, float)
    rows = np.zeros((len(centres), 8))
    rows[:, 0], rows[:, 7] = kind, axis
    rows[:, 1 : 1 + centres.shape[1]] = centres
    rows[:, 4 : 4 + sizes.shape[1]] = sizes
    return rows


TOUCH = 0.01  # of the smaller radius: balls of a packing that overlap by less are taken to touch


def count_overlaps(centres: np.ndarray, radii: np.ndarray, period: np.ndarray) -> tuple[int, int, float]:
    """(pairs that overlap, balls that repeat another, largest overlap over the smaller radius)."""
    x = _into_box(centres, period)
    order = np.argsort(-radii, kind="stable")
    x, radii = x[order], radii[order]
    tree = cKDTree(x, boxsize=np.where(np.isfinite(period), period, 0.0))
    pairs, most, repeats = 0, 0.0, np.zeros(len(x), dtype=bool)
    for first in range(0, len(x), 10_000):
        part = slice(first, first + 10_000)
        # of two balls that meet the smaller one has its centre within twice the radius of the larger one
        for i, near in enumerate(tree.query_ball_point(x[part], 2.0 * radii[part]), first):
            j = np.array([k for k in near if k > i], dtype=np.int64)
            if not len(j):
                continue
            apart = np.linalg.norm(nearest_image(x[j] - x[i], period), axis=1)
            same = (apart <= 1e-9 * radii[i]) & (radii[j] >= radii[i] * (1 - 1e-9))
            repeats[j[same]] = True
            once = ~(same | repeats[j] | repeats[i])
            depth = (radii[i] + radii[j] - apart)[once] / radii[j][once]
            pairs += int((depth > TOUCH).sum())
            most = max(most, float(depth.max(initial=0.0)))
    return pairs, int(repeats.sum()), min(most, 2.0)


def nearest_image(offset: np.ndarray, period: np.ndarray) -> np.ndarray:
    """Offsets (n, k) replaced along finite periods by the nearest periodic image."""
    finite = np.isfinite(period)
    if not finite.any():
        return offset
    offset = offset.copy()
    offset[:, finite] -= np.round(offset[:, finite] / period[finite]) * period[finite]
    return offset


def _into_box(x: np.ndarray, period: np.ndarray) -> np.ndarray:
    """Points moved into [0, period) along finite periods, as cKDTree wants them (mod may round to period)."""
    finite = np.isfinite(period)
    if not finite.any():
        return x
    x = x.copy()
    x[:, finite] = np.mod(x[:, finite], period[finite])
    x[:, finite] = np.where(x[:, finite] >= period[finite], 0.0, x[:, finite])
    return x


def _radius_classes(radii: np.ndarray) -> list[np.ndarray]:
    """Indices of balls grouped so that radii of a group are equal, or else within 20 %; largest first."""
    values = np.unique(radii)
    if len(values) <= 8:
        return [np.flatnonzero(radii == v) for v in values[::-1]]
    octave = np.floor(np.log(radii / radii.max()) / np.log(0.8))
    return [np.flatnonzero(octave == o) for o in np.unique(octave)]


def _lower_to_nearest(d: np.ndarray, x: np.ndarray, tree: cKDTree, radii: np.ndarray) -> None:
    """Lower d (n,) in place to the signed distance of the nearest ball of a tree.

    The nearest centre is the nearest surface for equal radii. Otherwise more centres are asked for until the
    next one is too far even for the largest ball.
    """
    todo, k = np.arange(len(x)), 1
    largest = radii.max()
    equal = radii.min() == largest
    while len(todo):
        k = min(k, len(radii))
        distance, index = tree.query(x[todo], k=[*range(1, k + 1)], workers=threads_here())
        d[todo] = np.minimum(d[todo], (distance - radii[index]).min(axis=1))
        if equal or k == len(radii):
            return
        todo, k = todo[distance[:, -1] - largest < d[todo]], 4 * k


VECTORS = ("centre", "lower", "upper", "point", "normal")  # fields of bodies that are points or directions


def check_body(body: Region, dim: int, name: str) -> None:
    """Raises ShapeError, with what to do, where an entry of a body has the wrong length or a size is not positive."""
    for key, value in vars(body).items():
        if key in VECTORS and (np.shape(value) != (dim,) or not np.isfinite(np.asarray(value, float)).all()):
            raise ShapeError(f"{name}: {key} {value!r} must be {dim} finite numbers")
    if isinstance(body, Sphere | Cylinder) and not 0 < body.radius < np.inf:
        raise ShapeError(f"{name}: radius {body.radius} must be positive")
    if isinstance(body, Box) and not (np.asarray(body.upper) > np.asarray(body.lower)).all():
        raise ShapeError(f"{name}: upper corner {body.upper} must lie above lower corner {body.lower}")
    if isinstance(body, HalfSpace) and not np.any(body.normal):
        raise ShapeError(f"{name}: normal must not be zero")
    if isinstance(body, Cylinder) and not (dim == 3 and 0 <= body.axis < 3):
        raise ShapeError(f"{name}: a cylinder needs three dimensions and axis x, y or z; in 2D use a disk")
    if isinstance(body, Cylinder) and body.ends is not None and not body.ends[0] < body.ends[1]:
        raise ShapeError(f"{name}: ends {body.ends} must be in ascending order")
    if isinstance(body, Spheres):
        centres, radii = np.asarray(body.centres, float), np.asarray(body.radii, float)
        if centres.ndim != 2 or centres.shape[1] != dim or not len(centres) or not np.isfinite(centres).all():
            raise ShapeError(
                f"{name}: centres of shape {centres.shape} must be finite and of shape (m, {dim}), m > 0"
            )
        if radii.shape not in ((), (len(centres),)) or not np.isfinite(radii).all() or not (radii > 0).all():
            raise ShapeError(f"{name}: radii must be positive, one number or one per centre")
