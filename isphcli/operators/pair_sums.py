"""Sums over the pairs of each particle, sum_j weight_ij (f_j - f_i): what operators in pair weights come down to."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..domain.neighbours import Neighbourhood
from ..domain.row_threads import over_rows


def laplacian(start: np.ndarray, column: np.ndarray, lap: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Laplacian of f (n, c) with weights lap (n_pairs,), (n, c)."""
    n = len(start) - 1
    result = np.zeros((n, f.shape[1]))
    over_rows(_laplacian, n, start, column, lap, f, result)
    return result


def gradient(start: np.ndarray, column: np.ndarray, grad: np.ndarray, f: np.ndarray) -> np.ndarray:
    """d f_c / d x_k of f (n, c) with weights grad (n_pairs, dim), (n, c, dim)."""
    n = len(start) - 1
    result = np.zeros((n, f.shape[1], grad.shape[1]))
    over_rows(_gradient, n, start, column, grad, f, result)
    return result


def gradient_of_scalar(start: np.ndarray, column: np.ndarray, grad: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Gradient (n, dim) of f (n,)."""
    n = len(start) - 1
    result = np.zeros((n, grad.shape[1]))
    over_rows(_gradient_of_scalar, n, start, column, grad, f, result)
    return result


def divergence(start: np.ndarray, column: np.ndarray, grad: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Divergence (n,) of u (n, dim)."""
    n = len(start) - 1
    result = np.empty(n)
    over_rows(_divergence, n, start, column, grad, u, result)
    return result


def gradient_of_potential(neighbours: Neighbourhood, grad: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Gradient (n, dim) of the potential force . x, which no periodic box holds: of its differences over the pairs."""
    out = np.zeros((neighbours.n, len(force)))
    over_rows(_gradient_of_potential, neighbours.n, neighbours, grad, force, out)
    return out


@njit(cache=True, nogil=True)
def _laplacian(rows, start, column, lap, f, result):
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for c in range(f.shape[1]):
                result[i, c] += lap[p] * (f[j, c] - f[i, c])  # eq. 6


@njit(cache=True, nogil=True)
def _gradient(rows, start, column, grad, f, result):
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for c in range(f.shape[1]):
                d = f[j, c] - f[i, c]
                for k in range(grad.shape[1]):
                    result[i, c, k] += grad[p, k] * d  # eq. 5


@njit(cache=True, nogil=True)
def _gradient_of_scalar(rows, start, column, grad, f, result):
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            d = f[column[p]] - f[i]
            for k in range(grad.shape[1]):
                result[i, k] += grad[p, k] * d  # eq. 5


@njit(cache=True, nogil=True)
def _divergence(rows, start, column, grad, u, result):
    for i in range(rows[0], rows[1]):
        s = 0.0
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for k in range(grad.shape[1]):
                s += grad[p, k] * (u[j, k] - u[i, k])  # the trace of eq. 5
        result[i] = s


@njit(cache=True, nogil=True)
def _gradient_of_potential(rows, neighbours, grad, force, out):
    start, row, x = neighbours.start, neighbours.row, neighbours.x
    dim = len(force)
    for i in range(rows[0], rows[1]):
        for q in range(start[i], start[i + 1]):
            rise = 0.0
            for k in range(dim):
                rise += force[k] * (x[row[q], k] - x[i, k])
            for k in range(dim):
                out[i, k] += grad[q, k] * rise
