"""Divergence of a velocity with the damping of the odd-even pressure mode, in one pass over the pairs.

The central gradient does not see a pressure that alternates from particle to particle. What it misses is

    S_i p = sum_j w_ij [ (p_j - p_i) - (grad p_i + grad p_j) . x_ji / 2 ]

with w the symmetric-form weights of the Laplacian: a difference of fourth order in dx that vanishes for quadratic
p, beside walls too (Rhie and Chow 1983 in the particles' words).
"""

import numpy as np
from numba import njit, prange


def divergence_and_jump(ops, x, row, natural, wall_div, u, p, grad_p, a, b):
    """a div u + b S p, (n,).

    ops: Operators; x: (n_rows, dim) table of positions, row: (n_pairs,) rows of the neighbours in it;
    natural: (n_pairs,) w_ij; wall_div: (n, dim) sums of the gradient weights over wall neighbours;
    u, grad_p: (n, dim); p: (n,).
    """
    return _sweep(ops.start, ops.column, row, x, ops.grad, natural, wall_div, u, p, grad_p, a, b)


@njit(cache=True, parallel=True)
def _sweep(start, column, row, x, grad, natural, wall_div, u, p, grad_p, a, b):
    n, dim = u.shape
    out = np.empty(n)
    for i in prange(n):
        divergence, jump = 0.0, 0.0
        for k in range(dim):
            divergence -= wall_div[i, k] * u[i, k]
        for q in range(start[i], start[i + 1]):
            j, r = column[q], row[q]
            missed = p[j] - p[i]
            for k in range(dim):
                divergence += grad[q, k] * (u[j, k] - u[i, k])
                missed -= 0.5 * (grad_p[i, k] + grad_p[j, k]) * (x[r, k] - x[i, k])
            jump += natural[q] * missed
        out[i] = a * divergence + b * jump
    return out
