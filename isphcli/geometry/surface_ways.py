"""Where the smooth surface of an image opens or closes passages, against its labels joined by the faces of voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..domain.components import root
from ..domain.slabs import Slabs
from .connectivity import components_of_slabs, join_slabs
from .spline import SEEN, value_and_slope

# From a voxel to those that share a face with it, then an edge: z, y, x. Of two opposite ways one.
WAYS = np.array([(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 1), (0, 1, -1), (1, 0, 1), (1, 0, -1), (1, 1, 0), (1, -1, 0)])


@dataclass(frozen=True)
class SurfaceWays:
    """The pores as the surface has them, beside those of the labels; axes in the order x, y(, z).

    moved: voxels whose centre is on the other side than their label; opened: edges between two fluid voxels, without
    another fluid voxel beside them, whose middle is fluid; closed: faces between two fluid voxels whose middle is
    solid; parts, percolates: of the surface; label_parts, label_percolates: of the labels by the faces of voxels.
    """

    moved: int
    opened: int
    closed: int
    parts: int
    label_parts: int
    percolates: tuple[bool, ...]
    label_percolates: tuple[bool, ...]

    def described(self) -> str:
        """Half a sentence for `Geometry.described`."""
        return (f"smooth: the centres of {self.moved} voxels lie on the other side than their own values say, pores in "
                f"{_parts(self.parts)} (faces of voxels {self.label_parts}), {self.opened} contacts at edges open, "
                f"{self.closed} at faces shut")

    def warnings(self) -> tuple[str, ...]:
        """Sentences on the axes along which only one of the two leads through."""
        said = []
        for name, found, labels in zip("xyz", self.percolates, self.label_percolates):
            if found != labels:
                what = "leads through, by faces of its voxels it does not" if found else (
                    "does not lead through, by faces of its voxels it does")
                said.append(f"the pores of the image along {name}: their surface {what}; the image does not resolve "
                            "the throats that this hangs on, and k is that of the surface (geometry.wall_distance: "
                            "stairs takes the faces)")
        return tuple(said)


def _parts(n: int) -> str:
    return f"{n} part" + "s" * (n != 1)


def surface_ways(coefficients: np.ndarray, around: np.ndarray, field: np.ndarray, labels: np.ndarray,
                 part: tuple[slice, ...], periodic: tuple[bool, ...], slabs: Slabs | None = None) -> SurfaceWays:
    """SurfaceWays of the spline through a field on voxel centres.

    coefficients, field (> 0 in fluid), labels (-1 solid): [z, y, x]; around: (3,) bool x, y, z of the spline; part: of
    these arrays, the sample without clear layers; periodic: of the sample, (dim,) x, y(, z); slabs: how the processes
    share the arrays, of which each has its layers; without it one process has all.
    """
    slabs = slabs or Slabs.whole(field.shape)
    fluid, sample = slabs.part(field > 0, part)
    solid, _ = slabs.part(labels < 0, part)
    owner, links, opened, closed = _joined_in(coefficients, around, fluid, part, periodic, slabs, sample)
    roots, edges = np.flatnonzero(owner == np.arange(len(owner), dtype=owner.dtype)), links.astype(np.int64)
    edges[:, :2] = np.searchsorted(roots, links[:, :2])
    number = np.full(len(owner) + 1, -1, np.int32)  # of a part by its root; the last one is of solids
    number[roots] = np.arange(len(roots))
    parts = number[owner]
    del owner, number
    of_surface = join_slabs(parts.reshape(-1, *fluid.shape[1:]), len(roots), np.unique(edges, axis=0), sample,
                            periodic)[1]
    of_labels = components_of_slabs(~solid, sample, periodic)[2]
    moved, opened, closed = slabs.ranks.sum(np.array([np.count_nonzero(fluid == solid), opened, closed]))
    through, label_through = (tuple(map(bool, np.ravel(found.any(axis=0)))) for found in (of_surface, of_labels))
    return SurfaceWays(int(moved), int(opened), int(closed), len(of_surface), len(of_labels), through, label_through)


def _joined_in(coefficients: np.ndarray, around: np.ndarray, fluid: np.ndarray, part: tuple[slice, ...],
               periodic: tuple[bool, ...], slabs: Slabs, sample: Slabs) -> tuple[np.ndarray, np.ndarray, int, int]:
    """`_joined` of the own layers of the sample, of which several processes see the layer above too."""
    wraps, start = np.array([*periodic, False][:3]), np.array([s.start for s in part[::-1]])
    if slabs.ranks.size == 1:
        return _joined(coefficients, around, fluid, start, wraps, (len(fluid), False))
    coefficients, first = slabs.beside(coefficients, SEEN, SEEN, bool(around[2]))
    layers, _ = sample.beside(fluid, 0, 1, bool(wraps[2]))
    start[2] += sample.own[0] - first
    seam = bool(wraps[2]) and sample.own[1] == sample.shape[0]
    return _joined(coefficients, np.array([*around[:2], False]), np.ascontiguousarray(layers), start,
                   np.array([*wraps[:2], False]), (len(fluid), seam))


@njit(cache=True)
def _joined(c, around, fluid, first, wraps, own):
    """(root of each voxel (n,), -1 in solids; links across periodic faces (m, 3): upper root, lower root, axis; edges
    that are open; faces that are closed). own: number of layers whose ways are followed, and whether one above them
    lies beyond a periodic face."""
    shape = fluid.shape
    nz, ny, nx = shape
    parent = np.full(nz * ny * nx, -1, np.int32)
    flat = fluid.ravel()
    for i in range(len(parent)):
        if flat[i]:
            parent[i] = i
    links = np.empty((6 * (nz * ny + ny * nx + nz * nx), 3), np.int32)
    count, opened, closed = 0, 0, 0
    q, there = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for z in range(own[0]):
        for y in range(ny):
            for x in range(nx):
                if not fluid[z, y, x]:
                    continue
                for way in WAYS:
                    q[0], q[1], q[2] = z + way[0], y + way[1], x + way[2]
                    crossed, axis, up, inside = 0, 0, True, True
                    for a in range(3):
                        there[a] = q[a]
                        if q[a] < 0 or q[a] >= shape[a]:
                            inside = inside and wraps[2 - a] and shape[a] > 1
                            crossed, axis, up = crossed + 1, 2 - a, q[a] > 0
                            there[a] = q[a] % shape[a]
                    if not inside or not fluid[there[0], there[1], there[2]]:
                        continue
                    face = abs(way[0]) + abs(way[1]) + abs(way[2]) == 1
                    if not face and _beside(fluid, z, y, x, there, way):
                        continue
                    value, _, _, _ = value_and_slope(c, around, first[0] + x + 0.5 + 0.5 * way[2],
                                                     first[1] + y + 0.5 + 0.5 * way[1],
                                                     first[2] + z + 0.5 + 0.5 * way[0])
                    if value <= 0.0:
                        closed += face
                        continue
                    opened += not face
                    here, other = (z * ny + y) * nx + x, (there[0] * ny + there[1]) * nx + there[2]
                    seam = own[1] and q[0] == own[0]
                    if crossed == 0:
                        a, b = root(parent, here), root(parent, other)
                        parent[max(a, b)] = min(a, b)
                    elif crossed == 1 and not seam:  # edges across two periodic faces are few, and are left out
                        links[count, 0], links[count, 1] = (here, other) if up else (other, here)
                        links[count, 2] = axis
                        count += 1
    for i in range(len(parent)):
        if parent[i] >= 0:
            parent[i] = root(parent, i)
    for k in range(count):
        links[k, 0], links[k, 1] = parent[links[k, 0]], parent[links[k, 1]]
    return parent, links[:count], opened, closed


@njit(cache=True)
def _beside(fluid, z, y, x, there, way):
    """Whether one of the two voxels beside a common edge is fluid: it joins the two over faces already."""
    if way[0] == 0:
        return fluid[z, there[1], x] or fluid[z, y, there[2]]
    if way[1] == 0:
        return fluid[there[0], y, x] or fluid[z, y, there[2]]
    return fluid[there[0], y, x] or fluid[z, there[1], x]
