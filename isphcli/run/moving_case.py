"""Moving particles of a case: preparation, the time loop with its files, the summary."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import walls_move
from ..output import folder, progress, restart
from ..output.files import History, read_history
from ..references.result import Result
from ..scene import memory
from ..scene.build_geometry import build_geometry
from ..scene.prepare import prepare
from .permeability import darcy, fluid_cells
from .results import (
    Look,
    Seen,
    _absent_fluids,
    _added_viscosity,
    _counts,
    _finish,
    _mean_max,
    _scene_entries,
    _series,
    _snapshot,
    _stopped_short,
    _terms,
    _terms_of_two,
    _write_case,
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


def run_moving(case: Case, clock: Clock, quiet: bool, resume: str | Path | None, look: Look | None) -> dict[str, Any]:
    """Runs a case of moving particles, leaves its files and returns the summary; see `run.run_case`."""
    from ..flow.step_limits import RunError
    from ..output.worst import NAME, write_worst

    assert case.time is not None and case.output.directory is not None
    with clock("geometry"), progress.stage("geometry", quiet):
        geometry = build_geometry(case)
    memory.refuse_lattice(case, geometry, case.particles.spacing)
    seen = look(case, geometry, clock, quiet) if look is not None else Seen()
    state, stepper, particles = prepare(case, geometry, clock)
    density = np.array([fluid.density for fluid in case.fluids.values()])[particles.phase]
    box = float(np.prod(geometry.upper - geometry.lower))
    march = TimeLoop(case, stepper, particles.site_volume, density, box)
    if geometry.has_solid:
        with clock("geometry"):
            march.fluid_cells = fluid_cells(geometry, particles, whole=True)
    measures = None
    if len(np.unique(particles.phase)) > 1:
        from ..scene.choose_measures import choose_measures

        march.measure = measures = choose_measures(case, geometry, particles, stepper.fluids)
    since, last_step, record = None, None, restart.record_of(case)
    if resume is not None:
        saved = restart.load(Path(resume) / restart.NAME, state, record)
        state = saved.state
        march.take_up(saved)
        record = _gone_on(case, Path(resume) / restart.NAME, saved, record, quiet)
        if Path(resume).resolve() == case.output.directory.resolve():  # elsewhere its files begin anew
            since, last_step = state.time, state.step
    with progress.stage("neighbours and operators", quiet):
        config = stepper.configure(state.x)
        if resume is not None:
            stepper.rebuild_hierarchies(saved.origins)
    directory = folder.prepare(case.output.directory)
    _write_case(directory, case, record["changes"])
    series = _series(case, directory, since)
    history: list[dict[str, Any]] = []
    restart_file = directory / restart.NAME

    def snapshot(state: State, config: Configuration) -> None:
        from ..operators.apply import total_divergence

        if series is not None:
            with clock("output"):
                fields = _snapshot(case, geometry, particles, state.x, state.u, state.p * stepper.fluids.reference,
                                   total_divergence(config.ops, state.u))
                series.write(state.step, state.time, *fields)

    if last_step is None:
        snapshot(state, config)
    try:
        with History(directory / "history.csv", last_step) as file, progress.Progress(
            case.time.end, case.time.max_steps if case.time.end is None else None, case.title, quiet
        ) as bar:
            if file.rows:
                history = read_history(directory / "history.csv")
                if measures is not None:
                    measures.resume(history[-1])

            def row(values: dict[str, Any]) -> None:
                history.append(values)
                file.append(values)

            def save() -> None:
                if march.last is not None:
                    file.sync()  # a restart finds every row and every snapshot up to its step
                    restart.save(restart_file, march.last, record)

            def show(found: StepResult, limit: str) -> None:
                state = found.state
                if case.output.restart_every and state.step % case.output.restart_every == 0:
                    with clock("output"):
                        save()
                reports = found.reports
                bar.update(state.step, state.time, found.dt, limit, {k: r.iterations for k, r in reports.items()},
                           {k: r.residual for k, r in reports.items()} | {"divergence": found.max_divergence}
                           | ({"change": march.steady.distance} if march.steady is not None else {}))

            try:
                state, config = march.run(state, config, snapshot, row, show)
                if series is None or not series.entries or series.entries[-1][0] < state.time:
                    snapshot(state, config)
            finally:
                with clock("output"):
                    save()
    except BaseException as stop:
        stop.restart = restart_file if restart_file.exists() else None  # type: ignore[attr-defined]  # for `cli`
        if isinstance(stop, RunError):
            with suppress(OSError):
                assert march.last is not None
                last = march.last.state
                stop.worst = write_worst(directory / NAME, last.x, stop.violation, velocity=last.u,
                                                 pressure=last.p)
        raise
    try:
        return _finish_march(case, directory, clock, geometry, particles, march, stepper, state, config, history,
                             measures, seen, record)
    except KeyboardInterrupt as stop:
        stop.restart = restart_file  # type: ignore[attr-defined]  # for `cli`
        raise


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


def _finish_march(case: Case, directory: Path, clock: Clock, geometry: Geometry, particles: Particles, march: TimeLoop,
                  stepper: Stepper, state: State, config: Configuration, history: list[dict[str, Any]],
                  measures: Measures | None, seen: Seen, record: dict[str, Any]) -> dict[str, Any]:
    force = stepper.fluids.force
    two = measures is not None
    gravity = float(np.linalg.norm(force))
    axis = int(np.argmax(np.abs(force))) if gravity > 0.0 else None
    if stepper.held_velocity is not None:
        assert state.pressure_gradient is not None
        force = force[stepper.held_velocity.axis] + state.pressure_gradient * march.settled(state)
        force = force * stepper.fluids.held
        gravity = float(np.linalg.norm(force))
        axis = stepper.held_velocity.axis if gravity > 0.0 else None
    superficial, mean, along = darcy(geometry, state.x, state.u, particles.site_volume, axis, force,
                                     stepper.fluids.nu_max, fluid_cells(geometry, particles))
    resisted = geometry.has_solid and not two and not walls_move(case)
    permeability = error = None
    if axis is not None and resisted and march.outcome == "steady":
        assert along is not None and march.steady is not None and march.steady.distance is not None
        permeability = float(along[axis]) * (march.settled(state) if stepper.held_velocity is None else 1.0)
        error = abs(permeability) * march.steady.distance
    result = Result(
        x=state.x, velocity=state.u, cell_velocity=state.u, pressure=state.p * stepper.fluids.reference,
        time=state.time, spacing=case.particles.spacing,
        phase=particles.phase, permeability=permeability, geometry=geometry, history=history,
    )
    free = axis is not None and not geometry.has_solid and not two
    messages = [_stopped_short(case, march, state, directory), _absent_fluids(case, particles),
                _added_viscosity(stepper.fluids), "no permeability: no wall resists the flow" if free else None,
                *(f"changed by a restart from {line}" for line in restart.sentences(record, of_flow=True))]
    summary = {
        "status": march.outcome,
        "message": "; ".join(filter(None, messages)) or None,
        "restarts": record["changes"],
        "warnings": seen.warnings,
        "particles": _counts(particles, config.halo),
        **_scene_entries(case, geometry, particles, seen),
        "terms": _terms(case, geometry, gravity > 0.0) + (_terms_of_two(stepper.fluids) if two else []),
        "steps": state.step,
        "time": state.time,
        "permeability": permeability,
        "permeability_error": error,
        "superficial_velocity": superficial,
        "mean_velocity": mean,
        "pressure_drop": stepper.held_velocity.drop(state) if stepper.held_velocity is not None else None,
        "mass_error": 0.0,  # particles are neither made nor lost
        "max_divergence": max((r["divergence"] for r in history), default=0.0),
        "iterations": {
            name: _mean_max([r[f"iterations_{name}"] for r in history]) for name in ("velocity", "pressure")
        },
    }
    if measures is not None:
        from ..two_phase.measures import broke_up
        from ..two_phase.measures import summary as summary_of_two

        moved = gravity > 0.0 or walls_move(case) or bool(case.initial and case.initial.velocity)
        summary["two_fluids"] = summary_of_two(measures, state, config, history, moved)
        broken = None if moved else broke_up(measures.names, history, summary["two_fluids"])
        if broken:
            summary.setdefault("warnings", []).append(broken)
    if case.output.plots:
        from ..output.plots import plot_histories, plot_phases, plot_slice

        with clock("output"):
            plot_slice(directory / "slice.png", state.x, state.u, None, geometry.dim, case.particles.spacing,
                       case.title, lower=geometry.lower, upper=geometry.upper, permeability=permeability,
                       phase=particles.phase if two else None, periodic=geometry.periodic,
                       wall_distance=geometry.distance if geometry.has_solid else None)
            if two:
                plot_phases(directory / "phases.png", state.x, particles.phase, case.fluid_names, geometry.dim,
                            case.particles.spacing, case.title, geometry.lower, geometry.upper, geometry.has_solid,
                            periodic=geometry.periodic,
                            wall_distance=geometry.distance if geometry.has_solid else None)
            plot_histories(directory / "histories.png", history, case.title)
    return _finish(case, directory, summary, result, clock)
