"""`VoxelGeometry`: phases, wall distance and first wall along a segment of an image whose walls are voxel faces.

In voxel coordinates u = (x - lower) / voxel_size, voxel i covers [i, i + 1] and its centre is i + 1/2. Images
are indexed [z, y, x]; a 2D image [y, x] is one layer, periodic along z.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numba import njit
from scipy import ndimage

from ..domain.row_threads import over_rows, over_slices
from .faces import AT_REST, Walls, face_distance
from .labels import ClearLayers, with_clear_layers
from .protocol import sample_voxels
from .voxel_crossings import put_first_faces
from .voxel_lookup import FAR, label_at, voxel_of
from .wall_distance import put_stairs_distances, signed_centre_distance


class VoxelGeometry:
    """Geometry (see `protocol.Geometry`) of a voxel image; its walls are the faces of solid voxels.

    labels: int8 [z, y, x] or [y, x], -1 solid, otherwise the index of a fluid; voxel_size: m, one number or
    (dim,) in the order x, y(, z); periodic: (dim,) in that order, the faces of the other axes are walls.
    layers: of fluid 0, which the image gets at both ends of an axis; that becomes periodic, and sample_lower,
    sample_upper (dim,) is the box of the image itself. walls: of the faces, and the slip length of all others.
    The wall distances are computed when they are first asked for. Raises ValueError where these do not fit each other.
    off: of a grey image, `ScanFit.off`, voxels; None where no scan was looked for.
    """

    level_walls = True
    warnings: tuple[str, ...] = ()
    described: tuple[tuple[str, str], ...] = ()
    wall_spin: np.ndarray | None = None
    off: float | None = None
    _microporous: np.ndarray | None = None  # see `fill_with`

    def __init__(
        self,
        labels: np.ndarray,
        voxel_size: float | Sequence[float] | np.ndarray,
        periodic: Sequence[bool],
        layers: ClearLayers | None = None,
        walls: Walls = AT_REST,
    ):
        labels = np.asarray(labels)
        if labels.ndim == 3 and labels.shape[0] == 1:
            labels = labels[0]
        if labels.ndim not in (2, 3) or labels.size == 0:
            raise ValueError(f"labels of shape {labels.shape}: give 2 or 3 dimensions and a voxel")
        self._set_box(labels.shape, voxel_size, periodic, layers, walls)
        self.labels: np.ndarray | None = np.ascontiguousarray(with_clear_layers(labels, layers, 0), dtype=np.int8)
        self._grid = self.labels if self.dim == 3 else self.labels[None]
        self._around = np.array([*self.periodic, True][:3])
        solid = bool((self.labels < 0).any())
        self.has_solid = solid or not all(self.periodic)
        self._solid = 0 if not solid else 1 if (self.labels >= 0).any() else 2  # none, some, all

    def _set_box(self, shape: tuple[int, ...], voxel_size: float | Sequence[float] | np.ndarray,
                 periodic: Sequence[bool], layers: ClearLayers | None, walls: Walls) -> None:
        """Sets the members that follow from the shape [z, y, x] or [y, x] of the image alone."""
        self.dim = len(shape)
        size = np.asarray(voxel_size, dtype=float).ravel()
        self.voxel_size = np.full(self.dim, size[0]) if size.size == 1 else size[: self.dim].copy()
        if (
            not (self.voxel_size > 0).all()
            or not np.isfinite(self.voxel_size).all()
            or size.size not in (1, 2, 3)
        ):
            raise ValueError(f"voxel_size {voxel_size} must be positive, one number or one per axis")
        around = [bool(p) for p in periodic][: self.dim]
        if len(around) != self.dim:
            raise ValueError(f"periodic needs {self.dim} entries")
        sample, start = np.array(shape[::-1]), np.zeros(self.dim)
        whole = sample.copy()
        if layers is not None:
            start[layers.axis] = layers.voxels
            around[layers.axis] = True
            whole[layers.axis] += 2 * layers.voxels
        self.periodic = tuple(around)
        self.lower = self._corner = np.zeros(self.dim)  # of the box, and of the voxels that are held
        self.upper = whole * self.voxel_size
        self.sample_lower = start * self.voxel_size
        self.sample_upper = (start + sample) * self.voxel_size
        self.wall_velocity, self.slip_length = walls.table(self.dim)
        self.wall_speed = np.linalg.norm(self.wall_velocity, axis=1)
        self._unit = float(self.voxel_size.min())
        self._voxel = np.append(self.voxel_size / self._unit, 1.0)[:3]  # x, y, z

    def within(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> VoxelGeometry:
        """Itself: it holds the whole image."""
        return self

    @property
    def _sample(self) -> tuple[slice, ...]:
        """The voxels [z, y, x] of the image without its clear layers."""
        sample = sample_voxels(self)
        return sample if self.dim == 3 else (slice(0, 1), *sample)

    @cached_property
    def _field(self) -> np.ndarray:
        """Wall distance at the voxel centres: most of the time and memory of an image."""
        if self._solid == 1:
            return signed_centre_distance(self._grid < 0, self._voxel, self._around)
        return np.full((1, 1, 1), FAR if self._solid == 0 else -FAR, dtype=np.float32)

    def phase(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: label of the voxel that holds each point; -1 in solids and beyond non-periodic faces."""
        return self._labels_at(x, self._grid)

    def _labels_at(self, x: np.ndarray, grid: np.ndarray) -> np.ndarray:
        u = self._points(x)
        label = np.empty(len(u), dtype=np.int8)
        over_rows(_put_phases, len(u), grid, self._around, u, label)
        return label

    def fill_with(self, microporous: np.ndarray, layers: ClearLayers | None) -> None:
        """Sets the microporous rock of each voxel: int8 as `labels` without layers, -1 for none. Solid voxels take that
        of the nearest voxel of fluid, because a smooth wall may leave fluid in them."""
        filled = with_clear_layers(microporous, layers, -1).reshape(self._grid.shape).astype(np.int8)
        if self._solid == 1:
            filled = of_nearest_fluid(filled, self._grid < 0, self._voxel, self._around)
        self._microporous = np.ascontiguousarray(filled)

    def microporous(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: index of the microporous rock of the voxel that holds each point, -1 in clear fluid."""
        if self._microporous is None:
            return np.full(len(x), -1, dtype=np.int8)
        return self._labels_at(x, self._microporous)

    def interface_distance(self, x: np.ndarray, spacing: float) -> None:
        """None: labels say which fluid is where."""

    def distance(self, x: np.ndarray, depth: float = np.inf) -> np.ndarray:
        """(n,) signed distance to the wall, m, at any depth; its sign agrees with `phase`."""
        u = self._points(x)
        if not self.has_solid:
            return np.full(len(u), np.inf)
        d = np.empty(len(u))
        self._fill_distances(u, d)
        return np.where(np.abs(d) > 1e20, np.copysign(np.inf, d), d * self._unit)

    def _fill_distances(self, u: np.ndarray, d: np.ndarray) -> None:
        """Puts the distances of the points u (n, 3) into d (n,), both in voxels."""
        over_rows(put_stairs_distances, len(u), self._grid, self._field, self._around, self._voxel, u, d)

    def wall(self, x: np.ndarray) -> np.ndarray:
        """(n,) int32: the face of the image where it is the nearest wall, otherwise 0."""
        return self.nearest(x)[1]

    def nearest(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(`distance`, `wall`) of points, found together."""
        x = np.asarray(x, dtype=float)
        distance = self.distance(x)
        face, number = face_distance(x, self.lower, self.upper, self.periodic)
        nearest = face <= np.maximum(distance, 0.0) + 1e-6 * self._unit
        return distance, np.where(nearest, number, 0).astype(np.int32)

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """(n,) fraction t in (0, 1] from fluid point xi to xj at the first wall; 1.0 where none is met."""
        xi, xj = np.asarray(xi, dtype=float), np.asarray(xj, dtype=float)
        if not self.has_solid:
            return np.ones(len(xi))
        t = np.empty(len(xi))
        self._fill_crossings((xi, xj), t)
        return t

    def _fill_crossings(self, ends: tuple[np.ndarray, np.ndarray], t: np.ndarray) -> None:
        """Puts the fractions into t (n,): of the first face of a solid voxel, exactly; a segment through the edge where
        two solid voxels touch is blocked."""
        over_rows(put_first_faces, len(t), self._grid, self._around, ends, self._corner, self.voxel_size, t)

    def _points(self, x: np.ndarray) -> np.ndarray:
        """Voxel coordinates (n, 3); the layer of a 2D image has z = 1/2."""
        x = np.asarray(x, dtype=float)
        u = np.empty((len(x), 3))

        def fill(part: slice) -> None:
            u[part, self.dim :] = 0.5
            for axis in range(self.dim):  # rows of three are slow to broadcast over
                u[part, axis] = (x[part, axis] - self.lower[axis]) / self.voxel_size[axis]

        over_slices(fill, len(x))
        return u


def of_nearest_fluid(values: np.ndarray, solid: np.ndarray, voxel: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Values [z, y, x] of voxels, in solid ones those of the nearest voxel of fluid. voxel: edges (3,) and around: (3,)
    bool, periodic, x, y, z. Beyond a periodic face voxels are seen as far as a smooth wall may be off its labels."""
    widths = [(2, 2) if repeats and n > 1 else (0, 0) for repeats, n in zip(around[::-1], values.shape)]
    wide = np.pad(values, widths, mode="wrap")
    nearest = ndimage.distance_transform_edt(np.pad(solid, widths, mode="wrap"), voxel[::-1], False, True)
    return wide[tuple(nearest)][tuple(slice(low, low + n) for (low, _), n in zip(widths, values.shape))]


@njit(cache=True, nogil=True)
def _put_phases(rows, grid, around, u, phase):
    for k in range(rows[0], rows[1]):
        phase[k] = label_at(grid, around, voxel_of(u[k, 0]), voxel_of(u[k, 1]), voxel_of(u[k, 2]))
