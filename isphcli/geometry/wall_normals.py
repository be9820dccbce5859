"""Unit normals of walls, from the wall distance (in place of eq. 19)."""

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
