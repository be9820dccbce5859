"""PETSc as what solves the linear systems, on any number of processes.

One multigrid cycle of hypre's BoomerAMG where PETSc has it, else of PETSc's own GAMG. Moving particles: KSP's GMRES
from the right, with the operator and the preconditioner as shells around functions of numpy arrays. Steady flow: that
of `krylov`, whose vectors take half of the memory. Imported only where it is used.
"""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..domain import reduce
from ..domain.communicator import INSTALL, Ranks, RanksError, current
from ..domain.exchange import Exchange
from ..domain.migration import Numbered
from .krylov import Apply, Convergence, Limits, Maps, Watch, convergence_of, gmres_from_the_right
from .multigrid import grounded
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

    def _cycle_of(self, whole: Any) -> _Cycle:
        if self.settings is HYPRE:  # it keeps a copy of its own: PETSc's would be held beside it for nothing
            copy = whole.convert("hypre", PETSc.Mat())
            whole.destroy()
            whole = copy
        return _Cycle(whole, self.settings, self.comm)

    def keep(self, matrix: sp.csr_matrix, exchange: Exchange) -> PetscKept:
        """See `engine.Engine`."""
        return PetscKept(self._cycle_of(self._aij(grounded(matrix), exchange)), matrix.shape[0], exchange, self.comm)

    def block_cycle(self, matrix: sp.csr_matrix, exchange: Exchange, strength: float) -> Apply:
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
        """PETSc's matrix of the rows of all processes; what hierarchies before it held is freed first."""
        self._free()
        n, kind = matrix.shape[0], PETSc.IntType
        whole = reduce.number(matrix.indptr[1:])
        columns = exchange.numbers(n).astype(kind)[matrix.indices]
        csr = matrix.indptr.astype(kind), columns, matrix.data.astype(float, copy=False)
        found = PETSc.Mat().createAIJ(((n, whole), (n, whole)), csr=csr, comm=self.comm)
        found.assemble()
        return found

    def _free(self) -> None:
        """Frees what no process refers to any more. Objects of PETSc that are of several processes can only be freed by
        all of them together: petsc4py keeps those that Python has let go of, from 3.18 on, until this is called."""
        if hasattr(PETSc, "garbage_cleanup"):
            PETSc.garbage_cleanup(self.comm)

    def gmres(self, maps: Maps, rhs: np.ndarray, limits: Limits, start: np.ndarray | None = None,
              watch: Watch | None = None) -> tuple[np.ndarray, Convergence]:
        """See `engine.Engine`: in vectors of single precision, where PETSc's are 32 bytes a particle and iteration."""
        return gmres_from_the_right(maps, rhs, limits, start, watch)

    def gmres_of_step(self, apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
                      start: np.ndarray | None = None) -> tuple[np.ndarray, Convergence]:
        """See `engine.Engine`: PETSc's, from the right. Whether it has converged is decided by the residual that is
        computed afterwards, not by PETSc's, which was below the tolerance on wrong solutions of singular systems."""
        rest = rhs if start is None else rhs - apply(start)
        square, left, number = reduce.totals(rhs * rhs, rest * rest, len(rhs))
        norm = float(np.sqrt(square))
        if norm == 0.0:
            return np.zeros_like(rhs), Convergence(0, 0.0, limits.tolerance, "zero right-hand side")
        size = (len(rhs), int(number))
        shells = _Shell(apply), _Shell(precondition)
        system = PETSc.Mat().createPython((size, size), shells[0], comm=self.comm)
        system.setUp()
        krylov = PETSc.KSP().create(self.comm)
        krylov.setOperators(system)
        krylov.setType("gmres")
        krylov.setPCSide(PETSc.PC.Side.RIGHT)
        krylov.setInitialGuessNonzero(start is not None)  # without one the product with it is left out
        inner = krylov.getPC()
        inner.setType("python")
        inner.setPythonContext(shells[1])
        iterations = 0
        right, found = system.createVecs()
        right.array[:] = rhs
        found.array[:] = 0.0 if start is None else start
        residual = float(np.sqrt(left)) / norm
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
            krylov.setInitialGuessNonzero(True)
            before, residual = residual, reduce.norm(rhs - apply(found.array_r.copy())) / norm
            if not residual < before:  # also where it is not finite
                break
        solution = found.array.copy()
        # of several processes petsc4py keeps every object until its end that is not destroyed, and all that it holds
        for used in (krylov, inner, system, right, found):
            used.destroy()
        return solution, convergence_of(iterations, float(residual), limits.tolerance)


class _Cycle:
    """One multigrid cycle of a matrix of PETSc as a function of the entries of this process (n,)."""

    def __init__(self, matrix: Any, settings: dict[str, Any], comm: Any):
        self.preconditioner = PETSc.PC().create(comm)
        prefix = f"isph{next(_number)}_"
        options = PETSc.Options()
        for key, value in settings.items():
            options[prefix + key] = value
        self.preconditioner.setOptionsPrefix(prefix)
        self.preconditioner.setOperators(matrix)
        self.preconditioner.setFromOptions()
        self.preconditioner.setUp()
        for key in settings:  # PETSc complains at its end of those that a version of it does not know
            options.delValue(prefix + key)
        self.matrix = matrix
        self.right, self.found = matrix.createVecs()

    def __call__(self, b: np.ndarray) -> np.ndarray:
        self.right.array[:] = b
        self.preconditioner.apply(self.right, self.found)
        return self.found.array.copy()

    def destroy(self) -> None:
        """Frees what PETSc holds, on all processes together."""
        for used in (self.preconditioner, self.matrix, self.right, self.found):
            used.destroy()


class PetscKept:
    """A hierarchy whose rows are where their particles were when it was built; see `engine.Kept`. Vectors go there and
    come back, which is little traffic: most particles stay with their process."""

    def __init__(self, once: _Cycle, n: int, exchange: Exchange, comm: Any):
        self.once, self.comm, self.exchange = once, comm, exchange
        self.order: Any = None
        self.scatter: Any = None
        if isinstance(exchange, Numbered):
            first, _ = once.matrix.getOwnershipRange()
            kind = PETSc.IntType
            self.order = PETSc.AO().createMemoryScalable(
                exchange.number.astype(kind), np.arange(first, first + n, dtype=kind), comm=comm)

    def cycle(self, matrix: sp.csr_matrix, exchange: Exchange) -> Apply:
        """See `engine.Kept`: the one of the matrix that it was built on."""
        if not isinstance(exchange, Numbered):
            return self.once
        if exchange is not self.exchange:
            self._follow(exchange)
        return self.once if self.scatter is None else self._there_and_back

    def _follow(self, exchange: Numbered) -> None:
        """Finds where the rows of the particles are that this process owns now."""
        self._free_vectors()
        self.exchange = exchange
        rows = self.order.app2petsc(exchange.number.astype(PETSc.IntType))
        self.here = PETSc.Vec().createMPI((len(rows), PETSc.DETERMINE), comm=self.comm)
        there = PETSc.IS().createGeneral(rows, comm=self.comm)
        self.scatter = PETSc.Scatter().create(self.here, None, self.once.right, there)
        there.destroy()

    def _there_and_back(self, b: np.ndarray) -> np.ndarray:
        once = self.once
        self.here.array[:] = b
        self.scatter.scatter(self.here, once.right)
        once.preconditioner.apply(once.right, once.found)
        self.scatter.scatter(once.found, self.here, mode=PETSc.ScatterMode.REVERSE)
        return self.here.array.copy()

    def _free_vectors(self) -> None:
        if self.scatter is not None:
            self.scatter.destroy()
            self.here.destroy()

    def release(self) -> None:
        """See `engine.Kept`."""
        self._free_vectors()
        self.once.destroy()
        if self.order is not None:
            self.order.destroy()


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
