"""PETSc as what solves the linear systems, on any number of processes.

KSP's GMRES from the right, with the operator and the preconditioner as shells around functions of numpy arrays; one
multigrid cycle of hypre's BoomerAMG where PETSc has it, else of PETSc's own GAMG. Imported only where it is used.
"""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..domain import reduce
from ..domain.communicator import INSTALL, Ranks, RanksError, current
from ..domain.exchange import Exchange
from .krylov import Apply, Limits, Report, Watch, report_of
from .pair_cycle import SweptMatrix

try:
    import dolfinx_solver  # noqa: F401 - the wheel with PETSc wants its MPI to be loaded first
except ImportError:
    pass
try:
    from petsc4py import PETSc
except ImportError as error:
    raise RanksError(f"solver.engine: petsc4py is not there ({error}); to install it:\n{INSTALL}") from None

# By trials on Berea sandstone of 64^3 and 128^3 voxels, in 1 to 4 processes, before 2026-11-29.
# PMIS with long-range interpolation keeps hierarchies of rows with 60 entries sparse; Gauss-Seidel one way in each
# half of the cycle costs 0.6 of hypre's default, both ways. GAMG without aggressive levels saves 4 iterations of 23 and
# triples the set-up: its triple product.
HYPRE = {
    "pc_type": "hypre",
    "pc_hypre_boomeramg_coarsen_type": "PMIS",
    "pc_hypre_boomeramg_interp_type": "ext+i",
    "pc_hypre_boomeramg_strong_threshold": 0.5,
    "pc_hypre_boomeramg_P_max": 4,
    "pc_hypre_boomeramg_relax_type_all": "SOR/Jacobi",
}
GAMG = {
    "pc_type": "gamg",
    "pc_gamg_type": "agg",
    "pc_gamg_agg_nsmooths": 1,
    "pc_gamg_threshold": 0.02,
    "pc_gamg_square_graph": 1,  # PETSc to 3.18
    "pc_gamg_aggressive_coarsening": 1,  # later ones
    "pc_gamg_coarse_eq_limit": 300,
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "sor",
}
_number = count()  # of the prefix of options: each preconditioner has its own


class Petsc:
    """See `engine.Engine`."""

    def __init__(self) -> None:
        ranks = current()
        self.comm: Any = ranks.raw if isinstance(ranks, Ranks) else PETSc.COMM_SELF
        self.settings = HYPRE if PETSc.Sys.hasExternalPackage("hypre") else GAMG

    def cycle(self, matrix: sp.csr_matrix | SweptMatrix, exchange: Exchange) -> Apply:
        """See `engine.Engine`."""
        whole = self._aij(matrix.tocsr(), exchange)
        del matrix  # PETSc has its own
        return self._cycle_of(whole)

    def _cycle_of(self, whole: Any) -> Apply:
        preconditioner = PETSc.PC().create(self.comm)
        prefix = f"isph{next(_number)}_"
        options = PETSc.Options()
        for key, value in self.settings.items():
            options[prefix + key] = value
        preconditioner.setOptionsPrefix(prefix)
        preconditioner.setOperators(whole)
        preconditioner.setFromOptions()
        preconditioner.setUp()
        for key in self.settings:  # PETSc complains at its end of those that a version of it does not know
            options.delValue(prefix + key)
        right, found = whole.createVecs()

        def apply(b: np.ndarray) -> np.ndarray:
            right.array[:] = b
            preconditioner.apply(right, found)
            return found.array.copy()

        return apply

    def block_cycle(self, matrix: sp.csr_matrix, exchange: Exchange, strength: float, cycles: int) -> Apply:
        """See `engine.Engine`: one cycle, one right-hand side after the other."""
        whole = self._aij(matrix, exchange)
        del matrix
        once = self._cycle_of(whole)

        def apply(b: np.ndarray) -> np.ndarray:
            out = np.zeros_like(b)
            for k in range(b.shape[1]):
                if reduce.any_true(b[:, k]):  # in 2D one is not
                    out[:, k] = once(b[:, k])
            return out

        return apply

    def _aij(self, matrix: sp.csr_matrix, exchange: Exchange) -> Any:
        """PETSc's matrix of the rows of all processes."""
        n, kind = matrix.shape[0], PETSc.IntType
        whole = reduce.number(matrix.indptr[1:])
        columns = exchange.numbers(n)[matrix.indices]
        csr = matrix.indptr.astype(kind), columns.astype(kind), matrix.data.astype(float)
        found = PETSc.Mat().createAIJ(((n, whole), (n, whole)), csr=csr, comm=self.comm)
        found.assemble()
        return found

    def gmres(self, apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
              start: np.ndarray | None = None, watch: Watch | None = None) -> tuple[np.ndarray, Report]:
        """See `krylov.gmres_from_the_right`: whether it has converged is decided by the residual that is computed
        afterwards, not by PETSc's, which was below the tolerance on wrong solutions of singular systems."""
        norm = reduce.norm(rhs)
        if norm == 0.0:
            return np.zeros_like(rhs), Report(0, 0.0, limits.tolerance, "zero right-hand side")
        size = (len(rhs), reduce.number(rhs))
        shells = _Shell(apply), _Shell(precondition)
        system = PETSc.Mat().createPython((size, size), shells[0], comm=self.comm)
        system.setUp()
        krylov = PETSc.KSP().create(self.comm)
        krylov.setOperators(system)
        krylov.setType("gmres")
        krylov.setPCSide(PETSc.PC.Side.RIGHT)
        krylov.setInitialGuessNonzero(True)
        inner = krylov.getPC()
        inner.setType("python")
        inner.setPythonContext(shells[1])
        iterations = 0
        if watch is not None:
            def each(_: Any, iteration: int, residual: float) -> None:
                if iteration > 0:
                    watch(iterations + iteration, residual / norm)

            krylov.setMonitor(each)
        right, found = system.createVecs()
        right.array[:] = rhs
        found.array[:] = 0.0 if start is None else start
        residual = 1.0 if start is None else reduce.norm(rhs - apply(start)) / norm
        while residual > limits.tolerance and iterations < limits.max_iterations:
            left = limits.max_iterations - iterations
            krylov.setGMRESRestart(min(limits.restart, left))
            krylov.setTolerances(rtol=0.0, atol=limits.tolerance * norm, divtol=1e10, max_it=left)
            try:
                krylov.solve(right, found)
            except PETSc.Error:
                for shell in shells:
                    if shell.error is not None:
                        raise shell.error from None
                raise
            iterations += krylov.getIterationNumber()
            before, residual = residual, reduce.norm(rhs - apply(found.array_r.copy())) / norm
            if not residual < before:  # also where it is not finite
                break
        return found.array.copy(), report_of(iterations, float(residual), limits.tolerance)


class _Shell:
    """A function of arrays as PETSc's matrix and as its preconditioner."""

    def __init__(self, function: Apply):
        self.function = function
        self.error: BaseException | None = None  # PETSc tells only that there was one

    def mult(self, _: Any, x: Any, y: Any) -> None:
        """y = A x."""
        try:
            y.array[:] = self.function(x.array_r)
        except BaseException as error:
            self.error = error
            raise

    apply = mult  # y = B x
