"""Least squares over the neighbours of particles: sums of the powers of the ways to them, and small systems of those.

What kernels hand on, `work`, is a namedtuple whose arrays bear these names: of TOGETHER particles at the places m the
ways (TOGETHER, 3, places) to neighbours, zero along z in 2D, weight (TOGETHER, places), seen (TOGETHER,), how many of
the places are taken, and matrix (size, size, TOGETHER); of one sums (35,); of the function that is fitted pair and
scale of `terms_of`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
from numba import njit

from ..domain.row_threads import REDUCE

# Systems that are solved side by side, each its own: the divisions and sums of one wait for each other.
TOGETHER = 4
LANES = 8  # neighbours are filled up to a multiple of so many without weight: two vectors, which a sum takes at once


@lru_cache(maxsize=4)
def terms_of(dim: int, orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(place (size,) of each term among the 35 powers of d up to the fourth order, those of 1 x y z xx xy xz yy yz zz
    first; pair (size, size), that of the product of two; scale (size,) of each) of a function with the terms of these
    orders, of 0 to 2."""
    powers = [powers for order in range(5) for powers in combinations_with_replacement(range(3), order)]
    terms = [term for term in powers if len(term) in orders and (not term or term[-1] < dim)]
    number = {term: k for k, term in enumerate(powers)}
    pair = [[number[tuple(sorted(a + b))] for b in terms] for a in terms]
    scale = [0.5 if len(term) == 2 and term[0] == term[1] else 1.0 for term in terms]
    return np.array([number[term] for term in terms]), np.array(pair), np.array(scale)


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def powers(work, m, v):
    """Sums of v (places,) times 1, x, y, z, xx, xy, xz, yy, yz, zz of the ways to the neighbours of place m; in any
    order, so that they are vectors. More of them would not stay in registers."""
    x, y, z, sums = work.ways[m, 0], work.ways[m, 1], work.ways[m, 2], work.sums
    s, sx, sy, sz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(work.seen[m]):
        a, b, c = v[k] * x[k], v[k] * y[k], v[k] * z[k]
        s += v[k]
        sx += a
        sy += b
        sz += c
        xx += a * x[k]
        xy += a * y[k]
        xz += a * z[k]
        yy += b * y[k]
        yz += b * z[k]
        zz += c * z[k]
    sums[0], sums[1], sums[2], sums[3], sums[4] = s, sx, sy, sz, xx
    sums[5], sums[6], sums[7], sums[8], sums[9] = xy, xz, yy, yz, zz


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def higher_powers(work, m):
    """As `powers`, the weights times the powers of third and fourth order."""
    x, y, z, w, sums, seen = work.ways[m, 0], work.ways[m, 1], work.ways[m, 2], work.weight[m], work.sums, work.seen
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = 0.0
    for k in range(seen[m]):
        xx, yy, zz = w[k] * x[k] * x[k], w[k] * y[k] * y[k], w[k] * z[k] * z[k]
        s0 += xx * x[k]
        s1 += xx * y[k]
        s2 += xx * z[k]
        s3 += yy * x[k]
        s4 += w[k] * x[k] * y[k] * z[k]
        s5 += zz * x[k]
        s6 += yy * y[k]
        s7 += yy * z[k]
        s8 += zz * y[k]
        s9 += zz * z[k]
    sums[10], sums[11], sums[12], sums[13], sums[14] = s0, s1, s2, s3, s4
    sums[15], sums[16], sums[17], sums[18], sums[19] = s5, s6, s7, s8, s9
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = t0 = t1 = t2 = t3 = t4 = 0.0
    for k in range(seen[m]):
        xx, xy, yy, yz, zz = x[k] * x[k], x[k] * y[k], y[k] * y[k], y[k] * z[k], z[k] * z[k]
        a, b, c, e, f = w[k] * xx, w[k] * xy, w[k] * yy, w[k] * yz, w[k] * zz
        s0 += a * xx
        s1 += a * xy
        s2 += a * x[k] * z[k]
        s3 += a * yy
        s4 += a * yz
        s5 += a * zz
        s6 += b * yy
        s7 += b * yz
        s8 += b * zz
        s9 += f * z[k] * x[k]
        t0 += c * yy
        t1 += c * yz
        t2 += c * zz
        t3 += e * zz
        t4 += f * zz
    sums[20], sums[21], sums[22], sums[23], sums[24] = s0, s1, s2, s3, s4
    sums[25], sums[26], sums[27], sums[28], sums[29] = s5, s6, s7, s8, s9
    sums[30], sums[31], sums[32], sums[33], sums[34] = t0, t1, t2, t3, t4


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def put_moments(work, m):
    """Lower half of the matrix of place m, from the sums of all powers."""
    for a in range(len(work.scale)):
        for b in range(a + 1):
            work.matrix[a, b, m] = work.scale[a] * work.scale[b] * work.sums[work.pair[a, b]]


# Numbers of their own, one for each of TOGETHER: of arrays LLVM does not know that they are apart, and a loop over them
# would be no vector.


@njit(cache=True, error_model="numpy")
def factors(lower):
    """Symmetric positive matrices (size, size, TOGETHER), whose lower halves are given, become their Cholesky factors,
    with one over what is on the diagonals."""
    for k in range(len(lower)):
        for c in range(k + 1):
            r0, r1, r2, r3 = lower[k, c, 0], lower[k, c, 1], lower[k, c, 2], lower[k, c, 3]
            for e in range(c):
                r0 -= lower[k, e, 0] * lower[c, e, 0]
                r1 -= lower[k, e, 1] * lower[c, e, 1]
                r2 -= lower[k, e, 2] * lower[c, e, 2]
                r3 -= lower[k, e, 3] * lower[c, e, 3]
            if c < k:
                r0, r1, r2, r3 = r0 * lower[c, c, 0], r1 * lower[c, c, 1], r2 * lower[c, c, 2], r3 * lower[c, c, 3]
            else:
                r0, r1, r2, r3 = 1.0 / math.sqrt(r0), 1.0 / math.sqrt(r1), 1.0 / math.sqrt(r2), 1.0 / math.sqrt(r3)
            lower[k, c, 0], lower[k, c, 1], lower[k, c, 2], lower[k, c, 3] = r0, r1, r2, r3


@njit(cache=True, error_model="numpy")
def solve_factored(lower, right):
    """right (size, TOGETHER) becomes the solutions of the systems whose `factors` are given."""
    size = len(right)
    for turn in range(2 * size):  # there, and back again
        k = turn if turn < size else 2 * size - 1 - turn
        r0, r1, r2, r3 = right[k, 0], right[k, 1], right[k, 2], right[k, 3]
        for e in range(0 if turn < size else k + 1, k if turn < size else size):
            a, b = (k, e) if turn < size else (e, k)
            r0 -= lower[a, b, 0] * right[e, 0]
            r1 -= lower[a, b, 1] * right[e, 1]
            r2 -= lower[a, b, 2] * right[e, 2]
            r3 -= lower[a, b, 3] * right[e, 3]
        right[k, 0], right[k, 1] = r0 * lower[k, k, 0], r1 * lower[k, k, 1]
        right[k, 2], right[k, 3] = r2 * lower[k, k, 2], r3 * lower[k, k, 3]
