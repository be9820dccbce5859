"""`IsoSurfaceGeometry`: the wall is the zero of a field on the voxel centres, interpolated by a cubic spline.

The field is positive in fluid. Its sign alone decides what is fluid, at every spacing of the particles: the body does
not depend on how it is sampled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from ..domain.row_threads import over_rows
from .faces import AT_REST, Walls
from .iso_crossings import first_zero, put_first_zeros
from .label_field import most_probable_field
from .labels import ClearLayers, with_clear_layers
from .protocol import sample_voxels
from .spline import average, spline_coefficients, value_and_slope
from .surface_ways import SurfaceWays, surface_ways
from .voxel_geometry import VoxelGeometry, of_nearest_fluid
from .voxel_lookup import FAR, label_at, voxel_of
from .wall_distance import interpolate, join_faces, signed_centre_distance

NEAR = 2.5  # smallest voxel sides: up to this distance the zero is looked for along the slope of the field
LEAST = 0.05  # smallest voxel sides: the distance where neither the slope nor the voxel centres give one
BEYOND = 1.0  # smallest voxel sides: the distance between voxel centres, less half a voxel, errs by less


@dataclass(frozen=True)
class ImageField:
    """A field on the voxel centres whose zero is the wall.

    values: [z, y, x] or [y, x], > 0 in fluid; gaussian: width in voxels of the Gaussian that they are averaged with, 0:
    none.
    """

    values: np.ndarray
    gaussian: float = 0.0


class IsoSurfaceGeometry(VoxelGeometry):
    """Geometry (see `protocol.Geometry`) of the surface on which a field of an image is zero.

    labels: int8 [z, y, x] or [y, x], -1 solid, otherwise the index of a fluid: where the field is positive, the
    nearest fluid voxel says which; field: of the same shape, or None: the smooth body that the labels are samples of
    (`label_field`). The other arguments: see `VoxelGeometry`; in clear layers the field has the median of its positive
    values. Raises ValueError where these do not fit each other.
    """

    level_walls = False

    def __init__(
        self,
        labels: np.ndarray,
        field: ImageField | None,
        voxel_size: float | Sequence[float] | np.ndarray,
        periodic: Sequence[bool],
        layers: ClearLayers | None = None,
        walls: Walls = AT_REST,
    ):
        super().__init__(labels, voxel_size, periodic, layers, walls)
        self._image_field = None
        if field is not None:
            values = np.asarray(field.values, dtype=np.float32)
            if values.shape != np.shape(labels):
                raise ValueError(f"a field of shape {values.shape} for labels of shape {np.shape(labels)}")
            fluid = float(np.median(values[values > 0])) if layers is not None and (values > 0).any() else 1.0
            whole = with_clear_layers(values, layers, fluid).reshape(self._grid.shape)
            self._image_field = ImageField(whole, field.gaussian)

    @cached_property
    def field(self) -> np.ndarray:
        """Field on the voxel centres, float32 [z, y, x], > 0 in fluid; averaged as asked."""
        if self._image_field is None:
            return most_probable_field(self._grid >= 0, self._around, self._sample)
        return average(self._image_field.values, self._image_field.gaussian, self._around)

    @cached_property
    def _pores(self) -> np.ndarray:
        """Whether the field is positive at the voxel centres, bool [z, y, x]."""
        return self.field > 0

    @cached_property
    def _spline(self) -> np.ndarray:
        return spline_coefficients(self.field, self._around)

    def ways(self) -> SurfaceWays:
        """How the pores of the sample are connected by this surface, and how by its labels."""
        sample = sample_voxels(self)
        assert self.labels is not None
        whole = [part == slice(0, n) for part, n in zip(sample, self.labels.shape)][::-1]  # x, y(, z)
        periodic = tuple(p and w for p, w in zip(self.periodic, whole))
        return surface_ways(self._spline, self._around, self.field, self._grid, self._sample, periodic)

    @cached_property
    def _distance_of_centres(self) -> np.ndarray:
        """Signed distance of the voxel centres: the zero is looked for a little farther than it."""
        solid = ~self._pores
        if solid.all() or not solid.any():
            return np.full(solid.shape, -FAR if solid.any() else FAR, dtype=np.float32)
        return signed_centre_distance(solid, self._voxel, self._around)

    @cached_property
    def _fluid(self) -> np.ndarray:
        """Labels with those of the nearest fluid voxels in place of solids."""
        if self._grid.max() <= 0:
            return np.zeros_like(self._grid)
        return np.ascontiguousarray(of_nearest_fluid(self._grid, self._grid < 0, self._voxel, self._around))

    def phase(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: index of the fluid where the field is positive, -1 elsewhere and beyond non-periodic faces."""
        u = self._points(x)
        phase = np.empty(len(u), dtype=np.int8)
        over_rows(_put_phases, len(u), self._spline, self._fluid, self._around, u, phase)
        return phase

    def _fill_distances(self, u: np.ndarray, d: np.ndarray) -> None:
        over_rows(_put_distances, len(u), self._spline, self._distance_of_centres, self._around, self._voxel, u, d)

    def _fill_crossings(self, ends: tuple[np.ndarray, np.ndarray], t: np.ndarray) -> None:
        """Of the first zero of the field, or face of the image."""
        over_rows(put_first_zeros, len(t), self._spline, self._around, ends, self._corner, self.voxel_size, t)


@njit(cache=True, inline="always")
def _fluid_at(fluid, around, ux, uy, uz):
    """Fluid of the voxel that holds a point; -1 beyond a face that is a wall."""
    nz, ny, nx = fluid.shape
    return label_at(fluid, around, _inside(ux, nx), _inside(uy, ny), _inside(uz, nz))


@njit(cache=True, inline="always")
def _inside(c, n):
    """Voxel of a coordinate; the upper face of an axis belongs to its last voxel."""
    return n - 1 if c == n else voxel_of(c)


@njit(cache=True, nogil=True)
def _put_phases(rows, c, fluid, around, u, phase):
    for k in range(rows[0], rows[1]):
        value, _, _, _ = value_and_slope(c, around, u[k, 0], u[k, 1], u[k, 2])
        phase[k] = _fluid_at(fluid, around, u[k, 0], u[k, 1], u[k, 2]) if value > 0.0 else -1


@njit(cache=True, nogil=True)
def _put_distances(rows, c, edt, around, voxel, u, d):
    """Distances of points u (n, 3), units of `voxel`, into d (n,): along the slope to the zero; far off, interpolated
    between voxel centres."""
    end = np.empty(3)
    for k in range(rows[0], rows[1]):
        d[k] = join_faces(_distance(c, edt, around, voxel, u[k], end), c.shape, around, voxel, u[k, 0], u[k, 1],
                          u[k, 2])


@njit(cache=True)
def _distance(c, edt, around, voxel, u, end):
    """Signed distance of a point u (3,) to the zero, without the faces of the image; end (3,): workspace."""
    far = interpolate(edt, around, u[0], u[1], u[2])
    value, sx, sy, sz = value_and_slope(c, around, u[0], u[1], u[2])
    sign = 1.0 if value > 0.0 else -1.0
    far = max(sign * far, LEAST)  # LEAST where the nearest centres have the other sign
    slope = np.sqrt((sx / voxel[0]) ** 2 + (sy / voxel[1]) ** 2 + (sz / voxel[2]) ** 2)
    if far > NEAR or slope == 0.0:
        return sign * far
    reach = far + BEYOND
    scale = -sign * reach / slope
    end[0] = u[0] + scale * sx / voxel[0] ** 2
    end[1] = u[1] + scale * sy / voxel[1] ** 2
    end[2] = u[2] + scale * sz / voxel[2] ** 2
    t = first_zero(c, around, sign, u, end)
    return sign * (t * reach if t < 1.0 else far)
