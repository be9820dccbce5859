"""What is tried again when a step fails, and how a run ends.

1. A linear solve that misses its tolerance is repeated with a new hierarchy (the kept one may be stale), then with
   two cycles of it a call and twice the Krylov vectors and iterations (`solvers.kept_hierarchies.RETRY_FACTOR`). A
   system solved with its diagonal alone gets a hierarchy.
2. A step of which a solve has failed, or that breaks one of the `step_limits.Bounds`, is repeated with half its length
   and new hierarchies, up to HALVINGS times.
3. RunError, exit code 3: the step, the system and its true residual or the limit and its value, and what to try. The
   run leaves the worst particles (worst.vtu) and a restart file of the last good state.

A steady solve (`flow: stokes`) that misses its tolerance is tried again as `StokesSystem.solve` tells, and ends with a
SolveError, exit code 3, and the particles of the largest residuals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..solvers.krylov import SolveError
from .state import Handover
from .step_limits import RunError, StepError

if TYPE_CHECKING:
    from .state import State, StepResult
    from .step import Stepper

HALVINGS = 4  # of a step that fails, one after the other; then the run ends


def attempt(stepper: Stepper, state: State, ready: Handover, dt: float) -> StepResult:
    """The StepResult of a step of dt or, if that fails, of a shorter one. Raises RunError.

    ready: the configuration of the state, which the first step takes over; it is made again for each shorter one."""
    problem: SolveError | StepError
    density = ready.look().terms.density
    for halving in range(HALVINGS + 1):
        length = dt * 0.5**halving
        try:
            if state.time + length * 1e-3 == state.time:
                raise StepError(f"the step {length:.3g} is lost in the digits of the time {state.time:.3g}")
            with np.errstate(all="ignore"):  # what is not finite is found by the bounds
                found = stepper.advance(state, ready, length)
                stepper.bounds.check(state, found, density)
            return found
        except (SolveError, StepError) as failure:
            problem = failure.with_traceback(None)  # its frames hold the configuration that the step made
            stepper.solvers.drop()
        if halving < HALVINGS:
            ready = stepper.ready(state)
    message = f"step {state.step + 1} at time {state.time:g}: {problem} (the last of {HALVINGS} halvings, {length:.3g})"
    if isinstance(problem, StepError):
        # cavities at Reynolds number 1000 and an orifice that blew up with shifting 0.1 held with each of the first two
        message += ("; try particles.support=3, more particles.shifting, a smaller particles.spacing where pores "
                    "are few particles wide, or smaller time steps (time.step where it is given, else time.cfl)")
        tension = stepper.fluids.tension
        if tension is not None:  # twice the limit holds for a while at Laplace number 1e6, and then blows up
            message += f", or time steps below the capillary limit of {tension.largest_step:.3g}"
    error = RunError(message)
    error.violation = problem.violation
    raise error from problem
