"""W-cycles of a matrix that is not stored: its finest level is computed from pairs, the coarser ones are PyAMG's."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.sparse as sp

from .multigrid import SMOOTHING, STRENGTH, add_product, cycle, edges, hierarchy

SLAB = 100_000  # rows of the finest matrix that are there at a time, in the triple product


class SweptMatrix(Protocol):
    """A symmetric matrix that knows its rows (`operators.conductances`)."""

    n: int

    def tocsr(self) -> sp.csr_matrix:
        """All of it."""
        ...

    def rows(self, begin: int, end: int) -> sp.csr_matrix:
        """(end - begin, n) of its rows."""
        ...

    def strong(self, threshold: float) -> sp.csr_matrix:
        """The pattern of the strong connections."""
        ...

    def smoothed(self, aggregate: np.ndarray, size: np.ndarray, threshold: float, omega: float) -> sp.csr_matrix:
        """The prolongation from aggregates, smoothed."""
        ...

    def sweep_from_zero(self, blocks: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(x, b - A x) after a forward sweep."""
        ...

    def sweep_back(self, blocks: np.ndarray, b: np.ndarray, x: np.ndarray) -> None:
        """A backward sweep in place."""
        ...


class PairCycle:
    """One W-cycle of smoothed aggregation from a zero guess, as `multigrid.cycle` of the same matrix; the sweeps of the
    finest level go through blocks of rows, as those of `multigrid.BlockCycle`."""

    def __init__(self, matrix: SweptMatrix):
        from pyamg.aggregation import standard_aggregation

        self.matrix, self.blocks, n = matrix, edges(matrix.n), matrix.n
        members, _ = standard_aggregation(matrix.strong(STRENGTH))
        aggregate = np.full(n, -1, np.int32)
        aggregate[np.diff(members.indptr) > 0] = members.indices
        size = np.bincount(members.indices, minlength=members.shape[1])
        del members
        self.prolongation = matrix.smoothed(aggregate, size, STRENGTH, SMOOTHING)
        del aggregate
        coarse = sp.csr_matrix((len(size), len(size)))
        for begin in range(0, n, SLAB):
            part = slice(begin, min(begin + SLAB, n))
            product = matrix.rows(part.start, part.stop) @ self.prolongation
            coarse = coarse + self.prolongation[part].T.tocsr() @ product
        self.levels, self.restriction = hierarchy(coarse, near_null=np.sqrt(size)), self.prolongation.T.tocsr()
        self.coarse, self._inner = coarse, cycle(self.levels)

    def __call__(self, b: np.ndarray) -> np.ndarray:
        x, rest = self.matrix.sweep_from_zero(self.blocks, b)
        coarse = np.zeros(self.coarse.shape[0])
        add_product(self.restriction, 1.0, rest, coarse)
        y = self._inner(coarse)
        if len(self.levels.levels) > 1:
            add_product(self.coarse, -1.0, y, coarse)
            y += self._inner(coarse)
        add_product(self.prolongation, 1.0, y, x)
        self.matrix.sweep_back(self.blocks, b, x)
        return x
