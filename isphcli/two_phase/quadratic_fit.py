"""A distance fitted to a field of the particles by least squares over the support, with slopes at walls.

    phi(x) ~ a + g . d + d . H d / 2 + C(d),    d = x - x_i,    weight W(d) of each neighbour and of the particle;

a wall point asks in the same sum for its slope along the normal p of the wall: support (p . (g + H d) - slope) with the
weight of a neighbour there. C are the terms of third and fourth order that a distance has (|grad phi| does not change
along grad phi) if the curvatures of its level stay as they are along it. They follow from g and H of a first fit and
are taken off in a second one: without that, fits to one side, beside walls, are of first order. A sphere is its own fit
to fourth order in the support, and roughness shorter than the support is not.

Half way between two interfaces the distance has an edge. Neighbours whose gradient points another way know the distance
to another interface and are left out: the fit is that of a particle's own one.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.row_threads import REDUCE, in_one_piece, over_rows
from ..operators.kernel import shape

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
    n, dim = neighbours.n, neighbours.x.shape[1]
    fit = QuadraticFit(phi[:n].copy(), np.zeros((n, dim)), np.zeros(n), np.zeros((n, dim * dim)))
    field = Distance(phi, known, directions(gradient), spacing / neighbours.support)
    over_rows(_fit, n, neighbours, field, wanted, walls, fit, work=partial(_scratch, dim, neighbours.longest))
    return fit


def directions(gradient: np.ndarray) -> np.ndarray:
    """Unit vectors (n, dim) along gradients of phi (n, dim), shorter where these are below STEEP."""
    size = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
    return gradient / np.maximum(size, STEEP)[:, None]


def own_gradient(neighbours: Neighbourhood, phi: np.ndarray, known: np.ndarray, gradient: np.ndarray,
                 spacing: float) -> np.ndarray:
    """Gradient (n, dim) of phi (n,), m, over the neighbours whose distance is to the same interface, of the particles
    that are `known` (n,); gradient: over all of them. What is given is that of remote particles too."""
    n, dim = neighbours.n, gradient.shape[1]
    out = np.zeros((n, dim))
    field = Distance(phi, known, directions(gradient), spacing / neighbours.support)
    over_rows(_linear, n, neighbours, field, out, work=lambda: tuple(in_one_piece((dim, dim), (dim,), (dim,))))
    return out


class Scratch(NamedTuple):
    """Of one particle: the system of the quadratic function and its second right-hand side; of one wall point the terms
    of the function and the way there; what a level of phi is like: its normal, its form, and vectors of the terms of
    higher order. Of its neighbours, in rows so that what is done to all of them runs along the memory: the ways there,
    what h makes of these, the terms, their weights, what phi rises by, and products."""

    moments: np.ndarray
    right: np.ndarray
    more: np.ndarray
    basis: np.ndarray
    d: np.ndarray
    unit: np.ndarray
    form: np.ndarray
    slopes: np.ndarray
    once: np.ndarray
    twice: np.ndarray
    ways: np.ndarray
    turned: np.ndarray
    terms: np.ndarray
    weight: np.ndarray
    rise: np.ndarray
    product: np.ndarray


def _scratch(dim: int, neighbours: int) -> Scratch:
    size, most = 1 + dim + dim * (dim + 1) // 2, max(neighbours, 1)
    return Scratch(*in_one_piece((size, size), (size,), (size,), (size,), (dim,), (dim,), (dim, dim), (dim,), (dim,),
                                 (dim,), (dim, most), (dim, most), (size, most), (most,), (most,), (most,)))


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(rows, work, neighbours, field, wanted, walls, fit):
    kind, support = neighbours.kind, neighbours.support
    wall_start, offset, normal, wall_slope, wall_weight = walls
    moments, right, more, basis, d = work.moments, work.right, work.more, work.basis, work.d
    phi, (value, slope, curvature, form) = field.phi, fit
    dim, size, own = len(d), len(right), shape(kind, 0.0)
    for i in range(rows[0], rows[1]):
        if not wanted[i]:
            continue
        count = _gather(i, neighbours, field, work)
        _normal_equations(work, count)
        moments[0, 0] += own
        for p in range(wall_start[i], wall_start[i + 1]):
            w = wall_weight[p] * _weight(d, offset, p, -1, support, kind)
            _slopes(basis, d, normal[p])
            _add(moments, right, basis, w, support * wall_slope[p])
        for a in range(1, size):
            moments[a, a] += own * (RIDGE if a > dim else RIDGE_FIRST)
        _factors(moments)
        _solve(moments, right)
        # what a quadratic function cannot have of a distance follows from it, and is taken off in a second fit
        steepness = _levels(right, work)
        _beyond_neighbours(work, count, steepness)
        for p in range(wall_start[i], wall_start[i + 1]):
            w = wall_weight[p] * _weight(d, offset, p, -1, support, kind)
            _slopes(basis, d, normal[p])
            _slopes_beyond(work)
            along = 0.0
            for k in range(dim):
                along += work.slopes[k] * normal[p, k]
            _add_right(more, basis, -w * steepness * along)
        _solve(moments, more)
        for a in range(size):
            right[a] += more[a]
        value[i] = phi[i] + right[0]
        for k in range(dim):
            slope[i, k] = right[1 + k] / support
        curvature[i] = _curvature(right, dim, support, value[i])
        _levels(right, work)
        for a in range(dim):
            for b in range(dim):
                form[i, a * dim + b] = work.form[a, b] / support


@njit(cache=True, error_model="numpy")
def _gather(i, neighbours, field, work):
    """The ways to the known neighbours of particle i, in units of the support, their terms and weights and what phi
    rises by are written; their number is returned."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, support, d, dim = neighbours.kind, neighbours.support, work.d, len(work.d)
    ways, terms, count = work.ways, work.terms, 0
    for p in range(start[i], start[i + 1]):
        j = column[p]
        if field.known[j]:
            work.weight[count] = _weight(d, x, row[p], i, support, kind) * _alike(field, i, j, d, support)
            work.rise[count] = field.phi[j] - field.phi[i]
            for k in range(dim):
                ways[k, count] = d[k]
            count += 1
    v = 1 + dim
    for k in range(count):
        terms[0, k] = 1.0
    for a in range(dim):
        for k in range(count):
            terms[1 + a, k] = ways[a, k]
        for b in range(a, dim):
            factor = 0.5 if a == b else 1.0
            for k in range(count):
                terms[v, k] = factor * ways[a, k] * ways[b, k]
            v += 1
    return count


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _normal_equations(work, count):
    """Moments, their lower half, and the right-hand side of the neighbours; sums in any order, so that they are
    vectors."""
    terms, product = work.terms, work.product
    for a in range(len(work.right)):
        total = 0.0
        for k in range(count):
            product[k] = work.weight[k] * terms[a, k]
            total += product[k] * work.rise[k]
        work.right[a] = total
        for b in range(a + 1):
            total = 0.0
            for k in range(count):
                total += product[k] * terms[b, k]
            work.moments[a, b] = total


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _beyond_neighbours(work, count, steepness):
    """The right-hand side of the second fit: terms of third and fourth order of a distance at the ways d of the
    neighbours, with n the normal (unit) and h the form of its level, unchanged along it:

    -(n . d) d . h h d / 2 + (n . d)^2 d . h h h d / 2 - (d . h d)(d . h h d) / 8."""
    ways, turned, n, h, dim = work.ways, work.turned, work.unit, work.form, len(work.d)
    for a in range(dim):
        for k in range(count):
            turned[a, k] = h[a, 0] * ways[0, k] + h[a, 1] * ways[1, k]
        if dim == 3:
            for k in range(count):
                turned[a, k] += h[a, 2] * ways[2, k]
    for k in range(count):
        if dim == 2:
            p, q, r, s, t, u = ways[0, k], ways[1, k], 0.0, turned[0, k], turned[1, k], 0.0
            q4 = h[0, 0] * s * s + 2.0 * h[0, 1] * s * t + h[1, 1] * t * t
            along = n[0] * p + n[1] * q
        else:
            p, q, r, s, t, u = ways[0, k], ways[1, k], ways[2, k], turned[0, k], turned[1, k], turned[2, k]
            q4 = h[0, 0] * s * s + h[1, 1] * t * t + h[2, 2] * u * u
            q4 += 2.0 * (h[0, 1] * s * t + h[0, 2] * s * u + h[1, 2] * t * u)
            along = n[0] * p + n[1] * q + n[2] * r
        q2, q3 = p * s + q * t + r * u, s * s + t * t + u * u
        beyond = 0.5 * along * (along * q4 - q3) - 0.125 * q2 * q3
        work.product[k] = -work.weight[k] * steepness * beyond
    for a in range(len(work.more)):
        total = 0.0
        for k in range(count):
            total += work.product[k] * work.terms[a, k]
        work.more[a] = total


@njit(cache=True, inline="always")
def _offset(d, x, j, i, support):
    """d (dim,) = (x_j - x_i) / support is written, and its square returned; x_i is zero for i = -1."""
    r2, over = 0.0, 1.0 / support
    for k in range(len(d)):
        d[k] = (x[j, k] - (x[i, k] if i >= 0 else 0.0)) * over
        r2 += d[k] ** 2
    return r2


@njit(cache=True, inline="always")
def _weight(d, x, j, i, support, kind):
    """Kernel at `_offset`."""
    return shape(kind, math.sqrt(_offset(d, x, j, i, support)))


@njit(cache=True, nogil=True, error_model="numpy")
def _linear(rows, work, neighbours, field, out):
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, support = neighbours.kind, neighbours.support
    moments, right, d = work
    phi, known, dim = field.phi, field.known, len(d)
    for i in range(rows[0], rows[1]):
        if known[i]:
            for a in range(dim):
                right[a] = 0.0
                for b in range(dim):
                    moments[a, b] = RIDGE_FIRST if a == b else 0.0
            for p in range(start[i], start[i + 1]):
                if known[column[p]]:
                    w = _weight(d, x, row[p], i, support, kind)
                    w *= _alike(field, i, column[p], d, support)
                    _add(moments, right, d, w, phi[column[p]] - phi[i])
            _factors(moments)
            _solve(moments, right)
            for a in range(dim):
                out[i, a] = right[a] / support


@njit(cache=True, inline="always")
def _alike(field, i, j, d, support):
    """Of 0 to 1: whether the distances of two particles are to the same interface, by the angle between them and by phi
    where they would meet: an edge nearer to the interface than a spacing is its own. d: (dim,) in units of the
    support."""
    direction, cosine, edge = field.direction, 0.0, 0.5 * (field.phi[i] + field.phi[j]) * (1.0 / support)
    for k in range(len(d)):
        cosine += direction[i, k] * direction[j, k]
        edge += 0.25 * (direction[i, k] - direction[j, k]) * d[k]
    apart = min((edge * (1.0 / field.spacing)) ** 2, 1.0)
    return 1.0 - apart * (1.0 - (0.5 * (1.0 + cosine)) ** APART)


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
def _add(moments, right, basis, w, f):
    for a in range(len(right)):
        wa = w * basis[a]
        right[a] += wa * f
        for b in range(a + 1):
            moments[a, b] += wa * basis[b]


@njit(cache=True, inline="always")
def _add_right(right, basis, f):
    for a in range(len(right)):
        right[a] += f * basis[a]


@njit(cache=True, error_model="numpy")
def _factors(lower):
    """A symmetric positive matrix (m, m), whose lower half is given, becomes its Cholesky factor, with one over what is
    on the diagonal."""
    for k in range(len(lower)):
        for c in range(k + 1):
            rest = lower[k, c]
            for e in range(c):
                rest -= lower[k, e] * lower[c, e]
            lower[k, c] = rest * lower[c, c] if c < k else 1.0 / math.sqrt(rest)


@njit(cache=True, error_model="numpy")
def _solve(lower, right):
    """right (m,) becomes the solution of the system whose `_factors` are given."""
    m = len(right)
    for k in range(m):
        rest = right[k]
        for e in range(k):
            rest -= lower[k, e] * right[e]
        right[k] = rest * lower[k, k]
    for k in range(m - 1, -1, -1):
        right[k] *= lower[k, k]
        for e in range(k):
            right[e] -= lower[k, e] * right[k]


@njit(cache=True, inline="always")
def _product(h, v, out):
    """out (dim,) = h v."""
    for a in range(len(v)):
        out[a] = 0.0
        for b in range(len(v)):
            out[a] += h[a, b] * v[b]


@njit(cache=True, error_model="numpy")
def _levels(c, work):
    """|g| of coefficients c. Written: unit = g / |g| and form, the second derivatives over |g| along the levels of phi:
    the second fundamental form of the level, at most MOST_BENT in size."""
    unit, form, across = work.unit, work.form, work.once
    dim = len(unit)
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
def _slopes_beyond(work):
    """Slopes of the terms of higher order of a distance (see `_beyond_neighbours`) at d are written."""
    d, n, h, slopes, once, twice = work.d, work.unit, work.form, work.slopes, work.once, work.twice
    dim = len(d)
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
