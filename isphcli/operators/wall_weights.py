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

from functools import partial

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..domain.row_threads import over_rows
from .crossings import MEETS_WALL, SHARES_PRESSURE, WallStencils, in_sight
from .moments import correction, gather_stencil, invert_gradient, new_workspace, stencil_moments, stencil_weights
from .pair_weights import Operators, WallRows


def build_wall_operators(stencil: WallStencils, order: int = 1, classes: np.ndarray | None = None,
                         exchange: Exchange = NO_EXCHANGE) -> Operators:
    """Operators of a scene with walls.

    order: of the velocity gradient, 1 (eq. 5) or 2; classes: (n,) of `narrow_pores.classify_neighbourhoods`, or None
    where none are asked for: then none is narrow; exchange: of the remote particles.
    """
    everyone, walls = stencil.neighbours, stencil.walls
    n = everyone.n
    start = np.zeros(n + 1, dtype=np.int64)
    np.cumsum(in_sight(everyone.start, stencil.links.link), out=start[1:])
    pairs, dim = int(start[n]), everyone.x.shape[1]
    column, row = np.empty(pairs, np.int32), np.empty(pairs, np.int32)
    lap, symmetric = np.empty(pairs), np.empty(pairs)
    grad, grad_p = np.empty((pairs, dim)), np.empty((pairs, dim))
    near_wall, slope_velocity = np.zeros(n, np.bool_), np.zeros((n, dim, dim))
    sums = new_boundary_sums(n, dim, walls.slip_length)
    out = start, column, row, lap, grad, grad_p, symmetric
    deficient = over_rows(_wall_rows, n, (everyone, stencil.links, stencil.volume, walls), order, out, near_wall,
                          (sums, slope_velocity), work=partial(new_workspace, everyone))
    wall_sums = boundary_sums(sums)
    classes = near_wall.astype(np.int8) if classes is None else classes
    found = WallRows(*wall_sums, symmetric, near_wall, classes, slope_velocity if wall_sums[-1] is None else None,
                     walls.distance[: n + exchange.remote])
    seen = everyone._replace(start=start, column=column, row=row)
    return Operators(seen, lap, grad, lap, grad_p, stencil.volume[: n + exchange.remote],
                     int(reduce.total(np.array(deficient))), found, exchange)


def wall_gradient(walls: WallRows, u: np.ndarray, which: np.ndarray) -> np.ndarray:
    """What walls that do not slip add to the gradient of u (n, dim) at some particles, which (n,) bool:
    (m, dim, dim)."""
    assert walls.slope_velocity is not None
    return walls.slope_velocity[which] - u[which][:, :, None] * walls.div[which][:, None, :]


@njit(cache=True)
def meet_walls(stencil, t, first, link):
    """Moves the far ends of the pairs of a stencil to where they meet a wall (eq. 11). t, first, link: see `Links`.

    Returns the sum of w s over the stencil with the dummies at their own places, and whether it meets a wall or has a
    neighbour that it shares no pressure with.
    """
    s, w = stencil[3], stencil[4]
    whole, near_wall = 0.0, False
    for k in range(len(link)):
        whole += w[k] * s[k]
    for k in range(len(link)):
        near_wall |= link[k] != SHARES_PRESSURE
        if link[k] == MEETS_WALL:
            s[k] *= t[first]  # eq. 11: the slope to the wall, at the distance of the wall
            first += 1
    return whole, near_wall


@njit(cache=True)
def second_moments(stencil, link, moments):
    """moments[0:6] of `stencil_moments` over the neighbours that share the pressure. link: (count,), see `Links`."""
    ex, ey, ez, s, w = stencil
    for v in range(6):
        moments[v] = 0.0
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


def new_boundary_sums(n: int, dim: int, slip_length: np.ndarray) -> tuple[np.ndarray, ...]:
    """Arrays of WallSums of n particles, still zero; slip: (0, dim, dim) where no wall slips."""
    slips = n if np.any(slip_length > 0.0) else 0
    return np.zeros(n), np.zeros((n, dim)), np.zeros((n, dim)), np.zeros(n), np.zeros((slips, dim, dim))


@njit(cache=True)
def add_walls(scene, i, link, stencil, weights, scratch, boundary):
    """Adds the neighbours of particle i that are met at a wall to the sums of the walls: eq. 11. Called once for a row,
    since to hand over so many arrays takes longer than a pair.

    scene: neighbours and WallTable; link: (count,), see `Links`; weights: (4, count) or more, of the Laplacian and of
    the gradient, 1/m2 and 1/m; scratch: velocity of the wall (dim,), slip tensor and `along` (dim, dim); boundary:
    arrays of WallSums, and slope_velocity (n, dim, dim) of WallRows or none. With Navier slip, u at the wall is
    u_W + B (u_i - u_W), B = length / (length + d) times the projection on the wall.

    Returns whether a wall slips. Then `along` is what the divergence makes of a velocity that changes along the wall:
    where pair k meets it, s away from the foot of the particle, what slides has the velocity of the particle, which is
    taken here, and beyond it  s . grad u:  sum_k g_k . B (s_k . grad u). With that slope by the fluid neighbours alone
    (the weights of the pressure gradient) the divergence of a linear velocity that does not cross the wall is exact.
    Without it flow along a wall leaked through it.
    """
    (neighbours, walls), (wall_u, slide, along) = scene, scratch
    (lap, lap_velocity, div, div_velocity, slip), slope_velocity = boundary
    x, normal, begin, slides = neighbours.x, walls.normal, neighbours.start[i], False
    dim = x.shape[1]
    for k in range(len(link)):
        if link[k] != MEETS_WALL:
            continue
        j, a = neighbours.row[begin + k], weights[0, k]
        met = walls.wall[j]
        # eq. 11: a neighbour at the crossing point that has the velocity of the wall
        lap[i] += a
        for m in range(dim):
            u, g = walls.velocity[met, m], weights[1 + m, k]
            if len(walls.spin) > 0:
                for q in range(dim):
                    u += walls.spin[met, m, q] * (x[i, q] + stencil[q][k] * stencil[3][k] * neighbours.support)
            wall_u[m] = u
            lap_velocity[i, m] += a * u
            div[i, m] += g
            div_velocity[i] += g * u
        if len(slope_velocity) > 0:
            for c in range(dim):
                for m in range(dim):
                    slope_velocity[i, c, m] += wall_u[c] * weights[1 + m, k]
        length = walls.slip_length[met]
        if not length > 0.0:
            continue
        factor, off = length / (length + max(walls.distance[i], 0.0)), 0.0
        for q in range(dim):
            off += normal[j, q] * stencil[q][k]
            for m in range(dim):
                slide[q, m] = factor * ((1.0 if q == m else 0.0) - normal[j, q] * normal[j, m])
                if not slides:
                    along[q, m] = 0.0
        slides = True
        for m in range(dim):
            s = stencil[3][k] * neighbours.support * (stencil[m][k] - off * normal[j, m])
            for q in range(dim):
                slip[i, q, m] += a * slide[q, m]
                lap_velocity[i, q] -= a * slide[q, m] * wall_u[m]
                div[i, m] -= weights[1 + q, k] * slide[q, m]
                div_velocity[i] -= weights[1 + q, k] * slide[q, m] * wall_u[m]
                for c in range(dim):
                    along[c, m] += weights[1 + q, k] * slide[q, c] * s
    return slides


@njit(cache=True, nogil=True)
def _wall_rows(rows, work, given, order, out, near_wall, boundary):
    """Weights of the pairs in sight of rows, near_wall (n,), arrays of WallSums and slope_velocity; returns how many
    rows are deficient."""
    neighbours, links, volume, walls = given
    start, per_length, t, link = neighbours.start, 1.0 / neighbours.support, links.t, links.link
    owner, first = neighbours.owner, links.first
    seen_start, column, row, lap, grad, grad_p, symmetric = out
    ex, ey, ez, s, w = work.stencil
    dim, moments, weights, g_p, along = grad.shape[1], work.moments, work.weights, work.g_p, work.wall[2]
    per_area, deficient = per_length * per_length, 0
    for i in range(rows[0], rows[1]):
        begin, count = start[i], start[i + 1] - start[i]
        padded = gather_stencil(neighbours, i, volume, work.stencil)
        whole, near_wall[i] = meet_walls(work.stencil, t, first[i], link[begin : begin + count])
        stencil_moments(work.stencil, padded, moments)
        deficient += correction(moments, dim, order, work.tensors)
        stencil_weights(work.stencil, padded, work.tensors, order, weights)
        at = np.uint64(seen_start[i])
        if not near_wall[i]:  # every neighbour is in sight and shares the pressure
            for k in range(count):
                p = at + np.uint64(k)
                row[p] = neighbours.row[begin + k]
                column[p] = owner[row[p]]
                lap[p] = weights[0, k] * per_area
                symmetric[p] = 2.0 * dim * per_area * w[k] / (whole * s[k]) if w[k] > 0.0 else 0.0
                grad[p, 0] = grad_p[p, 0] = weights[1, k] * per_length
                grad[p, 1] = grad_p[p, 1] = weights[2, k] * per_length
                if dim == 3:
                    grad[p, 2] = grad_p[p, 2] = weights[3, k] * per_length
            continue
        second_moments(work.stencil, link[begin : begin + count], moments)
        invert_gradient(moments, dim, g_p)
        for k in range(count):
            weights[0, k] *= per_area
            for m in range(dim):
                weights[1 + m, k] *= per_length
        slides = add_walls((neighbours, walls), i, link[begin : begin + count], work.stencil, weights, work.wall,
                           boundary)
        for k in range(count):
            if link[begin + k] != MEETS_WALL:
                row[at] = neighbours.row[begin + k]
                column[at] = owner[row[at]]
                lap[at] = weights[0, k]
                shared = link[begin + k] == SHARES_PRESSURE
                # eq. 3 beside walls: no flux through them, so that only fluid neighbours count
                symmetric[at] = 2.0 * dim * per_area * w[k] / (whole * s[k]) if w[k] > 0.0 and shared else 0.0
                for m in range(dim):
                    grad[at, m] = weights[1 + m, k]
                    b = g_p[m, 0] * ex[k] + g_p[m, 1] * ey[k] + g_p[m, 2] * ez[k]
                    grad_p[at, m] = b * w[k] * per_length if shared else 0.0
                at += np.uint64(1)
        if slides:
            for q in range(seen_start[i], seen_start[i + 1]):
                for m in range(dim):
                    for c in range(dim):
                        grad[q, m] += along[m, c] * grad_p[q, c]
    return deficient
