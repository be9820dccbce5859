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
from ..domain.neighbours import cell_list, pairs_of
from ..domain.row_threads import REDUCE, in_one_piece, over_rows
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
    cells = source.of(slice(*own))
    signs = np.array(list(itertools.product((-0.25, 0.25), repeat=len(ways))))
    parts = Parts(signs @ ways, 0.5 * ways, support, 0.25 * spread)
    images = build_halo(source.x, geometry.lower, geometry.upper, np.array(geometry.periodic), support,
                        None if share is None else (share.lower, share.upper))
    table, owner = images.positions(source.x), images.owners(len(source.x))
    found = np.zeros_like(cells.x)
    grid = cell_list(table, support)
    for first in range(own[0], own[1], CELLS_AT_ONCE):
        rows = first, min(first + CELLS_AT_ONCE, own[1])
        beside, pairs = source.of(slice(*rows)), pairs_of(table, grid, rows, support)
        most = 2 + 2 * pairs.longest  # equations: a velocity and a point of a wall of each, and of the cell's own
        over_rows(_means, len(beside.x), (pairs.start, pairs.index), (beside, _of_parts(geometry, beside, parts)),
                  (source, table, owner, seen), parts, (first, found[first - own[0] : rows[1] - own[0]]),
                  work=partial(_room, most, *ways.shape))
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
) -> tuple[BesideWalls, np.ndarray, tuple[int, int], np.ndarray]:
    """Fluid particles within a support of a wall, then dummies whose cells walls cut, remote ones of both too; the
    velocity beside its Laplacian of the former, (m, 2 dim); the range of the cells of this process that walls cut among
    these points, and their numbers (k,) among its particles. cells: share, edge as above, and how far the cell of the
    lattice reaches, m."""
    (share, edge, reach), n = cells, len(flow[0])
    both, row = np.concatenate(flow, axis=1), np.arange(len(x))
    if share is not None:
        x = np.concatenate([x[:n], share.ghosts, x[n:], share.dummies])
        row = np.concatenate([row[:n], np.full(len(share.ghosts), -1), row[n:], np.full(len(share.dummies), -1)])
        both = share.exchange.forward(both)
    distance, fluid = geometry.distance(x, support), np.arange(len(x)) < len(both)
    cut = np.abs(distance) < edge * reach
    asked = np.flatnonzero(cut | (fluid & (distance < support)))
    # cells of this process that walls cut stand together, behind the other fluid particles and before the other dummies
    own = cut & (row >= 0)
    place = np.where(fluid, np.where(own, 1, 0), np.where(own, 2, 3))[asked]
    order = np.argsort(place, kind="stable")
    asked, (first, last) = asked[order], np.searchsorted(place[order], (1, 3)).tolist()
    slips = np.any(geometry.slip_length > 0.0)
    slip = geometry.slip_length[geometry.wall(x[asked])] if slips else np.zeros(len(asked))
    beside = BesideWalls(x[asked], distance[asked], wall_normals(geometry, x[asked], support), slip, edge[asked],
                         cut[asked])
    return beside, both[asked[fluid[asked]]], (first, last), row[asked[first:last]]


class Room(NamedTuple):
    """Scratch of `_means`: of the equations of a cell, `most` at most, way (3, most), from its middle over the radius,
    0 along an axis that there is not, slip (3, most), slip length times normal over it, value (dim, most) and weight
    (most,); basis (m, most), what each of the m coefficients, 1, x, y, z, xx, xy, ... over the radius, has for a
    factor, and weighed (most,) one of them by the weight; foot (3, most), way of the points of walls, and normal
    (3, most) of these; matrix (m, m) and right (m, dim) of the least squares; laplacian (dim,); half (directions,)."""

    way: np.ndarray
    slip: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    basis: np.ndarray
    weighed: np.ndarray
    foot: np.ndarray
    normal: np.ndarray
    matrix: np.ndarray
    right: np.ndarray
    laplacian: np.ndarray
    half: np.ndarray


def _room(most: int, directions: int, dim: int) -> Room:
    m = (dim + 1) * (dim + 2) // 2
    ways = (3, most)
    return Room(*in_one_piece(ways, ways, (dim, most), (most,), (m, most), (most,), ways, ways, (m, m), (m, dim),
                              (dim,), (directions,)))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REDUCE)
def _means(rows, room, pairs, cut, sources, parts, out):  # pragma: no cover
    """Mean over the cell of the quadratic function of the module, zero in solids."""
    (cells, depth), (_, _, _, seen), (begin, mean) = cut, sources, out
    dim = mean.shape[1]
    for i in range(rows[0], rows[1]):
        radius, itself = parts.scale * cells.edge[i], begin + i
        count, walls, total = _gather(room, i, itself, pairs, cells, sources, radius)
        if total == 0.0:
            continue
        known = _equations(room, count)
        left = known
        # what the Laplacian makes of the velocity over half the radius, as that of one particle
        for k in range(dim):
            q, value = 1 + dim + k * dim - k * (k - 1) // 2, 0.25 * radius * radius * room.laplacian[k] / total
            left += value * value
            for m in range(dim):
                r = 1 + dim + m * dim - m * (m - 1) // 2
                room.right[q, m] += 0.5 * (0.25 * radius * radius * room.laplacian[m] / total)
                if r <= q:
                    room.matrix[q, r] += 0.25
        left -= _solve(room.matrix, room.right)
        whole = _integrate(room, walls, cells.edge[i], depth[i], parts, radius, mean[i])
        if itself < len(seen):  # what the function leaves of the velocity in the middle: it vanishes at the wall
            whole *= min(1.0, cells.distance[i] / (cells.edge[i] * np.sqrt(12.0 * parts.spread)))
            for k in range(dim):
                mean[i, k] += whole * (seen[itself, k] - room.right[0, k])
        # in pores of less than a particle, with others in sight, velocities are no quadratic function: the cell has the
        # velocity of its particle then, or none. By the fourth power of the share that the function leaves of their
        # squares, so that the mean is its own where it says something of them
        unlike = min(max(left / known, 0.0), 1.0) ** 4 if known > 0.0 else 0.0
        for k in range(dim):
            mean[i, k] += unlike * ((seen[itself, k] if itself < len(seen) else 0.0) - mean[i, k])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _gather(room, i, itself, pairs, cells, sources, radius):  # pragma: no cover
    """The equations of the cell i, of the point `itself` and its neighbours: their number, that of points of walls
    among them, and the weight of all particles, whose Laplacians are summed up by it. Indices are unsigned: loops need
    no check for those that count from the end.

    Hidden are neighbours where each lies behind the plane of the wall of the other and their normals are more than 60
    degrees apart. Round a grain walls fall behind the planes of each other and are seen."""
    (start, index), (source, table, owner, seen) = pairs, sources
    count, walls, total, dim = np.uint64(0), np.uint64(0), 0.0, cells.x.shape[1]
    last, deep, scale = dim - 1, dim - 2, 1.0 / radius
    x0, x1, x2 = cells.x[i, 0], cells.x[i, 1], cells.x[i, last]
    n0, n1, n2, depth = cells.normal[i, 0], cells.normal[i, 1], deep * cells.normal[i, last], cells.distance[i]
    for k in range(dim):
        room.laplacian[k] = 0.0
    for p in range(np.uint64(start[i]), np.uint64(start[i + 1] + 1)):
        row = np.uint64(index[p] if p < start[i + 1] else itself)
        j = np.uint64(owner[row])
        d0, d1, d2 = table[row, 0] - x0, table[row, 1] - x1, deep * (table[row, last] - x2)
        m0, m1, m2 = source.normal[j, 0], source.normal[j, 1], deep * source.normal[j, last]
        away, along = source.distance[j], n0 * m0 + n1 * m1 + n2 * m2
        before = n0 * d0 + n1 * d1 + n2 * d2 + depth - min(away, 0.0) * along
        behind = away - m0 * d0 - m1 * d1 - m2 * d2 - min(depth, 0.0) * along
        if along <= ALIKE and min(before, behind) < -SIGHT * radius:
            continue
        for wall in range(2):  # the velocity of the particle, then the point of the wall that is nearest to it
            if not (source.cut[j] if wall else j < len(seen)):
                continue
            if wall:
                d0, d1, d2 = d0 - away * m0, d1 - away * m1, d2 - away * m2
            square = (d0 * d0 + d1 * d1 + d2 * d2) * scale * scale
            if square >= 1.0:
                continue
            slip = source.slip[j] * scale if wall else 0.0
            weight = (1.0 - square) ** 3 * (WALLS / (1.0 + slip) ** 2 if wall else 1.0)
            room.way[0, count], room.way[1, count], room.way[2, count] = d0 * scale, d1 * scale, d2 * scale
            room.slip[0, count], room.slip[1, count], room.slip[2, count] = slip * m0, slip * m1, slip * m2
            room.weight[count] = weight
            for k in range(dim):
                room.value[k, count] = 0.0 if wall else seen[j, k]
            if wall:
                room.foot[0, walls], room.foot[1, walls], room.foot[2, walls] = d0 * scale, d1 * scale, d2 * scale
                room.normal[0, walls], room.normal[1, walls], room.normal[2, walls] = m0, m1, m2
                walls += np.uint64(1)
            else:
                total += weight
                for k in range(dim):
                    room.laplacian[k] += weight * seen[j, dim + k]
            count += np.uint64(1)
    return np.int64(count), np.int64(walls), total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _equations(room, count):  # pragma: no cover
    """Sums the equations up, that the coefficients times the basis are the value; returns the sum of the squares of
    the values by their weights. The basis is that of the way, less slip times its slope along the normal."""
    dim, known, q = len(room.value), 0.0, 1 + len(room.value)
    for r in range(count):
        room.basis[0, r] = 1.0
    for k in range(dim):
        for r in range(count):
            room.basis[1 + k, r] = room.way[k, r] - room.slip[k, r]
            known += room.weight[r] * room.value[k, r] ** 2
        for m in range(k, dim):
            for r in range(count):
                room.basis[q, r] = (room.way[k, r] * room.way[m, r] - room.slip[k, r] * room.way[m, r]
                                    - room.way[k, r] * room.slip[m, r])
            q += 1
    for a in range(len(room.basis)):
        for r in range(count):
            room.weighed[r] = room.weight[r] * room.basis[a, r]
        for k in range(dim):
            total = 0.0
            for r in range(count):
                total += room.weighed[r] * room.value[k, r]
            room.right[a, k] = total
        for b in range(a + 1):
            total = 0.0
            for r in range(count):
                total += room.weighed[r] * room.basis[b, r]
            room.matrix[a, b] = total
    return known


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _integrate(room, walls, edge, depth, parts, radius, mean):  # pragma: no cover
    """Adds the mean of the function over a cell to `mean` (dim,); returns the share of fluid. In each part it is taken
    along the normal of the wall that is nearest to it, and what it bends by along the wall is added."""
    dim, count, whole, scale, right = len(mean), len(depth), 0.0, edge / radius, room.right
    last, deep = dim - 1, dim - 2
    for part in range(count):
        w0, w1 = scale * parts.middles[part, 0], scale * parts.middles[part, 1]
        w2 = deep * scale * parts.middles[part, last]
        nearest, least = np.uint64(0), np.inf
        for w in range(np.uint64(walls)):
            away = (room.foot[0, w] - w0) ** 2 + (room.foot[1, w] - w1) ** 2 + (room.foot[2, w] - w2) ** 2
            if away < least:
                nearest, least = np.uint64(w), away
        n0, n1, n2 = room.normal[0, nearest], room.normal[1, nearest], room.normal[2, nearest]
        fluid, along, square = _mean_powers(depth[part], (n0, n1, n2), parts.ways, edge, room.half)
        share = fluid / count
        if share == 0.0:
            continue
        whole += share
        # of the way along the normal from the middle of the part, over the radius, and of its square
        first = along / count - share * depth[part]
        second = (square / count - depth[part] * (first + along / count)) / radius**2
        first /= radius
        spread = 0.5 * share * parts.spread * scale * scale
        for c in range(dim):
            value = right[0, c] + w0 * right[1, c] + w1 * right[2, c]
            slope = n0 * right[1, c] + n1 * right[2, c]
            if deep:
                h0, h1, h2, h3, h4, h5 = (right[4, c], right[5, c], right[6, c], right[7, c], right[8, c], right[9, c])
                value += w2 * right[3, c]
                slope += n2 * right[3, c]
            else:
                h0, h1, h2, h3, h4, h5 = right[3, c], right[4, c], 0.0, right[5, c], 0.0, 0.0
            # the function is h0 x x + h1 x y + h2 x z + h3 y y + h4 y z + h5 z z to second order
            value += w0 * (h0 * w0 + h1 * w1 + h2 * w2) + w1 * (h3 * w1 + h4 * w2) + h5 * w2 * w2
            slope += (n0 * (2.0 * h0 * w0 + h1 * w1 + h2 * w2) + n1 * (h1 * w0 + 2.0 * h3 * w1 + h4 * w2)
                      + n2 * (h2 * w0 + h4 * w1 + 2.0 * h5 * w2))
            bend = 2.0 * (n0 * (h0 * n0 + h1 * n1 + h2 * n2) + n1 * (h3 * n1 + h4 * n2) + h5 * n2 * n2)
            mean[c] += (share * value + first * slope + 0.5 * second * bend
                        + spread * (2.0 * (h0 + h3 + h5) - bend))
    return whole


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _mean_powers(distance, normal, ways, edge, half):  # pragma: no cover
    """Means of 1, s and s^2 over a box spline of directions ways (m, dim) times edge, zero where s < 0: s = distance +
    T along the normal, where T is the sum of one uniform part for each direction. half (m,): room for half of these."""
    widest, last, (n0, n1, n2) = 0.0, ways.shape[1] - 1, normal
    for k in range(len(ways)):
        half[k] = abs(0.5 * edge * (ways[k, 0] * n0 + ways[k, 1] * n1 + ways[k, last] * n2))
        widest = max(widest, half[k])
    parts, product = np.uint64(0), 1.0
    for k in range(len(ways)):
        if half[k] > FLAT * widest:
            half[parts] = half[k]
            product *= 2.0 * half[k]
            parts += np.uint64(1)
    # integrals of the powers of max(s, 0), as many times as there are parts, between the ends of each
    zero, one, two = 0.0, 0.0, 0.0
    for corner in range(2 ** np.int64(parts)):
        at, sign, odd = distance, 1.0 / product, corner
        for k in range(parts):
            side = 1.0 - 2.0 * (odd & 1)
            at, sign, odd = at + side * half[k], sign * side, odd >> 1
        at = max(at, 0.0)
        power = sign * at if parts % 2 else sign * (at > 0.0)
        if parts > 1:
            power *= at * at
        if parts > 3:
            power *= at * at
        zero, one, two = zero + power, one + power * at, two + power * at * at
    for k in range(2, parts + 1):
        zero, one, two = zero / k, one / k, two / k
    return zero, one / (parts + 1), 2.0 * two / ((parts + 1) * (parts + 2))
