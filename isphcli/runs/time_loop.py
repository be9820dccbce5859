"""The time loop of moving particles: step sizes, snapshots, history, steady states, restart files."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import walls_move
from ..domain import reduce
from ..domain.communicator import current
from ..domain.row_threads import over_slices
from ..flow.attempt import attempt
from ..flow.forces import largest_of
from ..flow.state import Handover
from ..flow.step_lengths import next_due, shortest
from ..output.restart import Saved
from ..scene.choose_steps import step_lengths
from ..scene.place import lattice_at
from .permeability import mean_velocities
from .steadiness import Steady

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..flow.state import Configuration, State, StepResult
    from ..flow.step import Stepper
    from .drive_steps import DriveProgram


def _free_direction(case: Case, stepper: Stepper) -> np.ndarray | None:
    """Unit vector (dim,) of the force along the axes that do not end at walls; None where there is no such force, or
    walls move and drag the fluid along as well, or it changes with time."""
    force = stepper.fluids.force * np.array(stepper.geometry.periodic)
    size = np.linalg.norm(force)
    return force / size if size > 0.0 and not walls_move(case) and stepper.timed_drive is None else None


class TimeLoop:
    """Runs a state to its end; callbacks write all files.

    snapshot(state, config), row(dict) and progress(result, limit) are called as the run goes. `last` is the last
    step whose row and snapshot are written (restart.Saved): a run that stops can go on from it.
    measure(state, config): further entries of a row, dict.
    steady: steadiness.Steady of what `observed` says, in a run to a steady state, else None.
    thick: (dim,) m, extents of the particles (`geometry.extents`), those of their lattice at the start.
    fluid_cells: volume of the fluid in the box over `site_volume`, see `permeability.fluid_cells`, which the mean
    velocity is taken over; None: over the particles. program: of a drive in steps, which ends the run with its last
    one, or None: `moving_case` makes it when the run that it writes for is there.
    """

    def __init__(self, case: Case, stepper: Stepper, site_volume: float, box_volume: float,
                 measure: Callable[[State, Configuration], dict[str, Any]] = lambda state, config: {},
                 fluid_cells: float | None = None):
        assert case.time is not None  # of moving particles
        self.measure, self.fluid_cells = measure, fluid_cells
        self.program: DriveProgram | None = None
        self.case, self.time, self.stepper = case, case.time, stepper
        self.site_volume, self.box_volume = site_volume, box_volume
        self.thick = lattice_at(case, stepper.geometry, case.particles.spacing).thick
        self.steady = Steady() if case.time.steady is not None else None
        self.along = _free_direction(case, stepper)
        fluids = stepper.fluids
        self.lengths = step_lengths(case, fluids.nu_min, fluids.tension.largest_step if fluids.tension else None,
                                    stepper.geometry.has_solid, fluids.nu_lacking)
        self.last: Saved | None = None
        self.outcome = "finished"

    def limits(self, state: State) -> dict[str, float]:
        """{name: step} of everything that bounds the next step, s."""
        stepper = self.stepper

        def squares(part: slice) -> list[float]:
            vectors = state.u[part], state.u[part] - state.u_old[part]
            return [np.einsum("nk,nk->n", v, v).max(initial=-np.inf) for v in vectors]

        speed, change = np.sqrt(reduce.largest_of_each(*np.array(over_slices(squares, len(state.u))).T))
        speed = float(speed)
        if state.dt_old:
            acceleration = change / state.dt_old
        else:
            acceleration = np.linalg.norm(stepper.fluids_at(state.time).force) + abs(state.pressure_gradient or 0.0)
            acceleration += largest_of(stepper.fluids.forces)
            speed = max(speed, stepper.held_velocity.speed if stepper.held_velocity is not None else 0.0)
        return self.lengths.limits(speed, float(acceleration), state.dt_old, self._follow(state))

    def _follow(self, state: State) -> Callable[[float], float] | None:
        """The step of at most dt that follows what drives the flow, as a function of dt; None where that is steady."""
        drive, end = self.stepper.timed_drive, self.time.end
        left = np.inf if end is None else end - state.time
        return None if drive is None else lambda dt: drive.limit(state.time, dt, left)

    def run(self, state: State, ready: Handover, snapshot: Callable[[State, Configuration], None],
            row: Callable[[dict[str, Any]], None],
            progress: Callable[[StepResult, str], None]) -> tuple[State, Configuration]:
        """(state, config) at the end. ready: the configuration of the state. Raises RunError."""
        time, program = self.time, self.program
        end = time.end if time.end is not None else np.inf
        if program is not None:
            state = program.begin(state)
        self.last = self._saved(state)
        while not self._over(state) and state.time < end * (1.0 - 1e-12) and state.step < time.max_steps:
            due = next_due(state.time, self.case.output.every)
            target = min(end, due, program.due(state) if program is not None else np.inf) - state.time
            dt, limit = shortest(self.limits(state), target)
            found = attempt(self.stepper, state, ready, dt)
            state, config = found.state, found.config
            if self.steady is not None:
                self.steady.add(state.time, self.observed(state))
            if state.time >= due * (1.0 - 1e-9):
                snapshot(state, config)
            row(self._row(found, limit) | self.measure(state, config))
            if program is not None:
                state = program.after(state, config)
            self.last = self._saved(state)
            progress(found, limit)
            ready = Handover(config)
            del found, config  # frees them: only the next step may hold the configuration
        if time.steady is not None:
            self.outcome = "steady" if self._steady_by_now() else "not steady at the end"
        elif state.step >= time.max_steps and state.time < end * (1.0 - 1e-12) and not self._over(state):
            self.outcome = "out of steps"
        return state, ready.take()

    def _over(self, state: State) -> bool:
        """Whether the flow is steady, or all steps of a drive have been taken."""
        return self._steady_by_now() or (self.program is not None and self.program.done(state))

    def _saved(self, state: State) -> Saved:
        kept = tuple(self.steady.kept) if self.steady is not None else ()
        return Saved(state, self.stepper.solvers.origins(), kept)

    def resume(self, saved: Saved) -> None:
        """Go on with the record of a restart.Saved; from its time on where it has none."""
        if self.steady is not None:
            self.steady = Steady(saved.steady or ((saved.state.time, 0.0),))

    def observed(self, state: State) -> float:
        """The number that tells whether the flow of a step.State is steady: the pressure drop, Pa, where a velocity is
        held; the superficial velocity of the sample along the force, m/s, where it can follow it; else the root mean
        square speed of the fluid, m/s, which walls that slide in opposite directions do not hide."""
        stepper = self.stepper
        if stepper.held_velocity is not None:
            return stepper.held_velocity.drop(state)
        if self.along is not None:
            superficial, _ = mean_velocities(stepper.geometry, state.x, state.u, self.site_volume, self.thick)
            return float(superficial @ self.along)
        return float(np.sqrt(current().sum(np.einsum("ij,ij", state.u, state.u)) / reduce.number(state.u)))

    def steady_ratio(self, state: State) -> float:
        """The steady value of `observed` over that of a state, which has the noise of its particles; 1 where the run
        is not steady."""
        if self.steady is None or self.steady.mean is None or not self._steady_by_now():
            return 1.0
        return self.steady.mean / self.observed(state)

    @property
    def standing(self) -> str | None:
        """Words on how far from steady a run to a steady state is; None of other runs."""
        if self.steady is None or self.outcome != "not steady at the end":
            return None
        distance, asked = self.steady.distance, f"time.steady asks for {self.time.steady:g}"
        if distance is None:
            return f"how far it is from its steady value cannot be told yet, {asked}"
        return f"it may be {distance:.2g} off its steady value, relative, and {asked}"

    def _steady_by_now(self) -> bool:
        distance = self.steady.distance if self.steady is not None else None
        return distance is not None and self.time.steady is not None and distance < self.time.steady

    def _row(self, found: StepResult, limit: str) -> dict[str, Any]:
        state, stepper = found.state, self.stepper
        # einsum: numpy's sums over an axis of two or three entries take five times as long
        density = stepper.fluids.reference * found.config.terms.density
        total, square, number = reduce.totals(np.einsum("ij->j", state.u)[None],
                                              density * np.einsum("ij,ij->i", state.u, state.u), len(state.u))
        held = stepper.held_velocity
        if held is not None:
            total[held.axis] = held.flux(state.x, state.u) * self.box_volume / self.site_volume
        mean = total / (self.fluid_cells or number)
        energy = 0.5 * self.site_volume * float(square)
        fraction = number * self.site_volume / self.box_volume
        row = {"step": state.step, "time": state.time, "dt": found.dt, "limit": limit}
        for name in ("velocity", "pressure"):
            solve = found.solves[name]
            row[f"iterations_{name}"] = solve.iterations
            row[f"residual_{name}"] = solve.residual
        row |= {"rebuilt": int(found.rebuilt), "divergence": found.max_divergence, "kinetic_energy": energy}
        if found.volume_drift is not None:
            row["volume_drift"] = found.volume_drift
        if held is not None:
            row[f"pressure_drop_{'xyz'[held.axis]}"] = held.drop(state)
        elif self.program is not None:
            row[f"pressure_drop_{'xyz'[self.program.axis]}"] = self.program.drop(state)
        row |= {f"mean_velocity_{a}": float(m) for a, m in zip("xyz", mean)}
        row |= {f"superficial_velocity_{a}": float(m / number * fraction) for a, m in zip("xyz", total)}
        if self.steady is not None:
            row["change"] = self.steady.distance
        return row
