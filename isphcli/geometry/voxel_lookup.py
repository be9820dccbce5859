"""The voxel of a point and its label; voxel coordinates: see `voxel_geometry`."""

from __future__ import annotations

import numpy as np
from numba import njit

TIE = 1e-9  # voxels: points this close below a voxel face lie on it and belong to the upper voxel
FAR = np.float32(1e30)
LEAST_T = 1e-9  # of a segment: crossing of a wall that passes through its first point


@njit(cache=True, error_model="numpy")
def label_at(grid, around, ix, iy, iz):
    """Label of voxel (ix, iy, iz), wrapped along periodic axes, -1 outside along the others."""
    nz, ny, nx = grid.shape
    if ix < 0 or ix >= nx:
        if not around[0]:
            return -1
        ix %= nx
    if iy < 0 or iy >= ny:
        if not around[1]:
            return -1
        iy %= ny
    if iz < 0 or iz >= nz:
        if not around[2]:
            return -1
        iz %= nz
    return int(grid[iz, iy, ix])


@njit(cache=True)
def voxel_of(u):
    """Index of the voxel along one axis; a face belongs to the upper voxel in spite of round-off."""
    return int(np.floor(u + TIE))
