"""The cubic B-spline through a field on voxel centres, with value and slope at any point (Unser 1999).

Voxel coordinates: see `voxel_geometry`. A spline of third order is twice continuously differentiable, so that its
zero is a smooth surface; trilinear interpolation has facets of the size of a voxel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from scipy import ndimage

from ..domain.slabs import Slabs

SEEN = 2  # layers of coefficients on either side of a voxel that values in it, and on the way to the next centre, need


def spline_coefficients(field: np.ndarray, around: np.ndarray, slabs: Slabs | None = None) -> np.ndarray:
    """Coefficients, float32 [z, y, x], of the cubic B-spline through a field (same shape, overwritten where float32).

    around: (3,) bool x, y, z. Along periodic axes the field repeats, along the others it is mirrored at the faces.
    slabs: how the processes share the field, of which each has its layers; without it one process has all.
    """

    def filtered(values: np.ndarray, axis: int) -> np.ndarray:
        mode = "grid-wrap" if around[2 - axis] else "reflect"
        return ndimage.spline_filter1d(values, 3, axis, output=np.float32, mode=mode)

    return _line_by_line(np.asarray(field, dtype=np.float32), filtered, slabs)


def average(field: np.ndarray, width: float, around: np.ndarray, slabs: Slabs | None = None) -> np.ndarray:
    """The field, float32 [z, y, x], averaged with a Gaussian of `width` voxels along every axis; 0 leaves it.

    Periodic and mirrored as `spline_coefficients` continues it; slabs: as there.
    """

    def filtered(values: np.ndarray, axis: int) -> np.ndarray:
        mode = "wrap" if around[2 - axis] else "reflect"
        return ndimage.gaussian_filter1d(values, width, axis, output=np.float32, mode=mode)

    return _line_by_line(field, filtered, slabs) if width > 0.0 else field


def _line_by_line(field: np.ndarray, filtered: Callable[[np.ndarray, int], np.ndarray],
                  slabs: Slabs | None) -> np.ndarray:
    """The field with all its lines filtered, axis by axis; a process without layers has nothing to filter."""
    slabs = slabs or Slabs.whole(field.shape)
    for axis in range(3):
        if slabs.shape[axis] > 1:
            field = slabs.along(field, axis, lambda values, axis=axis: (  # type: ignore[misc]
                filtered(values, axis) if values.size else values.astype(np.float32)))
    return field


@njit(cache=True, inline="always")
def _place(c, n, periodic):
    """(four indices of coefficients, fraction) round the coordinate c of an axis of n voxels."""
    c = c - 0.5
    i = int(np.floor(c))
    f = c - i
    if i >= 1 and i + 2 < n:
        return i - 1, i, i + 1, i + 2, f
    if periodic:
        return (i - 1) % n, i % n, (i + 1) % n, (i + 2) % n, f
    return _mirror(i - 1, n), _mirror(i, n), _mirror(i + 1, n), _mirror(i + 2, n), f


@njit(cache=True)
def _mirror(i, n):
    """Index of an axis of n voxels that is mirrored at its faces."""
    i %= 2 * n
    return i if i < n else 2 * n - 1 - i


@njit(cache=True, inline="always")
def _weights(f):
    """B-spline weights of the four coefficients and of the derivative, at fraction f of a voxel."""
    g = 1.0 - f
    value = (g * g * g / 6.0, (f * f * (3.0 * f - 6.0) + 4.0) / 6.0, (g * g * (3.0 * g - 6.0) + 4.0) / 6.0,
             f * f * f / 6.0)
    slope = (-0.5 * g * g, f * (1.5 * f - 2.0), g * (2.0 - 1.5 * g), 0.5 * f * f)
    return value, slope


@njit(cache=True)
def value_and_slope(c, around, ux, uy, uz):
    """(value, slope along x, y, z per voxel) of the spline with coefficients c at a point."""
    nz, ny, nx = c.shape
    x0, x1, x2, x3, fx = _place(ux, nx, around[0])
    (a0, a1, a2, a3), (b0, b1, b2, b3) = _weights(fx)
    y0, y1, y2, y3, fy = _place(uy, ny, around[1])
    vy, sy = _weights(fy)
    value, dx, dy, dz = 0.0, 0.0, 0.0, 0.0
    if nz == 1:
        k = 0
        for y in (y0, y1, y2, y3):
            p, q, r, s = c[0, y, x0], c[0, y, x1], c[0, y, x2], c[0, y, x3]
            row = a0 * p + a1 * q + a2 * r + a3 * s
            value += vy[k] * row
            dx += vy[k] * (b0 * p + b1 * q + b2 * r + b3 * s)
            dy += sy[k] * row
            k += 1
        return value, dx, dy, 0.0
    z0, z1, z2, z3, fz = _place(uz, nz, around[2])
    vz, sz = _weights(fz)
    m = 0
    for z in (z0, z1, z2, z3):
        layer, along, across = 0.0, 0.0, 0.0
        k = 0
        for y in (y0, y1, y2, y3):
            p, q, r, s = c[z, y, x0], c[z, y, x1], c[z, y, x2], c[z, y, x3]
            row = a0 * p + a1 * q + a2 * r + a3 * s
            layer += vy[k] * row
            along += vy[k] * (b0 * p + b1 * q + b2 * r + b3 * s)
            across += sy[k] * row
            k += 1
        value += vz[m] * layer
        dx += vz[m] * along
        dy += vz[m] * across
        dz += sz[m] * layer
        m += 1
    return value, dx, dy, dz


@njit(cache=True)
def neighbours(i, n, repeats):
    """Indices of the five coefficients along an axis of n voxels that the spline in voxel i has."""
    if i >= 2 and i + 2 < n:
        return i - 2, i - 1, i, i + 1, i + 2
    if repeats:
        return (i - 2) % n, (i - 1) % n, i, (i + 1) % n, (i + 2) % n
    return _mirror(i - 2, n), _mirror(i - 1, n), i, _mirror(i + 1, n), _mirror(i + 2, n)


def weights_in_voxel(parts: int) -> tuple[np.ndarray, np.ndarray]:
    """(weights, weights of the slope per voxel) (parts, 5) of `neighbours` at the middles of equal parts of a voxel."""
    value, slope = np.zeros((parts, 5)), np.zeros((parts, 5))
    for p in range(parts):
        at = (p + 0.5) / parts - 0.5  # from the centre of the voxel
        first = 1 if at >= 0.0 else 0
        value[p, first : first + 4], slope[p, first : first + 4] = _weights.py_func(at + 1.0 - first)
    return value, slope
