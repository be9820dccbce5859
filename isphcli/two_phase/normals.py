"""Where two fluids meet: the smoothed colour, the normals, and where a pair of unlike particles crosses the interface.

The colour of a particle is one in the first fluid and zero in the second (eq. 15 for all particles alike). Its kernel
average, taken once (AVERAGES), varies smoothly over a band of some spacings; normals come from the corrected gradient
of that, in place of eqs 16-17. Measured on a disk of radius 10 dx of disordered particles: mean curvature -0.1 % with
two averages, -0.9 % with one, -3 % with none, and half of the scatter; docs/design_notes.md says why it is one.

A pair of unlike particles is parted at the fraction t of the way from the one to the other. In a layered fluid at rest
or in shear, pairs weighted with  1 / (t rho_i + (1 - t) rho_j)  and  1 / (t / mu_i + (1 - t) / mu_j)  give a pressure
and a stress that are exact to round-off, whatever the ratio: that is the form which eqs 2 and 3 need at a jump.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit, prange

from ..operators.kernel import shape, slope
from ..operators.moments import invert_gradient

if TYPE_CHECKING:
    from ..operators.pair_weights import Operators

AVERAGES = 1  # kernel averages of the colour
FAINT = 0.02  # |grad C| dx below which a particle is not of the band
# Unlike particles closer than this, in mean distances V^(1/dim), have the interface half-way between them. On a lattice
# these are the pairs of adjacent layers only.
ADJACENT = 1.25
NEAREST = 0.1  # smallest fraction t
FLAT = 0.5  # a plane is fitted to the crossings if its thinnest direction is thinner than this part of the next one


@dataclass(frozen=True)
class Band:
    """The interface of one configuration.

    colour: (n,) averaged, 1 in the first fluid; normal: (n, dim) into the first fluid, zero outside the band;
    strength: (n,) |grad C|, 1/m, zero outside the band; curvature: (n,) 1/m, where a force has asked for it.
    """

    colour: np.ndarray
    normal: np.ndarray
    strength: np.ndarray
    curvature: np.ndarray | None = None


@dataclass(frozen=True)
class Ghosts:
    """Dummies that the fluid particles near a contact line see.

    start: (n + 1,) row pointers; offset: (n_pairs, dim) from the particle, m; colour: (n_pairs,); normal: (n_pairs,
    dim), zero where a dummy carries no interface; volume: of a dummy, m^dim.
    """

    start: np.ndarray
    offset: np.ndarray
    colour: np.ndarray
    normal: np.ndarray
    volume: float


def find_band(ops: Operators, colour: np.ndarray, near: np.ndarray, spacing: float,
              ghosts: Ghosts | None = None, wanted: np.ndarray | None = None) -> Band:
    """The Band of a configuration.

    ops: Operators; near: (n,) of `near_interface`; spacing: m; ghosts: what walls carry on of the interface
    (see `contact_angle`), or None; wanted: (n,) bool, particles whose normals are asked for, or None for all.
    """
    beyond = ghost_arrays(ghosts, len(colour), ops.dim)
    if wanted is None:
        wanted = np.ones(len(colour), np.bool_)
    reach, smooth, known = near, colour, wanted
    for _ in range(AVERAGES):
        known = dilate(ops.start, ops.column, known)
    for _ in range(AVERAGES):
        reach = dilate(ops.start, ops.column, reach)
        smooth = average(ops.neighbours, ops.volume, smooth, reach & known, beyond)
    reach = reach & wanted
    # in place of eqs 16-17: the gradient of eq. 5 of the averaged colour
    normal, strength = _normals(ops.start, ops.column, ops.grad_p, smooth, reach, FAINT / spacing)
    if ghosts is not None:
        beside, at_the_wall, strong = _normals_with_ghosts(ops.neighbours, ops.volume, smooth, reach, FAINT / spacing,
                                                           beyond)
        normal[beside], strength[beside] = at_the_wall[beside], strong[beside]
    return Band(smooth, normal, strength)


def ghost_arrays(ghosts: Ghosts | None, n: int,
                 dim: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """(start, offset, colour, normal, volume) of `Ghosts`; of none for n particles where they are None."""
    if ghosts is None:
        return np.zeros(n + 1, np.int64), np.zeros((0, dim)), np.zeros(0), np.zeros((0, dim)), 0.0
    return ghosts.start, ghosts.offset, ghosts.colour, ghosts.normal, ghosts.volume


def crossings(ops: Operators, colour: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Fraction t of the way from i to j at which a pair crosses the interface, (n_pairs,); 0.5 for like pairs.
    Arguments as those of `find_band`."""
    point, weight = _adjacent(ops.neighbours, ops.volume, colour, ADJACENT)
    depth = _depths(ops.neighbours, colour, point, weight, near, ops.dim)
    return _fractions(ops.start, ops.column, colour, depth)


@njit(cache=True, parallel=True)
def near_interface(start, column, colour):
    """Particles with a neighbour of the other fluid, (n,) bool."""
    n = len(start) - 1
    near = np.zeros(n, np.bool_)
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            if colour[column[p]] != colour[i]:
                near[i] = True
                break
    return near


@njit(cache=True, parallel=True)
def dilate(start, column, mark):
    """The marked particles and their neighbours, (n,) bool."""
    n = len(start) - 1
    out = mark.copy()
    for i in prange(n):
        if not mark[i]:
            for p in range(start[i], start[i + 1]):
                if mark[column[p]]:
                    out[i] = True
                    break
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def average(neighbours, weight, f, mark, ghosts):
    """Kernel average sum_j w W f / sum_j w W of the marked particles, (n,), j = i and the ghosts included; f elsewhere.

    weight: (n,) w, the volumes or more; f: (n,); mark: (n,) bool; ghosts: of `ghost_arrays`.
    """
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, support = neighbours.kind, neighbours.support
    ghost_start, ghost_offset, ghost_f, _, ghost_weight = ghosts
    n, dim = len(start) - 1, x.shape[1]
    out = f.copy()
    for i in prange(n):
        if mark[i]:
            total, z = weight[i] * shape(kind, 0.0), 0.0
            mean = total * f[i]
            for p in range(start[i], start[i + 1]):
                w = weight[column[p]] * shape(kind, _distance(x, i, row[p]) / support)
                total += w
                mean += w * f[column[p]]
            for p in range(ghost_start[i], ghost_start[i + 1]):
                if dim == 3:
                    z = ghost_offset[p, 2]
                r = math.sqrt(ghost_offset[p, 0] ** 2 + ghost_offset[p, 1] ** 2 + z * z)
                w = ghost_weight * shape(kind, r / support)
                total += w
                mean += w * ghost_f[p]
            out[i] = mean / total
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def averages(neighbours, weight, f, times):
    """f (n,) averaged so many times over the particles of weight (n,) above zero, without ghosts: see `average`."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, support = neighbours.kind, neighbours.support
    n = len(start) - 1
    share, own = np.empty(len(column)), np.empty(n)
    for i in prange(n):
        if weight[i] > 0.0:
            total = weight[i] * shape(kind, 0.0)
            for p in range(start[i], start[i + 1]):
                w = weight[column[p]]
                share[p] = w * shape(kind, _distance(x, i, row[p]) / support) if w > 0.0 else 0.0
                total += share[p]
            own[i] = weight[i] * shape(kind, 0.0) / total
            for p in range(start[i], start[i + 1]):
                share[p] /= total
    for _ in range(times):
        before = f
        f = before.copy()
        for i in prange(n):
            if weight[i] > 0.0:
                mean = own[i] * before[i]
                for p in range(start[i], start[i + 1]):
                    mean += share[p] * before[column[p]]
                f[i] = mean
    return f


@njit(cache=True, inline="always")
def _distance(x, i, j):
    """Between two rows of x (n, dim)."""
    r2 = (x[j, 0] - x[i, 0]) ** 2 + (x[j, 1] - x[i, 1]) ** 2
    if x.shape[1] == 3:
        r2 += (x[j, 2] - x[i, 2]) ** 2
    return math.sqrt(r2)


@njit(cache=True, parallel=True)
def _normals(start, column, grad, f, mark, faint):
    n, dim = len(start) - 1, grad.shape[1]
    normal, strength = np.zeros((n, dim)), np.zeros(n)
    for i in prange(n):
        if mark[i]:
            x, y, z = 0.0, 0.0, 0.0
            for p in range(start[i], start[i + 1]):
                d = f[column[p]] - f[i]
                x += grad[p, 0] * d
                y += grad[p, 1] * d
                if dim == 3:
                    z += grad[p, 2] * d
            normal[i, 0], normal[i, 1] = x, y
            if dim == 3:
                normal[i, 2] = z
            strength[i] = _normalise(normal[i], faint)
    return normal, strength


@njit(cache=True)
def _normalise(gradient, faint):
    """Makes a unit vector of a gradient (dim,), or zero of a faint one; returns its size, or zero."""
    size = 0.0
    for k in range(len(gradient)):
        size += gradient[k] ** 2
    size = math.sqrt(size)
    for k in range(len(gradient)):
        gradient[k] = gradient[k] / size if size > faint else 0.0
    return size if size > faint else 0.0


@njit(cache=True, parallel=True, error_model="numpy")
def _normals_with_ghosts(neighbours, volume, f, mark, faint, ghosts):
    """(which of the marked particles see ghosts, (n,) bool, their normals (n, dim), strengths (n,)): gradients of eq. 5
    over fluid and ghosts."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kernel = neighbours.kind, neighbours.support
    ghost_start, ghost_offset, ghost_f, _, ghost_volume = ghosts
    n, dim = len(start) - 1, x.shape[1]
    beside, normal, strength = np.zeros(n, np.bool_), np.zeros((n, dim)), np.zeros(n)
    for i in prange(n):
        if mark[i] and ghost_start[i + 1] > ghost_start[i]:
            beside[i] = True
            sums, dz = NO_SLOPE, 0.0
            for p in range(start[i], start[i + 1]):
                j, q = column[p], row[p]
                if dim == 3:
                    dz = x[q, 2] - x[i, 2]
                offset = x[q, 0] - x[i, 0], x[q, 1] - x[i, 1], dz
                sums = _add_slope(sums, offset, f[j] - f[i], volume[j], kernel)
            for p in range(ghost_start[i], ghost_start[i + 1]):
                if dim == 3:
                    dz = ghost_offset[p, 2]
                offset = ghost_offset[p, 0], ghost_offset[p, 1], dz
                sums = _add_slope(sums, offset, ghost_f[p] - f[i], ghost_volume, kernel)
            spread, inverse = np.empty(6), np.zeros((3, 3))
            for k in range(6):
                spread[k] = sums[k]
            invert_gradient(spread, dim, inverse, 0.0)
            for k in range(dim):
                normal[i, k] = inverse[k, 0] * sums[6] + inverse[k, 1] * sums[7] + inverse[k, 2] * sums[8]
            strength[i] = _normalise(normal[i], faint)
    return beside, normal, strength


NO_SLOPE = (0.0,) * 9


@njit(cache=True, inline="always")
def _add_slope(s, offset, difference, volume, kernel):
    """The sums of w d (x) d (xx, yy, zz, yz, xz, xy) and w d (f_j - f_i), w = F V / r, with one more neighbour."""
    x, y, z = offset
    r = math.sqrt(x * x + y * y + z * z)
    w = volume * slope(kernel[0], r / kernel[1]) / r if r > 0.0 else 0.0
    a, b, c = w * x, w * y, w * z
    return (s[0] + x * a, s[1] + y * b, s[2] + z * c, s[3] + y * c, s[4] + x * c, s[5] + x * b,
            s[6] + a * difference, s[7] + b * difference, s[8] + c * difference)  # fmt: skip


@njit(cache=True, parallel=True)
def _adjacent(neighbours, volume, colour, reach):
    """Mean crossing point of the adjacent unlike pairs of each particle, relative to it, (n, dim), and its weight."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    n, dim = len(start) - 1, x.shape[1]
    point, weight = np.zeros((n, dim)), np.zeros(n)
    farthest = (reach * np.max(volume) ** (1.0 / dim)) ** 2
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            if colour[j] != colour[i]:
                r2 = 0.0
                for k in range(dim):
                    r2 += (x[row[p], k] - x[i, k]) ** 2
                if r2 >= farthest:
                    continue
                limit = reach * (0.5 * (volume[i] + volume[j])) ** (1.0 / dim)
                q = r2 / (limit * limit)
                if q < 1.0:
                    w = (1.0 - q) ** 2
                    weight[i] += w
                    for k in range(dim):
                        point[i, k] += 0.5 * w * (x[row[p], k] - x[i, k])
        if weight[i] > 0.0:
            for k in range(dim):
                point[i, k] /= weight[i]
    return point, weight


@njit(cache=True, parallel=True, error_model="numpy")
def _depths(neighbours, colour, point, weight, near, dim):
    """Distance of the particles near the interface to the plane through the crossings that they see; nan where they
    see none.

    The plane goes through the mean of the crossings; its normal is the direction in which they spread least. Where
    they spread in all directions alike, as for a bubble of some particles, it is that from the one fluid to the other.
    """
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, support = neighbours.kind, neighbours.support
    n = len(start) - 1
    depth = np.full(n, np.nan)
    for i in prange(n):
        if near[i]:
            # moments in scalars: small arrays take twice as long
            total, px, py, pz = weight[i], point[i, 0], point[i, 1], point[i, 2] if dim == 3 else 0.0
            sum_x, sum_y, sum_z = total * px, total * py, total * pz
            xx, yy, zz, yz, xz, xy = sum_x * px, sum_y * py, sum_z * pz, sum_y * pz, sum_x * pz, sum_x * py
            across_x, across_y, across_z, dz = 0.0, 0.0, 0.0, 0.0
            for p in range(start[i], start[i + 1]):
                j, q = column[p], row[p]
                unlike = colour[j] - colour[i]
                if weight[j] == 0.0 and unlike == 0.0:
                    continue
                dx, dy = x[q, 0] - x[i, 0], x[q, 1] - x[i, 1]
                if dim == 3:
                    dz = x[q, 2] - x[i, 2]
                kernel = shape(kind, math.sqrt(dx * dx + dy * dy + dz * dz) / support)
                across_x += kernel * unlike * dx
                across_y += kernel * unlike * dy
                across_z += kernel * unlike * dz
                w = kernel * weight[j]
                px, py = dx + point[j, 0], dy + point[j, 1]
                pz = dz + point[j, 2] if dim == 3 else 0.0
                wx, wy, wz = w * px, w * py, w * pz
                total, sum_x, sum_y, sum_z = total + w, sum_x + wx, sum_y + wy, sum_z + wz
                xx, yy, zz = xx + wx * px, yy + wy * py, zz + wz * pz
                yz, xz, xy = yz + wy * pz, xz + wx * pz, xy + wx * py
            if total > 0.0:
                mean_x, mean_y, mean_z = sum_x / total, sum_y / total, sum_z / total
                # crossings at one point have no direction: their spread is round-off
                least = 1e-12 * total * support * support
                spread_xx, spread_yy, spread_xy = xx - sum_x * mean_x, yy - sum_y * mean_y, xy - sum_x * mean_y
                if dim == 2:
                    flat, normal_x, normal_y, normal_z = _flattest_2d(spread_xx, spread_yy, spread_xy, least)
                else:
                    flat, normal_x, normal_y, normal_z = _flattest(
                        spread_xx, spread_yy, zz - sum_z * mean_z, yz - sum_y * mean_z, xz - sum_x * mean_z, spread_xy,
                        least)
                if not flat:
                    normal_x, normal_y, normal_z = across_x, across_y, across_z
                size = math.sqrt(normal_x * normal_x + normal_y * normal_y + normal_z * normal_z)
                along = mean_x * normal_x + mean_y * normal_y + mean_z * normal_z
                depth[i] = abs(along) / size if size > 0.0 else np.nan
    return depth


@njit(cache=True)
def _flattest_2d(xx, yy, xy, least):
    """As `_flattest`."""
    half, middle = 0.5 * (xx - yy), 0.5 * (xx + yy)
    radius = math.hypot(half, xy)
    flat = middle - radius < FLAT * (middle + radius) and middle + radius >= least
    if half > 0.0:
        return flat, -xy, half + radius, 0.0
    return flat, radius - half, -xy, 0.0


@njit(cache=True)
def _flattest(xx, yy, zz, yz, xz, xy, least):
    """Whether a symmetric positive tensor is larger than `least`, and thinner than FLAT of the next in one direction,
    and that direction, not normalised.

    Eigenvalues in closed form, the vector from the rows of tensor - value: exact to round-off because the value stands
    apart, and several times faster than numpy's eigh.
    """
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    size = math.sqrt((a * a + b * b + c * c + 2.0 * (yz * yz + xz * xz + xy * xy)) / 6.0)
    if size == 0.0:
        return False, 0.0, 0.0, 0.0
    cosine = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (2.0 * size**3)
    angle = math.acos(min(max(cosine, -1.0), 1.0)) / 3.0
    largest = mean + 2.0 * size * math.cos(angle)
    smallest = mean + 2.0 * size * math.cos(angle + 2.0 * math.pi / 3.0)
    if not smallest < FLAT * (3.0 * mean - largest - smallest) or largest < least:
        return False, 0.0, 0.0, 0.0
    a, b, c = xx - smallest, yy - smallest, zz - smallest
    # the longest of the products of two rows
    u, v, w = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
    longest = u * u + v * v + w * w
    for product in ((xz * yz - xy * c, a * c - xz * xz, xy * xz - a * yz),
                    (b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz)):  # fmt: skip
        length = product[0] ** 2 + product[1] ** 2 + product[2] ** 2
        if length > longest:
            longest = length
            u, v, w = product
    return longest > 0.0, u, v, w


@njit(cache=True, parallel=True)
def _fractions(start, column, colour, depth):
    n = len(start) - 1
    t = np.full(len(column), 0.5)
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            if colour[j] != colour[i]:
                both = depth[i] + depth[j]
                if both > 0.0:
                    t[p] = min(max(depth[i] / both, NEAREST), 1.0 - NEAREST)
    return t
