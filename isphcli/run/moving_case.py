"""Moving particles of a case: preparation, the time loop with its files, the summary."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import walls_move
from ..output import folder, progress, restart
from ..output.files import History, Series, read_history
from ..references.result import Result
from ..scene import memory
from ..scene.build_geometry import build_geometry
from ..scene.prepare import prepare
from .permeability import darcy, fluid_cells
from .results import (
    Look,
    Seen,
    absent_fluids,
    added_viscosity,
    counts_of,
    finish,
    grids_of,
    mean_max,
    scene_entries,
    series_of,
    snapshot_of,
    stopped_short,
    terms_of,
    terms_of_two,
    write_case,
    write_grid,
)
from .time_loop import TimeLoop

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..flow.state import Configuration, State, StepResult
    from ..flow.step import Stepper
    from ..geometry.protocol import Geometry
    from ..output.clock import Clock
    from ..two_phase.measures import Measures

Summary = dict[str, Any]


@dataclass
class MovingRun:
    """A run of moving particles: its scene, its loop, and where its files go.

    measures: of two fluids, else None; cells: `permeability.fluid_cells` of the sample; seen: what was said of the
    scene before; record: of the case, with what restarts have changed (output.restart); since, last_step: time and step
    that a run goes on from whose files are in the same directory, else None; history: a dict a step.
    """

    case: Case
    directory: Path
    clock: Clock
    quiet: bool
    geometry: Geometry
    particles: Particles
    stepper: Stepper
    march: TimeLoop
    measures: Measures | None
    cells: float
    seen: Seen
    record: dict[str, Any]
    since: float | None = None
    last_step: int | None = None
    series: Series | None = None
    grids: Series | None = None
    history: list[dict[str, Any]] = field(default_factory=list)

    @property
    def restart_file(self) -> Path:
        """What a run that stops goes on from."""
        return self.directory / restart.NAME

    @property
    def pressure_unit(self) -> float:
        """What the pressures of a state are multiplied with, kg/m3."""
        return self.stepper.fluids.reference

    def snapshot(self, state: State, config: Configuration) -> None:
        """Writes a snapshot, if there are any."""
        if self.series is not None:
            with self.clock("output"):
                fields = snapshot_of(self.case, self.geometry, self.particles, state.x, state.u,
                                     state.p * self.pressure_unit, config.ops.total_divergence(state.u))
                self.series.write(state.step, state.time, *fields)
        with self.clock("output"):
            write_grid(self.grids, self.case, self.geometry, self.particles, (state.step, state.time),
                       (state.x, state.u, state.p * self.pressure_unit), self.case.particles.spacing)

    def save(self, file: History) -> None:
        """Writes the restart file of the last step of which all is told."""
        if self.march.last is not None:
            file.sync()  # a restart finds every row and every snapshot up to its step
            restart.save(self.restart_file, self.march.last, self.record)


def run_moving(case: Case, clock: Clock, quiet: bool, resume: str | Path | None,
               look: Look | None) -> tuple[Summary, Result]:
    """Runs a case of moving particles and leaves its files; see `run.solve_case`."""
    run, state, config = _prepared(case, clock, quiet, resume, look)
    if run.last_step is None:
        run.snapshot(state, config)
    try:
        state, config = _march(run, state, config)
    except BaseException as stop:
        stop.restart = run.restart_file if run.restart_file.exists() else None  # type: ignore[attr-defined]  # for `cli`
        _leave_worst(run, stop)
        raise
    try:
        return _finish_march(run, state, config)
    except KeyboardInterrupt as stop:
        stop.restart = run.restart_file  # type: ignore[attr-defined]  # for `cli`
        raise


def _prepared(case: Case, clock: Clock, quiet: bool, resume: str | Path | None,
              look: Look | None) -> tuple[MovingRun, State, Configuration]:
    """The run, its first state, that of a restart file where it goes on, and the configuration of that."""
    assert case.time is not None and case.output.directory is not None
    with clock("geometry"), progress.stage("geometry", quiet):
        geometry = build_geometry(case)
    memory.refuse_lattice(case, geometry, case.particles.spacing)
    seen = look(case, geometry, clock, quiet) if look is not None else Seen()
    state, stepper, particles = prepare(case, geometry, clock)
    density = np.array([fluid.density for fluid in case.fluids.values()])[particles.phase]
    box = float(np.prod(geometry.upper - geometry.lower))
    march = TimeLoop(case, stepper, particles.site_volume, density, box)
    with clock("geometry"):
        distance = geometry.distance(particles.x) if geometry.has_solid else None
        cells = fluid_cells(geometry, particles, distance)
        if geometry.has_solid:
            march.fluid_cells = fluid_cells(geometry, particles, distance, whole=True)
    measures = None
    if len(np.unique(particles.phase)) > 1:
        from ..scene.choose_measures import choose_measures

        march.measure = measures = choose_measures(case, geometry, particles, stepper.fluids)
    run = MovingRun(case, case.output.directory, clock, quiet, geometry, particles, stepper, march, measures, cells,
                    seen, restart.record_of(case))
    saved = None
    if resume is not None:
        saved = restart.load(Path(resume) / restart.NAME, state, run.record)
        state = saved.state
        march.take_up(saved)
        run.record = _gone_on(case, Path(resume) / restart.NAME, saved, run.record, quiet)
        if Path(resume).resolve() == case.output.directory.resolve():  # elsewhere its files begin anew
            run.since, run.last_step = state.time, state.step
    with progress.stage("neighbours and operators", quiet):
        config = stepper.configure(state.x, state.time)
        if saved is not None:
            stepper.rebuild_hierarchies(saved.origins)
    run.directory = folder.prepare(case.output.directory)
    write_case(run.directory, case, run.record["changes"])
    run.series = series_of(case, run.directory, run.since)
    run.grids = grids_of(case, run.directory, run.since)
    return run, state, config


def _march(run: MovingRun, state: State, config: Configuration) -> tuple[State, Configuration]:
    """The time loop with its files; (state, config) at the end."""
    case, march = run.case, run.march
    assert case.time is not None
    with History(run.directory / "history.csv", run.last_step) as file, progress.Progress(
        case.time.end, case.time.max_steps if case.time.end is None else None, case.title, run.quiet
    ) as bar:
        if file.rows:
            run.history = read_history(run.directory / "history.csv")
            if run.measures is not None:
                run.measures.resume(run.history[-1])

        def row(values: dict[str, Any]) -> None:
            run.history.append(values)
            file.append(values)

        def show(found: StepResult, limit: str) -> None:
            state = found.state
            if case.output.restart_every and state.step % case.output.restart_every == 0:
                with run.clock("output"):
                    run.save(file)
            reports = found.reports
            bar.update(state.step, state.time, found.dt, limit, {k: r.iterations for k, r in reports.items()},
                       {k: r.residual for k, r in reports.items()} | {"divergence": found.max_divergence}
                       | ({"change": march.steady.distance} if march.steady is not None else {}))

        try:
            state, config = march.run(state, config, run.snapshot, row, show)
            series = run.series or run.grids
            if series is None or not series.entries or series.entries[-1][0] < state.time:
                run.snapshot(state, config)
        finally:
            with run.clock("output"):
                run.save(file)
    return state, config


def _leave_worst(run: MovingRun, stop: BaseException) -> None:
    """Writes the worst particles of a step that failed."""
    from ..flow.step_limits import RunError
    from ..output.worst import NAME, write_worst

    if isinstance(stop, RunError):
        with suppress(OSError):
            assert run.march.last is not None
            last = run.march.last.state
            stop.worst = write_worst(run.directory / NAME, last.x, stop.violation, velocity=last.u, pressure=last.p)


def _gone_on(case: Case, path: Path, saved: restart.Saved, record: dict[str, Any], quiet: bool) -> dict[str, Any]:
    """The record of a case that goes on from a restart file; what it changes is said. Raises RestartError."""
    assert case.time is not None
    state, before = saved.state, len(saved.record["changes"])
    record = restart.go_on(path, saved, record, case.time)
    said = [f"changed from {line}" for line in restart.sentences(record)[before:]]
    if case.time.end is not None and state.time >= case.time.end * (1.0 - 1e-12):
        said.append(f"the run has reached its end, time {state.time:g}: no step is left (--set time.end=... runs it "
                    "longer)")
    elif state.step >= case.time.max_steps:
        said.append(f"the run has made time.max_steps = {case.time.max_steps} steps: no step is left")
    for line in () if quiet else said:
        print(f"restart: {line}", file=sys.stderr, flush=True)
    return record


def _drive_at_the_end(run: MovingRun, state: State) -> tuple[int | None, np.ndarray]:
    """(axis or None, acceleration (dim,), m/s2) of what drives a flow; of a velocity that is held, its steady value."""
    stepper = run.stepper
    force = stepper.fluids_at(state.time).force
    axis = int(np.argmax(np.abs(force)))
    if stepper.held_velocity is not None:
        assert state.pressure_gradient is not None
        axis = stepper.held_velocity.axis
        held = force[axis] + state.pressure_gradient * run.march.steady_ratio(state)
        force = held * stepper.fluids.held
    return (axis if float(np.linalg.norm(force)) > 0.0 else None), force


def _flow_entries(run: MovingRun, state: State) -> Summary:
    """Entries of the summary on the flow at the end: velocities, and a permeability where a steady flow has one."""
    stepper, march, two = run.stepper, run.march, run.measures is not None
    axis, force = _drive_at_the_end(run, state)
    superficial, mean, along = darcy(run.geometry, state.x, state.u, run.particles.site_volume, axis, force,
                                     stepper.fluids.nu_max, run.cells)
    resisted = run.geometry.has_solid and not two and not walls_move(run.case)
    permeability = error = None
    if axis is not None and resisted and march.outcome == "steady":
        assert along is not None and march.steady is not None and march.steady.distance is not None
        permeability = float(along[axis]) * (march.steady_ratio(state) if stepper.held_velocity is None else 1.0)
        error = abs(permeability) * march.steady.distance
    free = axis is not None and not run.geometry.has_solid and not two
    messages = [stopped_short(run.case, march, state, run.directory), absent_fluids(run.case, run.particles),
                added_viscosity(stepper.fluids), "no permeability: no wall resists the flow" if free else None,
                *(f"changed by a restart from {line}" for line in restart.sentences(run.record, of_flow=True))]
    return {
        "message": "; ".join(filter(None, messages)) or None,
        "terms": terms_of(run.case, run.geometry, axis is not None) + (terms_of_two(stepper.fluids) if two else []),
        "permeability": permeability,
        "permeability_error": error,
        "superficial_velocity": superficial,
        "mean_velocity": mean,
        "pressure_drop": stepper.held_velocity.drop(state) if stepper.held_velocity is not None else None,
    }


def _finish_march(run: MovingRun, state: State, config: Configuration) -> tuple[Summary, Result]:
    """The summary and the flow of a run that has ended, its pictures, and its errors against the reference."""
    case, history = run.case, run.history
    flow = _flow_entries(run, state)
    result = Result(
        x=state.x, velocity=state.u, cell_velocity=state.u, pressure=state.p * run.pressure_unit,
        time=state.time, spacing=case.particles.spacing, phase=run.particles.phase, permeability=flow["permeability"],
        geometry=run.geometry, history=history,
    )
    summary: Summary = {
        "status": run.march.outcome,
        "message": flow.pop("message"),
        "restarts": run.record["changes"],
        "warnings": run.seen.warnings,
        "particles": counts_of(run.particles, config.halo),
        **scene_entries(case, run.geometry, run.particles, run.cells, run.seen),
        "terms": flow.pop("terms"),
        "steps": state.step,
        "time": state.time,
        **flow,
        "mass_error": 0.0,  # particles are neither made nor lost
        "max_divergence": max((r["divergence"] for r in history), default=0.0),
        "iterations": {
            name: mean_max([r[f"iterations_{name}"] for r in history]) for name in ("velocity", "pressure")
        },
    }
    if run.measures is not None:
        _add_two_fluids(run, run.measures, summary, state, config)
    if case.output.plots:
        with run.clock("output"):
            _pictures(run, state, flow["permeability"])
    return finish(case, run.directory, summary, result, run.clock)


def _add_two_fluids(run: MovingRun, measures: Measures, summary: Summary, state: State, config: Configuration) -> None:
    """Adds to the summary what is measured of two fluids."""
    from ..two_phase.measures import broke_up
    from ..two_phase.measures import summary as summary_of_two

    case = run.case
    driven = _drive_at_the_end(run, state)[0] is not None
    moved = driven or walls_move(case) or bool(case.initial and case.initial.velocity)
    summary["two_fluids"] = summary_of_two(measures, state, config, run.history, moved)
    broken = None if moved else broke_up(measures.names, run.history, summary["two_fluids"])
    if broken:
        summary.setdefault("warnings", []).append(broken)


def _pictures(run: MovingRun, state: State, permeability: float | None) -> None:
    """A slice of the flow, the fluids where there are two, the histories."""
    from ..output.plots import Frame, plot_histories, plot_phases, plot_slice

    case, geometry, two = run.case, run.geometry, run.measures is not None
    phase = run.particles.phase
    frame = Frame(geometry.dim, case.particles.spacing, case.title, geometry.lower, geometry.upper, geometry.periodic,
                  geometry.distance if geometry.has_solid else None)
    plot_slice(run.directory / "slice.png", state.x, state.u, frame, permeability=permeability,
               phase=phase if two else None)
    if two:
        plot_phases(run.directory / "phases.png", state.x, phase, case.fluid_names, frame, walls=geometry.has_solid)
    plot_histories(run.directory / "histories.png", run.history, case.title)
