"""How wide pores are, by the sites of the lattice: nothing is solved and no neighbours are searched."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from ..geometry.connectivity import Connectivity, components, connectivity_of, percolating
from ..geometry.pore_sizes import ENOUGH_ACROSS
from .check_result import Throats

if TYPE_CHECKING:
    from ..domain.lattice import Lattice
    from ..geometry.protocol import Geometry


LINE_POINTS = 20_000  # points of the centre lines whose width is found exactly
# Sites round a point by which a centre line is detected: beside a nook of a wall, a site wide and deep, the next sites
# are 0.2 spacings farther off the walls than it, and those two away 1.1
NOOK = 2
STEP = 0.2  # spacings: sites whose width exceeds that of the path through by less are refined between sites too
WITHIN = 0.02  # spacings: tolerance of the width of the path through
TINY = 1e-6
ON_WALL = 1e-9  # of the support: a site this close to a wall is solid, as for `Geometry.phase`


class Sites:
    """Phase and wall distance of every site of a lattice, [x, y(, z), site of the cell].

    sample: the part of the box that is no clear layer, as slices of the cells; around: which axes of that
    part are periodic.
    """

    def __init__(self, lattice: Lattice, geometry: Geometry, support: float, one_fluid: bool = False):
        shape = (*(int(n) for n in lattice.counts), len(lattice.basis))
        phase = np.empty(shape, dtype=np.int8)
        distance = np.full(shape, np.inf, dtype=np.float32)
        by_distance = geometry.has_solid and one_fluid and geometry.labels is None
        flat_phase, flat_distance, first = phase.reshape(-1), distance.reshape(-1), 0
        for x in lattice.slabs():
            part = slice(first, first + len(x))
            if geometry.has_solid:
                flat_distance[part] = d = geometry.distance(x, 1.01 * support)
            # a distance among thousands of spheres costs a microsecond: with one fluid it tells the phase too
            flat_phase[part] = np.where(d > ON_WALL * support, 0, -1) if by_distance else geometry.phase(x)
            first += len(x)
        self.lattice, self.phase, self.distance = lattice, phase, distance
        lower, upper = geometry.sample_lower, geometry.sample_upper
        self.sample = _cells_between(lattice, lower, upper)
        whole = (np.asarray(lower) <= geometry.lower) & (np.asarray(upper) >= geometry.upper)
        self.around = tuple(bool(p and w) for p, w in zip(geometry.periodic, whole))
        fluid = phase >= 0
        seen = ~fluid & (distance > -support * (1 + 1e-6))
        count = int(fluid.sum())
        dummies = int(seen.sum()) if geometry.has_solid else 0
        self.particles = {"fluid": count, "dummy": dummies, "left_out": phase.size - count - dummies}
        self.per_fluid = np.bincount(phase[fluid], minlength=1) if count else np.zeros(1, dtype=int)

    def fluid(self, k: int = 0) -> np.ndarray:
        """Mask of the fluid in the sample on site k of the cells, [x, y(, z)]."""
        return self.phase[self.sample][..., k] >= 0

    def connectivity(self, open_axes: Sequence[int], through: Sequence[int] | None = None) -> Connectivity:
        """Of the sample, see `connectivity_of`; of lattices with two sites per cell, that of the better connected
        one."""
        volume = float(self.lattice.cell.prod())
        found = [connectivity_of(self.fluid(k).T, self.around, volume, open_axes, through)
                 for k in range(self.phase.shape[-1])]
        return max(found, key=lambda c: (sum(c.percolates), c.largest_share))

    def smaller_body(self) -> float:
        """Largest distance, in cells, of a site of the minority fluid from the end of that fluid; 0 of one fluid."""
        there = np.flatnonzero(self.per_fluid)
        if len(there) < 2:
            return 0.0
        least = there[np.argmin(self.per_fluid[there])]
        return float(ndimage.distance_transform_edt(self.phase[..., 0] == least).max())

    def leads_over_edges(self, axis: int) -> bool:
        """Whether fluid sites that touch in a face, an edge or a corner lead from end to end of the sample along an
        axis; ways that leave it through a side are not seen."""
        for k in range(self.phase.shape[-1]):
            fluid = self.fluid(k)
            labels = ndimage.label(fluid, structure=np.ones((3,) * fluid.ndim))[0]
            first, last = labels.take(0, axis=axis), labels.take(-1, axis=axis)
            if np.intersect1d(first[first > 0], last).size:
                return True
        return False

    def microporous(self, geometry: Geometry, rocks: int) -> np.ndarray:
        """Shares (rocks,) of the sites of the sample that lie in each microporous rock."""
        fluid = np.zeros(self.phase.shape, dtype=bool)
        fluid[self.sample] = self.phase[self.sample] >= 0
        counts, first, flat = np.zeros(rocks + 1, dtype=int), 0, fluid.reshape(-1)
        for x in self.lattice.slabs():
            counts += np.bincount(geometry.microporous(x[flat[first : first + len(x)]]) + 1, minlength=rocks + 1)
            first += len(x)
        return counts[1:] / self.phase[self.sample].size

    def points(self, most: int) -> np.ndarray:
        """Positions of some fluid sites, at most `most`, spread evenly; (n, dim)."""
        flat = np.flatnonzero(self.phase >= 0)
        return self.positions(flat[:: -(-len(flat) // most)])

    def positions(self, flat: np.ndarray) -> np.ndarray:
        """Positions (n, dim) of sites by their flat number."""
        *cell, k = np.unravel_index(flat, self.phase.shape)
        return self.lattice.corner + (np.stack(cell, axis=1) + self.lattice.basis[k]) * self.lattice.cell


def _cells_between(lattice: Lattice, lower: np.ndarray, upper: np.ndarray) -> tuple[slice, ...]:
    """Cells whose middle lies between two corners."""
    middle = [c + (np.arange(n) + 0.5) * h for c, n, h in zip(lattice.corner, lattice.counts, lattice.cell)]
    ends = [np.searchsorted(m, (a, b)) for m, a, b in zip(middle, lower, upper)]
    return tuple(slice(int(first), max(int(end), int(first) + 1)) for first, end in ends)


def throats(sites: Sites, geometry: Geometry, spacing: float, axes: Sequence[int]) -> Throats | None:
    """Widths of the pores in spacings; `axes`: those for which the critical width is wanted.

    A site is on a centre line if no site up to NOOK sites away is farther from the walls by more than half of the way
    there: off a centre line the distance grows by all of that way. The next sites alone are not enough: in a nook of a
    wall, as between the steps of stairs, the distance grows by little over the first spacing. The width is twice the
    largest distance there and half a spacing around, because the centre may lie between sites. Each point has the
    weight of its width: rough walls have many nooks, and little fluid in them. Ends without walls are no pores.
    """
    distance = sites.distance[..., 0]
    fluid = sites.phase[..., 0] >= 0
    modes = ["wrap" if p else "nearest" for p in geometry.periodic]
    line = np.zeros(sites.phase.shape, dtype=bool)
    line[..., 0] = fluid & _in(sites.sample, fluid.shape) & ~_beside_no_wall(fluid, sites.lattice.cell, geometry)
    for way in range(1, NOOK + 1):
        near = ndimage.maximum_filter(distance, size=2 * way + 1, mode=modes)
        line[..., 0] &= near - distance < 0.5 * way * spacing
    flat = np.flatnonzero(line)
    if not len(flat):
        return None
    width = _widths(sites.positions(flat[:: -(-len(flat) // LINE_POINTS)]), geometry, spacing)
    width.sort()
    share = np.cumsum(width) / width.sum()
    narrow, median = width[np.searchsorted(share, (0.1, 0.5))]
    thin = float(width[width < ENOUGH_ACROSS - TINY].sum() / width.sum())
    critical = {axis: _critical(sites, geometry, axis, spacing) for axis in axes if geometry.periodic[axis]}
    return Throats(float(narrow), float(median), thin, critical)


def _beside_no_wall(fluid: np.ndarray, cell: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Mask of the layers across an axis without any solid that are thicker than the box is wide, where that repeats:
    what a case leaves before and behind its pores. fluid: [x, y(, z)]; cell: (dim,) m."""
    found = np.zeros(fluid.shape, dtype=bool)
    for axis in range(fluid.ndim):
        others = tuple(a for a in range(fluid.ndim) if a != axis)
        clear = np.asarray(fluid.all(axis=others))
        # walls close faces, and there are no sites in them; a layer of solid alone is a side of a channel
        if clear.all() or not all(geometry.periodic) or not fluid.any(axis=others).all():
            continue
        start = int(np.argmin(clear))  # a layer with solid: what is clear goes on over the ends of the box
        steps = np.diff(np.roll(clear, -start).astype(int), append=0)
        width = max(cell[a] * fluid.shape[a] for a in others)
        for first, end in zip(np.flatnonzero(steps == 1) + 1, np.flatnonzero(steps == -1) + 1):
            if (end - first) * cell[axis] > width:
                found[(slice(None),) * axis + ((np.arange(first, end) + start) % len(clear),)] = True
    return found


def _in(part: tuple[slice, ...], shape: tuple[int, ...]) -> np.ndarray:
    mask = np.zeros(shape, dtype=bool)
    mask[part] = True
    return mask


def _widths(x: np.ndarray, geometry: Geometry, spacing: float) -> np.ndarray:
    """Twice the largest wall distance within half a spacing of each point, in spacings; x: (n, dim) m."""
    offsets, found = _around(x, geometry, spacing)
    best = found.argmax(axis=0)
    return _not_beyond(x + offsets[best], found.max(axis=0), geometry, spacing)


def _passages(x: np.ndarray, geometry: Geometry, spacing: float) -> np.ndarray:
    """Diameter of the largest ball that passes by each point along an axis, in spacings; x: (n, dim) m.

    Its centre goes from half a spacing before the point to half a spacing behind it, and beside it by as much to where
    there is most room: the least of three planes, in each the largest distance, along the best of the axes.
    """
    offsets, found = _around(x, geometry, spacing)
    dim, points = x.shape[1], np.arange(len(x))
    largest, centre = np.full(len(x), -np.inf), np.zeros(len(x), dtype=int)
    for axis in range(dim):
        planes = [np.flatnonzero(offsets[:, axis] == step) for step in np.unique(offsets[:, axis])]
        best = np.stack([plane[found[plane].argmax(axis=0)] for plane in planes])
        there = best[found[best, points].argmin(axis=0), points]
        more = found[there, points] > largest
        largest[more], centre[more] = found[there, points][more], there[more]
    return _not_beyond(x + offsets[centre], largest, geometry, spacing)


def _around(x: np.ndarray, geometry: Geometry, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (3^dim, dim) m of half a spacing, and the wall distance (3^dim, n) m of the points moved by each."""
    offsets = 0.5 * spacing * _directions(x.shape[1])
    return offsets, np.stack([geometry.distance(x + offset) for offset in offsets])


def _directions(dim: int) -> np.ndarray:
    """(3^dim, dim) steps of the lattice to what is next to a site, and to itself."""
    return np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * dim)).reshape(dim, -1).T


def _not_beyond(x: np.ndarray, distance: np.ndarray, geometry: Geometry, spacing: float) -> np.ndarray:
    """Widths (n,) of balls round points x (n, dim), in spacings, by their wall distance (n,), m.

    The distance from walls of an image is known to a voxel far from them, and well at them: it is at most what a point
    as far away, in any of the directions of the lattice, has more or less. That from shapes is exact."""
    far = np.maximum(distance, 0.0)
    if geometry.voxel_size is None:
        return 2 * far / spacing
    for direction in _directions(x.shape[1]):
        if direction.any():
            wall = geometry.distance(x + far[:, None] * (direction / np.linalg.norm(direction)))
            distance = np.minimum(distance, wall + far)
    return 2 * np.maximum(distance, 0.0) / spacing


def _critical(sites: Sites, geometry: Geometry, axis: int, spacing: float) -> float:
    """Diameter of the largest ball that passes along the axis, in spacings.

    By the sites alone it comes out up to a spacing too small, because the middle of a throat lies between them. The
    sites that determine it have widths just above it: they are refined between sites too (`_passages`), until the path
    depends on none that has not been refined.
    """
    phase, distance = sites.phase[sites.sample][..., 0], sites.distance[sites.sample][..., 0]
    widths = np.where(phase >= 0, 2 * distance / spacing, 0.0)
    first = np.array([part.start for part in sites.sample])
    known, width = np.zeros(widths.shape, dtype=bool), 0.0
    while True:
        width = _passing(widths, sites.around, axis, width)
        through = percolating(((widths >= width) & (widths > 0.0)).T, sites.around, axis).T
        near = np.argwhere(through & (widths < width + STEP) & ~known)
        if not len(near):
            return width
        for part in np.array_split(near, -(-len(near) // LINE_POINTS)):
            flat = np.ravel_multi_index((*(part + first).T, np.zeros(len(part), dtype=int)), sites.phase.shape)
            widths[tuple(part.T)] = _passages(sites.positions(flat), geometry, spacing)
        known[tuple(near.T)] = True


def _passing(widths: np.ndarray, around: tuple[bool, ...], axis: int, before: float) -> float:
    """Largest width, to WITHIN, whose sites lead through along the axis; widths: [x, y(, z)], 0 in solids; before: one
    that it is probably near."""
    others = tuple(a for a in range(widths.ndim) if a != axis)
    most = float(widths.max(axis=others).min())  # every way leads through every layer

    turned = np.ascontiguousarray(widths.T)

    def leads(width: float) -> bool:
        return width <= most and bool(components(turned >= width, around)[2][:, axis].any())

    low, high, step = 0.0, float(widths.max()), 2 * WITHIN
    if before > 0.0 and leads(before):
        low = before
        while low + step < high and leads(low + step):
            low, step = low + step, 2 * step
        high = min(high, low + step)
    while high - low > WITHIN:
        middle = (low + high) / 2
        low, high = (middle, high) if leads(middle) else (low, middle)
    return low
