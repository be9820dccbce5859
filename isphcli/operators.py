"""Consistent gradient and Laplacian of one particle configuration (paper eqs 5-7).

With e the unit vector from particle i to neighbour j, s the distance between them, F = -W'(r) >= 0 and V the
particle volumes, the sums of eqs 5 and 6 read

    grad f_i = sum_j (f_j - f_i) G_i e F V_j
    lap f_i  = 2 sum_j (L_i : e (x) e) F V_j ((f_j - f_i) / s - e . grad f_i)

G_i makes linear functions exact. L_i (3 unknowns in 2D, 6 in 3D) makes every quadratic function exact,
the error of the corrected gradient included (Fatehi and Manzari 2011; Trask et al. 2015). The same small
system gives the term K_i that makes the gradient exact for quadratics too: `order=2`.

Lengths inside the kernels are divided by the support radius, so that nothing depends on the unit of length.
Scenes in 2D carry a third component of zero: one code path serves both.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from .kernel import normalisation, shape, slope

CHUNKS = 64  # rows are handed to threads in this many pieces, each with its own scratch arrays
SINGULAR = 1e-7  # scaled pivot below which a correction system counts as rank-deficient


@dataclass(frozen=True)
class Operators:
    """Weights of one configuration; the first `n` rows are the fluid particles.

    start: (n + 1,) row pointers; column: (n_pairs,) int32 owners of the fluid neighbours;
    lap: (n_pairs,) weights of the velocity Laplacian, 1/m2; grad: (n_pairs, dim) weights of the velocity gradient, 1/m;
    lap_p, grad_p: the same for the pressure (the very same arrays where a scene has no walls);
    volume: (n,) m^dim; deficient: particles that fell back on a simpler correction;
    walls: sums over the neighbours beyond a wall, or None (see `walls.WallSums`).
    """

    start: np.ndarray
    column: np.ndarray
    lap: np.ndarray
    grad: np.ndarray
    lap_p: np.ndarray
    grad_p: np.ndarray
    volume: np.ndarray
    deficient: int = 0
    walls: object = None

    @property
    def n(self):
        return len(self.start) - 1


def particle_volumes(x, pairs, kind, support):
    """V_i = 1 / sum_j W_ij, the sum including j = i (eq. 7), (n,) m^dim."""
    return _volumes(x, pairs.start, pairs.index, kind, support)


def build_operators(x, pairs, owner, volume, kind, support, order=2):
    """Operators of a scene without walls.

    x: (n_rows, dim) owned particles and halo; pairs: neighbours of the owned ones; owner: (n_rows,) int32;
    volume: (n,); kind: kernel number; support: m; order: 1 (eq. 5) or 2 (gradient exact for quadratics).
    """
    lap, grad, deficient = _rows(x, pairs.start, pairs.index, owner, volume, kind, support, order)
    return Operators(pairs.start, owner[pairs.index], lap, grad, lap, grad, volume, int(deficient.sum()))


def laplacian(ops, f):
    """Velocity Laplacian of f (n, k) without the wall terms."""
    return _laplacian(ops.start, ops.column, ops.lap, f)


def gradient(ops, f):
    """Velocity gradient d f_c / d x_k of f (n, c) as (n, c, k), without the wall terms."""
    return _gradient(ops.start, ops.column, ops.grad, f)


def gradient_p(ops, p):
    """Pressure gradient (n, dim) of p (n,)."""
    return _gradient_scalar(ops.start, ops.column, ops.grad_p, p)


def divergence(ops, u):
    """Divergence (n,) of u (n, dim) without the wall terms."""
    return _divergence(ops.start, ops.column, ops.grad, u)


@njit(cache=True, parallel=True)
def _volumes(x, start, index, kind, support):
    n, dim = len(start) - 1, x.shape[1]
    volume = np.empty(n)
    scale = normalisation(kind, support, dim)
    for i in prange(n):
        total = shape(kind, 0.0)
        for p in range(start[i], start[i + 1]):
            r2 = 0.0
            for k in range(dim):
                r2 += (x[index[p], k] - x[i, k]) ** 2
            total += shape(kind, math.sqrt(r2) / support)
        volume[i] = 1.0 / (scale * total)
    return volume


@njit(cache=True)
def direction(x, i, j, support, pair):
    """Writes e into pair[0:3]; returns r / support. Coincident particles get no direction and r = 0."""
    d0, d1 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1]
    d2 = x[j, 2] - x[i, 2] if x.shape[1] == 3 else 0.0
    r = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    inverse = 1.0 / r if r > 0.0 else 0.0
    pair[0], pair[1], pair[2] = d0 * inverse, d1 * inverse, d2 * inverse
    return r / support


@njit(cache=True)
def add_moments(moments, pair, s, weight):
    """Adds a neighbour to the moment sums. pair[0:3] = e, s = distance / support, weight = F V.

    moments[0:6]: sum w s e e; [6:16]: sum w e e e; [16:26]: sum w s^2 e e e; [26:41]: sum w s e e e e,
    the components of each in the order of `_unpack`.
    """
    x, y, z = pair[0], pair[1], pair[2]
    xx, yy, zz, yz, xz, xy = x * x, y * y, z * z, y * z, x * z, x * y
    a = weight * s
    ax, ay, az, ayz, axz, axy = a * xx, a * yy, a * zz, a * yz, a * xz, a * xy
    moments[0] += ax
    moments[1] += ay
    moments[2] += az
    moments[3] += ayz
    moments[4] += axz
    moments[5] += axy
    c0, c1, c2, c3, c4 = x * xx, y * yy, z * zz, x * xy, x * xz
    c5, c6, c7, c8, c9 = y * xy, y * yz, z * xz, z * yz, x * yz
    moments[6] += weight * c0
    moments[7] += weight * c1
    moments[8] += weight * c2
    moments[9] += weight * c3
    moments[10] += weight * c4
    moments[11] += weight * c5
    moments[12] += weight * c6
    moments[13] += weight * c7
    moments[14] += weight * c8
    moments[15] += weight * c9
    b = a * s
    moments[16] += b * c0
    moments[17] += b * c1
    moments[18] += b * c2
    moments[19] += b * c3
    moments[20] += b * c4
    moments[21] += b * c5
    moments[22] += b * c6
    moments[23] += b * c7
    moments[24] += b * c8
    moments[25] += b * c9
    moments[26] += ax * xx
    moments[27] += ax * yy
    moments[28] += ax * zz
    moments[29] += ax * yz
    moments[30] += ax * xz
    moments[31] += ax * xy
    moments[32] += ay * yy
    moments[33] += ay * zz
    moments[34] += ay * yz
    moments[35] += ay * xz
    moments[36] += ay * xy
    moments[37] += az * zz
    moments[38] += az * yz
    moments[39] += az * xz
    moments[40] += az * xy


# Where the third moments (v, k), v a pair of axes in the order xx yy zz yz xz xy, stand among the ten distinct ones
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


@njit(cache=True)
def invert_gradient(moments, dim, g):
    """G_i = (sum w s e e)^-1 into g (3, 3); on a rank-deficient neighbourhood the pseudo-inverse.

    Returns True where it had to fall back. The pseudo-inverse gives the gradient in the directions that the
    neighbours span and zero in the others: what a pore one particle wide needs.
    """
    a, b, c = moments[0], moments[1], moments[2] if dim == 3 else moments[0] + moments[1]
    yz, xz, xy = moments[3], moments[4], moments[5]
    g[0, 0], g[1, 1], g[2, 2] = b * c - yz * yz, a * c - xz * xz, a * b - xy * xy
    g[0, 1], g[0, 2], g[1, 2] = xz * yz - xy * c, xy * yz - xz * b, xy * xz - yz * a
    determinant = a * g[0, 0] + xy * g[0, 1] + xz * g[0, 2]
    mean = (a + b + c) / 3.0
    deficient = not determinant > SINGULAR * mean * mean * mean
    if deficient:
        g[:] = 0.0
        if mean > 0.0:
            _pseudo_inverse(moments, dim, g)
        return True
    for k in range(3):
        g[k, k] /= determinant
    for k, m in ((0, 1), (0, 2), (1, 2)):
        g[k, m] /= determinant
        g[m, k] = g[k, m]
    return False


@njit(cache=True)
def _pseudo_inverse(moments, dim, g):
    a = np.empty((dim, dim))
    for k in range(dim):
        for m in range(dim):
            a[k, m] = moments[_SECOND[k, m]]
    values, vectors = np.linalg.eigh(a)
    for v in range(dim):
        if values[v] > 1e-4 * values[dim - 1]:
            for k in range(dim):
                for m in range(dim):
                    g[k, m] += vectors[k, v] * vectors[m, v] / values[v]


@njit(cache=True)
def correction(moments, dim, g, system, right, drift, spread):
    """Solves for L_i and K_i.

    moments: (41,) sums; g: (3, 3) G_i. Scratch: system (6, 6). Results, in the order xx yy zz yz xz xy:
    right (6, 4): column 0 the weights l of L_i : e e = sum_v l_v e_v, columns 1-3 K_i;
    drift (3,): 2 sum_v l_v R_v, what multiplies the gradient in the Laplacian; spread (3, 3): 1 + K R.
    Returns True where the system was rank-deficient: then L_i is a multiple of the identity and K_i zero.
    """
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
    deficient = not _solve(system, right)
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
        drift[k] = 2.0 * s
        for m in range(3):
            t = 1.0 if m == k else 0.0
            for v in range(6):
                t += right[v, 1 + m] * moments[6 + _THIRD[v, k]]
            spread[m, k] = t
    return deficient


@njit(cache=True)
def _solve(a, b):
    """Gaussian elimination with row pivoting of a (6, 6) and b (6, 4), in place. False where a is near singular."""
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
                for c in range(k + 1, 6):
                    a[r, c] -= f * a[k, c]
                for c in range(4):
                    b[r, c] -= f * b[k, c]
    for k in range(5, -1, -1):
        inverse = 1.0 / a[k, k]
        for c in range(4):
            s = b[k, c]
            for m in range(k + 1, 6):
                s -= a[k, m] * b[m, c]
            b[k, c] = s * inverse
    return True


@njit(cache=True)
def pair_weights(pair, s, weight, g, right, drift, spread, order, out):
    """Weights of one neighbour: out[0] of the Laplacian (times support^2), out[1:4] of the gradient (times support)."""
    x, y, z = pair[0], pair[1], pair[2]
    xx, yy, zz, yz, xz, xy = x * x, y * y, z * z, y * z, x * z, x * y
    g0 = weight * (g[0, 0] * x + g[0, 1] * y + g[0, 2] * z)
    g1 = weight * (g[1, 0] * x + g[1, 1] * y + g[1, 2] * z)
    g2 = weight * (g[2, 0] * x + g[2, 1] * y + g[2, 2] * z)
    near = weight / s
    tensor = (right[0, 0] * xx + right[1, 0] * yy + right[2, 0] * zz
              + right[3, 0] * yz + right[4, 0] * xz + right[5, 0] * xy)
    out[0] = 2.0 * tensor * near - (drift[0] * g0 + drift[1] * g1 + drift[2] * g2)
    if order == 1:
        out[1], out[2], out[3] = g0, g1, g2
    else:
        for m in range(3):
            bend = (right[0, 1 + m] * xx + right[1, 1 + m] * yy + right[2, 1 + m] * zz
                    + right[3, 1 + m] * yz + right[4, 1 + m] * xz + right[5, 1 + m] * xy)
            out[1 + m] = spread[m, 0] * g0 + spread[m, 1] * g1 + spread[m, 2] * g2 - bend * near


@njit(cache=True, parallel=True)
def _rows(x, start, index, owner, volume, kind, support, order):
    n, dim = len(start) - 1, x.shape[1]
    lap = np.empty(len(index))
    grad = np.empty((len(index), dim))
    deficient = np.zeros(CHUNKS, np.int64)
    scale = normalisation(kind, support, dim)
    for chunk in prange(CHUNKS):
        moments, pair, out = np.empty(41), np.empty(3), np.empty(4)
        g, system, right = np.empty((3, 3)), np.empty((6, 6)), np.empty((6, 4))
        drift, spread = np.empty(3), np.empty((3, 3))
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            moments[:] = 0.0
            for p in range(start[i], start[i + 1]):
                j = index[p]
                q = direction(x, i, j, support, pair)
                add_moments(moments, pair, q, slope(kind, q) * scale * volume[owner[j]])
            poor = invert_gradient(moments, dim, g)
            poor |= correction(moments, dim, g, system, right, drift, spread)
            deficient[chunk] += poor
            for p in range(start[i], start[i + 1]):
                j = index[p]
                q = direction(x, i, j, support, pair)
                if q == 0.0:  # coincident particles do not act on each other; shifting parts them
                    out[:] = 0.0
                else:
                    weight = slope(kind, q) * scale * volume[owner[j]]
                    pair_weights(pair, q, weight, g, right, drift, spread, order, out)
                lap[p] = out[0] / (support * support)
                for k in range(dim):
                    grad[p, k] = out[1 + k] / support
    return lap, grad, deficient


@njit(cache=True, parallel=True)
def _laplacian(start, column, lap, f):
    n, width = f.shape
    result = np.zeros((n, width))
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            for c in range(width):
                result[i, c] += lap[p] * (f[j, c] - f[i, c])
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
                    result[i, c, k] += grad[p, k] * d
    return result


@njit(cache=True, parallel=True)
def _gradient_scalar(start, column, grad, f):
    n, dim = len(f), grad.shape[1]
    result = np.zeros((n, dim))
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            d = f[column[p]] - f[i]
            for k in range(dim):
                result[i, k] += grad[p, k] * d
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
                s += grad[p, k] * (u[j, k] - u[i, k])
        result[i] = s
    return result
