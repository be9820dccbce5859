"""`ImageBrick`: the geometry of an image of which a process holds a part, its walls the faces of voxels.

The wall distance of a voxel centre is that of the whole image wherever it is less than the margin of voxels round the
brick: all walls nearer than that lie in the part. Elsewhere the distance is too small, but beyond the margin, and there
no operator needs its value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from ..domain.row_threads import over_rows
from .faces import AT_REST, Walls
from .labels import ClearLayers
from .voxel_crossings import put_first_faces
from .voxel_geometry import VoxelGeometry

# voxels read round a brick. In bricks of 64^3 voxels of Berea sandstone distances up to 7 voxels are those of the whole
# image bit for bit with a margin of 7; 3 are enough for distances up to a support of 2.5 spacings of a voxel
MARGIN = 7
CLEAR = -9  # stands for the index of a voxel in clear layers; no index of the file is next to it

Read = Callable[[Sequence[tuple[int, int]]], np.ndarray]  # labels int8 [z, y, x] or [y, x] of ranges along x, y(, z)


@dataclass(frozen=True)
class LabelsInFile:
    """The labels of an image in its file. shape: voxels along x, y(, z); fluid: how many are fluid; read: reads a part
    as int8, -1 solid, else the index of a fluid. walls: share of the neighbours along the axes, the last and the first
    voxel too, of which just one is solid; straight: all slices across one of the axes are the same."""

    shape: tuple[int, ...]
    fluid: int
    read: Read
    walls: float = 0.0
    straight: bool = False

    def part(self, first: np.ndarray, end: np.ndarray, layers: ClearLayers | None) -> np.ndarray:
        """int8 [z, y, x] or [y, x] of the voxels from `first` to before `end` along x, y(, z) of the image with its
        clear layers, which repeats along all axes."""
        pieces = []
        for axis, n in enumerate(self.shape):
            clear = layers.voxels if layers is not None and layers.axis == axis else 0
            at = np.mod(np.arange(first[axis], end[axis]), n + 2 * clear) - clear
            at = np.where((at >= 0) & (at < n), at, CLEAR)
            breaks = np.flatnonzero((np.diff(at) != 1) & ~((at[1:] == CLEAR) & (at[:-1] == CLEAR))) + 1
            pieces.append([(int(run[0]), int(begin), len(run)) for run, begin in
                           zip(np.split(at, breaks), np.concatenate([[0], breaks]))])
        out = np.zeros(tuple(int(b - a) for a, b in zip(first, end))[::-1], np.int8)
        for choice in np.ndindex(*(len(runs) for runs in pieces)):
            runs = [pieces[axis][k] for axis, k in enumerate(choice)]
            if min(low for low, _, _ in runs) >= 0:  # else clear
                place = tuple(slice(begin, begin + count) for _, begin, count in reversed(runs))
                out[place] = self.read([(low, low + count) for low, _, count in runs])
        return out


class ImageBrick(VoxelGeometry):
    """Geometry (see `protocol.Geometry`) of an image in a file; it has values only where `within` has been called for.

    voxel_size, periodic, layers, walls: see `VoxelGeometry`.
    """

    def __init__(self, image: LabelsInFile, voxel_size: float | Sequence[float] | np.ndarray, periodic: Sequence[bool],
                 layers: ClearLayers | None = None, walls: Walls = AT_REST):
        self.image, self._layers = image, layers
        self.labels = None
        self._set_box(image.shape[::-1], voxel_size, periodic, layers, walls)
        solid = image.fluid < int(np.prod(image.shape))
        self.has_solid = solid or not all(self.periodic)
        self._some = solid and image.fluid > 0
        self._first, self._turn = np.zeros(self.dim, int), np.zeros(self.dim, int)  # of the part; voxels that repeat
        self._held: dict[tuple[float, ...], ImageBrick] = {}

    def within(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> ImageBrick:
        """The geometry of the points within `reach`, m, of a brick of corners (dim,), and of their periodic images;
        distances up to `reach` are those of the whole image."""
        key = (*lower, *upper, reach)
        if key not in self._held:
            self._held.clear()  # one at a time
            self._held[key] = self._part(lower, upper, reach)
        return self._held[key]

    def _part(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> ImageBrick:
        found = copy(self)
        found._held = {}
        whole = np.rint((self.upper - self.lower) / self.voxel_size).astype(int)
        margin = np.maximum(np.ceil(reach / self.voxel_size), 0.0) + MARGIN
        first = np.floor((lower - reach - self.lower) / self.voxel_size - margin).astype(int)
        end = np.ceil((upper + reach - self.lower) / self.voxel_size + margin).astype(int)
        around = np.array(self.periodic)
        first, end = np.where(around, first, np.maximum(first, 0)), np.where(around, end, np.minimum(end, whole))
        every = end - first >= whole
        first, end = np.where(every, 0, first), np.where(every, whole, end)
        labels = self.image.part(first, end, self._layers)
        found._grid = labels if self.dim == 3 else labels[None]
        # a cut side of the part is farther from the points than any distance that is asked for
        found._around = np.array([*(around & every), True][:3])
        found._first, found._turn = first, np.where(around & ~every, whole, 0)
        found._solid = 0 if (labels >= 0).all() else 2 if (labels < 0).all() else 1
        return found

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """See `VoxelGeometry`; both points lie within reach of the brick, not of its images."""
        xi, xj = np.asarray(xi, dtype=float), np.asarray(xj, dtype=float)
        if not self.has_solid:
            return np.ones(len(xi))
        corner = self.lower + self._first * self.voxel_size
        t = np.empty(len(xi))
        over_rows(put_first_faces, len(xi), self._grid, self._around, (xi, xj), corner, self.voxel_size, t)
        return t

    def _points(self, x: np.ndarray) -> np.ndarray:
        """Voxel coordinates (n, 3) in the part that is held."""
        u = super()._points(x)
        for axis, (first, turn) in enumerate(zip(self._first, self._turn)):
            u[:, axis] -= first
            if turn:
                u[:, axis] -= turn * np.floor(u[:, axis] / turn)
        return u
