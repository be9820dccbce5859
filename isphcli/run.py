"""A case from its file to its results: the one place that chooses which terms a scene has."""

import importlib
import shlex
import sys
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from . import COMPLETE, folder, memory, output, progress, restart
from .case import CaseError, Problem, dump_case
from .drive import darcy, drives, held_axis, sample_box, walls_move
from .geometry import build_geometry, opens, why_closed
from .linear import SolveError
from .particles import lattice_at


def run_case(case, quiet=False, resume=None, overwrite=False):
    """Runs a case and leaves its files (docs/output.md) in case.output.directory. Returns the summary (dict).

    resume: directory whose restart.npz a run of moving particles goes on from.
    overwrite: replace results that the directory holds, those files that its manifest names.

    What the check of a case warns of stands in the summary as `warnings`, and on stderr before anything is solved
    unless `quiet`.

    Raises ValueError (CaseError, VoxelError, ShapeError, ParticleError, NoFlowError, FolderError, RestartError) for a
    case that cannot run, before anything is written; SolveError, StepError or RunError for one that had to stop.
    """
    directory = Path(case.output.directory)
    if resume is not None:
        if case.flow == "stokes":
            raise CaseError((Problem(str(case.path), None, "flow", "a steady solve has nothing to go on from",
                                     "run it without --restart"),))
        restart.require(Path(resume) / restart.NAME)
    goes_on = resume is not None and Path(resume).resolve() == directory.resolve()
    with folder.Folder(directory, _files(case), str(case.path) if case.path else None, goes_on, overwrite):
        return _run(case, quiet, resume)


def _files(case):
    """Patterns of all files that a run of the case may write, relative to its directory."""
    moving = case.flow != "stokes"
    names = ["case.yaml", "history.csv", "summary.json", "worst.vtu", *[restart.NAME] * moving]
    if case.output.snapshots:
        names += ["particles.pvd", f"{output.SNAPSHOTS}/particles_[0-9]*.vtu"]
    if case.output.plots:
        names += ["slice.png", *["phases.png", "histories.png"] * moving]
    return names


def _run(case, quiet, resume):
    clock = output.Clock()
    with clock("compile"), _compile_listener(clock):  # imports of what the flow needs, and nothing else
        run = _run_stokes if case.flow == "stokes" else _run_navier_stokes
        solver = importlib.import_module(f".run_{case.flow}", __package__)
    with _compile_listener(clock):
        return run(case, solver, clock, quiet, resume)


@contextmanager
def _compile_listener(clock):
    """Counts the time of the compiler as `compile`, at the cost of the section in which a kernel is first used, and
    tells the display of kernels that are not in the cache."""
    from numba.core import event

    class Compiling(event.Listener):
        depth, section = 0, None

        def on_start(self, _):
            if self.depth == 0:
                self.section = clock("compile")
                self.section.__enter__()
            self.depth += 1

        def on_end(self, _):
            self.depth -= 1
            if self.depth == 0:
                self.section.__exit__(None, None, None)

    class NotInCache(event.Listener):
        depth = 0

        def on_start(self, _):
            self.depth += 1
            progress.compiling(True)

        def on_end(self, _):
            self.depth -= 1
            progress.compiling(self.depth > 0)

    with event.install_listener("numba:compiler_lock", Compiling()):
        with event.install_listener("numba:compile", NotInCache()):
            yield


# --- steady creeping flow ---------------------------------------------------------------------------------------


def _run_stokes(case, solver, clock, quiet, resume):
    axes, flows, closed, history, seen = _solve_stokes(case, solver, clock, quiet)
    summary, result = _sum_up_stokes(case, solver, axes, flows, closed, history, seen)
    main = _main(flows)
    directory = folder.prepare(case.output.directory)
    with clock("output"), progress.stage("files and pictures", quiet):
        series = _series(case, directory)
        if series is not None:
            series.write(0, 0.0, *_snapshot(case, main.geometry, main.particles, result.x, main.velocity,
                                            main.pressure))
        with output.History(directory / "history.csv") as file:
            for row in history:
                file.append(row)
        if case.output.plots:
            _pictures(case, directory, main, (result.permeability or {}).get("xyz"[main.axis or 0]))
    return _finish(case, directory, summary, result, clock)


def _solve_stokes(case, solver, clock, quiet):
    """Every spacing and axis of a steady case: (axes, {(axis, spacing): StokesResult}, {(axis, spacing): why
    nothing flows, None: no path}, rows of history, _Seen). The matrices, which leave no room for the files, are gone
    when it returns.

    Raises NoPathError where nothing flows along any axis.
    """
    flows, closed, history, scene = {}, {}, [], None
    spacings = (case.particles.spacing, *case.refine)
    with clock("geometry"), progress.stage("geometry", quiet):
        first = build_geometry(case)
    axes = drives(case, first)
    sealed = getattr(first, "sample_lower", None) is not None and not all(_periodic_of(case, first.dim))
    driven = [axis for axis, _ in axes if axis is not None]
    if driven and not any(opens(case, axis) for axis in driven):
        raise solver.NoPathError(why_closed(case, *driven))
    for spacing in spacings:  # a finer one that does not fit is not found out after hours
        lattice_at(case, first, spacing)
        memory.refuse_lattice(case, first, spacing)
    seen = _look(case, first, clock, quiet)
    for spacing in spacings:
        scene, built_for = None, None
        for axis, force in axes:
            if scene is None or (sealed and built_for != axis):
                scene, built_for = None, axis  # frees the matrices of the axis before
                with clock("geometry"), progress.stage(f"geometry at spacing {spacing:g}", quiet):
                    geometry = first if axis == axes[0][0] else build_geometry(case, axis)
                needs = driven if not sealed else [axis] * (axis is not None)
                try:
                    with progress.stage("particles, operators and hierarchies", quiet):
                        scene = solver.build_scene(case, geometry, spacing, clock, needs)
                except solver.NoPathError:
                    closed |= {(a, spacing): None for a in needs}
                    if sealed:
                        continue
                    break
                refuse_second_fluid(case, scene.particles)
            if axis is not None and not scene.percolates[:, axis].any():
                closed[axis, spacing] = None
                continue
            label = f"flow along {'xyz'[axis]}" if axis is not None else "flow driven by walls"
            with progress.stage(f"{label}, {scene.particles.n_fluid:,} particles", quiet) as stage:
                try:
                    flow = solver.solve_axis(case, scene, axis, force, clock, _watch(stage))
                except SolveError as error:
                    with suppress(OSError):
                        error.worst = _worst_of(case, scene, error)
                    raise
            if axis is not None and flow.permeability[axis] <= 0.0:
                closed[axis, spacing] = f"the flow along {'xyz'[axis]} is zero; check the drive and what is solid"
                continue
            flows[axis, spacing] = flow
            history.append({"step": len(history) + 1, "spacing": spacing,
                            "axis": "xyz"[axis] if axis is not None else "",
                            "iterations_stokes": flow.report.iterations, "residual_stokes": flow.report.residual,
                            **{f"superficial_velocity_{a}": float(v) for a, v in zip("xyz", flow.superficial)}})
    if not flows:
        raise solver.NoPathError("; ".join(dict.fromkeys(filter(None, closed.values()))) or why_closed(case, *driven))
    return axes, flows, closed, history, seen


def _main(flows):
    """The flow that is written: at the finest spacing, along the first axis that has one."""
    return flows[min(flows, key=lambda key: key[1])]


def _worst_of(case, scene, error):
    """Path of the particles with the largest residuals of a steady solve that failed."""
    from .failure import NAME, write_worst

    directory = folder.prepare(case.output.directory)
    return write_worst(directory / NAME, scene.particles.x[: scene.particles.n_fluid], error.violation)


def _sum_up_stokes(case, solver, axes, flows, closed, history, seen):
    """(summary, result) of the flows of a steady case; the finest spacing of the first axis is what is written.

    Along an axis without a path the permeability is 0; of spacings, those count at which there is one.
    """
    base = case.particles.spacing
    spacings = (base, *case.refine)
    main = _main(flows)
    permeability, messages, bars, ladders = {}, [], {}, {}
    for axis, _ in axes:
        if axis is None:
            continue
        name = "xyz"[axis]
        known = {h: flows[axis, h].permeability[axis] if (axis, h) in flows else 0.0 for h in spacings}
        open_at = [h for h in spacings if (axis, h) in flows]
        ladders[name] = {f"{h:g}": float(k) for h, k in sorted(known.items())}
        permeability[name] = float(known[open_at[0]]) if open_at else 0.0
        if len(open_at) > 1:
            limit, bar, _, sentence = solver.extrapolate(open_at, [known[h] for h in open_at])
            messages.append(f"{name}: {sentence}")
            permeability[name], bars[name] = float(limit), bar
        if shut := [h for h in spacings if h not in open_at]:
            where = f"at the spacing {', '.join(f'{h:g}' for h in shut)} " if open_at else ""
            seen.warnings.append(where + (closed[axis, shut[0]] or why_closed(case, axis)))
        if name not in seen.open_axes and open_at:  # by particles that see each other, not by faces of sites
            seen.open_axes = [a for a in "xyz" if a == name or a in seen.open_axes]
        elif not open_at:
            seen.open_axes = [a for a in seen.open_axes if a != name]
    tensor, dim = None, main.geometry.dim
    # of sealed sides every axis is an experiment of its own: flow across it has nowhere to go
    if len(permeability) == dim and not bars and all(_periodic_of(case, dim)):
        columns = [flows.get((axis, base)) for axis in range(dim)]
        tensor = np.array([np.zeros(dim) if flow is None else flow.permeability for flow in columns]).T
    single = next(iter(permeability.values())) if len(permeability) == 1 else None
    fluid = next(iter(case.fluids.values()))
    result = SimpleNamespace(
        x=main.particles.x[: main.particles.n_fluid], velocity=main.velocity, cell_velocity=main.cell_velocity,
        pressure=main.pressure, time=None,
        spacing=main.spacing,
        phase=main.particles.phase, permeability=permeability or None, geometry=main.geometry, history=history,
        flows={"xyz"[a]: f for (a, h), f in flows.items() if a is not None and h == base}, tensor=tensor,
        density=fluid.density,
    )
    summary = {
        "status": "finished",
        "message": "; ".join(messages) or None,
        "warnings": seen.warnings,
        "particles": _counts(main.particles, main.halo),
        **seen.scene(main.geometry, main.particles),
        "terms": _terms(case, main.geometry, _drive_of(axes)) + (["flux-balanced divergence"] if main.balanced else []),
        "steps": 0,
        "time": None,
        "permeability": single if single is not None else permeability or None,
        "permeability_error": (next(iter(bars.values())) if len(bars) == 1 else bars) or None,
        "permeability_by_spacing": ladders if len(spacings) > 1 else None,
        "permeability_tensor": tensor,
        "superficial_velocity": main.superficial,
        "mean_velocity": main.mean,
        "mass_error": max(flow.mass_error for flow in flows.values()),
        "max_divergence": max(flow.divergence for flow in flows.values()),
        "iterations": {"stokes": _mean_max([r["iterations_stokes"] for r in history])},
        "components": main.components,
        "isolated_pockets": main.isolated_pockets,
    }
    return summary, result


def refuse_second_fluid(case, particles):
    """A steady solve knows the first fluid only."""
    first, *others = case.fluids.items()
    for k, (name, fluid) in enumerate(others, 1):
        if (fluid.density, fluid.mu) != (first[1].density, first[1].mu) and np.any(particles.phase == k):
            what = f"a steady solve has one fluid, and {name} is another than {first[0]}"
            raise CaseError((Problem(str(case.path), None, "flow", what, "use flow: navier_stokes"),))


def _periodic_of(case, dim):
    return [a in case.geometry.periodic for a in "xyz"[:dim]]


def _watch(stage):
    def watch(iteration, residual):
        stage.update(f"iteration {iteration}, residual {residual:.1e}")

    return watch


def _drive_of(axes):
    return any(force.any() for _, force in axes)


def _pictures(case, directory, flow, permeability):
    from .plots import plot_slice

    x = flow.particles.x[: flow.particles.n_fluid]
    plot_slice(directory / "slice.png", x, flow.velocity, None, flow.geometry.dim, flow.spacing, case.title,
               flow_axis=flow.axis, lower=flow.geometry.lower, upper=flow.geometry.upper, permeability=permeability,
               periodic=flow.geometry.periodic)


# --- moving particles --------------------------------------------------------------------------------------------


def _run_navier_stokes(case, ns, clock, quiet, resume):
    from . import failure

    with clock("geometry"), progress.stage("geometry", quiet):
        geometry = build_geometry(case)
    memory.refuse_lattice(case, geometry, case.particles.spacing)
    seen = _look(case, geometry, clock, quiet)
    state, stepper, particles = ns.prepare(case, geometry, clock)
    density = np.array([fluid.density for fluid in case.fluids.values()])[particles.phase]
    box = float(np.prod(geometry.upper - geometry.lower))
    march = ns.TimeLoop(case, stepper, particles.site_volume, density, box)
    measures = None
    if len(np.unique(particles.phase)) > 1:
        from .measures import of_case

        march.measure = measures = of_case(case, geometry, particles, stepper.fluids)
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
    history, restart_file = [], directory / restart.NAME

    def snapshot(state, config):
        from .operators import total_divergence

        if series is not None:
            with clock("output"):
                fields = _snapshot(case, geometry, particles, state.x, state.u, state.p * stepper.fluids.reference,
                                   total_divergence(config.ops, state.u))
                series.write(state.step, state.time, *fields)

    if last_step is None:
        snapshot(state, config)
    try:
        with output.History(directory / "history.csv", last_step) as file, progress.Progress(
            case.time.end, case.time.max_steps if case.time.end is None else None, case.title, quiet
        ) as bar:
            if file.rows:
                history = output.read_history(directory / "history.csv")
                if measures is not None:
                    measures.go_on(history[-1])

            def row(values):
                history.append(values)
                file.append(values)

            def save():
                if march.last is not None:
                    file.sync()  # a restart finds every row and every snapshot up to its step
                    restart.save(restart_file, march.last, record)

            def show(found, limit):
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
        stop.restart = restart_file if restart_file.exists() else None
        if isinstance(stop, failure.RunError):
            with suppress(OSError):
                last = march.last.state
                stop.worst = failure.write_worst(directory / failure.NAME, last.x, stop.violation, velocity=last.u,
                                                 pressure=last.p)
        raise
    try:
        return _finish_march(case, directory, clock, geometry, particles, march, stepper, state, config, history,
                             measures, seen, record)
    except KeyboardInterrupt as stop:
        stop.restart = restart_file
        raise


def _gone_on(case, path, saved, record, quiet):
    """The record of a case that goes on from a restart file; what it changes is said. Raises RestartError."""
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


def _write_case(directory, case, changes):
    """case.yaml: the effective case, behind the values that restarts have changed."""
    lines = restart.sentences({"changes": changes})
    head = ["# Changed by restarts, from the step on that is named (docs/output.md):", *(f"# {line}" for line in lines)]
    text = "".join(f"{line}\n" for line in head) if lines else ""
    output.write_text(directory / "case.yaml", text + dump_case(case))


def _finish_march(case, directory, clock, geometry, particles, march, stepper, state, config, history, measures, seen,
                  record):
    force = stepper.fluids.force
    two = measures is not None
    gravity = np.linalg.norm(force)
    axis = int(np.argmax(np.abs(force))) if gravity > 0.0 else None
    if stepper.held_velocity is not None:
        force = force[stepper.held_velocity.axis] + state.pressure_gradient * march.settled(state)
        force = force * stepper.fluids.held
        gravity = np.linalg.norm(force)
        axis = stepper.held_velocity.axis if gravity > 0.0 else None
    superficial, mean, along = darcy(geometry, state.x, state.u, particles.site_volume, axis, force,
                                     stepper.fluids.nu_max)
    resisted = geometry.has_solid and not two and not walls_move(case)
    known = axis is not None and resisted and march.outcome == "steady"
    permeability = error = None
    if known:
        permeability = float(along[axis]) * (march.settled(state) if stepper.held_velocity is None else 1.0)
        error = abs(permeability) * march.steady.distance
    result = SimpleNamespace(
        x=state.x, velocity=state.u, cell_velocity=state.u, pressure=state.p * stepper.fluids.reference,
        time=state.time, spacing=case.particles.spacing,
        phase=particles.phase, permeability=permeability, geometry=geometry, history=history, flows={}, tensor=None,
        density=stepper.fluids.reference,
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
        **seen.scene(geometry, particles),
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
    if two:
        from .measures import broke_up
        from .measures import summary as summary_of_two

        moved = gravity > 0.0 or bool(np.any(geometry.wall_velocity)) or bool(case.initial and case.initial.velocity)
        summary["two_fluids"] = summary_of_two(measures, state, config, history, moved)
        broken = None if moved else broke_up(measures.names, history, summary["two_fluids"])
        if broken:
            summary.setdefault("warnings", []).append(broken)
    if case.output.plots:
        from .plots import plot_histories, plot_phases, plot_slice

        with clock("output"):
            plot_slice(directory / "slice.png", state.x, state.u, None, geometry.dim, case.particles.spacing,
                       case.title, lower=geometry.lower, upper=geometry.upper, permeability=permeability,
                       phase=particles.phase if two else None, periodic=geometry.periodic)
            if two:
                plot_phases(directory / "phases.png", state.x, particles.phase, case.fluid_names, geometry.dim,
                            case.particles.spacing, case.title, geometry.lower, geometry.upper, geometry.has_solid,
                            periodic=geometry.periodic)
            plot_histories(directory / "histories.png", history, case.title)
    return _finish(case, directory, summary, result, clock)


def _stopped_short(case, march, state, directory):
    """A sentence on a run that ended before it had what was asked for; None where it had."""
    if march.outcome in COMPLETE:
        return None
    time = case.time
    by_steps = state.step >= time.max_steps
    cause = (f"time.max_steps, {time.max_steps}, came" if by_steps else f"time.end, {time.end:g} s, came") + " first"
    what, key = march.outcome, "time.max_steps" if by_steps else "time.end"
    if time.steady is not None:
        what = f"the flow is not steady: {march.standing}"
    return f"{what}; {cause}. Go on with: isph run --restart {shlex.quote(str(directory))} --set {key}=..."


# --- what both leave ---------------------------------------------------------------------------------------------


def _finish(case, directory, summary, result, clock):
    """Errors against the reference, the effective case and summary.json, which is left too where there is nothing to
    compare: CompareError comes after it."""
    errors = incomparable = None
    if case.reference is not None:
        with clock("reference"):
            from .compare import CompareError, compare

            try:
                errors = compare(case, result)
            except CompareError as error:
                incomparable = error
                summary["message"] = "; ".join(filter(None, [summary["message"], f"no errors: {error}"]))
    import numba

    effective = replace(case, output=replace(case.output, directory=directory))
    _write_case(directory, effective, summary.get("restarts", ()))
    summary = {
        "title": case.title,
        **{k: summary[k] for k in ("status", "message", "warnings")},
        "dimension": result.geometry.dim,
        **{k: v for k, v in summary.items() if k not in ("status", "message", "warnings")},
        "errors": errors,
        "cpu_seconds": clock.cpu(),
        "wall_seconds": clock.wall(),
        "peak_memory_bytes": output.peak_memory(),
        "threads": numba.get_num_threads(),
        "versions": output.versions(),
    }
    output.write_summary(directory / "summary.json", summary)
    if incomparable is not None:
        raise incomparable
    summary["directory"] = str(directory)
    summary["pictures"] = sorted(str(p) for p in Path(directory).glob("*.png"))
    return summary


class _Seen:
    """What was seen of a scene before anything was solved: `warnings`, `open_axes` (names of the axes along which
    pores lead through the sample, of a scene with walls) and `throats` (check.Throats or None)."""

    def __init__(self, case, found, geometry):
        self.voxels = case.geometry.voxels
        self.inputs = [f"{name}: {text}" for name, text in geometry.described]
        self.warnings = list(dict.fromkeys(found.warnings))
        self.throats = found.throats
        leads = found.connectivity.percolates if geometry.has_solid and found.connectivity is not None else ()
        self.open_axes = [name for name, open_ in zip("xyz", leads) if open_]

    def scene(self, geometry, particles):
        """Entries of the summary on the scene that was run."""
        image = throats = None
        if self.voxels is not None:
            voxel = np.asarray(geometry.voxel_size)
            lower, upper = sample_box(geometry)
            image = {"size": np.rint((upper - lower) / voxel).astype(int), "voxel_size": voxel,
                     "axes": self.voxels.axes}
        if self.throats is not None:
            throats = {"narrow": self.throats.narrow, "median": self.throats.median, "thin": self.throats.thin}
        return {"inputs": self.inputs, "image": image, "porosity": _porosity(geometry, particles),
                "open_axes": self.open_axes if geometry.has_solid else None, "throats": throats}


def _look(case, geometry, clock, quiet):
    """_Seen of a case that is about to run; what is warned of stands on stderr unless `quiet`.

    On Berea (128^3 voxels) it took 1.5 s on an idle core, 5 s on a busy one: the lattice is looked at,
    no neighbours are searched.
    """
    from .check import check

    with clock("check"), progress.stage("check of the scene", quiet):
        found = check(case, geometry, to_run=True)
    seen = _Seen(case, found, geometry)
    if not quiet:
        for text in seen.warnings:
            print(f"warning: {text}", file=sys.stderr, flush=True)
    return seen


def _series(case, directory, resume_time=None):
    return output.Series(directory, resume_time=resume_time) if case.output.snapshots else None


def _snapshot(case, geometry, particles, x, velocity, pressure, divergence=None):
    """(positions, fields) of a snapshot, dummies behind the fluid where they are asked for."""
    known = {"velocity": velocity, "pressure": pressure, "phase": particles.phase.astype(np.int32)}
    if divergence is not None:
        known["divergence"] = divergence
    if "distance" in case.output.fields and geometry.has_solid:
        known["distance"] = geometry.distance(x)
    fields = {name: known[name] for name in case.output.fields if name in known}
    if not case.output.dummies or particles.n_dummy == 0:
        return x, fields
    dummies = particles.x[particles.n_fluid:]
    rest = {"phase": np.full(len(dummies), -1, np.int32)}
    if "distance" in fields:
        rest["distance"] = geometry.distance(dummies)
    joined = {name: np.concatenate([v, rest.get(name, np.zeros((len(dummies), *v.shape[1:]), v.dtype))])
              for name, v in fields.items()}
    joined["kind"] = np.repeat(np.array([0, 1], np.int32), [len(x), len(dummies)])
    return np.concatenate([x, dummies]), joined


def _counts(particles, halo):
    return {"fluid": particles.n_fluid, "dummy": particles.n_dummy, "halo": halo, "left_out": particles.left_out}


def _porosity(geometry, particles):
    """Fluid share of the sample (of an image without its clear layers), by lattice sites."""
    lower, upper = sample_box(geometry)
    x = particles.x[: particles.n_fluid]
    inside = int(np.all((x >= lower) & (x <= upper), axis=1).sum())
    return inside * particles.site_volume / float(np.prod(upper - lower))


def _terms(case, geometry, driven):
    terms = ["viscosity", "pressure"]
    if held_axis(case) is not None:
        terms.append("held velocity")
    if driven and (held_axis(case) is None or case.drive.body_force):
        terms.append("body force")
    if geometry.has_solid:
        terms.append("walls")
        if np.any(geometry.wall_speed):
            terms.append("moving walls")
        if np.any(geometry.slip_length > 0.0):
            terms.append("slip walls")
    if any(geometry.periodic):
        terms.append("periodic halo")
    if case.flow == "navier_stokes" and case.particles.shifting > 0.0:
        terms.append("shifting")
    if case.flow == "navier_stokes" and case.particles.keep_volume > 0.0:
        terms.append("kept volume")
    return terms


def _terms_of_two(fluids):
    """Of a scene in which two fluids are present. fluids: TwoFluids, or OneFluid where only their names differ."""
    terms = ["two fluids"]
    if getattr(fluids, "phase", None) is None:
        return terms
    if fluids.density[0] != fluids.density[1]:
        terms.append("density jump")
    if fluids.mu[0] != fluids.mu[1]:
        terms.append("viscosity jump")
    if fluids.tension is not None:
        terms.append(f"surface tension ({fluids.tension.method})")
        if fluids.tension.contact is not None:
            terms.append("contact angle")
        if fluids.added_viscosity > 0.0:
            terms.append("artificial viscosity at the interface")
        if fluids.line is not None:
            terms.append("slip at contact lines")
    return terms


def _added_viscosity(fluids):
    """A sentence on what an interface that hardly damps gets; None where nothing is added."""
    added = getattr(fluids, "artificial", 0.0)
    return (f"{added:.2g} Pa s are added to the viscosity at the interface, whose roughness its own would not hold at "
            "this spacing (docs/method.md 12)") if added else None


def _absent_fluids(case, particles):
    """A sentence on the fluids that the case names and the scene does not have; None where all are there."""
    absent = [name for k, name in enumerate(case.fluid_names) if not np.any(particles.phase == k)]
    return f"no particle is of the fluid {' or '.join(absent)}: run as a single fluid" if absent else None


def _mean_max(counts):
    return {"mean": float(np.mean(counts)), "max": int(max(counts))} if counts else {"mean": 0.0, "max": 0}
