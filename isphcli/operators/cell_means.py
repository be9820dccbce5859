"""Means of a velocity over the cells of the lattice, those that walls cut too: sums of them are integrals.

Sums of the velocity at the particles are not: beside a wall they depend on how far from it the lattice lies, and of a
pipe five spacings across the flux is 0.8 % off though the velocities are right.

Beside a wall at the distance s the velocity is f(s) = g (s + b) + lap u s^2 / 2, with the slip length b and the slope g
at the wall, found from the particles beside it. A cell holds its mean of f, zero beyond the wall, and so do cells whose
middles lie in the solid.
"""

from __future__ import annotations

import itertools
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
    fluid; slip (n,) m, slip length of the wall; edge (n,), of their cells over those of the lattice."""

    x: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    slip: np.ndarray
    edge: np.ndarray

    def of(self, rows: slice | np.ndarray) -> BesideWalls:
        """Those of some rows."""
        return BesideWalls(*(values[rows] for values in self))


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
    1/(m s), by the momentum balance; share: of this process, where there are several; edge: (all,), of the cell of each
    particle over that of the lattice, 1 without it.
    """
    edge = np.ones(len(x)) if edge is None else edge
    if geometry.level_walls and geometry.voxel_size is not None:
        return _faces_of_voxels(geometry.lower, geometry.voxel_size, lattice, flow, edge)
    n, ways = len(flow[0]), directions(lattice)
    if np.any(geometry.wall_speed):
        return CellMeans.whole(flow[0])
    moment = float((ways**2).sum()) / (12.0 * len(lattice.cell))
    fluid = flow[0] + flow[1] * (0.5 * moment * edge[:n, None] ** 2)
    source, seen, cells, cut = _beside_walls(geometry, x, support, flow, (share, edge, _reach(ways)))
    places = cells.x
    images = build_halo(source.x, geometry.lower, geometry.upper, np.array(geometry.periodic), support,
                        None if share is None else (share.lower, share.upper))
    table, owner = images.positions(source.x), images.owners(len(source.x))
    found = np.zeros_like(places)
    for first in range(0, len(cut), CELLS_AT_ONCE):
        part = slice(first, first + CELLS_AT_ONCE)
        pairs = find_pairs(np.concatenate([places[part], table]), len(places[part]), support)
        beside = cells.of(part)
        over_rows(_means, len(places[part]), (pairs.start, pairs.index), (beside, _of_parts(geometry, beside, ways)),
                  (source, table, owner, seen), 0.5 * ways, support, found[part])
    inside = cut < n
    fluid[cut[inside]] = flow[0][cut[inside]] + found[inside]
    at = np.clip(places[~inside], geometry.lower, geometry.upper)
    return CellMeans(fluid, found[~inside], at, cut[~inside], True)


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


def _of_parts(geometry: Geometry, cells: BesideWalls, ways: np.ndarray) -> np.ndarray:
    """Wall distances (n, 2^m), m, of the middles of the parts of cells: halves along each of the m directions. Another
    wall may be nearer there than that of the middle."""
    signs = np.array(list(itertools.product((-0.25, 0.25), repeat=len(ways))))
    return np.stack([geometry.distance(cells.x + cells.edge[:, None] * way) for way in signs @ ways], axis=1)


def _reach(ways: np.ndarray) -> float:
    """Farthest from its middle that a cell of these directions (m, dim) reaches, m."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=len(ways)))) @ ways
    return float(np.sqrt((corners**2).sum(axis=1)).max())


def _beside_walls(
    geometry: Geometry, x: np.ndarray, support: float, flow: tuple[np.ndarray, np.ndarray],
    cells: tuple[Share | None, np.ndarray, float],
) -> tuple[BesideWalls, np.ndarray, BesideWalls, np.ndarray]:
    """Fluid particles within a support of a wall, remote ones too, their velocity beside its Laplacian, (m, 2 dim), and
    the cells of this process that walls cut, with their numbers. cells: share, edge as above, and how far the cell of
    the lattice reaches, m."""
    (share, edge, reach), n, own = cells, len(flow[0]), len(x)
    both = np.concatenate(flow, axis=1)
    if share is not None:
        x, both = np.concatenate([x, share.ghosts]), share.exchange.forward(both)
        edge = np.concatenate([edge, np.ones(len(share.ghosts))])  # their cells belong to others, and are not asked for
    distance, row = geometry.distance(x, support), np.arange(len(x))
    near = (distance < support) & ((row < n) | (row >= own))
    cut = (np.abs(distance) < edge * reach) & (row < own)
    asked = np.flatnonzero(near | cut)  # normals of what is both are asked for once
    slips = np.any(geometry.slip_length > 0.0)
    slip = geometry.slip_length[geometry.wall(x[asked])] if slips else np.zeros(len(asked))
    beside = BesideWalls(x[asked], distance[asked], wall_normals(geometry, x[asked], support), slip, edge[asked])
    seen = both[np.concatenate([np.flatnonzero(near[:n]), n + np.flatnonzero(near[own:])])]
    return beside.of(near[asked]), seen, beside.of(cut[asked]), np.flatnonzero(cut)


@njit(cache=True, nogil=True, error_model="numpy")
def _means(rows, pairs, cut, sources, ways, support, out):  # pragma: no cover
    """Mean over the cell of f less f in its middle, zero in solids (module). ways: directions of the parts of cells."""
    (start, index), (cells, depth), (source, table, owner, seen) = pairs, cut, sources
    n, dim = cells.x.shape
    slope, lap = np.empty(dim), np.empty(dim)
    half, means = np.empty(len(ways)), np.empty(3)
    for i in range(rows[0], rows[1]):
        radius = support * cells.edge[i]
        slope[:], lap[:] = 0.0, 0.0
        square, weight = 0.0, 0.0
        for p in range(start[i], start[i + 1]):
            row = index[p] - n
            if row < 0:
                continue
            j = owner[row]
            away, along = 0.0, 0.0
            for k in range(dim):
                away += (table[row, k] - cells.x[i, k]) ** 2
                along += cells.normal[i, k] * source.normal[j, k]
            away /= radius * radius
            if along <= 0.0 or away >= 1.0:
                continue
            d = source.distance[j]
            w, a = (1.0 - away) * along * along, d + source.slip[j]
            square += w * a * a
            weight += w * d
            for k in range(dim):  # least squares: u = g a + lap u d^2 / 2
                slope[k] += w * a * (seen[j, k] - 0.5 * d * d * seen[j, dim + k])
                lap[k] += w * d * seen[j, dim + k]
        if not (square > 0.0 and weight > 0.0):
            continue
        means[:] = 0.0
        for part in range(depth.shape[1]):
            _add_means(depth[i, part], cells.normal[i], ways, cells.edge[i], half, means)
        share, first, second = means[0] / depth.shape[1], means[1] / depth.shape[1], means[2] / depth.shape[1]
        d, slip = cells.distance[i], cells.slip[i]
        middle, in_fluid = (d, 1.0) if d > 0.0 else (0.0, 0.0)
        for k in range(dim):
            out[i, k] = (slope[k] / square * (first - middle + slip * (share - in_fluid))
                         + 0.5 * lap[k] / weight * (second - middle * middle))


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
