"""Scenes of spheres, boxes, cylinders and half-spaces with exact signed distances.

A `ShapeGeometry` is a box filled with one fluid and an ordered list of `Shape`, later ones on top of earlier
ones. Solids join by min and fluid shapes carve by max of the signed distances. That is exact in
the fluid round unions of solids; elsewhere it is a lower bound that is 0 on every surface, also where two shapes of
a kind touch and there is no wall. There `_walls_near` looks for the nearest point of a wall.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numba import get_num_threads, njit, prange
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from .geometry import block_distance, face_distance, face_walls
from .halo import build_halo

ROUND_OFF = 1e-12  # of the largest side of the box: points closer than this to a wall are on it
BALL, BLOCK, CYLINDER, HALF_SPACE = range(4)  # convex pieces of bodies, see `Body.pieces`
CELLS_A_PIECE = 8  # cells of the grid of pieces: beads then meet about three cells each way
PLANE, ROUND = range(2)  # surfaces of pieces, see `_surfaces_near`
MOST_SURFACES = 48  # nearest ones on which a wall is looked for
PROBE = 1e-9  # of the largest side of the box: how far from a point its surroundings are looked at


class ShapeError(ValueError):
    """A shape or a file of shapes that cannot be used: what is wrong and what to do."""


class Body(Protocol):
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
        return (
            np.linalg.norm(_nearest_image(x - np.asarray(self.centre, float), period), axis=1) - self.radius
        )

    def pieces(self, period: np.ndarray) -> np.ndarray:
        return _pieces(BALL, [self.centre], [[self.radius]])


Disk = Sphere


@dataclass(frozen=True, eq=False)
class Spheres:
    """Many balls, overlapping or not: centres (m, dim), radii a number or (m,).

    columns: how the columns of their file were understood, where that took more than m and the usual order.
    """

    centres: np.ndarray
    radii: np.ndarray | float
    columns: str = ""
    _trees: dict = field(default_factory=dict, repr=False)

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        d = np.full(len(x), np.inf)
        for tree, radii in self._classes(period):
            _lower_to_nearest(d, _into_box(x, period), tree, radii)
        return d

    def pieces(self, period: np.ndarray) -> np.ndarray:
        centres = np.atleast_2d(np.asarray(self.centres, float))
        return _pieces(BALL, centres, np.broadcast_to(np.asarray(self.radii, float), len(centres))[:, None])

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

    def pieces(self, period: np.ndarray) -> np.ndarray:
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

    def pieces(self, period: np.ndarray) -> np.ndarray:
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
        normal = np.asarray(self.normal, float)
        normal = normal / np.abs(normal).max()  # squares of very small and very large numbers are 0 and inf
        return normal / np.linalg.norm(normal)

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        return (x - np.asarray(self.point, float)) @ self.unit_normal

    def pieces(self, period: np.ndarray) -> np.ndarray:
        return _pieces(HALF_SPACE, [self.point], [self.unit_normal])


@dataclass(frozen=True)
class Shape:
    """A body and what fills it: phase -1 for solid, else index of a fluid; `outside` fills its complement."""

    body: Body
    phase: int = -1
    outside: bool = False
    velocity: Sequence[float] | None = None  # of the wall, m/s; None: at rest
    slip_length: float | None = None  # m; None: that of the geometry
    angular_velocity: float | None = None  # rad/s of a cylinder about its axis, of a disk about its centre

    def signed_distance(self, x: np.ndarray, period: np.ndarray) -> np.ndarray:
        d = self.body.signed_distance(x, period)
        return -d if self.outside else d


class ShapeGeometry:
    """Box of fluid with shapes in it; implements `geometry.Geometry`.

    lower, upper: (dim,) corners, m; periodic: per axis, the faces of the other axes are walls;
    fluid: index of the fluid that fills the box; shapes: later ones lie on top of earlier ones.
    slip_length: m, of walls that do not state their own; face_velocity, face_slip: see `geometry.face_walls`.
    Walls are numbered 0 (at rest), 1 + 2 axis + side (faces), 1 + 2 dim + k (shape k).
    Raises ShapeError where a shape or the box cannot be used.
    """

    warnings: tuple[str, ...] = ()
    described: tuple[tuple[str, str], ...] = ()

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
        self.warnings = tuple(_cut_planes(self))
        self._grid: _Grid | None = None  # for `crossing`, when it is first asked
        self.has_solid = self.fluid < 0 or not all(self.periodic) or any(s.phase < 0 for s in self.shapes)
        self.wall_velocity, self.slip_length = face_walls(
            self.dim, slip_length, face_velocity, face_slip, len(self.shapes)
        )
        for k, shape in enumerate(self.shapes):
            self.wall_velocity[1 + 2 * self.dim + k] = 0.0 if shape.velocity is None else shape.velocity
            if shape.slip_length is not None:
                self.slip_length[1 + 2 * self.dim + k] = shape.slip_length
        self.wall_speed = np.linalg.norm(self.wall_velocity, axis=1)
        self.wall_spin: np.ndarray | None = None
        for k, shape in enumerate(self.shapes):
            if shape.angular_velocity:
                self._turn(1 + 2 * self.dim + k, shape, f"shape {k + 1}")

    def _turn(self, wall: int, shape: Shape, name: str) -> None:
        """Let a wall turn: u = u_0 + A (x - centre), A antisymmetric."""
        body, omega = shape.body, shape.angular_velocity
        assert omega is not None
        if not isinstance(body, Cylinder) and not (isinstance(body, Sphere) and self.dim == 2):
            raise ShapeError(f"{name}: only cylinders turn, and disks in 2D")
        # x, y, z in turn: the plane that is turned, in the positive sense about the axis
        plane = [(body.axis + 1) % 3, (body.axis + 2) % 3] if isinstance(body, Cylinder) else [0, 1]
        centre = np.asarray(body.centre, float)
        if (abs(centre - (self.lower + self.upper) / 2) + body.radius > self.period / 2 + self.round_off)[plane].any():
            raise ShapeError(f"{name}: turns, and reaches over a periodic face; move it into the box")
        if self.wall_spin is None:
            self.wall_spin = np.zeros((len(self.wall_velocity), self.dim, self.dim))
        self.wall_spin[wall, plane[0], plane[1]], self.wall_spin[wall, plane[1], plane[0]] = -omega, omega
        self.wall_velocity[wall] -= self.wall_spin[wall] @ centre
        self.wall_speed[wall] += abs(omega) * body.radius

    def phase(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: -1 in a solid or on its surface, otherwise the index of the fluid."""
        x = self._wrapped(x)
        phase = np.full(len(x), self.fluid, dtype=np.int8)
        seam = np.zeros(len(x), dtype=bool)  # on the surface of a fluid shape: a wall only if there is solid beside it
        for shape in self.shapes:
            margin = self.round_off if shape.phase < 0 else -self.round_off
            d = shape.signed_distance(x, self.period)
            phase[d <= margin] = shape.phase
            if shape.phase >= 0:
                seam |= np.abs(d) <= self.round_off
        phase[face_distance(x, self.lower, self.upper, self.periodic)[0] <= self.round_off] = -1
        seam &= phase < 0
        if seam.any():
            beside = _beside(_in_3d(x[seam]), *self._pieces(), self.fluid < 0, PROBE / ROUND_OFF * self.round_off)
            phases = np.array([self.fluid, *(s.phase for s in self.shapes)], dtype=np.int8)
            phase[seam] = np.where(beside < -1, -1, phases[beside + 1])
        return phase

    def distance(self, x: np.ndarray) -> np.ndarray:
        """(n,) signed distance to the wall, m.

        Walls are where fluid meets solid, not where shapes of a kind touch. Exact where the nearest point of the
        wall lies on one surface or on an edge of planes; where it lies on an edge of curved surfaces that has
        several nearest points, never more than the distance to one of them and never less than that to the
        nearest surface of any shape.
        """
        return self._nearest(x)[0]

    def wall(self, x: np.ndarray) -> np.ndarray:
        """(n,) int32 index of the face or shape whose surface gives `distance`; on a crossing point it is the
        wall that is met."""
        return self._nearest(x)[1]

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """(n,) fraction t in (0, 1] from fluid point xi to xj at the first wall; 1.0 where none is met.

        Exact: the chords of the segment in the bodies cut it into parts, and the first part whose topmost
        shape is solid begins at t.
        """
        xi, xj = np.asarray(xi, float), np.asarray(xj, float)
        if not self.has_solid or not len(xi):
            return np.ones(len(xi))
        return _crossings(xi, xj, *self._pieces(), self.fluid < 0, self.round_off, get_num_threads())

    def _pieces(self) -> _Grid:
        if self._grid is None:
            self._grid = _Grid.of(self)
        return self._grid

    def _wrapped(self, x: np.ndarray) -> np.ndarray:
        x = np.array(x, dtype=float, ndmin=2)
        for a in range(self.dim):
            if self.periodic[a]:
                x[:, a] = self.lower[a] + np.mod(x[:, a] - self.lower[a], self.period[a])
        return x

    def _nearest(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance and index of the wall that gives it."""
        x = self._wrapped(x)
        d = np.full(len(x), np.inf if self.fluid >= 0 else -np.inf)
        wall = np.zeros(len(x), dtype=np.int32)
        for k, shape in enumerate(self.shapes):
            if shape.phase < 0:
                sd = shape.signed_distance(x, self.period)
                closer = sd < d
            elif self.fluid < 0 or any(s.phase < 0 for s in self.shapes[:k]):
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
        # beside fluid, faces are walls, and so are solids that no fluid shape lies on
        bare = np.logical_and.accumulate([s.phase < 0 for s in self.shapes[::-1]])[::-1]
        is_wall = np.concatenate([np.ones(1 + 2 * self.dim, dtype=bool), bare])
        ask = np.flatnonzero(np.isfinite(d) & ((d <= self.round_off) | ~is_wall[wall]))
        if len(ask) and self.shapes:
            d[ask], wall[ask] = _walls_near(
                _in_3d(x[ask]), d[ask], wall[ask], self.dim, *self._pieces(), self.fluid < 0,
                PROBE / ROUND_OFF * self.round_off, get_num_threads(),
            )
        return d, wall


class _Grid(NamedTuple):
    """Convex pieces of a scene and their images, listed by the cells of a grid over the box; axes x, y, z.

    lower, edge (3,): of cells, m; counts, around (3,): cells and periodicity; start, entry: pieces of each
    cell; piece (m, 8): see `Body.pieces`; shape (m,): the shape each is of; solid, outside, sure: of each
    shape, sure: what is in its pieces is solid whatever the other shapes.
    """

    lower: np.ndarray
    edge: np.ndarray
    counts: np.ndarray
    around: np.ndarray
    start: np.ndarray
    entry: np.ndarray
    piece: np.ndarray
    shape: np.ndarray
    solid: np.ndarray
    outside: np.ndarray
    sure: np.ndarray

    @classmethod
    def of(cls, geometry: ShapeGeometry) -> _Grid:
        lower, upper = np.zeros((2, 3))
        upper[:] = 2 * geometry.round_off  # the layer of a 2D scene
        lower[: geometry.dim], upper[: geometry.dim] = geometry.lower, geometry.upper
        lower[geometry.dim :] = -upper[geometry.dim :]
        around = np.array([*geometry.periodic, False][:3])
        of_shape = [s.body.pieces(geometry.period) for s in geometry.shapes]
        piece = np.concatenate([np.zeros((0, 8)), *of_shape])
        shape = np.repeat(np.arange(len(of_shape)), [len(p) for p in of_shape])
        piece, shape = _images(piece, shape, lower, upper, around)
        size = upper - lower
        edge = (size[: geometry.dim].prod() / (CELLS_A_PIECE * max(len(piece), 1))) ** (1 / geometry.dim)
        counts = np.clip(np.round(size / edge), 1, 500).astype(np.int64)
        counts[geometry.dim :] = 1
        edge = size / counts
        solid = np.array([s.phase < 0 for s in geometry.shapes], dtype=np.bool_)
        outside = np.array([s.outside for s in geometry.shapes], dtype=np.bool_)
        sure = solid & ~outside & np.logical_and.accumulate(solid[::-1])[::-1]
        start, entry = _fill_cells(piece, _extent(piece), lower, edge, counts)
        return cls(lower, edge, counts, around, start, entry, piece, shape, solid, outside, sure)


def _pieces(kind: int, centres, sizes, axis: int = 0) -> np.ndarray:
    """Rows of `Body.pieces`; what is missing of centres and sizes is 0."""
    centres, sizes = np.asarray(centres, float), np.asarray(sizes, float)
    rows = np.zeros((len(centres), 8))
    rows[:, 0], rows[:, 7] = kind, axis
    rows[:, 1 : 1 + centres.shape[1]] = centres
    rows[:, 4 : 4 + sizes.shape[1]] = sizes
    return rows


def _extent(piece: np.ndarray) -> np.ndarray:
    """Half sides (m, 3) of the blocks round the pieces."""
    extent = np.full((len(piece), 3), np.inf)
    kind, axis = piece[:, 0].astype(int), piece[:, 7].astype(int)
    extent[kind == BALL] = piece[kind == BALL, 4:5]
    extent[kind == BLOCK] = piece[kind == BLOCK, 4:7]
    tube = np.flatnonzero(kind == CYLINDER)
    extent[tube] = piece[tube, 4:5]
    extent[tube, axis[tube]] = piece[tube, 5]
    return extent


def _images(
    piece: np.ndarray, shape: np.ndarray, lower: np.ndarray, upper: np.ndarray, around: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pieces with their periodic images, as far as they reach into the box, and their shapes."""
    size, extent = upper - lower, _extent(piece)
    piece = piece.copy()
    moves = np.isfinite(extent) & around
    centre = piece[:, 1:4]
    centre[:] = np.where(moves, lower + np.mod(centre - lower, size), centre)
    reach = np.ceil(np.max(np.where(moves, extent, 0.0), axis=0, initial=0.0) / size).astype(int)
    found, owner = [np.zeros((0, 8))], [np.zeros(0, dtype=np.int64)]
    for shift in itertools.product(*(range(-r, r + 1) for r in reach)):
        at = centre + np.array(shift) * size
        slack = extent + ROUND_OFF * size
        keep = ((at + slack >= lower) & (at - slack <= upper) | ~around).all(axis=1)
        keep &= (moves | (np.array(shift) == 0)).all(axis=1)
        found.append(np.column_stack([piece[keep, 0], at[keep], piece[keep, 4:]]))
        owner.append(shape[keep])
    return np.concatenate(found), np.concatenate(owner)


@njit(cache=True)
def _fill_cells(piece, extent, lower, edge, counts):
    """Pieces of each cell: entry[start[c] : start[c + 1]], c = (z ny + y) nx + x."""
    cells = counts[0] * counts[1] * counts[2]
    start = np.zeros(cells + 1, np.int64)
    entry = np.zeros(0, np.int64)
    first, last = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for counting in (True, False):
        for p in range(len(piece)):
            for a in range(3):
                slack = extent[p, a] * (1.0 + 1e-9) + 1e-9 * edge[a]
                low = (piece[p, 1 + a] - slack - lower[a]) / edge[a]
                high = (piece[p, 1 + a] + slack - lower[a]) / edge[a]
                first[a] = int(np.floor(min(max(low, 0.0), counts[a] + 0.0)))
                last[a] = int(np.floor(min(max(high, -1.0), counts[a] - 1.0)))
            for z in range(first[2], last[2] + 1):
                for y in range(first[1], last[1] + 1):
                    for x in range(first[0], last[0] + 1):
                        if piece[p, 0] == BALL:
                            gap = 0.0
                            for a in range(3):
                                low = lower[a] + (x if a == 0 else y if a == 1 else z) * edge[a]
                                away = max(low - piece[p, 1 + a], piece[p, 1 + a] - low - edge[a], 0.0)
                                gap += away * away
                            if np.sqrt(gap) > extent[p, 0] * (1.0 + 1e-9) + 1e-9 * edge[0]:
                                continue
                        cell = (z * counts[1] + y) * counts[0] + x
                        if counting:
                            start[cell + 1] += 1
                        else:
                            entry[start[cell]] = p
                            start[cell] += 1
        if counting:
            start = np.cumsum(start)
            entry = np.zeros(start[-1], np.int64)
    start[1:] = start[:-1].copy()
    start[0] = 0
    return start, entry


@njit(cache=True, parallel=True)
def _crossings(
    xi, xj, lower, edge, counts, around, start, entry, piece, shape, solid, outside, sure,
    filled, round_off, chunks,
):
    n, dim = xi.shape
    t = np.empty(n)
    for chunk in prange(chunks):
        x, dx = np.zeros(3), np.zeros(3)
        walk = np.zeros((3, 3), np.int64)  # cell, step, steps left of each axis
        face, local = np.zeros(3), np.zeros(3)
        chords, owner = np.zeros((32, 2)), np.zeros(32, np.int64)
        for k in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            end, r2 = 1.0, 0.0
            for a in range(dim):
                x[a], dx[a] = xi[k, a], xj[k, a] - xi[k, a]
                r2 += dx[a] * dx[a]
                if around[a]:
                    period = edge[a] * counts[a]
                    x[a] -= np.floor((x[a] - lower[a]) / period) * period
                elif dx[a] != 0.0:
                    wall = lower[a] + edge[a] * counts[a] if dx[a] > 0 else lower[a]
                    end = min(end, max((wall - x[a]) / dx[a], 0.0))
            if r2 > 0.0:
                least = round_off / np.sqrt(r2)
                end, m, chords, owner = _chords(
                    x, dx, end, least, lower, edge, counts, around, start, entry, piece, shape, sure,
                    walk, face, local, chords, owner,
                )
                end = _first_solid(chords, owner, m, end, solid, outside, filled, least)
            t[k] = max(end, ROUND_OFF)
    return t


@njit(cache=True)
def _chords(
    x, dx, end, least, lower, edge, counts, around, start, entry, piece, shape, sure,
    walk, face, local, chords, owner,
):
    """Chords (t_in, t_out) of a segment in the pieces of the cells that it passes (Amanatides and Woo 1987).

    Returns (end, m, chords, owner): where a piece that is surely solid begins, the number of chords before,
    the chords and their shapes.
    """
    m = 0
    for a in range(3):
        first = int(np.floor((x[a] - lower[a]) / edge[a]))
        last = int(np.floor((x[a] + end * dx[a] - lower[a]) / edge[a]))
        if not around[a]:
            first, last = min(max(first, 0), counts[a] - 1), min(max(last, 0), counts[a] - 1)
        walk[a, 0], walk[a, 1], walk[a, 2] = first, 1 if last > first else -1, abs(last - first)
        face[a] = _cell_face(x, dx, lower, edge, walk, a)
    entered = 0.0
    while True:
        axis = 0 if face[0] <= face[1] and face[0] <= face[2] else 1 if face[1] <= face[2] else 2
        left = min(max(face[axis], entered), end)
        cell = 0
        for a in range(2, -1, -1):
            turns = walk[a, 0] // counts[a]
            cell = cell * counts[a] + walk[a, 0] - turns * counts[a]
            local[a] = x[a] - turns * (edge[a] * counts[a])
        for q in range(start[cell], start[cell + 1]):
            p = entry[q]
            t_in, t_out = _chord(piece, p, local, dx)
            if piece[p, 0] == HALF_SPACE:  # the only one without images: cut where points are wrapped
                t_in, t_out = max(t_in, entered), min(t_out, left)
            if t_in >= t_out or t_in >= end or t_out <= 0.0:
                continue
            if sure[shape[p]]:
                if t_out - max(t_in, 0.0) > least:
                    end = max(t_in, 0.0)
                continue
            known = False
            for c in range(m):
                known |= chords[c, 0] == t_in and chords[c, 1] == t_out and owner[c] == shape[p]
            if known:
                continue
            if m == len(chords):
                chords = np.concatenate((chords, np.zeros_like(chords)))
                owner = np.concatenate((owner, np.zeros_like(owner)))
            chords[m, 0], chords[m, 1], owner[m] = t_in, t_out, shape[p]
            m += 1
        if walk[0, 2] + walk[1, 2] + walk[2, 2] == 0 or left >= end:
            return end, m, chords, owner
        entered = left
        walk[axis, 0] += walk[axis, 1]
        walk[axis, 2] -= 1
        face[axis] = _cell_face(x, dx, lower, edge, walk, axis)


@njit(cache=True)
def _cell_face(x, dx, lower, edge, walk, a):
    """Place along the segment of the next cell face of axis a; infinite when no face is left."""
    if walk[a, 2] == 0:
        return np.inf
    return (lower[a] + (walk[a, 0] + (1 if walk[a, 1] > 0 else 0)) * edge[a] - x[a]) / dx[a]


@njit(cache=True)
def _chord(piece, p, x, dx):
    """Where the line x + t dx enters and leaves piece p; (inf, -inf) if it misses it."""
    kind, axis = int(piece[p, 0]), int(piece[p, 7])
    if kind == HALF_SPACE:
        height, rise = 0.0, 0.0
        for a in range(3):
            height += (x[a] - piece[p, 1 + a]) * piece[p, 4 + a]
            rise += dx[a] * piece[p, 4 + a]
        if rise == 0.0:
            return (-np.inf, np.inf) if height < 0.0 else (np.inf, -np.inf)
        return (-height / rise, np.inf) if rise < 0.0 else (-np.inf, -height / rise)
    t_in, t_out = -np.inf, np.inf
    if kind == BLOCK:
        for a in range(3):
            low, high = _slab(x[a] - piece[p, 1 + a], dx[a], piece[p, 4 + a])
            t_in, t_out = max(t_in, low), min(t_out, high)
        return t_in, t_out
    away2, along, step2 = 0.0, 0.0, 0.0
    for a in range(3):
        if kind == BALL or a != axis:
            away = x[a] - piece[p, 1 + a]
            away2 += away * away
            along += away * dx[a]
            step2 += dx[a] * dx[a]
    power = away2 - piece[p, 4] * piece[p, 4]
    if step2 == 0.0:
        if power >= 0.0:
            return np.inf, -np.inf
    else:
        if along >= 0.0 and power >= 0.0:
            return np.inf, -np.inf
        root = along * along - step2 * power
        if root <= 0.0:
            return np.inf, -np.inf
        q = np.sqrt(root) + abs(along)  # without cancellation
        t_in, t_out = (power / q, q / step2) if along < 0.0 else (-q / step2, -power / q)
    if kind == CYLINDER:
        low, high = _slab(x[axis] - piece[p, 1 + axis], dx[axis], piece[p, 5])
        t_in, t_out = max(t_in, low), min(t_out, high)
    return t_in, t_out


@njit(cache=True)
def _slab(x, dx, half):
    """Where x + t dx is within half of 0."""
    if half == np.inf:
        return -np.inf, np.inf
    if dx == 0.0:
        return (-np.inf, np.inf) if abs(x) < half else (np.inf, -np.inf)
    low, high = (-half - x) / dx, (half - x) / dx
    return min(low, high), max(low, high)


@njit(cache=True)
def _first_solid(chords, owner, m, end, solid, outside, filled, least):
    """Begin of the first part of the segment, longer than `least`, whose topmost shape is solid, or `end`."""
    begin = 0.0
    while begin < end:
        stop = end  # next end of a chord
        for c in range(m):
            for side in range(2):
                if chords[c, side] > begin:
                    stop = min(stop, chords[c, side])
        if stop - begin > least:
            middle, is_solid = 0.5 * (begin + stop), filled
            for s in range(len(solid) - 1, -1, -1):
                inside = False
                for c in range(m):
                    inside |= owner[c] == s and chords[c, 0] < middle and middle < chords[c, 1]
                if inside != outside[s]:
                    is_solid = solid[s]
                    break
            if is_solid:
                return begin
        begin = stop
    return end


@njit(cache=True)
def _inside(piece, p, x, y, z):
    """Whether a point lies inside a piece, not on its surface."""
    x, y, z = x - piece[p, 1], y - piece[p, 2], z - piece[p, 3]
    kind = piece[p, 0]
    if kind == BALL:
        return x * x + y * y + z * z < piece[p, 4] ** 2
    if kind == BLOCK:
        return abs(x) < piece[p, 4] and abs(y) < piece[p, 5] and abs(z) < piece[p, 6]
    if kind == HALF_SPACE:
        return x * piece[p, 4] + y * piece[p, 5] + z * piece[p, 6] < 0.0
    axis = piece[p, 7]
    along = x if axis == 0 else y if axis == 1 else z
    return x * x + y * y + z * z - along * along < piece[p, 4] ** 2 and abs(along) < piece[p, 5]


@njit(cache=True)
def _topmost(x, y, z, lower, edge, counts, around, start, entry, piece, shape, outside):
    """The topmost shape that holds a point, -1 where it is none, -2 beyond a face that is a wall."""
    cell = 0
    at = (x, y, z)
    local = np.empty(3)
    for a in range(2, -1, -1):
        i = int(np.floor((at[a] - lower[a]) / edge[a]))
        turns = i // counts[a]
        if turns != 0 and not around[a]:
            return -2
        local[a] = at[a] - turns * (edge[a] * counts[a])
        cell = cell * counts[a] + i - turns * counts[a]
    top = -1
    for q in range(start[cell], start[cell + 1]):
        s = shape[entry[q]]
        if s > top and not outside[s] and _inside(piece, entry[q], local[0], local[1], local[2]):
            top = s
    for s in range(len(outside) - 1, top, -1):
        if outside[s]:
            held = False
            for q in range(start[cell], start[cell + 1]):
                held |= shape[entry[q]] == s and _inside(piece, entry[q], local[0], local[1], local[2])
            if not held:
                return s
    return top


@njit(cache=True)
def _is_solid(x, y, z, lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled):
    top = _topmost(x, y, z, lower, edge, counts, around, start, entry, piece, shape, outside)
    return True if top == -2 else filled if top == -1 else bool(solid[top])


def _directions() -> np.ndarray:
    """(m, 3) unit vectors all round, turned off the axes, so that none lies in a face of a box."""
    steps = np.array([v for v in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(v)])
    return steps / np.linalg.norm(steps, axis=1)[:, None] @ Rotation.from_euler("xyz", [0.17, 0.23, 0.31]).as_matrix()


def _in_3d(x: np.ndarray) -> np.ndarray:
    """Points (n, 3), z = 0 in 2D."""
    return np.ascontiguousarray(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))


ROUND_ABOUT = _directions()
ROUND_ABOUT_2D = np.array([[np.cos(a), np.sin(a), 0.0] for a in (np.arange(16) + 0.3) * np.pi / 8])


@njit(cache=True, parallel=True)
def _beside(
    x, lower, edge, counts, around, start, entry, piece, shape, solid, outside, sure, filled, step
):
    """A fluid shape (-1: what fills the box) beside each point, -2 if there is solid beside it too."""
    found = np.empty(len(x), np.int64)
    flat = edge[2] * counts[2] < 10.0 * step
    ways = ROUND_ABOUT_2D if flat else ROUND_ABOUT
    for k in prange(len(x)):
        beside = -2
        for w in range(len(ways)):
            top = _topmost(
                x[k, 0] + step * ways[w, 0], x[k, 1] + step * ways[w, 1], x[k, 2] + step * ways[w, 2],
                lower, edge, counts, around, start, entry, piece, shape, outside,
            )  # fmt: skip
            if top == -2 or (top == -1 and filled) or (top >= 0 and solid[top]):
                beside = -2
                break
            beside = max(beside, top)
        found[k] = beside
    return found


@njit(cache=True)
def _value(surface, s, p, slope):
    """Signed distance of point p to a surface; its gradient goes to slope."""
    if surface[s, 0] == PLANE:
        f = -surface[s, 4]
        for a in range(3):
            slope[a] = surface[s, 1 + a]
            f += slope[a] * p[a]
        return f
    r = 0.0
    for a in range(3):
        slope[a] = (p[a] - surface[s, 1 + a]) * surface[s, 5 + a]
        r += slope[a] * slope[a]
    r = np.sqrt(r)
    if r == 0.0:  # in the middle all directions are alike
        slope[0 if surface[s, 5] > 0 else 1] = 1.0
    else:
        slope /= r
    return r - surface[s, 4]


@njit(cache=True)
def _add_surface(surface, n, row, x, reach, slope, near, step):
    """Put a surface on the list of the nearest, if it is within reach and new; returns how many there are."""
    surface[-1] = row
    f = abs(_value(surface, len(surface) - 1, x, slope))
    if f > reach:
        return n
    for s in range(n):
        same = surface[s, 0] == row[0] and abs(surface[s, 4] - row[4]) < 0.1 * step
        for a in range(3):
            small = 1e-12 if row[0] == PLANE else 0.1 * step
            same &= abs(surface[s, 1 + a] - row[1 + a]) < small and surface[s, 5 + a] == row[5 + a]
        if same:
            return n
    at = n
    if n == MOST_SURFACES:
        at = int(np.argmax(near[:n]))
        if f >= near[at]:
            return n
    surface[at] = row
    near[at] = f
    return min(n + 1, MOST_SURFACES)


@njit(cache=True)
def _surfaces_near(x, reach, lower, edge, counts, around, start, entry, piece, shape, surface, near, row, slope, step):
    """Planes and round surfaces of the pieces within reach of point x, periodic images too, and closed faces.

    Rows of surface: kind; normal (3,) of a plane or centre (3,); offset of the plane or radius; of round ones 1 along
    the axes that count (a cylinder leaves one out), of planes 0; the shape, -1 of a face.
    """
    n = 0
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for a in range(3):
        first[a] = int(np.floor((x[a] - reach - lower[a]) / edge[a]))
        last[a] = int(np.floor((x[a] + reach - lower[a]) / edge[a]))
        if not around[a]:
            first[a] = min(max(first[a], 0), counts[a] - 1)
            last[a] = min(max(last[a], 0), counts[a] - 1)
            if edge[a] * counts[a] > 10.0 * step:  # not the layer of a 2D scene
                for side in range(2):
                    row[:] = 0.0
                    row[1 + a], row[4], row[8] = 1.0, lower[a] + side * edge[a] * counts[a], -1.0
                    n = _add_surface(surface, n, row, x, reach, slope, near, step)
    for z in range(first[2], last[2] + 1):
        for y in range(first[1], last[1] + 1):
            for i in range(first[0], last[0] + 1):
                tx, ty, tz = i // counts[0], y // counts[1], z // counts[2]
                cell = ((z - tz * counts[2]) * counts[1] + y - ty * counts[1]) * counts[0] + i - tx * counts[0]
                for q in range(start[cell], start[cell + 1]):
                    p = entry[q]
                    kind = piece[p, 0]
                    c = (piece[p, 1] + tx * edge[0] * counts[0], piece[p, 2] + ty * edge[1] * counts[1],
                         piece[p, 3] + tz * edge[2] * counts[2])
                    row[:] = 0.0
                    row[8] = shape[p]
                    if kind == HALF_SPACE:
                        for a in range(3):
                            row[1 + a] = piece[p, 4 + a]
                            row[4] += row[1 + a] * c[a]
                        n = _add_surface(surface, n, row, x, reach, slope, near, step)
                        continue
                    if kind != BLOCK:
                        row[0], row[4] = ROUND, piece[p, 4]
                        for a in range(3):
                            row[1 + a] = c[a]
                            row[5 + a] = 0.0 if kind == CYLINDER and a == piece[p, 7] else 1.0
                        n = _add_surface(surface, n, row, x, reach, slope, near, step)
                    if kind == BALL:
                        continue
                    for a in range(3):
                        half = piece[p, 4 + a] if kind == BLOCK else piece[p, 5] if a == piece[p, 7] else np.inf
                        if half == np.inf:
                            continue
                        for side in (-1.0, 1.0):
                            row[:8] = 0.0
                            row[1 + a], row[4] = 1.0, c[a] + side * half
                            n = _add_surface(surface, n, row, x, reach, slope, near, step)
    return n


@njit(cache=True)
def _solve(g, b, m):
    """Solution of the symmetric m by m system g x = b in place of b; False where it is singular."""
    for i in range(m):
        if g[i, i] < 1e-10:
            return False
        for j in range(i + 1, m):
            factor = g[j, i] / g[i, i]
            for k in range(i, m):
                g[j, k] -= factor * g[i, k]
            b[j] -= factor * b[i]
    for i in range(m - 1, -1, -1):
        for j in range(i + 1, m):
            b[i] -= g[i, j] * b[j]
        b[i] /= g[i, i]
    return True


@njit(cache=True)
def _foot(surface, chosen, m, dim, x, p, j, g, b, step):
    """Move p to the point nearest to x that lies on all m chosen surfaces; False where none is found."""
    scale = step / PROBE
    for turn in range(60):
        # steps towards x along tight curves are too long and swing about the nearest point; at last only back to them
        share = 1.0 if turn < 15 else 0.4 if turn < 30 else 0.15 if turn < 50 else 0.0
        off = 0.0
        for i in range(m):
            b[i] = -_value(surface, chosen[i], p, j[i])
            off = max(off, abs(b[i]))
            for a in range(3):
                b[i] -= share * j[i, a] * (x[a] - p[a])
        if m == dim and turn == 12 and off > 1e-3 * scale:  # they do not meet
            return False
        for i in range(m):
            for k in range(m):
                g[i, k] = j[i, 0] * j[k, 0] + j[i, 1] * j[k, 1] + j[i, 2] * j[k, 2]
        if not _solve(g, b, m):
            return False
        moved = 0.0
        for a in range(3):
            to = p[a] + share * (x[a] - p[a])
            for i in range(m):
                to += b[i] * j[i, a]
            moved = max(moved, abs(to - p[a]))
            p[a] = to
        if not moved < 1e6 * scale:
            return False
        if moved < 1e-13 * scale:
            break
    for i in range(m):
        if not abs(_value(surface, chosen[i], p, j[i])) < 1e-12 * scale:
            return False
    return True


@njit(cache=True)
def _meets(
    p, m, j, g, b, wanted, dim, lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled, step
):
    """Whether there is solid (wanted True) or fluid (False) beside point p, on m surfaces of gradients j.

    Looked at are all sides that the surfaces make and directions all round.
    """
    ways = ROUND_ABOUT_2D if dim == 2 else ROUND_ABOUT
    for w in range(2**m + len(ways)):
        d0, d1, d2 = 0.0, 0.0, 0.0
        if w < 2**m:
            for i in range(m):
                b[i] = 1.0 if (w >> i) & 1 else -1.0
                for k in range(m):
                    g[i, k] = j[i, 0] * j[k, 0] + j[i, 1] * j[k, 1] + j[i, 2] * j[k, 2]
            if not _solve(g, b, m):
                continue
            for i in range(m):
                d0, d1, d2 = d0 + b[i] * j[i, 0], d1 + b[i] * j[i, 1], d2 + b[i] * j[i, 2]
            size = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
            d0, d1, d2 = d0 / size + 4e-4, d1 / size + 9e-4, d2 / size + (5e-4 if dim == 3 else 0.0)
        else:
            d0, d1, d2 = ways[w - 2**m, 0], ways[w - 2**m, 1], ways[w - 2**m, 2]
        if wanted == _is_solid(
            p[0] + step * d0, p[1] + step * d1, p[2] + step * d2,
            lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled,
        ):  # fmt: skip
            return True
    return False


@njit(cache=True, parallel=True)
def _walls_near(
    x, bound, known, dim, lower, edge, counts, around, start, entry, piece, shape, solid, outside, sure,
    filled, step, chunks,
):
    """Signed distance (n,) to the nearest wall and its index (n,).

    x: (n, 3) in the box or beyond closed faces; bound, known: (n,) signed lower bound of the distance and the index
    of the surface it is to. Walls are where there is solid beside fluid. The nearest point of them is the foot of
    x on one surface, on the line where two meet or on a point of three: those of the surfaces near by are tried.
    """
    n = len(x)
    d, wall = bound.copy(), known.copy()
    size = np.sqrt(((edge[:dim] * counts[:dim]) ** 2).sum())
    for chunk in prange(chunks):
        surface, near = np.zeros((MOST_SURFACES + 1, 9)), np.zeros(MOST_SURFACES)
        row, slope, p, twin, at = np.zeros(9), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
        j, g, b = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
        chosen = np.zeros(3, np.int64)
        for k in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            at[:], p[:] = x[k], 0.0
            least = abs(bound[k])
            wanted = bound[k] > 0.0  # in fluid solid is looked for, in a solid fluid
            if least <= 2.0 * step:  # on a surface: a wall, or inside one kind
                here, other = False, False
                ways, away = ROUND_ABOUT_2D if dim == 2 else ROUND_ABOUT, 4.0 * step
                for w in range(len(ways)):
                    is_solid = _is_solid(
                        at[0] + away * ways[w, 0], at[1] + away * ways[w, 1], at[2] + away * ways[w, 2],
                        lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled,
                    )  # fmt: skip
                    here, other = here | is_solid, other | (not is_solid)
                if here and other:
                    continue
                wanted = not here
            elif _met_at_once(
                at, least, wanted, known[k] - 1 - 2 * dim, dim, lower, edge, counts, around, start, entry, piece,
                shape, solid, outside, filled, step, p,
            ):  # fmt: skip
                continue
            reach, best, owner = least * (1.0 + 1e-9) + 4.0 * step, np.inf, -1
            while True:
                m = _surfaces_near(
                    at, reach, lower, edge, counts, around, start, entry, piece, shape, surface, near, row, slope, step
                )
                order = np.argsort(near[:m])
                for count in range(1, dim + 1):
                    best, owner = _nearest_foot(
                        surface, near, order, m, count, at, least, best, owner, wanted, dim, p, twin, chosen, j, g, b,
                        lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled, step,
                    )
                if best <= reach or reach > 2.0 * size:
                    break
                reach = 2.0 * reach + 0.01 * size
            if best < np.inf:
                d[k] = max(best, least) if wanted else -max(best, least)
                if owner >= 0:
                    wall[k] = 1 + 2 * dim + owner
    return d, wall


@njit(cache=True)
def _twin(surface, chosen, count, p, j, twin):
    """Mirror image of a point that `count` (the dimension) surfaces share, in the plane that holds the centres of the
    round ones and the normals of the planes; False where there is none. They meet there too."""
    centre, m = -1, 0
    for i in range(count):
        c = chosen[i]
        if surface[c, 0] == PLANE:
            j[m] = surface[c, 1:4]
            m += 1
        elif centre < 0:
            centre = c
        else:
            j[m] = surface[c, 1:4] - surface[centre, 1:4]
            m += 1
    if count == 2:
        j[1, 0], j[1, 1], j[1, 2] = 0.0, 0.0, 1.0
    twin[0] = j[0, 1] * j[1, 2] - j[0, 2] * j[1, 1]
    twin[1] = j[0, 2] * j[1, 0] - j[0, 0] * j[1, 2]
    twin[2] = j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]
    size = np.sqrt((twin * twin).sum())
    if size == 0.0:
        return False
    twin /= size
    height = 0.0
    for a in range(3):
        height += (p[a] - surface[centre, 1 + a]) * twin[a]
    for a in range(3):
        twin[a] = p[a] - 2.0 * height * twin[a]
    return True


@njit(cache=True)
def _nearest_foot(
    surface, near, order, m, count, x, least, best, owner, wanted, dim, p, twin, chosen, j, g, b, lower, edge, counts,
    around, start, entry, piece, shape, solid, outside, filled, step,
):
    """(best, owner): distance of the nearest point of a wall on `count` of the m surfaces, if it is nearer than best,
    and a shape whose surface it is on."""
    for i0 in range(m):
        if near[order[i0]] >= best:
            break
        for i1 in range(i0 + 1 if count > 1 else 0, m if count > 1 else 1):
            if count > 1 and near[order[i1]] >= best:
                break
            for i2 in range(i1 + 1 if count > 2 else 0, m if count > 2 else 1):
                if count > 2 and near[order[i2]] >= best:
                    break
                chosen[0], chosen[1], chosen[2] = order[i0], order[i1], order[i2]
                curved, tube = False, False
                for i in range(count):
                    curved |= surface[chosen[i], 0] == ROUND
                    for a in range(dim):
                        tube |= surface[chosen[i], 0] == ROUND and surface[chosen[i], 5 + a] == 0.0
                # round surfaces also meet on their far sides; on the line between two centres both face the same way
                found = False
                for side in range(count + 4 if curved and count > 1 else 1):
                    middle = chosen[min(max(side - 1, 0), count - 1)]
                    if 0 < side <= count and (surface[middle, 0] == PLANE or (found and not tube)):
                        continue
                    if (count < side < count + 3 and found) or (side == count + 3 and not (found and count == dim)):
                        continue
                    for a in range(dim):
                        p[a] = twin[a] if side > count + 2 else x[a]
                        if count < side < count + 3:
                            aside = 0.3 * near[order[i2 if count == 3 else i1]]
                            p[a] += aside * ROUND_ABOUT[0, a] * (1.0 if side == count + 1 else -1.0)
                        elif 0 < side <= count and surface[middle, 5 + a] > 0.0:
                            p[a] = 2.0 * surface[middle, 1 + a] - x[a]
                    if not _foot(surface, chosen, count, dim, x, p, j, g, b, step):
                        continue
                    if curved and not found:
                        found = count < dim or _twin(surface, chosen, count, p, g, twin)
                    away = np.sqrt((p[0] - x[0]) ** 2 + (p[1] - x[1]) ** 2 + (p[2] - x[2]) ** 2)
                    if away < best and away > least * (1.0 - 1e-9) - step and _meets(
                        p, count, j, g, b, wanted, dim, lower, edge, counts, around, start, entry, piece, shape, solid,
                        outside, filled, step,
                    ):
                        best, owner = away, int(surface[chosen[0], 8])
                        if best <= least * (1.0 + 1e-9) + step:
                            return best, owner
    return best, owner


@njit(cache=True)
def _met_at_once(
    x, least, wanted, k, dim, lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled, step, p
):
    """Whether there is a wall right at the foot of x on the piece of shape k that holds it (k < 0: on the faces)."""
    if k < 0:
        for a in range(3):
            inside = 2.0 * step if a < dim else 0.0
            p[a] = x[a] if around[a] else min(max(x[a], lower[a] + inside), lower[a] + edge[a] * counts[a] - inside)
            p[a] += 0.3 * inside * ROUND_ABOUT[0, a]  # not on a seam
        return wanted == _is_solid(
            p[0], p[1], p[2], lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled
        )
    cell = 0
    for a in range(2, -1, -1):
        i = int(np.floor((x[a] - lower[a]) / edge[a]))
        cell = cell * counts[a] + min(max(i, 0), counts[a] - 1)
    for q in range(start[cell], start[cell + 1]):
        c = entry[q]
        if shape[c] != k or not _inside(piece, c, x[0], x[1], x[2]):
            continue
        p[:] = x
        if piece[c, 0] == BLOCK:
            for a in range(dim):
                if abs(piece[c, 4 + a] - abs(x[a] - piece[c, 1 + a]) - least) <= step:
                    p[a] = piece[c, 1 + a] + np.copysign(piece[c, 4 + a] + step, x[a] - piece[c, 1 + a])
                    break
        elif piece[c, 0] == HALF_SPACE:
            for a in range(dim):
                p[a] += (least + step) * piece[c, 4 + a]
        else:
            r, tube = 0.0, piece[c, 0] == CYLINDER
            for a in range(3):
                if not (tube and a == piece[c, 7]):
                    r += (x[a] - piece[c, 1 + a]) ** 2
            r = np.sqrt(r)
            if r == 0.0 or abs(piece[c, 4] - r - least) > step:
                continue
            for a in range(3):
                if not (tube and a == piece[c, 7]):
                    p[a] = piece[c, 1 + a] + (x[a] - piece[c, 1 + a]) * (piece[c, 4] + step) / r
        away = 0.0
        for a in range(3):
            away += (p[a] - x[a]) ** 2
        for a in range(dim):
            p[a] += 0.3 * step * ROUND_ABOUT[0, a]  # not on a seam
        if np.sqrt(away) <= least + 3.0 * step and wanted == _is_solid(
            p[0], p[1], p[2], lower, edge, counts, around, start, entry, piece, shape, solid, outside, filled
        ):
            return True
    return False


def read_spheres(
    path: str | Path, dim: int = 3, radius: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (m, dim) and radii (m,) of a CSV file, m; see `spheres_of_file`."""
    found = spheres_of_file(path, dim, radius)
    return found.centres, np.broadcast_to(np.asarray(found.radii, float), len(found.centres))


def spheres_of_file(path: str | Path, dim: int = 3, radius: float | None = None) -> Spheres:
    """Balls of a CSV file with columns x, y(, z)[, radius or diameter].

    Lines starting with # are skipped. A header line may be there, after a # too; it names the columns and perhaps their
    unit, x_mm or radius [um], in which case the lengths are converted to m. Names that are not understood, columns in
    another order and lengths of which only some have a unit are refused. radius, m, is used where the file has no such
    column. Raises ShapeError.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ShapeError(f"{path}: cannot be read as text ({error}); give rows of x,y,z[,radius]") from None
    rows: list[list[float]] = []
    header: _Header | None = None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        if line.lstrip().startswith("#"):
            if not rows and header is None:  # numpy.savetxt puts a # before its header
                header = _commented_header(line, dim, f"{path}:{number}")
            continue
        if ";" in line and "," in line:
            raise ShapeError(f"{path}:{number}: holds ; and ,: numbers need a decimal point, columns one separator")
        cells = [c.strip() for c in line.replace(";", ",").split(",")]
        try:
            values = [float(c) for c in cells]
        except ValueError:
            if not rows and not any(_is_number(c) for c in cells):
                header = _Header.of(cells, dim, f"{path}:{number}")
                continue
            raise ShapeError(
                f"{path}:{number}: '{line.strip()[:60]}' is not a row of numbers; fix it"
            ) from None
        if len(values) not in (dim, dim + 1) or (rows and len(values) != len(rows[0])):
            want = f"{dim} or {dim + 1}" if not rows else str(len(rows[0]))
            raise ShapeError(f"{path}:{number}: {len(values)} columns where {want} are expected")
        if not np.isfinite(values).all():
            raise ShapeError(f"{path}:{number}: a value is not finite; remove the row or correct it")
        if header is not None and len(values) != len(header.scale):
            raise ShapeError(f"{path}:{number}: {len(values)} columns where the header has {len(header.scale)}")
        rows.append(values)
    if not rows:
        raise ShapeError(f"{path}: holds no sphere; give rows of x,y,z[,radius]")
    table = np.array(rows) * (header.scale if header is not None else 1.0)
    if table.shape[1] == dim and radius is None:
        raise ShapeError(f"{path}: has no column of radii; add one or give the key 'radius'")
    radii = table[:, dim] if table.shape[1] > dim else np.full(len(table), float(radius))  # type: ignore[arg-type]
    if not (radii > 0).all() or not np.isfinite(table).all():
        raise ShapeError(f"{path}: radius {radii.min()} is not positive, or a length leaves the range of numbers")
    return Spheres(np.ascontiguousarray(table[:, :dim]), radii, header.said if header is not None else "")


TRIES = 2000  # random places tried for each sphere before there is said to be no room
MOST_TRIES = 2_000_000  # for all of them: some seconds
DENSEST = {2: 0.907, 3: 0.741}  # share of space that equal balls can fill at all


def random_spheres(
    geometry: ShapeGeometry, count: int, radius: float, clearance: float = 0.0, seed: int = 0
) -> Spheres:
    """Balls of a radius at random places in the box, no two nearer than `clearance`, nor any to a wall, m.

    Raises ShapeError where not all of them find room.
    """
    rng = np.random.default_rng(seed)
    box, size = geometry.upper - geometry.lower, 2.0 * radius + clearance
    with np.errstate(over="ignore"):
        share = count * np.pi / (2 * geometry.dim) * float(np.prod(size / box))  # of balls with half their clearance
    if share > DENSEST[geometry.dim]:
        raise ShapeError(f"{count} spheres of radius {radius:g} would fill {100 * share:.3g} % of the box with their "
                         f"clearance, and no more than {100 * DENSEST[geometry.dim]:.0f} % can be; ask for fewer or "
                         f"smaller ones")
    centres = np.empty((count, geometry.dim))
    placed = 0
    for _ in range(min(TRIES, max(1, MOST_TRIES // count))):
        places = geometry.lower + rng.random((count, geometry.dim)) * box
        places = places[geometry.distance(places) >= radius + clearance]
        if placed:  # most of those that are too near are found at once
            images = build_halo(centres[:placed], geometry.lower, geometry.upper, np.array(geometry.periodic), size)
            places = places[cKDTree(images.positions(centres[:placed])).query(places)[0] >= size * (1.0 - 1e-9)]
        for place in places:
            apart = np.linalg.norm(_nearest_image(centres[:placed] - place, geometry.period), axis=1)
            if (apart >= size).all():
                centres[placed] = place
                placed += 1
                if placed == count:
                    return Spheres(centres, radius)
    raise ShapeError(
        f"only {placed} of {count} spheres of radius {radius:g} found room at random; ask for fewer or smaller ones"
    )


UNITS = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "cm": 1e-2, "mm": 1e-3, "millimeter": 1e-3,
    "millimeters": 1e-3, "millimetre": 1e-3, "millimetres": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6,
    "micron": 1e-6, "microns": 1e-6, "micrometer": 1e-6, "micrometers": 1e-6, "micrometre": 1e-6, "micrometres": 1e-6,
    "nm": 1e-9,
}  # fmt: skip
RADIUS, DIAMETER = ("r", "rad", "radius", "radii"), ("d", "dia", "diam", "diameter", "diameters")


@dataclass(frozen=True)
class _Header:
    """scale: (columns,) factors that make the columns metres and diameters radii; said: what it took, or nothing."""

    scale: np.ndarray
    said: str

    @classmethod
    def of(cls, cells: list[str], dim: int, where: str) -> _Header:
        """Header of the names in a line; raises ShapeError where they are not understood."""
        found = [_column(cell) for cell in cells]
        names, shown = [name for name, _ in found], ",".join(cells)[:60]
        wanted = f"{','.join('xyz'[:dim])}[,radius]"
        strange = [cell for cell, name in zip(cells, names) if not name]
        if strange:
            raise ShapeError(f"{where}: no such column: {', '.join(strange)[:60]}; give {wanted} and no others")
        if names[:dim] != list("xyz"[:dim]) or names[dim:] not in ([], ["radius"], ["diameter"]):
            raise ShapeError(f"{where}: the columns are {shown}; give {wanted} in this order")
        units = [unit for _, unit in found]
        if None in units and any(units):
            without = ", ".join(cell for cell, unit in zip(cells, units) if unit is None)
            raise ShapeError(f"{where}: only some columns have a unit; name that of {without} too, or of none")
        scale = np.array([1.0 if unit is None else UNITS[unit] for unit in units])
        said = f"lengths in {', '.join(dict.fromkeys(u for u in units if u))}" if any(units) else ""
        if any(u is not None and UNITS[u] != 1.0 for u in units):
            said += " converted to m"
        if names[-1] == "diameter":
            scale[-1] /= 2
            said += f"{', ' if said else ''}diameters halved"
        return cls(scale, said)


def _column(cell: str) -> tuple[str, str | None]:
    """('x', 'y', 'z', 'radius', 'diameter' or '' for another, its unit or None) of the name of a column."""
    text = cell.strip().strip("'\"").lower()
    words = [w for w in re.split(r"[\s_\[\](){}/]+", text) if w]
    unit = words.pop() if len(words) > 1 and words[-1] in UNITS else None
    words = [w for w in words if w not in ("centre", "center", "pos", "position", "coordinate", "in", "bead", "sphere")]
    if len(words) != 1:
        return "", unit
    (word,) = words
    if word in RADIUS or word in DIAMETER:
        return "radius" if word in RADIUS else "diameter", unit
    return word if word in ("x", "y", "z") else "", unit


def _commented_header(line: str, dim: int, where: str) -> _Header | None:
    """The header in a comment, if all its words are names of columns."""
    text = line.lstrip("# \t")
    for cells in (re.split(r"[,;]", text), text.split()):
        cells = [c.strip() for c in cells]
        if len(cells) >= dim and all(_column(c)[0] for c in cells):
            return _Header.of(cells, dim, where)
    return None


LARGE = 10.0  # radii over the smallest period: then one ball has 8000 images and lengths are in another unit


def sphere_findings(
    body: Spheres, lower: np.ndarray, upper: np.ndarray, period: np.ndarray, name: str
) -> tuple[list[str], list[str]]:
    """(facts, warnings) on balls against their box: those outside, wrapped or left out, and those that overlap.

    lower, upper: (dim,) corners, m; period: (dim,) m, infinite along closed axes. Raises ShapeError for balls far
    larger than a periodic box.
    """
    centres = np.atleast_2d(np.asarray(body.centres, float))
    radii = np.broadcast_to(np.asarray(body.radii, float), len(centres))
    facts, odd = [], []
    count, size = len(centres), upper - lower
    if radii.max() > LARGE * period.min():
        raise ShapeError(f"{name}: a radius of {radii.max():g} m in a periodic box of {period.min():g} m; check the "
                         "unit: lengths are in m unless the header names another (x_mm)")  # fmt: skip
    beyond = np.maximum(lower - centres, centres - upper)  # of the centre, along each axis
    closed = ~np.isfinite(period)
    out = (beyond[:, closed] >= radii[:, None]).any(axis=1)
    wrapped = (beyond[:, ~closed] > ROUND_OFF * size[~closed]).any(axis=1) & ~out
    far = ((beyond - radii[:, None] >= 0.0)[:, ~closed]).any(axis=1) & ~out
    if out.any():
        odd.append(f"{name}: {out.sum()} of {count} spheres lie outside the box and are left out; check lengths "
                   "and origin")  # fmt: skip
    if wrapped.any():
        text = f"{wrapped.sum()} of {count} spheres have their centre outside the box and are wrapped into it"
        most = float((beyond / size)[:, ~closed].max())
        if far.any():
            odd.append(f"{name}: {text}, {far.sum()} of them from wholly outside (up to {most:.3g} box lengths); "
                       "check lengths and origin")  # fmt: skip
        else:
            facts.append(text)
    kept = np.flatnonzero(~out)
    pairs, copies, most = _overlaps(centres[kept], radii[kept], period) if len(kept) > 1 else (0, 0, 0.0)
    if copies:
        facts.append(f"{copies} spheres repeat another one, or its periodic image; they count once")
    if pairs:
        odd.append(f"{name}: {pairs} pairs of spheres overlap, by up to {100 * most:.0f} % of the smaller radius; "
                   "what they share counts once")  # fmt: skip
    return facts, odd


TOUCH = 0.01  # of the smaller radius: overlaps up to it are how packings touch


def _overlaps(centres: np.ndarray, radii: np.ndarray, period: np.ndarray) -> tuple[int, int, float]:
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
            apart = np.linalg.norm(_nearest_image(x[j] - x[i], period), axis=1)
            same = (apart <= 1e-9 * radii[i]) & (radii[j] >= radii[i] * (1 - 1e-9))
            repeats[j[same]] = True
            once = ~(same | repeats[j] | repeats[i])
            depth = (radii[i] + radii[j] - apart)[once] / radii[j][once]
            pairs += int((depth > TOUCH).sum())
            most = max(most, float(depth.max(initial=0.0)))
    return pairs, int(repeats.sum()), min(most, 2.0)


def _cut_planes(geometry: ShapeGeometry) -> Iterator[str]:
    """Half-spaces that end at a periodic face."""
    for k, shape in enumerate(geometry.shapes):
        if not isinstance(shape.body, HalfSpace):
            continue
        slope = np.abs(shape.body.unit_normal) > ROUND_OFF
        cut = [name for name, p, s in zip("xyz", geometry.periodic, slope) if p and s]
        if cut:
            yield (f"shape {k + 1}: the half-space is not periodic along {', '.join(cut)}: it ends at the periodic "
                   "face, where the distance to walls is not that to its end")  # fmt: skip


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
