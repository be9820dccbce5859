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

from ..domain.halo import nearest_image, wrap

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry

VIEWPOINTS = 4  # along each side of a cell: points of it that it may look from


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
        steps = (np.arange(VIEWPOINTS) + 0.5) / VIEWPOINTS - 0.5
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
        # balls of fluid round a point of a cell and round a particle hide nothing between them
        asked = asked[self.clear[asked] < reach + self.aside[asked]]
        near = np.flatnonzero(distance < reach + self.aside.max(initial=0.0))
        cell, particle, away = self._around(x, asked, near, reach)
        may = distance[particle] + self.clear[cell] < away + self.aside[cell]
        cell, particle = cell[may], particle[may]
        cells = np.unique(cell[self._hidden(cell, particle, self._offset(x, cell, particle), distance)])
        cell, particle, _ = self._around(x, cells, np.arange(len(x)), reach)
        order = np.lexsort((particle, cell))  # those of a cell lie together
        cell, particle = cell[order], particle[order]
        offset = self._offset(x, cell, particle)
        seen = ~self._hidden(cell, particle, offset, distance)
        cell, particle = cell[seen], particle[seen]
        return SeenBy(np.unique(cell), cell, particle, offset[seen])

    def _around(self, x: np.ndarray, cells: np.ndarray, particles: np.ndarray,
                reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(cell, particle, distance of the particle from the middle of the cell, m) of all pairs within reach."""
        geometry = self.geometry
        box = np.where(geometry.periodic, geometry.upper - geometry.lower, 0.0)
        if len(cells) == 0:
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        there = wrap(x[particles], geometry.lower, geometry.upper, geometry.periodic) - geometry.lower
        trees = [cKDTree(points, boxsize=box) for points in (self.middle[cells] - geometry.lower, there)]
        pairs = trees[0].sparse_distance_matrix(trees[1], reach, output_type="ndarray")
        return cells[pairs["i"]], particles[pairs["j"]], pairs["v"]

    def _offset(self, x: np.ndarray, cell: np.ndarray, particle: np.ndarray) -> np.ndarray:
        """(m, dim) of the middles of cells from particles, m."""
        geometry = self.geometry
        return nearest_image(self.middle[cell] - x[particle], geometry.upper - geometry.lower, geometry.periodic)

    def _hidden(self, cell: np.ndarray, particle: np.ndarray, offset: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """(m,) bool, whether a wall is between the point of a cell and a particle."""
        point, there = self.point[cell], self.middle[cell] - offset
        free = np.maximum(distance[particle] + self.clear[cell], 0.0)  # two balls of fluid that cover the way
        ask = np.flatnonzero(free**2 < ((point - there) ** 2).sum(axis=1))
        hidden = np.zeros(len(cell), np.bool_)
        hidden[ask] = self.geometry.crossing(point[ask], there[ask]) < 1.0
        return hidden
