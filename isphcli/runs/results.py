"""Results of a run: entries of the summary, snapshots, pictures of moving particles, the effective case."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import COMPLETE
from ..case.blocks import Case
from ..case.force_list import forces_of
from ..case.forcing import body_force, changes, drive_steps, held_axis
from ..case.load import dump_case
from ..domain import reduce
from ..domain.communicator import current
from ..geometry.protocol import Geometry, inside_sample, sample_box, sample_voxels
from ..output import folder, restart
from ..output.clock import Clock
from ..output.files import SNAPSHOTS, Series, write_summary, write_text
from ..output.machine import peak_memory, versions
from .permeability import microporous_shares

if TYPE_CHECKING:
    from ..domain.lattice import Particles
    from ..flow.one_fluid import Fluids
    from ..flow.state import State
    from ..output.grid import Grid, GridParts
    from ..output.plots import Frame
    from ..references.errors import CompareError
    from ..references.result import Result
    from .time_loop import TimeLoop


PROFILES, CURVE = "profiles.csv", "curve.csv"


# Patterns of the pictures that a run draws at its end
PICTURES = ("*.png", "report.html")


def files_of(case: Case) -> list[str]:
    """Patterns of all files that a run of the case may write, relative to its directory."""
    moving = case.flow != "stokes"
    names = ["case.yaml", "history.csv", "summary.json", "worst.vtu", *[restart.NAME] * moving]
    lists, *suffixes = ("xdmf", "h5", "h5") if case.output.format == "xdmf" else ("pvd", "vtu", "vti")
    for name, suffix, wanted in zip(("particles", "grid"), suffixes,
                                    (case.output.snapshots, case.output.grid is not None)):
        names += [f"{name}.{lists}", f"{SNAPSHOTS}/{name}_[0-9]*.{suffix}"] * wanted
    if "particles.pvd" in names:  # of several processes
        names.append(f"{SNAPSHOTS}/particles_[0-9]*.pvtu")
    if len(case.fluids) > 1 or not moving:
        names += [PROFILES, *[CURVE] * (drive_steps(case) is not None)]
    if case.output.plots:
        names += [str(Path(name).with_suffix(".png")) for name in names if name in (PROFILES, CURVE)]
        names += ["slice.png", "report.html", "numerics.png", "distributions.png", "flow_3d.png",
                  *(["phases.png", "fluids_3d.png", "histories.png"] if moving else ["wall_shear_3d.png"])]
    return names


@contextlib.contextmanager
def drawing_in_3d(directory: Path, frame: Frame, geometry: Geometry, flow: Mapping[str, np.ndarray],
                  warnings: list[str], names: Sequence[str] = (),
                  stress: tuple[np.ndarray, np.ndarray] | None = None) -> Iterator[None]:
    """Draws pictures of a scene in three dimensions that is deep enough while the block draws others: streamlines, the
    shear at the walls where stress is given (`wall_stress`), two fluids where names are. flow: `x`, `velocity` and, of
    two fluids, `phase`.

    Where they cannot be drawn, a sentence is added to warnings: the pictures of a plane exist in any case.
    """
    from ..output import render

    if not render.deep_enough(geometry, frame.spacing):
        yield
        return
    targets = {} if names else {render.FLOW: directory / "flow_3d.png"}
    if names:
        targets[render.FLUIDS] = directory / "fluids_3d.png"
    if stress is not None:
        targets[render.SHEAR] = directory / "wall_shear_3d.png"
    axis = frame.flow_axis
    if axis is None:
        axis = int(np.argmax(np.abs(flow["velocity"].mean(axis=0))))
    try:
        with render.rendering(render.scene_of(geometry, flow, frame.spacing, axis, stress), frame, targets, names):
            yield
    except render.RenderError as error:
        warnings.append(f"no pictures in 3D: {error}; slice.png shows a plane")


def draw_distributions(directory: Path, case: Case, geometry: Geometry, x: np.ndarray, velocity: np.ndarray,
                       spacing: float) -> None:
    """Sizes of the pores, with what the spacing resolves, and speeds. velocity: (n, dim) m/s; spacing: m."""
    from ..geometry.pore_sizes import pore_sizes
    from ..output.panels import plot_distributions

    pores = None
    if geometry.has_solid:
        lower, upper = sample_box(geometry)
        counts = np.maximum(np.rint((upper - lower) / spacing), 1).astype(int)
        cell = (upper - lower) / counts
        middles = [low + (np.arange(n) + 0.5) * h for low, n, h in zip(lower, counts, cell)]
        points = np.stack([a.ravel() for a in np.meshgrid(*middles[::-1], indexing="ij")][::-1], axis=1)
        fluid = (geometry.phase(points) >= 0).reshape(counts[::-1])
        pores = pore_sizes(fluid, cell, geometry.periodic)
    inside = inside_sample(geometry, x)
    plot_distributions(directory / "distributions.png", velocity[inside], spacing, pores, case.title)


def write_case(directory: Path, case: Case, changes: Sequence[Mapping[str, Any]]) -> None:
    """Writes case.yaml: the values that restarts have changed, then the effective case."""
    lines = restart.sentences({"changes": changes})
    head = ["# Changed by restarts, from the step on that is named (docs/output.md):", *(f"# {line}" for line in lines)]
    text = "".join(f"{line}\n" for line in head) if lines else ""
    write_text(directory / "case.yaml", text + dump_case(case))


@dataclass
class Seen:
    """Findings of the check of a scene before it runs (preflight.look); empty without a check.

    warnings: sentences; open_axes: axes along which fluid can flow through the sample, of a scene with walls, None
    where nothing was asked; throats: {what: width in particles} or None.
    """

    warnings: list[str] = field(default_factory=list)
    open_axes: list[str] | None = None
    throats: dict[str, float] | None = None


Look = Callable[[Case, Geometry, Clock, bool], Seen]  # preflight.look.look; the last is whether it is quiet


def scene_entries(case: Case, geometry: Geometry, particles: Particles, fluid: tuple[float, np.ndarray],
                  seen: Seen) -> dict[str, Any]:
    """Entries of the summary on the scene that was run. fluid: `permeability.fluid_cells` of the sample, and extents
    (dim,) of the particles, m."""
    image, rocks = None, None
    lower, upper = sample_box(geometry)
    cells, thick = fluid
    pores = cells * particles.site_volume / float(np.prod(upper - lower))
    if case.microporous:
        parts = microporous_shares(geometry, particles.x[: particles.n_fluid], len(case.microporous), thick)
        rocks = {name: pores * float(part) for name, part in zip(case.microporous, parts)}
    if case.geometry.voxels is not None:
        from ..geometry.images.read import axes_of

        voxel = np.asarray(geometry.voxel_size)
        image = {"size": np.array([s.stop - s.start for s in sample_voxels(geometry)[::-1]]), "voxel_size": voxel,
                 "axes": axes_of(case.geometry.voxels.file, case.geometry.voxels.axes)}
    return {"inputs": [f"{name}: {text}" for name, text in geometry.described], "image": image,
            "porosity": pores - sum((rocks or {}).values()), "microporous": rocks,
            "open_axes": seen.open_axes if geometry.has_solid else None, "throats": seen.throats}


def stopped_short(case: Case, loop: TimeLoop, state: State, directory: Path) -> str | None:
    """A sentence on a run that ended before its end or steady state; None where it reached that."""
    if loop.outcome in COMPLETE:
        return None
    time = case.time
    assert time is not None  # of moving particles
    by_steps = state.step >= time.max_steps
    cause = (f"time.max_steps, {time.max_steps}, came" if by_steps else f"time.end, {time.end:g} s, came") + " first"
    what, key = loop.outcome, "time.max_steps" if by_steps else "time.end"
    if time.steady is not None:
        what = f"the flow is not steady: {loop.standing}"
    return f"{what}; {cause}. Go on with: isph run --restart {shlex.quote(str(directory))} --set {key}=..."


@dataclass(frozen=True)
class Compared:
    """Of a result and its reference: the errors by name, or why there are none: a comparison that cannot be made, or a
    result that lacks what it needs."""

    errors: Mapping[str, Any] | None = None
    not_compared: str | None = None
    failed: CompareError | None = None


def compare_with_reference(case: Case, result: Result, clock: Clock) -> Compared:
    """`references.compare` of the result of a run; nothing where its case names no reference. Several processes call it
    together: each compares its own particles."""
    if case.reference is None:
        return Compared()
    with clock("reference"):
        from ..references import compare, errors

        try:
            return Compared(compare.compare(case, result))
        except errors.NotComparedError as error:
            return Compared(not_compared=str(error))
        except errors.CompareError as error:
            return Compared(failed=error)


def finish(case: Case, directory: Path, summary: dict[str, Any], result: Result, clock: Clock,
           draw: Callable[[], None] | None = None, compared: Compared | None = None) -> tuple[dict[str, Any], Result]:
    """(summary, result): errors against the reference, the effective case, summary.json, and pictures where a case has
    them.

    summary.json is written before `draw` is called: drawing in 3D takes half a minute, and a user who stops it has the
    numbers. It is written again with the time and warnings of drawing. It is left too where the comparison fails:
    CompareError is raised after it is written. compared: what several processes have found together.
    """
    if compared is None:
        compared = compare_with_reference(case, result, clock)
    if compared.not_compared is not None:
        summary["not_compared"] = compared.not_compared
    if compared.failed is not None:
        summary["message"] = "; ".join(filter(None, [summary["message"], f"no errors: {compared.failed}"]))
    effective = replace(case, output=replace(case.output, directory=directory))
    write_case(directory, effective, summary.get("restarts", ()))
    for name in PICTURES:  # pictures from before a restart are removed: where drawing is stopped none are left
        for path in directory.glob(name):
            folder.remove(path)
    whole = _write_summary(directory, case, summary, result, compared.errors, clock)
    if draw is not None and case.output.plots:
        with clock("output"):
            draw()
        whole = _write_summary(directory, case, summary, result, compared.errors, clock)
    if compared.failed is not None:
        raise compared.failed
    whole["directory"] = str(directory)
    whole["pictures"] = sorted(str(p) for p in Path(directory).glob("*.png"))
    if case.output.plots:
        from ..output.report import write_report

        write_report(directory / "report.html", [directory])
    return whole, result


def _write_summary(directory: Path, case: Case, summary: Mapping[str, Any], result: Result,
                   errors: Mapping[str, Any] | None, clock: Clock) -> dict[str, Any]:
    """Writes summary.json as of now, and returns it."""
    import numba

    whole = {
        "title": case.title,
        **{k: summary[k] for k in ("status", "message", "warnings")},
        "dimension": result.geometry.dim,
        **{k: v for k, v in summary.items() if k not in ("status", "message", "warnings")},
        "errors": errors,
        "cpu_seconds": clock.cpu(),
        "wall_seconds": clock.wall(),
        "peak_memory_bytes": peak_memory(),
        "threads": numba.get_num_threads(),
        "versions": versions(),
    }
    write_summary(directory / "summary.json", whole)
    return whole


def series_of(case: Case, directory: Path, resume_time: float | None = None) -> Series | None:
    """The series of snapshots of a run, None where none are asked for; resume_time: s, of a run that goes on."""
    return _series(case, directory, "particles", resume_time) if case.output.snapshots else None


def grids_of(case: Case, directory: Path, resume_time: float | None = None) -> Series | None:
    """The series of snapshots on a grid of a case, or None."""
    return _series(case, directory, "grid", resume_time) if case.output.grid is not None else None


def _series(case: Case, directory: Path, name: str, resume_time: float | None) -> Series:
    if case.output.format == "xdmf":
        from ..output.xdmf import XdmfSeries

        return XdmfSeries(directory, name, resume_time)
    return Series(directory, name, resume_time)


def write_grid(series: Series | None, case: Case, geometry: Geometry, particles: Particles, moment: tuple[int, float],
               flow: tuple[np.ndarray, np.ndarray, np.ndarray], spacing: float) -> None:
    """Writes a snapshot on a grid, if there are any; all processes together. moment: step and time, s; flow: positions,
    velocities and pressures of the fluid particles; spacing: of the particles, m."""
    if series is None:
        return
    from ..output.grid import grid_in_parts, make_grid, write_vti

    cell = geometry.voxel_size if isinstance(case.output.grid, str) else case.output.grid
    x, velocity, pressure = flow
    step, time = moment
    fields = {"velocity": velocity, "pressure": pressure, "phase": particles.phase}
    grid: Grid | GridParts = (make_grid(geometry, x, fields, spacing, cell) if particles.share is None else
                          grid_in_parts(geometry, x, fields, spacing, cell, particles.share))
    if case.output.format == "xdmf":
        from ..output.xdmf import XdmfSeries

        assert isinstance(series, XdmfSeries)
        series.write_grid(step, time, grid)
    else:
        series.add(step, time, "vti", lambda path: write_vti(path, grid, time))


def snapshot_of(case: Case, geometry: Geometry, particles: Particles, x: np.ndarray, velocity: np.ndarray,
              pressure: np.ndarray, divergence: np.ndarray | None = None) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """(positions, fields) of a snapshot, dummies behind the fluid where they are asked for."""
    known = {"velocity": velocity, "pressure": pressure, "phase": particles.phase.astype(np.int32)}
    if divergence is not None:
        known["divergence"] = divergence
    if "distance" in case.output.fields and geometry.has_solid:
        known["distance"] = geometry.distance(x)
    fields = {name: known[name] for name in case.output.fields if name in known}
    if not case.output.dummies or not current().max(particles.n_dummy):  # the pieces of all ranks have the same fields
        return x, fields
    dummies = particles.x[particles.n_fluid:]
    rest = {"phase": np.full(len(dummies), -1, np.int32)}
    if "distance" in fields:
        rest["distance"] = geometry.distance(dummies)
    joined = {name: np.concatenate([v, rest.get(name, np.zeros((len(dummies), *v.shape[1:]), v.dtype))])
              for name, v in fields.items()}
    joined["kind"] = np.repeat(np.array([0, 1], np.int32), [len(x), len(dummies)])
    return np.concatenate([x, dummies]), joined


def counts_of(particles: Particles, halo: int) -> dict[str, int]:
    """Entry `particles` of the summary; halo: rows that are periodic images; left_out: sites that no fluid sees."""
    fluid, dummy, images, left_out = current().sum(
        np.array([particles.n_fluid, particles.n_dummy, halo, particles.left_out])).tolist()
    return {"fluid": fluid, "dummy": dummy, "halo": images, "left_out": left_out}


def used_physics(case: Case, geometry: Geometry, driven: bool) -> list[str]:
    """Entry `terms` of the summary: the terms of the method that a scene of this case uses; driven: whether a force
    acts."""
    used = ["viscosity", "pressure"]
    if held_axis(case) is not None:
        used.append("held velocity")
    if driven and (held_axis(case) is None or body_force(case, geometry.dim).any()):
        used.append("body force")
    used += [force.name for force in forces_of(case, geometry)]
    if drive_steps(case) is not None:
        used.append("drive in steps")
    if changes(case):
        used.append("drive that changes with time")
    if geometry.has_solid:
        used.append("walls")
        if np.any(geometry.wall_speed):
            used.append("moving walls")
        if np.any(geometry.slip_length > 0.0):
            used.append("slip walls")
    if any(geometry.periodic):
        used.append("periodic halo")
    if case.flow == "navier_stokes" and case.particles.shifting > 0.0:
        used.append("shifting")
    if case.flow == "navier_stokes" and case.particles.keep_volume > 0.0:
        used.append("kept volume")
    return used


def used_physics_of_two(case: Case, fluids: Fluids) -> list[str]:
    """`used_physics` of two fluids. fluids: TwoFluids, or OneFluid where only the names of the fluids differ."""
    from ..two_phase.two_fluids import TwoFluids

    used = ["two fluids", *["reservoirs"] * (case.reservoirs is not None)]
    if not isinstance(fluids, TwoFluids):
        return used
    if fluids.density[0] != fluids.density[1]:
        used.append("density jump")
    if fluids.mu[0] != fluids.mu[1]:
        used.append("viscosity jump")
    if fluids.tension is not None:
        used.append(f"surface tension ({fluids.tension.method})")
        if fluids.contact is not None:
            used.append("contact angle")
        if fluids.added_viscosity > 0.0:
            used.append("artificial viscosity at the interface")
        if fluids.line is not None:
            used.append("slip at contact lines")
    return used


def added_viscosity(fluids: Fluids) -> str | None:
    """A sentence on the viscosity that is added to an interface with little damping; None where none is added."""
    added = fluids.added_viscosity
    return (f"{added:.2g} Pa s are added to the viscosity at the interface, whose roughness its own would not hold at "
            "this spacing (docs/method.md 12)") if added else None


def absent_fluids(case: Case, particles: Particles) -> str | None:
    """A sentence on the fluids that the case names and the scene does not have; None where all are there."""
    absent = [name for k, name in enumerate(case.fluid_names) if not reduce.any_true(particles.phase == k)]
    return f"no particle is of the fluid {' or '.join(absent)}: run as a single fluid" if absent else None


def mean_max(counts: Sequence[int]) -> dict[str, float]:
    """Mean and largest of iterations or other counts, zeros where there are none."""
    return {"mean": float(np.mean(counts)), "max": int(max(counts))} if counts else {"mean": 0.0, "max": 0}
