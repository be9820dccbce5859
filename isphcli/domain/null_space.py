"""The null space of a pressure matrix, one constant per connected component, and the projection that takes it out of a
vector (eqs 25-26)."""

from __future__ import annotations

import numpy as np
from numba import njit

from . import reduce
from .row_threads import ROWS, edges_of, over_blocks, over_rows

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
        # a block has a sum of each component: all blocks together not more than there are particles
        self._edges = edges_of(len(labels), max(ROWS, len(self.count)))

    def remove(self, v: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """v without its mean over each component, (n,), in `out` where that is given, which may be v."""
        if len(self.count) == 1:
            return np.subtract(v, reduce.total(v) / self.count[0], out=out)  # eq. 26
        # eq. 26, with one constant vector per component
        sums, out = np.zeros((len(self._edges) - 1, len(self.count))), np.empty(len(v)) if out is None else out
        over_blocks(_sums, self._edges, self.labels, v, sums)
        over_rows(_less, len(v), self.labels, reduce.total(sums) / self.count, v, out)
        return out


@njit(cache=True, nogil=True)
def _sums(blocks, edges, labels, v, sums):
    """Sums (blocks, components) of v over the rows of each block."""
    for block in range(blocks[0], blocks[1]):
        for i in range(edges[block], edges[block + 1]):
            sums[block, labels[i]] += v[i]


@njit(cache=True, nogil=True)
def _less(rows, labels, mean, v, out):
    """v without the mean of the component of each row."""
    for i in range(rows[0], rows[1]):
        out[i] = v[i] - mean[labels[i]]
