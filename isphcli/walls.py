"""Walls: neighbours beyond a wall, the consistent form of paper eq. 11.

Eq. 11 extends a Dirichlet field linearly into the wall, f_D = f_W + (d_D / d_I)(f_W - f_I). With t the
fraction of the way from the fluid particle i to the dummy particle at which the pair crosses the wall,
(f_D - f_I) / r = (f_W - f_I) / (t r): the slope of eq. 6 is that to the point where the pair meets the wall.
We therefore put that point, and not the dummy, into the correction tensors G_i and L_i as well. Quadratic
functions with their wall values are then exact at any wall distance (plane Poiseuille flow to round-off), and
every particle keeps its full star of directions, in a throat one particle wide too.

Pairs of fluid particles that see each other only through a wall are wall pairs as well.

Pressure has no values at walls: its gradient is corrected over fluid neighbours only, its Laplacian is the
uncorrected sum over them (homogeneous Neumann, conservative).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from .operators import (
    CHUNKS,
    SHARED,
    Operators,
    correction,
    gather_star,
    invert_gradient,
    new_star,
    second_moments,
    star_moments,
    star_size,
    star_weights,
)

AT_ONCE = 4_000_000  # pairs asked of the geometry in one go: bounds the memory of large scenes
NEAREST = 0.02  # of a pair: nearest a wall may be; nearer ones triple the iterations and change k by 1e-5


@dataclass(frozen=True)
class WallSums:
    """What the wall contributes to the rows of the fluid particles, walls moving with velocity u_W.

    lap: (n,) sum of the Laplacian weights a_iW; lap_velocity: (n, dim) sum a_iW u_W;
    div: (n, dim) sum of the gradient weights g_iW; div_velocity: (n,) sum g_iW . u_W;
    slip: (n, dim, dim) what a slip wall takes off the diagonal, or None where no wall slips;
    natural: (n_pairs,) symmetric-form weights of the pressure Laplacian;
    row: (n_pairs,) int32 row of each fluid neighbour in the table of positions;
    near: (n,) bool, particle sees a wall, or fluid that it shares no pressure with;
    few, still: (n,) bool, see `coupling.crowding`, or None where there are none.
    """

    lap: np.ndarray
    lap_velocity: np.ndarray
    div: np.ndarray
    div_velocity: np.ndarray
    slip: np.ndarray | None
    natural: np.ndarray
    row: np.ndarray
    near: np.ndarray
    few: np.ndarray | None = None
    still: np.ndarray | None = None


@dataclass(frozen=True)
class WallTable:
    """Wall data of every row of the table of positions.

    fluid: (n_rows,) bool; distance: (n_rows,) signed, m; wall: (n_rows,) int32 nearest wall;
    velocity: (n_walls, dim) m/s; slip_length: (n_walls,) m; normal: (n_rows, dim) into the fluid,
    used by slip walls only (else empty); spin: (n_walls, dim, dim) 1/s where walls turn, u_W = velocity + spin x.
    """

    fluid: np.ndarray
    distance: np.ndarray
    wall: np.ndarray
    velocity: np.ndarray
    slip_length: np.ndarray
    normal: np.ndarray
    spin: np.ndarray | None = None


def crossings(geometry, x, pairs, table):
    """Fraction t of each pair at which it meets a wall, (n_pairs,) in (0, 1]; 2.0 for fluid pairs in sight.

    geometry: a Geometry; x: (n_rows, dim); pairs: neighbours of the fluid particles; table: WallTable.
    """
    fraction = np.full(len(pairs.index), 2.0)
    ask = _suspects(x, pairs.start, pairs.index, table.fluid, table.distance)
    for begin in range(0, len(ask), AT_ONCE):
        some = ask[begin : begin + AT_ONCE]
        i = np.searchsorted(pairs.start, some, side="right") - 1
        j = pairs.index[some]
        t = geometry.crossing(x[i], x[j])
        # a fluid neighbour in sight stays one; a dummy that the geometry calls free is met at its own place
        sees = table.fluid[j] & (t >= 1.0)
        fraction[some] = np.where(sees, 2.0, np.clip(t, NEAREST, 1.0))
    return fraction


def build_wall_operators(x, pairs, fraction, owner, volume, table, kind, support, order=1, few=None, still=None):
    """Operators of a scene with walls.

    x: (n_rows, dim); pairs, fraction: neighbours of the n fluid particles and their wall crossings;
    owner: (n_rows,); volume: (n_owned,) of fluid particles and dummies; order: of the velocity gradient;
    few, still: of `WallSums`.
    """
    n, dim = len(pairs.start) - 1, x.shape[1]
    start = np.zeros(n + 1, dtype=np.int64)
    np.cumsum(in_sight(pairs.start, fraction), out=start[1:])
    size = start[-1]
    slips = bool(np.any(table.slip_length > 0.0))
    column, row = np.empty(size, np.int32), np.empty(size, np.int32)
    lap, natural, lap_p = np.empty(size), np.empty(size), np.empty(size)
    grad, grad_p = np.empty((size, dim)), np.empty((size, dim))
    spin = np.zeros((0, dim, dim)) if table.spin is None else table.spin
    sums = WallSums(np.zeros(n), np.zeros((n, dim)), np.zeros((n, dim)), np.zeros(n),
                    np.zeros((n, dim, dim)) if slips else None, natural, row, np.zeros(n, dtype=np.bool_), few, still)
    deficient = _wall_rows(
        x, pairs.start, pairs.index, fraction, owner, volume, kind, support, order,
        table.distance, table.wall, table.velocity, spin, table.slip_length, table.normal,
        start, column, row, lap, grad, natural, lap_p, grad_p,
        sums.lap, sums.lap_velocity, sums.div, sums.div_velocity,
        sums.slip if slips else np.zeros((0, dim, dim)), sums.near,
    )
    return Operators(start, column, lap, grad, lap_p, grad_p, volume[:n], int(deficient.sum()), sums)


def wall_laplacian(walls, u):
    """What walls add to the velocity Laplacian of u (n, dim)."""
    result = walls.lap_velocity - walls.lap[:, None] * u
    if walls.slip is not None:
        result += np.einsum("nkm,nm->nk", walls.slip, u)
    return result


def wall_divergence(walls, u):
    """What walls add to the divergence of u (n, dim), (n,)."""
    return walls.div_velocity - np.einsum("nk,nk->n", walls.div, u)


@njit(cache=True)
def _suspects(x, start, index, fluid, distance):
    """Pairs that may cross a wall: those with a dummy, and fluid pairs that two free balls do not cover."""
    count = 0
    keep = np.empty(len(index), np.bool_)
    for i in range(len(start) - 1):
        for p in range(start[i], start[i + 1]):
            j = index[p]
            keep[p] = not fluid[j]
            if fluid[j]:
                r2 = 0.0
                for k in range(x.shape[1]):
                    r2 += (x[j, k] - x[i, k]) ** 2
                clear = (distance[i] + distance[j]) * (1.0 + 1e-9)
                keep[p] = clear * clear < r2
            count += keep[p]
    out = np.empty(count, np.int64)
    count = 0
    for p in range(len(index)):
        if keep[p]:
            out[count] = p
            count += 1
    return out


@njit(cache=True)
def in_sight(start, fraction):
    """Neighbours (n,) of each particle that no wall hides."""
    counts = np.zeros(len(start) - 1, np.int64)
    for i in range(len(counts)):
        for p in range(start[i], start[i + 1]):
            counts[i] += fraction[p] > 1.0
    return counts


@njit(cache=True, parallel=True)
def _wall_rows(x, start, index, fraction, owner, volume, kind, support, order,
               distance, wall, velocity, spin, slip_length, normal,
               fluid_start, column, row, lap, grad, natural, lap_p, grad_p,
               wall_lap, wall_lap_velocity, wall_div, wall_div_velocity, slip, near):
    n, dim, size = len(start) - 1, x.shape[1], star_size(start)
    deficient = np.zeros(CHUNKS, np.int64)
    per_length = 1.0 / support
    per_area = per_length * per_length
    for chunk in prange(CHUNKS):
        star, moments, out = new_star(size), np.empty(41), np.empty((4, size))
        ex, ey, ez, s, w = star
        g, gp, system, right = np.empty((3, 3)), np.empty((3, 3)), np.empty((6, 6)), np.empty((6, 4))
        drift, spread, wall_u, slide = np.empty(3), np.empty((3, 3)), np.empty(dim), np.empty((dim, dim))
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            begin, count = start[i], start[i + 1] - start[i]
            padded = gather_star(x, i, begin, start[i + 1], index, owner, volume, kind, support, star)
            full = 0.0  # sum of w r over the whole star, dummies at their own places
            for k in range(count):
                full += w[k] * s[k]
            for k in range(count):
                near[i] |= fraction[begin + k] <= SHARED
                if fraction[begin + k] <= 1.0:
                    s[k] *= fraction[begin + k]  # to where the pair meets the wall
            star_moments(star, padded, moments)
            poor = invert_gradient(moments, dim, g)
            poor |= correction(moments, dim, order, g, system, right, drift, spread)
            deficient[chunk] += poor
            star_weights(star, padded, g, right, drift, spread, order, out)
            if near[i]:
                second_moments(star, fraction[begin : begin + count], moments)
                invert_gradient(moments, dim, gp)
            at = np.uint64(fluid_start[i])
            for k in range(count):
                j = np.uint32(index[begin + k])
                a = out[0, k] * per_area
                if fraction[begin + k] > 1.0:
                    column[at] = owner[j]
                    row[at] = j
                    lap[at] = a
                    shared = fraction[begin + k] > SHARED
                    natural[at] = 2.0 * dim * per_area * w[k] / (full * s[k]) if w[k] > 0.0 and shared else 0.0
                    lap_p[at] = natural[at] if near[i] else a
                    for m in range(dim):
                        grad[at, m] = out[1 + m, k] * per_length
                        if near[i]:
                            b = gp[m, 0] * ex[k] + gp[m, 1] * ey[k] + gp[m, 2] * ez[k]
                            grad_p[at, m] = b * w[k] * per_length if shared else 0.0
                        else:
                            grad_p[at, m] = grad[at, m]
                    at += np.uint64(1)
                else:
                    met = wall[j]
                    wall_lap[i] += a
                    set_wall_velocity(x[i], star, k, support, velocity, spin, met, wall_u)
                    for m in range(dim):
                        wall_lap_velocity[i, m] += a * wall_u[m]
                        wall_div[i, m] += out[1 + m, k] * per_length
                        wall_div_velocity[i] += out[1 + m, k] * per_length * wall_u[m]
                    if slip_length[met] > 0.0:
                        add_slip(a, out[1:, k], per_length, slip_length[met], max(distance[i], 0.0),
                                 normal, j, wall_u, slide,
                                 slip[i], wall_lap_velocity[i], wall_div[i], wall_div_velocity, i)
    return deficient


@njit(cache=True)
def set_wall_velocity(x, star, k, support, velocity, spin, wall, out):
    """Velocity of a wall where pair k of the star of a particle at x (dim,) meets it, into out (dim,)."""
    away, s = star[:3], star[3]
    for m in range(len(x)):
        out[m] = velocity[wall, m]
        if len(spin) > 0:
            for q in range(len(x)):
                out[m] += spin[wall, m, q] * (x[q] + away[q][k] * s[k] * support)


@njit(cache=True)
def add_slip(a, slope, per_length, length, distance, normal, j, wall_u, slide,
             slip, lap_velocity, div, div_velocity, i):
    """Navier slip: u at the wall is u_W + B (u_i - u_W), B = length / (length + d) times the projection
    on the wall."""
    dim = len(wall_u)
    factor = length / (length + distance)
    for k in range(dim):
        for m in range(dim):
            slide[k, m] = factor * ((1.0 if k == m else 0.0) - normal[j, k] * normal[j, m])
    for k in range(dim):
        for m in range(dim):
            slip[k, m] += a * slide[k, m]
            lap_velocity[k] -= a * slide[k, m] * wall_u[m]
            div[m] -= slope[k] * per_length * slide[k, m]
            div_velocity[i] -= slope[k] * per_length * slide[k, m] * wall_u[m]
