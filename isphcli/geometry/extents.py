"""What part of a particle, or of a cell, lies within the sample or a section of it.

Particles and cells are points with a volume, and an extent along each axis: the distance of the layers of their
lattice. Counted as their middles lie, those in a length L are a whole number of layers, and a flux or a volume is off
by up to a layer of those in L. Counted by the part of their extent that lies within, they have the length L wherever
its ends are: extents of the layers of a lattice are next to each other. Particles that move keep their extent: where
they have lost their lattice the mean is the same, and what is counted changes without jumps as they pass an end.
"""

from __future__ import annotations

import math

import numpy as np

from .protocol import Geometry, sample_box

POINTS = 4  # along each axis of a piece of a cell, at which fluid is looked for


def part_between(along: np.ndarray, thick: np.ndarray | float, lower: float, upper: float) -> np.ndarray:
    """(n,) parts, 0 to 1, of the extents that lie between lower and upper; along: (n,) their middles, thick: (n,) or
    one, in the same unit. Rounded, so that an end between two layers cuts neither."""
    within = np.minimum(along + 0.5 * thick, upper) - np.maximum(along - 0.5 * thick, lower)
    return np.asarray(np.clip(np.round(within / thick, 9), 0.0, 1.0))


def _ends(geometry: Geometry) -> np.ndarray:
    """Axes, int, along which the sample ends within the box."""
    lower, upper = sample_box(geometry)
    return np.flatnonzero((lower > geometry.lower) | (upper < geometry.upper))


def part_of_sample(geometry: Geometry, x: np.ndarray, thick: np.ndarray) -> np.ndarray:
    """(n,) parts, 0 to 1, of particles or cells x (n, dim), m, that lie within the sample; thick: (dim,) or (n, dim) m,
    their extents. Ends cut them where clear layers lie beyond. At the faces of the box those whose middles lie within
    count whole: a period has both of their parts.

    A flux is the same through every section: of a flow the mean over such parts has no error by where walls lie at an
    end. A volume of fluid has: see `fluid_part_of_sample`."""
    lower, upper = sample_box(geometry)
    part = np.all((x >= geometry.lower) & (x <= geometry.upper), axis=1).astype(float)
    edges = np.broadcast_to(thick, x.shape)
    for axis in _ends(geometry):
        part *= part_between(x[:, axis], edges[:, axis], lower[axis], upper[axis])
    return part


def fluid_part_of_sample(geometry: Geometry, x: np.ndarray, thick: np.ndarray, points: int = 1) -> np.ndarray:
    """(n,) parts, 0 to 1, of the fluid in cells x (n, dim), m, that lies within the sample; thick: (dim,) m.

    Rock that is cut off flat has its face at the end of the sample: of a cell in front of it all fluid lies beyond. In
    cells that an end cuts, fluid is looked for at `points` along each axis of both pieces; by one it is in a piece of a
    particle or not. Cells whose middles lie beyond a wall at the face of the box count whole, other than in
    `part_of_sample`."""
    lower, upper = sample_box(geometry)
    whole = np.ones(len(x))
    grid = (np.stack(np.meshgrid(*[np.arange(points)] * geometry.dim, indexing="ij"), axis=-1) + 0.5) / points - 0.5
    for axis in _ends(geometry):
        part = part_between(x[:, axis], thick[axis], lower[axis], upper[axis])
        cut = np.flatnonzero((part > 0.0) & (part < 1.0)) if geometry.has_solid else np.zeros(0, int)
        if points > 1 and len(cut):  # no wall near, no need to look
            cut = cut[np.abs(geometry.distance(x[cut])) < 0.5 * np.linalg.norm(thick)]
        at, inner, low = x[cut, axis], part[cut], x[cut, axis] - 0.5 * thick[axis] < lower[axis]
        ends = at + np.where(low, -0.5, 0.5) * thick[axis], at + np.where(low, 0.5, -0.5) * thick[axis]
        fluid = []
        for end, sign, share in ((ends[0], 1.0, 1.0 - inner), (ends[1], -1.0, inner)):
            edges = np.tile(thick, (len(cut), 1))
            edges[:, axis] *= share
            middle = x[cut]
            middle[:, axis] = end + np.where(low, sign, -sign) * 0.5 * edges[:, axis]
            sought = middle[:, None] + grid.reshape(-1, geometry.dim) * edges[:, None]
            there = geometry.phase(sought.reshape(-1, geometry.dim)) >= 0
            fluid.append(share * there.reshape(len(cut), points**geometry.dim).mean(axis=1))
        beyond, within = fluid
        part[cut] = np.divide(within, within + beyond, out=inner.copy(), where=within + beyond > 0.0)
        whole *= part
    return whole


def sections(along: np.ndarray, thick: np.ndarray | float, ends: tuple[float, float], count: int,
             periodic: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(section (m,), particle (m,), part (m,)): the parts, above 0, of the extents in the `count` equal sections
    between two ends. along: (n,) m, middles; thick: (n,) or one, m; periodic: what lies beyond one end is at the other
    one, otherwise in the section next to it."""
    lower, edge = ends[0], (ends[1] - ends[0]) / count
    first = np.floor((along - 0.5 * thick - lower) / edge)
    found = []
    for k in range(math.ceil(float(np.max(thick)) / edge) + 1):
        part = part_between(along - lower - (first + k) * edge, thick, 0.0, edge)
        who = np.flatnonzero(part > 0.0)
        section = (first[who] + k).astype(int)
        found.append((section % count if periodic else np.clip(section, 0, count - 1), who, part[who]))
    section, who, part = (np.concatenate(values) for values in zip(*found))
    return section, who, part
