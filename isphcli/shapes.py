"""Scenes of spheres, boxes, cylinders and half-spaces with exact signed distances.

A `ShapeGeometry` is a box filled with one fluid and an ordered list of `Shape`, later ones on top of earlier
ones. Solids join by min and fluid shapes carve by max of the signed distances (design section 5): exact in
the fluid round unions of solids.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numba import get_num_threads
from scipy.spatial import cKDTree

from .geometry import block_distance, face_distance, face_walls

ROUND_OFF = 1e-12  # of the largest side of the box: points closer than this to a wall are on it


class ShapeError(ValueError):
    """A shape or a file of shapes that cannot be used: what is wrong and what to do."""


class Body(Protocol):
    """A region of space; periodic images are taken along the axes where `period` is finite."""

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        """(n,) distance of x (n, dim) to the surface of the region and its images of period (dim,)."""
        ...


@dataclass(frozen=True)
class Sphere:
    """Ball of a centre (dim,) and a radius; a disk in 2D."""

    centre: Sequence[float]
    radius: float

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        return (
            np.linalg.norm(_nearest_image(x - np.asarray(self.centre, float), period), axis=1) - self.radius
        )


Disk = Sphere


@dataclass(frozen=True, eq=False)
class Spheres:
    """Many balls, overlapping or not: centres (m, dim), radii a number or (m,)."""

    centres: np.ndarray
    radii: np.ndarray | float
    _trees: dict = field(default_factory=dict, repr=False)

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        d = np.full(len(x), np.inf)
        for tree, radii in self._classes(period):
            _lower_to_nearest(d, _into_box(x, period), tree, radii)
        return d

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
        lower, upper = np.asarray(self.lower, float), np.asarray(self.upper, float)
        q = np.abs(_nearest_image(x - (lower + upper) / 2, period)) - (upper - lower) / 2
        return block_distance(np.where(upper - lower >= period * (1 - ROUND_OFF), -np.inf, q))


@dataclass(frozen=True)
class Cylinder:
    """Cylinder along an axis (0 x, 1 y, 2 z) through a centre (3,) (its entry along the axis is ignored),
    infinite, or between ends = (lower, upper) along the axis."""

    axis: int
    centre: Sequence[float]
    radius: float
    ends: tuple[float, float] | None = None

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        across = [a for a in range(x.shape[1]) if a != self.axis]
        centre = np.asarray(self.centre, float)
        radial = (
            np.linalg.norm(_nearest_image(x[:, across] - centre[across], period[across]), axis=1)
            - self.radius
        )
        if self.ends is None or self.ends[1] - self.ends[0] >= period[self.axis] * (1 - ROUND_OFF):
            return radial
        middle, half = (self.ends[0] + self.ends[1]) / 2, (self.ends[1] - self.ends[0]) / 2
        axial = np.abs(_nearest_image(x[:, [self.axis]] - middle, period[[self.axis]]))[:, 0] - half
        return block_distance(np.stack([radial, axial], axis=1))


@dataclass(frozen=True)
class HalfSpace:
    """Everything behind the plane through a point whose normal (any length) points out of the region.

    It has no periodic images: points are wrapped into the box first.
    """

    point: Sequence[float]
    normal: Sequence[float]

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        normal = np.asarray(self.normal, float)
        return (x - np.asarray(self.point, float)) @ (normal / np.linalg.norm(normal))


@dataclass(frozen=True)
class Shape:
    """A body and what fills it: phase -1 for solid, else index of a fluid; `outside` fills its complement."""

    body: Body
    phase: int = -1
    outside: bool = False
    velocity: Sequence[float] | None = None  # of the wall, m/s; None: at rest
    slip_length: float | None = None  # m; None: that of the geometry

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        d = self.body.signed_distance(x, period)
        return -d if self.outside else d


class ShapeGeometry:
    """Box of fluid with shapes in it; implements `geometry.Geometry`.

    lower, upper: (dim,) corners, m; periodic: per axis, the faces of the other axes are walls;
    fluid: index of the fluid that fills the box; shapes: later ones lie on top of earlier ones.
    slip_length: m, of walls that do not state their own; face_velocity, face_slip: see `geometry.face_walls`.
    Walls are numbered 0 (at rest), 1 + 2 axis + side (faces), 1 + 2 dim + k (shape k).
    """

    def __init__(
        self,
        lower: Sequence[float] | np.ndarray,
        upper: Sequence[float] | np.ndarray,
        periodic: Sequence[bool],
        fluid: int = 0,
        shapes: Sequence[Shape] = (),
        slip_length: float = 0.0,
        face_velocity: dict | None = None,
        face_slip: dict | None = None,
    ):
        self.lower = np.array(lower, dtype=float)
        self.upper = np.array(upper, dtype=float)
        self.dim = len(self.lower)
        self.periodic = tuple(bool(p) for p in periodic)
        self.fluid = int(fluid)
        self.shapes = tuple(shapes)
        if self.dim not in (2, 3) or len(self.upper) != self.dim or len(self.periodic) != self.dim:
            raise ShapeError("lower, upper and periodic need two entries each, or three each")
        if not (
            np.isfinite(self.lower).all()
            and np.isfinite(self.upper).all()
            and (self.upper > self.lower).all()
        ):
            raise ShapeError(f"box from {self.lower} to {self.upper}: upper must be finite and above lower")
        self.period = np.where(self.periodic, self.upper - self.lower, np.inf)
        self.round_off = ROUND_OFF * float((self.upper - self.lower).max())
        for k, shape in enumerate(self.shapes):
            _check_body(shape.body, self.dim, f"shape {k + 1}")
        self.has_solid = not all(self.periodic) or any(s.phase < 0 for s in self.shapes)
        self.wall_velocity, self.slip_length = face_walls(
            self.dim, slip_length, face_velocity, face_slip, len(self.shapes)
        )
        for k, shape in enumerate(self.shapes):
            self.wall_velocity[1 + 2 * self.dim + k] = 0.0 if shape.velocity is None else shape.velocity
            if shape.slip_length is not None:
                self.slip_length[1 + 2 * self.dim + k] = shape.slip_length

    def phase(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: -1 in a solid or on its surface, otherwise the index of the fluid."""
        x = self._wrapped(x)
        phase = np.full(len(x), self.fluid, dtype=np.int8)
        for shape in self.shapes:
            margin = self.round_off if shape.phase < 0 else -self.round_off
            phase[shape.signed_distance(x, self.period) <= margin] = shape.phase
        phase[face_distance(x, self.lower, self.upper, self.periodic)[0] <= self.round_off] = -1
        return phase

    def distance(self, x: np.ndarray) -> np.ndarray:
        """(n,) signed distance to the wall, m; exact in the fluid round unions of solids."""
        return self._nearest(x)[0]

    def wall(self, x: np.ndarray) -> np.ndarray:
        """(n,) int32 index of the face or shape whose surface gives `distance`; on a crossing point it is the
        wall that is met."""
        return self._nearest(x)[1]

    def crossing(
        self, xi: np.ndarray, xj: np.ndarray, di: np.ndarray | None = None, dj: np.ndarray | None = None
    ) -> np.ndarray:
        """(n,) fraction t in (0, 1] from fluid point xi to xj at the first wall; 1.0 where none is met.

        di, dj: `distance` of the points where the caller has it already. A distance is 1-Lipschitz, so a
        segment with di + dj >= |xi - xj| is free; the others are halved until free, blocked or short.
        """
        xi, xj = np.asarray(xi, float), np.asarray(xj, float)
        t = np.ones(len(xi))
        if not self.has_solid or not len(xi):
            return t
        di = self.distance(xi) if di is None else np.asarray(di, float)
        dj = self.distance(xj) if dj is None else np.asarray(dj, float)
        r = np.linalg.norm(xj - xi, axis=1)
        near = np.flatnonzero((di + dj < r) | (dj <= self.round_off))
        t[near] = self._first_crossing(xi[near], xj[near], di[near], dj[near], r[near])
        return t

    def _wrapped(self, x: np.ndarray) -> np.ndarray:
        x = np.array(x, dtype=float, ndmin=2)
        for a in range(self.dim):
            if self.periodic[a]:
                x[:, a] = self.lower[a] + np.mod(x[:, a] - self.lower[a], self.period[a])
        return x

    def _nearest(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance and index of the wall that gives it."""
        x = self._wrapped(x)
        d = np.full(len(x), np.inf)
        wall = np.zeros(len(x), dtype=np.int32)
        for k, shape in enumerate(self.shapes):
            if shape.phase < 0:
                sd = shape.signed_distance(x, self.period)
                closer = sd < d
            elif any(s.phase < 0 for s in self.shapes[:k]):
                sd = -shape.signed_distance(x, self.period)
                closer = sd > d
            else:
                continue
            d[closer] = sd[closer]
            wall[closer] = 1 + 2 * self.dim + k
        face, face_wall = face_distance(x, self.lower, self.upper, self.periodic)
        closer = face < d
        d[closer] = face[closer]
        wall[closer] = face_wall[closer]
        return d, wall

    def _first_crossing(
        self, xi: np.ndarray, xj: np.ndarray, di: np.ndarray, dj: np.ndarray, r: np.ndarray, depth: int = 5
    ) -> np.ndarray:
        """First crossings of segments that may be blocked: bracket by halving, then a guarded secant."""
        n = len(r)
        t_solid = np.where(dj <= self.round_off, 1.0, np.inf)  # first sample known to be solid
        d_solid = dj.copy()
        samples = [(np.arange(n), np.zeros(n), di)]
        pair, ta, tb, da, db = np.arange(n), np.zeros(n), np.ones(n), di, dj
        for level in range(depth):
            length = (tb - ta) * r[pair]
            open_ = np.where(db > self.round_off, da + db < length, (da - db < 0.99 * length) & (level < 2))
            keep = open_ & (ta < t_solid[pair])
            pair, ta, tb, da, db = pair[keep], ta[keep], tb[keep], da[keep], db[keep]
            if not len(pair):
                break
            tm = (ta + tb) / 2
            dm = self.distance(xi[pair] + tm[:, None] * (xj - xi)[pair])
            solid = dm <= self.round_off
            for k in np.flatnonzero(solid & (tm < t_solid[pair])):  # few
                if tm[k] < t_solid[pair[k]]:
                    t_solid[pair[k]], d_solid[pair[k]] = tm[k], dm[k]
            samples.append((pair[~solid], tm[~solid], dm[~solid]))
            right = ~solid
            pair, ta, tb, da, db = (
                np.concatenate([pair, pair[right]]),
                np.concatenate([ta, tm[right]]),
                np.concatenate([tm, tb[right]]),
                np.concatenate([da, dm[right]]),
                np.concatenate([dm, db[right]]),
            )
        t_fluid, d_fluid = _last_before(samples, t_solid, n)
        t = np.ones(n)
        hit = np.flatnonzero(np.isfinite(t_solid))
        t[hit] = self._root(xi[hit], (xj - xi)[hit], t_fluid[hit], t_solid[hit], d_fluid[hit], d_solid[hit])
        return np.clip(t, ROUND_OFF, 1.0)

    def _root(
        self, x: np.ndarray, dx: np.ndarray, a: np.ndarray, b: np.ndarray, fa: np.ndarray, fb: np.ndarray
    ) -> np.ndarray:
        """Zero of the distance along x + t dx between a (fluid) and b (solid): Illinois, at most 60 steps."""
        a, b, fa, fb = a.copy(), b.copy(), np.maximum(fa, 0.0), np.minimum(fb, 0.0)
        gap = fa - fb
        t = np.where(gap > 0, (a * -fb + b * fa) / np.where(gap > 0, gap, 1.0), b)
        active = np.flatnonzero((fa > self.round_off) & (fb < -self.round_off))
        last = np.zeros(len(t), dtype=np.int8)
        for step in range(60):
            if not len(active):
                break
            k = active
            if step:
                t[k] = (a[k] * -fb[k] + b[k] * fa[k]) / (fa[k] - fb[k])
            if step % 8 == 7:
                t[k] = (a[k] + b[k]) / 2
            f = self.distance(x[k] + t[k, None] * dx[k])
            positive = f > 0
            up, down = k[positive], k[~positive]
            fb[up[last[up] == 1]] /= 2
            fa[down[last[down] == -1]] /= 2
            a[up], fa[up], last[up] = t[up], f[positive], 1
            b[down], fb[down], last[down] = t[down], f[~positive], -1
            active = k[np.abs(f) > self.round_off]
        return t


def read_spheres(
    path: str | Path, dim: int = 3, radius: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (m, dim) and radii (m,) of a CSV file with columns x, y(, z)[, radius].

    A header line and lines starting with # are skipped. radius is used where the file has no such column.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ShapeError(f"{path}: cannot be read as text ({error}); give rows of x,y,z[,radius]") from None
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        cells = [c.strip() for c in line.replace(";", ",").split(",")]
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            values = [float(c) for c in cells]
        except ValueError:
            if not rows and not any(_is_number(c) for c in cells):
                continue
            raise ShapeError(
                f"{path}:{number}: '{line.strip()[:60]}' is not a row of numbers; fix it"
            ) from None
        if len(values) not in (dim, dim + 1) or (rows and len(values) != len(rows[0])):
            want = f"{dim} or {dim + 1}" if not rows else str(len(rows[0]))
            raise ShapeError(f"{path}:{number}: {len(values)} columns where {want} are expected")
        if not np.isfinite(values).all():
            raise ShapeError(f"{path}:{number}: a value is not finite; remove the row or correct it")
        rows.append(values)
    if not rows:
        raise ShapeError(f"{path}: holds no sphere; give rows of x,y,z[,radius]")
    table = np.array(rows)
    if table.shape[1] == dim and radius is None:
        raise ShapeError(f"{path}: has no column of radii; add one or give the key 'radius'")
    radii = table[:, dim] if table.shape[1] > dim else np.full(len(table), float(radius))  # type: ignore[arg-type]
    if (radii <= 0).any():
        raise ShapeError(f"{path}: radius {radii.min()} is not positive")
    return np.ascontiguousarray(table[:, :dim]), radii


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _nearest_image(offset: np.ndarray, period: np.ndarray) -> np.ndarray:
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
        distance, index = tree.query(x[todo], k=[*range(1, k + 1)], workers=get_num_threads())
        d[todo] = np.minimum(d[todo], (distance - radii[index]).min(axis=1))
        if equal or k == len(radii):
            return
        todo, k = todo[distance[:, -1] - largest < d[todo]], 4 * k


def _last_before(samples: list, t_solid: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Of fluid samples (pair, t, d), the last before the first solid one of each pair: (t (n,), d (n,))."""
    pair, t, d = (np.concatenate(column) for column in zip(*samples))
    keep = t < t_solid[pair]
    pair, t, d = pair[keep], t[keep], d[keep]
    order = np.lexsort((t, pair))
    t_fluid, d_fluid = np.zeros(n), np.zeros(n)
    t_fluid[pair[order]], d_fluid[pair[order]] = t[order], d[order]  # the last write of a pair stays
    return t_fluid, d_fluid


def _check_body(body: Body, dim: int, name: str) -> None:
    """Sizes and positivity of a body, with a message that says what to do."""
    vectors = {
        k: getattr(body, k) for k in ("centre", "lower", "upper", "point", "normal") if hasattr(body, k)
    }
    for key, value in vectors.items():
        if np.shape(value) != (dim,) or not np.isfinite(np.asarray(value, float)).all():
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
