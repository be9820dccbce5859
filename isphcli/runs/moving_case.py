"""Moving particles of a case: preparation, the time loop with its files, the summary."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import drive_steps, driven_axes, longest_time, opens, walls_move, why_closed
from ..case.yaml import CaseError, Problem
from ..domain.communicator import current, on_first
from ..domain.lattice import ParticleError
from ..flow.held_velocity import leads_through
from ..flow.state import Handover, phase_of
from ..flow.step_limits import RunError
from ..geometry.extents import part_of_sample
from ..output import folder, progress, restart
from ..output.files import History, Series, read_history
from ..references.result import Result
from ..scene import memory
from ..scene.build_geometry import build_geometry
from ..scene.place import lattice_at
from ..scene.prepare import prepare
from . import ranks
from .flow_measures import profile_rows, speed_distribution
from .late_means import LAST, LateMean, late_mean, noise_of_the_drop
from .permeability import darcy, fluid_cells, mean_velocities
from .results import (
    CURVE,
    PROFILES,
    Look,
    Seen,
    absent_fluids,
    added_viscosity,
    compare_with_reference,
    counts_of,
    draw_distributions,
    drawing_in_3d,
    finish,
    grids_of,
    mean_max,
    scene_entries,
    series_of,
    snapshot_of,
    stopped_short,
    used_physics,
    used_physics_of_two,
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
    from ..two_phase.profiles import Profiles
    from ..two_phase.reservoir_measures import ReservoirMeasures
    from .drive_steps import DriveProgram

Summary = dict[str, Any]


@dataclass
class MovingRun:
    """A run of moving particles: its scene, its loop, and where its files go.

    measures: of two fluids, else None; cells: `permeability.fluid_cells` of the sample; seen: what was said of the
    scene before; record: of the case, with the changes by restarts (output.restart); since, last_step: time and step
    from which a run goes on in the same directory, else None; history: a dict per step; between: measures between
    reservoirs, profiles: along the axis of the flow, or None; profiled: step of the last profile written; tables: files
    of these measures, profiles and of the steps of the drive.
    """

    case: Case
    directory: Path
    clock: Clock
    quiet: bool
    geometry: Geometry
    particles: Particles
    stepper: Stepper
    loop: TimeLoop
    measures: Measures | None
    cells: float
    seen: Seen
    record: dict[str, Any]
    since: float | None = None
    last_step: int | None = None
    series: Series | None = None
    grids: Series | None = None
    history: list[dict[str, Any]] = field(default_factory=list)
    between: ReservoirMeasures | None = None
    profiles: Profiles | None = None
    profiled: int | None = None
    tables: dict[str, History] = field(default_factory=dict)

    @property
    def restart_file(self) -> Path:
        """The file from which a run that has stopped can go on."""
        return self.directory / restart.NAME

    @property
    def pressure_unit(self) -> float:
        """The density, kg/m3, by which pressures of a state are multiplied to be in Pa."""
        return self.stepper.fluids.reference

    def particles_at(self, state: State) -> Particles:
        """The particles with their fluids in a state."""
        particles = self.particles
        if state.number is not None:  # particles have changed the process since the start
            dummies = particles.x[particles.n_fluid:]
            particles = replace(particles, x=np.concatenate([state.x, dummies]), phase=np.zeros(len(state.x), np.int8))
        return particles if state.phi is None else replace(particles, phase=phase_of(state.phi))

    def snapshot(self, state: State, config: Configuration) -> None:
        """Writes a snapshot, if there are any."""
        if self.series is not None:
            with self.clock("output"):
                fields = snapshot_of(self.case, self.geometry, self.particles_at(state), state.x, state.u,
                                     state.p * self.pressure_unit, config.terms.divergence(state.u))
                self.series.write(state.step, state.time, *fields)
        if self.profiles is not None and state.step != self.profiled:
            self.profiled = state.step
            with self.clock("output"):
                axis = self.profiles.axis
                scale = self.profiles.thickness, self.particles.site_volume, float(self.loop.thick[axis])
                layers = profile_rows(self.geometry, state.x, (state.u, state.p), axis, 0.0, scale)
                for row, layer in zip(self.profiles.rows(state, self.particles_at(state).phase), layers):
                    self.tables[PROFILES].append(row | {"superficial_velocity": layer["superficial_velocity"]})
        with self.clock("output"):
            write_grid(self.grids, self.case, self.geometry, self.particles_at(state), (state.step, state.time),
                       (state.x, state.u, state.p * self.pressure_unit), self.case.particles.spacing)

    def save(self, file: History) -> None:
        """Writes the restart file of the last step whose row and snapshot are written."""
        if self.loop.last is not None:
            for table in self.tables.values():
                table.sync()
            file.sync()  # a restart finds every row and every snapshot up to its step
            restart.save(self.restart_file, self.loop.last, self.record)

    def may_save(self, stop: BaseException) -> bool:
        """Whether all processes have stopped in the same place and can write the file together."""
        return current().size == 1 or isinstance(stop, (RunError, ranks.AllInterrupted))


def run_moving(case: Case, clock: Clock, quiet: bool, resume: str | Path | None,
               look: Look | None) -> tuple[Summary, Result]:
    """Runs a case of moving particles and leaves its files; see `run.solve_case`."""
    run, state, ready = _prepared(case, clock, quiet, resume, look)
    if run.last_step is None:
        with progress.stage("first snapshot", quiet):
            run.snapshot(state, ready.look())
    try:
        state, config = _time_loop(run, state, ready)
    except BaseException as stop:
        stop.restart = run.restart_file if run.restart_file.exists() else None  # type: ignore[attr-defined]  # for `cli`
        _leave_worst(run, stop)
        raise
    try:
        return _finish(run, state, config)
    except KeyboardInterrupt as stop:
        stop.restart = run.restart_file  # type: ignore[attr-defined]  # for `cli`
        raise


def _prepared(case: Case, clock: Clock, quiet: bool, resume: str | Path | None,
              look: Look | None) -> tuple[MovingRun, State, Handover]:
    """The run, its first state, that of a restart file where it goes on, and the configuration of that."""
    assert case.time is not None and case.output.directory is not None
    with clock("geometry"), progress.stage("geometry", quiet):
        geometry = build_geometry(case)
    memory.refuse_lattice(case, geometry, case.particles.spacing)
    seen = look(case, geometry, clock, quiet) if look is not None else Seen()
    with progress.stage("particles and fluids", quiet):
        state, stepper, particles = prepare(case, geometry, clock)
    geometry = stepper.geometry  # of an image that is held by parts that of this process
    box = float(np.prod(geometry.upper - geometry.lower))
    with clock("geometry"):
        distance = geometry.distance(particles.x) if geometry.has_solid else None
        thick = lattice_at(case, geometry, case.particles.spacing).thick
        cells = fluid_cells(geometry, particles, distance, thick)
        whole = fluid_cells(geometry, particles, distance) if geometry.has_solid else None
    measures = between = profiles = None
    if particles.two_fluids:
        from ..scene.choose_measures import choose_measures, choose_profiles, choose_reservoir_measures

        measures = choose_measures(case, geometry, particles, stepper.fluids, stepper.held_velocity)
        profiles = choose_profiles(case, geometry, stepper.fluids)
        between = choose_reservoir_measures(case, geometry, particles, stepper.fluids)
    loop = TimeLoop(case, stepper, particles.site_volume, box, _each_step(measures, between), whole)
    run = MovingRun(case, case.output.directory, clock, quiet, geometry, particles, stepper, loop, measures, cells,
                    seen, on_first(lambda: restart.record_of(case)), between=between, profiles=profiles)
    if drive_steps(case) is not None:
        loop.program = _program(run, between)
    saved = None
    if resume is not None:
        saved = restart.load(Path(resume) / restart.NAME, state, run.record)
        state = saved.state
        loop.resume(saved)
        run.record = _gone_on(case, Path(resume) / restart.NAME, saved, run.record, quiet)
        if Path(resume).resolve() == case.output.directory.resolve():  # in another directory all files begin anew
            run.since, run.last_step = state.time, state.step
    with progress.stage("neighbours and operators", quiet):
        state, _ = stepper.settled(state)
        if saved is not None:
            stepper.rebuild_hierarchies(saved.origins)
        ready = stepper.ready(state)
    _refuse_what_is_closed(case, stepper, ready.look())
    directory = case.output.directory
    run.directory = on_first(lambda: folder.prepare(directory))
    on_first(lambda: write_case(run.directory, case, run.record["changes"]))
    run.series = series_of(case, run.directory, run.since)
    if run.profiles is not None:
        run.tables[PROFILES] = ranks.table(run.directory / PROFILES, run.last_step)
        if current().first(run.tables[PROFILES].rows):
            run.profiled = on_first(lambda: read_history(run.directory / PROFILES)[-1]["step"])
    if loop.program is not None:
        run.tables[CURVE] = ranks.table(run.directory / CURVE, run.last_step)
    run.grids = grids_of(case, run.directory, run.since)
    return run, state, ready


def _refuse_what_is_closed(case: Case, stepper: Stepper, config: Configuration) -> None:
    """Raises ParticleError where no fluid leads through the scene along any axis of a flow that is held, or that is to
    become steady: before anything is written."""
    box = stepper.geometry.lower, stepper.geometry.upper
    assert case.time is not None
    axes: list[int] = []
    if stepper.held_velocity is not None:
        axes = [stepper.held_velocity.axis]
    elif case.time.steady is not None and not walls_move(case) and len({f.density for f in case.fluids.values()}) == 1:
        axes = driven_axes(case, box[1] - box[0])
    if axes and not any(opens(case, axis) and leads_through(config.ops, axis, box) for axis in axes):
        raise ParticleError(why_closed(case, *axes))


def _each_step(*measures: Measures | ReservoirMeasures | None) -> Callable[[State, Configuration], dict[str, Any]]:
    """A function that returns the entries of all given measures for a row of the history."""
    there = [measure for measure in measures if measure is not None]
    return lambda state, config: {name: value for measure in there for name, value in measure(state, config).items()}


def _program(run: MovingRun, between: ReservoirMeasures | None) -> DriveProgram:
    """The steps of the drive of a run; each writes a row of curve.csv. Raises CaseError where there is one fluid."""
    from .drive_steps import DriveProgram

    if between is None:
        what = "are of two fluids, and the scene has one: no particle is of the other"
        raise CaseError((Problem(*run.case.place_of("drive.steps"), "drive.steps", what,
                                 "see reservoirs and initial.flood, or give another drive"),))

    steps, measures, geometry = drive_steps(run.case), run.measures, run.geometry
    assert steps is not None and measures is not None
    areal = run.stepper.fluids.reference * float((geometry.upper - geometry.lower)[between.axis])

    def finished(number: int, value: float, settled: bool, state: State, config: Configuration) -> None:
        late = [past for past in run.history if past["time"] > state.time - program.window * (1.0 + 1e-9)]
        now = measures(state, config, everything=True) | between(state, config, everything=True)
        row: dict[str, Any] = {"step": state.step, "time": state.time, "drive_step": number + 1,
                               "settled": int(settled)}
        if steps.superficial_velocity:
            row["superficial_velocity"] = value
        for name, column in (("pressure_drop", f"pressure_drop_{'xyz'[between.axis]}"),
                             ("capillary_pressure", "capillary_pressure")):
            values = [past[column] for past in late if past.get(column) is not None]
            row[name] = float(np.mean(values)) if values else now.get(name)
            found = late_mean(late, column, state.time - program.window)
            row |= {f"{name}_error": None} if found is None else {name: found.mean, f"{name}_error": found.error}
        for kind in ("saturation", "ganglia", "trapped"):
            row |= {f"{kind}_{name}": now[f"{kind}_{name}"] for name in measures.names}
        run.tables[CURVE].append(row)

    program = DriveProgram(steps, between.axis, run.stepper, areal, between.saturation, finished)
    return program


def _time_loop(run: MovingRun, state: State, ready: Handover) -> tuple[State, Configuration]:
    """The time loop with its files; (state, config) at the end."""
    case, loop = run.case, run.loop
    assert case.time is not None
    # when a flow will be steady is unknown: `end` and `max_steps` only bound the run
    end = longest_time(case) if case.time.steady is None else None
    steady = case.time.steady
    steps = case.time.max_steps if steady is None else None
    with ExitStack() as tables, ranks.table(
        run.directory / "history.csv", run.last_step
    ) as file, ranks.interrupts() as look_for_interrupts, progress.Progress(
        end, steps, case.title, run.quiet
    ) as bar:
        for table in run.tables.values():
            tables.enter_context(table)  # closed at the end
        if current().first(file.rows):
            run.history = on_first(lambda: read_history(run.directory / "history.csv"))
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
            solves = found.solves
            bar.update(state.step, state.time, found.dt, limit, {k: r.iterations for k, r in solves.items()},
                       {k: r.residual for k, r in solves.items()} | {"divergence": found.max_divergence}
                       | ({} if loop.steady is None else {f"change (steady at {steady:g})": loop.steady.distance}))
            look_for_interrupts()

        try:
            state, config = loop.run(state, ready, run.snapshot, row, show)
            series = run.series or run.grids
            if series is None or not series.entries or series.entries[-1][0] < state.time:
                run.snapshot(state, config)
        except BaseException as stop:
            if run.may_save(stop):
                with run.clock("output"):
                    run.save(file)
            raise
        with run.clock("output"):
            run.save(file)
    return state, config


def _leave_worst(run: MovingRun, stop: BaseException) -> None:
    """Writes the worst particles of a step that failed."""
    from ..output.worst import NAME, write_worst

    if isinstance(stop, RunError) and current().size == 1:
        with suppress(OSError):
            assert run.loop.last is not None
            last = run.loop.last.state
            stop.worst = write_worst(run.directory / NAME, last.x, stop.violation, velocity=last.u, pressure=last.p)


def _gone_on(case: Case, path: Path, saved: restart.Saved, record: dict[str, Any], quiet: bool) -> dict[str, Any]:
    """The record of a case that goes on from a restart file; prints the values that it changes. Raises RestartError."""
    assert case.time is not None
    state, before = saved.state, len(saved.record["changes"])
    record = restart.resume(path, saved, record, case.time)
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
    """(axis or None, acceleration (dim,), m/s2) of the drive at the end; where a velocity is held, the steady value."""
    stepper = run.stepper
    force = stepper.fluids_at(state.time).force
    axis = int(np.argmax(np.abs(force)))
    if stepper.held_velocity is not None:
        assert state.pressure_gradient is not None
        axis = stepper.held_velocity.axis
        held = force[axis] + state.pressure_gradient * run.loop.steady_ratio(state)
        force = held * stepper.fluids.held
    return (axis if float(np.linalg.norm(force)) > 0.0 else None), force


def _flow_entries(run: MovingRun, state: State) -> Summary:
    """Entries of the summary on the flow at the end: velocities, and a permeability where a steady flow has one."""
    stepper, loop, two = run.stepper, run.loop, run.measures is not None
    axis, force = _drive_at_the_end(run, state)
    held, drop = stepper.held_velocity, _late_drop(run, state)
    known = None if held is None else (held.axis, held.flux(state.x, state.u))
    superficial, mean = mean_velocities(run.geometry, state.x, state.u, loop.site_volume, loop.thick, run.cells, known)
    along = None if axis is None else darcy(run.geometry, superficial, axis, force, stepper.fluids.nu_max)
    resisted = run.geometry.has_solid and not two and not walls_move(run.case)
    permeability = error = None
    if axis is not None and resisted and loop.outcome == "steady":
        assert along is not None and loop.steady is not None and loop.steady.distance is not None
        permeability = float(along[axis]) * (loop.steady_ratio(state) if held is None else 1.0)
        error = abs(permeability) * loop.steady.distance
    free = axis is not None and not run.geometry.has_solid and not two
    messages = [stopped_short(run.case, loop, state, run.directory), absent_fluids(run.case, run.particles),
                added_viscosity(stepper.fluids), "no permeability: no wall resists the flow" if free else None,
                *(f"changed by a restart from {line}" for line in restart.sentences(run.record, of_flow=True))]
    return {
        "message": "; ".join(filter(None, messages)) or None,
        "terms": [*used_physics(run.case, run.geometry, axis is not None),
                  *(used_physics_of_two(run.case, stepper.fluids) if two else ())],
        "permeability": permeability,
        "permeability_error": error,
        "superficial_velocity": superficial,
        "mean_velocity": mean,
        "pressure_drop": held.drop(state) if held is not None else None,
        **_entries_of("pressure_drop", drop),
    }


def _late_drop(run: MovingRun, state: State) -> LateMean | None:
    """The pressure drop of a velocity that is held over the last part of the run."""
    held = run.stepper.held_velocity
    return None if held is None else late_mean(run.history, f"pressure_drop_{'xyz'[held.axis]}", _late(run, state))


def _late(run: MovingRun, state: State) -> float:
    """When the last part of a run begins, over which its means are taken, s: of the time under the drive of its end,
    the last of its steps or what a restart made of it, and not before the history, which a restart in another folder
    begins anew."""
    began = [one["time"] for one in run.record["changes"] if any(key.startswith("drive") for key in one["changes"])]
    if run.loop.program is not None:
        began.append(run.loop.program.last_began(state))
    late = state.time - LAST * (state.time - max(began, default=0.0))
    return float(max([late, *(row["time"] - row["dt"] for row in run.history[:1])]))


def _entries_of(name: str, found: LateMean | None) -> dict[str, float]:
    """Entries of the summary of a mean over the last part of a run; none where there is none."""
    return {} if found is None else {f"{name}_{part}": value for part, value in found._asdict().items()}


def _finish(run: MovingRun, state: State, config: Configuration) -> tuple[Summary, Result]:
    """The summary and the flow of a run that has ended, its pictures, and its errors against the reference."""
    case, history = run.case, run.history
    flow = _flow_entries(run, state)
    result = Result(
        x=state.x, velocity=state.u, cell_velocity=state.u, pressure=state.p * run.pressure_unit,
        time=state.time, spacing=case.particles.spacing, phase=run.particles_at(state).phase,
        permeability=flow["permeability"], geometry=run.geometry, history=history,
    )
    summary: Summary = {
        "status": run.loop.outcome,
        "message": flow.pop("message"),
        "restarts": run.record["changes"],
        "warnings": run.seen.warnings,
        "particles": counts_of(run.particles_at(state), config.halo),
        **scene_entries(case, run.geometry, run.particles, (run.cells, run.loop.thick), run.seen),
        "terms": flow.pop("terms"),
        "steps": state.step,
        "time": state.time,
        **flow,
        "mass_error": None,  # of steady solves only; for moving particles profiles.csv has the flux of each slice
        "max_divergence": max((r["divergence"] for r in history), default=0.0),
        "iterations": {
            name: mean_max([r[f"iterations_{name}"] for r in history]) for name in ("velocity", "pressure")
        },
    }
    summary["warnings"].extend(filter(None, [noise_of_the_drop(_late_drop(run, state), run.geometry.has_solid)]))
    if run.measures is not None:
        _add_two_fluids(run, run.measures, summary, state, config)
        result.two_fluids = summary["two_fluids"]
    summary["speed"] = speed_distribution(state.u, part_of_sample(run.geometry, state.x, run.loop.thick))
    if current().size > 1:
        return _finish_ranks(run, summary, result, config), result
    return finish(case, run.directory, summary, result, run.clock,
                  lambda: _pictures(run, state, flow["permeability"]))


def _finish_ranks(run: MovingRun, summary: Summary, result: Result, config: Configuration) -> Summary:
    """The end of a run of several processes, by rank 0; returns the summary."""
    case = run.case
    summary["ranks"] = ranks.entry(len(result.x), config.ops.exchange, run.clock)
    if case.output.plots:
        summary["warnings"].append(ranks.NO_PICTURES)
    quiet_case = replace(case, output=replace(case.output, plots=False))
    compared = compare_with_reference(case, result, run.clock)
    return on_first(lambda: finish(quiet_case, run.directory, summary, result, run.clock, compared=compared)[0])


def _add_two_fluids(run: MovingRun, measures: Measures, summary: Summary, state: State, config: Configuration) -> None:
    """Adds the measures of two fluids to the summary."""
    from ..two_phase.measures import broke_up, misses_its_angle
    from ..two_phase.measures import summary as summary_of_two

    case = run.case
    driven = _drive_at_the_end(run, state)[0] is not None
    moved = driven or walls_move(case) or bool(case.reservoirs or (case.initial and case.initial.velocity))
    summary["two_fluids"] = summary_of_two(measures, state, config, run.history, moved)
    if run.between is not None:
        summary["two_fluids"] |= run.between(state, config, everything=True)
        found = late_mean(run.history, "capillary_pressure", _late(run, state))
        summary["two_fluids"] |= _entries_of("capillary_pressure", found)
    if not moved:
        said = [broke_up(measures.names, run.history, summary["two_fluids"])]
        if case.interface is not None:
            said.append(misses_its_angle(case.interface.contact_angle, run.history, summary["two_fluids"]))
        if any(said):
            summary.setdefault("warnings", []).extend(text for text in said if text)


def _pictures(run: MovingRun, state: State, permeability: float | None) -> None:
    """Draws a slice of the flow, two fluids, both in 3D, speeds and pores, histories, profiles, the curve of a drive in
    steps, and separately the numerical quantities."""
    from ..output.plots import (
        Frame,
        plot_curve,
        plot_histories,
        plot_numerics,
        plot_phases,
        plot_profiles,
        plot_slice,
    )

    case, geometry, two = run.case, run.geometry, run.measures is not None
    phase = run.particles_at(state).phase
    frame = Frame(geometry.dim, case.particles.spacing, case.title, geometry.lower, geometry.upper, geometry.periodic,
                  geometry.distance if geometry.has_solid else None)
    flow = {"x": state.x, "velocity": state.u} | ({"phase": phase} if two else {})
    with drawing_in_3d(run.directory, frame, geometry, flow, run.seen.warnings, case.fluid_names if two else ()):
        plot_slice(run.directory / "slice.png", state.x, state.u, frame, permeability=permeability,
                   phase=phase if two else None)
        draw_distributions(run.directory, case, geometry, state.x, state.u, case.particles.spacing)
        if two:
            plot_phases(run.directory / "phases.png", state.x, phase, case.fluid_names, frame, walls=geometry.has_solid)
        plot_histories(run.directory / "histories.png", run.history, case.title)
        plot_numerics(run.directory / "numerics.png", run.history, case.title)
        for name, plot in ((PROFILES, plot_profiles), (CURVE, plot_curve)):
            rows = read_history(run.directory / name) if name in run.tables and run.tables[name].rows else []
            if rows:
                plot((run.directory / name).with_suffix(".png"), rows, case.fluid_names, case.title)
