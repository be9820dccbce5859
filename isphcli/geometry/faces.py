"""Distances to the faces of the box, and the walls that faces of non-periodic axes are."""

from __future__ import annotations

import numpy as np


def block_distance(q: np.ndarray) -> np.ndarray:
    """Signed distance of a block from its per-axis signed distances q (n, k), exact inside and outside."""
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def face_distance(
    x: np.ndarray, lower: np.ndarray, upper: np.ndarray, periodic: tuple[bool, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (n,) to the faces of the non-periodic axes, > 0 in the box, and the wall number (n,)
    int32 of the nearest: 1 + 2 axis + side. +inf and 0 where all axes are periodic."""
    walls = [a for a in range(len(lower)) if not periodic[a]]
    if not walls:
        return np.full(len(x), np.inf), np.zeros(len(x), dtype=np.int32)
    depth = np.stack([q for a in walls for q in (x[:, a] - lower[a], upper[a] - x[:, a])], axis=1)
    numbers = np.array([1 + 2 * a + side for a in walls for side in (0, 1)], dtype=np.int32)
    return -block_distance(-depth), numbers[np.argmin(depth, axis=1)]


def face_walls(
    dim: int, slip: float, face_velocity: dict | None, face_slip: dict | None, n_more: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Table of walls: velocity (n, dim), m/s, and slip length (n,), m.

    Wall 0 is any wall at rest, 1 + 2 axis + side a face, n_more others follow. face_velocity, face_slip:
    {(axis, side): value}, side 0 lower, 1 upper.
    """
    velocity = np.zeros((1 + 2 * dim + n_more, dim))
    slips = np.full(len(velocity), float(slip))
    for (axis, side), value in (face_velocity or {}).items():
        velocity[1 + 2 * axis + side] = value
    for (axis, side), value in (face_slip or {}).items():
        slips[1 + 2 * axis + side] = value
    return velocity, slips
