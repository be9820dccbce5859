"""A distance fitted to a field of the particles by least squares over the support, with slopes at walls.

    phi(x) ~ a + g . d + d . H d / 2 + C(d),    d = x - x_i,    weight W(d) of each neighbour and of the particle;

a wall point asks in the same sum for its slope along the normal p of the wall: support (p . (g + H d) - slope) with the
weight of a neighbour there. C are the terms of third and fourth order that a distance has (|grad phi| does not change
along grad phi) if the curvatures of its level stay as they are along it. They follow from g and H of a first fit and
are taken off in a second one: without that, fits to one side, beside walls, are of first order. The fit to a sphere is
exact to fourth order in the support; roughness shorter than the support is smoothed out.

Half way between two interfaces the distance has a kink. Neighbours whose gradient points another way know the distance
to another interface and are left out: the fit is that of a particle's own one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.row_threads import REDUCE, in_one_piece, over_rows
from ..operators.kernel import put_shapes, shape
from .least_squares import LANES, TOGETHER, factors, higher_powers, powers, put_moments, solve_factored, terms_of

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood

# Parts of the weight of a particle that are added to the moments, to those of second derivatives and to those of first
# ones: where too few neighbours are in sight to resolve a derivative it is zero, where they are its error is of this
# size. In 2D a drop that spreads to 30 degrees lost a splinter with 1e-8; in 3D a tenth changes nothing.
RIDGE = 1e-6
RIDGE_FIRST = 1e-9
MOST_BENT = 1.0  # times 1 / support: curvature up to which the terms of higher order are taken
# Power of (1 + cosine) / 2: it falls to a half at 50 degrees between two gradients. With 2 and 4 bubbles three spacings
# apart were drawn together or moved at Ca 1e-4, with 8 they rest (Ca 1e-5).
APART = 8
STEEP = 0.5  # |grad phi| below which phi has no direction: half way between two interfaces
FLATTEST = 0.25  # 1 + kappa d + K d^2 of a particle at distance d is above zero but at the centre of a drop


class SlopesAtWalls(NamedTuple):
    """Slopes that wall points ask for.

    start: (n + 1,) row pointers; offset: (n_pairs, dim) of the wall point from the particle, m; normal: (n_pairs, dim)
    of the wall, into the fluid; slope: (n_pairs,) along it; weight: (n_pairs,) of 0 to 1, over that of a neighbour.
    """

    start: np.ndarray
    offset: np.ndarray
    normal: np.ndarray
    slope: np.ndarray
    weight: np.ndarray


class Distance(NamedTuple):
    """What a fit is made of: phi (n,), m; known: (n,) bool; direction: (n, dim) along its gradient; spacing over the
    support."""

    phi: np.ndarray
    known: np.ndarray
    direction: np.ndarray
    spacing: float


class QuadraticFit(NamedTuple):
    """value: (n,) m; slope: (n, dim); curvature: (n,) 1/m, of the surface phi = 0 where it is nearest to the particle,
    positive where the sphere that touches it has phi > 0 inside; form: (n, dim dim) 1/m, row by row, second fundamental
    form of the level of phi at the particle, at most MOST_BENT over the support in size."""

    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray
    form: np.ndarray


def no_slopes(n: int, dim: int) -> SlopesAtWalls:
    """Of n particles that see no wall."""
    return SlopesAtWalls(np.zeros(n + 1, np.int64), np.zeros((0, dim)), np.zeros((0, dim)), np.zeros(0), np.zeros(0))


def quadratic_fit(neighbours: Neighbourhood, phi: np.ndarray, known: np.ndarray, wanted: np.ndarray,
                  gradient: np.ndarray, spacing: float, walls: SlopesAtWalls) -> QuadraticFit:
    """QuadraticFit of the particles `wanted` (n,), from those that are `known` (n,); elsewhere the value is phi (n,),
    m, and slope and curvature are zero. neighbours: of the fluid particles; gradient: (n, dim) of phi, roughly;
    spacing: m. phi, known and gradient are those of remote particles too."""
    fit, field = _none(phi, neighbours), Distance(phi, known, directions(gradient), spacing / neighbours.support)
    which = np.flatnonzero(wanted[: neighbours.n])
    over_rows(_fit, len(which), which, neighbours, field, walls, fit, work=lambda: _scratch(neighbours, True))
    return fit


def directions(gradient: np.ndarray) -> np.ndarray:
    """Unit vectors (n, dim) along gradients of phi (n, dim), shorter where these are below STEEP."""
    size = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
    return gradient / np.maximum(size, STEEP)[:, None]


def own_gradient(neighbours: Neighbourhood, phi: np.ndarray, known: np.ndarray, gradient: np.ndarray,
                 spacing: float) -> np.ndarray:
    """Gradient (n, dim) of phi (n,), m, over the neighbours whose distance is to the same interface, of the particles
    that are `known` (n,); gradient: over all of them. What is given is that of remote particles too."""
    fit, field = _none(phi, neighbours), Distance(phi, known, directions(gradient), spacing / neighbours.support)
    which, walls = np.flatnonzero(known[: neighbours.n]), no_slopes(neighbours.n, gradient.shape[1])
    over_rows(_fit, len(which), which, neighbours, field, walls, fit, work=lambda: _scratch(neighbours, False))
    return fit.slope


def _none(phi: np.ndarray, neighbours: Neighbourhood) -> QuadraticFit:
    n, dim = neighbours.n, neighbours.x.shape[1]
    return QuadraticFit(phi[:n].copy(), np.zeros((n, dim)), np.zeros(n), np.zeros((n, dim * dim)))


class Scratch(NamedTuple):
    """Of TOGETHER particles: matrices (size, size, TOGETHER) and right-hand sides (size, TOGETHER) of their systems,
    the second ones in `more`; the number of their neighbours, with those that fill up vectors; and of these, in rows
    so that what is done to all runs along the memory: ways (TOGETHER, 3, places) there, zero along z in 2D, weights and
    what phi rises by (TOGETHER, places). Of one: turned (3, places), which way phi rises there;
    product (places,) of the weights and what is
    fitted; sums (35,) of the powers of the ways; of a wall point the terms
    of the function and the way there; coefficients, and what a level of phi is like: its normal, its form, and vectors
    of the terms of higher order. Of the terms, see `terms_of`: place, pair, scale.
    """

    matrix: np.ndarray
    right: np.ndarray
    more: np.ndarray
    ways: np.ndarray
    weight: np.ndarray
    rise: np.ndarray
    turned: np.ndarray
    product: np.ndarray
    sums: np.ndarray
    basis: np.ndarray
    d: np.ndarray
    coefficients: np.ndarray
    unit: np.ndarray
    form: np.ndarray
    slopes: np.ndarray
    once: np.ndarray
    twice: np.ndarray
    seen: np.ndarray
    place: np.ndarray
    pair: np.ndarray
    scale: np.ndarray


def _scratch(neighbours: Neighbourhood, quadratic: bool) -> Scratch:
    """quadratic: of a quadratic function, else of a linear one without its constant."""
    dim, most = neighbours.x.shape[1], int(neighbours.longest) + LANES
    terms = terms_of(dim, (0, 1, 2) if quadratic else (1,))
    size = len(terms[0])
    arrays = in_one_piece((size, size, TOGETHER), (size, TOGETHER), (size, TOGETHER), (TOGETHER, 3, most),
                          (TOGETHER, most), (TOGETHER, most), (3, most), (most,), (35,), (size,), (dim,), (size,), (3,),
                          (3, 3), (dim,), (dim,), (dim,))
    work = Scratch(*[*arrays, np.zeros(TOGETHER, np.int64), *terms])
    for array in (work.matrix, work.right, work.more, work.unit, work.form):
        array[:] = 0.0  # of fewer particles than TOGETHER, and in 2D the third components
    return work


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(turns, work, which, neighbours, field, walls, fit):
    kind, support = neighbours.kind, neighbours.support
    wall_start, offset, normal, wall_slope, wall_weight = walls
    matrix, right, more, basis, d, c = work.matrix, work.right, work.more, work.basis, work.d, work.coefficients
    phi, (value, slope, curvature, form) = field.phi, fit
    dim, size, own = len(d), len(basis), shape(kind, 0.0)
    quadratic = size > dim  # else a linear function without its constant, of which the slope is asked
    for first in range(turns[0], turns[1], TOGETHER):
        lanes = min(TOGETHER, turns[1] - first)
        for m in range(lanes):
            i = which[first + m]
            _gather(i, m, neighbours, field, work)
            if quadratic:
                powers(work, m, work.weight[m])
                higher_powers(work, m)
                put_moments(work, m)
                _put_rises(work, m)
                matrix[0, 0, m] += own
            else:
                _linear_equations(work, m)
            for p in range(wall_start[i], wall_start[i + 1]):
                if not wall_weight[p] > 0.0:
                    continue
                w = wall_weight[p] * _weight(d, offset, p, support, kind)
                _slopes(basis, d, normal[p])
                for a in range(size):
                    for b in range(a + 1):
                        matrix[a, b, m] += w * basis[a] * basis[b]
                    right[a, m] += w * basis[a] * support * wall_slope[p]
            for a in range(1 if quadratic else 0, size):
                matrix[a, a, m] += own * (RIDGE if a > dim else RIDGE_FIRST)
        factors(matrix)
        solve_factored(matrix, right)
        if not quadratic:
            for m in range(lanes):
                for k in range(dim):
                    slope[which[first + m], k] = right[k, m] / support
            continue
        for m in range(lanes):
            i = which[first + m]
            for a in range(size):
                c[a] = right[a, m]
            # what a quadratic function cannot have of a distance follows from it, and is taken off in a second fit
            steepness = _levels(c, work.unit, work.form, work.once)
            _beyond_neighbours(work, m, steepness)
            for p in range(wall_start[i], wall_start[i + 1]):
                if not wall_weight[p] > 0.0:
                    continue
                w = wall_weight[p] * _weight(d, offset, p, support, kind)
                _slopes(basis, d, normal[p])
                _slopes_beyond(d, work.unit, work.form, (work.slopes, work.once, work.twice))
                along = 0.0
                for k in range(dim):
                    along += work.slopes[k] * normal[p, k]
                for a in range(size):
                    more[a, m] -= w * steepness * along * basis[a]
        solve_factored(matrix, more)
        for m in range(lanes):
            i = which[first + m]
            for a in range(size):
                c[a] = right[a, m] + more[a, m]
            value[i] = phi[i] + c[0]
            for k in range(dim):
                slope[i, k] = c[1 + k] / support
            curvature[i] = _curvature(c, dim, support, value[i])
            _levels(c, work.unit, work.form, work.once)
            for a in range(dim):
                for b in range(dim):
                    form[i, a * dim + b] = work.form[a, b] / support


@njit(cache=True, error_model="numpy", forceinline=True)
def _gather(i, m, neighbours, field, work):
    """The ways to the known neighbours of particle i, in units of the support, their weights and what phi rises by, and
    the number of these, filled up to whole vectors, are written to place m.

    A weight is that of the distance times a number of 0 to 1, whether the distances of the two particles are to the
    same interface, by the angle between them and by phi where they would meet: a kink nearer to the interface than a
    spacing belongs to it."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    phi, known, direction = field.phi, field.known, field.direction
    d0, d1, d2, weight, rise = work.ways[m, 0], work.ways[m, 1], work.ways[m, 2], work.weight[m], work.rise[m]
    m0, m1, m2 = work.turned[0], work.turned[1], work.turned[2]
    over, deep, last = 1.0 / neighbours.support, 1.0 if len(work.d) == 3 else 0.0, len(work.d) - 1
    x0, x1, x2, own, count = x[i, 0], x[i, 1], x[i, last], phi[i], np.uint64(0)
    # two loops, a table each: 150 in place of 240 ns a particle with 71 neighbours
    for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
        j = np.uint32(row[p])
        d0[count], d1[count], d2[count] = (x[j, 0] - x0) * over, (x[j, 1] - x1) * over, deep * (x[j, last] - x2) * over
        count += np.uint64(known[np.uint32(column[p])])  # the next one takes the place of one that is not known
    count = np.uint64(0)
    for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
        j = np.uint32(column[p])
        m0[count], m1[count], m2[count] = direction[j, 0], direction[j, 1], deep * direction[j, last]
        rise[count] = phi[j] - own
        count += np.uint64(known[j])
    padded = (count + np.uint64(LANES - 1)) // np.uint64(LANES) * np.uint64(LANES)
    for k in range(count, padded):
        d0[k], d1[k], d2[k] = 1.0, 0.0, 0.0  # at the edge of the support: no weight
        m0[k], m1[k], m2[k], rise[k] = 0.0, 0.0, 0.0, 0.0
    put_shapes(neighbours.kind, work.ways[m], padded, weight)
    n0, n1, n2, near = direction[i, 0], direction[i, 1], deep * direction[i, last], 1.0 / field.spacing
    for k in range(padded):
        meet = (0.5 * rise[k] + own) * over
        meet += 0.25 * ((n0 - m0[k]) * d0[k] + (n1 - m1[k]) * d1[k] + (n2 - m2[k]) * d2[k])
        apart = min((meet * near) ** 2, 1.0)
        weight[k] *= 1.0 - apart * (1.0 - (0.5 * (1.0 + n0 * m0[k] + n1 * m1[k] + n2 * m2[k])) ** APART)
    work.seen[m] = padded


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _put_rises(work, m):
    """Right-hand side of what phi rises by at the neighbours of place m."""
    for k in range(work.seen[m]):
        work.product[k] = work.weight[m, k] * work.rise[m, k]
    powers(work, m, work.product)
    for a in range(len(work.scale)):
        work.right[a, m] = work.scale[a] * work.sums[work.place[a]]


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _linear_equations(work, m):
    """Matrix, its lower half, and right-hand side of a linear function through the particle of place m."""
    x, y, z, w, rise, sums = work.ways[m, 0], work.ways[m, 1], work.ways[m, 2], work.weight[m], work.rise[m], work.sums
    sx, sy, sz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(work.seen[m]):
        a, b, c = w[k] * x[k], w[k] * y[k], w[k] * z[k]
        sx += a * rise[k]
        sy += b * rise[k]
        sz += c * rise[k]
        xx += a * x[k]
        xy += a * y[k]
        xz += a * z[k]
        yy += b * y[k]
        yz += b * z[k]
        zz += c * z[k]
    sums[1], sums[2], sums[3] = sx, sy, sz
    sums[4], sums[5], sums[6], sums[7], sums[8], sums[9] = xx, xy, xz, yy, yz, zz
    put_moments(work, m)
    for a in range(len(work.place)):
        work.right[a, m] = sums[work.place[a]]


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _beyond_neighbours(work, m, steepness):
    """The right-hand side of the second fit: terms of third and fourth order of a distance at the ways d of the
    neighbours, with n the normal (unit) and h the form of its level, unchanged along it:

    -(n . d) d . h h d / 2 + (n . d)^2 d . h h h d / 2 - (d . h d)(d . h h d) / 8."""
    x, y, z, w, product, n, h = (work.ways[m, 0], work.ways[m, 1], work.ways[m, 2], work.weight[m], work.product,
                                 work.unit, work.form)
    n0, n1, n2 = n[0], n[1], n[2]
    xx, xy, xz, yy, yz, zz = h[0, 0], h[0, 1], h[0, 2], h[1, 1], h[1, 2], h[2, 2]
    for k in range(work.seen[m]):
        s = xx * x[k] + xy * y[k] + xz * z[k]  # h d
        t = xy * x[k] + yy * y[k] + yz * z[k]
        u = xz * x[k] + yz * y[k] + zz * z[k]
        along = n0 * x[k] + n1 * y[k] + n2 * z[k]
        q2, q3 = x[k] * s + y[k] * t + z[k] * u, s * s + t * t + u * u
        q4 = xx * s * s + yy * t * t + zz * u * u + 2.0 * (xy * s * t + xz * s * u + yz * t * u)
        beyond = 0.5 * along * (along * q4 - q3) - 0.125 * q2 * q3
        product[k] = -w[k] * steepness * beyond
    powers(work, m, product)
    for a in range(len(work.scale)):
        work.more[a, m] = work.scale[a] * work.sums[work.place[a]]


@njit(cache=True, inline="always")
def _weight(d, offset, p, support, kind):
    """Kernel at d (dim,) = offset of p over the support, which is written."""
    r2, over = 0.0, 1.0 / support
    for k in range(len(d)):
        d[k] = offset[p, k] * over
        r2 += d[k] ** 2
    return shape(kind, math.sqrt(r2))


@njit(cache=True, inline="always")
def _slopes(basis, d, normal):
    """Slopes along a normal (dim,) of the terms of the quadratic function at d, times the support: 1, d_a, and
    d_a d_a / 2 and d_a d_b, the upper half row by row."""
    dim = len(d)
    basis[0] = 0.0
    v = 1 + dim
    for a in range(dim):
        basis[1 + a] = normal[a]
        for b in range(a, dim):
            basis[v] = normal[a] * d[a] if a == b else normal[a] * d[b] + normal[b] * d[a]
            v += 1


@njit(cache=True, inline="always")
def _product(h, v, out):
    """out (dim,) = h v."""
    for a in range(len(out)):
        out[a] = 0.0
        for b in range(len(out)):
            out[a] += h[a, b] * v[b]


@njit(cache=True, error_model="numpy")
def _levels(c, unit, form, across):
    """|g| of coefficients c. Written: unit = g / |g| and form, the second derivatives over |g| along the levels of phi:
    the second fundamental form of the level, at most MOST_BENT in size."""
    dim = len(across)
    steepness = 0.0
    for a in range(dim):
        steepness += c[1 + a] ** 2
    steepness = math.sqrt(steepness)
    over = 1.0 / steepness if steepness > 0.0 else 0.0
    v = 1 + dim
    for a in range(dim):
        unit[a] = c[1 + a] * over
        for b in range(a, dim):
            form[a, b] = c[v] * over
            form[b, a] = form[a, b]
            v += 1
    both, square = 0.0, 0.0
    _product(form, unit, across)
    for a in range(dim):
        both += unit[a] * across[a]
    for a in range(dim):
        for b in range(dim):
            form[a, b] += both * unit[a] * unit[b] - across[a] * unit[b] - unit[a] * across[b]
            square += form[a, b] ** 2
    if square > MOST_BENT**2:
        for a in range(dim):
            for b in range(dim):
                form[a, b] *= MOST_BENT / math.sqrt(square)
    return steepness


@njit(cache=True, error_model="numpy")
def _slopes_beyond(d, n, h, vectors):
    """Slopes of the terms of higher order of a distance (see `_beyond_neighbours`) at d are written to the first of
    three vectors (dim,)."""
    (slopes, once, twice), dim = vectors, len(d)
    _product(h, d, once)
    _product(h, once, twice)
    _product(h, twice, slopes)
    along, q2, q3, q4 = 0.0, 0.0, 0.0, 0.0
    for a in range(dim):
        along += n[a] * d[a]
        q2 += d[a] * once[a]
        q3 += once[a] * once[a]
        q4 += once[a] * twice[a]
    for a in range(dim):
        slopes[a] = along * along * slopes[a] - along * twice[a] - 0.25 * (q3 * once[a] + q2 * twice[a])
        slopes[a] += n[a] * (along * q4 - 0.5 * q3)


@njit(cache=True, error_model="numpy")
def _curvature(c, dim, support, value):
    """kappa = -(tr H - n . H n) / |g| of coefficients c in units of the support, brought from the particle to phi = 0,
    value / |g| away: each of the two curvatures k of a parallel surface is k / (1 + k d)."""
    gauss, scale = 0.0, 1.0 / support
    if dim == 2:
        gx, gy, xx, xy, yy = c[1], c[2], c[3], c[4], c[5]
        square = gx * gx + gy * gy
        if square == 0.0:
            return 0.0
        size = math.sqrt(square)
        kappa = -(xx * gy * gy - 2.0 * xy * gx * gy + yy * gx * gx) / (size * square) * scale
    else:
        gx, gy, gz, xx, xy, xz, yy, yz, zz = c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9]
        square = gx * gx + gy * gy + gz * gz
        if square == 0.0:
            return 0.0
        size = math.sqrt(square)
        along = gx * gx * xx + gy * gy * yy + gz * gz * zz + 2.0 * (gx * gy * xy + gx * gz * xz + gy * gz * yz)
        kappa = -((xx + yy + zz) - along / square) / size * scale
        gauss = (gx * gx * (yy * zz - yz * yz) + gy * gy * (xx * zz - xz * xz) + gz * gz * (xx * yy - xy * xy)
                 + 2.0 * (gx * gy * (xz * yz - xy * zz) + gx * gz * (xy * yz - xz * yy)
                          + gy * gz * (xy * xz - yz * xx))) / (square * square) * scale * scale
    # in place of eq. 23: at the interface, not at the particle
    distance = value / (size * scale)
    return (kappa + 2.0 * distance * gauss) / max(1.0 + distance * (kappa + distance * gauss), FLATTEST)
