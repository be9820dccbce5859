"""Sums over the pairs of each particle, sum_j weight_ij (f_j - f_i): what operators in pair weights come down to."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..domain.neighbours import Neighbourhood
from ..domain.row_threads import REDUCE, over_rows

NONE, ONCE = np.zeros(1), np.ones(1)  # factors of all rows


def laplacian(start: np.ndarray, column: np.ndarray, lap: np.ndarray, f: np.ndarray, own: np.ndarray = NONE,
              scale: np.ndarray = ONCE) -> np.ndarray:
    """own f + scale L f, (n, c), with L f the Laplacian of f (n, c) with weights lap (n_pairs,); L f alone without own
    and scale, (n,) or (1,)."""
    n = len(start) - 1
    result = np.empty((n, f.shape[1]))
    over_rows(_laplacian, n, start, column, lap, f, (own, scale), result)
    return result


def laplacian_of_scalar(start: np.ndarray, column: np.ndarray, lap: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Laplacian (n,) of f (n,)."""
    result = np.empty(len(start) - 1)
    over_rows(_laplacian_of_scalar, len(result), start, column, lap, f, result)
    return result


def gradient(start: np.ndarray, column: np.ndarray, grad: np.ndarray, f: np.ndarray) -> np.ndarray:
    """d f_c / d x_k of f (n, c) with weights grad (n_pairs, dim), (n, c, dim)."""
    n = len(start) - 1
    result = np.empty((n, f.shape[1], grad.shape[1]))
    over_rows(_gradient, n, start, column, grad, f, result)
    return result


def gradient_of_scalar(start: np.ndarray, column: np.ndarray, grad: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Gradient (n, dim) of f (n,)."""
    return gradient(start, column, grad, f[:, None])[:, 0]


def divergence(start: np.ndarray, column: np.ndarray, grad: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Divergence (n,) of u (n, dim)."""
    n = len(start) - 1
    result = np.empty(n)
    over_rows(_divergence, n, start, column, grad, u, result)
    return result


def gradient_of_potential(neighbours: Neighbourhood, grad: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Gradient (n, dim) of the potential force . x, which no periodic box holds: of its differences over the pairs."""
    out = np.empty((neighbours.n, len(force)))
    over_rows(_gradient_of_potential, neighbours.n, neighbours, grad, force, out)
    return out


# Sums are kept in numbers of their own: an array that is written to may be one that is read, as far as LLVM knows, and
# is stored each time. Where there is no third column the second is taken again, and its sum not stored.


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _laplacian(rows, start, column, lap, f, factors, result):
    own, scale = factors
    for i in range(rows[0], rows[1]):
        a, b = own[i if len(own) > 1 else 0], scale[i if len(scale) > 1 else 0]
        for c0 in range(0, f.shape[1], 3):
            c1, c2 = min(c0 + 1, f.shape[1] - 1), min(c0 + 2, f.shape[1] - 1)
            s0, s1, s2, f0, f1, f2 = 0.0, 0.0, 0.0, f[i, c0], f[i, c1], f[i, c2]
            for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                j, w = np.uint32(column[p]), lap[p]
                s0, s1, s2 = s0 + w * (f[j, c0] - f0), s1 + w * (f[j, c1] - f1), s2 + w * (f[j, c2] - f2)  # eq. 6
            result[i, c0], result[i, c1], result[i, c2] = a * f0 + b * s0, a * f1 + b * s1, a * f2 + b * s2


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _laplacian_of_scalar(rows, start, column, lap, f, result):
    for i in range(rows[0], rows[1]):
        s, own = 0.0, f[i]
        for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            s += lap[p] * (f[np.uint32(column[p])] - own)  # eq. 6
        result[i] = s


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _gradient(rows, start, column, grad, f, result):
    last = grad.shape[1] - 1
    for i in range(rows[0], rows[1]):
        for c in range(f.shape[1]):
            s0, s1, s2, own = 0.0, 0.0, 0.0, f[i, c]
            for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                d = f[np.uint32(column[p]), c] - own
                s0, s1, s2 = s0 + grad[p, 0] * d, s1 + grad[p, 1] * d, s2 + grad[p, last] * d  # eq. 5
            result[i, c, 0], result[i, c, 1] = s0, s1
            if last == 2:
                result[i, c, 2] = s2


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _divergence(rows, start, column, grad, u, result):
    last = grad.shape[1] - 1
    for i in range(rows[0], rows[1]):
        s0, s1, s2, u0, u1, u2 = 0.0, 0.0, 0.0, u[i, 0], u[i, 1], u[i, last]
        for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            j = np.uint32(column[p])
            s0 += grad[p, 0] * (u[j, 0] - u0)  # the trace of eq. 5
            s1 += grad[p, 1] * (u[j, 1] - u1)
            s2 += grad[p, last] * (u[j, last] - u2)
        result[i] = s0 + s1 + (s2 if last == 2 else 0.0)


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _gradient_of_potential(rows, neighbours, grad, force, out):
    start, row, x = neighbours.start, neighbours.row, neighbours.x
    last = len(force) - 1
    f0, f1, f2 = force[0], force[1], force[2] if last == 2 else 0.0
    for i in range(rows[0], rows[1]):
        s0, s1, s2, x0, x1, x2 = 0.0, 0.0, 0.0, x[i, 0], x[i, 1], x[i, last]
        for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            j = np.uint32(row[p])
            rise = f0 * (x[j, 0] - x0) + f1 * (x[j, 1] - x1) + f2 * (x[j, last] - x2)
            s0, s1, s2 = s0 + grad[p, 0] * rise, s1 + grad[p, 1] * rise, s2 + grad[p, last] * rise
        out[i, 0], out[i, 1] = s0, s1
        if last == 2:
            out[i, 2] = s2
