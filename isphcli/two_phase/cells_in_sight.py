"""Which particles a cell of the grid sees: walls thinner than the reach of a cell part fluids that never meet.

`cut_cells` asks the particles round a cell, on whichever side of a wall. With two fluids on the two sides of a plate
the cell would be cut by an interface that is not there, and parts that do not touch would have an area between them and
feed each other (`kept_volumes`). A cell that has both fluids round it is therefore made of the particles that it sees,
as operators are: from its middle or, where that is solid, from the point of its fluid that is nearest to it. A cell
that sees none of them is made of all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..domain.halo import wrap

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry

SAMPLES = 4  # along each side of a cell: points of it that it may look from


class SeenBy(NamedTuple):
    """Particles round some cells. cells: (k,) which; cell: (m,) of each pair, particle: (m,), offset: (m, dim) of the
    middle of the cell from the particle, m."""

    cells: np.ndarray
    cell: np.ndarray
    particle: np.ndarray
    offset: np.ndarray


class CellSight:
    """geometry: Geometry; middle: (n_cells, dim) of the cells, m; side: (dim,) of a cell, m."""

    def __init__(self, geometry: Geometry, middle: np.ndarray, side: np.ndarray):
        dim = geometry.dim
        self.geometry, self.middle, point = geometry, middle, middle.copy()
        blind = np.flatnonzero(geometry.phase(point) < 0)
        steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        offsets = np.stack(np.meshgrid(*[steps] * dim, indexing="ij"), axis=-1).reshape(-1, dim) * side
        for offset in offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]:  # the nearest first
            found = geometry.phase(middle[blind] + offset) >= 0
            point[blind[found]] += offset
            blind = blind[~found]
        # deep in solids, where no fluid was found, no ball is free
        self.point, self.clear = point, geometry.distance(point, 0.0)
        self.aside = np.sqrt(((point - middle) ** 2).sum(axis=1))

    def seen(self, x: np.ndarray, asked: np.ndarray, reach: float, distance: np.ndarray) -> SeenBy:
        """What those of the cells `asked` (k,) see that have particles within reach, m, behind walls, and some that are
        not. x: (n, dim) m, in the box; distance: (n,) of these to the walls, m."""
        geometry, middle = self.geometry, self.middle
        asked = asked[self.clear[asked] < reach + self.aside[asked]]  # else a ball of fluid holds all in reach
        size = geometry.upper - geometry.lower
        box = np.where(geometry.periodic, size, 0.0)
        tree = cKDTree(wrap(x, geometry.lower, geometry.upper, geometry.periodic) - geometry.lower, boxsize=box)
        pairs = cKDTree(middle[asked] - geometry.lower, boxsize=box).sparse_distance_matrix(tree, reach,
                                                                                           output_type="ndarray")
        pairs = pairs[np.lexsort((pairs["j"], pairs["i"]))]  # those of a cell lie together
        cell, particle = asked[pairs["i"]], pairs["j"]
        offset = middle[cell] - x[particle]
        offset -= box * np.round(offset / size)
        point, there = self.point[cell], middle[cell] - offset
        free = np.maximum(distance[particle] + self.clear[cell], 0.0)  # two balls of fluid that cover the way
        ask = np.flatnonzero(free**2 < ((point - there) ** 2).sum(axis=1))
        seen = np.ones(len(cell), np.bool_)
        seen[ask] = geometry.crossing(point[ask], there[ask]) >= 1.0
        total, left = (np.bincount(cell[some], minlength=len(middle)) for some in (slice(None), seen))
        cells = np.flatnonzero((left < total) & (left > 0))
        keep = seen & ((left < total) & (left > 0))[cell]
        return SeenBy(cells, cell[keep], particle[keep], offset[keep])
