"""The seam of a periodic loop with a reservoir at either end: fluid that goes over it becomes that of the other one.

A scene that is periodic along an axis needs no open boundary: pressures and velocities go on over the seam, where the
reservoir at the upper end of the box, the outlet, meets that at its lower end, the inlet. Only which fluid a particle
is of does not: near the seam all are of the fluid of their reservoir. What leaves the outlet comes in as the fluid of
the inlet, and the reverse; a bubble that comes to the end of the outlet is gone; the interface at the seam is a plane,
without capillary pressure. The number of particles stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..domain import reduce
from .held_velocity import Beyond

TINY = 1e-6  # of the depth of the seam: a particle on the seam itself is this far from it, so that phi has a sign


@dataclass(frozen=True)
class Seam:
    """axis: 0, 1 or 2; lower, upper: faces of the box along it, m; depth: up to which a reservoir is of its own fluid
    whatever comes there, m; fluids: of the inlet, at the lower end, and of the outlet, 0 or 1 each; reservoirs: where
    they are; area: of the box across the axis, m^(dim - 1)."""

    axis: int
    lower: float
    upper: float
    depth: float
    fluids: tuple[int, int]
    reservoirs: Beyond
    area: float

    def entered(self, x: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """phi (n,) m, the signed distance to the interface, positive in the first fluid, of particles that have moved
        to x (n, dim), m, in the box: within `depth` of the seam it is that to the seam."""
        for fluid, behind in zip(self.fluids, (x[:, self.axis] - self.lower, self.upper - x[:, self.axis])):
            side = 1.0 if fluid == 0 else -1.0
            phi = np.where(behind < self.depth, side * np.maximum(behind, TINY * self.depth), phi)
        return phi

    def flows(self, x: np.ndarray, way: np.ndarray) -> float:
        """Volume that flows over the seam in a step, m^dim: as much as through every section of the reservoirs, where
        the velocity is known better than between menisci, and is what a held velocity holds.

        x: (n, dim) before the step, m; way: (n,) by which the velocity moves the particles along the axis, m, without
        their shifts, which move the points only."""
        return self.area * self.reservoirs.flux(x, way)

    def let_in(self, x: np.ndarray, flows: float, changed: np.ndarray, volume: np.ndarray) -> np.ndarray:
        """`State.volume` (n,), m^dim, with what flows over the seam in a step: the inlet's fluid has more of it, that
        of the outlet less. Particles cross the seam a row at a time, and a flow does not: the shares of those that have
        just crossed are taken off `flows`, and what is left is spread over all particles at the seam.

        x: (n, dim) after the step, in the box, m; flows: m^dim, of `flows`; changed: (n,) bool, which have come into
        the other fluid at the seam; volume: (n,) before.
        """
        inlet, outlet = x[:, self.axis] - self.lower < self.depth, self.upper - x[:, self.axis] < self.depth
        if not (reduce.any_true(inlet) and reduce.any_true(outlet)):
            return volume
        told = changed * (inlet.astype(float) - outlet)
        more = flows - reduce.dot(volume, told)
        return volume + more * (inlet / reduce.count(inlet) - outlet / reduce.count(outlet))
