"""The pressure matrix beside walls: the divergence of a gradient with the odd-even mode damped, in one pass over pairs.

The central gradient does not see a pressure that alternates from particle to particle. What it misses is

    S_i p = sum_j w_ij [ (p_j - p_i) - (grad p_i + grad p_j) . x_ji / 2 ]

with w the symmetric-form weights of the Laplacian: a difference of fourth order in dx that vanishes for quadratic
p, beside walls too (the interpolation of Rhie and Chow 1983, for particles).

Where a pair meets an interface at t, with a = grad p / rho on either side, the difference of p is that of two straight
pieces,  p_j - p_i = (t rho_i a_i + (1 - t) rho_j a_j) . x_ji,  so that the two gradients have the weights t rho_i r_ij
and (1 - t) rho_j r_ij in the place of halves, 1 / r_ij = t rho_i + (1 - t) rho_j. Across an interface a jumps with the
density: with halves S p would not vanish there for a smooth flow, and would leave a divergence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.migration import Numbered
from ..domain.row_threads import REDUCE, over_rows

if TYPE_CHECKING:
    from .pair_weights import Operators


class DivGrad(NamedTuple):
    """-div(grad p) - S p beside walls, made once a configuration. The weights of the pairs are computed where they are
    needed (`_of_pair`): to store them would take as much as the gradient does.

    grad: (n_pairs, dim), of the velocity; symmetric, symmetric_p: (n_pairs,) w_ij, and what it is over the density of
    the pair; rho: (n + remote,) where densities differ, else (0,); own: (n, dim), of the gradient of the particle;
    total: (n,), sum of the weights of p of its pairs.
    """

    grad: np.ndarray
    symmetric: np.ndarray
    symmetric_p: np.ndarray
    rho: np.ndarray
    own: np.ndarray
    total: np.ndarray


def div_grad_weights(ops: Operators, symmetric_p: np.ndarray, density: np.ndarray | float = 1.0) -> DivGrad:
    """ops: with walls; symmetric_p: (n_pairs,) w_ij, over the density of the pair where that varies, the gradients that
    the weights are for then being over the density; density: (n,) where it varies, in the unit of symmetric_p."""
    walls = ops.walls
    assert walls is not None
    rho = ops.exchange.forward(density) if isinstance(density, np.ndarray) else np.empty(0)
    found = DivGrad(ops.grad, walls.symmetric_laplacian, symmetric_p, rho, walls.div.copy(), np.empty(ops.n))
    over_rows(_own_weights, ops.n, ops.neighbours, found)
    return found


def div_grad_rhie_chow(ops: Operators, weights: DivGrad, p: np.ndarray, grad_p: np.ndarray) -> np.ndarray:
    """-div(grad p) - S p beside walls, (n,). p: (n + remote,); grad_p: (n, dim), its gradient."""
    out = np.empty(ops.n)
    grad_p = ops.exchange.forward(grad_p)
    both = np.empty((len(p), 4))  # what a pair reads of its neighbour, in one piece
    both[:, :ops.dim], both[:, 3] = grad_p, p
    over_rows(_div_grad_rhie_chow, ops.n, ops.neighbours, weights, both, out)
    return out


@njit(cache=True, nogil=True)
def _own_weights(rows, neighbours, weights):
    """The weights of the gradient of the particle itself, and the sums of those of p."""
    start, row, x = neighbours.start, neighbours.row, neighbours.x
    symmetric, symmetric_p, own, total = weights.symmetric, weights.symmetric_p, weights.own, weights.total
    last = x.shape[1] - 1  # in 2D the third column is the second again, and not summed up
    for i in range(rows[0], rows[1]):
        s, s0, s1, s2, x0, x1, x2 = 0.0, own[i, 0], own[i, 1], own[i, last], x[i, 0], x[i, 1], x[i, last]
        for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            r, w = np.uint32(row[q]), symmetric[q]
            w0, w1, w2 = w * (x[r, 0] - x0), w * (x[r, 1] - x1), w * (x[r, last] - x2)
            s, s0, s1, s2 = s + symmetric_p[q], s0 + w0, s1 + w1, s2 + w2
        own[i, 0], own[i, 1], own[i, last], total[i] = s0, s1, s2, s


# Without fastmath, so that every kernel rounds them alike.


@njit(cache=True, error_model="numpy", fastmath=False, forceinline=True)
def _share(rho_i, rho_j, w, w_p):
    """(1 - t) rho_j / r_ij, a half where there is no interface between i and j. w, w_p: symmetric and symmetric_p of
    `DivGrad`."""
    return 0.5 if rho_i == rho_j or w == 0.0 else rho_j * (rho_i * w_p / w - 1.0) / (rho_i - rho_j)


@njit(cache=True, error_model="numpy", fastmath=False, forceinline=True)
def _of_pair(g, share, w, along):
    """The weight of a pair of the difference of one component of the gradient over it: of
    grad p_i + share (grad p_j - grad p_i) the rest goes with i. g: weight of the divergence; along: x_j - x_i, m."""
    return g - share * (w * along)


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _div_grad_rhie_chow(rows, neighbours, weights, both, out):
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    grad, symmetric, symmetric_p, rho, own, _ = weights
    dim = x.shape[1]
    last, differ = dim - 1, len(rho) > 0
    for i in range(rows[0], rows[1]):
        s0, s1, s2, s3, pi = 0.0, 0.0, 0.0, 0.0, both[i, 3]
        g0, g1, g2, x0, x1, x2 = both[i, 0], both[i, 1], both[i, last], x[i, 0], x[i, 1], x[i, last]
        for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            share, j, r, w = 0.5, np.uint32(column[q]), np.uint32(row[q]), symmetric[q]
            if differ:
                share = _share(rho[i], rho[j], w, symmetric_p[q])
            s0 += _of_pair(grad[q, 0], share, w, x[r, 0] - x0) * (both[j, 0] - g0)
            s1 += _of_pair(grad[q, 1], share, w, x[r, 1] - x1) * (both[j, 1] - g1)
            s2 += _of_pair(grad[q, last], share, w, x[r, last] - x2) * (both[j, last] - g2)
            s3 += symmetric_p[q] * (both[j, 3] - pi)
        total = s0 + s1 + s3 - own[i, 0] * g0 - own[i, 1] * g1
        out[i] = -(total + s2 - own[i, last] * g2 if dim == 3 else total)  # eq. 3 beside walls: -(div grad p + S p)


def diagonal(ops: Operators, weights: DivGrad, grad_p: np.ndarray) -> np.ndarray:
    """Diagonal (n,) of the matrix that `div_grad_rhie_chow` applies with the gradients grad_p (n_pairs, dim), of rows
    that see a wall; of the others that of the Laplacian."""
    walls = ops.walls
    assert walls is not None
    out = weights.total.copy()
    over_rows(_diagonal, ops.n, ops.neighbours, weights, grad_p, walls.near_wall, out)
    if isinstance(ops.exchange, Numbered):
        _add_remote_rows(ops, ops.exchange, weights, grad_p, out)
    return out


def _add_remote_rows(ops: Operators, exchange: Numbered, weights: DivGrad, grad_p: np.ndarray, out: np.ndarray) -> None:
    """What the rows of remote particles, which are with their owners, add to the diagonal out (n,)."""
    assert ops.walls is not None
    n, dim, near = ops.n, ops.dim, ops.walls.near_wall
    which, row, column, offset = _remote_pairs(ops)
    told, asked = np.flatnonzero(exchange.forward(near)[column]), np.flatnonzero(near[row])
    back = exchange.from_other_side((row[told], column[told], offset[told], grad_p[which[told]]),
                                    (row[asked], column[asked], offset[asked]))
    # in a thin box a remote particle sees several images of this one, through each of which the others go
    several = np.unique(row[asked] * (n + exchange.remote) + column[asked], return_inverse=True)[1]
    whole = np.zeros((len(back), dim))
    np.add.at(whole, several, back)
    pair = np.empty((len(asked), dim))
    _some_pairs(row[asked], which[asked], ops.neighbours, weights, pair)
    over = np.einsum("qk,qk->q", pair, whole[several])
    out -= np.bincount(row[asked], over, n)


@njit(cache=True)
def _some_pairs(rows, which, neighbours, weights, pair):
    """The weights of `_of_pair` of pairs which (m,) of particles rows (m,) into pair (m, dim)."""
    row, x, (grad, symmetric, symmetric_p, rho, _, _) = neighbours.row, neighbours.x, weights
    for m in range(len(which)):
        i, q, share = rows[m], which[m], 0.5
        if len(rho) > 0:
            share = _share(rho[i], rho[neighbours.column[q]], symmetric[q], symmetric_p[q])
        for k in range(pair.shape[1]):
            pair[m, k] = _of_pair(grad[q, k], share, symmetric[q], x[row[q], k] - x[i, k])


def _remote_pairs(ops: Operators) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The pairs with remote particles, which are few: (their numbers (m,), row and column of each, x_j - x_i (m, dim),
    m)."""
    which = np.flatnonzero(ops.column >= ops.n)
    row, x = np.searchsorted(ops.start, which, side="right") - 1, ops.neighbours.x
    return which, row, ops.column[which], x[ops.neighbours.row[which]] - x[row]


def adjoint_divergence(ops: Operators) -> None:
    """Gives rows of narrow pores the divergence that is minus the adjoint of the pressure gradient, in place:
    sum_i V_i p_i div u_i = - sum_i V_i u_i . grad p_i over these rows.

    Where beads touch, particles see few others, perhaps all in a plane, and one gradient of the pressure and another
    of the velocity fall back on different directions. One's divergence of the other then has the wrong sign:
    a correction makes the divergence worse, step by step, and the particle is thrown out. With the adjoint, a
    projection cannot add energy, and what it takes out of a pore it puts in elsewhere (the gradient of a constant is
    zero, and so is the sum of the divergence).
    """
    walls = ops.walls
    assert walls is not None
    if not reduce.any_true(walls.narrow):
        return
    narrow = np.flatnonzero(walls.narrow)
    if isinstance(ops.exchange, Numbered):
        _adjoint_of_remote(ops, ops.exchange, walls.narrow)
    over_rows(_adjoint_divergence, len(narrow), ops.neighbours, ops.volume, ops.grad_p, narrow,
              (ops.grad, walls.div, walls.div_velocity))


def _adjoint_of_remote(ops: Operators, exchange: Numbered, narrow: np.ndarray) -> None:
    """The pairs of narrow rows with remote particles, whose rows are with their owners. narrow: (n,) bool."""
    which, row, column, offset = _remote_pairs(ops)
    told, asked = np.flatnonzero(exchange.forward(narrow)[column]), np.flatnonzero(narrow[row])
    weighted = -ops.volume[row[told], None] * ops.grad_p[which[told]]
    found = exchange.from_other_side((row[told], column[told], offset[told], weighted),
                                     (row[asked], column[asked], offset[asked]))
    ops.grad[which[asked]] = found / ops.volume[row[asked], None]


@njit(cache=True, nogil=True)
def _adjoint_divergence(rows, neighbours, volume, grad_p, narrow, out):
    grad, wall_div, wall_div_velocity = out
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    dim = x.shape[1]
    for r in range(rows[0], rows[1]):
        i = narrow[r]
        for k in range(dim):
            wall_div[i, k] = 0.0
        wall_div_velocity[i] = 0.0
        for q in range(start[i], start[i + 1]):
            j, away = column[q], 0.0
            for k in range(dim):
                if j < len(start) - 1:
                    grad[q, k] = 0.0
                away += (x[row[q], k] - x[i, k]) ** 2
            # the same pair from the other side: in a thin box j may see several images of i
            begin, end = (start[j], start[j + 1]) if j < len(start) - 1 else (0, 0)  # of remote rows: already there
            for back in range(begin, end):
                if column[back] == i:
                    off = 0.0
                    for k in range(dim):
                        off += (x[row[back], k] - x[j, k] + x[row[q], k] - x[i, k]) ** 2
                    if off < 1e-12 * away:
                        for k in range(dim):
                            grad[q, k] = -volume[j] / volume[i] * grad_p[back, k]
            for k in range(dim):
                wall_div[i, k] -= grad[q, k] + grad_p[q, k]


@njit(cache=True, nogil=True)
def _diagonal(rows, neighbours, weights, grad_p, near_wall, out):
    """Adds to out (n,), the sums of the weights of p, what goes through the gradients."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    grad, symmetric, symmetric_p, rho, own, _ = weights
    last, differ = own.shape[1] - 1, len(rho) > 0
    for i in range(rows[0], rows[1]):
        if not near_wall[i]:
            continue
        # div a + S p = sum_j pair_ij . a_j - (own + sum_j pair_ij) . a_i + sum_j w_ij (p_j - p_i)
        w0, w1, w2, s0, s1, s2, found = own[i, 0], own[i, 1], own[i, last], 0.0, 0.0, 0.0, 0.0
        for turn in range(2):
            for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                share, j, r, w = 0.5, column[q], np.uint32(row[q]), symmetric[q]
                if differ:
                    share = _share(rho[i], rho[j], w, symmetric_p[q])
                a0 = _of_pair(grad[q, 0], share, w, x[r, 0] - x[i, 0])
                a1 = _of_pair(grad[q, 1], share, w, x[r, 1] - x[i, 1])
                a2 = _of_pair(grad[q, last], share, w, x[r, last] - x[i, last])
                if turn == 0:
                    w0, w1, w2 = w0 + a0, w1 + a1, w2 + a2
                    s0, s1, s2 = s0 - grad_p[q, 0], s1 - grad_p[q, 1], s2 - grad_p[q, last]
                    continue
                if j >= len(start) - 1:  # a remote row, see `_add_remote_rows`
                    continue
                many, first, end = 0, np.uint64(start[j]), np.uint64(start[j + 1])
                place = np.uint64(0)
                for back in range(first, end):  # without a break, so that LLVM makes vectors of it
                    many += column[back] == np.int32(i)
                    place += back if column[back] == np.int32(i) else np.uint64(0)
                if many == 1:
                    first, end = place, place + np.uint64(1)
                for back in range(first, end):
                    if column[back] == i:  # in a thin box j may see several images of i
                        found -= a0 * grad_p[back, 0] + a1 * grad_p[back, 1]
                        if last == 2:
                            found -= a2 * grad_p[back, 2]
            if turn == 0:
                found = w0 * s0 + w1 * s1 + (w2 * s2 if last == 2 else 0.0)
        out[i] += found
