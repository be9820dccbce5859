"""`ShapeGeometry`: a box filled with one fluid, and an ordered list of `bodies.Shape`, later ones on top."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..domain.row_threads import cut, over_parts, over_rows
from .bodies import ROUND_OFF, Cylinder, HalfSpace, Shape, ShapeError, Sphere, Spheres, check_body
from .faces import AT_REST, Walls, face_distance
from .fluid_faces import FluidFaces
from .nearest_wall import PROBE, in_3d, put_beside, put_walls
from .segment_walls import CELLS_A_PIECE, extent_of, fill_cells, periodic_images, put_crossings

# Points whose distances a thread finds in one go: 20 temporary arrays of them are 3 MB, which are had from memory that
# was freed before. Of millions of points each array is new to the process, and to clear its pages took a third of the
# time
AT_ONCE = 16_384


class ShapeGeometry:
    """Box of fluid with shapes in it; implements `protocol.Geometry`.

    lower, upper: (dim,) corners, m; periodic: per axis, the faces of the other axes are walls;
    fluid: index of the fluid that fills the box; shapes: later ones lie on top of earlier ones.
    walls: of the faces, and of shapes that do not state their own slip length.
    Walls are numbered 0 (at rest), 1 + 2 axis + side (faces), 1 + 2 dim + k (shape k).
    Raises ShapeError where a shape or the box cannot be used.
    """

    level_walls = False
    warnings: tuple[str, ...] = ()
    described: tuple[tuple[str, str], ...] = ()
    labels: np.ndarray | None = None
    voxel_size: np.ndarray | None = None

    def __init__(
        self,
        lower: Sequence[float] | np.ndarray,
        upper: Sequence[float] | np.ndarray,
        periodic: Sequence[bool],
        fluid: int = 0,
        shapes: Sequence[Shape] = (),
        walls: Walls = AT_REST,
    ):
        self.lower = np.array(lower, dtype=float)
        self.upper = np.array(upper, dtype=float)
        self.sample_lower, self.sample_upper = self.lower, self.upper
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
            check_body(shape.body, self.dim, f"shape {k + 1}")
        self._grid: PieceGrid | None = None  # for `crossing`, when it is first asked
        self.has_solid = self.fluid < 0 or not all(self.periodic) or any(s.phase < 0 for s in self.shapes)
        self.wall_velocity, self.slip_length = walls.table(self.dim, len(self.shapes))
        for k, shape in enumerate(self.shapes):
            self.wall_velocity[1 + 2 * self.dim + k] = 0.0 if shape.velocity is None else shape.velocity
            if shape.slip_length is not None:
                self.slip_length[1 + 2 * self.dim + k] = shape.slip_length
        self.wall_speed = np.linalg.norm(self.wall_velocity, axis=1)
        self.wall_spin: np.ndarray | None = None
        for k, shape in enumerate(self.shapes):
            if shape.angular_velocity:
                self._turn(1 + 2 * self.dim + k, shape, f"shape {k + 1}")
        self.warnings = tuple(_cut_planes(self))

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

    def within(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> ShapeGeometry:
        """Itself: shapes are few."""
        return self

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
            points = in_3d(x[seam])
            beside = np.empty(len(points), np.int64)
            over_rows(put_beside, len(points), points, self._pieces(), beside)
            phases = np.array([self.fluid, *(s.phase for s in self.shapes)], dtype=np.int8)
            phase[seam] = np.where(beside < -1, -1, phases[beside + 1])
        return phase

    def microporous(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: index of the microporous rock of the shape on top, -1 in clear fluid and solids."""
        x = self._wrapped(x)
        found = np.full(len(x), -1, dtype=np.int8)
        for shape in self.shapes:
            found[shape.signed_distance(x, self.period) <= self.round_off] = shape.microporous
        return found

    def interface_distance(self, x: np.ndarray, spacing: float) -> np.ndarray:
        """(n,) signed distance to where fluids 0 and 1 meet, m, > 0 in fluid 0; solids lie on it and end nothing.

        Exact except beyond the edges of shapes, where it is the distance to the nearest surface. Faces of shapes along
        walls are no interface (`FluidFaces`). spacing: of the particles, m.
        """
        x, whole = self._wrapped(x), True
        phi = np.full(len(x), np.inf if self.fluid == 0 else -np.inf)
        for shape in self.shapes:
            if shape.phase >= 0:
                faces = FluidFaces(shape.body, (self.lower, self.upper), self.period, self.phase, spacing)
                d = -faces.signed_distance(x) if shape.outside else faces.in_sight(x, self.crossing)
                phi, whole = np.maximum(phi, -d) if shape.phase == 0 else np.minimum(phi, d), whole and faces.whole
        # walls may hide a shape from a point: the sign is then that of its label
        return phi if whole else np.copysign(phi, np.where(self.phase(x) == 0, 1.0, -1.0))

    def distance(self, x: np.ndarray, depth: float = np.inf) -> np.ndarray:
        """(n,) signed distance to the wall, m; in solids beyond `depth`, m, to the nearest surface of a shape.

        Walls are where fluid meets solid, not where shapes of a kind touch. Exact where the nearest point of the
        wall lies on one surface or on an edge of planes; where it lies on an edge of curved surfaces that has
        several nearest points, never more than the distance to one of them and never less than that to the
        nearest surface of any shape.
        """
        return self._nearest(x, depth)[0]

    def wall(self, x: np.ndarray) -> np.ndarray:
        """(n,) int32 index of the face or shape whose surface gives `distance`; on a crossing point it is the
        wall that is met."""
        return self._nearest(x)[1]

    def nearest(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(`distance`, `wall`) of points, found together."""
        return self._nearest(x)

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """(n,) fraction t in (0, 1] from fluid point xi to xj at the first wall; 1.0 where none is met.

        Exact: the chords of the segment in the bodies cut it into parts, and the first part whose topmost
        shape is solid begins at t.
        """
        xi, xj = np.asarray(xi, float), np.asarray(xj, float)
        if not self.has_solid or not len(xi):
            return np.ones(len(xi))
        t = np.empty(len(xi))
        over_rows(put_crossings, len(xi), xi, xj, self._pieces(), t)
        return t

    def _pieces(self) -> PieceGrid:
        if self._grid is None:
            self._grid = PieceGrid.of(self)
        return self._grid

    def _wrapped(self, x: np.ndarray) -> np.ndarray:
        x = np.array(x, dtype=float, ndmin=2)
        for a in range(self.dim):
            if self.periodic[a]:
                x[:, a] = self.lower[a] + np.mod(x[:, a] - self.lower[a], self.period[a])
        return x

    def _nearest(self, x: np.ndarray, depth: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance and index of the wall that gives it; depth: see `distance`."""
        if len(x) > AT_ONCE:
            self._nearest(x[:1], depth)  # makes the lists that all parts look in
            parts = over_parts(lambda part: self._nearest(x[slice(*part)], depth), cut(len(x), -(-len(x) // AT_ONCE)))
            return np.concatenate([d for d, _ in parts]), np.concatenate([wall for _, wall in parts])
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
        # where balls that overlap are cut out of a solid, their surfaces within each other are none
        several = [s.outside and isinstance(s.body, Spheres) for s in self.shapes]
        is_wall = np.concatenate([np.ones(1 + 2 * self.dim, dtype=bool), bare & ~np.array(several, dtype=bool)])
        ask = np.flatnonzero(np.isfinite(d) & (d >= -depth) & ((d <= self.round_off) | ~is_wall[wall]))
        if len(ask) and self.shapes:
            near, owner = d[ask], wall[ask]
            over_rows(put_walls, len(ask), in_3d(x[ask]), near, owner, self._pieces())
            d[ask], wall[ask] = near, owner
        return d, wall


class PieceGrid(NamedTuple):
    """Convex pieces of a scene and their images, listed by the cells of a grid over the box; axes x, y, z.

    lower, edge (3,): of cells, m; counts, around (3,): cells and periodicity; start, entry: pieces of each
    cell; piece (m, 8): see `Region.pieces`; shape (m,): the shape each is of; origin, turns (m, 3): see
    `periodic_images`; solid, outside, sure: of each
    shape, sure: what is in its pieces is solid whatever the other shapes; dim: of the scene, whose third axis is a
    thin layer in 2D; filled: solid fills the box where no shape is; round_off, probe: m, lengths that are nothing, and
    how far from a point its surroundings are looked at.
    """

    lower: np.ndarray
    edge: np.ndarray
    counts: np.ndarray
    around: np.ndarray
    start: np.ndarray
    entry: np.ndarray
    piece: np.ndarray
    shape: np.ndarray
    origin: np.ndarray
    turns: np.ndarray
    solid: np.ndarray
    outside: np.ndarray
    sure: np.ndarray
    dim: int
    filled: bool
    round_off: float
    probe: float

    @classmethod
    def of(cls, geometry: ShapeGeometry) -> PieceGrid:
        """The grid of the shapes of a geometry: some CELLS_A_PIECE cells per piece, 500 along an axis at most."""
        lower, upper = np.zeros((2, 3))
        upper[:] = 2 * geometry.round_off  # the layer of a 2D scene
        lower[: geometry.dim], upper[: geometry.dim] = geometry.lower, geometry.upper
        lower[geometry.dim :] = -upper[geometry.dim :]
        around = np.array([*geometry.periodic, False][:3])
        of_shape = [s.body.pieces(geometry.period) for s in geometry.shapes]
        piece = np.concatenate([np.zeros((0, 8)), *of_shape])
        shape = np.repeat(np.arange(len(of_shape)), [len(p) for p in of_shape])
        piece, shape, origin, turns = periodic_images(piece, shape, lower, upper, around)
        size = upper - lower
        edge = (size[: geometry.dim].prod() / (CELLS_A_PIECE * max(len(piece), 1))) ** (1 / geometry.dim)
        counts = np.clip(np.round(size / edge), 1, 500).astype(np.int64)
        counts[geometry.dim :] = 1
        edge = size / counts
        solid = np.array([s.phase < 0 for s in geometry.shapes], dtype=np.bool_)
        outside = np.array([s.outside for s in geometry.shapes], dtype=np.bool_)
        sure = solid & ~outside & np.logical_and.accumulate(solid[::-1])[::-1]
        start, entry = fill_cells(piece, extent_of(piece), lower, edge, counts)
        return cls(lower, edge, counts, around, start, entry, piece, shape, origin, turns, solid, outside, sure,
                   geometry.dim, geometry.fluid < 0, geometry.round_off, PROBE / ROUND_OFF * geometry.round_off)


ON_FACE = 1000  # points at which the two sides of a periodic face are compared


def _same_beyond(geometry: ShapeGeometry, axis: int) -> bool:
    """Whether phases are equal on both sides of a periodic face: a shape that ends there goes on as another one."""
    x = geometry.lower + np.random.default_rng(0).random((ON_FACE, geometry.dim)) * (geometry.upper - geometry.lower)
    low, high = x.copy(), x.copy()
    low[:, axis], high[:, axis] = geometry.lower[axis], geometry.upper[axis]
    low[:, axis] += 10.0 * geometry.round_off
    high[:, axis] -= 10.0 * geometry.round_off
    return bool((geometry.phase(low) == geometry.phase(high)).all())


def _cut_planes(geometry: ShapeGeometry) -> Iterator[str]:
    """Half-spaces that end at a periodic face."""
    for k, shape in enumerate(geometry.shapes):
        if not isinstance(shape.body, HalfSpace):
            continue
        slope = np.abs(shape.body.unit_normal) > ROUND_OFF
        cut = [name for axis, (name, p, s) in enumerate(zip("xyz", geometry.periodic, slope))
               if p and s and not _same_beyond(geometry, axis)]
        if cut:
            yield (f"shape {k + 1}: the half-space is not periodic along {', '.join(cut)}: it ends at the periodic "
                   "face, where the distance to walls is not that to its end")  # fmt: skip
