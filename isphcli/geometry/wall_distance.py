"""Signed wall distance of a labelled voxel image: of its stairs, or of the smooth walls that they stand for.

The distance that the paper takes from smoothed colours (eqs 12-13) is not used: docs/method.md 5.

Voxel coordinates: see `voxel_geometry`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from scipy import ndimage
from scipy.special import ndtr, ndtri

from .voxel_lookup import FAR, SIGN, _label, _voxel_of


def wall_field(
    grid: np.ndarray, voxel: np.ndarray, around: np.ndarray, wall_distance: str = "smooth"
) -> np.ndarray:
    """Signed wall distance at the voxel centres, float32 [z, y, x], in units of `voxel` (x, y, z).

    Faces of the image are not walls here; the kernels add them exactly. 'stairs': the Euclidean distance to
    the nearest centre of the other kind less half a voxel, exact for walls along the axes. 'smooth': near
    walls that look smooth this gives way to the distance at which a plane has the same Gaussian average of
    the labels (width s, one voxel), less the shift s^2 / 2 lap d of a curved wall. Error within two voxels of
    the wall in voxels, rms / mean, against the true bodies (max 0.4 to 0.8: the labels decide the sign):

                                 stairs            smooth
        sphere, R 8.2            0.182 / +0.001    0.120 / +0.012
        sphere, R 4.3            0.178 / +0.007    0.152 / +0.032
        tube, R 8.2              0.220 / -0.035    0.185 / -0.040
        plane (1, 3, 0.7)        0.181 / -0.012    0.097 / -0.013
        plane (1, 1, 1)          0.120 / +0.062    0.085 / +0.064

    For the sphere of R 8.2, the mean of the distances to the boundary voxels of both kinds has 0.165, one
    binomial pass over the distance 0.158, the Gaussian without the curvature term 0.161 (mean +0.127).
    """
    solid = grid < 0
    edt = nearest_centre(solid, voxel, around) - nearest_centre(~solid, voxel, around)
    if wall_distance == "stairs":
        return edt
    axes = [a for a in range(3) if grid.shape[2 - a] > 1]  # x, y, z
    s = float(np.prod(voxel[axes]) ** (1 / max(len(axes), 1)))
    mean = (~solid).astype(np.float32)
    for a in axes:
        mode = "wrap" if around[a] else "nearest"
        mean = ndimage.convolve1d(mean, _gaussian(s / voxel[a]), axis=2 - a, mode=mode)
    plane = np.float32(s) * ndtri(np.clip(mean, 1e-6, 1 - 1e-6, out=mean))
    _blend(edt, plane.astype(np.float32, copy=False), voxel, around, s)
    return np.where(solid, np.minimum(edt, -SIGN), np.maximum(edt, SIGN)).astype(np.float32)


def _gaussian(s: float) -> np.ndarray:
    """Weights of voxels under a Gaussian of s voxels; a plane along the axes then averages to ndtr(d / s)."""
    k = np.arange(-int(np.ceil(6 * s)), int(np.ceil(6 * s)) + 1)
    w = ndtr((k + 0.5) / s) - ndtr((k - 0.5) / s)
    return w / w.sum()


def nearest_centre(target: np.ndarray, voxel: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Distance from each voxel centre to the nearest target centre, less half a voxel in its direction;
    0 on targets. float32 [z, y, x]; exact Euclidean distances, periodic where `around` (x, y, z) says so."""
    squares = np.where(target, np.float32(0), FAR)
    steps = squares.copy()  # the same offsets squared in voxels, for the half voxel of anisotropic images
    for axis in (2, 1, 0):
        n = target.shape[axis]
        if n == 1:
            continue
        shape = np.moveaxis(squares, axis, 2).shape
        f = np.ascontiguousarray(np.moveaxis(squares, axis, 2)).reshape(-1, n)
        g = np.ascontiguousarray(np.moveaxis(steps, axis, 2)).reshape(-1, n)
        _lower_envelopes(f, g, float(voxel[2 - axis]), bool(around[2 - axis]))
        squares = np.moveaxis(f.reshape(shape), 2, axis)
        steps = np.moveaxis(g.reshape(shape), 2, axis)
    half = np.where(steps > 0, 0.5 / np.sqrt(np.maximum(steps, 1)), 0)
    return np.ascontiguousarray(np.sqrt(squares) * (1 - half), dtype=np.float32)


@njit(cache=True, parallel=True)
def _lower_envelopes(f, g, h, periodic):
    """One pass of the distance transform of Felzenszwalb and Huttenlocher (2012), in place: row by row
    f[q] = min over p of f[p] + h^2 (q - p)^2, and g[q] = g[p] + (q - p)^2 with the p that gives it."""
    lines, n = f.shape
    for line in prange(lines):
        first, last = (-n, 2 * n) if periodic else (0, n)
        value, step = f[line].copy(), g[line].copy()
        place = np.empty(last - first, dtype=np.int64)
        start = np.empty(last - first)
        k = -1
        for p in range(first, last):
            fp = value[p % n]
            if fp >= FAR:
                continue
            s = -np.inf
            while k >= 0:
                q = place[k]
                s = ((fp - value[q % n]) / (h * h) + (p * p - q * q)) / (2.0 * (p - q))
                if s > start[k]:
                    break
                k -= 1
            k += 1
            place[k] = p
            start[k] = s if k > 0 else -np.inf
        if k < 0:
            continue
        j = 0
        for q in range(n):
            while j < k and start[j + 1] < q:
                j += 1
            p = place[j]
            f[line, q] = value[p % n] + h * h * (q - p) ** 2
            g[line, q] = step[p % n] + (q - p) ** 2


@njit(cache=True, parallel=True)
def _blend(edt, plane, voxel, around, s):
    """Replace edt in place by the corrected plane distance near smooth walls, where |grad plane| is 1.

    At a face of the image the field goes on as it comes there: in a straight line, without a bend.
    A second wall within the Gaussian (throats, thin walls) changes the gradient: there edt stays. It also
    stays where the two differ by less than 0.06 s, so that walls along the axes are exact.
    """
    nz, ny, nx = edt.shape
    for layer in prange(nz):
        z = np.int64(layer)
        for y in range(ny):
            for x in range(nx):
                near = _step((2.5 * s - abs(edt[z, y, x])) / s)
                if near == 0.0:
                    continue
                centre = plane[z, y, x]
                slope2, bend = 0.0, 0.0
                low, high, apart = _beside(x, nx, around[0])
                if apart > 0:
                    slope2 += ((plane[z, y, high] - plane[z, y, low]) / (apart * voxel[0])) ** 2
                    if apart == 2:
                        bend += (plane[z, y, high] - 2 * centre + plane[z, y, low]) / voxel[0] ** 2
                low, high, apart = _beside(y, ny, around[1])
                if apart > 0:
                    slope2 += ((plane[z, high, x] - plane[z, low, x]) / (apart * voxel[1])) ** 2
                    if apart == 2:
                        bend += (plane[z, high, x] - 2 * centre + plane[z, low, x]) / voxel[1] ** 2
                low, high, apart = _beside(z, nz, around[2])
                if apart > 0:
                    slope2 += ((plane[high, y, x] - plane[low, y, x]) / (apart * voxel[2])) ** 2
                    if apart == 2:
                        bend += (plane[high, y, x] - 2 * centre + plane[low, y, x]) / voxel[2] ** 2
                smooth = _step((0.1 - abs(np.sqrt(slope2) - 1.0)) / 0.05)
                more = centre - 0.5 * s * s * bend - edt[z, y, x]
                edt[z, y, x] += near * smooth * _step((abs(more) / s - 0.06) / 0.03) * more


@njit(cache=True)
def _beside(i, n, periodic):
    """Neighbours of i along an axis and how far apart they are; 0 apart on an axis of one voxel."""
    if n == 1:
        return i, i, 0
    if periodic:
        return (i - 1) % n, (i + 1) % n, 2
    low, high = max(i - 1, 0), min(i + 1, n - 1)
    return low, high, high - low


@njit(cache=True)
def _step(x):
    """0 below 0, 1 above 1, smooth between."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3 - 2 * x)


@njit(cache=True)
def _neighbours_of(c, n, periodic):
    """The two centres round coordinate c along an axis and the weight of the second."""
    c = c - 0.5
    low = int(np.floor(c))
    w = c - low
    high = low + 1
    if low >= 0 and high < n:
        return low, high, w
    if periodic:
        return low % n, high % n, w
    return min(max(low, 0), n - 1), min(max(high, 0), n - 1), w


@njit(cache=True)
def _interpolate(field, around, ux, uy, uz):
    """Trilinear interpolation between voxel centres, constant beyond the outer ones of non-periodic axes."""
    nz, ny, nx = field.shape
    x0, x1, wx = _neighbours_of(ux, nx, around[0])
    y0, y1, wy = _neighbours_of(uy, ny, around[1])
    z0, z1, wz = _neighbours_of(uz, nz, around[2])
    low = (1 - wy) * ((1 - wx) * field[z0, y0, x0] + wx * field[z0, y0, x1])
    low += wy * ((1 - wx) * field[z0, y1, x0] + wx * field[z0, y1, x1])
    if nz == 1:
        return low
    high = (1 - wy) * ((1 - wx) * field[z1, y0, x0] + wx * field[z1, y0, x1])
    high += wy * ((1 - wx) * field[z1, y1, x0] + wx * field[z1, y1, x1])
    return (1 - wz) * low + wz * high


@njit(cache=True)
def _smooth(grid, field, around, voxel, ux, uy, uz):
    """Interpolated distance joined with the faces of the image; its sign may differ from the labels."""
    nz, ny, nx = grid.shape
    plane = np.inf
    beyond = 0.0
    for a in range(3):
        if not around[a]:
            c, n = (ux, nx) if a == 0 else (uy, ny) if a == 1 else (uz, nz)
            depth = min(c, n - c) * voxel[a]
            plane = min(plane, depth)
            if depth < 0:
                beyond += depth * depth
    d = _interpolate(field, around, ux, uy, uz)
    if beyond > 0:
        d = min(d, 0.0)
        return -np.sqrt(beyond + d * d)
    return min(d, plane)


@njit(cache=True)
def _signed(d, label):
    """Distance with the sign of the label, at least SIGN in size where it has to be turned."""
    if label < 0:
        return d if d <= 0 else -SIGN
    return d if d > 0 else SIGN


@njit(cache=True)
def _stairs(grid, around, voxel, ux, uy, uz, far):
    """Distance to the voxel faces, exact within one voxel; farther away `far`, but at least one voxel."""
    if abs(far) > 3 * max(voxel[0], voxel[1], voxel[2]):
        return far
    ix, iy, iz = _voxel_of(ux), _voxel_of(uy), _voxel_of(uz)
    fluid = _label(grid, around, ix, iy, iz) >= 0
    least = np.inf
    for dz in range(-1, 2):
        if grid.shape[0] == 1 and around[2] and dz != 0:
            continue
        z = voxel[2] * max(iz + dz - uz, uz - (iz + dz + 1), 0.0)
        for dy in range(-1, 2):
            y = voxel[1] * max(iy + dy - uy, uy - (iy + dy + 1), 0.0)
            for dx in range(-1, 2):
                if (_label(grid, around, ix + dx, iy + dy, iz + dz) >= 0) != fluid:
                    x = voxel[0] * max(ix + dx - ux, ux - (ix + dx + 1), 0.0)
                    least = min(least, x * x + y * y + z * z)
    d = min(np.sqrt(least), max(abs(far), 1.0))
    return d if fluid else -d


@njit(cache=True, parallel=True)
def _distances(grid, field, around, voxel, stairs, u):
    d = np.empty(len(u))
    for k in prange(len(u)):
        ux, uy, uz = u[k, 0], u[k, 1], u[k, 2]
        d[k] = _smooth(grid, field, around, voxel, ux, uy, uz)
        if stairs:
            d[k] = _stairs(grid, around, voxel, ux, uy, uz, d[k])
        else:
            d[k] = _signed(d[k], _label(grid, around, _voxel_of(ux), _voxel_of(uy), _voxel_of(uz)))
    return d
