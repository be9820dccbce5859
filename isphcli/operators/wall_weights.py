"""Operators beside walls: the consistent form of eq. 11.

Eq. 11 extends a Dirichlet field linearly into the wall, f_D = f_W + (d_D / d_I)(f_W - f_I). With t the
fraction of the way from the fluid particle i to the dummy particle at which the pair crosses the wall,
(f_D - f_I) / r = (f_W - f_I) / (t r): the slope of eq. 6 is that to the point where the pair meets the wall.
We therefore put that point, and not the dummy, into the correction tensors G_i and L_i as well. Quadratic
functions with their wall values are then exact at any wall distance (plane Poiseuille flow to round-off), and
every particle keeps neighbours in all directions, in a throat one particle wide too.

Pressure has no values at walls: its gradient is corrected over fluid neighbours only, its Laplacian is the
uncorrected sum over them (homogeneous Neumann, conservative).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from ..domain import reduce
from .crossings import MEETS_WALL, SHARES_PRESSURE, WallStencils, in_sight
from .moments import (
    CHUNKS,
    correction,
    gather_stencil,
    invert_gradient,
    new_correction,
    new_stencil,
    stencil_moments,
    stencil_size,
    stencil_weights,
)
from .pair_weights import Operators, WallRows


def build_wall_operators(stencil: WallStencils, order: int = 1, classes: np.ndarray | None = None) -> Operators:
    """Operators of a scene with walls.

    order: of the velocity gradient, 1 (eq. 5) or 2; classes: (n,) of `narrow_pores.classify_neighbourhoods`, or None
    where none are asked for: then none is narrow.
    """
    everyone, walls = stencil.neighbours, stencil.walls
    n = everyone.n
    start = np.zeros(n + 1, dtype=np.int64)
    np.cumsum(in_sight(everyone.start, stencil.links.link), out=start[1:])
    deficient, (column, row), (lap, grad, lap_p, grad_p, symmetric), near, (sums, slope_velocity) = _wall_rows(
        everyone, stencil.links, stencil.volume, order, walls, start)
    wall_sums = boundary_sums(sums)
    found = WallRows(*wall_sums, symmetric, near, near.astype(np.int8) if classes is None else classes,
                     slope_velocity if wall_sums[-1] is None else None)
    seen = everyone._replace(start=start, column=column, row=row)
    return Operators(seen, lap, grad, lap_p, grad_p, stencil.volume[:n], int(reduce.total(deficient)), found)


def wall_gradient(walls: WallRows, u: np.ndarray) -> np.ndarray:
    """What walls that do not slip add to the gradient of u (n, dim), (n, dim, dim)."""
    assert walls.slope_velocity is not None
    return walls.slope_velocity - u[:, :, None] * walls.div[:, None, :]


@njit(cache=True)
def meet_walls(stencil, t, link):
    """Moves the far ends of the pairs of a star to where they meet a wall (eq. 11). t, link: (count,), see `Links`.

    Returns the sum of w s over the star with the dummies at their own places, and whether it meets a wall or has a
    neighbour that it shares no pressure with.
    """
    s, w = stencil[3], stencil[4]
    whole, near = 0.0, False
    for k in range(len(link)):
        whole += w[k] * s[k]
    for k in range(len(link)):
        near |= link[k] != SHARES_PRESSURE
        if link[k] == MEETS_WALL:
            s[k] *= t[k]  # eq. 11: the slope to the wall, at the distance of the wall
    return whole, near


@njit(cache=True)
def second_moments(stencil, link, moments):
    """moments[0:6] of `stencil_moments` over the neighbours that share the pressure. link: (count,), see `Links`."""
    ex, ey, ez, s, w = stencil
    moments[:6] = 0.0
    for k in range(len(link)):
        if link[k] == SHARES_PRESSURE:
            x, y, z, a = ex[k], ey[k], ez[k], w[k] * s[k]
            moments[0] += a * x * x
            moments[1] += a * y * y
            moments[2] += a * z * z
            moments[3] += a * y * z
            moments[4] += a * x * z
            moments[5] += a * x * y


def boundary_sums(sums: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray,
                                                         np.ndarray | None]:
    """The arrays that kernels make, of `new_boundary_sums`, as fields of `WallSums`."""
    lap, lap_velocity, div, div_velocity, slip = sums
    return lap, lap_velocity, div, div_velocity, slip if len(slip) else None


@njit(cache=True)
def new_boundary_sums(n, dim, slip_length):
    """Arrays of WallSums of n particles, still zero; slip: (0, dim, dim) where no wall slips."""
    slips = n if np.any(slip_length > 0.0) else 0
    return np.zeros(n), np.zeros((n, dim)), np.zeros((n, dim)), np.zeros(n), np.zeros((slips, dim, dim))


@njit(cache=True)
def new_wall_pair(dim):
    """Scratch arrays for `add_wall_pair`: weights of the pair (4,), of the Laplacian and of the gradient; velocity of
    the wall (dim,); slip tensor (dim, dim)."""
    return np.empty(4), np.empty(dim), np.empty((dim, dim))


@njit(cache=True)
def add_wall_pair(neighbours, walls, i, k, stencil, pair, sums):
    """Adds neighbour k of the star of particle i, which is met at a wall, to the sums of the walls: eq. 11.

    pair: of `new_wall_pair`, with the weights of this one, 1/m2 and 1/m; sums: arrays of WallSums. With Navier
    slip, u at the wall is u_W + B (u_i - u_W), B = length / (length + d) times the projection on the wall.
    """
    weight, wall_u, slide = pair
    lap, lap_velocity, div, div_velocity, slip = sums
    x, dim = neighbours.x, neighbours.x.shape[1]
    j = neighbours.row[neighbours.start[i] + k]
    met = walls.wall[j]
    for m in range(dim):
        wall_u[m] = walls.velocity[met, m]
        if len(walls.spin) > 0:
            for q in range(dim):
                wall_u[m] += walls.spin[met, m, q] * (x[i, q] + stencil[q][k] * stencil[3][k] * neighbours.support)
    a = weight[0]
    # eq. 11: a neighbour at the crossing point that has the velocity of the wall
    lap[i] += a
    for m in range(dim):
        lap_velocity[i, m] += a * wall_u[m]
        div[i, m] += weight[1 + m]
        div_velocity[i] += weight[1 + m] * wall_u[m]
    length = walls.slip_length[met]
    if length > 0.0:
        normal, factor = walls.normal, length / (length + max(walls.distance[i], 0.0))
        for q in range(dim):
            for m in range(dim):
                slide[q, m] = factor * ((1.0 if q == m else 0.0) - normal[j, q] * normal[j, m])
        for q in range(dim):
            for m in range(dim):
                slip[i, q, m] += a * slide[q, m]
                lap_velocity[i, q] -= a * slide[q, m] * wall_u[m]
                div[i, m] -= weight[1 + q] * slide[q, m]
                div_velocity[i] -= weight[1 + q] * slide[q, m] * wall_u[m]


@njit(cache=True, parallel=True)
def _wall_rows(neighbours, links, volume, order, walls, seen_start):
    """(deficient, (columns, rows), weights of the pairs in sight, near, (arrays of WallSums, slope_velocity)).

    All that it makes is returned: numba loses what a parallel loop writes to arrays that came in a tuple.
    """
    start, per_length, t, link = neighbours.start, 1.0 / neighbours.support, links.t, links.link
    n, dim, size = len(start) - 1, neighbours.x.shape[1], stencil_size(start)
    pairs = seen_start[n]
    column, row, near = np.empty(pairs, np.int32), np.empty(pairs, np.int32), np.zeros(n, np.bool_)
    lap, symmetric, lap_p = np.empty(pairs), np.empty(pairs), np.empty(pairs)
    grad, grad_p = np.empty((pairs, dim)), np.empty((pairs, dim))
    wall_lap, wall_lap_velocity, wall_div, wall_div_velocity, slip = new_boundary_sums(n, dim, walls.slip_length)
    slope_velocity = np.zeros((n, dim, dim))
    deficient = np.zeros(CHUNKS, np.int64)
    per_area = per_length * per_length
    for chunk in prange(CHUNKS):
        stencil, moments, out = new_stencil(size), np.empty(41), np.empty((4, size))
        ex, ey, ez, s, w = stencil
        tensors, g_p, pair = new_correction(), np.empty((3, 3)), new_wall_pair(dim)
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            begin, count = start[i], start[i + 1] - start[i]
            padded = gather_stencil(neighbours, i, volume, stencil)
            whole, near[i] = meet_walls(stencil, t[begin : begin + count], link[begin : begin + count])
            stencil_moments(stencil, padded, moments)
            deficient[chunk] += correction(moments, dim, order, tensors)
            stencil_weights(stencil, padded, tensors, order, out)
            if near[i]:
                second_moments(stencil, link[begin : begin + count], moments)
                invert_gradient(moments, dim, g_p)
            at = np.uint64(seen_start[i])
            for k in range(count):
                a = out[0, k] * per_area
                if link[begin + k] != MEETS_WALL:
                    column[at] = neighbours.column[begin + k]
                    row[at] = neighbours.row[begin + k]
                    lap[at] = a
                    shared = link[begin + k] == SHARES_PRESSURE
                    # eq. 3 beside walls: no flux through them, so that only fluid neighbours count
                    symmetric[at] = 2.0 * dim * per_area * w[k] / (whole * s[k]) if w[k] > 0.0 and shared else 0.0
                    lap_p[at] = symmetric[at] if near[i] else a
                    for m in range(dim):
                        grad[at, m] = out[1 + m, k] * per_length
                        if near[i]:
                            b = g_p[m, 0] * ex[k] + g_p[m, 1] * ey[k] + g_p[m, 2] * ez[k]
                            grad_p[at, m] = b * w[k] * per_length if shared else 0.0
                        else:
                            grad_p[at, m] = grad[at, m]
                    at += np.uint64(1)
                else:
                    pair[0][0] = a
                    for m in range(dim):
                        pair[0][1 + m] = out[1 + m, k] * per_length
                    sums = wall_lap, wall_lap_velocity, wall_div, wall_div_velocity, slip
                    add_wall_pair(neighbours, walls, i, k, stencil, pair, sums)
                    for c in range(dim):
                        for m in range(dim):
                            slope_velocity[i, c, m] += pair[1][c] * pair[0][1 + m]
    sums = wall_lap, wall_lap_velocity, wall_div, wall_div_velocity, slip
    return deficient, (column, row), (lap, grad, lap_p, grad_p, symmetric), near, (sums, slope_velocity)
