"""Operators in pair weights, applied to fields: gradient, Laplacian, divergence (eqs 5-6).

The weights are made in `pair_weights`, beside walls in `wall_weights`; `lattice_weights` has the same functions for
the operators of a steady solve.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from .pair_weights import Operators


def laplacian(ops: Operators, f: np.ndarray) -> np.ndarray:
    """Velocity Laplacian of f (n, k) without the wall terms."""
    return _laplacian(ops.start, ops.column, ops.lap, f)


def gradient(ops: Operators, f: np.ndarray) -> np.ndarray:
    """Velocity gradient d f_c / d x_k of f (n, c) as (n, c, k), without the wall terms."""
    return _gradient(ops.start, ops.column, ops.grad, f)


def gradient_p(ops: Operators, p: np.ndarray) -> np.ndarray:
    """Pressure gradient (n, dim) of p (n,)."""
    return _gradient_scalar(ops.start, ops.column, ops.grad_p, p)


def total_gradient(ops: Operators, u: np.ndarray) -> np.ndarray:
    """Velocity gradient d u_c / d x_k of u (n, dim) as (n, c, k), walls that do not slip included."""
    slope = gradient(ops, u)
    if ops.walls is not None:
        from .wall_weights import wall_gradient

        slope += wall_gradient(ops.walls, u)
    return slope


def gradient_one_sided(ops: Operators, f: np.ndarray) -> np.ndarray:
    """Gradients (n, c, dim) of f (n, c) with the weights of the pressure: over fluid neighbours only beside walls."""
    return _gradient(ops.start, ops.column, ops.grad_p, f)


def divergence(ops: Operators, u: np.ndarray) -> np.ndarray:
    """Divergence (n,) of u (n, dim) without the wall terms."""
    return _divergence(ops.start, ops.column, ops.grad, u)


def total_divergence(ops: Operators, u: np.ndarray) -> np.ndarray:
    """Divergence (n,) of u (n, dim), walls included."""
    div = divergence(ops, u)
    if ops.walls is not None:
        from .wall_weights import wall_divergence

        div += wall_divergence(ops.walls, u)
    return div


def potential_gradient(ops: Operators, force: np.ndarray) -> np.ndarray:
    """A uniform acceleration force (dim,) as the gradient of its potential in the pressure's own operator, (n, dim).

    Where the neighbours span all directions it is the force itself; in a dead end one particle wide it is what a
    pressure can balance, and the fluid rests.
    """
    return _potential_gradient(ops.neighbours, ops.grad_p, force)


@njit(cache=True, parallel=True)
def _laplacian(start, column, lap, f):
    n, width = f.shape
    result = np.zeros((n, width))
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for c in range(width):
                result[i, c] += lap[p] * (f[j, c] - f[i, c])  # eq. 6
    return result


@njit(cache=True, parallel=True)
def _gradient(start, column, grad, f):
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
def _gradient_scalar(start, column, grad, f):
    n, dim = len(f), grad.shape[1]
    result = np.zeros((n, dim))
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            d = f[column[p]] - f[i]
            for k in range(dim):
                result[i, k] += grad[p, k] * d  # eq. 5
    return result


@njit(cache=True, parallel=True)
def _divergence(start, column, grad, u):
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
def _potential_gradient(neighbours, grad_p, force):
    start, row, x = neighbours.start, neighbours.row, neighbours.x
    n, dim = len(start) - 1, len(force)
    out = np.zeros((n, dim))
    for i in prange(n):
        for q in range(start[i], start[i + 1]):
            rise = 0.0
            for k in range(dim):
                rise += force[k] * (x[row[q], k] - x[i, k])
            for k in range(dim):
                out[i, k] += grad_p[q, k] * rise
    return out
