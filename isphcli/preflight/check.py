"""The check of a case before it runs: the terms it uses, memory, time and warnings.

`check` looks at the lattice only: nothing is solved and no neighbours are searched.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..case import forcing
from ..case.blocks import AXES, Case
from ..case.force_list import FORCES, forces_of
from ..case.load import load_case
from ..domain.lattice import Lattice, ParticleError
from ..geometry.protocol import Geometry
from ..references.sample import other_sample
from ..scene import memory
from ..scene.build_geometry import build_geometry
from ..scene.place import lattice_at, what_is_solid
from .check_result import CheckResult, Physics, in_bytes
from .costs_of_ranks import of_ranks
from .estimates import costs, flow_estimate, steps
from .findings import (
    absent_fluids,
    contact_angle_findings,
    drive_findings,
    fluids_there,
    other_findings,
    reservoir_findings,
    resolution_findings,
    step_findings,
)
from .menisci import menisci_findings
from .throats import Sites, throats

# Most lattice sites that are classified one by one: 0.6 us each on an idle core, 2 us on a busy one (Berea, 2026-11-29)
MOST_SITES = 30_000_000
BYTES_SITE = 30  # bytes per lattice site in a check: phase, distance, labels of the connected parts


def check_case_file(path: str | Path, overrides: Sequence[str] = (), ranks: int | None = None) -> CheckResult:
    """Read and check a case, and what it costs each of `ranks` processes where they are given; raises CaseError,
    VoxelError or ShapeError where it cannot even be set up."""
    return check(load_case(path, tuple(overrides)), ranks=ranks)


def check(case: Case, geometry: Geometry | None = None, to_run: bool = False,
          ranks: int | None = None) -> CheckResult:
    """Check a case; `geometry` where it is at hand already.

    to_run: the case is about to be run. Classifying any number of sites then takes little time beside the solve, and
    findings that the run itself reports are left to it: axes that are closed, fluids that are absent. ranks: how many
    processes are to run it, on a machine that need not be this one.
    """
    if geometry is None:
        try:
            geometry = build_geometry(case)
        except ParticleError as error:  # an image whose size alone says that it does not fit
            return CheckResult(case, case.dim or 3, [], {}, errors=[str(error)])
    result = CheckResult(case, geometry.dim, physics_of(case, geometry, list(case.fluids)), {},
                         warnings=list(geometry.warnings), inputs=geometry.described)
    try:
        lattice = lattice_at(case, geometry, case.particles.spacing)
        if lattice.sites > MOST_SITES and not to_run:
            _from_samples(result, geometry, lattice, ranks)
            return result
        memory.refuse(lattice.sites * BYTES_SITE, f"{lattice.sites:,} lattice sites, to be checked,",
                      memory.too_large(case))
    except ParticleError as error:
        result.errors.append(str(error))
        return result
    sites = Sites(lattice, geometry, case.support * case.particles.spacing, len(case.fluids) == 1)
    result.particles, there = sites.particles, fluids_there(case, sites)
    result.physics = physics_of(case, geometry, there)
    if not sites.particles["fluid"]:
        result.errors.append("no fluid: the scene is solid at every site of the lattice; check "
                             f"{what_is_solid(geometry)}, or take a smaller particles.spacing")
        return result
    open_axes = [axis for axis in range(geometry.dim) if forcing.opens(case, axis)]
    result.connectivity = sites.connectivity(open_axes, forcing.reservoir_axes(case))
    if case.microporous:
        result.microporous = dict(zip(case.microporous, sites.microporous(geometry, len(case.microporous)).tolist()))
    driven = forcing.driven_axes(case, geometry.upper - geometry.lower)
    through = [axis for axis in driven if result.connectivity.percolates[axis]]
    if geometry.has_solid:
        result.throats = throats(sites, geometry, case.particles.spacing, through)
    if not _flow_is_expected(result, geometry, sites, driven):
        result.warnings += result.errors if to_run and case.flow != "stokes" else []
        return result
    if case.flow != "stokes":
        result.steps = steps(case, geometry, result.flow, result.throats, there)
    _costs(result, geometry, sites, ranks)
    if not to_run or case.flow != "stokes":
        drive_findings(result, geometry, sites, driven, through)
    _findings(result, geometry, sites, lattice, to_run)
    return result


def _findings(result: CheckResult, geometry: Geometry, sites: Sites, lattice: Lattice, to_run: bool) -> None:
    """Adds warnings and errors, by the expected flow; to_run: see `check`."""
    case = result.case
    kinds = {(f.density, f.mu) for f in case.fluids.values()}
    if case.flow == "stokes" and sites.per_fluid[1:].any() and len(kinds) > 1:
        result.errors.append("a steady solve has one fluid; use flow: navier_stokes for two")
    result.warnings += [*resolution_findings(result, geometry, lattice), *contact_angle_findings(case, geometry),
                        *reservoir_findings(case), *step_findings(result), *menisci_findings(result),
                        *other_findings(result, geometry, sites)]
    if not to_run:
        other = [f"the reference is not compared: {text}" for text in [other_sample(case, geometry)] if text]
        result.warnings += [*other, *absent_fluids(case, sites)]
    elif case.flow != "stokes":  # the run reports it, by its particles
        result.warnings += result.errors


def _flow_is_expected(result: CheckResult, geometry: Geometry, sites: Sites, driven: Sequence[int]) -> bool:
    """Finds the flow to expect; False where its velocity leaves the range of numbers, which is an error."""
    with np.errstate(all="ignore"):  # a flow that is not finite is reported
        flow = flow_estimate(result.case, geometry, sites, result.throats, driven)
    if flow is not None and not math.isfinite(flow.motion.largest + flow.motion.acceleration):
        result.errors.append("the velocity to expect leaves the range of numbers; check units of drive, viscosity and "
                             "initial velocity")
        return False
    result.flow = flow
    return True


def _costs(result: CheckResult, geometry: Geometry, sites: Sites, ranks: int | None) -> None:
    """Memory and time, and those of each of so many processes."""
    case = result.case
    share = memory.neighbours_held(case, geometry, sites.points(memory.SAMPLE), min(case.spacings))
    costs(result, geometry, share)
    if ranks is not None:
        of_ranks(result, geometry, ranks, share)


def _from_samples(result: CheckResult, geometry: Geometry, lattice: Lattice, ranks: int | None) -> None:
    """Estimates by random points for a lattice with too many sites to classify all."""
    case = result.case
    size = geometry.upper - geometry.lower
    points = geometry.lower + np.random.default_rng(0).random((memory.SAMPLE, geometry.dim)) * size
    inside = geometry.phase(points) >= 0
    share = float(inside.mean())
    porosity = f"porosity about {100 * share:.2g} %"
    if case.microporous:
        porosity += f", {100 * float((geometry.microporous(points) >= 0).mean()):.2g} % of the box microporous"
    result.particles = {"fluid": round(share * lattice.sites)}
    if case.flow != "stokes":
        fixed = case.time is not None and case.time.step
        result.steps = steps(case, geometry, None, None, list(case.fluids)) if fixed else None
    costs(result, geometry, memory.neighbours_held(case, geometry, points[inside], min(case.spacings)))
    # a second solve that does not fit leaves the first one its value
    need = sum(result.memory.values()) - (result.second.memory if result.second is not None else 0.0)
    left = memory.available()
    if ranks is not None:
        of_ranks(result, geometry, ranks)
    elif need > left:
        result.errors.append(f"needs about {in_bytes(need)} of memory, {in_bytes(left)} are free; "
                             f"{memory.too_large(case)}")
    result.warnings.append(
        f"{lattice.sites:,} lattice sites are too many to look at each ({MOST_SITES:,} at most): particles, memory and "
        f"time are from {memory.SAMPLE:,} random points ({porosity}), and pores, throats and "
        "time steps were not looked at; check a part of the scene for those"
    )


def physics_of(case: Case, geometry: Geometry, there: Sequence[str]) -> list[Physics]:
    """The parts of the physics, used and left out. there: names of the fluids that are in the scene: of one alone
    nothing is at an interface, whatever the case says of it."""
    moving = case.flow != "stokes"
    wall = geometry.has_solid
    moves = wall and bool(np.any(geometry.wall_speed))
    slips = wall and bool(np.any(geometry.slip_length > 0))
    around = "".join(a for a, p in zip(AXES, geometry.periodic) if p)
    fluids = [case.fluids[name] for name in there]
    jumps = len({f.mu for f in fluids}) > 1 or len({f.density for f in fluids}) > 1
    shifts = moving and case.particles.shifting > 0
    keeps = moving and case.particles.keep_volume > 0
    layered = around and any(a not in case.geometry.repeats for a in around)
    halo = f"along {around}" + (", closed by clear layers" if layered else "")
    tension = case.interface if len(there) > 1 else None
    without = "one fluid alone is there" if len(there) < len(case.fluids) else "no interface"
    line_slip = tension.slip_length if wall and tension is not None else 0.0
    added = 0.0
    if tension is not None:
        from ..two_phase.interface_rules import interface_rules

        added = interface_rules([f.density for f in fluids], [f.mu for f in fluids], tension.tension,
                                case.particles.spacing).added_viscosity
    starts = case.initial is not None and bool(case.initial.velocity)
    flood = case.initial.flood if case.initial else None
    ends = case.reservoirs
    beside = {force.name: force.words for force in forces_of(case, geometry)}
    return [
        Physics("walls", wall, f"distance {case.wall_distance}" if wall else "no solid and no closed face"),
        Physics("moving walls", moves, "a wall has a velocity" if moves else "all walls are at rest"),
        Physics("slip", slips or line_slip > 0, "a wall has a slip length" if slips else
             f"{line_slip:g} m at contact lines" if line_slip > 0 else "no slip length"),
        Physics("periodic halo", bool(around), halo if around else "no periodic axis"),
        Physics("inertia", moving, "particles move, in time" if moving else "flow: stokes"),
        Physics("viscosity", True, "implicit: no stability limit"),
        Physics("fluid contrasts", jumps, "density or viscosity differ" if jumps else "equal or one fluid"),
        Physics("shifting", shifts, f"C = {case.particles.shifting:g}" if shifts
             else "particles stay on the lattice" if not moving else "particles.shifting is 0"),
        Physics("kept volume", keeps, f"in {case.particles.keep_volume:g} steps" if keeps
             else "particles stay on the lattice" if not moving else "particles.keep_volume is 0"),
        Physics("surface tension", tension is not None,
             f"{tension.tension:g} N/m, {tension.method}" if tension else without),
        Physics("artificial viscosity", added > 0, f"{added:.2g} Pa s at the interface, which hardly damps" if added
             else without if not tension else "the interface damps enough at this spacing"),
        Physics("contact angle", tension is not None and wall,
             without if not tension else f"{tension.contact_angle:g} degrees" if wall else "no walls"),
        Physics("drive", forcing.is_driven(case), forcing.in_words(case)),
        *(Physics(known.name, known.name in beside, beside.get(known.name, known.without)) for known in FORCES),
        Physics("initial velocity", starts, "formula" if starts else "starts at rest"),
        Physics("reservoirs", ends is not None and len(there) > 1, "none" if not ends else without if len(there) < 2
             else f"{ends.inlet} at {ends.axis}_min, {ends.outlet} at {ends.axis}_max"),
        Physics("flooding", flood is not None, f"{flood.fluid} from {flood.face}" if flood else "none"),
    ]  # fmt: skip
