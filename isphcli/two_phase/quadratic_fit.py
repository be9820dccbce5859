"""A quadratic function fitted to a field of the particles by least squares over the support, with slopes at walls.

    phi(x) ~ a + g . d + d . H d / 2,     d = x - x_i,     weight W(d) of each neighbour and of the particle itself;

a wall point asks in the same sum for its slope along the normal p of the wall: support (p . (g + H d) - slope) with the
weight of a neighbour there. Third derivatives are what the value a differs from phi by, so that a smooth field is kept
to fourth order in the support, and roughness shorter than the support is not.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.row_threads import over_rows
from ..operators.kernel import shape

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood

# Part of the weight of a particle that is added to the moments, to those of second derivatives and of first ones: where
# too few neighbours are in sight to resolve a derivative it is zero, and where they are its error is of this size.
RIDGE = 1e-6
RIDGE_FIRST = 1e-9
FLATTEST = 0.25  # 1 + kappa d + K d^2 of a particle at distance d is above zero but at the centre of a drop


class SlopesAtWalls(NamedTuple):
    """Slopes that wall points ask for.

    start: (n + 1,) row pointers; offset: (n_pairs, dim) of the wall point from the particle, m; normal: (n_pairs, dim)
    of the wall, into the fluid; slope: (n_pairs,) along it; weight: (n_pairs,) of 0 to 1, over that of a neighbour.
    """

    start: np.ndarray
    offset: np.ndarray
    normal: np.ndarray
    slope: np.ndarray
    weight: np.ndarray


class QuadraticFit(NamedTuple):
    """value: (n,) m; slope: (n, dim); curvature: (n,) 1/m, of the surface phi = 0 where it is nearest to the particle,
    positive where the sphere that touches it has phi > 0 inside."""

    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray


def no_slopes(n: int, dim: int) -> SlopesAtWalls:
    """Of n particles that see no wall."""
    return SlopesAtWalls(np.zeros(n + 1, np.int64), np.zeros((0, dim)), np.zeros((0, dim)), np.zeros(0), np.zeros(0))


def quadratic_fit(neighbours: Neighbourhood, phi: np.ndarray, known: np.ndarray, wanted: np.ndarray,
                  walls: SlopesAtWalls) -> QuadraticFit:
    """QuadraticFit of the particles `wanted` (n,), from those that are `known` (n,); elsewhere the value is phi (n,),
    m, and slope and curvature are zero. neighbours: of the fluid particles."""
    n, dim = neighbours.n, neighbours.x.shape[1]
    fit = QuadraticFit(phi.copy(), np.zeros((n, dim)), np.zeros(n))
    over_rows(_fit, n, neighbours, phi, (known, wanted), walls, fit, work=partial(_scratch, dim))
    return fit


def _scratch(dim: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Moments, right-hand side and terms of the quadratic function of one particle."""
    size = 1 + dim + dim * (dim + 1) // 2
    return np.empty((size, size)), np.empty(size), np.empty(size)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(rows, work, neighbours, phi, which, walls, fit):
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, support = neighbours.kind, neighbours.support
    wall_start, offset, normal, wall_slope, wall_weight = walls
    (moments, right, basis), (known, wanted), (value, slope, curvature) = work, which, fit
    dim, size = x.shape[1], len(right)
    for i in range(rows[0], rows[1]):
        if not wanted[i]:
            continue
        for a in range(size):
            right[a] = 0.0
            for b in range(size):
                moments[a, b] = 0.0
        own = shape(kind, 0.0)
        moments[0, 0] = own
        for p in range(start[i], start[i + 1]):
            if known[column[p]]:
                r2 = 0.0
                for k in range(dim):
                    basis[1 + k] = (x[row[p], k] - x[i, k]) / support
                    r2 += basis[1 + k] ** 2
                basis[0] = 1.0
                _products(basis, dim)
                _add(moments, right, basis, shape(kind, math.sqrt(r2)), phi[column[p]] - phi[i])
        for p in range(wall_start[i], wall_start[i + 1]):
            r2 = 0.0
            for k in range(dim):
                r2 += (offset[p, k] / support) ** 2
            _slopes(basis, offset[p], normal[p], support)
            _add(moments, right, basis, wall_weight[p] * shape(kind, math.sqrt(r2)), support * wall_slope[p])
        for a in range(1, size):
            moments[a, a] += own * (RIDGE if a > dim else RIDGE_FIRST)
        _solve(moments, right)
        value[i] = phi[i] + right[0]
        for k in range(dim):
            slope[i, k] = right[1 + k] / support
        curvature[i] = _curvature(right, dim, support, value[i])


@njit(cache=True, inline="always")
def _products(basis, dim):
    """Behind 1 and d: d_a d_a / 2 and d_a d_b, the upper half row by row."""
    v = 1 + dim
    for a in range(dim):
        for b in range(a, dim):
            basis[v] = basis[1 + a] * basis[1 + b] * (0.5 if a == b else 1.0)
            v += 1


@njit(cache=True)
def _slopes(basis, offset, normal, support):
    """What each term of the quadratic function adds to its slope along a normal (dim,), times the support."""
    dim = len(normal)
    basis[0] = 0.0
    v = 1 + dim
    for a in range(dim):
        basis[1 + a] = normal[a]
        for b in range(a, dim):
            da, db = offset[a] / support, offset[b] / support
            basis[v] = normal[a] * da if a == b else normal[a] * db + normal[b] * da
            v += 1


@njit(cache=True, inline="always")
def _add(moments, right, basis, w, f):
    for a in range(len(right)):
        wa = w * basis[a]
        right[a] += wa * f
        for b in range(a + 1):
            moments[a, b] += wa * basis[b]


@njit(cache=True, error_model="numpy")
def _solve(lower, right):
    """right (m,) becomes the solution of a symmetric positive system whose lower half is given; Cholesky's factors."""
    m = len(right)
    for k in range(m):
        for c in range(k + 1):
            rest = lower[k, c]
            for e in range(c):
                rest -= lower[k, e] * lower[c, e]
            lower[k, c] = rest / lower[c, c] if c < k else math.sqrt(rest)
        rest = right[k]
        for e in range(k):
            rest -= lower[k, e] * right[e]
        right[k] = rest / lower[k, k]
    for k in range(m - 1, -1, -1):
        rest = right[k]
        for e in range(k + 1, m):
            rest -= lower[e, k] * right[e]
        right[k] = rest / lower[k, k]


@njit(cache=True, error_model="numpy")
def _curvature(c, dim, support, value):
    """kappa = -(tr H - n . H n) / |g| of coefficients c in units of the support, brought from the particle to phi = 0,
    value / |g| away: each of the two curvatures k of a parallel surface is k / (1 + k d)."""
    gauss, scale = 0.0, 1.0 / support
    if dim == 2:
        gx, gy, xx, xy, yy = c[1], c[2], c[3], c[4], c[5]
        square = gx * gx + gy * gy
        if square == 0.0:
            return 0.0
        size = math.sqrt(square)
        kappa = -(xx * gy * gy - 2.0 * xy * gx * gy + yy * gx * gx) / (size * square) * scale
    else:
        gx, gy, gz, xx, xy, xz, yy, yz, zz = c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9]
        square = gx * gx + gy * gy + gz * gz
        if square == 0.0:
            return 0.0
        size = math.sqrt(square)
        along = gx * gx * xx + gy * gy * yy + gz * gz * zz + 2.0 * (gx * gy * xy + gx * gz * xz + gy * gz * yz)
        kappa = -((xx + yy + zz) - along / square) / size * scale
        gauss = (gx * gx * (yy * zz - yz * yz) + gy * gy * (xx * zz - xz * xz) + gz * gz * (xx * yy - xy * xy)
                 + 2.0 * (gx * gy * (xz * yz - xy * zz) + gx * gz * (xy * yz - xz * yy)
                          + gy * gz * (xy * xz - yz * xx))) / (square * square) * scale * scale
    # in place of eq. 23: at the interface, not at the particle
    distance = value / (size * scale)
    return (kappa + 2.0 * distance * gauss) / max(1.0 + distance * (kappa + distance * gauss), FLATTEST)
