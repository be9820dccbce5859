"""`ImageBrick` and `SmoothBrick`: the geometry of an image of which several processes hold a part each.

Each process has some layers of the image (`domain/slabs.py`), from which it gets the voxels of its brick with a margin.
What runs through the whole image, such as the waves and the spline of a smooth wall, is computed on the layers.

The wall distance of a voxel centre is that of the whole image wherever it is less than the margin of voxels round the
brick: all walls nearer than that lie in the part. Elsewhere the distance is another, but beyond the margin, and there
no operator needs its value.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..domain import reduce
from ..domain.slabs import Shared, Slabs
from .faces import AT_REST, Walls
from .iso_surface import ImageField, IsoSurfaceGeometry
from .label_field import most_probable_field
from .labels import ClearLayers, faces_and_pairs, runs_straight
from .protocol import sample_voxels
from .spline import average, spline_coefficients
from .surface_ways import SurfaceWays, surface_ways
from .voxel_geometry import VoxelGeometry

# voxels held round a brick. In bricks of 64^3 voxels of Berea sandstone distances up to 7 voxels are those of the whole
# image bit for bit with a margin of 7; 3 are enough for distances up to a support of 2.5 spacings of a voxel. A smooth
# wall is looked for 3.5 voxels from a point (`iso_surface`), and its spline needs two more
MARGIN = 7

Brick = TypeVar("Brick", bound="ImageBrick")


@dataclass(frozen=True)
class WholeImage:
    """What is known of all voxels of an image, without its clear layers. shape: voxels along x, y(, z); fluid: how many
    are fluid; walls: share of the neighbours along the axes, the last and the first voxel too, of which just one is
    solid; straight: see `runs_straight`, and a 2D image."""

    shape: tuple[int, ...]
    fluid: int
    walls: float
    straight: bool


def whole_image(pores: np.ndarray, slabs: Slabs) -> WholeImage:
    """Of the pores, bool [z, y, x], of which each process has its layers."""
    shape, ranks = slabs.shape[::-1] if slabs.shape[0] > 1 else slabs.shape[:0:-1], slabs.ranks
    faces = [faces_and_pairs(pores, slabs, (True, True, True), (axis,))[0] for axis in (0, 1, 2)]
    voxels, fluid = int(np.prod(shape)), int(ranks.sum(np.count_nonzero(pores)))
    return WholeImage(shape, fluid, sum(faces) / (len(shape) * voxels), len(shape) == 2 or runs_straight(faces))


class ImageBrick(VoxelGeometry):
    """Geometry (see `protocol.Geometry`) of an image that processes share; its walls are the faces of voxels. It has
    values only where `within` has been called for. All processes make it, and call `within`, together.

    labels: int8 [z, y, x]. voxel_size, periodic, layers, walls: see `VoxelGeometry`.
    """

    def __init__(self, labels: Shared, voxel_size: float | Sequence[float] | np.ndarray,
                 periodic: Sequence[bool], layers: ClearLayers | None = None, walls: Walls = AT_REST):
        slabs = labels.slabs
        self.image = whole_image(labels.values >= 0, slabs)
        self.labels = None
        self._rocks: np.ndarray | None = None  # of the own layers, as `fill_with` has them
        self._set_box(self.image.shape[::-1], voxel_size, periodic, layers, walls)
        solid = self.image.fluid < int(np.prod(self.image.shape))
        self.has_solid = solid or not all(self.periodic)
        self._layered = layers is not None
        along, thick = (2 - layers.axis, layers.voxels) if layers is not None else (0, 0)
        self._widths = [(thick, thick) if a == along else (0, 0) for a in range(3)]
        self._slabs, self._grid = slabs.grown(self._widths), slabs.padded(labels.values, self._widths, 0)
        self._around = np.array([*self.periodic, True][:3])
        self._first, self._turn = np.zeros(self.dim, int), np.zeros(self.dim, int)  # of the part; voxels that repeat
        self._held: dict[tuple[float, ...], ImageBrick] = {}
        self._whole: ImageBrick | None = None  # of a part: what it is taken from

    def fill_with(self, microporous: np.ndarray, layers: ClearLayers | None) -> None:
        """See `VoxelGeometry`; of the own layers."""
        self._rocks = self._slabs.padded(microporous, self._widths, -1)

    def solid_at(self, places: Sequence[np.ndarray]) -> np.ndarray:
        """Whether the voxels of the image at places along z, y, x, or y, x, without its clear layers are solid: bool of
        all combinations, on all processes, which call it together. places: ascending."""
        whole = self._whole or self
        layers, slabs = whole._slabs.part(whole._grid, whole._sample)
        z, y, x = places if len(places) == 3 else (np.zeros(1, int), *places)
        own = z[(z >= slabs.own[0]) & (z < slabs.own[1])] - slabs.own[0]
        solid = np.concatenate(slabs.ranks.collect(layers[np.ix_(own, y, x)] < 0))
        return solid.reshape([len(along) for along in places])

    def within(self: Brick, lower: np.ndarray, upper: np.ndarray, reach: float) -> Brick:
        """The geometry of the points within `reach`, m, of a brick of corners (dim,), and of their periodic images;
        distances up to `reach` are those of the whole image."""
        if self._whole is not None:
            return self._whole.within(lower, upper, reach)  # type: ignore[return-value]
        key = (*lower, *upper, reach)
        if self._slabs.ranks.max(int(key not in self._held)):  # on any of the processes: they make it together
            self._held.clear()  # one at a time
            self._held[key] = self._part(lower, upper, reach)
        return self._held[key]  # type: ignore[return-value]

    def _part(self: Brick, lower: np.ndarray, upper: np.ndarray, reach: float) -> Brick:
        found = copy(self)
        found._held, found._whole = {}, self
        whole = np.rint((self.upper - self.lower) / self.voxel_size).astype(int)
        margin = np.maximum(np.ceil(reach / self.voxel_size), 0.0) + MARGIN
        first = np.floor((lower - reach - self.lower) / self.voxel_size - margin).astype(int)
        end = np.ceil((upper + reach - self.lower) / self.voxel_size + margin).astype(int)
        around = np.array(self.periodic)
        first, end = np.where(around, first, np.maximum(first, 0)), np.where(around, end, np.minimum(end, whole))
        every = end - first >= whole
        first, end = np.where(every, 0, first), np.where(every, whole, end)
        # a cut side of the part is farther from the points than any distance that is asked for
        found._around = np.array([*(around & every), True][:3])
        found._first, found._turn = first, np.where(around & ~every, whole, 0)
        found._corner = self.lower + first * self.voxel_size
        flat = [1] * (3 - self.dim)
        found._take(self, [0] * len(flat) + list(first[::-1]), flat + list(end[::-1]))
        return found

    def _take(self, layers: ImageBrick, first: Sequence[int], end: Sequence[int]) -> None:
        """Takes the voxels from `first` to before `end`, z, y, x, from the layers of all processes."""
        self._grid = layers._slabs.box(layers._grid, first, end)
        solid = self._grid < 0
        self._solid = 0 if not solid.any() else 2 if solid.all() else 1
        if layers._rocks is not None:
            super().fill_with(layers._slabs.box(layers._rocks, first, end), None)
            self._rocks = None

    def _points(self, x: np.ndarray) -> np.ndarray:
        """Voxel coordinates (n, 3) in the part that is held."""
        u = super()._points(x)
        for axis, (first, turn) in enumerate(zip(self._first, self._turn)):
            u[:, axis] -= first
            if turn:
                u[:, axis] -= turn * np.floor(u[:, axis] / turn)
        return u


class SmoothBrick(ImageBrick, IsoSurfaceGeometry):
    """The same of the surface on which a field of an image is zero (see `IsoSurfaceGeometry`). field: its values are
    those of the own layers."""

    def __init__(self, labels: Shared, field: ImageField | None, voxel_size: float | Sequence[float] | np.ndarray,
                 periodic: Sequence[bool], layers: ClearLayers | None = None, walls: Walls = AT_REST):
        ImageBrick.__init__(self, labels, voxel_size, periodic, layers, walls)
        values = self._field_of_layers(field)
        self._pores, self._spline = values > 0, spline_coefficients(values, self._around, self._slabs)

    def _field_of_layers(self, field: ImageField | None) -> np.ndarray:
        """See `IsoSurfaceGeometry.field`; of the own layers, which clear ones belong to."""
        if field is None:
            return most_probable_field(self._grid >= 0, self._around, self._sample, self._slabs)
        values, fluid = np.asarray(field.values, np.float32), 1.0
        if self._layered:
            pores = values[values > 0].astype(float)
            fluid = float(reduce.quantiles(pores, [0.5])[0]) if reduce.number(pores) else 1.0
        values = self._slabs.padded(values, self._widths, fluid)
        return average(values, field.gaussian, self._around, self._slabs)

    def ways(self) -> SurfaceWays:
        """See `IsoSurfaceGeometry`."""
        whole = [part == slice(0, n) for part, n in zip(sample_voxels(self), self._slabs.shape[3 - self.dim :])][::-1]
        periodic = tuple(p and w for p, w in zip(self.periodic, whole))
        return surface_ways(self._spline, self._around, self._pores, self._grid, self._sample, periodic, self._slabs)

    def _take(self, layers: ImageBrick, first: Sequence[int], end: Sequence[int]) -> None:
        super()._take(layers, first, end)
        assert isinstance(layers, SmoothBrick)
        self._pores = layers._slabs.box(layers._pores, first, end)
        self._spline = layers._slabs.box(layers._spline, first, end)
