"""Steady creeping flow of a case: every spacing and axis, summary and files."""

from __future__ import annotations

import itertools
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import drives, opens, why_closed
from ..case.yaml import CaseError, Problem
from ..domain import reduce
from ..domain.communicator import as_first, current, on_first
from ..domain.lattice import ParticleError
from ..geometry.extents import part_of_sample
from ..output import folder, progress
from ..output.files import write_rows
from ..output.lines import permeability_lines, table
from ..references.result import Result
from ..scene import memory
from ..scene.build_geometry import build_geometry
from ..scene.place import lattice_at
from ..solvers.krylov import SolveError
from . import ranks, steady
from .expected_error import (
    THINNEST,
    expected,
    grain_chord,
    has_edges,
    pore_width,
    scan_of,
    slip_error,
    slip_of,
    too_narrow,
    usual_error,
    wall_of,
)
from .flow_measures import profile_rows, speed_distribution, tortuosity
from .permeability import EDGE, SHARE, extrapolate
from .refinement import Solved, further_spacings
from .results import (
    PROFILES,
    Look,
    Seen,
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
    used_physics,
    write_grid,
)

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..geometry.protocol import Geometry
    from ..output.clock import Clock
    from ..solvers.krylov import Watch
    from .half_in_throats import InThroats

# Of the bar of the formation factor over the differences of its spacings: 90 % of pairs and 98 % of triples of spacings
# on arrays of insulating cylinders and spheres keep within it (`python benchmarks/formation_factor.py`)
DIFFUSION_BAR = 2.35
DIFFUSION = 1.0  # order of the error of the formation factor beside round obstacles (docs/method.md 8)

Drives = list[tuple[int | None, np.ndarray]]  # (axis or None, acceleration (dim,), m/s2), see `drives`
Flows = dict[tuple[int | None, float], steady.StokesResult]  # by axis and spacing, m
Closed = dict[tuple[int | None, float], str | None]  # why nothing flows, None: no path
Rows = list[dict[str, Any]]  # of the history


@dataclass
class Found:
    """The results of the solves of a steady case so far, by axis and spacing."""

    flows: Flows = field(default_factory=dict)
    closed: Closed = field(default_factory=dict)
    history: Rows = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    stopped: KeyboardInterrupt | None = None  # the interrupt that ended the solves after at least one spacing


@dataclass(frozen=True)
class Job:
    """The objects that all spacings of a steady case share.

    geometries: by axis, the first one and, where there are several spacings, those that were needed since; sealed: an
    image whose sides are closed but along the axis of the flow, so that every axis has a geometry and matrices of its
    own.
    """

    case: Case
    geometries: dict[int | None, Geometry]
    axes: Drives
    sealed: bool
    clock: Clock
    quiet: bool

    @property
    def driven(self) -> list[int]:
        """Axes along which a permeability is asked for."""
        return [axis for axis, _ in self.axes if axis is not None]

    def needs(self, axis: int | None) -> list[int]:
        """Axes along at least one of which fluid must percolate for the matrices of an axis."""
        return self.driven if not self.sealed else [] if axis is None else [axis]


def run_steady(case: Case, clock: Clock, quiet: bool, look: Look | None) -> tuple[dict[str, Any], Result]:
    """Solves a steady case and leaves its files; see `run.solve_case`. Where it is interrupted when a spacing is
    solved already, the files are of the spacings that are, before KeyboardInterrupt goes on."""
    case, axes, found, seen = _solve(case, clock, quiet, look)
    summary, result = _sum_up(case, axes, found, seen)
    main = _main(found.flows)
    if found.stopped is not None:
        summary["status"] = "interrupted"
        summary["message"] = "interrupted before all spacings of refine were solved: what stands here is of the others"
        case = replace(case, output=replace(case.output, plots=False))
    elif case.geometry.voxels is not None and case.geometry.voxels.grey is not None:
        from .image_uncertainty import by_threshold

        at_own = {axis: _along(flow, axis) for (axis, h), flow in found.flows.items()
                  if axis is not None and h == case.particles.spacing}
        summary["permeability_by_threshold"] = by_threshold(case, axes, at_own, clock, quiet, seen.warnings)
    if current().size > 1:
        return _finish_ranks(case, summary, result, found, clock), result
    assert case.output.directory is not None
    directory = folder.prepare(case.output.directory)
    rows = _profile(main)
    try:
        with clock("output"), progress.stage("files", quiet):
            _write_fields(case, directory, main, result.x)
            write_rows(directory / "history.csv", found.history)
            write_rows(directory / PROFILES, rows)
    except OSError as error:  # a full disk: what was solved for is said at least
        error.found = table(permeability_lines(summary))  # type: ignore[attr-defined]  # for `cli`
        raise

    def draw() -> None:
        with progress.stage("pictures", quiet):
            _pictures(case, directory, main, found.flows, summary, rows)

    try:
        finished = finish(case, directory, summary, result, clock, draw)
        if found.stopped is not None:
            raise found.stopped
    except KeyboardInterrupt as stop:
        stop.results = directory  # type: ignore[attr-defined]  # for `cli`
        raise
    return finished


def _write_fields(case: Case, directory: Path, main: steady.StokesResult, x: np.ndarray) -> None:
    """The snapshot of a flow, and its fields on a grid where they are asked for. x: (n, dim) of its particles, m."""
    series = series_of(case, directory)
    if series is not None:
        series.write(0, 0.0, *snapshot_of(case, main.geometry, main.particles, x, main.velocity, main.pressure))
    write_grid(grids_of(case, directory), case, main.geometry, main.particles, (0, 0.0),
               (x, main.velocity, main.pressure), main.spacing)


def _finish_ranks(case: Case, summary: dict[str, Any], result: Result, found: Found, clock: Clock) -> dict[str, Any]:
    """The files of several processes: a snapshot of each, all else by rank 0; returns the summary."""
    main, output = _main(found.flows), case.output
    assert output.directory is not None
    share = main.particles.share
    assert share is not None
    summary["ranks"] = ranks.entry(main.particles.n_fluid, share.exchange, clock)
    if output.plots:
        summary["warnings"].append(ranks.NO_PICTURES)
    directory: Path = on_first(lambda: folder.prepare(output.directory))  # type: ignore[arg-type]
    with clock("output"):
        _write_fields(case, directory, main, result.x)
        compared, rows = compare_with_reference(case, result, clock), _profile(main)

        def rest() -> dict[str, Any]:
            write_rows(directory / "history.csv", found.history)
            write_rows(directory / PROFILES, rows)
            quiet_case = replace(case, output=replace(output, plots=False))
            return finish(quiet_case, directory, summary, result, clock, compared=compared)[0]

        return on_first(rest)


def _solve(case: Case, clock: Clock, quiet: bool, look: Look | None) -> tuple[Case, Drives, Found, Seen]:
    """Every spacing and axis of a steady case: (the case with the spacings that were chosen, axes, Found, Seen). The
    matrices, which leave no room for the files, are gone when it returns.

    Raises NoPathError where nothing flows along any axis.
    """
    automatic = case.refine == "auto"
    with clock("geometry"), progress.stage("geometry", quiet):
        first = build_geometry(case)
    layered = first.voxel_size is not None or case.geometry.clear_layer is not None
    sealed = layered and not all(_periodic_of(case, first.dim))
    axes = drives(case, first)
    job = Job(case, {axis: first for axis, _ in axes[:1]}, axes, sealed, clock, quiet)
    if job.driven and not any(opens(case, axis) for axis in job.driven):
        raise steady.NoPathError(why_closed(case, *job.driven))
    for spacing in case.spacings:  # refused before the coarser ones have taken hours
        lattice_at(case, first, spacing)
        memory.refuse_lattice(case, first, spacing)
    seen = look(case, first, clock, quiet) if look is not None else Seen()
    found, solved = Found(), list[Solved]()
    further = as_first(further_spacings(case, first, solved)) if automatic else iter(())
    for spacing in itertools.chain(case.spacings, further):
        started = _seconds(clock)
        try:
            particles = _solve_spacing(job, spacing, found, needed=not solved)
        except SolveError as error:
            if not solved:
                raise
            # the spacings that the case names have their results
            seen.warnings.append(f"refine: auto left out the spacing {spacing:g}: {error}")
            found.flows = {key: other for key, other in found.flows.items() if key[1] != spacing}
            continue
        except KeyboardInterrupt as stop:
            case = _interrupted(case, found, axes, stop)
            break
        if automatic and particles:
            solved.append(Solved(spacing, particles, _seconds(clock) - started))
    if automatic:
        case = replace(case, refine=tuple(level.spacing for level in solved[1:]))
        if len(solved) == 1 and found.stopped is None:
            seen.warnings.append(f"refine: auto: no further spacing fits refine_budget, {case.refine_budget:g} s, and "
                                 "the memory that is free: no error bar")
    seen.warnings += found.warnings
    if not found.flows:
        reasons = dict.fromkeys(filter(None, found.closed.values()))
        raise steady.NoPathError("; ".join(reasons) or why_closed(case, *job.driven))
    return case, job.axes, found, seen


def _interrupted(case: Case, found: Found, axes: Drives, stop: KeyboardInterrupt) -> Case:
    """The case with the spacings whose axes are all done, of which the flows stay in `found`. Raises KeyboardInterrupt
    where nothing flows in any, and on several processes, which do not stop in the same place."""
    def whole(spacing: float) -> bool:
        return all((axis, spacing) in found.flows or (axis, spacing) in found.closed for axis, _ in axes)

    found.flows = {key: flow for key, flow in found.flows.items() if whole(key[1])}
    if not found.flows or current().size > 1:
        raise stop
    found.stopped = stop
    return case if isinstance(case.refine, str) else replace(case, refine=tuple(filter(whole, case.refine)))


def _solve_spacing(job: Job, spacing: float, found: Found, needed: bool) -> int:
    """Every axis at one spacing, into `found`; returns the number of fluid particles, 0 where no path leads through.
    needed: whether a solve that fails ends the run. Raises SolveError."""
    scene: steady.SteadyScene | None = None
    particles = 0
    for axis, force in job.axes:
        if scene is None or job.sealed:
            scene = None  # frees the matrices of the axis before
            scene = _build(job, axis, spacing)
            if scene is None:
                found.closed |= {(a, spacing): None for a in job.needs(axis)}
                if job.sealed:
                    continue
                return 0
            refuse_second_fluid(job.case, scene.particles)
            particles = reduce.number(scene.particles.phase)
        _solve_one_axis(job, scene, axis, force, found, needed)
    return particles


def _build(job: Job, axis: int | None, spacing: float) -> steady.SteadyScene | None:
    """The matrices of one axis, or of all where the image is not sealed; None where no path leads through."""
    with job.clock("geometry"), progress.stage(f"geometry at spacing {spacing:g}", job.quiet):
        geometry = job.geometries.get(axis) or build_geometry(job.case, axis)
        if job.case.refine:  # the next spacing needs it again
            job.geometries[axis] = geometry
    try:
        with progress.stage("particles, operators and hierarchies", job.quiet):
            return steady.build_scene(job.case, geometry, spacing, job.clock, job.needs(axis))
    except steady.NoPathError:
        return None


def _solve_one_axis(job: Job, scene: steady.SteadyScene, axis: int | None, force: np.ndarray, found: Found,
                    needed: bool) -> None:
    """The flow along an axis, its row of the history, or why nothing flows, into `found`; see `_solve_spacing`."""
    spacing = scene.system.spacing
    if axis is not None and not scene.percolates[:, axis].any():
        found.closed[axis, spacing] = None
        return
    label = f"flow along {'xyz'[axis]}" if axis is not None else "flow driven by walls"
    left_out: SolveError | None = None
    with progress.stage(f"{label}, {reduce.number(scene.particles.phase):,} particles", job.quiet) as stage:
        try:
            flow = steady.solve_axis(job.case, scene, axis, force, job.clock, _watch(stage))
        except SolveError as error:
            if needed:
                if current().size > 1:  # each has the residuals of its own particles only
                    raise
                with suppress(OSError):
                    error.worst = _worst_of(job.case, scene, error)
                raise
            left_out = error
    if left_out is not None:  # raised outside of the display, which would show that the run was stopped
        raise left_out
    if axis is not None and _along(flow, axis) <= 0.0:
        found.closed[axis, spacing] = f"the flow along {'xyz'[axis]} is zero; check the drive and what is solid"
        return
    found.flows[axis, spacing] = flow
    if "formation_factor" in job.case.measure and axis is not None:
        with progress.stage(f"diffusion along {'xyz'[axis]}", job.quiet) as stage:
            flow.diffusivity = steady.solve_diffusion(job.case, scene, axis, job.clock, _watch(stage))
    _tell_history(found, spacing, flow.axis, flow)
    if job.case.refine == "throats" and axis is not None:
        _refine_throats(job, scene, flow, force, found)


def _tell_history(found: Found, spacing: float, axis: int | None, flow: steady.StokesResult | InThroats) -> None:
    """Adds the row of a solve to the history."""
    found.history.append({"step": len(found.history) + 1, "spacing": spacing,
                          "axis": "xyz"[axis] if axis is not None else "",
                          "iterations_stokes": flow.convergence.iterations,
                          "residual_stokes": flow.convergence.residual,
                          **{f"superficial_velocity_{a}": float(v) for a, v in zip("xyz", flow.superficial)}})


def _refine_throats(job: Job, scene: steady.SteadyScene, flow: steady.StokesResult, force: np.ndarray,
                    found: Found) -> None:
    """The permeability with half the spacing in throats, into the flow, and its row of the history; where that solve
    fails or does not fit, the first one keeps its value, without a bar."""
    from .half_in_throats import MOST_CUT, in_throats

    assert flow.axis is not None
    n, spacing, along = scene.particles.n_fluid, scene.system.spacing, "xyz"[flow.axis]
    with progress.stage(f"half the spacing in throats, along {along}", job.quiet) as stage:
        known = scene.system.ops, scene.particles.x[:n], flow.velocity
        try:
            flow.throats = in_throats(job.case, scene.whole, known, (flow.axis, force), job.clock,
                                      watch=_watch(stage))
        except (SolveError, ParticleError) as error:
            found.warnings.append(f"refine: throats: no second solve along {along}, so no error bar: {error}")
            return
    _tell_history(found, 0.5 * spacing, flow.axis, flow.throats)
    if flow.throats.cut > MOST_CUT:
        found.warnings.append(f"refine: throats: along {along} {flow.throats.cut:.0%} of the fluid has half the "
                              f"spacing: refine: [{0.5 * spacing:g}] is as cheap and has the narrower bar")


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


@dataclass(frozen=True)
class AxisResult:
    """The permeability along one axis.

    permeability: m2, 0 without a path; by_spacing: the same of each spacing, keys as they are written; shut: spacings
    without a path; bar: its error by the spacings, m2, and sentence: how that was found, None of one spacing; image:
    its error by the image, m2, None without one; bounds: range of the permeability, m2, and source: the bodies behind
    it, None where k is 0.
    """

    name: str
    permeability: float
    by_spacing: dict[str, float]
    shut: list[float]
    bar: float | None = None
    sentence: str | None = None
    image: float | None = None
    bounds: tuple[float, float] | None = None
    source: str | None = None


def _axis_result(case: Case, axis: int, flows: Flows, geometry: Geometry, porosity: float,
                 grain: float) -> AxisResult:
    """AxisResult of the flows along an axis; of spacings, those count at which there is a path. grain: m, see
    `grain_chord`."""
    name, spacings, wall = "xyz"[axis], case.spacings, wall_of(case)
    scan = scan_of(geometry, wall == "grey")
    slip = slip_of(geometry)
    known = {h: _along(flows[axis, h], axis) if (axis, h) in flows else 0.0 for h in spacings}
    open_at = [h for h in spacings if (axis, h) in flows]
    by_spacing = {f"{h:g}": float(k) for h, k in sorted(known.items())}
    found = AxisResult(name, float(known[open_at[0]]) if open_at else 0.0, by_spacing,
                       [h for h in spacings if h not in open_at])
    throats = flows[axis, open_at[0]].throats if open_at else None
    if throats is not None:
        found = _with_throats(found, throats, open_at[0], (porosity, grain), wall, slip)
    elif len(open_at) > 1:
        edges = EDGE if wall == "stairs" else None
        finest = min(open_at)
        k = float(known[finest])
        usual = usual_error(k, porosity, finest, grain) if k > 0.0 else 0.0
        limit, bar, _, sentence = extrapolate(open_at, [known[h] for h in open_at], edges, usual=usual,
                                              flux=flows[axis, finest].mass_error)
        if slip > 0.0 and k > 0.0:
            bar += slip_error(k, porosity, finest, slip) * k
            sentence += ", and what slip walls leave"
        found = replace(found, permeability=float(limit), bar=bar, sentence=f"{name}: {sentence}")
    if found.permeability > 0.0:
        k = found.permeability
        fluid = flows[axis, open_at[0]].particles
        if wall == "exact" and found.bar is None and has_edges(geometry, fluid.x[: fluid.n_fluid], open_at[0]):
            wall = "stairs"
        error = expected(wall, k, porosity, open_at[0], grain, scan, found.bar)
        if found.bar is None:
            error = error.with_slip(slip_error(k, porosity, open_at[0], slip))
        found = replace(found, bounds=error.bounds(k), source=f"{name}: {error.sentence}",
                        image=error.image * k if scan is not None else None)
    return found


def _with_throats(found: AxisResult, throats: InThroats, spacing: float, pores: tuple[float, float],
                  wall: str, slip: float) -> AxisResult:
    """The result of a spacing, m, with the value and bar of half of it in throats. pores: porosity and chord of the
    grains, m; slip: length, m, of walls: outside the throats the error that it leaves is that of the whole spacing."""
    from .half_in_throats import limit_of_throats

    k = throats.permeability
    limit, bar, sentence = limit_of_throats(found.permeability, k, spacing, pores, wall, throats.mass_error)
    if slip > 0.0 and k > 0.0:
        bar += slip_error(k, pores[0], (1.0 - 0.5 * SHARE) * spacing, slip) * k
        sentence += ", and what slip walls leave"
    by_spacing = found.by_spacing | {f"{spacing:g} and {0.5 * spacing:g}": k}
    return replace(found, permeability=limit, bar=bar, by_spacing=by_spacing,
                   sentence=f"{found.name}: half the spacing where {SHARE:.0%} of the energy is lost "
                            f"({throats.particles:,} particles, of {throats.everywhere:,} of half the spacing "
                            f"everywhere): {sentence}")


def _tell(found: AxisResult, case: Case, closed: Closed, seen: Seen, porosity: float, longer: float = 1.0) -> None:
    """Adds to `seen` what the solves along an axis show: whether it is open, and a warning of narrow pores. longer: the
    tortuosity, by whose square k is less in pores of one width that do not lie along the axis."""
    name, axis, opened = found.name, "xyz".index(found.name), len(found.shut) < len(case.spacings)
    if found.shut:
        where = f"at the spacing {', '.join(f'{h:g}' for h in found.shut)} " if opened else ""
        seen.warnings.append(where + (closed[axis, found.shut[0]] or why_closed(case, axis)))
    if opened:  # by pairs of particles, although it may be closed by faces of lattice sites
        seen.open_axes = [a for a in "xyz" if a == name or a in (seen.open_axes or [])]
    elif seen.open_axes is not None:  # without a check, a closed axis says nothing of those that were not solved
        seen.open_axes = [a for a in seen.open_axes if a != name]
    told = seen.throats is not None and seen.throats["median"] < THINNEST  # the check has warned of the same pores
    resists = case.microporous or case.geometry.depth  # drag besides that of walls: k gives no width
    if found.permeability > 0.0 and not told and not resists:
        finest = min(h for h in case.spacings if h not in found.shut)
        if case.refine == "throats" and found.bar is not None:
            finest *= 0.5  # in throats particles have half the spacing
        narrow = too_narrow(f"the flow along {name} sees pores (tortuosity sqrt(12 k / porosity))",
                            longer * pore_width(found.permeability, porosity), finest)
        seen.warnings += [narrow] if narrow else []


def _sum_up(case: Case, axes: Drives, found: Found, seen: Seen) -> tuple[dict[str, Any], Result]:
    """(summary, result) of the flows of a steady case; the finest spacing of the first axis is what is written."""
    flows, history, main = found.flows, found.history, _main(found.flows)
    scene = scene_entries(case, main.geometry, main.particles, (main.cells, main.thick), seen)
    filled = scene["porosity"] + sum((scene["microporous"] or {}).values())
    grain = grain_chord(main.geometry, min(case.spacings))
    results = [_axis_result(case, axis, flows, main.geometry, filled, grain)
               for axis, _ in axes if axis is not None]
    ways = _tortuosities(flows)
    for along in results:
        _tell(along, case, found.closed, seen, filled, ways.get(along.name) or 1.0)
    if main.geometry.has_solid:
        scene["open_axes"] = seen.open_axes
    permeability = {along.name: along.permeability for along in results}
    bars = {along.name: along.bar for along in results if along.bar is not None}
    images = {along.name: along.image for along in results if along.image is not None}
    ranges = {along.name: along.bounds for along in results if along.bounds is not None}
    tensor, dim = None, main.geometry.dim
    finest = [flow for (_, spacing), flow in flows.items() if spacing == main.spacing]
    # with sealed sides each axis is a separate flow without a velocity across it, and there is no tensor
    if len(permeability) == dim and not bars and all(_periodic_of(case, dim)):
        columns = [flows.get((axis, case.particles.spacing)) for axis in range(dim)]
        tensor = np.array([np.zeros(dim) if flow is None else flow.permeability for flow in columns]).T
    single = len(permeability) == 1
    result = Result(
        x=main.particles.x[: main.particles.n_fluid], velocity=main.velocity, cell_velocity=main.cell_velocity,
        pressure=main.pressure, time=None,
        spacing=main.spacing,
        phase=main.particles.phase, permeability=permeability or None, geometry=main.geometry, history=history,
        tensor=tensor,
    )
    summary = {
        "status": "finished",
        "message": "; ".join(along.sentence for along in results if along.sentence) or None,
        "warnings": seen.warnings,
        "particles": counts_of(main.particles, main.halo),
        **scene,
        "terms": used_physics(case, main.geometry, _drive_of(axes))
                 + (["adjoint divergence in narrow pores"] if main.narrow else []),
        "steps": 0,
        "time": None,
        "permeability": _alone(permeability, single) if permeability else None,
        "permeability_error": _alone(bars, len(bars) == 1) or None,
        "permeability_image_error": _alone(images, len(images) == 1) or None,
        "permeability_range": _alone(ranges, single) or None,
        "permeability_range_from": "; ".join(along.source for along in results if along.source) or None,
        "permeability_by_spacing": ({along.name: along.by_spacing for along in results}
                                    if len(case.spacings) > 1 or case.refine == "throats" else None),
        "permeability_tensor": tensor,
        **_measures(case, flows, ways),
        "superficial_velocity": main.superficial,
        "mean_velocity": main.mean,
        "mass_error": max(flow.mass_error for flow in finest),
        "max_divergence": max(flow.divergence for flow in finest),
        "iterations": {"stokes": mean_max([r["iterations_stokes"] for r in history])},
        "components": main.components,
        "isolated_pockets": main.isolated_pockets,
    }
    return summary, result


def _tortuosities(flows: Flows) -> dict[str, float | None]:
    """By the name of the axis, of the flows at the finest spacing along one."""
    finest, ways = min(h for _, h in flows), {}
    for (axis, h), flow in sorted(flows.items(), key=str):
        if axis is not None and h == finest:
            cells, velocity = flow.all_cells
            ways["xyz"[axis]] = tortuosity(velocity, axis, part_of_sample(flow.geometry, cells, flow.thick))
    return ways


def _measures(case: Case, flows: Flows, ways: dict[str, float | None]) -> dict[str, Any]:
    """Entries of the summary on the flows at the finest spacing: tortuosity, formation factor, and of the flow that is
    written the distribution of the speed and the wall shear. ways: see `_tortuosities`."""
    finest = min(h for _, h in flows)
    driven = {axis: flow for (axis, h), flow in sorted(flows.items(), key=str) if axis is not None and h == finest}
    factors, bars = {}, {}
    for axis, flow in driven.items():
        if flow.diffusivity:
            factors["xyz"[axis]] = 1.0 / flow.diffusivity
            known = {h: other.diffusivity for (a, h), other in flows.items() if a == axis and other.diffusivity}
            if len(known) > 1:
                bars["xyz"[axis]] = extrapolate(list(known), [1.0 / d for d in known.values()],
                                                 given=(DIFFUSION, DIFFUSION_BAR))[1]
    main = _main(flows)
    x = main.particles.x[: main.particles.n_fluid]
    cells, velocity = main.all_cells
    single = len(driven) == 1
    diffusivities = {axis: 1.0 / factor for axis, factor in factors.items()}
    return {
        "tortuosity": _alone(ways, single) or None,
        "formation_factor": _alone(factors, single) or None,
        "formation_factor_error": _alone(bars, single) or None,
        "effective_diffusivity": _alone(diffusivities, single) or None,
        "effective_diffusivity_error": _alone({a: bar / factors[a] ** 2 for a, bar in bars.items()}, single) or None,
        "speed": speed_distribution(main.cell_velocity, part_of_sample(main.geometry, x, main.thick),
                                    (velocity, part_of_sample(main.geometry, cells, main.thick), main.cells)),
        "wall_shear": main.shear,
    }


def _alone(by_axis: dict[str, Any], single: bool) -> Any:
    """The one entry of a dict by axes where there is a single one, else the dict."""
    return next(iter(by_axis.values())) if single and by_axis else by_axis


def _along(flow: steady.StokesResult, axis: int) -> float:
    """Permeability along the axis of a flow, m2."""
    assert flow.permeability is not None
    return flow.permeability[axis]


def refuse_second_fluid(case: Case, particles: Particles) -> None:
    """Raises CaseError where particles are of a second fluid that differs: a steady solve has one fluid."""
    first, *others = case.fluids.items()
    for k, (name, fluid) in enumerate(others, 1):
        if (fluid.density, fluid.mu) != (first[1].density, first[1].mu) and reduce.any_true(particles.phase == k):
            what = f"a steady solve has one fluid, and {name} is another than {first[0]}"
            raise CaseError((Problem(*case.place_of("flow"), "flow", what, "use flow: navier_stokes"),))


def _periodic_of(case: Case, dim: int) -> list[bool]:
    return [a in case.geometry.repeats for a in "xyz"[:dim]]


def _watch(stage: progress.stage) -> Watch:
    def watch(iteration: int, residual: float) -> None:
        stage.update(f"iteration {iteration}, residual {residual:.1e}")

    return watch


def _drive_of(axes: Drives) -> bool:
    return any(force.any() for _, force in axes)


def _profile(flow: steady.StokesResult) -> list[dict[str, float | None]]:
    """Rows of profiles.csv; none of a flow that walls drive."""
    if flow.axis is None:
        return []
    particles = flow.particles
    x, velocity = flow.all_cells
    return profile_rows(flow.geometry, x, (velocity, flow.pressure), flow.axis, flow.drop,
                        (flow.spacing, particles.site_volume, float(flow.thick[flow.axis])))


def _pictures(case: Case, directory: Path, flow: steady.StokesResult, flows: Flows, summary: dict[str, Any],
              rows: list[dict[str, float | None]]) -> None:
    """Draws a slice and, in three dimensions, rock with streamlines and the shear at its walls; profiles; pores and
    speeds; and separately the numerical quantities."""
    from ..output.panels import plot_flow_profile
    from ..output.plots import Frame, plot_slice

    x, geometry = flow.particles.x[: flow.particles.n_fluid], flow.geometry
    frame = Frame(geometry.dim, flow.spacing, case.title, geometry.lower, geometry.upper, geometry.periodic,
                  geometry.distance, flow_axis=flow.axis)
    k = summary["permeability"]
    k = k.get("xyz"[flow.axis or 0]) if isinstance(k, dict) else k
    with drawing_in_3d(directory, frame, geometry, {"x": x, "velocity": flow.velocity}, summary["warnings"],
                       stress=flow.stress):
        plot_slice(directory / "slice.png", x, flow.velocity, frame, permeability=k)
        draw_distributions(directory, case, geometry, x, flow.cell_velocity, flow.spacing)
        if rows:
            plot_flow_profile((directory / PROFILES).with_suffix(".png"), rows, flow.mass_error, case.title)
        _plot_numerics(directory / "numerics.png", case, flows, summary, rows)


def _plot_numerics(path: Path, case: Case, flows: Flows, summary: dict[str, Any],
                   rows: list[dict[str, float | None]]) -> None:
    """Convergence of every solve, k against spacing, spread of the flux."""
    from ..output.panels import Numerics, plot_steady_numerics

    axes = ["xyz"[axis] for axis in dict.fromkeys(axis for axis, _ in flows) if axis is not None]

    def of_axes(key: str) -> dict[str, float]:
        value = summary.get(key)
        return dict(value) if isinstance(value, dict) else {} if value is None else {axes[0]: float(value)}

    by_spacing: dict[str, dict[float, float]] = {}
    residuals: dict[str, list[tuple[int, float]]] = {}
    for (axis, h), flow in sorted(flows.items(), key=lambda item: (item[0][0] or 0, -item[0][1])):
        name = "walls" if axis is None else "xyz"[axis]
        if axis is not None:
            by_spacing.setdefault(name, {})[h] = _along(flow, axis)
        residuals[f"{name}, spacing {h:.3g}"] = flow.residuals
        if flow.throats is not None:
            by_spacing[name][0.5 * h] = flow.throats.permeability
            residuals[f"{name}, {0.5 * h:.3g} in throats"] = flow.throats.residuals
    plot_steady_numerics(path, Numerics(residuals, case.solver.tolerance, by_spacing, of_axes("permeability"),
                                        of_axes("permeability_error"), rows, _main(flows).mass_error), case.title)
