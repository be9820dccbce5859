"""The operators of a steady solve in factors: a few tensors a particle in place of ten numbers a pair.

With e the unit vector from particle i to its neighbour j, s their distance over the support, w = F V support and

    a = w e,        T = w e (x) e / s        (xx yy zz yz xz xy)

the weights of eqs 5-6 (see `operators` and `walls`) are

    lap_ij = L_i : T - b_i . a,   grad_ij = M_i a - K_i : T,   grad_p_ij = Q_i a,   natural_ij = c_i w / s .

K makes the gradient of the velocity exact for quadratic functions. A lattice has as many different (a, T) as a star
has neighbours, however many particles there are: a pair keeps the number of its shape, one byte, where the weights
took 80.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit, prange

from .kernel import normalisation, slope
from .operators import (
    CHUNKS,
    correction,
    gather_star,
    invert_gradient,
    new_star,
    second_moments,
    star_moments,
    star_size,
)
from .walls import add_slip, set_wall_velocity

# Share by which diagonals of the conductances are raised. Pressure is known up to a constant in each component; in a
# pocket smaller than an aggregate the coarse matrices hold nothing but that constant and divide by round-off.
GROUND = 1e-6
MOST_SHAPES = 255  # more, and every pair keeps a shape of its own: particles off a lattice


@dataclass(frozen=True)
class Rows:
    """Rows of the fluid particles over the fluid neighbours in sight; columns are owners.

    start: (n + 1,); column: (n_pairs,) int32; shape: (n_pairs,) number of the pair's shape.
    Of the shapes: step (m, dim) x_j - x_i, m; pull (m, 3) a; bend (m, 6) T; tie (m,) w / s.
    Of the particles: laplace (n, 9) L and b, 1/m2; gradient (n, dim, dim) M and gradient_p Q, 1/m; scale (n,) c,
    1/m2; curve (n, dim, 6) K, 1/m, or (0, dim, 6) for gradients of first order; curve_p, the same of the pressure
    gradient away from walls, (0, dim, 6) on a lattice, where it vanishes.
    Sums over the neighbours beyond walls, see `walls.WallSums`: wall_lap (n,), wall_lap_velocity (n, dim),
    wall_div (n, dim), wall_div_velocity (n,), slip (n, dim, dim) or None.
    deficient: particles that fell back on a simpler correction.
    """

    start: np.ndarray
    column: np.ndarray
    shape: np.ndarray
    step: np.ndarray
    pull: np.ndarray
    bend: np.ndarray
    tie: np.ndarray
    laplace: np.ndarray
    gradient: np.ndarray
    gradient_p: np.ndarray
    scale: np.ndarray
    curve: np.ndarray
    curve_p: np.ndarray
    wall_lap: np.ndarray
    wall_lap_velocity: np.ndarray
    wall_div: np.ndarray
    wall_div_velocity: np.ndarray
    slip: np.ndarray | None
    deficient: int

    @property
    def n(self):
        """Number of fluid particles."""
        return len(self.start) - 1


def build_rows(x, pairs, fraction, owner, volume, table, kind, support, order=1):
    """(Rows, row of each pair in the table of positions); arguments as those of `walls.build_wall_operators`."""
    n, dim = len(pairs.start) - 1, x.shape[1]
    start, row = _in_sight(pairs.start, pairs.index, fraction)
    shape, step, count = _shapes(x, start, row, 1e-6 * support)
    if count <= MOST_SHAPES:
        step, weight = step[:count].copy(), np.full(count, volume[0])
    else:
        shape = np.arange(len(row), dtype=np.int32)
        step, weight = x[row] - np.repeat(x[:n], np.diff(start), axis=0), volume[owner[row]]
    pull, bend, tie = _shape_weights(step, weight, kind, support)
    slips = bool(np.any(table.slip_length > 0.0))
    tensors = (np.empty((n, 9)), np.empty((n, dim, dim)), np.empty((n, dim, dim)), np.empty(n),
               np.zeros((n if order == 2 else 0, dim, 6)),
               np.zeros((n if order == 2 and count > MOST_SHAPES else 0, dim, 6)))
    sums = np.zeros(n), np.zeros((n, dim)), np.zeros((n, dim)), np.zeros(n)
    slip = np.zeros((n if slips else 0, dim, dim))
    spin = np.zeros((0, dim, dim)) if table.spin is None else table.spin
    deficient = _factors(x, pairs.start, pairs.index, fraction, owner, volume, kind, support, order,
                         table.distance, table.wall, table.velocity, spin, table.slip_length, table.normal,
                         *tensors, *sums, slip)
    return Rows(start, owner[row], shape, step, pull, bend, tie, *tensors, *sums, slip if slips else None,
                int(deficient.sum())), row


def velocity_matrix(rows, dx, dtype=float):
    """-dx^2 lap, walls included, in canonical CSR form."""
    return _canonical(rows, *_velocity_entries(rows.start, rows.column, rows.shape, rows.pull, rows.bend, rows.laplace,
                                               rows.wall_lap, dx * dx, np.dtype(dtype).type(0)))


def conductance_matrix(rows, w, dx):
    """-dx^2 div(w grad) with the natural weights and harmonic means of w (n,) over the pairs, canonical CSR.

    Its diagonal is raised by `GROUND`.
    """
    entries = _conductance_entries(rows.start, rows.column, rows.shape, rows.tie, rows.scale, w, dx * dx)
    return _canonical(rows, *entries)


def _canonical(rows, start, column, entries):
    matrix = sp.csr_matrix((entries, column, start), shape=(rows.n, rows.n))
    matrix.sum_duplicates()
    return matrix


def gradient_p(rows, p):
    """Pressure gradient (n, dim) of p (n,)."""
    gradient = _gradient_p(rows.start, rows.column, rows.shape, rows.pull, rows.gradient_p, p)
    if len(rows.curve_p):
        gradient -= _bent(rows.start, rows.column, rows.shape, rows.bend, rows.curve_p, p)
    return gradient


def potential_gradient(rows, force):
    """The force (dim,) as the gradient of its potential in the pressure's own operator, (n, dim)."""
    return _potential_gradient(rows.start, rows.shape, rows.pull, rows.bend, rows.step, rows.gradient_p, rows.curve_p,
                               force)


def total_divergence(rows, u):
    """Consistent divergence (n,) of u (n, dim), walls included."""
    zero = np.zeros(rows.n)
    return divergence_and_jump(rows, u, zero, u, 1.0, 0.0, False) + rows.wall_div_velocity


def divergence_and_jump(rows, u, p, grad_p, a, b, conservative):
    """a div u + b S p without the velocity of the walls, (n,); see `coupling`.

    conservative: on a lattice the divergence may be the balance of the fluxes w_ij x_ji . (u_i + u_j) / 2 between
    neighbours, which is exact for linear fields too where the neighbourhood is whole. It adds up to zero over the
    fluid whatever the walls. The consistent divergence does not: in pores a few particles wide the errors that it
    leaves are as large as the flow through a throat, and GMRES stalls (bead pack at 1.2 particles a bead: residual
    0.6 after 200 iterations, against 130 iterations to 1e-6).
    """
    return _divergence_and_jump(rows.start, rows.column, rows.shape, rows.step, rows.pull, rows.tie, rows.bend,
                                rows.gradient, rows.curve, rows.scale, rows.wall_div, u, p, grad_p, a, b, conservative)


def momentum(rows, u, p, dx, out, grad_p):
    """-dx^2 lap u + dx grad p into out (n, dim), grad p into grad_p (n, dim)."""
    _momentum(rows.start, rows.column, rows.shape, rows.pull, rows.bend, rows.laplace, rows.gradient_p, rows.wall_lap,
              dx, u, p, out, grad_p)
    if len(rows.curve_p):
        bent = _bent(rows.start, rows.column, rows.shape, rows.bend, rows.curve_p, p)
        grad_p -= bent
        out -= dx * bent


def natural_laplacian(rows, f):
    """sum_j natural_ij (f_j - f_i), (n,)."""
    return _natural(rows.start, rows.column, rows.shape, rows.tie, rows.scale, f)


# --- building ----------------------------------------------------------------------------------------------------


@njit(cache=True)
def _in_sight(start, index, fraction):
    """Row pointers and rows in the table of the neighbours that no wall hides."""
    n = len(start) - 1
    first = np.zeros(n + 1, np.int64)
    for i in range(n):
        first[i + 1] = first[i]
        for q in range(start[i], start[i + 1]):
            first[i + 1] += fraction[q] > 1.0
    row = np.empty(first[n], np.int32)
    at = 0
    for q in range(len(index)):
        if fraction[q] > 1.0:
            row[at] = index[q]
            at += 1
    return first, row


@njit(cache=True)
def _shapes(x, start, row, tolerance):
    """Number of the shape of each pair, the steps of the shapes, and how many; gives up beyond MOST_SHAPES."""
    dim = x.shape[1]
    shape = np.empty(len(row), np.uint8)
    step = np.empty((MOST_SHAPES, dim))
    count = 0
    for i in range(len(start) - 1):
        guess = 0  # rows list their neighbours in the same order
        for q in range(start[i], start[i + 1]):
            found = -1
            for tried in range(count):
                t = guess + tried
                if t >= count:
                    t -= count
                off = 0.0
                for k in range(dim):
                    off = max(off, abs(x[row[q], k] - x[i, k] - step[t, k]))
                if off < tolerance:
                    found = t
                    break
            if found < 0:
                if count == MOST_SHAPES:
                    return shape, step, count + 1
                for k in range(dim):
                    step[count, k] = x[row[q], k] - x[i, k]
                found = count
                count += 1
            shape[q] = found
            guess = found + 1
    return shape, step, count


@njit(cache=True)
def _shape_weights(step, volume, kind, support):
    m, dim = step.shape
    pull, bend, tie = np.zeros((m, 3)), np.zeros((m, 6)), np.zeros(m)
    factor = normalisation(kind, support, dim)
    e = np.zeros(3)
    for t in range(m):
        r = 0.0
        for k in range(dim):
            r += step[t, k] ** 2
        r = np.sqrt(r)
        if r == 0.0:  # coincident particles do not act on each other
            continue
        for k in range(dim):
            e[k] = step[t, k] / r
        s = r / support
        w = volume[t] * factor * slope(kind, s)
        tie[t] = w / s
        for k in range(3):
            pull[t, k] = w * e[k]
            bend[t, k] = tie[t] * e[k] * e[k]
        bend[t, 3], bend[t, 4], bend[t, 5] = tie[t] * e[1] * e[2], tie[t] * e[0] * e[2], tie[t] * e[0] * e[1]
    return pull, bend, tie


@njit(cache=True, parallel=True)
def _factors(x, start, index, fraction, owner, volume, kind, support, order,
             distance, wall, velocity, spin, slip_length, normal,
             laplace, gradient, gradient_p, scale, curve, curve_p,
             wall_lap, wall_lap_velocity, wall_div, wall_div_velocity, slip):
    """As `walls._wall_rows`, but the tensors are kept and the weights of the wall pairs only summed up."""
    n, dim, size = len(start) - 1, x.shape[1], star_size(start)
    deficient = np.zeros(CHUNKS, np.int64)
    per_length = 1.0 / support
    per_area = per_length * per_length
    for chunk in prange(CHUNKS):
        star, moments = new_star(size), np.empty(41)
        ex, ey, ez, s, w = star
        g, gp, system, right = np.empty((3, 3)), np.empty((3, 3)), np.empty((6, 6)), np.empty((6, 4))
        drift, spread, wall_u, slide = np.empty(3), np.empty((3, 3)), np.empty(dim), np.empty((dim, dim))
        pull, bend, slopes = np.empty(3), np.empty(6), np.empty(3)
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            begin, count = start[i], start[i + 1] - start[i]
            padded = gather_star(x, i, begin, start[i + 1], index, owner, volume, kind, support, star)
            full, near = 0.0, False  # sum of w r over the whole star, dummies at their own places
            for k in range(count):
                full += w[k] * s[k]
            for k in range(count):
                if fraction[begin + k] <= 1.0:
                    near = True
                    s[k] *= fraction[begin + k]  # to where the pair meets the wall
            star_moments(star, padded, moments)
            poor = invert_gradient(moments, dim, g)
            poor |= correction(moments, dim, order, g, system, right, drift, spread)
            deficient[chunk] += poor
            scale[i] = 2.0 * dim * per_area / full if full > 0.0 else 0.0
            for v in range(6):
                laplace[i, v] = 2.0 * per_area * right[v, 0]
            for k in range(3):
                laplace[i, 6 + k] = per_area * (g[k, 0] * drift[0] + g[k, 1] * drift[1] + g[k, 2] * drift[2])
            for m in range(dim):
                for k in range(dim):
                    gradient[i, m, k] = per_length * g[m, k]
                    gradient_p[i, m, k] = per_length * g[m, k]
                if order == 2:
                    for k in range(dim):
                        gradient[i, m, k] = per_length * (
                            spread[m, 0] * g[0, k] + spread[m, 1] * g[1, k] + spread[m, 2] * g[2, k])
                    for v in range(6):
                        curve[i, m, v] = per_length * right[v, 1 + m]
            if not near:
                if len(curve_p) > 0:
                    gradient_p[i], curve_p[i] = gradient[i], curve[i]
                continue
            second_moments(star, fraction[begin : begin + count], moments)
            invert_gradient(moments, dim, gp)
            for m in range(dim):
                for k in range(dim):
                    gradient_p[i, m, k] = per_length * gp[m, k]
            for q in range(count):
                if fraction[begin + q] > 1.0:
                    continue
                pull[0], pull[1], pull[2] = w[q] * ex[q], w[q] * ey[q], w[q] * ez[q]
                b = w[q] / s[q]
                bend[0], bend[1], bend[2] = b * ex[q] * ex[q], b * ey[q] * ey[q], b * ez[q] * ez[q]
                bend[3], bend[4], bend[5] = b * ey[q] * ez[q], b * ex[q] * ez[q], b * ex[q] * ey[q]
                a = 0.0
                for v in range(6):
                    a += laplace[i, v] * bend[v]
                for k in range(3):
                    a -= laplace[i, 6 + k] * pull[k]
                j = index[begin + q]
                met = wall[j]
                wall_lap[i] += a
                set_wall_velocity(x[i], star, q, support, velocity, spin, met, wall_u)
                for m in range(dim):
                    slopes[m] = 0.0
                    for k in range(dim):
                        slopes[m] += gradient[i, m, k] * pull[k]
                    if order == 2:
                        for v in range(6):
                            slopes[m] -= curve[i, m, v] * bend[v]
                    wall_lap_velocity[i, m] += a * wall_u[m]
                    wall_div[i, m] += slopes[m]
                    wall_div_velocity[i] += slopes[m] * wall_u[m]
                if slip_length[met] > 0.0:
                    add_slip(a, slopes, 1.0, slip_length[met], max(distance[i], 0.0),
                             normal, j, wall_u, slide,
                             slip[i], wall_lap_velocity[i], wall_div[i], wall_div_velocity, i)
    return deficient


@njit(cache=True, inline="always")
def _lap_weight(laplace, i, bend, pull, t):
    return (laplace[i, 0] * bend[t, 0] + laplace[i, 1] * bend[t, 1] + laplace[i, 2] * bend[t, 2]
            + laplace[i, 3] * bend[t, 3] + laplace[i, 4] * bend[t, 4] + laplace[i, 5] * bend[t, 5]
            - laplace[i, 6] * pull[t, 0] - laplace[i, 7] * pull[t, 1] - laplace[i, 8] * pull[t, 2])


@njit(cache=True, parallel=True)
def _velocity_entries(start, column, shape, pull, bend, laplace, wall_lap, area, zero):
    n = len(start) - 1
    first = np.empty(n + 1, np.int32)
    index, entries = np.empty(len(column) + n, np.int32), np.empty(len(column) + n, type(zero))
    first[n] = len(index)
    for i in prange(n):
        at = start[i] + i
        first[i] = at
        total = wall_lap[i]
        for q in range(start[i], start[i + 1]):
            a = _lap_weight(laplace, i, bend, pull, shape[q])
            total += a
            index[q + i + 1], entries[q + i + 1] = column[q], -area * a
        index[at], entries[at] = i, area * total
    return first, index, entries


@njit(cache=True, parallel=True)
def _conductance_entries(start, column, shape, tie, scale, w, area):
    n = len(start) - 1
    first = np.empty(n + 1, np.int32)
    index, entries = np.empty(len(column) + n, np.int32), np.empty(len(column) + n)
    first[n] = len(index)
    for i in prange(n):
        at = start[i] + i
        first[i] = at
        total = 0.0
        for q in range(start[i], start[i + 1]):
            j = column[q]
            a = scale[i] * tie[shape[q]] * 2.0 * w[i] * w[j] / (w[i] + w[j])
            total += a
            index[q + i + 1], entries[q + i + 1] = j, -area * a
        index[at], entries[at] = i, (1.0 + GROUND) * area * total if total > 0.0 else 1.0
    return first, index, entries


# --- applying ----------------------------------------------------------------------------------------------------


@njit(cache=True, parallel=True)
def _momentum(start, column, shape, pull, bend, laplace, gradient_p, wall_lap, dx, u, p, out, grad_p):
    n, dim = u.shape
    for i in prange(n):
        s0 = s1 = s2 = v0 = v1 = v2 = 0.0
        u0, u1, u2, pi = u[i, 0], u[i, 1], u[i, 2] if dim == 3 else 0.0, p[i]
        for q in range(start[i], start[i + 1]):
            j, t = column[q], shape[q]
            dp = p[j] - pi
            s0 += pull[t, 0] * dp
            s1 += pull[t, 1] * dp
            s2 += pull[t, 2] * dp
            a = _lap_weight(laplace, i, bend, pull, t)
            v0 += a * (u[j, 0] - u0)
            v1 += a * (u[j, 1] - u1)
            if dim == 3:
                v2 += a * (u[j, 2] - u2)
        for k in range(dim):
            grad_p[i, k] = gradient_p[i, k, 0] * s0 + gradient_p[i, k, 1] * s1
            if dim == 3:
                grad_p[i, k] += gradient_p[i, k, 2] * s2
        out[i, 0] = dx * dx * (wall_lap[i] * u0 - v0) + dx * grad_p[i, 0]
        out[i, 1] = dx * dx * (wall_lap[i] * u1 - v1) + dx * grad_p[i, 1]
        if dim == 3:
            out[i, 2] = dx * dx * (wall_lap[i] * u2 - v2) + dx * grad_p[i, 2]


@njit(cache=True, parallel=True)
def _divergence_and_jump(start, column, shape, step, pull, tie, bend, gradient, curve, scale, wall_div, u, p, grad_p,
                         a, b, conservative):
    n, dim = u.shape
    out = np.empty(n)
    for i in prange(n):
        divergence, flux, jump = 0.0, 0.0, 0.0
        if not conservative:
            for k in range(dim):
                divergence -= wall_div[i, k] * u[i, k]
        for q in range(start[i], start[i + 1]):
            j, t = column[q], shape[q]
            missed, along = p[j] - p[i], 0.0
            for k in range(dim):
                missed -= 0.5 * (grad_p[i, k] + grad_p[j, k]) * step[t, k]
                if conservative:
                    along += 0.5 * (u[i, k] + u[j, k]) * step[t, k]
                else:
                    g = 0.0
                    for m in range(dim):
                        g += gradient[i, k, m] * pull[t, m]
                    if len(curve) > 0:
                        for v in range(6):
                            g -= curve[i, k, v] * bend[t, v]
                    divergence += g * (u[j, k] - u[i, k])
            flux += tie[t] * along
            jump += tie[t] * missed
        out[i] = a * (divergence + scale[i] * flux) + b * scale[i] * jump
    return out


@njit(cache=True, parallel=True)
def _gradient_p(start, column, shape, pull, gradient_p, p):
    n, dim = len(p), gradient_p.shape[1]
    out = np.empty((n, dim))
    for i in prange(n):
        s0 = s1 = s2 = 0.0
        for q in range(start[i], start[i + 1]):
            dp, t = p[column[q]] - p[i], shape[q]
            s0 += pull[t, 0] * dp
            s1 += pull[t, 1] * dp
            s2 += pull[t, 2] * dp
        for k in range(dim):
            out[i, k] = gradient_p[i, k, 0] * s0 + gradient_p[i, k, 1] * s1
            if dim == 3:
                out[i, k] += gradient_p[i, k, 2] * s2
    return out


@njit(cache=True, parallel=True)
def _bent(start, column, shape, bend, curve_p, p):
    """K_i : sum_j T (p_j - p_i), (n, dim)."""
    n, dim = len(p), curve_p.shape[1]
    out = np.zeros((n, dim))
    for i in prange(n):
        for q in range(start[i], start[i + 1]):
            dp, t = p[column[q]] - p[i], shape[q]
            for k in range(dim):
                for v in range(6):
                    out[i, k] += curve_p[i, k, v] * bend[t, v] * dp
    return out


@njit(cache=True, parallel=True)
def _potential_gradient(start, shape, pull, bend, step, gradient_p, curve_p, force):
    n, dim = len(start) - 1, len(force)
    out = np.zeros((n, dim))
    for i in prange(n):
        for q in range(start[i], start[i + 1]):
            rise = 0.0
            for k in range(dim):
                rise += force[k] * step[shape[q], k]
            for k in range(dim):
                for m in range(dim):
                    out[i, k] += gradient_p[i, k, m] * pull[shape[q], m] * rise
                if len(curve_p) > 0:
                    for v in range(6):
                        out[i, k] -= curve_p[i, k, v] * bend[shape[q], v] * rise
    return out


@njit(cache=True, parallel=True)
def _natural(start, column, shape, tie, scale, f):
    out = np.empty(len(f))
    for i in prange(len(f)):
        s = 0.0
        for q in range(start[i], start[i + 1]):
            s += tie[shape[q]] * (f[column[q]] - f[i])
        out[i] = scale[i] * s
    return out
