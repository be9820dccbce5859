"""What solves the linear systems: PyAMG and SciPy for one process, PETSc for any number.

Both precondition by an algebraic multigrid cycle of a matrix and iterate by GMRES with the operator and the
preconditioner as functions; what they solve is the same.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy.sparse as sp

from ..domain.communicator import current
from ..domain.exchange import Exchange
from .krylov import Apply, Convergence, Limits, Maps, Watch, gmres, gmres_from_the_right
from .multigrid import BlockCycle, cycle, grounded, hierarchy
from .pair_cycle import PairCycle, SweptMatrix

PAIR_CYCLE = 50_000  # rows from which the matrix is not stored: smaller scenes are not worth the kernels' compilation

if TYPE_CHECKING:
    from pyamg.multilevel import MultilevelSolver


class Kept(Protocol):
    """A hierarchy that is kept while its particles move on."""

    def cycle(self, matrix: sp.csr_matrix, exchange: Exchange) -> Apply:
        """An approximate inverse as a function of the right-hand side (n,), for the matrix of this step, whose
        particles have moved since the hierarchy was built."""
        ...

    def release(self) -> None:
        """Frees its memory."""
        ...


class Engine(Protocol):
    """Matrices are the (n, n + remote) rows of this process, remote columns last (`domain/exchange.py`); vectors are
    the entries of this process."""

    def cycle(self, matrix: sp.csr_matrix | SweptMatrix, exchange: Exchange) -> Apply:
        """An approximate inverse as a function of the right-hand side (n,)."""
        ...

    def block_cycle(self, matrix: sp.csr_matrix, exchange: Exchange, strength: float) -> Apply:
        """The same of three right-hand sides (n, 3). strength: threshold of aggregation of `OneProcess`; PETSc has its
        own settings."""
        ...

    def gmres(self, maps: Maps, rhs: np.ndarray, limits: Limits, start: np.ndarray | None = None,
              watch: Watch | None = None) -> tuple[np.ndarray, Convergence]:
        """See `krylov.gmres_from_the_right`."""
        ...

    def keep(self, matrix: sp.csr_matrix, exchange: Exchange) -> Kept:
        """A hierarchy for the steps that follow."""
        ...

    def gmres_of_step(self, apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
                      start: np.ndarray | None = None) -> tuple[np.ndarray, Convergence]:
        """GMRES for systems of moving particles, those of the pressure among them, which are singular."""
        ...


class OneProcess:
    """PyAMG's hierarchies, our own cycles of them, SciPy's GMRES."""

    def cycle(self, matrix: sp.csr_matrix | SweptMatrix, exchange: Exchange) -> Apply:
        """See `Engine`."""
        if isinstance(matrix, sp.csr_matrix) or matrix.n < PAIR_CYCLE:
            return cycle(hierarchy(matrix.tocsr()))
        return PairCycle(matrix)

    def block_cycle(self, matrix: sp.csr_matrix, exchange: Exchange, strength: float) -> Apply:
        """See `Engine`."""
        return BlockCycle(hierarchy(matrix, strength))

    def gmres(self, maps: Maps, rhs: np.ndarray, limits: Limits, start: np.ndarray | None = None,
              watch: Watch | None = None) -> tuple[np.ndarray, Convergence]:
        """See `Engine`."""
        return gmres_from_the_right(maps, rhs, limits, start, watch)

    def keep(self, matrix: sp.csr_matrix, exchange: Exchange) -> Kept:
        """See `Engine`."""
        return Levels(hierarchy(grounded(matrix)))

    def gmres_of_step(self, apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
                      start: np.ndarray | None = None) -> tuple[np.ndarray, Convergence]:
        """See `Engine`: from the left."""
        return gmres(apply, rhs, precondition, limits, start)


class Levels:
    """A hierarchy of PyAMG without its finest matrix, which each step brings: that of the step before would be held
    beside the operators of the next."""

    def __init__(self, levels: MultilevelSolver):
        self.levels = levels
        levels.levels[0].A = None

    def cycle(self, matrix: sp.csr_matrix, exchange: Exchange) -> Apply:
        """See `Kept`."""
        whole, finest = copy.copy(self.levels), copy.copy(self.levels.levels[0])
        finest.A = matrix
        whole.levels = [finest, *self.levels.levels[1:]]
        return cycle(whole)

    def release(self) -> None:
        """See `Kept`."""


ONE_PROCESS = OneProcess()


def engine_of(name: str) -> Engine:
    """The engine of a name: petsc, or auto, which is PETSc where there are several processes. Raises RanksError where
    PETSc is asked for and is not there."""
    if name == "auto" and current().size == 1:
        return ONE_PROCESS
    from .petsc import Petsc

    return Petsc()
