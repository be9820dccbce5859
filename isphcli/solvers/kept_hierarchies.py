"""Linear systems of moving particles: GMRES, preconditioned by hierarchies that are kept over many steps.

A hierarchy is kept until its iterations have grown; a solve that misses its tolerance is repeated with a new one, and
then with RETRY_FACTOR cycles of it (see `flow.attempt`). A restart file does not hold hierarchies, which are ten times
as large as the state: it holds the steps in which they were built (`origins`), and these are taken again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from ..domain.communicator import current
from ..domain.exchange import NO_EXCHANGE, Exchange
from .engine import ONE_PROCESS, Engine, Kept
from .krylov import Apply, Convergence, Limits, SolveError

if TYPE_CHECKING:
    from ..flow.state import State
    from ..output.clock import Clock

# Iterations over those of the first use of a hierarchy, and by how many, beyond which it is built anew
REBUILD_RATIO, REBUILD_MARGIN = 1.5, 4
RETRY_FACTOR = 2  # cycles a call of the preconditioner, Krylov vectors and iterations, of the last try of a solve


@dataclass
class KeptHierarchies:
    """The solver of a run; the hierarchies are its only changing state.

    tolerance: of a residual over its right-hand side; restart: Krylov vectors; max_iterations: of a solve;
    clock: clock.Clock; engine: what solves. solves, rebuilt: of the solves since `begin`.
    """

    tolerance: float
    restart: int
    max_iterations: int
    clock: Clock
    engine: Engine = ONE_PROCESS
    solves: dict[str, Convergence] = field(default_factory=dict)
    rebuilt: bool = False

    def __post_init__(self) -> None:
        self._levels: dict[str, Kept] = {}
        self._first: dict[str, int] = {}  # iterations of the first use of each
        self._origin: dict[str, tuple[State, float]] = {}  # the state before the step that built each, and its length
        self._now: tuple[State, float] | None = None

    def __contains__(self, name: str) -> bool:
        return name in self._levels

    def begin(self, state: State, dt: float) -> None:
        """A step of dt from `state` begins: solves are of this step, and hierarchies that are built belong to it."""
        self.solves, self.rebuilt, self._now = {}, False, (state, dt)

    def drop(self) -> None:
        """Forget the hierarchies: the next solves build new ones."""
        for levels in self._levels.values():
            levels.release()
        self._levels.clear()

    def origins(self) -> dict[str, tuple[State, float, int]]:
        """{name: (state before the step in which a hierarchy was built, length of that step, iterations of its first
        use)}; of several processes nothing: their particles are owned by others by then, and the hierarchies are built
        anew."""
        return {} if current().size > 1 else {name: (*self._origin[name], self._first[name]) for name in self._levels}

    def rebuild(self, origins: dict[str, tuple[State, float, int]], take: Callable[[State, float], None]) -> None:
        """Build the hierarchies of `origins` again, with the same bits. take(state, dt): the step that builds them;
        what it cannot build is built when it is needed."""
        found: dict[str, Kept] = {}
        for state, dt in {(id(state), dt): (state, dt) for state, dt, _ in origins.values()}.values():
            self._levels = {}
            take(state, dt)
            wanted = [name for name, (s, t, _) in origins.items() if s is state and t == dt]
            found |= {name: self._levels[name] for name in wanted if name in self._levels}
        self._levels = found
        self._origin = {name: (state, dt) for name, (state, dt, _) in origins.items()}
        self._first = {name: first for name, (_, _, first) in origins.items()}

    def krylov(self, apply: Apply, right: np.ndarray, precondition: Apply, guess: np.ndarray | None, factor: int = 1,
               tolerance: float | None = None) -> tuple[np.ndarray, Convergence]:
        """GMRES with `factor` times the Krylov vectors and iterations of the case; see `Engine.gmres_of_step`."""
        limits = Limits(tolerance or self.tolerance, self.restart, self.max_iterations)
        return self.engine.gmres_of_step(apply, right, precondition, limits.times(factor), guess)

    def multigrid(self, name: str, matrix: sp.csr_matrix, apply: Apply, right: np.ndarray, guess: np.ndarray | None,
                  spread: Callable[[Apply], Apply] | None = None,
                  tolerance: float | None = None,
                  exchange: Exchange = NO_EXCHANGE) -> tuple[np.ndarray, Convergence]:
        """GMRES with the hierarchy kept under `name`. One whose iterations have grown is dropped after the solve; a
        solve that failed is repeated with a new one, then with RETRY_FACTOR cycles of it.

        matrix: (m, m + remote) that the hierarchy is built on; apply: the system, of any size; spread: makes of a cycle
        the preconditioner of `apply`; exchange: of the remote columns. Returns the last solution and its Convergence,
        converged or not.
        """
        factors = [1, RETRY_FACTOR] if name not in self._levels else [1, 1, RETRY_FACTOR]
        for factor in factors:
            fresh = name not in self._levels
            if fresh:
                with self.clock("preconditioner"):
                    self._levels[name] = self.engine.keep(matrix, exchange)
                assert self._now is not None
                self._origin[name] = self._now
                self.rebuilt = True
            precondition = _cycles(self._levels[name].cycle(matrix, exchange), matrix, exchange, factor)
            if spread is not None:
                precondition = spread(precondition)
            solution, convergence = self.krylov(apply, right, precondition, guess, factor, tolerance)
            if fresh:
                self._first[name] = convergence.iterations
            first = self._first[name]
            if convergence.converged and convergence.iterations <= max(REBUILD_RATIO * first, first + REBUILD_MARGIN):
                break
            self._levels.pop(name).release()
            if convergence.converged:
                break
        return solution, convergence

    def record(self, name: str, convergence: Convergence, residual: Callable[[], np.ndarray]) -> None:
        """Keep the convergence of the hardest solve of a system. Raises SolveError, with the residual (n,) of each
        particle as its `violation`, where it did not converge."""
        if not convergence.converged:
            error = SolveError(name, convergence)
            error.violation = residual()
            raise error
        before = self.solves.get(name)
        if before is None or before.iterations < convergence.iterations:
            self.solves[name] = convergence


def _cycles(once: Apply, matrix: sp.csr_matrix, exchange: Exchange, count: int) -> Apply:
    """So many cycles of a hierarchy as a function of the right-hand side."""

    def apply(b: np.ndarray) -> np.ndarray:
        x = once(b)
        for _ in range(count - 1):
            x += once(b - matrix @ exchange.forward(x))
        return x

    return apply
