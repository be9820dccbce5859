"""Means of a velocity over the cells of the lattice, those that walls cut too: sums of them are integrals.

Sums of the velocity at the particles are not: beside a wall they depend on how far from it the lattice lies, and of a
pipe five spacings across the flux is 0.8 % off though the velocities are right.

In each cell that a wall cuts the velocity is the quadratic function that fits best, by least squares, what is known
round the middle of the cell: the velocities of the particles in sight, their Laplacian by the momentum balance, and the
condition u = b du/dn (slip length b) at the points of walls that are nearest to the cells that walls cut. Between
planes, in pipes and in corners, where the velocity goes as the product of the distances to both walls, that is the flow
itself. A cell holds its mean of the function, zero beyond the wall, and so do cells whose middles lie in the solid.
"""

from __future__ import annotations

import itertools
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.halo import build_halo
from ..domain.neighbours import find_pairs
from ..domain.row_threads import over_rows
from ..geometry.wall_normals import wall_normals

if TYPE_CHECKING:
    from ..domain.cut import Share
    from ..domain.lattice import Lattice
    from ..geometry.protocol import Geometry

CELLS_AT_ONCE = 100_000  # cells whose neighbours are found in one go: 40 MB
# Widths of a cell along the normal of a wall below this share of the widest count as none: off by the square of it
FLAT = 1e-4
# Added to the diagonal of the least squares, over its largest entry: what neither particles nor walls tell becomes
# zero. The flux of slits is exact to 1e-9 with it
UNKNOWN = 1e-10
WALLS = 2.0  # weight of the point of a wall over that of a particle as far away: its velocity is exact
# Cosine between the normals of two walls that may lie behind each other's planes, as round a grain. With 0 particles
# behind narrow beads are seen: of beads of 1.7 spacings (cases/bead_pack.yaml, particles.spacing=3e-4) the flux is 2.1
# times that by the nearest wall alone, with 0.5 1.3 times
ALIKE = 0.5
SIGHT = 1e-3  # of the support, that a point may lie behind the plane of a wall: normals are those of differences


class CellMeans(NamedTuple):
    """Means over cells: fluid (n, dim), of those of the fluid particles; solid (m, dim), of those whose middles lie in
    a solid, x (m, dim) m their places within the box, rows (m,) their numbers among all particles; cut: whether cells
    may hold solid beside fluid."""

    fluid: np.ndarray
    solid: np.ndarray
    x: np.ndarray
    rows: np.ndarray
    cut: bool

    @staticmethod
    def whole(fluid: np.ndarray) -> CellMeans:
        """Those of cells that walls do not cut."""
        return CellMeans(fluid, fluid[:0], fluid[:0], np.zeros(0, int), False)

    def everywhere(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places and means of all cells, those of the fluid particles, at x (n, dim), first."""
        return np.concatenate([x, self.x]), np.concatenate([self.fluid, self.solid])


class BesideWalls(NamedTuple):
    """Points beside walls, as the kernel takes them: x (n, dim) m; distance (n,) m, signed; normal (n, dim) into the
    fluid; slip (n,) m, slip length of the wall; edge (n,), of their cells over those of the lattice; cut (n,), whether
    a wall cuts these."""

    x: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    slip: np.ndarray
    edge: np.ndarray
    cut: np.ndarray

    def of(self, rows: slice | np.ndarray) -> BesideWalls:
        """Those of some rows."""
        return BesideWalls(*(values[rows] for values in self))


class Parts(NamedTuple):
    """The parts of a cell, halves along each of m directions, and the cell: middles (2^m, dim) m, from that of the
    cell; ways (m, dim) m, of the parts; scale: m, the support; spread: m2, mean square of the way from
    the middle of a part along an axis."""

    middles: np.ndarray
    ways: np.ndarray
    scale: float
    spread: float


def directions(lattice: Lattice) -> np.ndarray:
    """(m, dim) m, of the box spline whose translates to the sites of a lattice add up to one everywhere, so that it is
    the cell of a site: the edges of the cell, or the ways to the nearest neighbours where it has a second site in its
    middle (de Boor, Hoellig and Riemenschneider 1993, Box Splines, chapter II)."""
    dim = len(lattice.cell)
    if len(lattice.basis) == 1:
        return np.diag(lattice.cell)
    half = 0.5 * np.array([[1, 1], [1, -1], [2, 0]] if dim == 2 else [[1, 1, 1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]])
    return half * lattice.cell


def means_over_cells(geometry: Geometry, x: np.ndarray, lattice: Lattice, support: float,
                     flow: tuple[np.ndarray, np.ndarray], share: Share | None = None,
                     edge: np.ndarray | None = None) -> CellMeans:
    """Means over the cells of particles that sit on a lattice; where walls move, the velocities themselves.

    x: (all, dim) m, the n fluid particles, then dummies; support: m; flow: velocity (n, dim) m/s and its Laplacian,
    1/(m s), by the momentum balance; share: of this process, where there are several; edge: of the cell of each fluid
    particle, remote one, dummy and remote dummy over that of the lattice, 1 at most, and without it.
    """
    if edge is None:
        edge = np.ones(len(x) if share is None else len(x) + len(share.ghosts) + len(share.dummies))
    if geometry.level_walls and geometry.voxel_size is not None:
        return _faces_of_voxels(geometry.lower, geometry.voxel_size, lattice, flow, edge)
    n, ways = len(flow[0]), directions(lattice)
    if np.any(geometry.wall_speed):
        return CellMeans.whole(flow[0])
    spread = float((ways**2).sum()) / (12.0 * len(lattice.cell))
    fluid = flow[0] + flow[1] * (0.5 * spread * edge[:n, None] ** 2)
    source, seen, own, row = _beside_walls(geometry, x, support, flow, (share, edge, _reach(ways)))
    cells = source.of(own)
    signs = np.array(list(itertools.product((-0.25, 0.25), repeat=len(ways))))
    parts = Parts(signs @ ways, 0.5 * ways, support, 0.25 * spread)
    images = build_halo(source.x, geometry.lower, geometry.upper, np.array(geometry.periodic), support,
                        None if share is None else (share.lower, share.upper))
    table, owner = images.positions(source.x), images.owners(len(source.x))
    found = np.zeros_like(cells.x)
    for first in range(0, len(found), CELLS_AT_ONCE):
        part = slice(first, first + CELLS_AT_ONCE)
        beside = cells.of(part)
        pairs = find_pairs(np.concatenate([beside.x, table]), len(beside.x), support)
        over_rows(_means, len(beside.x), (pairs.start, pairs.index), (beside, _of_parts(geometry, beside, parts)),
                  (source, table, owner, seen), parts, (own[part], found[part]),
                  work=partial(_room, len(parts.middles), *ways.shape))
    inside = row < n
    fluid[row[inside]] = found[inside]
    at = np.clip(cells.x[~inside], geometry.lower, geometry.upper)
    return CellMeans(fluid, found[~inside], at, row[~inside], True)


def _faces_of_voxels(lower: np.ndarray, voxel: np.ndarray, lattice: Lattice, flow: tuple[np.ndarray, np.ndarray],
                     edge: np.ndarray) -> CellMeans:
    """Of walls that are faces of voxels of edges (dim,), m, from a corner of the box (dim,) on: sums over the planes of
    a lattice are by midpoints where whole steps between planes fill a voxel from face to face. Where they do not, the
    edges of voxels cut cells in ways that one plane is not, and nothing is added."""
    velocity, laplacian = flow
    out = velocity.copy()
    for size in np.unique(edge):
        step = lattice.cell * (size / len(lattice.basis))  # two sites of a cell are in planes of their own
        steps = voxel / step, (lattice.corner - lower) / step
        if all(np.allclose(n, np.maximum(np.round(n), least), rtol=1e-6, atol=1e-6)
               for n, least in zip(steps, (1.0, -np.inf))):
            rows = edge[: len(out)] == size
            out[rows] += laplacian[rows] * (float(step.mean()) ** 2 / 24.0)
    return CellMeans.whole(out)


def _of_parts(geometry: Geometry, cells: BesideWalls, parts: Parts) -> np.ndarray:
    """Wall distances (n, 2^m), m, of the middles of the parts of cells. Another wall may be nearer there than that of
    the middle. Parts that reach no fluid have any distance beyond that."""
    reach = _reach(parts.ways)
    return np.stack([geometry.distance(cells.x + cells.edge[:, None] * way, reach) for way in parts.middles], axis=1)


def _reach(ways: np.ndarray) -> float:
    """Farthest from its middle that a cell of these directions (m, dim) reaches, m."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=len(ways)))) @ ways
    return float(np.sqrt((corners**2).sum(axis=1)).max())


def _beside_walls(
    geometry: Geometry, x: np.ndarray, support: float, flow: tuple[np.ndarray, np.ndarray],
    cells: tuple[Share | None, np.ndarray, float],
) -> tuple[BesideWalls, np.ndarray, np.ndarray, np.ndarray]:
    """Fluid particles within a support of a wall, then dummies whose cells walls cut, remote ones of both too; the
    velocity beside its Laplacian of the former, (m, 2 dim); of the cells of this process that walls cut the numbers
    among these points and among its particles, (k,). cells: share, edge as above, and how far the cell of the lattice
    reaches, m."""
    (share, edge, reach), n = cells, len(flow[0])
    both, row = np.concatenate(flow, axis=1), np.arange(len(x))
    if share is not None:
        x = np.concatenate([x[:n], share.ghosts, x[n:], share.dummies])
        row = np.concatenate([row[:n], np.full(len(share.ghosts), -1), row[n:], np.full(len(share.dummies), -1)])
        both = share.exchange.forward(both)
    distance, fluid = geometry.distance(x, support), np.arange(len(x)) < len(both)
    cut = np.abs(distance) < edge * reach
    asked = np.flatnonzero(cut | (fluid & (distance < support)))
    slips = np.any(geometry.slip_length > 0.0)
    slip = geometry.slip_length[geometry.wall(x[asked])] if slips else np.zeros(len(asked))
    beside = BesideWalls(x[asked], distance[asked], wall_normals(geometry, x[asked], support), slip, edge[asked],
                         cut[asked])
    own = np.flatnonzero(cut[asked] & (row[asked] >= 0))
    return beside, both[asked[fluid[asked]]], own, row[asked[own]]


class Room(NamedTuple):
    """Scratch of `_means`: matrix (m, m) and right (m, dim) of the least squares of m coefficients, 1, x, y, z, xx, xy,
    ... over the radius, and basis (m,), what each is at a point; way, value, laplacian (dim,); nearest (parts,)
    and normal (parts, dim), of the point of a wall nearest to each part; half (directions,); means (3,)."""

    matrix: np.ndarray
    right: np.ndarray
    basis: np.ndarray
    way: np.ndarray
    value: np.ndarray
    laplacian: np.ndarray
    nearest: np.ndarray
    normal: np.ndarray
    half: np.ndarray
    means: np.ndarray


def _room(parts: int, directions: int, dim: int) -> Room:
    m = (dim + 1) * (dim + 2) // 2
    shapes = (m, m), (m, dim), (m,), (dim,), (dim,), (dim,), (parts,), (parts, dim), (directions,), (3,)
    return Room(*(np.zeros(shape) for shape in shapes))


@njit(cache=True, nogil=True, error_model="numpy")
def _means(rows, room, pairs, cut, sources, parts, out):  # pragma: no cover
    """Mean over the cell of the quadratic function of the module, zero in solids."""
    (start, index), (cells, depth), (source, table, owner, seen), (itself, mean) = pairs, cut, sources, out
    n, dim = cells.x.shape
    for i in range(rows[0], rows[1]):
        radius, total, known = parts.scale * cells.edge[i], 0.0, 0.0
        _clear(room)
        for p in range(start[i], start[i + 1]):
            row = index[p] - n
            if row < 0:
                continue
            j = owner[row]
            if _hidden(cells, i, source, j, table[row], parts.scale):
                continue
            for wall in range(2):  # the velocity of the particle, then the point of the wall that is nearest to it
                if not (source.cut[j] if wall else j < len(seen)):
                    continue
                beyond, slip, away = wall * source.distance[j] / radius, wall * source.slip[j] / radius, 0.0
                for k in range(dim):
                    room.way[k] = (table[row, k] - cells.x[i, k]) / radius - beyond * source.normal[j, k]
                    room.value[k] = 0.0 if wall else seen[j, k]
                    away += room.way[k] ** 2
                if away >= 1.0:
                    continue
                weight = (1.0 - away) ** 3 * (WALLS / (1.0 + slip) ** 2 if wall else 1.0)
                _put(room, source.normal[j], slip)
                known += _add_row(room, weight)
                if wall:
                    _nearest(room, parts, cells.edge[i] / radius, source.normal[j])
                    continue
                total += weight
                for k in range(dim):
                    room.laplacian[k] += weight * seen[j, dim + k]
        if total == 0.0:
            continue
        for q in range(len(room.basis)):
            room.basis[q] = 0.0
        for k in range(dim):  # what the Laplacian makes of the velocity over half the radius, as that of one particle
            room.basis[1 + dim + k * dim - k * (k - 1) // 2] = 0.5
            room.value[k] = 0.25 * radius * radius * room.laplacian[k] / total
        left = known + _add_row(room, 1.0) - _solve(room.matrix, room.right)
        whole = _integrate(room, cells.edge[i], depth[i], parts, radius, mean[i])
        if itself[i] < len(seen):  # what the function leaves of the velocity in the middle: it vanishes at the wall
            whole *= min(1.0, cells.distance[i] / (cells.edge[i] * np.sqrt(12.0 * parts.spread)))
            for k in range(dim):
                mean[i, k] += whole * (seen[itself[i], k] - room.right[0, k])
        # in pores of less than a particle, with others in sight, velocities are no quadratic function: the cell has the
        # velocity of its particle then, or none. By the fourth power of the share that the function leaves of their
        # squares, so that the mean is its own where it says something of them
        unlike = min(max(left / known, 0.0), 1.0) ** 4 if known > 0.0 else 0.0
        for k in range(dim):
            mean[i, k] += unlike * ((seen[itself[i], k] if itself[i] < len(seen) else 0.0) - mean[i, k])


@njit(cache=True, nogil=True, error_model="numpy")
def _clear(room):  # pragma: no cover
    """All that is summed up over neighbours, of the next cell."""
    for q in range(len(room.basis)):
        for k in range(len(room.value)):
            room.right[q, k] = 0.0
        for r in range(q + 1):
            room.matrix[q, r] = 0.0
    for k in range(len(room.value)):
        room.laplacian[k] = 0.0
    for part in range(len(room.nearest)):
        room.nearest[part] = np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _hidden(cells, i, source, j, x, support):  # pragma: no cover
    """Whether the cell i and a point j at x (dim,) hide from each other: each behind the plane of the wall of the
    other, and their normals more than 60 degrees apart. Round a grain walls fall behind the planes of each other and
    are seen."""
    along, before, behind = 0.0, 0.0, 0.0
    inside = min(cells.distance[i], 0.0)
    for k in range(len(x)):
        own, other = cells.normal[i, k], source.normal[j, k]
        wall = cells.x[i, k] - cells.distance[i] * own
        along += own * other
        before += (x[k] - min(source.distance[j], 0.0) * other - wall) * own
        behind += (cells.x[i, k] - inside * own - x[k] + source.distance[j] * other) * other
    return along <= ALIKE and min(before, behind) < -SIGHT * support * cells.edge[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _put(room, normal, slip):  # pragma: no cover
    """The basis at the way from the middle less slip times its slope along the normal."""
    way, dim, q = room.way, len(room.way), 1 + len(room.way)
    room.basis[0] = 1.0
    for k in range(dim):
        room.basis[1 + k] = way[k] - slip * normal[k]
        for m in range(k, dim):
            room.basis[q] = way[k] * way[m] - slip * (normal[k] * way[m] + way[k] * normal[m])
            q += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _add_row(room, weight):  # pragma: no cover
    """Adds that the coefficients times the basis are the value; returns the square of this by its weight."""
    square = 0.0
    for k in range(len(room.value)):
        square += weight * room.value[k] ** 2
    for a in range(len(room.basis)):
        one = weight * room.basis[a]
        for k in range(len(room.value)):
            room.right[a, k] += one * room.value[k]
        for b in range(a + 1):
            room.matrix[a, b] += one * room.basis[b]
    return square


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(room, parts, scale, normal):  # pragma: no cover
    """Of each part the nearest point of a wall so far, and its normal."""
    for part in range(len(parts.middles)):
        away = 0.0
        for k in range(len(normal)):
            away += (room.way[k] - scale * parts.middles[part, k]) ** 2
        if away < room.nearest[part]:
            room.nearest[part] = away
            for k in range(len(normal)):
                room.normal[part, k] = normal[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(matrix, right):  # pragma: no cover
    """right becomes the solution, by Cholesky factors of the matrix, whose lower half is given; returns what the
    solution has of the sum of the squares of all values."""
    size, largest, found = len(matrix), 0.0, 0.0
    for a in range(size):
        largest = max(largest, matrix[a, a])
    for a in range(size):
        matrix[a, a] += UNKNOWN * largest
        for b in range(a + 1):
            rest = matrix[a, b]
            for c in range(b):
                rest -= matrix[a, c] * matrix[b, c]
            matrix[a, b] = rest / matrix[b, b] if b < a else np.sqrt(rest)
    for turn in range(2 * size):  # there, and back again
        a = turn if turn < size else 2 * size - 1 - turn
        for k in range(right.shape[1]):
            rest = right[a, k]
            for b in range(0 if turn < size else a + 1, a if turn < size else size):
                rest -= (matrix[a, b] if turn < size else matrix[b, a]) * right[b, k]
            right[a, k] = rest / matrix[a, a]
            if turn < size:
                found += right[a, k] ** 2
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _integrate(room, edge, depth, parts, radius, mean):  # pragma: no cover
    """Adds the mean of the function over a cell to `mean` (dim,); returns the share of fluid. In each part it is taken
    along the normal of the wall, and what it bends by along the wall is added."""
    dim, count, whole = len(mean), len(depth), 0.0
    for part in range(count):
        normal = room.normal[part]
        room.means[0], room.means[1], room.means[2] = 0.0, 0.0, 0.0
        _add_means(depth[part], normal, parts.ways, edge, room.half, room.means)
        share = room.means[0] / count
        if share == 0.0:
            continue
        whole += share
        # of the way along the normal from the middle of the part, over the radius, and of its square
        first = room.means[1] / count - share * depth[part]
        second = (room.means[2] / count - depth[part] * (first + room.means[1] / count)) / radius**2
        first /= radius
        for k in range(dim):
            room.way[k] = edge * parts.middles[part, k] / radius
        _put(room, normal, 0.0)
        for c in range(dim):
            value, slope, bend, laplacian, q = 0.0, 0.0, 0.0, 0.0, 1 + dim
            for a in range(len(room.basis)):
                value += room.basis[a] * room.right[a, c]
            for k in range(dim):
                slope += room.right[1 + k, c] * normal[k]
                for m in range(k, dim):
                    factor = room.right[q, c]
                    slope += factor * (normal[k] * room.way[m] + room.way[k] * normal[m])
                    bend += 2.0 * factor * normal[k] * normal[m]
                    laplacian += 2.0 * factor if k == m else 0.0
                    q += 1
            mean[c] += (share * value + first * slope + 0.5 * second * bend
                        + 0.5 * share * (laplacian - bend) * parts.spread * (edge / radius) ** 2)
    return whole


@njit(cache=True, nogil=True, error_model="numpy")
def _add_means(distance, normal, ways, edge, half, means):  # pragma: no cover
    """Adds the means of 1, s and s^2 over a box spline, zero where s < 0: s = distance + T, where T is the sum of one
    uniform part for each direction. half: room for their half widths."""
    widest = 0.0
    for k in range(len(ways)):
        half[k] = 0.0
        for axis in range(len(normal)):
            half[k] += 0.5 * edge * ways[k, axis] * normal[axis]
        half[k] = abs(half[k])
        widest = max(widest, half[k])
    parts, product = 0, 1.0
    for k in range(len(ways)):
        if half[k] > FLAT * widest:
            half[parts] = half[k]
            product *= 2.0 * half[k]
            parts += 1
    # integrals of the powers of max(s, 0), as many times as there are parts, between the ends of each
    for corner in range(2**parts):
        at, sign = distance, 1.0 / product
        for k in range(parts):
            if corner >> k & 1:
                at, sign = at - half[k], -sign
            else:
                at += half[k]
        if at > 0.0:
            power = sign
            for k in range(1, parts + 1):
                power *= at / k
            means[0] += power
            means[1] += power * at / (parts + 1)
            means[2] += 2.0 * power * at * at / ((parts + 1) * (parts + 2))
