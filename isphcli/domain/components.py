"""Connected components of the fluid, and the projection that takes the mean of each out of a vector (eqs 25-26)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from . import reduce


class ComponentMeans:
    """The projection P of eq. 26 for one constant vector a connected component.

    labels: (n,) component of each particle.
    """

    def __init__(self, labels: np.ndarray):
        self.labels = labels
        self.count = reduce.total_by(labels)

    def remove(self, v: np.ndarray) -> np.ndarray:
        """v without its mean over each component, (n,)."""
        if len(self.count) == 1:
            return v - reduce.mean(v)  # eq. 26
        # eq. 26, with one constant vector a component
        return v - (reduce.total_by(self.labels, v, len(self.count)) / self.count)[self.labels]


def pair_components(start: np.ndarray, column: np.ndarray,
                    joined: np.ndarray | None = None) -> tuple[int, np.ndarray]:
    """Connected components of the pair graph: (count, labels (n,) int32). joined: (n_pairs,) bool, pairs that count."""
    n = len(start) - 1
    if joined is not None:
        start, column = np.concatenate([[0], np.cumsum(joined)])[start], column[joined]
    graph = sp.csr_matrix((np.ones(len(column), dtype=np.int8), column, start), shape=(n, n))
    return sp.csgraph.connected_components(graph, directed=False)
