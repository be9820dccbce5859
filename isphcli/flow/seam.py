"""The seam of a periodic loop with a reservoir at either end: fluid that goes over it becomes that of the other one.

A scene that is periodic along an axis needs no open boundary: pressures and velocities go on over the seam, where the
reservoir at the upper end of the box, the outlet, meets that at its lower end, the inlet. Only which fluid a particle
is of does not: what leaves the outlet comes in as the fluid of the inlet, and the reverse. The number of particles
stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TINY = 1e-6  # of the length of the box: a particle on the seam itself is this far from it, so that phi has a sign


def phase_of(phi: np.ndarray) -> np.ndarray:
    """(n,) int8 fluid of particles, 0 or 1, from phi (n,), which is positive in the first fluid."""
    return (phi <= 0.0).astype(np.int8)


@dataclass(frozen=True)
class Seam:
    """axis: 0, 1 or 2; lower, upper: faces of the box along it, m; fluids: of the inlet, at the lower end, and of the
    outlet, 0 or 1 each."""

    axis: int
    lower: float
    upper: float
    fluids: tuple[int, int]

    def crossings(self, ahead: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(n,) int8: 1 of particles that have left the outlet and come into the inlet, -1 of those that went the other
        way, else 0. ahead: (n, dim) m, before they were brought back into the box; x: (n, dim) m, after."""
        length = self.upper - self.lower
        return np.rint((ahead[:, self.axis] - x[:, self.axis]) / length).astype(np.int8)

    def entered(self, ahead: np.ndarray, x: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """phi (n,) m, positive in the first fluid, with those over the seam of the fluid of the reservoir that they
        came into: as far from the other one as they are from the seam. Arguments as those of `crossings`."""
        crossed = self.crossings(ahead, x)
        if not crossed.any():
            return phi
        along = x[:, self.axis]
        inlet, outlet = (1.0 if fluid == 0 else -1.0 for fluid in self.fluids)
        least = TINY * (self.upper - self.lower)
        phi = np.where((crossed > 0) & (inlet * phi <= 0.0), inlet * np.maximum(along - self.lower, least), phi)
        return np.where((crossed < 0) & (outlet * phi <= 0.0), outlet * np.maximum(self.upper - along, least), phi)
