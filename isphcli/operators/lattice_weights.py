"""The operators of a steady solve in factors (eqs 5-6, 11): a few tensors per particle, not ten numbers per pair.

With e the unit vector from particle i to its neighbour j, s their distance over the support, w = F V support and

    a = w e,        T = w e (x) e / s        (xx yy zz yz xz xy)

the weights of eqs 5-6 (see `moments` and `wall_weights`) are

    lap_ij = L_i : T - b_i . a,   grad_ij = M_i a - K_i : T,   grad_p_ij = Q_i a,   symmetric_ij = c_i w / s .

K makes the gradient of the velocity exact for quadratic functions. A lattice has as many different (a, T) as a
neighbourhood has neighbours, however many particles there are: a pair keeps the number of its offset, one byte, where
the weights themselves would take 80.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..domain import reduce
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..domain.neighbours import Neighbourhood
from ..domain.row_threads import edges_of, in_one_piece, over_blocks, over_rows
from .crossings import MEETS_WALL, WallStencils, in_sight
from .kernel import normalisation, slope
from .moments import (
    correction,
    extremes_2d,
    extremes_3d,
    gather_stencil,
    invert_gradient,
    new_workspace,
    stencil_moments,
)
from .neighbourhood_class import NARROW_SHARE_FIXED
from .protocol import WallSums
from .wall_weights import add_walls, boundary_sums, meet_walls, new_boundary_sums, second_moments

NEAREST = 1.02  # of the smallest squared distance on a lattice that is not stretched: the nearest neighbours
# Least distances of sites along the axes, in spacings: square and hexagonal, cubic and body-centred lattices
LEAST_STEPS = {2: ((1.0, 1.0), (0.5, 0.75**0.5)), 3: ((1.0, 1.0, 1.0), (0.5, 0.5, 0.5))}
MOST_OFFSETS = 255  # more, and every pair keeps an offset of its own: particles off a lattice


class LatticePairs(NamedTuple):
    """The pairs of fluid particles in sight as kernels take them; columns are owners, those of remote particles (see
    `domain/exchange.py`) n and more.

    start: (n + 1,); column: (n_pairs,) int32; offset_id: (n_pairs,) number of the offset of the pair. Of the m offsets:
    step (m, dim) x_j - x_i, m; first_moment (m, 3) a; second_moment (m, 6) T; pair_laplacian (m,) w / s.
    """

    start: np.ndarray
    column: np.ndarray
    offset_id: np.ndarray
    step: np.ndarray
    first_moment: np.ndarray
    second_moment: np.ndarray
    pair_laplacian: np.ndarray


class Factors(NamedTuple):
    """Tensors of the particles as kernels take them.

    row: (n,) int32 of the particle in the others; on a lattice those that see every offset and no wall share row 0, off
    it nobody has that.
    laplace: (rows, 9) L and b, 1/m2; gradient: (rows, dim, dim) M and gradient_p Q, 1/m; scale: (rows,) c, 1/m2;
    k_tensor: (rows, dim, 6) K, 1/m, or (0, dim, 6) for gradients of first order; k_tensor_p, the same of the pressure
    gradient away from walls, (0, dim, 6) on a lattice, where it vanishes. row, gradient_p and k_tensor_p have remote
    particles too, for the adjoint.
    """

    row: np.ndarray
    laplace: np.ndarray
    gradient: np.ndarray
    gradient_p: np.ndarray
    scale: np.ndarray
    k_tensor: np.ndarray
    k_tensor_p: np.ndarray


class WholeRows(NamedTuple):
    """Weights of the particles that see every offset and no wall, row 0 of `Factors`, as kernels take them.

    weights: (4, m) of the m offsets, the three of the velocity gradient, 1/m, and that of the Laplacian, 1/m2;
    half_step: (m, 3) half the step times `pair_laplacian`, of any particle. In 2D what is of the third axis is zero.
    """

    weights: np.ndarray
    half_step: np.ndarray


@dataclass(frozen=True)
class LatticeWeights:
    """The operators of the fluid particles of a steady solve, of the protocol `DiscreteOperators`.

    pairs, tensors: see there; walls: sums over the neighbours beyond walls; deficient: particles that fell back on a
    simpler correction; narrow: (n,) bool, particles in pores that the lattice does not resolve, whose divergence is the
    adjoint one (`divergence_and_rhie_chow`); whole: see `WholeRows`; exchange: where the values of remote particles
    come from.
    """

    pairs: LatticePairs
    tensors: Factors
    walls: WallSums
    deficient: int
    narrow: np.ndarray
    whole: WholeRows
    exchange: Exchange = NO_EXCHANGE

    @property
    def n(self) -> int:
        """Number of fluid particles."""
        return len(self.pairs.start) - 1

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self.pairs.step.shape[1]

    @property
    def start(self) -> np.ndarray:
        """(n + 1,) row pointers of the pairs."""
        return self.pairs.start

    @property
    def column(self) -> np.ndarray:
        """(n_pairs,) int32 particles that the neighbours are or image."""
        return self.pairs.column

    @property
    def on_lattice(self) -> bool:
        """Whether pairs share offsets."""
        return self.pairs.offset_id.dtype == np.uint8

    def gradient_p(self, p: np.ndarray) -> np.ndarray:
        """Pressure gradient (n, dim) of p (n,)."""
        gradient, zero = np.empty((self.n, self.dim)), np.zeros((self.n, self.dim))
        add_gradient_p(self, 0.0, p, zero, (gradient, zero))
        return gradient

    def potential_gradient(self, force: np.ndarray) -> np.ndarray:
        """The acceleration force (dim,) as the gradient of its potential, (n, dim): see `DiscreteOperators`."""
        out = np.zeros((self.n, self.dim))
        over_rows(_potential_gradient, self.n, self.pairs, self.tensors, force, out)
        return out

    def total_divergence(self, u: np.ndarray) -> np.ndarray:
        """Consistent divergence (n,) of u (n, dim), walls and their velocities included."""
        zero = np.zeros(self.n)
        return divergence_and_rhie_chow(self, u, (zero, u), (1.0, 0.0)) + self.walls.div_velocity


def build_lattice_weights(stencils: WallStencils, order: int = 1,
                          exchange: Exchange = NO_EXCHANGE) -> tuple[LatticeWeights, np.ndarray]:
    """(LatticeWeights, row of each pair in the table of positions). order: of the velocity gradient, 1 (eq. 5) or 2."""
    everyone, walls, links, volume = stencils.neighbours, stencils.walls, stencils.links, stencils.volume
    x, n = everyone.x, everyone.n
    start = np.zeros(n + 1, np.int64)
    np.cumsum(in_sight(everyone.start, links.link), out=start[1:])
    row, column, offset_id, step = _pairs_in_sight(everyone, links.link, start)
    largest = reduce.largest(volume)
    on_lattice = reduce.largest(np.array([len(step)])) <= MOST_OFFSETS and reduce.smallest(volume) == largest
    if on_lattice:
        weight = np.full(len(step), largest)
    else:
        offset_id = np.arange(len(row), dtype=np.int32)
        step, weight = x[row] - np.repeat(x[:n], np.diff(start), axis=0), volume[column]
    m = len(step)
    moments = first_moment, second_moment, pair_laplacian = np.zeros((m, 3)), np.zeros((m, 6)), np.zeros(m)
    _offset_weights(step, weight, everyone.kind, everyone.support, np.zeros(3), moments)
    which, dim = _own_tensors(np.diff(start), np.diff(everyone.start), len(step) if on_lattice else -1), x.shape[1]
    rows, second = len(which), len(which) if order == 2 else 0
    tensors = Factors(np.zeros(n, np.int32), np.zeros((rows, 9)), np.zeros((rows, dim, dim)),
                      np.zeros((rows, dim, dim)), np.zeros(rows), np.zeros((second, dim, 6)),
                      np.zeros((0 if on_lattice else second, dim, 6)))
    tensors.row[which[1:]] = np.arange(1, rows)
    sums, narrow = new_boundary_sums(n, dim, walls.slip_length), np.zeros(n, np.bool_)
    deficient = over_rows(_factors, rows, (which, everyone, links, volume, walls), order, tensors, narrow, sums,
                          work=partial(new_workspace, everyone))
    pairs = LatticePairs(start, column, offset_id, step, first_moment, second_moment, pair_laplacian)
    wall_sums = WallSums(*boundary_sums(sums))
    return LatticeWeights(pairs, _with_remote(tensors, exchange), wall_sums, int(reduce.total(np.array(deficient))),
                          narrow, _whole_rows(pairs, tensors), exchange), row


def _own_tensors(seen: np.ndarray, near: np.ndarray, offsets: int) -> np.ndarray:
    """The particle (int32) of each row of `Factors`; the first has a whole neighbourhood, or is -1 where none has.

    seen, near: (n,) neighbours of each particle, without those beyond walls and with them; offsets: of the lattice.
    """
    whole = (seen == offsets) & (near == offsets)
    one = np.flatnonzero(whole)[:1]
    return np.concatenate([one if len(one) else [-1], np.flatnonzero(~whole)]).astype(np.int32)


def _with_remote(tensors: Factors, exchange: Exchange) -> Factors:
    """The tensors with rows of gradient_p and k_tensor_p for remote particles behind the others."""
    # a process without remote neighbours may have particles that others see, and sends those
    if exchange is NO_EXCHANGE:
        return tensors
    n, rows = len(tensors.row), len(tensors.scale)
    more = [np.concatenate([tensor, exchange.forward(tensor[tensors.row])[n:]]) if len(tensor) else tensor
            for tensor in (tensors.gradient_p, tensors.k_tensor_p)]
    row = np.concatenate([tensors.row, np.arange(rows, rows + exchange.remote, dtype=np.int32)])
    return tensors._replace(row=row, gradient_p=more[0], k_tensor_p=more[1])


def _whole_rows(pairs: LatticePairs, tensors: Factors) -> WholeRows:
    """WholeRows of a lattice, whose tensors differ by round-off alone; off a lattice none is whole."""
    m, dim = pairs.step.shape
    half_step = np.zeros((m, 3))
    half_step[:, :dim] = 0.5 * pairs.pair_laplacian[:, None] * pairs.step
    weights = np.zeros((4, m))
    if pairs.offset_id.dtype == np.uint8:
        first, second = pairs.first_moment, pairs.second_moment
        weights[3] = second @ tensors.laplace[0, :6] - first @ tensors.laplace[0, 6:]
        weights[:dim] = tensors.gradient[0] @ first[:, :dim].T
        if len(tensors.k_tensor):
            weights[:dim] -= tensors.k_tensor[0] @ second.T
    return WholeRows(weights, half_step)


def velocity_matrix(ops: LatticeWeights, dx: float, dtype: type = float) -> sp.csr_matrix:
    """-dx^2 lap, walls included, in canonical CSR form; columns of remote particles are the last ones."""
    matrix = _empty_matrix(ops, np.dtype(dtype))
    over_rows(_velocity_entries, ops.n, ops.pairs, ops.tensors, ops.walls.lap, dx * dx, matrix)
    return canonical(ops, *matrix)


def nearest_matrix(ops: LatticeWeights, dx: float) -> sp.csr_matrix:
    """-dx^2 lap of the nearest neighbours on a lattice alone, canonical CSR: 7 entries per row on a cubic one, for 33.

    Each weighs 2 dim / (number in a whole neighbourhood) dx^2 / distance^2, which is exact for quadratic functions
    there; what walls add is as in `velocity_matrix`. It is symmetric, and as a preconditioner as good.
    """
    weight = dx * dx * nearest_weights(ops, dx)
    first = np.zeros(ops.n + 1, np.int32)
    np.cumsum(1 + in_sight(ops.start, (weight > 0.0).view(np.int8)[ops.pairs.offset_id]), out=first[1:])
    matrix = first, np.empty(first[-1], np.int32), np.empty(first[-1])
    over_rows(_near_entries, ops.n, ops.pairs, weight, ops.walls.lap, dx * dx, matrix)
    return canonical(ops, *matrix)


def _nearest(step: np.ndarray, dx: float) -> np.ndarray:
    """(m,) bool, which offsets (m, dim), m, are to nearest neighbours: by distances on the lattice of the spacing dx,
    m, before a box that it does not fit stretched it. Along an axis that is longer by 1 % two neighbours are as near as
    before, and a matrix without them does not hold the velocity along it."""
    apart = np.abs(step)
    edges = np.array([reduce.smallest(np.append(along[along > 0.1 * dx], np.inf)) for along in apart.T])
    unstretched = min(LEAST_STEPS[len(edges)], key=lambda least: abs(edges[0] / dx - least[0]))
    square = ((step / edges * unstretched) ** 2).sum(axis=1)
    return square < NEAREST * reduce.smallest(square)


def nearest_weights(ops: LatticeWeights, dx: float) -> np.ndarray:
    """Weights of the offsets in that Laplacian, (m,) 1/m2: zero but for the nearest."""
    near = _nearest(ops.pairs.step, dx)
    # a process that has but a few particles may see half of a neighbourhood
    whole = reduce.largest(np.array([np.count_nonzero(near)]))
    return np.where(near, 2.0 * ops.dim / whole / (ops.pairs.step**2).sum(axis=1), 0.0)


def _empty_matrix(ops: LatticeWeights, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row pointers, columns and entries of a matrix with the pairs and the diagonal, before its rows."""
    size = len(ops.column) + ops.n
    first = np.empty(ops.n + 1, np.int32)
    first[-1] = size
    return first, np.empty(size, np.int32), np.empty(size, dtype)


def canonical(ops: LatticeWeights, start: np.ndarray, column: np.ndarray, entries: np.ndarray) -> sp.csr_matrix:
    """Some rows of a matrix, sorted and each column once; columns of remote particles are the last ones."""
    matrix = sp.csr_matrix((entries, column, start), shape=(len(start) - 1, ops.n + ops.exchange.remote))
    matrix.sum_duplicates()
    return matrix


def divergence_and_rhie_chow(ops: LatticeWeights, u: np.ndarray, pressure: tuple[np.ndarray, np.ndarray],
                             factors: tuple[float, float]) -> np.ndarray:
    """a div u + b S p without the velocity of the walls, (n,); see `div_grad` and `coupled`.

    pressure: p (n,) and its gradient (n, dim); factors: a, b.
    """
    forces, mass = np.empty((ops.n, ops.dim)), np.empty(ops.n)
    coupled(ops, u, pressure, (0.0, *factors), (forces, mass))
    return mass


def coupled(ops: LatticeWeights, u: np.ndarray, pressure: tuple[np.ndarray, np.ndarray],
            factors: tuple[float, float, float], found: tuple[np.ndarray, np.ndarray]) -> None:
    """-dx^2 lap u + dx grad p into found[0] (n, dim) and a div u + b S p into found[1] (n,), without the velocity of
    the walls; both in one pass over the pairs, most of whose time is to read them and the velocities.

    pressure: p (n,) and its gradient (n, dim); factors: dx, a, b.

    Where the lattice resolves the pore, div is the consistent one. Narrow particles take minus the adjoint of the
    pressure gradient, sum_i V_i p_i div u_i = -sum_i V_i u_i . grad p_i over them: with the weights b of the gradient
    it is sum_j (b_ij . u_i - b_ji . u_j V_j / V_i), a balance of fluxes. Between two walls the fluid in sight may lie
    in other directions than the walls, and the consistent divergence of a pressure gradient have the wrong sign; that
    of the adjoint has not.
    """
    unknowns = tuple(ops.exchange.forward(values) for values in (u, *pressure))
    walls = ops.walls.lap, ops.walls.div, ops.narrow
    weights = (ops.pairs, ops.tensors, ops.whole), ops.on_lattice
    over_rows(_coupled, ops.n, weights, walls, unknowns, factors, found, work=partial(_row_weights, ops))


def _row_weights(ops: LatticeWeights) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Scratch of `_coupled`: first and second moments, those of an offset or of a pair a column, and weights of one row
    (4, offsets or places), zeros: of the gradient and of the Laplacian."""
    first, second = ops.pairs.first_moment.T, ops.pairs.second_moment.T
    m = len(ops.pairs.step) if ops.on_lattice else int(np.diff(ops.start).max(initial=1))
    first_row, second_row, weights = in_one_piece((3, m), (6, m), (4, m))
    weights[:] = 0.0
    if ops.on_lattice:  # few: along the memory
        first_row[:], second_row[:] = first, second
        first, second = first_row, second_row
    return (first, second), weights


def add_gradient_p(ops: LatticeWeights, factor: float, p: np.ndarray, given: np.ndarray,
                   found: tuple[np.ndarray, np.ndarray]) -> None:
    """grad p into found[0], given + factor grad p into found[1], (n, dim) each. given may be found[1]."""
    p, (gradient, out) = ops.exchange.forward(p), found
    over_rows(_add_gradient_p, ops.n, ops.pairs, (ops.tensors.row, ops.tensors.gradient_p), factor, p, given, found)
    if len(ops.tensors.k_tensor_p):
        more = _second_order(ops.pairs, ops.tensors, p)
        gradient -= more
        out -= factor * more


def symmetric_laplacian(ops: LatticeWeights, f: np.ndarray) -> np.ndarray:
    """sum_j symmetric_ij (f_j - f_i), (n,)."""
    out = np.zeros(ops.n)
    add_symmetric_laplacian(ops, 1.0, f, out)
    return out


def add_symmetric_laplacian(ops: LatticeWeights, factor: float, f: np.ndarray, out: np.ndarray) -> None:
    """out (n,) += factor times the symmetric Laplacian of f (n,)."""
    scales = ops.tensors.row, ops.tensors.scale
    over_rows(_add_symmetric, ops.n, ops.pairs, scales, factor, ops.exchange.forward(f), out)


def share_in_sight(ops: LatticeWeights) -> np.ndarray:
    """What the pairs of each particle have of the second moments of a whole neighbourhood, (n,): 1 where no wall hides
    a neighbour, 0 where walls hide all."""
    out, square = np.empty(ops.n), (ops.pairs.step**2).sum(axis=1) / (2.0 * ops.dim)
    over_rows(_share, ops.n, ops.pairs, (ops.tensors.row, ops.tensors.scale), square, out)
    return out


def _second_order(pairs: LatticePairs, tensors: Factors, p: np.ndarray) -> np.ndarray:
    """K_i : sum_j T (p_j - p_i), (n, dim)."""
    n = len(pairs.start) - 1
    out = np.zeros((n, pairs.step.shape[1]))
    over_rows(_add_second_order, n, pairs, tensors, p, out)
    return out


# --- building ----------------------------------------------------------------------------------------------------


def _pairs_in_sight(everyone: Neighbourhood, link: np.ndarray,
                    start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(row, column, number of the offset, uint8, of each pair of `everyone` that no wall hides (n_pairs,); the offsets
    (m, dim), m), numbered in the order of the pairs that have them first. Those that differ by less than round-off of
    the places are one; of more than MOST_OFFSETS only m is told. start: (n + 1,) of those pairs.

    Blocks of rows begin with the offsets of the first one and number those that they have beyond them by themselves;
    these are joined in the order of the blocks.
    """
    edges, dim, tolerance = edges_of(len(start) - 1), everyone.x.shape[1], 1e-6 * everyone.support
    row, column = np.empty(start[-1], np.int32), np.empty(start[-1], np.int32)
    offset_id, step = np.empty(start[-1], np.uint8), np.empty((len(edges) - 1, MOST_OFFSETS, dim))
    # one more than there are numbers, for what follows the last one
    behind = np.zeros((len(step), MOST_OFFSETS + 2), np.uint8)
    counts, given = np.zeros(len(step), np.int64), (everyone, link, start, tolerance, behind)
    _offsets((0, 1), edges, given, (row, column, offset_id), step, counts)
    common = min(int(counts[0]), MOST_OFFSETS)
    if len(step) > 1:
        step[1:], counts[1:] = step[0], counts[0]
        over_blocks(_offsets, edges[1:], given, (row, column, offset_id), step[1:], counts[1:])
    if counts.max() > MOST_OFFSETS:
        return row, column, offset_id, np.empty((MOST_OFFSETS + 1, dim))
    every = step[0, :common]
    for k in np.flatnonzero(counts > common):
        number = np.arange(MOST_OFFSETS + 1)
        for own in range(common, counts[k]):
            same = np.flatnonzero(np.abs(every - step[k, own]).max(axis=1) < tolerance)
            every = every if len(same) else np.vstack([every, step[k, own]])
            number[own] = same[0] if len(same) else len(every) - 1
        block = slice(start[edges[k]], start[edges[k + 1]])
        offset_id[block] = number[offset_id[block]]
    return row, column, offset_id, every.copy()


@njit(cache=True, nogil=True)
def _offsets(blocks, edges, given, pairs, step, counts):
    """Rows, columns and numbers of the offsets of the pairs in sight of each block of rows, and its offsets, step
    (blocks, MOST_OFFSETS, dim); counts (blocks,): of those, given and left, MOST_OFFSETS + 1 where there are more."""
    (everyone, link, start, tolerance, behind), (row, column, offset_id) = given, pairs
    x, owner, dim = everyone.x, everyone.owner, everyone.x.shape[1]
    for block in range(blocks[0], blocks[1]):
        count = counts[block]
        for i in range(edges[block], edges[block + 1]):
            # rows list their neighbours in the same order, those beyond walls among them: an offset is guessed by the
            # one before it, behind which it stood the last time
            q, before, known = start[i], MOST_OFFSETS + 1, True
            own_x, own_y, own_z = x[i, 0], x[i, 1], x[i, dim - 1]
            for p in range(everyone.start[i], everyone.start[i + 1]):
                if link[p] == MEETS_WALL:
                    before, known = np.int64(behind[block, before]), False
                    continue
                j, found, at = everyone.row[p], -1, q
                row[at], column[at] = j, owner[j]
                q += 1
                if count > MOST_OFFSETS:
                    continue
                x_step, y_step, z_step = x[j, 0] - own_x, x[j, 1] - own_y, x[j, dim - 1] - own_z
                guess = np.int64(behind[block, before])
                for tried in range(count):
                    t = guess + tried
                    if t >= count:
                        t -= count
                    off = max(abs(x_step - step[block, t, 0]), abs(y_step - step[block, t, 1]),
                              abs(z_step - step[block, t, dim - 1]))
                    if off < tolerance:
                        found = t
                        break
                if found < 0:
                    if count < MOST_OFFSETS:
                        for k in range(dim):
                            step[block, count, k] = x[j, k] - x[i, k]
                    found = count
                    count += 1
                offset_id[at] = found
                if known:
                    behind[block, before] = found
                before, known = found, True
        counts[block] = count


@njit(cache=True)
def _offset_weights(step, volume, kind, support, e, moments):
    """Adds to the arrays of `LatticePairs` first_moment, second_moment and pair_laplacian, zeros; e (3,) zeros."""
    (m, dim), (first_moment, second_moment, pair_laplacian) = step.shape, moments
    factor = normalisation(kind, support, dim)
    for t in range(m):
        r = 0.0
        for k in range(dim):
            r += step[t, k] ** 2
        r = np.sqrt(r)
        if r == 0.0:  # coincident particles do not act on each other
            continue
        for k in range(dim):
            e[k] = step[t, k] / r
        s = r / support
        w = volume[t] * factor * slope(kind, s)
        pair_laplacian[t] = w / s
        for k in range(3):
            first_moment[t, k] = w * e[k]
            second_moment[t, k] = pair_laplacian[t] * e[k] * e[k]
        for v, a, b in ((3, 1, 2), (4, 0, 2), (5, 0, 1)):
            second_moment[t, v] = pair_laplacian[t] * e[a] * e[b]


@njit(cache=True, nogil=True)
def _factors(rows, work, given, order, tensors, narrow, sums):
    """As `wall_weights._wall_rows`, but the tensors are kept and the weights of the wall pairs only summed up.

    given: particles of the rows, -1 for none, then what they are built from. Writes the rows of Factors, narrow (n,)
    and the arrays of WallSums; returns how many are deficient."""
    which, neighbours, links, volume, walls = given
    _, laplace, gradient, gradient_p, scale, k_tensor, k_tensor_p = tensors
    wall_lap, _, wall_div, wall_div_velocity, _ = sums
    start, per_length, (link, fraction, first) = neighbours.start, 1.0 / neighbours.support, links
    moments, gp, weights, along = work.moments, work.g_p, work.weights, work.wall[2]
    ex, ey, ez, s, w = work.stencil
    g, _, right, gradient_part, spread = work.tensors
    (first_one, second_one), scene, boundary = work.one_pair, (neighbours, walls), (sums, work.no_slope)
    dim, per_area, deficient = gradient.shape[1], per_length * per_length, 0
    for o in range(rows[0], rows[1]):
        i = np.int64(which[o])  # as helpers take it from loops over all rows: they are compiled once for both
        if i < 0:
            continue
        begin, count = start[i], start[i + 1] - start[i]
        padded = gather_stencil(neighbours, i, volume, work.stencil)
        whole, near_wall = meet_walls(work.stencil, fraction, first[i], link[begin : begin + count])
        stencil_moments(work.stencil, padded, moments)
        deficient += correction(moments, dim, order, work.tensors)
        scale[o] = 2.0 * dim * per_area / whole if whole > 0.0 else 0.0
        for v in range(6):
            laplace[o, v] = 2.0 * per_area * right[v, 0]
        for k in range(3):
            laplace[o, 6 + k] = per_area * (
                g[k, 0] * gradient_part[0] + g[k, 1] * gradient_part[1] + g[k, 2] * gradient_part[2]
            )
        for m in range(dim):
            for k in range(dim):
                gradient[o, m, k] = per_length * g[m, k]
                gradient_p[o, m, k] = per_length * g[m, k]
            if order == 2:
                for k in range(dim):
                    gradient[o, m, k] = per_length * (
                        spread[m, 0] * g[0, k] + spread[m, 1] * g[1, k] + spread[m, 2] * g[2, k])
                for v in range(6):
                    k_tensor[o, m, v] = per_length * right[v, 1 + m]
        if whole == 0.0:  # no neighbour at all: the particle rests, as one that walls surround
            wall_lap[i] = per_area
        if not near_wall:
            if len(k_tensor_p) > 0:
                for m in range(dim):
                    for k in range(dim):
                        gradient_p[o, m, k] = gradient[o, m, k]
                    for v in range(6):
                        k_tensor_p[o, m, v] = k_tensor[o, m, v]
            continue
        second_moments(work.stencil, link[begin : begin + count], moments)
        invert_gradient(moments, dim, gp)
        narrow[i] = not _smallest(moments, dim) > NARROW_SHARE_FIXED * whole / dim
        for m in range(dim):
            for k in range(dim):
                gradient_p[o, m, k] = per_length * gp[m, k]
        for q in range(count):
            if link[begin + q] != MEETS_WALL:
                continue
            first_one[0, 0], first_one[0, 1], first_one[0, 2] = w[q] * ex[q], w[q] * ey[q], w[q] * ez[q]
            b = w[q] / s[q]
            second_one[0, 0], second_one[0, 1] = b * ex[q] * ex[q], b * ey[q] * ey[q]
            second_one[0, 2], second_one[0, 3] = b * ez[q] * ez[q], b * ey[q] * ez[q]
            second_one[0, 4], second_one[0, 5] = b * ex[q] * ez[q], b * ex[q] * ey[q]
            weights[0, q] = _lap_weight(laplace, o, second_one, first_one, 0)
            for m in range(dim):
                weights[1 + m, q] = _grad_weight(gradient, k_tensor, o, m, second_one, first_one, 0)
        # eq. 11
        if add_walls(scene, i, link[begin : begin + count], work.stencil, weights, work.wall, boundary):
            for m in range(dim):
                for k in range(dim):
                    for c in range(dim):
                        gradient[o, m, k] += along[m, c] * gradient_p[o, c, k]
        if narrow[i]:  # no flux passes a wall
            wall_div_velocity[i] = 0.0
            for m in range(dim):
                wall_div[i, m] = 0.0
    return deficient


@njit(cache=True)
def _smallest(moments, dim):
    """Smallest eigenvalue of the second moments moments[0:6]: xx, yy, zz, yz, xz, xy."""
    if dim == 2:
        return extremes_2d(moments[0], moments[1], moments[5])[0]
    return extremes_3d(moments[0], moments[1], moments[2], moments[3], moments[4], moments[5])[0]


@njit(cache=True, inline="always")
def _lap_weight(laplace, i, second, first, t):
    """Weight of the Laplacian of particle i for a pair of first and second moments in row t: eq. 6 in factors."""
    return (laplace[i, 0] * second[t, 0] + laplace[i, 1] * second[t, 1] + laplace[i, 2] * second[t, 2]
            + laplace[i, 3] * second[t, 3] + laplace[i, 4] * second[t, 4] + laplace[i, 5] * second[t, 5]
            - laplace[i, 6] * first[t, 0] - laplace[i, 7] * first[t, 1] - laplace[i, 8] * first[t, 2])


@njit(cache=True, inline="always")
def _grad_weight(gradient, k_tensor, i, k, second, first, t):
    """Component k of the weight of the gradient for such a pair: eq. 5 in factors, with the part that makes it exact
    for quadratics."""
    g = 0.0
    for m in range(gradient.shape[1]):
        g += gradient[i, k, m] * first[t, m]
    if len(k_tensor) > 0:
        for v in range(6):
            g -= k_tensor[i, k, v] * second[t, v]
    return g


@njit(cache=True, nogil=True)
def _velocity_entries(rows, pairs, tensors, wall_lap, area, matrix):
    start, column, offset_id = pairs.start, pairs.column, pairs.offset_id
    first_moment, second_moment = pairs.first_moment, pairs.second_moment
    first, index, entries = matrix
    for i in range(rows[0], rows[1]):
        at = start[i] + i
        first[i] = at
        total = wall_lap[i]
        for q in range(start[i], start[i + 1]):
            a = _lap_weight(tensors.laplace, tensors.row[i], second_moment, first_moment, offset_id[q])
            total += a
            index[q + i + 1], entries[q + i + 1] = column[q], -area * a
        index[at], entries[at] = i, area * total


@njit(cache=True, nogil=True)
def _near_entries(rows, pairs, weight, wall_lap, area, matrix):
    first, index, entries = matrix
    for i in range(rows[0], rows[1]):
        at, total = first[i] + 1, area * max(wall_lap[i], 0.0)
        for q in range(pairs.start[i], pairs.start[i + 1]):
            a = weight[pairs.offset_id[q]]
            if a > 0.0:
                index[at], entries[at] = pairs.column[q], -a
                total += a
                at += 1
        index[first[i]], entries[first[i]] = i, total if total > 0.0 else 1.0


# --- applying ----------------------------------------------------------------------------------------------------


# In 2D the third column is the second again, times what is zero in 2D.


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _coupled(rows, work, weights, walls, unknowns, factors, found):
    ((pairs, tensors, whole), on_lattice), (wall_lap, wall_div, narrow), (u, p, grad_p) = weights, walls, unknowns
    start, column, offset_id, (moments, scratch), (dx, a, b) = pairs.start, pairs.column, pairs.offset_id, work, factors
    half, weight, (forces, mass) = whole.half_step, pairs.pair_laplacian, found
    dim, last = u.shape[1], u.shape[1] - 1
    for i in range(rows[0], rows[1]):
        odd_even, divergence, pi, o = 0.0, 0.0, p[i], tensors.row[i]
        q0, q1, q2, u0, u1, u2 = grad_p[i, 0], grad_p[i, 1], grad_p[i, last], u[i, 0], u[i, 1], u[i, last]
        first, end = np.uint64(start[i]), np.uint64(start[i + 1])
        for q in range(first, end):
            j, t = np.uint32(column[q]), np.uint32(offset_id[q])
            odd_even += (weight[t] * (p[j] - pi) - half[t, 0] * (q0 + grad_p[j, 0]) - half[t, 1] * (q1 + grad_p[j, 1])
                         - half[t, 2] * (q2 + grad_p[j, last]))
        g, begin = whole.weights, 0
        if o != 0:
            begin, count = (0, len(weight)) if on_lattice else (start[i], start[i + 1] - start[i])
            _weights(tensors, o, moments, begin, count, scratch)
            g = scratch
        v0 = v1 = v2 = 0.0
        for q in range(first, end):
            j, t = np.uint32(column[q]), np.uint32(offset_id[q]) - np.uint32(begin)
            d0, d1, d2, w = u[j, 0] - u0, u[j, 1] - u1, u[j, last] - u2, g[3, t]
            divergence += g[0, t] * d0 + g[1, t] * d1 + g[2, t] * d2
            v0, v1, v2 = v0 + w * d0, v1 + w * d1, v2 + w * d2
        if o != 0:
            if narrow[i]:
                divergence = _adjoint_flux(pairs, tensors, i, u)
            for k in range(dim):
                divergence -= wall_div[i, k] * u[i, k]
        mass[i] = a * divergence + b * tensors.scale[o] * odd_even
        for k in range(dim):
            v = v0 if k == 0 else v1 if k == 1 else v2
            forces[i, k] = dx * dx * (wall_lap[i] * u[i, k] - v) + dx * grad_p[i, k]


@njit(cache=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _weights(tensors, o, moments, begin, count, out):
    """Weights (4, count) of the velocity gradient and, last, of the Laplacian of the pairs whose moments are columns
    from `begin` on, by the tensors in row o, as `_grad_weight` and `_lap_weight`: all offsets of a lattice, along which
    they are vectors, take less time than the pairs of a row one by one."""
    first, second = moments
    x0, x1, x2, y0, y1, y2 = first[0], first[1], first[2], second[0], second[1], second[2]
    y3, y4, y5 = second[3], second[4], second[5]
    for k in range(4):
        if k == 3:
            c = tensors.laplace[o]  # eq. 6 in factors
            g0, g1, g2, c0, c1, c2, c3, c4, c5 = -c[6], -c[7], -c[8], -c[0], -c[1], -c[2], -c[3], -c[4], -c[5]
        elif k >= tensors.gradient.shape[1]:
            continue
        else:
            g, c0, c1, c2, c3, c4, c5 = tensors.gradient[o, k], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            g0, g1, g2 = g[0], g[1], g[2] if len(g) == 3 else 0.0
            if len(tensors.k_tensor) > 0:
                c = tensors.k_tensor[o, k]
                c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
        weight = out[k]
        for t in range(np.uint64(count)):
            q = np.uint64(begin) + t
            weight[t] = (g0 * x0[q] + g1 * x1[q] + g2 * x2[q] - c0 * y0[q] - c1 * y1[q] - c2 * y2[q] - c3 * y3[q]
                         - c4 * y4[q] - c5 * y5[q])


@njit(cache=True, error_model="numpy", fastmath=False)
def _adjoint_flux(pairs, tensors, i, u):
    """The adjoint divergence of particle i: a_ji V_j = -a_ij V_i, T_ji V_j = T_ij V_i."""
    first, second, dim = pairs.first_moment, pairs.second_moment, u.shape[1]
    gradient_p, k_tensor_p, o, flux = tensors.gradient_p, tensors.k_tensor_p, tensors.row[i], 0.0
    for q in range(pairs.start[i], pairs.start[i + 1]):
        j, t = pairs.column[q], pairs.offset_id[q]
        n = tensors.row[j]
        for k in range(dim):
            for m in range(dim):
                flux += first[t, m] * (gradient_p[o, k, m] * u[i, k] + gradient_p[n, k, m] * u[j, k])
            if len(k_tensor_p) > 0:
                for v in range(6):
                    flux -= second[t, v] * (k_tensor_p[o, k, v] * u[i, k] - k_tensor_p[n, k, v] * u[j, k])
    return flux


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_gradient_p(rows, pairs, tensors, factor, p, given, found):
    start, column, offset_id, first_moment = pairs.start, pairs.column, pairs.offset_id, pairs.first_moment
    (row, gradient_p), dim, (gradient, out) = tensors, given.shape[1], found
    for i in range(rows[0], rows[1]):
        s0, s1, s2, pi = 0.0, 0.0, 0.0, p[i]
        for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            dp, t = p[np.uint32(column[q])] - pi, np.uint32(offset_id[q])
            s0 += first_moment[t, 0] * dp
            s1 += first_moment[t, 1] * dp
            s2 += first_moment[t, 2] * dp
        o = row[i]
        for k in range(dim):
            g = gradient_p[o, k]
            along = g[0] * s0 + g[1] * s1 + (g[2] * s2 if dim == 3 else 0.0)
            gradient[i, k], out[i, k] = along, given[i, k] + factor * along


@njit(cache=True, nogil=True)
def _add_second_order(rows, pairs, tensors, p, out):
    start, column, offset_id, second_moment = pairs.start, pairs.column, pairs.offset_id, pairs.second_moment
    k_tensor_p, dim = tensors.k_tensor_p, out.shape[1]
    for i in range(rows[0], rows[1]):
        for q in range(start[i], start[i + 1]):
            dp, t = p[column[q]] - p[i], offset_id[q]
            for k in range(dim):
                for v in range(6):
                    out[i, k] += k_tensor_p[tensors.row[i], k, v] * second_moment[t, v] * dp


@njit(cache=True, nogil=True)
def _potential_gradient(rows, pairs, tensors, force, out):
    start, offset_id, step = pairs.start, pairs.offset_id, pairs.step
    first_moment, second_moment = pairs.first_moment, pairs.second_moment
    dim, gradient_p, k_tensor_p = len(force), tensors.gradient_p, tensors.k_tensor_p
    for i in range(rows[0], rows[1]):
        o = tensors.row[i]
        s0 = s1 = s2 = 0.0
        for q in range(start[i], start[i + 1]):
            t, rise = np.uint32(offset_id[q]), 0.0
            for k in range(dim):
                rise += force[k] * step[t, k]
            s0, s1, s2 = s0 + first_moment[t, 0] * rise, s1 + first_moment[t, 1] * rise, s2 + first_moment[t, 2] * rise
            if len(k_tensor_p) > 0:
                for k in range(dim):
                    for v in range(6):
                        out[i, k] -= k_tensor_p[o, k, v] * second_moment[t, v] * rise
        for k in range(dim):
            g = gradient_p[o, k]
            out[i, k] += g[0] * s0 + g[1] * s1 + (g[2] * s2 if dim == 3 else 0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_symmetric(rows, pairs, scales, factor, f, out):
    row, scale = scales
    start, column, offset_id, pair_laplacian = pairs.start, pairs.column, pairs.offset_id, pairs.pair_laplacian
    for i in range(rows[0], rows[1]):
        s, fi = 0.0, f[i]
        for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            s += pair_laplacian[np.uint32(offset_id[q])] * (f[np.uint32(column[q])] - fi)
        out[i] += factor * scale[row[i]] * s


@njit(cache=True, nogil=True)
def _share(rows, pairs, scales, square, out):
    row, scale = scales
    start, offset_id, pair_laplacian = pairs.start, pairs.offset_id, pairs.pair_laplacian
    for i in range(rows[0], rows[1]):
        s = 0.0
        for q in range(start[i], start[i + 1]):
            s += pair_laplacian[offset_id[q]] * square[offset_id[q]]
        out[i] = scale[row[i]] * s
