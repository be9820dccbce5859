"""W-cycles of a matrix that is not stored: its finest level is computed from pairs, the coarser ones are PyAMG's."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.sparse as sp

from ..domain.row_threads import ROWS, edges_of, over_parts
from .aggregation import SMOOTHING, aggregates
from .multigrid import STRENGTH, add_product, by_kernels, cycle, hierarchy, single

# Threshold of aggregation below the finest level: smaller aggregates, of some 17 rows for 22. Iterations of Berea 128^3
# (with a V-cycle of the velocity): 40 with STRENGTH, 36 with 0.035 and 0.05; with 0.1 it does not converge, few
# rows being connected
COARSE_STRENGTH = 0.035

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
        self.matrix, self.blocks, n = matrix, edges_of(matrix.n, ROWS), matrix.n
        aggregate, count = aggregates(matrix.strong(STRENGTH))
        size = np.bincount(aggregate[aggregate >= 0], minlength=count)
        self.prolongation = matrix.smoothed(aggregate, size, STRENGTH, SMOOTHING)
        del aggregate
        coarse = sp.csr_matrix((count, count))
        for part in over_parts(self._coarse_part, [(begin, min(begin + SLAB, n)) for begin in range(0, n, SLAB)]):
            coarse = coarse + part
        self.levels = hierarchy(coarse, COARSE_STRENGTH, np.sqrt(size))
        del coarse
        # entries alone: cycles of vectors in single precision would be no linear maps; PyAMG's sweeps take one type
        if by_kernels(self.levels):
            for level in self.levels.levels[:-1]:
                level.A, level.P, level.R = single(level.A), single(level.P), single(level.R)
        self.prolongation = single(self.prolongation)
        self.restriction = self.prolongation.T.tocsr()
        self._coarse, self._inner = self.levels.levels[0].A, cycle(self.levels)

    def _coarse_part(self, rows: tuple[int, int]) -> sp.csr_matrix:
        """What some rows of the finest matrix add to the coarse one."""
        product = self.matrix.rows(*rows) @ self.prolongation
        return self.prolongation[rows[0] : rows[1]].T.tocsr() @ product

    def __call__(self, b: np.ndarray) -> np.ndarray:
        x, rest = self.matrix.sweep_from_zero(self.blocks, b)
        coarse = np.zeros(self._coarse.shape[0])
        add_product(self.restriction, 1.0, rest, coarse)
        y = self._inner(coarse)
        if len(self.levels.levels) > 1:
            add_product(self._coarse, -1.0, y, coarse)
            y += self._inner(coarse)
        add_product(self.prolongation, 1.0, y, x)
        self.matrix.sweep_back(self.blocks, b, x)
        return x
