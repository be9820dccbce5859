"""Sums over the pairs of each particle, sum_j weight_ij (f_j - f_i): what operators in pair weights come down to."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True)
def laplacian(start, column, lap, f):
    """Laplacian of f (n, c) with weights lap (n_pairs,), (n, c)."""
    n, width = f.shape
    result = np.zeros((n, width))
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for c in range(width):
                result[i, c] += lap[p] * (f[j, c] - f[i, c])  # eq. 6
    return result


@njit(cache=True, parallel=True)
def gradient(start, column, grad, f):
    """d f_c / d x_k of f (n, c) with weights grad (n_pairs, dim), (n, c, dim)."""
    n, width = f.shape
    dim = grad.shape[1]
    result = np.zeros((n, width, dim))
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for c in range(width):
                d = f[j, c] - f[i, c]
                for k in range(dim):
                    result[i, c, k] += grad[p, k] * d  # eq. 5
    return result


@njit(cache=True, parallel=True)
def gradient_of_scalar(start, column, grad, f):
    """Gradient (n, dim) of f (n,)."""
    n, dim = len(f), grad.shape[1]
    result = np.zeros((n, dim))
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            d = f[column[p]] - f[i]
            for k in range(dim):
                result[i, k] += grad[p, k] * d  # eq. 5
    return result


@njit(cache=True, parallel=True)
def divergence(start, column, grad, u):
    """Divergence (n,) of u (n, dim)."""
    n, dim = u.shape
    result = np.zeros(n)
    for i in prange(n):
        s = 0.0
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for k in range(dim):
                s += grad[p, k] * (u[j, k] - u[i, k])  # the trace of eq. 5
        result[i] = s
    return result


@njit(cache=True, parallel=True)
def gradient_of_potential(neighbours, grad, force):
    """Gradient (n, dim) of the potential force . x, which no periodic box holds: of its differences over the pairs."""
    start, row, x = neighbours.start, neighbours.row, neighbours.x
    n, dim = len(start) - 1, len(force)
    out = np.zeros((n, dim))
    for i in prange(n):
        for q in range(start[i], start[i + 1]):
            rise = 0.0
            for k in range(dim):
                rise += force[k] * (x[row[q], k] - x[i, k])
            for k in range(dim):
                out[i, k] += grad[q, k] * rise
    return out
