"""Unit normals and curvature of walls, from the wall distance (in place of eq. 19)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .protocol import Geometry


def wall_normals(geometry: Geometry, x: np.ndarray, scale: float) -> np.ndarray:
    """Unit normals into the fluid at x (n, dim), from central differences of the wall distance over 1e-3 of `scale`, m;
    zero where it is flat."""
    h = 1e-3 * scale
    normal = np.empty_like(x)
    for k in range(x.shape[1]):
        step = np.zeros(x.shape[1])
        step[k] = h
        normal[:, k] = geometry.distance(x + step) - geometry.distance(x - step)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0.0, length, 1.0)


def wall_shape(geometry: Geometry, x: np.ndarray, distance: np.ndarray,
               step: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (n, dim) into the fluid at x (n, dim), m, zero where the distance is flat, and the Laplacian (n,) of
    the distance, 1/m: the sum of the curvatures of the wall, below 0 where it bends round the fluid.

    distance: (n,) m, at x; step: m, of the differences.
    """
    normal, laplacian = np.empty_like(x), -2.0 * x.shape[1] * distance
    for k in range(x.shape[1]):
        way = np.zeros(x.shape[1])
        way[k] = step
        above, below = geometry.distance(x + way), geometry.distance(x - way)
        normal[:, k] = above - below
        laplacian += above + below
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0.0, length, 1.0), laplacian / step**2
