"""Smoothing kernels W(r) with compact support, and their derivatives.

A kernel is named by a small integer inside numba code (`KERNELS` maps the names of the case language to it).
All are written in q = r / support, so that the support radius is the only length.

Sources: Wendland 1995 (C2, C4); Morris, Fox and Zhu 1997 (quintic spline, support 3 h).
"""

import math

from numba import njit

WENDLAND_C2, WENDLAND_C4, QUINTIC_SPLINE = 0, 1, 2  # `kind` of a kernel in compiled code
KERNELS = {"wendland_c2": WENDLAND_C2, "wendland_c4": WENDLAND_C4, "quintic_spline": QUINTIC_SPLINE}


@njit(cache=True, inline="always")
def normalisation(kind, support, dim):
    """Factor that makes the integral of W over its support one, in 1 / length^dim."""
    if kind == WENDLAND_C2:
        c = 7.0 / math.pi if dim == 2 else 21.0 / (2.0 * math.pi)
    elif kind == WENDLAND_C4:
        c = 9.0 / math.pi if dim == 2 else 495.0 / (32.0 * math.pi)
    else:
        c = 9.0 * 7.0 / (478.0 * math.pi) if dim == 2 else 27.0 / (120.0 * math.pi)
    return c / support**dim


@njit(cache=True, inline="always")
def shape(kind, q):
    """W / normalisation at q = r / support (zero from q = 1 on)."""
    if q >= 1.0:
        return 0.0
    a = 1.0 - q
    if kind == WENDLAND_C2:
        return a * a * a * a * (1.0 + 4.0 * q)
    if kind == WENDLAND_C4:
        return a**6 * (1.0 + 6.0 * q + 35.0 / 3.0 * q * q)
    s = 3.0 * q
    w = (3.0 - s) ** 5
    if s < 2.0:
        w -= 6.0 * (2.0 - s) ** 5
    if s < 1.0:
        w += 15.0 * (1.0 - s) ** 5
    return w


@njit(cache=True, inline="always")
def slope(kind, q):
    """-(d/dq)(W / normalisation) >= 0 at q = r / support."""
    if q >= 1.0:
        return 0.0
    a = 1.0 - q
    if kind == WENDLAND_C2:
        return 20.0 * q * a * a * a
    if kind == WENDLAND_C4:
        return 56.0 / 3.0 * q * a**5 * (1.0 + 5.0 * q)
    s = 3.0 * q
    w = 15.0 * (3.0 - s) ** 4
    if s < 2.0:
        w -= 90.0 * (2.0 - s) ** 4
    if s < 1.0:
        w += 225.0 * (1.0 - s) ** 4
    return w


@njit(cache=True, error_model="numpy")
def put_shapes(kind, ways, count, out):
    """`shape` at the ends of the first `count` of ways (3, places), in units of the support, into out (places,). A loop
    for each kernel: with a kernel known when it is compiled it vectorises."""
    x, y, z = ways[0], ways[1], ways[2]
    if kind == WENDLAND_C2:
        for k in range(count):
            out[k] = shape(WENDLAND_C2, min(math.sqrt(x[k] * x[k] + y[k] * y[k] + z[k] * z[k]), 1.0))
    elif kind == WENDLAND_C4:
        for k in range(count):
            out[k] = shape(WENDLAND_C4, min(math.sqrt(x[k] * x[k] + y[k] * y[k] + z[k] * z[k]), 1.0))
    else:
        for k in range(count):
            out[k] = shape(QUINTIC_SPLINE, min(math.sqrt(x[k] * x[k] + y[k] * y[k] + z[k] * z[k]), 1.0))
