"""Estimates of the flow, of time steps and of costs, meant to be right within a factor of two.

The numbers behind them are below, with the date on which they were measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..case import forcing
from ..case.force_list import forces_of
from ..flow.forces import largest_of, resistance_of
from ..output.render import deep_enough
from ..runs.refinement import Solved, further_spacings
from ..scene import memory
from .check_result import CheckResult, Flow, Motion, SecondSolve, Steps, Throats
from .expected_steps import expected_steps
from .findings import fluids_there
from .throats import LINE_POINTS, Sites

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry


# FASTEST, FASTEST_IN_ROCK: speed of the fastest particle over the mean in the pores, where a velocity is held: on the
# axis of a pipe; in Berea sandstone, by the steps of cases/berea_drainage.yaml. MENISCI: upper bound of the speed of
# menisci over sqrt(sigma / rho w): driven slowly, the same case takes steps of 1.3 us
FASTEST, FASTEST_IN_ROCK, MENISCI = 2.0, 6.0, 0.3
SAID = 0.05  # of the expected velocity: a cause of a smaller share is not named
# CPU seconds of one core without compilation, pictures and reference, from docs/validation.md (1836b9f, 2026-11-30) and
# docs/performance.md; benchmarks/estimates.py compares them with runs. A step: a part for any scene, and microseconds a
# particle at support 2.1 (square or cubic lattice), of which a denser one or a wider support has more neighbours; by
# dimension and whether there are walls. SECONDS_RUN: modules, files and small arrays of any run (slit, taylor_couette
# and taylor_green_2d take 0.18 to 0.21 s in all beside a load of 7, `python benchmarks/estimates.py slit`)
# SECONDS_KERNELS: kernels that two fluids read from their files, 0.3 to 0.5 s: `isph run` in a process of its own less
# the second run in the same
SECONDS_RUN, SECONDS_KERNELS = 0.17, 0.3
SECONDS_STEP, SECONDS_STEP_TWO = 2.3e-3, 4.0e-3
MICROSECONDS_MOVING = {(2, False): 2.7, (2, True): 5.5, (3, False): 4.3, (3, True): 15.0}
MICROSECONDS_TWO = {(2, False): 3.2, (2, True): 5.1, (3, False): 9.5, (3, True): 9.5}
# Of two fluids in 3D a dummy particle, which stands for the walls: steps of berea_drainage, berea_injection and
# co2_bubbles, with 0.53, 1.04 and 0.28 of them a fluid particle, take 25, 26 to 30 and 31 us a fluid particle (the last
# with twice the neighbours; 2026-12-01, loads of 2 to 4)
MICROSECONDS_WALLS_TWO = 22.0
# What two fluids take before their second step, in steps. FROM_LABELS: where a flood, reservoirs or labels say which
# fluid is where, 40 passes smooth the first distances (`scene/first_interface.py`), which with the rest of the geometry
# take 6.0 and 5.8 steps in berea_drainage and berea_injection. HELD: passes of a first step whose flux is held, and
# those that set the fluid in motion: 4.1 and 2.8 steps more than one. `isph run` with time.max_steps of 1, 5 and 20 or
# 24, cpu_seconds of summary.json (2026-12-01, load 4): drainage 5.8, 8.4 and 15.5 s, of which 3.05 geometry, injection
# 1.88, 2.55 and 5.99 s, of which 1.03
FROM_LABELS, HELD = 6.0, 3.5
# Of steady flow a particle: once, and an iteration for each axis (0.45 on an array of spheres and in a corner of Berea
# sandstone, 0.5 in all of it, twice the pairs in a pack of beads, by benchmarks/stokes.py on a busy machine); in 2D an
# axis. Iterations are 18 to 24 in wide pores, 34 in Berea sandstone, 59 in a pack of beads: see `_iterations`
MICROSECONDS_ONCE, MICROSECONDS_ITERATION, MICROSECONDS_STEADY_2D = 12.0, 0.62, 27.0
ITERATIONS, ITERATIONS_OF_THROATS, HALF = 9.0, 50.0, 2.5  # HALF: particles
# Of steady flow past shapes a dummy particle: distances to walls, where pairs cross them, and means over cells that
# they cut; cases/bead_pack.yaml takes 15.3 s for 409,273 (geometry in summary.json, load 8 to 10 on two cores)
MICROSECONDS_SHAPES = 37.0
# Particles of `refine: throats` over those of half the spacing everywhere: 0.33 and 0.21 in corners of Berea of 32^3
# and 64^3 voxels, 0.28 in the whole cube (docs/design_notes.md, docs/clusters.md): the mean of them, which no width
# tells before a flow is known; arrays of spheres and packs of beads in boxes of up to 20 spacings 0.9 to 1
IN_ROCK, AMONG_SHAPES = 0.27, 1.0


# Bytes for drawing, by whether there are pictures in 3D: peaks of runs of up to 11,000 particles were 276 to 380
# MB without those and 551 MB with them (couette, slit, cylinder_array, taylor_green_2d; sphere_array; 2026-11-30), 228
# to 232 MB without any
BYTES_PICTURES = {False: 1.0e8, True: 3.0e8}


def flow_estimate(
    case: Case, geometry: Geometry, sites: Sites, widths: Throats | None, driven: Sequence[int]
) -> Flow | None:
    """Largest velocity to expect: of the walls, at the start, or by the drive; None where nothing tells."""
    length = geometry.upper - geometry.lower
    width = _width(widths, case.particles.spacing, length)
    nu = min(f.nu for f in case.fluids.values())
    found: list[tuple[Motion, str]] = []
    if geometry.has_solid and np.any(geometry.wall_speed):
        found.append((Motion(always=float(geometry.wall_speed.max())), "moving wall"))
    if case.initial is not None and case.initial.velocity:
        found.append((_from_the_start(case, sites), "initial velocity"))
    found += _driven(case, geometry, sites, width, driven)
    held = forcing.held_flux(case)
    if held is not None:
        inside = np.count_nonzero(sites.phase[sites.sample] >= 0) * sites.lattice.site_volume
        porosity = inside / float(np.prod(geometry.sample_upper - geometry.sample_lower))
        fastest = FASTEST_IN_ROCK if geometry.voxel_size is not None else FASTEST
        found.append((Motion(always=fastest * abs(held[1]) / porosity), f"{fastest:g} times the mean of a held flow"))
    if case.interface is not None:
        found += _of_tension(case, sites, width)
    if not found or max(motion.largest for motion, _ in found) == 0:
        return None
    motion = _together([motion for motion, _ in found])
    u, mu = motion.largest, max(f.mu for f in case.fluids.values())
    parts = sorted((entry for entry in found if entry[0].largest > SAID * u), key=lambda entry: -entry[0].largest)
    source = " + ".join(name for _, name in parts)
    capillary = mu * u / case.interface.tension if case.interface else None
    return Flow(u, source, u * width / nu, capillary, motion)


def _of_tension(case: Case, sites: Sites, width: float) -> Iterator[tuple[Motion, str]]:
    """Motions by tension: of menisci in the pores, which last, and of bodies of the minority fluid, which come to rest:
    the second mode of a drop of radius R decays at 5 nu / R^2 (Lamb, Hydrodynamics, section 355)."""
    assert case.interface is not None
    tension, fluids = case.interface.tension, list(case.fluids.values())
    speed = MENISCI * math.sqrt(tension / (max(f.density for f in fluids) * width))
    yield Motion(always=speed), f"menisci, {MENISCI:g} sqrt(sigma / rho w)"
    radius = sites.smaller_body() * case.particles.spacing
    if radius > 0.0:
        nu = sum(f.nu for f in fluids) / len(fluids)
        speed = math.sqrt(tension / (min(f.density for f in fluids) * radius))
        yield Motion(start=speed, decay=radius**2 / (5.0 * nu)), "surface tension, sqrt(sigma / rho R)"


def _together(motions: Sequence[Motion]) -> Motion:
    """Several motions as one: the fastest start, the fastest driven motion, and the sum of those that last."""
    starts, driven = (max(motions, key=lambda motion, name=name: getattr(motion, name)) for name in ("start", "driven"))  # type: ignore[misc]
    return Motion(starts.start, starts.decay, driven.driven, driven.rise, sum(motion.always for motion in motions),
                  max(motion.acceleration for motion in motions))


def _from_the_start(case: Case, sites: Sites) -> Motion:
    """The motion by the initial velocity of a case: its largest speed, and the time in which viscosity lowers the root
    mean square speed by a factor e, |u|^2 / (nu |grad u|^2) in the mean over the fluid."""
    from ..scene.prepare import initial_velocity

    x = sites.points(LINE_POINTS)
    nu, h = min(f.nu for f in case.fluids.values()), 1e-3 * case.particles.spacing

    u = initial_velocity(case, x)
    slopes = sum(((initial_velocity(case, x + h * e) - u) ** 2).sum() for e in np.eye(x.shape[1])) / h**2
    decay = float((u**2).sum() / (nu * slopes)) if slopes > 0.0 else math.inf
    return Motion(start=float(np.linalg.norm(u, axis=1).max()), decay=decay)


def _driven(case: Case, geometry: Geometry, sites: Sites, width: float,
            driven: Sequence[int]) -> Iterator[tuple[Motion, str]]:
    """Motions by forces from rest: the velocity is g t until walls or the length of the fluid limit it."""
    length, nu = geometry.upper - geometry.lower, min(f.nu for f in case.fluids.values())
    force = forcing.largest_acceleration(case, length)
    g, fall = float(np.linalg.norm(force)), float(np.max(length))
    if driven and not any(forcing.opens(case, axis) for axis in driven):  # only differences of density drive a flow
        densities = [case.fluids[name].density for name in fluids_there(case, sites)]
        g *= (max(densities) - min(densities)) / (max(densities) + min(densities))
        # a fluid that floods the rock has no sites yet
        fall = 0.5 * sites.smaller_body() * case.particles.spacing or fall
    beside = forces_of(case, geometry)
    more = largest_of(beside)
    if not ((g > 0 and driven) or more > 0):
        return
    g += more
    resistance = resistance_of(beside, sites.points(LINE_POINTS))
    least = 0.0 if resistance is None else float(resistance.min())
    bounds = [(math.sqrt(2 * g * fall), "free fall over the box")]
    if forcing.changes(case):
        times = forcing.sample_times(case)
        pushes = np.diff(times)[:, None] * forcing.acceleration(case, length, times[:-1])
        bounds.append((float(np.linalg.norm(np.cumsum(pushes, axis=0), axis=1).max()), "the drive over its time"))
    if geometry.has_solid or least > 0:
        creeping = g * width**2 / (8 * nu) / (1 + least * width**2 / 8)
        bounds.append((creeping, "creeping flow in the throats, g w2 / 8 nu"))
    speed, source = min(bounds)
    end = forcing.longest_time(case)
    if end is not None and -speed * math.expm1(-g * end / speed) < 0.7 * speed:
        source = "acceleration until the end"
        speed = min(speed, g * end)
    yield Motion(driven=speed, rise=speed / g, acceleration=g), source


def _width(widths: Throats | None, spacing: float, length: np.ndarray) -> float:
    """Width that the estimates take, m: the critical or the median throat, else the box."""
    if widths is None:
        return float(length.min())
    return spacing * (max(widths.critical.values()) if widths.critical else widths.median)


def steps(case: Case, geometry: Geometry, flow: Flow | None, widths: Throats | None, fluids: list[str]) -> Steps:
    """Time-step limits of a run in time, and its steps. fluids: names of those that are there."""
    decay = None
    if widths is not None:
        decay = (widths.median * case.particles.spacing) ** 2 / (math.pi**2 * min(case.fluids[f].nu for f in fluids))
    return expected_steps(case, geometry, Motion() if flow is None else flow.motion, fluids, decay)


def _iterations(widths: Throats | None, finer: float) -> float:
    """Of a steady solve, by the width below which a tenth of the fluid lies: pores of few particles take most. finer:
    spacing of the widths over that of the solve."""
    narrow = math.inf if widths is None else widths.narrow * finer
    return ITERATIONS + ITERATIONS_OF_THROATS / (1.0 + (narrow / HALF) ** 2)


def costs(result: CheckResult, geometry: Geometry, share: float = 1.0) -> None:
    """Neighbours, memory and time. share: see `memory.neighbours_held`."""
    case, dim = result.case, result.dim
    result.neighbours = memory.neighbours(case, dim)
    spacing = case.particles.spacing
    result.spacings = _spacings(result, geometry)
    finest = (spacing / min(result.spacings)) ** dim
    fluid, dummies = (result.particles.get(kind, 0) * finest for kind in ("fluid", "dummy"))
    two, labels = len(case.fluids) > 1, geometry.labels
    result.memory = memory.estimate(case, dim, geometry.has_solid, fluid, dummies, two=two, share=share)
    if case.output.plots:
        result.memory["pictures"] = BYTES_PICTURES[deep_enough(geometry, spacing)]
    if labels is not None:
        result.memory["image"] = labels.size * memory.BYTES_VOXEL
    result.seconds = _seconds(result, geometry, fluid)
    if case.refine == "throats" and result.seconds is not None and fluid:
        result.second = _second_solve(result, geometry, fluid, dummies)
        result.memory["half the spacing in throats"] = result.second.memory
        result.seconds += result.second.seconds


def _spacings(result: CheckResult, geometry: Geometry) -> list[float]:
    """Spacings, m, that are solved; of `refine: auto` those that the free memory and the expected seconds let it take:
    it asks for them itself, of solves that take as long as is expected."""
    case, fluid = result.case, result.particles.get("fluid", 0)
    if case.refine != "auto" or not fluid:
        return list(case.spacings)
    base = case.particles.spacing
    solved = [Solved(base, fluid, _solve_seconds(result, geometry, base))]
    for further in further_spacings(case, geometry, solved):
        particles = round(fluid * (base / further) ** result.dim)
        solved.append(Solved(further, particles, _solve_seconds(result, geometry, further)))
    return [level.spacing for level in solved]


def _solve_seconds(result: CheckResult, geometry: Geometry, spacing: float) -> float:
    """CPU seconds of the steady solves along all axes at a spacing, m."""
    finer, axes = result.case.particles.spacing / spacing, max(len(forcing.steady_axes(result.case)), 1)
    fluid, dummies = (result.particles.get(kind, 0) * finer**result.dim for kind in ("fluid", "dummy"))
    return fluid * _steady_seconds(result, axes, finer) + _of_shapes(result, geometry, dummies)


def _second_solve(result: CheckResult, geometry: Geometry, fluid: float, dummies: float) -> SecondSolve:
    """The second solve of `refine: throats`, which builds new matrices for each axis."""
    most = fluid * 2**result.dim
    particles = most * (AMONG_SHAPES if geometry.voxel_size is None else IN_ROCK)
    axes = max(len(forcing.steady_axes(result.case)), 1)
    return SecondSolve(particles, most, particles * memory.BYTES_TWO_SPACINGS,
                       axes * (particles * _steady_seconds(result, 1)
                               + _of_shapes(result, geometry, dummies * particles / fluid)))


def _pairs(result: CheckResult) -> float:
    """Neighbours of a particle over those of support 2.1, in millions."""
    return 1e-6 * result.neighbours / (memory.PAIRS[result.dim] * 2.1**result.dim)


def _steady_seconds(result: CheckResult, axes: int, finer: float = 1.0) -> float:
    """CPU seconds of a particle of a steady solve along so many axes with the same matrices; finer: the spacing of the
    case over that of the solve."""
    if result.dim == 2:
        return _pairs(result) * axes * MICROSECONDS_STEADY_2D
    iterations = _iterations(result.throats, finer)
    return _pairs(result) * (MICROSECONDS_ONCE + axes * iterations * MICROSECONDS_ITERATION)


def _of_shapes(result: CheckResult, geometry: Geometry, dummies: float) -> float:
    """CPU seconds to find distances to shapes in 3D, and where pairs cross their walls; none of images."""
    return 1e-6 * MICROSECONDS_SHAPES * dummies * (result.dim == 3 and geometry.voxel_size is None)


def _seconds(result: CheckResult, geometry: Geometry, fluid: float) -> float | None:
    """CPU seconds of a run, in time of so many particles; None where there is no telling."""
    case, dim = result.case, result.dim
    pairs = _pairs(result)
    if case.flow == "stokes":
        return SECONDS_RUN + sum(_solve_seconds(result, geometry, spacing) for spacing in result.spacings)
    if result.steps is None or result.steps.count is None:
        return None
    count = result.steps.count
    if len(case.fluids) < 2:
        return SECONDS_RUN + count * (SECONDS_STEP + fluid * pairs * MICROSECONDS_MOVING[dim, geometry.has_solid])
    each = MICROSECONDS_TWO[dim, geometry.has_solid]
    if dim == 3 and fluid:
        each += MICROSECONDS_WALLS_TWO * result.particles.get("dummy", 0) / result.particles["fluid"]
    step = SECONDS_STEP_TWO + fluid * pairs * each
    return SECONDS_RUN + SECONDS_KERNELS + (count + _before_the_second_step(case, geometry)) * step


def _before_the_second_step(case: Case, geometry: Geometry) -> float:
    """Steps that would take as long as what two fluids take once: the first interface, and more passes of the first
    step."""
    flooded = case.initial is not None and case.initial.flood is not None
    labels = flooded or case.reservoirs is not None or geometry.voxel_size is not None
    return FROM_LABELS * labels + HELD * (forcing.held_flux(case) is not None)
