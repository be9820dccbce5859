"""Steady creeping flow of a case: every spacing and axis, summary and files."""

from __future__ import annotations

import itertools
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import drives, opens, why_closed
from ..case.yaml import CaseError, Problem
from ..output import folder, progress
from ..output.files import History
from ..references.result import Result
from ..scene import memory
from ..scene.build_geometry import build_geometry
from ..scene.place import lattice_at
from ..solvers.krylov import SolveError
from . import steady
from .expected_error import expected, scan_of, wall_of
from .permeability import EDGE, extrapolate
from .refinement import Solved, further_spacings
from .results import Look, Seen, counts_of, finish, mean_max, scene_entries, series_of, snapshot_of, terms_of

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..output.clock import Clock
    from ..solvers.krylov import Watch

Drives = list[tuple[int | None, np.ndarray]]  # (axis or None, acceleration (dim,), m/s2), see `drives`
Flows = dict[tuple[int | None, float], steady.StokesResult]  # by axis and spacing, m
Closed = dict[tuple[int | None, float], str | None]  # why nothing flows, None: no path
Rows = list[dict[str, Any]]  # of the history


def run_steady(case: Case, clock: Clock, quiet: bool, look: Look | None) -> dict[str, Any]:
    """Solves a steady case, leaves its files and returns the summary; see `run.run_case`."""
    case, axes, flows, closed, history, seen = _solve(case, clock, quiet, look)
    summary, result = _sum_up(case, axes, flows, closed, history, seen)
    main = _main(flows)
    if case.geometry.voxels is not None and case.geometry.voxels.grey is not None:
        from .image_uncertainty import by_threshold

        at_own = {axis: _along(flow, axis) for (axis, h), flow in flows.items()
                  if axis is not None and h == case.particles.spacing}
        summary["permeability_by_threshold"] = by_threshold(case, axes, at_own, clock, quiet, seen.warnings)
    assert case.output.directory is not None
    directory = folder.prepare(case.output.directory)
    with clock("output"), progress.stage("files and pictures", quiet):
        series = series_of(case, directory)
        if series is not None:
            series.write(0, 0.0, *snapshot_of(case, main.geometry, main.particles, result.x, main.velocity,
                                              main.pressure))
        with History(directory / "history.csv") as file:
            for row in history:
                file.append(row)
        if case.output.plots:
            known = result.permeability if isinstance(result.permeability, dict) else {}
            _pictures(case, directory, main, known.get("xyz"[main.axis or 0]))
    return finish(case, directory, summary, result, clock)


def _solve(case: Case, clock: Clock, quiet: bool,
           look: Look | None) -> tuple[Case, Drives, Flows, Closed, Rows, Seen]:
    """Every spacing and axis of a steady case: (the case with the spacings that were chosen, axes, {(axis, spacing):
    StokesResult}, {(axis, spacing): why nothing flows, None: no path}, rows of history, Seen). The matrices, which
    leave no room for the files, are gone when it returns.

    Raises NoPathError where nothing flows along any axis.
    """
    flows: Flows = {}
    closed: Closed = {}
    history: Rows = []
    scene: steady.SteadyScene | None
    automatic = case.refine == "auto"
    with clock("geometry"), progress.stage("geometry", quiet):
        first = build_geometry(case)
    axes = drives(case, first)
    sealed = first.voxel_size is not None and not all(_periodic_of(case, first.dim))
    driven = [axis for axis, _ in axes if axis is not None]
    if driven and not any(opens(case, axis) for axis in driven):
        raise steady.NoPathError(why_closed(case, *driven))
    for spacing in case.spacings:  # a finer one that does not fit is not found out after hours
        lattice_at(case, first, spacing)
        memory.refuse_lattice(case, first, spacing)
    seen = look(case, first, clock, quiet) if look is not None else Seen()
    solved: list[Solved] = []
    further = further_spacings(case, first, solved) if automatic else iter(())
    for spacing in itertools.chain(case.spacings, further):
        scene = built_for = None
        started, particles = _seconds(clock), 0
        for axis, force in axes:
            if scene is None or (sealed and built_for != axis):
                scene, built_for = None, axis  # frees the matrices of the axis before
                with clock("geometry"), progress.stage(f"geometry at spacing {spacing:g}", quiet):
                    geometry = first if axis == axes[0][0] else build_geometry(case, axis)
                needs = driven if not sealed else [] if axis is None else [axis]
                try:
                    with progress.stage("particles, operators and hierarchies", quiet):
                        scene = steady.build_scene(case, geometry, spacing, clock, needs)
                except steady.NoPathError:
                    closed |= {(a, spacing): None for a in needs}
                    if sealed:
                        continue
                    break
                refuse_second_fluid(case, scene.particles)
                particles = scene.particles.n_fluid
            if axis is not None and not scene.percolates[:, axis].any():
                closed[axis, spacing] = None
                continue
            label = f"flow along {'xyz'[axis]}" if axis is not None else "flow driven by walls"
            with progress.stage(f"{label}, {scene.particles.n_fluid:,} particles", quiet) as stage:
                try:
                    flow = steady.solve_axis(case, scene, axis, force, clock, _watch(stage))
                except SolveError as error:
                    if solved:  # the spacings that the case names have their results
                        seen.warnings.append(f"refine: auto left out the spacing {spacing:g}: {error}")
                        flows = {key: other for key, other in flows.items() if key[1] != spacing}
                        particles = 0
                        break
                    with suppress(OSError):
                        error.worst = _worst_of(case, scene, error)
                    raise
            if axis is not None and _along(flow, axis) <= 0.0:
                closed[axis, spacing] = f"the flow along {'xyz'[axis]} is zero; check the drive and what is solid"
                continue
            flows[axis, spacing] = flow
            history.append({"step": len(history) + 1, "spacing": spacing,
                            "axis": "xyz"[axis] if axis is not None else "",
                            "iterations_stokes": flow.report.iterations, "residual_stokes": flow.report.residual,
                            **{f"superficial_velocity_{a}": float(v) for a, v in zip("xyz", flow.superficial)}})
        if automatic and particles:
            solved.append(Solved(spacing, particles, _seconds(clock) - started))
            scene = None  # its memory is free when the next spacing is chosen
    if automatic:
        case = replace(case, refine=tuple(level.spacing for level in solved[1:]))
        if len(solved) == 1:
            seen.warnings.append(f"refine: auto: no further spacing fits refine_budget, {case.refine_budget:g} s, and "
                                 "the memory that is free: no error bar")
    if not flows:
        raise steady.NoPathError("; ".join(dict.fromkeys(filter(None, closed.values()))) or why_closed(case, *driven))
    return case, axes, flows, closed, history, seen


def _seconds(clock: Clock) -> float:
    """Wall seconds so far, without those of the compiler."""
    spent = clock.wall()
    return spent["total"] - spent.get("compile", 0.0)


def _main(flows: Flows) -> steady.StokesResult:
    """The flow that is written: at the finest spacing, along the first axis that has one."""
    return flows[min(flows, key=lambda key: key[1])]


def _worst_of(case: Case, scene: steady.SteadyScene, error: SolveError) -> Path | None:
    """Path of the particles with the largest residuals of a steady solve that failed."""
    from ..output.worst import NAME, write_worst

    assert case.output.directory is not None
    directory = folder.prepare(case.output.directory)
    return write_worst(directory / NAME, scene.particles.x[: scene.particles.n_fluid], error.violation)


def _sum_up(case: Case, axes: Drives, flows: Flows, closed: Closed, history: Rows,
            seen: Seen) -> tuple[dict[str, Any], Result]:
    """(summary, result) of the flows of a steady case; the finest spacing of the first axis is what is written.

    Along an axis without a path the permeability is 0; of spacings, those count at which there is one.
    """
    base = case.particles.spacing
    spacings = case.spacings
    main = _main(flows)
    permeability: dict[str, float] = {}
    messages: list[str] = []
    bars: dict[str, float] = {}
    images: dict[str, float] = {}
    ranges: dict[str, tuple[float, float]] = {}
    sources: list[str] = []
    wall, scan = wall_of(case), scan_of(main.geometry)
    scene = scene_entries(case, main.geometry, main.particles, seen)
    ladders: dict[str, dict[str, float]] = {}
    for axis, _ in axes:
        if axis is None:
            continue
        name = "xyz"[axis]
        known = {h: _along(flows[axis, h], axis) if (axis, h) in flows else 0.0 for h in spacings}
        open_at = [h for h in spacings if (axis, h) in flows]
        ladders[name] = {f"{h:g}": float(k) for h, k in sorted(known.items())}
        permeability[name] = float(known[open_at[0]]) if open_at else 0.0
        if len(open_at) > 1:
            edges = EDGE if wall == "stairs" else None
            limit, bar, _, sentence = extrapolate(open_at, [known[h] for h in open_at], edges)
            messages.append(f"{name}: {sentence}")
            permeability[name], bars[name] = float(limit), bar
        if permeability[name] > 0.0:
            found = expected(wall, permeability[name], scene["porosity"], open_at[0], scan, bars.get(name))
            ranges[name] = found.bounds(permeability[name])
            sources.append(f"{name}: {found.sentence}")
            if scan is not None:
                images[name] = found.image * permeability[name]
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
    result = Result(
        x=main.particles.x[: main.particles.n_fluid], velocity=main.velocity, cell_velocity=main.cell_velocity,
        pressure=main.pressure, time=None,
        spacing=main.spacing,
        phase=main.particles.phase, permeability=permeability or None, geometry=main.geometry, history=history,
        tensor=tensor,
    )
    summary = {
        "status": "finished",
        "message": "; ".join(messages) or None,
        "warnings": seen.warnings,
        "particles": counts_of(main.particles, main.halo),
        **scene,
        "terms": terms_of(case, main.geometry, _drive_of(axes))
                 + (["adjoint divergence in narrow pores"] if main.narrow else []),
        "steps": 0,
        "time": None,
        "permeability": single if single is not None else permeability or None,
        "permeability_error": (next(iter(bars.values())) if len(bars) == 1 else bars) or None,
        "permeability_image_error": (next(iter(images.values())) if len(images) == 1 else images) or None,
        "permeability_range": (next(iter(ranges.values())) if single is not None and ranges else ranges) or None,
        "permeability_range_from": "; ".join(sources) or None,
        "permeability_by_spacing": ladders if len(spacings) > 1 else None,
        "permeability_tensor": tensor,
        "superficial_velocity": main.superficial,
        "mean_velocity": main.mean,
        "mass_error": max(flow.mass_error for flow in flows.values()),
        "max_divergence": max(flow.divergence for flow in flows.values()),
        "iterations": {"stokes": mean_max([r["iterations_stokes"] for r in history])},
        "components": main.components,
        "isolated_pockets": main.isolated_pockets,
    }
    return summary, result


def _along(flow: steady.StokesResult, axis: int) -> float:
    """Permeability along the axis of a flow, m2."""
    assert flow.permeability is not None
    return flow.permeability[axis]


def refuse_second_fluid(case: Case, particles: Particles) -> None:
    """A steady solve knows the first fluid only."""
    first, *others = case.fluids.items()
    for k, (name, fluid) in enumerate(others, 1):
        if (fluid.density, fluid.mu) != (first[1].density, first[1].mu) and np.any(particles.phase == k):
            what = f"a steady solve has one fluid, and {name} is another than {first[0]}"
            raise CaseError((Problem(str(case.path), None, "flow", what, "use flow: navier_stokes"),))


def _periodic_of(case: Case, dim: int) -> list[bool]:
    return [a in case.geometry.repeats for a in "xyz"[:dim]]


def _watch(stage: progress.stage) -> Watch:
    def watch(iteration: int, residual: float) -> None:
        stage.update(f"iteration {iteration}, residual {residual:.1e}")

    return watch


def _drive_of(axes: Drives) -> bool:
    return any(force.any() for _, force in axes)


def _pictures(case: Case, directory: Path, flow: steady.StokesResult, permeability: float | None) -> None:
    from ..output.plots import Frame, plot_slice

    x, geometry = flow.particles.x[: flow.particles.n_fluid], flow.geometry
    frame = Frame(geometry.dim, flow.spacing, case.title, geometry.lower, geometry.upper, geometry.periodic,
                  geometry.distance, flow_axis=flow.axis)
    plot_slice(directory / "slice.png", x, flow.velocity, frame, permeability=permeability)
