"""Signed wall distance of a labelled voxel image: to the faces of its solid voxels, and between its voxel centres.

The distance that the paper takes from smoothed colours (eqs 12-13) is not used: docs/method.md 5.

Voxel coordinates: see `voxel_geometry`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..domain.row_threads import over_rows
from .voxel_lookup import FAR, label_at, voxel_of


def signed_centre_distance(solid: np.ndarray, voxel: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Signed wall distance at the voxel centres, float32 [z, y, x], in units of `voxel` (x, y, z), > 0 in fluid.

    It is the Euclidean distance to the nearest centre of the other kind less half a voxel, exact for walls along the
    axes. Faces of the image are not walls here; `join_faces` adds them.
    """
    return nearest_centre(solid, voxel, around) - nearest_centre(~solid, voxel, around)


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
        over_rows(_lower_envelopes, len(f), f, g, float(voxel[2 - axis]), bool(around[2 - axis]))
        squares = np.moveaxis(f.reshape(shape), 2, axis)
        steps = np.moveaxis(g.reshape(shape), 2, axis)
    half = np.where(steps > 0, 0.5 / np.sqrt(np.maximum(steps, 1)), 0)
    return np.ascontiguousarray(np.sqrt(squares) * (1 - half), dtype=np.float32)


@njit(cache=True, nogil=True)
def _lower_envelopes(rows, f, g, h, periodic):
    """One pass of the distance transform of Felzenszwalb and Huttenlocher (2012), in place: row by row
    f[q] = min over p of f[p] + h^2 (q - p)^2, and g[q] = g[p] + (q - p)^2 with the p that gives it."""
    n = f.shape[1]
    first, last = (-n, 2 * n) if periodic else (0, n)
    value, step = np.empty_like(f[0]), np.empty_like(f[0])
    place, start = np.empty(last - first, dtype=np.int64), np.empty(last - first)
    for line in range(rows[0], rows[1]):
        for q in range(n):
            value[q], step[q] = f[line, q], g[line, q]
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
def interpolate(field, around, ux, uy, uz):
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
def join_faces(d, shape, around, voxel, ux, uy, uz):
    """A signed distance joined with the faces of the image that are walls."""
    nz, ny, nx = shape
    plane = np.inf
    beyond = 0.0
    for a in range(3):
        if not around[a]:
            c, n = (ux, nx) if a == 0 else (uy, ny) if a == 1 else (uz, nz)
            depth = min(c, n - c) * voxel[a]
            plane = min(plane, depth)
            if depth < 0:
                beyond += depth * depth
    if beyond > 0:
        d = min(d, 0.0)
        return -np.sqrt(beyond + d * d)
    return min(d, plane)


@njit(cache=True, error_model="numpy")
def _along(j, n, around, edge, u):
    """Voxel j along an axis of n, wrapped where it repeats and else -1 outside; and how far the coordinate u is off it,
    in units of `edge`."""
    off = edge * max(j - u, u - (j + 1), 0.0)
    if 0 <= j < n:
        return j, off
    return (j % n if around else -1), off


@njit(cache=True)
def _stairs(grid, around, voxel, ux, uy, uz, far):
    """Distance to the voxel faces, exact within one voxel; farther away `far`, but at least one voxel."""
    if abs(far) > 3 * max(voxel[0], voxel[1], voxel[2]):
        return far
    ix, iy, iz = voxel_of(ux), voxel_of(uy), voxel_of(uz)
    own = _along(ix, grid.shape[2], around[0], voxel[0], ux)
    above = _along(ix + 1, grid.shape[2], around[0], voxel[0], ux)
    below = _along(ix - 1, grid.shape[2], around[0], voxel[0], ux)
    fluid = label_at(grid, around, ix, iy, iz) >= 0
    least = np.inf
    # the layer of the point first along each axis: layers farther off than a wall already found are not looked up
    for kz in range(3):
        dz = kz if kz < 2 else -1
        if grid.shape[0] == 1 and around[2] and dz != 0:
            continue
        jz, z = _along(iz + dz, grid.shape[0], around[2], voxel[2], uz)
        for ky in range(3):
            jy, y = _along(iy + (ky if ky < 2 else -1), grid.shape[1], around[1], voxel[1], uy)
            if y * y + z * z >= least:
                continue
            beyond = jz < 0 or jy < 0  # the faces of the image: as solid
            for jx, x in (own, above, below):
                square = x * x + y * y + z * z
                if square < least and (not (beyond or jx < 0) and grid[jz, jy, jx] >= 0) != fluid:
                    least = square
    d = min(np.sqrt(least), max(abs(far), 1.0))
    return d if fluid else -d


@njit(cache=True, nogil=True)
def put_stairs_distances(rows, grid, field, around, voxel, u, d):
    """Distances to the faces of solid voxels at points u (n, 3) into d (n,)."""
    for k in range(rows[0], rows[1]):
        ux, uy, uz = u[k, 0], u[k, 1], u[k, 2]
        far = join_faces(interpolate(field, around, ux, uy, uz), grid.shape, around, voxel, ux, uy, uz)
        d[k] = _stairs(grid, around, voxel, ux, uy, uz, far)
