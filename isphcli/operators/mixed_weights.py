"""Operators of particles of two spacings on one lattice (`domain/mixed_lattice.py`), and matrices of their cells.

Eqs 5, 6 and 11 ask for neighbours and a moment matrix, not for equal volumes: the weights are those of
`wall_weights`, with kernels as wide as the mean spacing of a pair. Beside the other kind neighbourhoods are not
symmetric, and the Laplacian of eq. 6 errs by the third derivatives of the velocity, which made k of arrays 0.3 to 0.8 %
too high. There its weights are the smallest that are exact for functions of third order, as long as the sum of their
sizes is below `HEAVIEST` of their sum; else, as beside many walls, they are those of eq. 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..domain.components import pair_components
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..domain.halo import build_halo
from ..domain.migration import Numbered
from ..domain.mixed_lattice import MIXED, pairs_of_two
from ..domain.neighbours import Neighbourhood
from ..domain.null_space import GROUND
from ..domain.row_threads import over_rows
from ..geometry.wall_normals import wall_normals
from .crossings import MEETS_WALL, WallStencils, WallTable, crossings
from .div_grad import adjoint_divergence
from .kernel import slope
from .narrow_pores import fixed_classes
from .pair_weights import Operators
from .wall_weights import build_wall_operators

if TYPE_CHECKING:
    from ..domain.cut import Share
    from ..geometry.protocol import Geometry

# Sizes of the weights of a Laplacian of third order over their sum. Without a bound some rows beside walls have one of
# 10 and more, and GMRES needs 40 to 400 iterations in the place of 21 to 29 (cylinders and spheres of 12 to 16 spacings
# a cell, benchmarks/two_spacings.py); a third of the rows keep those of eq. 6
HEAVIEST = 1.5
ROWS_AT_ONCE = 2000  # rows of third order at once: 100 MB
RIDGE = 1e-13  # of the trace of their matrices
# Of area over distance, for pairs in sight between which no way leads over faces. Means of the pressure are those of
# all that see each other (eqs 25-26); without a way the preconditioner gives each part a mean of its own, and GMRES
# stalls: in a pack of beads at a spacing of 1/20 of the box 391 iterations, with it 34, and the same k
BRIDGE = 0.1


@dataclass(frozen=True)
class MixedParticles:
    """n_fluid fluid particles, the remote ones that they see, dummies, and those of other processes: x (k, dim) m;
    half, beside (k,) bool, see `domain/mixed_lattice.py`; spacing, m, and site_volume, m^dim: of the larger kind;
    share: of this process, whose exchange is `Numbered`, None of a single one."""

    x: np.ndarray
    n_fluid: int
    half: np.ndarray
    beside: np.ndarray
    spacing: float
    site_volume: float
    share: Share | None = None

    @property
    def exchange(self) -> Exchange:
        """Of the remote particles."""
        return NO_EXCHANGE if self.share is None else self.share.exchange

    @property
    def own(self) -> np.ndarray:
        """Rows of the fluid particles and dummies of this process."""
        if self.share is None:
            return np.arange(len(self.x))
        first = self.n_fluid + self.exchange.remote
        return np.concatenate([np.arange(self.n_fluid), np.arange(first, len(self.x) - len(self.share.dummies))])

    @property
    def spacings(self) -> np.ndarray:
        """Of the fluid particles, m."""
        return np.where(self.half[: self.n_fluid], 0.5 * self.spacing, self.spacing)

    @property
    def volumes(self) -> np.ndarray:
        """Of all, m^dim."""
        return np.where(self.half, 0.5 ** self.x.shape[1], 1.0) * self.site_volume


@dataclass(frozen=True)
class Faces:
    """Pairs whose cells share a face, those of two spacings included: first, second (m,) particles, the second of which
    may be remote; share (m,), its area over the distance of the middles, in spacings; exchange: of remote ones."""

    first: np.ndarray
    second: np.ndarray
    share: np.ndarray
    exchange: Exchange = NO_EXCHANGE

    def conductance(self, w: np.ndarray, walls: np.ndarray | None = None) -> sp.csr_matrix:
        """-div(w grad) summed over each cell, symmetric: w (n,), of which faces take the mean, rows
        (n, n + remote); walls: (n,) added to
        the diagonal, or None, where it is raised by `GROUND`."""
        n, every = len(w), self.exchange.forward(w)
        share = 0.5 * self.share * (w[self.first] + every[self.second])
        total = np.bincount(self.first, share, minlength=n)
        diagonal = total * (1.0 + GROUND) if walls is None else total + walls
        diagonal[diagonal <= 0.0] = 1.0
        own, shape = np.arange(n), (n, len(every))
        between = sp.csr_matrix((-share, (self.first, self.second)), shape)
        return between + sp.csr_matrix((diagonal, (own, own)), shape)


def build_mixed_operators(geometry: Geometry, particles: MixedParticles, kind: int,
                          support: float) -> tuple[Operators, Faces]:
    """(Operators, Faces) of walls at rest. support: m, of the larger spacing."""
    n, volumes, share = particles.n_fluid, particles.volumes, particles.share
    fluid = n + particles.exchange.remote
    images = build_halo(particles.x, geometry.lower, geometry.upper, np.array(geometry.periodic), support,
                        None if share is None else (share.lower, share.upper))
    table, owner = images.positions(particles.x), images.owners(len(particles.x))
    half = particles.half[owner]
    pairs = pairs_of_two(table, n, half, particles.beside[owner], support)
    # the volume of a neighbour is that of the pair: it takes the width of the kernel of the pair along
    number = np.arange(len(pairs.index), dtype=np.int32)
    neighbours = Neighbourhood(pairs.start, number, pairs.index, table, owner, kind, support)
    weight = np.empty(len(pairs.index))
    over_rows(_pair_volumes, n, neighbours, half, volumes, weight)
    distance, wall = geometry.nearest(particles.x)
    slips = np.any(geometry.slip_length > 0.0)
    normal = wall_normals(geometry, particles.x, support)[owner] if slips else np.zeros((0, geometry.dim))
    walls = WallTable(owner < fluid, distance[owner], wall[owner], geometry.wall_velocity, geometry.slip_length,
                      normal, np.zeros((0, geometry.dim, geometry.dim)))
    stencils = WallStencils(neighbours, walls, crossings(geometry, neighbours, walls), weight)
    ops = build_wall_operators(stencils, 2, fixed_classes(stencils), particles.exchange)
    ops = replace(ops, volume=volumes[:fluid])
    _of_third_order(stencils, half, weight, ops)
    adjoint_divergence(ops)
    return ops, _faces(ops, particles)


@njit(cache=True, nogil=True)
def _pair_volumes(rows, neighbours, half, volumes, weight):
    """Volume of each neighbour times the slope of the kernel of the pair over that of the larger spacing."""
    start, row, x, owner = neighbours.start, neighbours.row, neighbours.x, neighbours.owner
    kind, support, dim = neighbours.kind, neighbours.support, neighbours.x.shape[1]
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            j, r2 = row[p], 0.0
            share = MIXED if half[i] != half[j] else 0.5 if half[i] else 1.0
            weight[p] = volumes[owner[j]]
            if share == 1.0:
                continue
            for k in range(dim):
                r2 += (x[j, k] - x[i, k]) ** 2
            q = np.sqrt(r2) / support
            weight[p] *= slope(kind, q / share) / (slope(kind, q) * share ** (dim + 1))


def _of_third_order(stencils: WallStencils, half: np.ndarray, weight: np.ndarray, ops: Operators) -> None:
    """Laplacian of the rows that see both kinds, exact for functions of third order (see above), in place."""
    neighbours, links = stencils.neighbours, stencils.links
    assert ops.walls is not None
    count = np.diff(neighbours.start)
    first = np.repeat(np.arange(len(count)), count)
    mixed = np.unique(first[half[neighbours.row] != half[first]])
    # what walls that slip take off the diagonal is by the weights of eq. 6
    rows = mixed if ops.walls.slip is None else mixed[~ops.walls.slip[mixed].any(axis=(1, 2))]
    wall = links.link == MEETS_WALL
    way = np.ones(len(first))
    way[wall] = links.t
    place_in_sight = np.cumsum(~wall) - 1
    for some in np.array_split(rows, max(1, -(-len(rows) // ROWS_AT_ONCE))) if len(rows) else []:
        places = np.arange(count[some].max())
        valid = places < count[some][:, None]
        pair = np.where(valid, neighbours.start[some][:, None] + places, 0)
        found = _third_order_weights(neighbours, (some, pair, valid), way, weight)
        good = np.abs(found).sum(axis=1) < HEAVIEST * found.sum(axis=1)
        pair, valid, found = pair[good], valid[good], found[good]
        beyond = wall[pair] & valid
        ops.walls.lap[some[good]] = (found * beyond).sum(axis=1)
        seen = valid & ~beyond
        ops.lap[place_in_sight[pair[seen]]] = found[seen]


def _third_order_weights(neighbours: Neighbourhood, some: tuple[np.ndarray, ...], way: np.ndarray,
                         weight: np.ndarray) -> np.ndarray:
    """Weights (m, longest) 1/m2 of the Laplacian with the smallest sum of squares over those of the kernel.

    some: rows (m,), their pairs (m, longest) and which of these there are; way: (n_pairs,) of each pair to the wall.
    """
    (rows, pair, valid), support = some, neighbours.support
    step = (neighbours.x[neighbours.row[pair]] - neighbours.x[rows][:, None]) / support
    q = np.maximum(np.linalg.norm(step, axis=2), 1e-30)
    slopes = np.empty(q.size)
    over_rows(_slopes, q.size, neighbours.kind, q.ravel(), slopes)
    omega = np.where(valid, weight[pair] * slopes.reshape(q.shape) / (q * way[pair]), 0.0)
    omega /= omega.max(axis=1)[:, None]
    e = np.moveaxis(step * way[pair][..., None], 2, 0)
    dim = len(e)
    powers = [power for order in (1, 2, 3) for power in combinations_with_replacement(range(dim), order)]
    functions = np.stack([np.prod([e[a] for a in power], axis=0) for power in powers], axis=2)
    wanted = np.array([2.0 if len(power) == 2 and power[0] == power[1] else 0.0 for power in powers])
    # every function about as large as the largest: the matrix is then regular where the neighbours tell them apart
    size = np.sqrt((functions**2 * omega[..., None]).sum(axis=1)) + 1e-30
    scaled = functions / size[:, None]
    weighted = scaled * omega[..., None]
    matrix = weighted.transpose(0, 2, 1) @ scaled + RIDGE * len(powers) * np.eye(len(powers))
    return (weighted @ np.linalg.solve(matrix, (wanted / size)[..., None]))[..., 0] / support**2


@njit(cache=True, nogil=True)
def _slopes(rows, kind, q, out):
    for k in range(rows[0], rows[1]):
        out[k] = slope(kind, q[k])


def _faces(ops: Operators, particles: MixedParticles) -> Faces:
    """Faces between cells; those of two kinds are three quarters of a spacing apart, a quarter beside each other.

    What is joined over edges and corners of cells alone has weak faces there (`BRIDGE`).
    """
    neighbours, forward = ops.neighbours, ops.exchange.forward
    d = forward(particles.spacings / particles.spacing)
    first, second = np.repeat(np.arange(ops.n), np.diff(ops.start)), ops.column
    step = (neighbours.x[neighbours.row] - neighbours.x[first]) / particles.spacing
    mean, area = 0.5 * (d[first] + d[second]), np.minimum(d[first], d[second]) ** (ops.dim - 1)
    same = d[first] == d[second]
    # the next ones are 1.41 and 1.45 means apart; cells may be stretched along an axis
    shared = (step**2).sum(axis=1) < np.where(same, 1.2, 1.25) ** 2 * mean**2
    part = forward(pair_components(ops.start, second, shared, ops.exchange)[1])
    over = np.flatnonzero(part[first] != part[second])
    over = over[_mutual(ops, first, over)]
    share = np.concatenate([area[shared] / np.abs(step[shared]).max(axis=1),
                            BRIDGE * area[over] / np.linalg.norm(step[over], axis=1)])
    pairs = np.concatenate([np.flatnonzero(shared), over])
    return Faces(first[pairs], second[pairs], share, ops.exchange)


def _mutual(ops: Operators, first: np.ndarray, some: np.ndarray) -> np.ndarray:
    """(m,) bool: of which of some pairs (m,) either particle sees the other; beside the other kind sight need not be
    mutual. first: (n_pairs,) particle of each."""
    i, j, n = first[some], ops.column[some].astype(np.int64), ops.n
    every = n + ops.exchange.remote
    found = (j < n) & np.isin(j * every + i, i * every + j)
    if isinstance(ops.exchange, Numbered):
        x, away = ops.neighbours.x, np.flatnonzero(j >= n)
        offset = x[ops.neighbours.row[some[away]]] - x[i[away]]
        pairs = i[away], j[away], offset
        found[away] = ops.exchange.from_other_side((*pairs, np.ones((len(away), 1))), pairs)[:, 0] > 0.0
    return found
