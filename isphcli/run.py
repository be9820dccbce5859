"""A case from its file to its results: the one place that chooses which terms a scene has."""

import importlib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from . import output, progress, restart
from .case import CaseError, Problem, dump_case
from .drive import darcy, drives, held_axis, sample_box, walls_move
from .geometry import build_geometry
from .linear import SolveError


def run_case(case, quiet=False, resume=None):
    """Runs a case and leaves its files (docs/output.md) in case.output.directory. Returns the summary (dict).

    resume: directory whose restart.npz a run of moving particles goes on from.

    Raises ValueError (CaseError, VoxelError, ShapeError, ParticleError, NoFlowError) for a case that cannot run,
    before anything is written; SolveError, StepError or RunError for one that had to stop.
    """
    clock = output.Clock()
    with clock("compile"), _compile_listener(clock):  # imports of what the flow needs, and nothing else
        run = _run_stokes if case.flow == "stokes" else _run_navier_stokes
        solver = importlib.import_module(f".run_{case.flow}", __package__)
    with _compile_listener(clock):
        return run(case, solver, clock, quiet, resume)


def _compile_listener(clock):
    """Counts the time of the compiler as `compile`, at the cost of the section in which a kernel is first used."""
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

    return event.install_listener("numba:compiler_lock", Compiling())


# --- steady creeping flow ---------------------------------------------------------------------------------------


def _run_stokes(case, solver, clock, quiet, resume):
    if resume is not None:
        raise CaseError((Problem(str(case.path), None, "flow", "a steady solve has nothing to go on from",
                                 "run it without --restart"),))
    axes, flows, scene, history = _solve_stokes(case, solver, clock, quiet)
    summary, result = _sum_up_stokes(case, solver, axes, flows, scene, history)
    del scene  # hierarchies of large scenes leave no room for the files
    main = flows[axes[0][0], min((case.particles.spacing, *case.refine))]
    directory = output.prepare_directory(case.output.directory)
    with clock("output"), progress.stage("files and pictures", quiet):
        series = _series(case, directory)
        if series is not None:
            series.write(0, 0.0, *_snapshot(case, main.geometry, main.particles, result.x, main.velocity,
                                            main.pressure))
        with output.History(directory / "history.csv") as file:
            for row in history:
                file.append(row)
        if case.output.plots:
            _pictures(case, directory, main, next(iter((result.permeability or {}).values()), None))
    return _finish(case, directory, summary, result, clock)


def _solve_stokes(case, solver, clock, quiet):
    """Every spacing and axis of a steady case: (axes, {(axis, spacing): Creep}, the last Scene, rows of history)."""
    flows, history, scene = {}, [], None
    for spacing in (case.particles.spacing, *case.refine):
        scene, built_for = None, None
        first = build_geometry(case)
        axes = drives(case, first.dim)
        sealed = getattr(first, "sample_lower", None) is not None and not all(_periodic_of(case, first.dim))
        for axis, force in axes:
            if scene is None or (sealed and built_for != axis):
                with clock("geometry"), progress.stage(f"geometry at spacing {spacing:g}", quiet):
                    geometry = first if axis == axes[0][0] else build_geometry(case, axis)
                scene = None  # frees the matrices of the axis before
                with progress.stage("particles, operators and hierarchies", quiet):
                    needs = [a for a, _ in axes if a is not None] if not sealed else [axis] * (axis is not None)
                    scene = solver.build_scene(case, geometry, spacing, clock, needs)
                    refuse_second_fluid(case, scene.particles)
                    built_for = axis
            label = f"flow along {'xyz'[axis]}" if axis is not None else "flow driven by walls"
            with progress.stage(f"{label}, {scene.particles.n_fluid:,} particles", quiet) as stage:
                try:
                    flow = solver.solve_axis(case, scene, axis, force, clock, _watch(stage))
                except SolveError as error:
                    with suppress(OSError):
                        error.worst = _worst_of(case, scene, error)
                    raise
            flows[axis, spacing] = flow
            history.append({"step": len(history) + 1, "spacing": spacing,
                            "axis": "xyz"[axis] if axis is not None else "",
                            "iterations_stokes": flow.report.iterations, "residual_stokes": flow.report.residual,
                            **{f"superficial_velocity_{a}": float(v) for a, v in zip("xyz", flow.superficial)}})
            if axis is not None and flow.permeability[axis] <= 0.0:
                raise solver.NoFlowError(f"the flow along {'xyz'[axis]} is zero; check the drive and the labels")
    return axes, flows, scene, history


def _worst_of(case, scene, error):
    """Path of the particles with the largest residuals of a steady solve that failed."""
    from .failure import NAME, write_worst

    directory = output.prepare_directory(case.output.directory)
    return write_worst(directory / NAME, scene.particles.x[: scene.particles.n_fluid], error.badness)


def _sum_up_stokes(case, solver, axes, flows, scene, history):
    """(summary, result) of the flows of a steady case; the finest spacing of the first axis is what is written."""
    base = case.particles.spacing
    spacings = (base, *case.refine)
    main = flows[axes[0][0], min(spacings)]
    permeability, messages, bars, ladders = {}, [], {}, {}
    for axis, _ in axes:
        if axis is None:
            continue
        values = [flows[axis, h].permeability[axis] for h in spacings]
        permeability["xyz"[axis]] = float(values[0])
        ladders["xyz"[axis]] = {f"{h:g}": float(k) for h, k in sorted(zip(spacings, values))}
        if len(spacings) > 1:
            limit, bar, _, sentence = solver.extrapolate(spacings, values)
            messages.append(f"{'xyz'[axis]}: {sentence}")
            permeability["xyz"[axis]], bars["xyz"[axis]] = float(limit), bar
    tensor = None
    if len(permeability) == main.geometry.dim and not bars:
        tensor = np.array([flows["xyz".index(a), base].permeability for a in "xyz"[: main.geometry.dim]]).T
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
        "particles": _counts(main.particles, scene.halo),
        "porosity": _porosity(main.geometry, main.particles),
        "terms": _terms(case, main.geometry, _drive_of(axes))
        + (["flux-balanced divergence"] if scene.system.conservative else []),
        "steps": 0,
        "time": None,
        "permeability": single if single is not None else permeability or None,
        "permeability_error": (next(iter(bars.values())) if len(bars) == 1 else bars) or None,
        "permeability_by_spacing": ladders if len(spacings) > 1 else None,
        "permeability_tensor": tensor,
        "superficial_velocity": main.superficial,
        "mean_velocity": main.mean,
        "mass_error": main.mass_error,
        "max_divergence": main.divergence,
        "iterations": {"stokes": _mean_max([r["iterations_stokes"] for r in history])},
        "components": scene.system.count,
        "isolated_pockets": int((~scene.percolates.any(axis=1)).sum()),
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
               flow_axis=flow.axis, lower=flow.geometry.lower, upper=flow.geometry.upper, permeability=permeability)


# --- moving particles --------------------------------------------------------------------------------------------


def _run_navier_stokes(case, ns, clock, quiet, resume):
    from . import failure

    with clock("geometry"), progress.stage("geometry", quiet):
        geometry = build_geometry(case)
    state, stepper, particles = ns.prepare(case, geometry, clock)
    density = np.array([fluid.density for fluid in case.fluids.values()])[particles.phase]
    box = float(np.prod(geometry.upper - geometry.lower))
    march = ns.March(case, stepper, particles.site_volume, density, box)
    measures = None
    if len(np.unique(particles.phase)) > 1:
        from .measures import of_case

        march.measure = measures = of_case(case, geometry, particles, stepper.fluids)
    since, last_step = None, None
    if resume is not None:
        saved = restart.load(Path(resume) / restart.NAME, state)
        state = saved.state
        march.take_up(saved)
        if Path(resume).resolve() == case.output.directory.resolve():  # elsewhere its files begin anew
            since, last_step = state.time, state.step
    with progress.stage("neighbours and operators", quiet):
        config = stepper.configure(state.x)
        if resume is not None:
            stepper.take_up(saved.origins)
    directory = output.prepare_directory(case.output.directory, resume=last_step is not None)
    output.write_text(directory / "case.yaml", dump_case(case))
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
                    restart.save(restart_file, march.last)

            def show(state, dt, limit):
                if case.output.restart_every and state.step % case.output.restart_every == 0:
                    with clock("output"):
                        save()
                reports = stepper.reports
                bar.update(state.step, state.time, dt, limit, {k: r.iterations for k, r in reports.items()},
                           {k: r.residual for k, r in reports.items()} | {"divergence": stepper.divergence}
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
                stop.worst = failure.write_worst(directory / failure.NAME, last.x, stop.badness, velocity=last.u,
                                                 pressure=last.p)
        raise
    return _finish_march(case, directory, clock, geometry, particles, march, stepper, state, config, history, measures)


def _finish_march(case, directory, clock, geometry, particles, march, stepper, state, config, history, measures):
    force = stepper.fluids.force
    two = measures is not None
    gravity = np.linalg.norm(force)
    axis = int(np.argmax(np.abs(force))) if gravity > 0.0 else None
    if stepper.rate is not None:
        force = (force[stepper.rate.axis] + state.push * march.settled(state)) * stepper.fluids.held
        gravity = np.linalg.norm(force)
        axis = stepper.rate.axis if gravity > 0.0 else None
    superficial, mean, along = darcy(geometry, state.x, state.u, particles.site_volume, axis, force,
                                     stepper.fluids.stiffest)
    resisted = geometry.has_solid and not two and not walls_move(case)
    known = axis is not None and resisted and march.outcome == "steady"
    permeability = error = None
    if known:
        permeability = float(along[axis]) * (march.settled(state) if stepper.rate is None else 1.0)
        error = permeability * march.steady.distance
    result = SimpleNamespace(
        x=state.x, velocity=state.u, cell_velocity=state.u, pressure=state.p * stepper.fluids.reference,
        time=state.time, spacing=case.particles.spacing,
        phase=particles.phase, permeability=permeability, geometry=geometry, history=history, flows={}, tensor=None,
        density=stepper.fluids.reference,
    )
    free = axis is not None and not geometry.has_solid and not two
    messages = [_absent_fluids(case, particles), _added_viscosity(stepper.fluids),
                "no permeability: no wall resists the flow" if free else None, march.standing]
    summary = {
        "status": march.outcome,
        "message": "; ".join(filter(None, messages)) or None,
        "particles": _counts(particles, config.halo),
        "porosity": _porosity(geometry, particles),
        "terms": _terms(case, geometry, gravity > 0.0) + (_terms_of_two(stepper.fluids) if two else []),
        "steps": state.step,
        "time": state.time,
        "permeability": permeability,
        "permeability_error": error,
        "superficial_velocity": superficial,
        "mean_velocity": mean,
        "pressure_drop": stepper.rate.drop(state) if stepper.rate is not None else None,
        "mass_error": 0.0,  # particles are neither made nor lost
        "max_divergence": max((r["divergence"] for r in history), default=0.0),
        "iterations": {
            name: _mean_max([r[f"iterations_{name}"] for r in history]) for name in ("velocity", "pressure")
        },
    }
    if two:
        from .measures import summary as summary_of_two

        moved = gravity > 0.0 or bool(np.any(geometry.wall_velocity)) or bool(case.initial and case.initial.velocity)
        summary["two_fluids"] = summary_of_two(measures, state, config, history, moved)
    if case.output.plots:
        from .plots import plot_histories, plot_phases, plot_slice

        with clock("output"):
            plot_slice(directory / "slice.png", state.x, state.u, None, geometry.dim, case.particles.spacing,
                       case.title, lower=geometry.lower, upper=geometry.upper, permeability=permeability,
                       phase=particles.phase if two else None)
            if two:
                plot_phases(directory / "phases.png", state.x, particles.phase, case.fluid_names, geometry.dim,
                            case.particles.spacing, case.title, geometry.lower, geometry.upper, geometry.has_solid)
            plot_histories(directory / "histories.png", history, case.title)
    return _finish(case, directory, summary, result, clock)


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
    output.write_text(directory / "case.yaml", dump_case(effective))
    summary = {
        "title": case.title,
        **{k: summary[k] for k in ("status", "message")},
        "dimension": result.geometry.dim,
        **{k: v for k, v in summary.items() if k not in ("status", "message")},
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
        if fluids.artificial > 0.0:
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
