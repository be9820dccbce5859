"""The null space of a pressure matrix, one constant per connected component, and the projection that takes it out of a
vector (eqs 25-26)."""

from __future__ import annotations

import numpy as np

from . import reduce

# Share by which diagonals of a pressure matrix are raised before a hierarchy is built on it. Pressure is determined up
# to a constant in each component: in a pocket smaller than an aggregate, and on the coarsest level, that constant is
# the only unknown of a coarse matrix, and the hierarchy would divide by round-off.
GROUND = 1e-6


class ComponentMeans:
    """The projection P of eq. 26 for one constant vector per connected component.

    labels: (n,) component of each particle, numbered over all processes; count: of the components, where it is known.
    """

    def __init__(self, labels: np.ndarray, count: int = 0):
        self.labels = labels
        self.count = reduce.total_by(labels, labels=count)

    def remove(self, v: np.ndarray) -> np.ndarray:
        """v without its mean over each component, (n,)."""
        if len(self.count) == 1:
            return v - reduce.total(v) / self.count[0]  # eq. 26
        # eq. 26, with one constant vector per component
        mean = (reduce.total_by(self.labels, v, len(self.count)) / self.count).take(self.labels)
        return np.subtract(v, mean, out=mean)
