"""Sentences on what may go wrong in a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..case import forcing
from ..case.blocks import AXES, Time
from ..case.force_list import forces_of
from ..case.reader import keys_of
from ..domain.lattice import Lattice
from ..flow.forces import largest_of
from ..geometry.connectivity import connectivity_of
from ..geometry.images.image import machine_memory
from ..runs.expected_error import THINNEST, too_narrow
from ..runs.steadiness import FEWEST
from .check_result import CheckResult, in_bytes
from .throats import TINY, Sites

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry


# Reynolds number of a check above which a value of the case must be wrong: flow in pores stays far below it, and
# estimates of free fall and of bubbles, which are too large, reach 1.4e4 in `cases/`
TURBULENT = 1e5


def drive_findings(
    result: CheckResult, geometry: Geometry, sites: Sites, driven: Sequence[int], through: Sequence[int]
) -> None:
    """Nothing can flow: an error of a steady case; a warning of others and of too coarse a lattice."""
    case = result.case
    steady = case.flow == "stokes" or (case.time is not None and case.time.steady is not None)
    moved = geometry.has_solid and bool(np.any(geometry.wall_speed))
    held = forcing.held_flux(case) is not None
    for axis in driven:
        if axis in through or (len({f.density for f in case.fluids.values()}) > 1
                               and axis not in forcing.pressed_axes(case)):
            continue  # a light fluid rises between walls too
        name, fatal = AXES[axis], held or (steady and not through and not moved)
        if not forcing.opens(case, axis):
            found = forcing.why_closed(case, axis)
        elif _open_when_finer(case, geometry, axis):
            fatal = False
            found = f"throats along {name} are closed on this lattice; take a smaller particles.spacing"
        elif sites.leads_over_edges(axis):
            fatal = False
            found = (f"no pore leads through the scene along {name} by faces of lattice sites, only over their edges: "
                     "isph run finds out whether particles see each other there; take a smaller particles.spacing")
        else:
            found = f"no pore leads through the scene along {name}: its permeability is zero; check what is solid"
        (result.errors if fatal else result.warnings).append(found)
    pushed = driven or largest_of(forces_of(case, geometry)) > 0.0
    if case.flow == "stokes" and not pushed and not moved:
        result.errors.append("nothing moves the fluid; give a drive or a wall with a velocity")
    begins = case.initial is not None and case.initial.velocity
    tension = case.interface is not None and len(fluids_there(case, sites)) > 1
    result.warnings += [f"{zero} and drives nothing" for zero in forcing.drives_of_zero(case)]
    if case.flow != "stokes" and not (pushed or moved or held or begins or tension):
        result.warnings.append("nothing moves the fluid, which stays at rest; give a drive, tension of two fluids, "
                               "an initial velocity or a wall with one")


def _open_when_finer(case: Case, geometry: Geometry, axis: int) -> bool:
    """Whether what the lattice finds closed along an axis is open by the voxels, or at half the spacing."""
    lower, upper, edges = geometry.sample_lower, geometry.sample_upper, geometry.voxel_size
    if edges is None:
        edges = np.full(geometry.dim, case.particles.spacing / 2)
    cells = np.maximum(np.rint((upper - lower) / edges), 1).astype(int)
    around = tuple(AXES[a] in case.geometry.repeats for a in range(geometry.dim))
    lattice = Lattice(np.full((1, geometry.dim), 0.5), (upper - lower) / cells, cells, lower)
    fluid = np.concatenate([geometry.phase(x) >= 0 for x in lattice.slabs()]).reshape(cells)
    return bool(connectivity_of(fluid.T, around).percolates[axis])


def resolution_findings(result: CheckResult, geometry: Geometry, lattice: Lattice) -> Iterator[str]:
    """Lattice against throats, voxels, clear layers and box."""
    case, widths = result.case, result.throats
    spacing = case.particles.spacing
    if widths is not None:
        narrow = too_narrow("the median throat is", widths.median * spacing, spacing)
        yield from [narrow] if narrow else []
    for axis, width in (widths.critical if widths is not None else {}).items():
        if width < THINNEST:
            yield (
                f"the way along {AXES[axis]} leads through a throat of about {width:.1f} particles: "
                "its flow is not resolved"
            )
    voxels = case.geometry.voxels
    if voxels is not None:
        assert geometry.voxel_size is not None
        sizes = np.unique(geometry.voxel_size)
        for size in sizes:
            ratio = max(size / spacing, spacing / size)
            if abs(ratio - round(ratio)) > 1e-3:
                fits = size / max(round(size / spacing), 1)
                yield (
                    f"the spacing {spacing:g} does not divide the voxel size {size:g}: particles lie "
                    f"differently to the walls from voxel to voxel; take particles.spacing {fits:.6g}"
                )
    layer = float(np.max(geometry.sample_lower - geometry.lower))
    added = any(p and a not in case.geometry.repeats for a, p in zip(AXES, geometry.periodic))
    if added and layer < case.support * spacing * (1 - TINY):
        what, key = ("image", "geometry.voxels.clear_layer") if voxels is not None else ("pack", "geometry.clear_layer")
        yield (
            f"the clear layer, {layer:g}, is thinner than the support {case.support * spacing:.3g}: the "
            f"two ends of the {what} see each other; make {key} larger"
        )
    stretch = (
        lattice.cell
        / spacing
        / np.array([1, math.sqrt(3) if "hex" in case.lattice_in(result.dim) else 1, 1][: result.dim])
    )
    alike: dict[str, list[str]] = {}
    for axis in range(result.dim):
        if abs(stretch[axis] - 1) > 0.01:
            alike.setdefault(f"{100 * (stretch[axis] - 1):+.1f} %", []).append(AXES[axis])
    for much, axes in alike.items():
        yield (f"the box along {', '.join(axes)} is no whole number of spacings: the lattice is stretched by "
               f"{much} there")


def contact_angle_findings(case: Case, geometry: Geometry) -> Iterator[str]:
    """A wedge of fluid at the contact line that is thinner than a spacing as far as the wall asks for the angle."""
    if case.interface is None or not geometry.has_solid or len(case.fluids) < 2:
        return
    from ..two_phase.contact_angle import NEAR_LINE

    angle = case.interface.contact_angle
    slope = math.tan(math.radians(min(angle, 180.0 - angle)))
    if slope * NEAR_LINE < 1.0:
        thin = case.fluid_names[0 if angle < 90.0 else 1]
        far = "all along a film" if slope < 1e-6 else f"up to {1.0 / slope:.2g} spacings from the contact line"
        least = math.ceil(math.degrees(math.atan(1.0 / NEAR_LINE)))
        yield (
            f"interface.contact_angle {angle:g}: {thin} on the wall is thinner than a spacing {far}, which no spacing "
            f"resolves: drops rest at other angles, and films break; {least} to {180 - least} degrees are resolved"
        )


def other_findings(result: CheckResult, geometry: Geometry, sites: Sites) -> Iterator[str]:
    """Memory, Reynolds number, fluids without particles, pockets."""
    case, there = result.case, machine_memory()
    need = sum(result.memory.values())
    if need > there and result.ranks is None:
        yield f"needs about {in_bytes(need)}, this machine has {in_bytes(there)}; take a larger particles.spacing"
    if (
        case.flow == "stokes"
        and result.flow is not None
        and result.flow.reynolds
        and result.flow.reynolds > 1
    ):
        yield f"flow: stokes leaves out inertia, but the Reynolds number is about {result.flow.reynolds:.2g}"
    c = result.connectivity
    if c is not None and geometry.has_solid and any(c.percolates) and c.isolated_share > 0.05:
        # beads that touch cut single sites off: of a body-centred pack at 12 spacings a cell 9 %, which particles reach
        yield (f"{100 * c.isolated_share:.0f} % of the fluid lies in pockets that are closed by the faces of lattice "
               "sites: no flow passes through them but where particles see each other past an edge")


def fluids_there(case: Case, sites: Sites) -> list[str]:
    """Names of the fluids that are in the scene at the start, or come in with a flood."""
    placed = {case.initial.flood.fluid} if case.initial and case.initial.flood else set()
    if case.reservoirs is not None:
        placed |= {case.reservoirs.inlet, case.reservoirs.outlet}
    return [name for k, name in enumerate(case.fluids)
            if name in placed or (k < len(sites.per_fluid) and sites.per_fluid[k])]


def step_findings(result: CheckResult) -> Iterator[str]:
    """A run that is out of steps before its end; a flow that would be turbulent."""
    case, steps = result.case, result.steps
    if case.time is None:
        return
    for name in ("cfl", "capillary") if case.time.step else ():
        if getattr(case.time, name) != keys_of(Time)[name].default:
            yield f"time.{name} has no effect beside time.step, which is {case.time.step:g} s"
    if case.time.steady is not None and case.time.max_steps < FEWEST:
        yield (f"time.max_steps = {case.time.max_steps} ends the run before it can be told how far from steady it "
               f"is, which takes {FEWEST} steps and more")
    if steps is None or steps.count is None:
        return
    if steps.count >= case.time.max_steps and case.time.steady is None:
        end = forcing.longest_time(case)
        why = f"the smallest limit of a step is {steps.binding}, {steps.limits[steps.binding]:.2g} s"
        if steps.most == "end":
            why = "steps end where something is due, of output.every or drive.steps.window"
        yield (f"after time.max_steps = {case.time.max_steps:,} steps the run stops short of its end, {end:g} s: "
               f"{why}; check the units, or raise time.max_steps")
    reynolds = result.flow.reynolds if result.flow is not None else None
    if reynolds is not None and reynolds > TURBULENT:
        yield (f"the Reynolds number is about {reynolds:.2g}: such flow is turbulent, and no spacing resolves "
               "it; check the units of the viscosity and of the drive")


def reservoir_findings(case: Case) -> Iterator[str]:
    """The same fluid at both ends, so that none displaces another. Reservoirs shorter than the seam between them. An
    end of the run before that of the steps of the drive."""
    ends, steps = case.reservoirs, forcing.drive_steps(case)
    if steps is not None and case.time is not None and case.time.end is not None:
        count = len(steps.pressure_drop or steps.superficial_velocity or ())
        if case.time.end < (count - 1) * steps.duration:
            yield (f"time.end, {case.time.end:g} s, may come before the last of the {count} drive.steps, of up to "
                   f"{steps.duration:g} s each: steps that are not reached are not in curve.csv; leave time.end out")
    sight = case.support * case.particles.spacing
    if ends is not None and ends.length is not None and ends.length < sight * (1 - TINY):
        yield (f"reservoirs.length, {ends.length:g}, is less than the support, {sight:.3g}: half of a reservoir is "
               "taken for the seam with the other; make it two supports or more")
    if ends is not None and ends.inlet == ends.outlet:
        other = next((name for name in case.fluids if name != ends.inlet), None)
        yield (f"reservoirs.inlet and reservoirs.outlet are both {ends.inlet}: it goes round, and no fluid displaces "
               "another" + (f"; name {other} at one end" if other else ""))


def absent_fluids(case: Case, sites: Sites) -> Iterator[str]:
    """A sentence for each fluid of the case that no site of the lattice is in; one that floods the sample comes
    later."""
    there = fluids_there(case, sites)
    for name in case.fluids:
        if name not in there:
            yield f"fluids.{name} has no particle: the scene runs as one of a single fluid"
