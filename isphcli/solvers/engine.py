"""What solves the linear systems of steady flow: PyAMG and SciPy for one process, PETSc for any number.

Both precondition by an algebraic multigrid cycle of a matrix and iterate by GMRES from the right with the operator and
the preconditioner as functions; what they solve is the same.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.sparse as sp

from ..domain.communicator import current
from ..domain.exchange import Exchange
from .krylov import Apply, Limits, Report, Watch, gmres_from_the_right
from .multigrid import BlockCycle, cycle, hierarchy
from .pair_cycle import PairCycle, SweptMatrix

PAIR_CYCLE = 50_000  # rows from which the matrix is not stored: smaller scenes are not worth the kernels' compilation


class Engine(Protocol):
    """Matrices are the (n, n + remote) rows of this process, remote columns last (`domain/exchange.py`); vectors are
    the entries of this process."""

    def cycle(self, matrix: sp.csr_matrix | SweptMatrix, exchange: Exchange) -> Apply:
        """An approximate inverse as a function of the right-hand side (n,)."""
        ...

    def block_cycle(self, matrix: sp.csr_matrix, exchange: Exchange, strength: float, cycles: int) -> Apply:
        """The same of three right-hand sides (n, 3). strength, cycles: of the aggregates of the one that aggregates."""
        ...

    def gmres(self, apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
              start: np.ndarray | None = None, watch: Watch | None = None) -> tuple[np.ndarray, Report]:
        """See `krylov.gmres_from_the_right`."""
        ...


class OneProcess:
    """PyAMG's hierarchies, our own cycles of them, SciPy's GMRES."""

    def cycle(self, matrix: sp.csr_matrix | SweptMatrix, exchange: Exchange) -> Apply:
        """See `Engine`."""
        if isinstance(matrix, sp.csr_matrix) or matrix.n < PAIR_CYCLE:
            return cycle(hierarchy(matrix.tocsr()))
        return PairCycle(matrix)

    def block_cycle(self, matrix: sp.csr_matrix, exchange: Exchange, strength: float, cycles: int) -> Apply:
        """See `Engine`."""
        return BlockCycle(hierarchy(matrix, strength), cycles)

    def gmres(self, apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
              start: np.ndarray | None = None, watch: Watch | None = None) -> tuple[np.ndarray, Report]:
        """See `Engine`."""
        return gmres_from_the_right(apply, rhs, precondition, limits, start, watch)


ONE_PROCESS = OneProcess()


def engine_of(name: str) -> Engine:
    """The engine of a name: petsc, or auto, which is PETSc where there are several processes. Raises RanksError where
    PETSc is asked for and is not there."""
    if name == "auto" and current().size == 1:
        return ONE_PROCESS
    from .petsc import Petsc

    return Petsc()
