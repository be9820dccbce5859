"""The first wall along a segment of a voxel image, by walking from voxel to voxel.

Voxel coordinates: see `voxel_geometry`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .voxel_lookup import LEAST_T, TIE, label_at, voxel_of


@njit(cache=True, nogil=True)
def put_first_faces(rows, grid, around, ends, lower, size, t):
    """Fraction in (0, 1] of the way from xi to xj, (n, dim) m, to the first solid voxel into t (n,); 1 without one."""
    xi, xj = ends
    walk = np.empty((3, 3), np.int64)
    face, u, v = np.empty(3), np.empty(3), np.empty(3)
    u[2] = v[2] = 0.5
    for k in range(rows[0], rows[1]):
        for a in range(xi.shape[1]):
            u[a] = (xi[k, a] - lower[a]) / size[a]
            v[a] = (xj[k, a] - lower[a]) / size[a]
        first = _march(grid, around, u, v, walk, face)
        t[k] = min(max(first, LEAST_T), 1.0)


@njit(cache=True)
def _march(grid, around, u, v, walk, face):
    """First wall along the segment u -> v: walk from voxel face to voxel face (Amanatides and Woo 1987).

    The number of faces along each axis is fixed beforehand, so that round-off can neither miss the last voxel
    nor pass it. Faces of several axes met at one place (within TIE) are an edge or a corner. walk (3, 3): cell, step
    and steps left of each axis, and face (3,), of the next face: workspaces.
    """
    cell, step, left = walk[0], walk[1], walk[2]
    fastest = 0.0
    for a in range(3):
        cell[a] = voxel_of(u[a])
        steps = voxel_of(v[a]) - cell[a]
        left[a] = abs(steps)
        step[a] = 1 if steps > 0 else -1
        face[a] = _face(u[a], v[a], cell[a], step[a], left[a])
        fastest = max(fastest, abs(v[a] - u[a]))
    while left[0] + left[1] + left[2] > 0:
        t = min(face[0], face[1], face[2])
        tie = t + TIE / fastest * 10
        x, y, z = face[0] <= tie, face[1] <= tie, face[2] <= tie
        if x + y + z > 1 and not _passable(grid, around, cell, step, x, y, z):
            return t
        for a in range(3):
            if face[a] <= tie:
                cell[a] += step[a]
                left[a] -= 1
                face[a] = _face(u[a], v[a], cell[a], step[a], left[a])
        if label_at(grid, around, cell[0], cell[1], cell[2]) < 0:
            return t
    return 1.0


@njit(cache=True)
def _face(u, v, cell, step, left):
    """Place along the segment of the next voxel face of one axis; 2 when no face is left."""
    if left == 0:
        return 2.0
    at = cell + 1 if step > 0 else cell
    return min(max((at - u) / (v - u), 0.0), 1.0)


@njit(cache=True)
def _passable(grid, around, cell, step, x, y, z):
    """Whether an edge or a corner can be passed by way of fluid voxels that share faces (the voxel behind it
    is looked at by the caller)."""
    sx, sy, sz = step[0] * x, step[1] * y, step[2] * z
    ix, iy, iz = cell[0], cell[1], cell[2]
    a = x and label_at(grid, around, ix + sx, iy, iz) >= 0
    b = y and label_at(grid, around, ix, iy + sy, iz) >= 0
    c = z and label_at(grid, around, ix, iy, iz + sz) >= 0
    if not (x and y and z):
        return a or b or c
    ab = label_at(grid, around, ix + sx, iy + sy, iz) >= 0
    bc = label_at(grid, around, ix, iy + sy, iz + sz) >= 0
    ac = label_at(grid, around, ix + sx, iy, iz + sz) >= 0
    return (ab and (a or b)) or (bc and (b or c)) or (ac and (a or c))
