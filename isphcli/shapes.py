"""Scenes of spheres, boxes, cylinders and half-spaces with exact signed distances.

A `ShapeGeometry` is a box filled with one fluid and an ordered list of `Shape`, later ones on top of earlier
ones. Solids join by min and fluid shapes carve by max of the signed distances (design section 5): exact in
the fluid round unions of solids.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numba import get_num_threads, njit, prange
from scipy.spatial import cKDTree

from .geometry import block_distance, face_distance, face_walls
from .halo import build_halo

ROUND_OFF = 1e-12  # of the largest side of the box: points closer than this to a wall are on it
BALL, BLOCK, CYLINDER, HALF_SPACE = range(4)  # convex pieces of bodies, see `Body.pieces`
CELLS_A_PIECE = 8  # cells of the grid of pieces: beads then meet about three cells each way


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
    """Many balls, overlapping or not: centres (m, dim), radii a number or (m,)."""

    centres: np.ndarray
    radii: np.ndarray | float
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
    """

    warnings: tuple[str, ...] = ()

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

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """(n,) fraction t in (0, 1] from fluid point xi to xj at the first wall; 1.0 where none is met.

        Exact: the chords of the segment in the bodies cut it into parts, and the first part whose topmost
        shape is solid begins at t.
        """
        xi, xj = np.asarray(xi, float), np.asarray(xj, float)
        if not self.has_solid or not len(xi):
            return np.ones(len(xi))
        if self._grid is None:
            self._grid = _Grid.of(self)
        return _crossings(xi, xj, *self._grid, self.fluid < 0, self.round_off, get_num_threads())

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


def read_spheres(
    path: str | Path, dim: int = 3, radius: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (m, dim) and radii (m,) of a CSV file with columns x, y(, z)[, radius].

    Lines starting with # are skipped. A header line may be there; names in it that say another order of the
    columns, or diameters, are refused. radius is used where the file has no such column.
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
                _check_header(cells, dim, f"{path}:{number}")
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


def _check_header(cells: list[str], dim: int, where: str) -> None:
    names = [c.strip("'\"").lower() for c in cells]
    order = list("xyz"[:dim])
    moved = any(a in names and names.index(a) != i for i, a in enumerate(order))
    if moved or any(n == "d" or n.startswith("diam") for n in names) or names[0] in ("r", "radius"):
        found = ",".join(names)[:60]
        raise ShapeError(f"{where}: the columns are {found}; give {','.join(order)}[,radius] in this order")


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
