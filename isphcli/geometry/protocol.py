"""The members of every geometry; `ShapeGeometry` and `VoxelGeometry` implement them."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Geometry(Protocol):
    """Labels and wall distances of a scene. Points are (n, dim) float64, lengths in metres.

    Points may lie outside the box: along periodic axes they are wrapped, along the others everything outside
    is solid.
    """

    dim: int
    lower: np.ndarray  # (dim,) corner of the box
    upper: np.ndarray  # (dim,)
    sample_lower: np.ndarray  # (dim,) corner of the rock itself: of an image without its clear layers, else of the box
    sample_upper: np.ndarray  # (dim,)
    periodic: tuple[bool, ...]  # per axis
    wall_velocity: np.ndarray  # (n_walls, dim), m/s; wall 0 is at rest
    wall_spin: np.ndarray | None  # (n_walls, dim, dim), 1/s: a wall moves at wall_velocity + wall_spin @ x; None: 0
    wall_speed: np.ndarray  # (n_walls,) largest speed, m/s
    slip_length: np.ndarray  # (n_walls,) Navier slip length, m
    has_solid: bool  # False: no solid anywhere
    level_walls: bool  # every wall lies along the axes: the faces of voxels
    warnings: tuple[str, ...]  # sentences on what is unusual about the input
    described: tuple[tuple[str, str], ...]  # what was read and how it was understood: (name, text); () without a file

    @property
    def labels(self) -> np.ndarray | None:
        """Of an image, int8 [z, y, x] or [y, x], its clear layers included; None of shapes."""
        ...

    @property
    def voxel_size(self) -> np.ndarray | None:
        """Of an image, (dim,) m; None of shapes."""
        ...

    def within(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> Geometry:
        """The same geometry, for points within `reach`, m, of a brick of corners (dim,) and their periodic images only:
        of an image that is not in memory it reads that part."""
        ...

    def phase(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: -1 in a solid, otherwise the index of the fluid."""
        ...

    def microporous(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: index of the microporous rock that fluid seeps through, -1 in clear fluid and solids."""
        ...

    def distance(self, x: np.ndarray, depth: float = np.inf) -> np.ndarray:
        """(n,) signed distance to the wall, > 0 in fluid; +inf where there is no wall at all.

        depth: m; for points deeper in solids any distance beyond it may be returned, which is quicker."""
        ...

    def wall(self, x: np.ndarray) -> np.ndarray:
        """(n,) int32 index of the nearest wall in `wall_velocity` and `slip_length`."""
        ...

    def nearest(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(`distance`, `wall`) of points, found together."""
        ...

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """(n,) fraction t in (0, 1] of the way from fluid point xi to xj where the first wall is met;
        1.0 where none is met."""
        ...

    def interface_distance(self, x: np.ndarray, spacing: float) -> np.ndarray | None:
        """(n,) signed distance to where fluids 0 and 1 meet, m, > 0 in fluid 0; None where only labels tell the fluids
        apart.

        spacing: of the particles, m: what is narrower may be missed."""
        ...


def inside_sample(geometry: Geometry, x: np.ndarray) -> np.ndarray:
    """(n,) bool: which points (n, dim) are within the rock itself, of an image without its clear layers."""
    lower, upper = sample_box(geometry)
    return np.all((x >= lower) & (x <= upper), axis=1)


def sample_voxels(geometry: Geometry) -> tuple[slice, ...]:
    """Part of the labels [z, y, x] or [y, x] of an image without its clear layers."""
    assert geometry.voxel_size is not None
    corners = (np.rint((corner - geometry.lower) / geometry.voxel_size).astype(int) for corner in sample_box(geometry))
    first, end = corners
    return tuple(slice(int(a), int(b)) for a, b in zip(first[::-1], end[::-1]))


def sample_box(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """(lower, upper) corners of the rock itself: of an image without its clear layers, else of the box."""
    return geometry.sample_lower, geometry.sample_upper
