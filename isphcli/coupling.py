"""The pressure matrix beside walls: the divergence of a gradient with the odd-even mode damped, in one pass over pairs.

The central gradient does not see a pressure that alternates from particle to particle. What it misses is

    S_i p = sum_j w_ij [ (p_j - p_i) - (grad p_i + grad p_j) . x_ji / 2 ]

with w the symmetric-form weights of the Laplacian: a difference of fourth order in dx that vanishes for quadratic
p, beside walls too (Rhie and Chow 1983 in the particles' words).
"""

import numpy as np
from numba import njit, prange

FEW = 0.5  # of the neighbours; with 0.4 the pack of beads still blew up


def divergence_and_jump(ops, x, natural_p, p, grad_p):
    """-div(grad p) - S p beside walls, (n,).

    ops: Operators with walls; x: (n_rows, dim) table of positions; p: (n,); natural_p: (n_pairs,) w_ij, over the
    density of the pair where that varies, grad_p (n, dim) then being the gradient over the density.
    """
    walls = ops.walls
    return _sweep(ops.start, ops.column, walls.row, x, ops.grad, walls.natural, natural_p, walls.div, p, grad_p)


@njit(cache=True, parallel=True)
def _sweep(start, column, row, x, grad, natural, natural_p, wall_div, p, grad_p):
    n, dim = grad_p.shape
    out = np.empty(n)
    for i in prange(n):
        divergence, jump = 0.0, 0.0
        for k in range(dim):
            divergence -= wall_div[i, k] * grad_p[i, k]
        for q in range(start[i], start[i + 1]):
            j, r = column[q], row[q]
            expected = 0.0
            for k in range(dim):
                expected += 0.5 * (grad_p[i, k] + grad_p[j, k]) * (x[r, k] - x[i, k])
                divergence += grad[q, k] * (grad_p[j, k] - grad_p[i, k])
            jump += natural_p[q] * (p[j] - p[i]) - natural[q] * expected
        out[i] = -divergence - jump
    return out


def diagonal(ops, x, natural_p, grad_p):
    """Diagonal (n,) of the matrix that `divergence_and_jump` applies with the gradients grad_p (n_pairs, dim), of rows
    that see a wall; of the others that of the Laplacian natural_p."""
    walls = ops.walls
    return _diagonal(ops.start, ops.column, walls.row, x, ops.grad, walls.natural, natural_p, walls.div, grad_p,
                     walls.near)


def balance(ops, x, count):
    """Makes sense of rows that see less than FEW of their neighbours, in place. count: (n,) those beyond walls too.

    Divergence: the balance of fluxes. sum_j w_ij x_ji . (u_i + u_j) / 2 is exact where the neighbourhood
    is whole and never senseless. Where beads touch, particles see few others, perhaps all in a plane: the gradients of
    pressure and velocity then fall back on different directions, and one's divergence of the other has the wrong sign.
    Of a pack of beads at 2.5 spacings a bead the pressure matrix had 20 eigenvalues with the wrong sign; without the
    rows that see less than FEW of their neighbours it has none, and GMRES takes 22 iterations. Flat walls leave two
    thirds of the neighbours in sight.
    """
    walls = ops.walls
    bad = np.flatnonzero(np.diff(ops.start) < FEW * count)
    _balance(ops.start, walls.row, x, walls.natural, bad, ops.grad, walls.div, walls.div_velocity)


@njit(cache=True)
def _balance(start, row, x, natural, rows, grad, wall_div, wall_div_velocity):
    dim = x.shape[1]
    for i in rows:
        wall_div[i] = 0.0
        wall_div_velocity[i] = 0.0
        for q in range(start[i], start[i + 1]):
            for k in range(dim):
                flux = natural[q] * (x[row[q], k] - x[i, k])
                grad[q, k] = 0.5 * flux
                wall_div[i, k] -= flux


@njit(cache=True, parallel=True)
def _diagonal(start, column, row, x, grad, natural, natural_p, wall_div, grad_p, near):
    n, dim = wall_div.shape
    out = np.zeros(n)
    for i in prange(n):
        for q in range(start[i], start[i + 1]):
            out[i] += natural_p[q]
        if not near[i]:
            continue
        # div a + S p = own . a_i + sum_j other_j . a_j + sum_j w_ij (p_j - p_i)
        for k in range(dim):
            own, slope = -wall_div[i, k], 0.0
            for q in range(start[i], start[i + 1]):
                half = 0.5 * natural[q] * (x[row[q], k] - x[i, k])
                own -= grad[q, k] + half
                slope -= grad_p[q, k]
                other, j = grad[q, k] - half, column[q]
                for back in range(start[j], start[j + 1]):
                    if column[back] == i:
                        out[i] -= other * grad_p[back, k]
            out[i] -= own * slope
    return out
