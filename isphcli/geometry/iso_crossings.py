"""The first zero of a spline along a segment that starts where it is positive.

Voxel coordinates: see `voxel_geometry`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .spline import value_and_slope
from .voxel_lookup import LEAST_T

REACH = 0.75  # voxels: longest part of a segment between two values. Half of it leaves k of blobs unchanged
CLOSE_T = 1e-7  # of the length of such a part: error at which the search for a zero ends


@njit(cache=True, nogil=True)
def put_first_zeros(rows, c, around, ends, lower, size, t):
    """Fraction in (0, 1] of the way from xi to xj, (n, dim) m, to the first zero or face into t (n,); 1 without one."""
    xi, xj = ends
    u, v = np.empty(3), np.empty(3)
    u[2] = v[2] = 0.5
    for k in range(rows[0], rows[1]):
        for a in range(xi.shape[1]):
            u[a] = (xi[k, a] - lower[a]) / size[a]
            v[a] = (xj[k, a] - lower[a]) / size[a]
        first = min(first_zero(c, around, 1.0, u, v), _first_face(c.shape, around, u, v))
        t[k] = min(max(first, LEAST_T), 1.0)


@njit(cache=True)
def _first_face(shape, around, u, v):
    """Place at which the segment leaves the image through a face that is a wall; 1 where it does not."""
    first = 1.0
    for a in range(3):
        if not around[a]:
            n = shape[2 - a]
            if v[a] < 0.0:
                first = min(first, u[a] / (u[a] - v[a]))
            elif v[a] > n:
                first = min(first, (n - u[a]) / (v[a] - u[a]))
    return max(first, 0.0)


@njit(cache=True)
def _along(c, around, sign, u, v, t):
    """(value, derivative by t) of sign times the spline at fraction t of the segment u -> v."""
    dx, dy, dz = v[0] - u[0], v[1] - u[1], v[2] - u[2]
    value, sx, sy, sz = value_and_slope(c, around, u[0] + t * dx, u[1] + t * dy, u[2] + t * dz)
    return sign * value, sign * (sx * dx + sy * dy + sz * dz)


@njit(cache=True)
def first_zero(c, around, sign, u, v):
    """First place where sign times the spline is not positive along the segment u -> v, 1 without one.

    Values and slopes are taken at parts of it, between them cubics.

    A segment that only dips into a solid between two values is found by the least value of the cubic.
    """
    length = np.sqrt((v[0] - u[0]) ** 2 + (v[1] - u[1]) ** 2 + (v[2] - u[2]) ** 2)
    parts = max(int(np.ceil(length / REACH)), 1)
    fa, da = _along(c, around, sign, u, v, 0.0)
    if fa <= 0.0:
        return 0.0
    a = 0.0
    for k in range(1, parts + 1):
        b = k / parts
        fb, db = _along(c, around, sign, u, v, b)
        if fb <= 0.0:
            return _zero_between(c, around, sign, u, v, (a, fa), (b, fb))
        if da < 0.0 and db > 0.0:
            h = b - a
            s = _place_of_least(fa, da * h, fb, db * h)
            inside, _ = _along(c, around, sign, u, v, a + s * h)
            if inside <= 0.0:
                return _zero_between(c, around, sign, u, v, (a, fa), (a + s * h, inside))
        a, fa, da = b, fb, db
    return 1.0


@njit(cache=True)
def _place_of_least(fa, da, fb, db):
    """Place in (0, 1) of the minimum of the cubic with values fa, fb and slopes da < 0, db > 0 at 0 and 1."""
    p = 3.0 * (da + db - 2.0 * (fb - fa))
    q = 2.0 * (3.0 * (fb - fa) - 2.0 * da - db)
    # p s^2 + q s + da = 0, its root where the second derivative is positive
    root = np.sqrt(max(q * q - 4.0 * p * da, 0.0))
    if q <= 0.0:  # then p > 0; -2 da / (q + root), the same root, may be 0 / 0 where a field hardly varies
        return min(max((root - q) / (2.0 * p), 0.0), 1.0) if p > 0.0 else 0.5
    return min(max(-2.0 * da / (q + root), 0.0), 1.0)


@njit(cache=True)
def _zero_between(c, around, sign, u, v, first, last):
    """Zero between two (place, value), the first value positive and the last not: Newton's method kept between them."""
    (a, fa), (b, fb) = first, last
    h = b - a
    t = a + h * fa / (fa - fb)
    for _ in range(30):
        f, d = _along(c, around, sign, u, v, t)
        if f > 0.0:
            a = t
        else:
            b = t
        step = -f / d if d < 0.0 else 0.0
        following = t + step
        if not (d < 0.0 and a < following < b):
            following = 0.5 * (a + b)
        if abs(following - t) < CLOSE_T * h:
            return following
        t = following
    return t
