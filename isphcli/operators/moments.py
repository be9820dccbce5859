"""Moments of a neighbourhood and the correction tensors that make operators consistent (eqs 5-7).

With e the unit vector from particle i to neighbour j, s the distance between them, F = -W'(r) >= 0 and V the
particle volumes, the sums of eqs 5 and 6 read

    grad f_i = sum_j (f_j - f_i) G_i e F V_j                                            (eq. 5)
    lap f_i  = 2 sum_j (L_i : e (x) e) F V_j ((f_j - f_i) / s - e . grad f_i)           (eq. 6)

G_i makes linear functions exact. L_i (3 unknowns in 2D, 6 in 3D) makes every quadratic function exact,
the error of the corrected gradient included (Fatehi and Manzari 2011; Trask et al. 2015). The same small
system gives the term K_i that makes the gradient exact for quadratics too: `order=2`.

In the kernels: `g` is G_i, column 0 of `right` L_i, its columns 1 to 3 K_i, `w` F V_j and `s` the distance over the
support; `moments` are the sums over the neighbourhood that all three follow from.

Lengths inside the kernels are divided by the support radius, so that nothing depends on the unit of length.
Scenes in 2D carry a third component of zero: one code path serves both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ..domain.neighbours import Neighbourhood
from ..domain.row_threads import REDUCE, in_one_piece, over_rows
from .kernel import QUINTIC_SPLINE, WENDLAND_C2, WENDLAND_C4, normalisation, shape, slope
from .neighbourhood_class import LOPSIDED, ROUND, SINGULAR, THIN

SWEEPS = 6  # of rotations: what is beside the diagonal is squared by each, and is round-off after four
LANES = 8  # rows are padded to a multiple of this many neighbours: whole vectors


def particle_volumes(neighbours: Neighbourhood) -> np.ndarray:
    """V_i = 1 / sum_j W_ij, the sum over all neighbours and j = i (eq. 7), (n,) m^dim."""
    volume = np.empty(neighbours.n)
    over_rows(_volumes, neighbours.n, neighbours, volume, work=lambda: np.empty(neighbours.longest))
    return volume


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _volumes(rows, q, neighbours, volume):
    x, start, index = neighbours.x, neighbours.start, neighbours.row
    kind, per_support, dim = neighbours.kind, 1.0 / neighbours.support, x.shape[1]
    last, deep = dim - 1, 1.0 if dim == 3 else 0.0
    scale = normalisation(kind, neighbours.support, dim)
    for i in range(rows[0], rows[1]):
        begin, count = np.uint64(start[i]), np.uint64(start[i + 1] - start[i])
        x0, x1, x2, total = x[i, 0], x[i, 1], x[i, last], shape(kind, 0.0)
        for k in range(count):
            j = np.uint32(index[begin + k])
            r2 = (x[j, 0] - x0) ** 2 + (x[j, 1] - x1) ** 2 + deep * (x[j, last] - x2) ** 2
            q[k] = min(math.sqrt(r2) * per_support, 1.0)
        if kind == WENDLAND_C2:  # as in `gather_stencil`
            for k in range(count):
                total += shape(WENDLAND_C2, q[k])
        elif kind == WENDLAND_C4:
            for k in range(count):
                total += shape(WENDLAND_C4, q[k])
        else:
            for k in range(count):
                total += shape(QUINTIC_SPLINE, q[k])
        volume[i] = 1.0 / (scale * total)  # eq. 7


class Workspace(NamedTuple):
    """Scratch arrays for one particle, with places for the longest row once padded.

    stencil: see `gather_stencil`; moments: (41,) of `stencil_moments`; tensors: (g, system, right, gradient_part,
    spread), see `correction`; weights: (4, places) of `stencil_weights`; g_p: (3, 3) correction of the pressure
    gradient; wall: scratch of `wall_weights.add_walls`, which no_slope is for too; one_pair: (1, 3) and (1, 6), moments
    of one pair.
    """

    stencil: tuple[np.ndarray, ...]
    moments: np.ndarray
    tensors: tuple[np.ndarray, ...]
    weights: np.ndarray
    g_p: np.ndarray
    wall: tuple[np.ndarray, ...]
    one_pair: tuple[np.ndarray, ...]
    no_slope: np.ndarray


def new_workspace(neighbours: Neighbourhood) -> Workspace:
    """Scratch arrays for any particle of a neighbourhood."""
    size, dim = int(neighbours.longest) + LANES, neighbours.x.shape[1]
    part = in_one_piece(*[(size,)] * 5, (41,), (3, 3), (6, 6), (6, 4), (3,), (3, 3), (4, size), (3, 3), (dim,),
                        (dim, dim), (dim, dim), (1, 3), (1, 6), (0, dim, dim))
    return Workspace(tuple(part[:5]), part[5], tuple(part[6:11]), part[11], part[12], tuple(part[13:16]),
                     tuple(part[16:18]), part[18])


@njit(cache=True, error_model="numpy", forceinline=True)
def gather_stencil(neighbours, i, volume, stencil):
    """The neighbours of particle i into stencil = (ex, ey, ez, s, w).

    e: direction; s: distance / support; w: F V support. Coincident particles get e = 0, w = 0 and s = 1: they
    do not act on each other, shifting parts them. Weightless neighbours fill up whole vectors.
    Returns the number with those.
    """
    ex, ey, ez, s, w = stencil
    x, row, column, kind, support = neighbours.x, neighbours.row, neighbours.column, neighbours.kind, neighbours.support
    begin, last, deep = np.uint64(neighbours.start[i]), x.shape[1] - 1, 1.0 if x.shape[1] == 3 else 0.0
    count, x0, x1, x2 = np.uint64(neighbours.start[i + 1]) - begin, x[i, 0], x[i, 1], x[i, last]
    for k in range(count):
        j = np.uint32(row[begin + k])
        ex[k], ey[k], ez[k] = x[j, 0] - x0, x[j, 1] - x1, deep * (x[j, last] - x2)
    for k in range(count):
        w[k] = volume[np.uint32(column[begin + k])]
    padded = (count + np.uint64(LANES - 1)) // np.uint64(LANES) * np.uint64(LANES)
    for k in range(count, padded):
        ex[k], ey[k], ez[k], w[k] = 0.0, 0.0, 0.0, 0.0
    inverse_support = 1.0 / support
    for k in range(padded):
        r = math.sqrt(ex[k] * ex[k] + ey[k] * ey[k] + ez[k] * ez[k])
        inverse = 1.0 / r if r > 0.0 else 0.0
        ex[k] *= inverse
        ey[k] *= inverse
        ez[k] *= inverse
        s[k] = r * inverse_support if r > 0.0 else 1.0  # no slope at the edge of the support: w = 0
    # a loop for each kernel: with a kernel known when it is compiled it vectorises
    scale = normalisation(kind, support, last + 1)
    if kind == WENDLAND_C2:
        for k in range(padded):
            w[k] *= scale * slope(WENDLAND_C2, s[k])
    elif kind == WENDLAND_C4:
        for k in range(padded):
            w[k] *= scale * slope(WENDLAND_C4, s[k])
    else:
        for k in range(padded):
            w[k] *= scale * slope(QUINTIC_SPLINE, s[k])
    return np.int64(padded)


@njit(cache=True, fastmath=REDUCE, forceinline=True)
def stencil_moments(stencil, padded, moments):
    """Moment sums of a stencil.

    moments[0:6]: sum w s e e; [6:16]: sum w e e e; [16:26]: sum w s^2 e e e; [26:41]: sum w s e e e e,
    the components of each in the order of `_SECOND`, `_THIRD` and `_FOURTH`.
    """
    ex, ey, ez, s, w = stencil
    # several loops: their sums stay in registers, 41 do not
    m0 = m1 = m2 = m3 = m4 = m5 = 0.0
    t0 = t1 = t2 = t3 = t4 = t5 = t6 = t7 = t8 = t9 = 0.0
    for k in range(padded):
        x, y, z = ex[k], ey[k], ez[k]
        wx, wy, wz = w[k] * x, w[k] * y, w[k] * z
        a, b, c, d, e, f = wx * x, wy * y, wz * z, wy * z, wx * z, wx * y
        m0 += s[k] * a
        m1 += s[k] * b
        m2 += s[k] * c
        m3 += s[k] * d
        m4 += s[k] * e
        m5 += s[k] * f
        t0 += a * x
        t1 += b * y
        t2 += c * z
        t3 += a * y
        t4 += a * z
        t5 += b * x
        t6 += b * z
        t7 += c * x
        t8 += c * y
        t9 += f * z
    moments[0], moments[1], moments[2], moments[3], moments[4], moments[5] = m0, m1, m2, m3, m4, m5
    moments[6], moments[7], moments[8], moments[9], moments[10] = t0, t1, t2, t3, t4
    moments[11], moments[12], moments[13], moments[14], moments[15] = t5, t6, t7, t8, t9
    t0 = t1 = t2 = t3 = t4 = t5 = t6 = t7 = t8 = t9 = 0.0
    for k in range(padded):
        x, y, z = ex[k], ey[k], ez[k]
        v = w[k] * s[k] * s[k]
        a, b, c, f = v * x * x, v * y * y, v * z * z, v * x * y
        t0 += a * x
        t1 += b * y
        t2 += c * z
        t3 += a * y
        t4 += a * z
        t5 += b * x
        t6 += b * z
        t7 += c * x
        t8 += c * y
        t9 += f * z
    moments[16], moments[17], moments[18], moments[19], moments[20] = t0, t1, t2, t3, t4
    moments[21], moments[22], moments[23], moments[24], moments[25] = t5, t6, t7, t8, t9
    f0 = f1 = f2 = f3 = f4 = f5 = f6 = f7 = f8 = f9 = f10 = f11 = f12 = f13 = f14 = 0.0
    for k in range(padded):
        x, y, z = ex[k], ey[k], ez[k]
        v = w[k] * s[k]
        xx, yy, zz, yz, xz, xy = x * x, y * y, z * z, y * z, x * z, x * y
        a, b, c = v * xx, v * yy, v * zz
        f0 += a * xx
        f1 += a * yy
        f2 += a * zz
        f3 += a * yz
        f4 += a * xz
        f5 += a * xy
        f6 += b * yy
        f7 += b * zz
        f8 += b * yz
        f9 += b * xz
        f10 += b * xy
        f11 += c * zz
        f12 += c * yz
        f13 += c * xz
        f14 += c * xy
    moments[26], moments[27], moments[28], moments[29], moments[30] = f0, f1, f2, f3, f4
    moments[31], moments[32], moments[33], moments[34], moments[35] = f5, f6, f7, f8, f9
    moments[36], moments[37], moments[38], moments[39], moments[40] = f10, f11, f12, f13, f14


# Where the third moments (v, k) stand among the ten distinct ones, v a pair of axes: xx yy zz yz xz xy
_THIRD = np.array([[0, 3, 4], [5, 1, 6], [7, 8, 2], [9, 6, 8], [4, 9, 7], [3, 5, 9]])
# and the fourth moments (v, u) among the fifteen
_FOURTH = np.array(
    [
        [0, 1, 2, 3, 4, 5],
        [1, 6, 7, 8, 9, 10],
        [2, 7, 11, 12, 13, 14],
        [3, 8, 12, 7, 14, 9],
        [4, 9, 13, 14, 2, 3],
        [5, 10, 14, 9, 3, 1],
    ]
)
_SECOND = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])


@njit(cache=True, error_model="numpy")
def invert_gradient(moments, dim, g, whole=1.0):
    """G_i = (sum w s e e)^-1 into g (3, 3); on a rank-deficient neighbourhood the pseudo-inverse.

    whole: what the moments of a whole neighbourhood are. Returns True where it had to fall back. The pseudo-inverse
    gives the gradient in the directions that the neighbours span and zero in the others: what a pore one particle wide
    needs.
    """
    # eq. 5: the tensor that makes it exact for linear functions
    a, b, c = moments[0], moments[1], moments[2] if dim == 3 else moments[0] + moments[1]
    yz, xz, xy = moments[3], moments[4], moments[5]
    g[0, 0], g[1, 1], g[2, 2] = b * c - yz * yz, a * c - xz * xz, a * b - xy * xy
    g[0, 1], g[0, 2], g[1, 2] = xz * yz - xy * c, xy * yz - xz * b, xy * xz - yz * a
    determinant = a * g[0, 0] + xy * g[0, 1] + xz * g[0, 2]
    mean = (a + b + c) / 3.0
    if not (determinant > ROUND * mean * mean * mean and mean > ROUND * whole):
        for k in range(3):
            for m in range(3):
                g[k, m] = 0.0
        return not mean > 0.0 or _pseudo_inverse(moments, dim, g, whole)
    for k in range(3):
        g[k, k] /= determinant
    for k, m in ((0, 1), (0, 2), (1, 2)):
        g[k, m] /= determinant
        g[m, k] = g[k, m]
    return False


@njit(cache=True, error_model="numpy")
def extremes_2d(xx, yy, xy):
    """Smallest and largest eigenvalue of a symmetric tensor."""
    middle, radius = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    return middle - radius, middle + radius


@njit(cache=True, error_model="numpy")
def extremes_3d(xx, yy, zz, yz, xz, xy):
    """As `extremes_2d`, in closed form, several times faster than numpy's eigvalsh."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    size = math.sqrt((a * a + b * b + c * c + 2.0 * (yz * yz + xz * xz + xy * xy)) / 6.0)
    if size == 0.0:
        return mean, mean
    cosine = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (2.0 * size**3)
    angle = math.acos(min(max(cosine, -1.0), 1.0)) / 3.0
    return mean + 2.0 * size * math.cos(angle + 2.0 * math.pi / 3.0), mean + 2.0 * size * math.cos(angle)


@njit(cache=True, error_model="numpy")
def _pseudo_inverse(moments, dim, g, whole):
    """Adds it to g, by Jacobi's rotations (numpy's eigh took a second to compile); returns True where it left a
    direction out."""
    tensor, vectors = np.empty((3, 3)), np.empty((3, 3))
    for k in range(3):
        for m in range(3):
            tensor[k, m], vectors[k, m] = moments[_SECOND[k, m]], 1.0 if k == m else 0.0
    for _ in range(SWEEPS):
        for k in range(dim - 1):
            for m in range(k + 1, dim):
                if tensor[k, m] == 0.0:
                    continue
                ratio = 0.5 * (tensor[m, m] - tensor[k, k]) / tensor[k, m]
                tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
                c = 1.0 / math.sqrt(tangent * tangent + 1.0)
                s = tangent * c
                for r in range(dim):
                    a, b = tensor[r, k], tensor[r, m]
                    tensor[r, k], tensor[r, m] = c * a - s * b, s * a + c * b
                    a, b = vectors[r, k], vectors[r, m]
                    vectors[r, k], vectors[r, m] = c * a - s * b, s * a + c * b
                for r in range(dim):
                    a, b = tensor[k, r], tensor[m, r]
                    tensor[k, r], tensor[m, r] = c * a - s * b, s * a + c * b
                tensor[k, m] = tensor[m, k] = 0.0
    largest, thin = whole, False
    for v in range(dim):
        largest = max(largest, tensor[v, v])
    for v in range(dim):
        if not tensor[v, v] > THIN * largest:
            thin = True
        else:
            for k in range(dim):
                for m in range(dim):
                    g[k, m] += vectors[k, v] * vectors[m, v] / tensor[v, v]
    return thin


@njit(cache=True, error_model="numpy")
def correction(moments, dim, order, tensors):
    """The correction tensors of one particle: G_i, L_i and, for order 2, K_i.

    With q_v the six products of the components of e (xx yy zz yz xz xy) and w = F V_j, the quadratic functions
    f_u = s^2 q_u about the particle have by eq. 5 the gradient P_u, which ought to vanish, and the bracket of eq. 6 is
    s q_u - e . P_u:

        P_u = G_i sum_j w s^2 q_u e,      R_vk = sum_j w q_v e_k,      A_uv = sum_j w q_v (s q_u - e . P_u) .

    The Laplacian of f_u is 2 for xx, yy, zz and 0 for the others, its gradient 0. With L_i : e e = sum_v l_v q_v and
    K_i in the same form this is a system with the 6 by 6 matrix A (in 2D rows and columns with z are replaced by a
    multiple of the identity),

        sum_v A_uv l_v = 1 or 0,      sum_v A_uv K_vk = P_uk      for every u .

    moments: (41,) sums. tensors: (g (3, 3) G_i; system (6, 6) scratch; right, gradient_part, spread), in the order
    xx yy zz yz xz xy: right (6, 4): column 0 the weights l of L_i : e e = sum_v l_v e_v, columns 1-3 K_i;
    gradient_part (3,): 2 sum_v l_v R_v, what multiplies the gradient in the Laplacian; spread (3, 3): 1 + K R.
    Returns True where a system was rank-deficient: G_i is then a pseudo-inverse, or L_i a multiple of the identity and
    K_i zero.
    """
    g, system, right, gradient_part, spread = tensors
    thin = invert_gradient(moments, dim, g)  # G_i of eq. 5
    # P_uk: the gradient of eq. 5 of the quadratic function u, which ought to vanish at the particle
    p = right  # columns 1-3 first hold P
    for v in range(6):
        for k in range(3):
            s = 0.0
            for m in range(3):
                s += g[k, m] * moments[16 + _THIRD[v, m]]
            p[v, 1 + k] = s
    trace = 0.0
    for v in range(6):
        for u in range(6):
            s = moments[26 + _FOURTH[v, u]]
            for k in range(3):
                s -= moments[6 + _THIRD[v, k]] * p[u, 1 + k]
            system[u, v] = s
            if v < dim and u < dim:
                trace += s
        right[v, 0] = 1.0 if v < dim else 0.0
    if dim == 2:  # no quadratic function in z to reproduce
        for v in (2, 3, 4):
            for u in range(6):
                system[u, v] = 0.0
                system[v, u] = 0.0
            system[v, v] = system[0, 0]
    deficient = not _solve(system, right)  # L_i of eq. 6, and K_i
    if not deficient:
        # a system that is only nearly singular shows in an L_i far from a multiple of the identity
        largest = 0.0
        for v in range(dim if dim == 3 else 2):
            largest = max(largest, abs(right[v, 0] - dim / trace))
        for v in range(3, 6):
            largest = max(largest, 0.5 * abs(right[v, 0]))
        deficient = not largest < LOPSIDED * dim / trace
    if deficient:
        for v in range(6):
            for c in range(4):
                right[v, c] = 0.0
            if v < dim and trace > 0.0:
                right[v, 0] = dim / trace
    for k in range(3):
        s = 0.0
        for v in range(6):
            s += right[v, 0] * moments[6 + _THIRD[v, k]]
        gradient_part[k] = 2.0 * s
        if order == 2:
            for m in range(3):
                t = 1.0 if m == k else 0.0
                for v in range(6):
                    t += right[v, 1 + m] * moments[6 + _THIRD[v, k]]
                spread[m, k] = t
    return thin or deficient


@njit(cache=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _solve(a, b):
    """Gaussian elimination with row pivoting of a (6, 6) and b (6, 4), in place. False: singular.

    Whole rows are taken, of known length, though their first entries are zeros by then: they are vectors."""
    largest, smallest = 0.0, math.inf
    for k in range(6):
        best = k
        for r in range(k + 1, 6):
            if abs(a[r, k]) > abs(a[best, k]):
                best = r
        if best != k:
            for c in range(6):
                a[k, c], a[best, c] = a[best, c], a[k, c]
            for c in range(4):
                b[k, c], b[best, c] = b[best, c], b[k, c]
        pivot = abs(a[k, k])
        largest, smallest = max(largest, pivot), min(smallest, pivot)
        if not smallest > SINGULAR * largest:
            return False
        inverse = 1.0 / a[k, k]
        for r in range(k + 1, 6):
            f = a[r, k] * inverse
            if f != 0.0:
                for c in range(6):
                    a[r, c] -= f * a[k, c]
                for c in range(4):
                    b[r, c] -= f * b[k, c]
    for k in range(5, -1, -1):
        for m in range(k + 1, 6):
            f = a[k, m]
            for c in range(4):
                b[k, c] -= f * b[m, c]
        inverse = 1.0 / a[k, k]
        for c in range(4):
            b[k, c] *= inverse
    return True


@njit(cache=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def stencil_weights(stencil, padded, tensors, order, out):
    """Weights of every neighbour of a stencil (eqs 5 and 6) into out (4, padded).

    out[0]: of the Laplacian (times support^2); out[1:4]: of the gradient (times support).
    """
    ex, ey, ez, s, w = stencil
    g, _, right, gradient_part, spread = tensors
    lap, gx, gy, gz = out[0], out[1], out[2], out[3]
    g00, g01, g02, g11, g12, g22 = g[0, 0], g[0, 1], g[0, 2], g[1, 1], g[1, 2], g[2, 2]
    l0, l1, l2, l3, l4, l5 = right[0, 0], right[1, 0], right[2, 0], right[3, 0], right[4, 0], right[5, 0]
    d0, d1, d2 = gradient_part[0], gradient_part[1], gradient_part[2]
    for k in range(padded):
        x, y, z = ex[k], ey[k], ez[k]
        g0, g1, g2 = g00 * x + g01 * y + g02 * z, g01 * x + g11 * y + g12 * z, g02 * x + g12 * y + g22 * z
        tensor = x * (l0 * x + l4 * z + l5 * y) + y * (l1 * y + l3 * z) + z * (l2 * z)
        lap[k] = w[k] * (2.0 * tensor / s[k] - (d0 * g0 + d1 * g1 + d2 * g2))  # eq. 6
        gx[k], gy[k], gz[k] = w[k] * g0, w[k] * g1, w[k] * g2  # eq. 5
    if order == 1:
        return
    s00, s01, s02 = spread[0, 0], spread[0, 1], spread[0, 2]
    s10, s11, s12 = spread[1, 0], spread[1, 1], spread[1, 2]
    s20, s21, s22 = spread[2, 0], spread[2, 1], spread[2, 2]
    a0, a1, a2, a3, a4, a5 = right[0, 1], right[1, 1], right[2, 1], right[3, 1], right[4, 1], right[5, 1]
    b0, b1, b2, b3, b4, b5 = right[0, 2], right[1, 2], right[2, 2], right[3, 2], right[4, 2], right[5, 2]
    c0, c1, c2, c3, c4, c5 = right[0, 3], right[1, 3], right[2, 3], right[3, 3], right[4, 3], right[5, 3]
    for k in range(padded):
        x, y, z, w_over_s = ex[k], ey[k], ez[k], w[k] / s[k]
        xx, yy, zz, yz, xz, xy = x * x, y * y, z * z, y * z, x * z, x * y
        g0, g1, g2 = gx[k], gy[k], gz[k]
        # beyond eq. 5: what it misses of quadratic functions
        gx[k] = s00 * g0 + s01 * g1 + s02 * g2 - w_over_s * (
            a0 * xx + a1 * yy + a2 * zz + a3 * yz + a4 * xz + a5 * xy)
        gy[k] = s10 * g0 + s11 * g1 + s12 * g2 - w_over_s * (
            b0 * xx + b1 * yy + b2 * zz + b3 * yz + b4 * xz + b5 * xy)
        gz[k] = s20 * g0 + s21 * g1 + s22 * g2 - w_over_s * (
            c0 * xx + c1 * yy + c2 * zz + c3 * yz + c4 * xz + c5 * xy)
