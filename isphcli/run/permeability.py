"""Permeability of a flow by Darcy's law (eq. 28), and its limit over several spacings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.protocol import Geometry, sample_box

if TYPE_CHECKING:
    from ..domain.lattice import Particles


def fluid_cells(geometry: Geometry, particles: Particles, whole: bool = False) -> float:
    """Volume of the fluid in the sample, or of the whole box, over that of a cell of the lattice, by the wall distance.

    A cell of edge h whose middle lies at the distance d of a wall holds fluid in the share 1/2 + d/h of it, between 0
    and 1: exact beside walls along the lattice, and over the many ways in which an oblique wall cuts cells the mean is
    right too. To count cells by their middles leaves out 12 % of a pipe four spacings across.
    """
    x = particles.x
    if not geometry.has_solid:
        return float(particles.n_fluid)
    lower, upper = (geometry.lower, geometry.upper) if whole else sample_box(geometry)
    # a face of the box that is a wall cuts cells whose middles lie beyond it; the end of a clear layer does not
    ends = (lower > geometry.lower) | (upper < geometry.upper)
    inside = np.all(((x >= lower) & (x <= upper)) | ~ends, axis=1)
    edge = particles.site_volume ** (1.0 / geometry.dim)
    return float(np.clip(0.5 + geometry.distance(x[inside]) / edge, 0.0, 1.0).sum())


def darcy(geometry: Geometry, x: np.ndarray, velocity: np.ndarray, site_volume: float, axis: int | None = None,
          force: np.ndarray | None = None, viscosity: float | None = None,
          cells: float | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Superficial and mean velocity (dim,) of the sample, and its permeability.

    x, velocity: (n, dim) of the fluid particles; axis: of the drive or None; force: (dim,) m/s2, and
    viscosity: kinematic, m2/s, of a drive. cells: `fluid_cells` of the sample, which the mean velocity is taken over:
    the flux over the volume of the fluid. Without it: over the particles.
    permeability: (dim,) m2, entry `axis` along the drive, the others across it; None without a drive. The force acts on
    the whole length of the box, the sample resists on its own length: k = nu U L_sample / (g L_box).
    """
    lower, upper = sample_box(geometry)
    inside = np.all((x >= lower) & (x <= upper), axis=1)
    total = velocity[inside].sum(axis=0)
    superficial = total * (site_volume / np.prod(upper - lower))
    mean = total / (cells or max(int(inside.sum()), 1))
    if axis is None:
        return superficial, mean, None
    assert force is not None and viscosity is not None
    size = np.linalg.norm(force)
    gravity = size * (geometry.upper - geometry.lower)[axis] / (upper - lower)[axis]
    permeability = viscosity / gravity * superficial * np.sign(force[axis])
    permeability[axis] = viscosity / gravity * float(superficial @ force) / size  # eq. 28
    return superficial, mean, permeability


ORDERS = (0.5, 4.0)  # outside them an observed order tells of no trend: first to second order schemes, and round-off
SMOOTH = (1.0, 2.0)  # order of k beside smooth walls: that of the wall's position on the lattice, that of the operators
# Order of k beside the edges of cubes, solid of 90 degrees: twice the exponent of the velocity at the edge (the error of
# k is that of the dissipation), across the edge 0.5445 (Dean and Montagnon 1949), along it 2/3 (Laplace)
EDGE = (1.089, 4 / 3)


def extrapolate(spacings: Sequence[float] | np.ndarray, values: Sequence[float] | np.ndarray,
                known: tuple[float, float] | None = None) -> tuple[float, float, float | None, str]:
    """Richardson extrapolation of values (m,) at spacings (m,): (value, error bar, order or None, sentence)."""
    return 0.0, 0.0, None, ""
