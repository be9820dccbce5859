"""Estimates of the flow, of time steps and of costs, meant to be right within a factor of two.

The numbers behind them stand below with the date on which they were measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..case import expressions, forcing
from ..case.blocks import AXES
from ..case.force_list import forces_of
from ..flow.forces import largest_of, resistance_of
from ..scene import memory
from .check_report import CheckReport, Flow, Steps, Throats
from .throats import LINE_POINTS, Sites

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry


# CPU microseconds a particle and axis of steady flow on one core at support 2.1, compilation left out: 27 in 2D
# (2026-11-22), 26 (sphere array) to 54 (Berea, 64^3 voxels) in 3D (`benchmarks/stokes.py`, 2026-11-30)
MICROSECONDS_STEADY = {2: 27.0, 3: 54.0}
# The same a particle and step of moving ones, by dimension and whether there are walls (2026-11-30): Taylor-Green 4.5
# in 2D and 4.1 in 3D (`benchmarks/step_cost.py`), a rising bubble 9.0, spheres that nearly touch 12.6
MICROSECONDS_MOVING = {(2, False): 4.5, (2, True): 9.0, (3, False): 4.5, (3, True): 12.5}
STEPS_TO_STEADY = 16  # at least, however large they are (trials before 2026-11-22)


def flow_estimate(
    case: Case, geometry: Geometry, sites: Sites, widths: Throats | None, driven: Sequence[int]
) -> Flow | None:
    """Largest velocity to expect: of the walls, at the start, or by the drive; None where nothing tells."""
    length = geometry.upper - geometry.lower
    width = _width(widths, case.particles.spacing, length)
    nu = min(f.nu for f in case.fluids.values())
    found: list[tuple[float, str]] = []
    if geometry.has_solid and np.any(geometry.wall_speed):
        found.append((float(geometry.wall_speed.max()), "moving wall"))
    if case.initial is not None and case.initial.velocity:
        variables = dict(zip(AXES, sites.points(LINE_POINTS).T))
        start = np.stack([expressions.evaluate(f, **variables) for f in case.initial.velocity], axis=1)
        found.append((float(np.linalg.norm(start, axis=1).max()), "initial velocity"))
    g = float(np.linalg.norm(forcing.largest_acceleration(case, length)))
    beside = forces_of(case, geometry)
    more = largest_of(beside)
    if (g > 0 and driven) or more > 0:
        g += more
        resistance = resistance_of(beside, sites.points(LINE_POINTS))
        least = 0.0 if resistance is None else float(resistance.min())
        creeping = (g * width**2 / (8 * nu) / (1 + least * width**2 / 8), "creeping flow in the throats, g w2 / 8 nu")
        end = case.time.end if case.time else None
        inertial = (math.sqrt(2 * g * float(np.max(length))), "free fall over the box")
        started = (g * end, "acceleration until the end") if end else inertial
        found.append(min(creeping, inertial, started, key=lambda estimate: estimate[0]))
    held = forcing.held_flux(case)
    if held is not None:
        porosity = sites.particles["fluid"] * sites.lattice.site_volume / float(np.prod(length))
        found.append((abs(held[1]) / porosity, "held superficial velocity over the porosity"))
    if case.interface is not None:
        rho = max(f.density for f in case.fluids.values())
        found.append(
            (math.sqrt(case.interface.tension / (rho * width)), "surface tension, sqrt(sigma / rho w)")
        )
    if not found or max(estimate for estimate, _ in found) == 0:
        return None
    u, source = max(found, key=lambda estimate: estimate[0])
    mu = max(f.mu for f in case.fluids.values())
    capillary = mu * u / case.interface.tension if case.interface else None
    return Flow(u, source, u * width / nu, capillary)


def _width(widths: Throats | None, spacing: float, length: np.ndarray) -> float:
    """Width that the estimates take, m: the critical or the median throat, else the box."""
    if widths is None:
        return float(length.min())
    return spacing * (max(widths.critical.values()) if widths.critical else widths.median)


def steps(case: Case, flow: Flow | None, widths: Throats | None) -> Steps:
    """Time-step limits of a run in time, and its steps."""
    spacing, fluids = case.particles.spacing, list(case.fluids.values())
    assert case.time is not None
    limits = {}
    if case.time.step:
        limits["fixed"] = case.time.step
    if flow is not None:
        limits["cfl"] = case.time.cfl * spacing / flow.velocity
    if case.interface is not None:
        density = sum(f.density for f in fluids) / len(fluids)
        wave = math.sqrt(density * spacing**3 / (2 * math.pi * case.interface.tension))
        limits["capillary"] = case.time.capillary * wave
    limits["viscous accuracy"] = spacing**2 / max(f.nu for f in fluids)
    step = case.time.step or min(
        dt for name, dt in limits.items() if name != "viscous accuracy" or len(limits) == 1
    )
    end = forcing.longest_time(case)
    count = None if end is None else max(end / step, 1.0)
    if case.time.steady and widths is not None:
        slowest = min(f.nu for f in fluids)
        decay = (widths.median * spacing) ** 2 / (math.pi**2 * slowest)
        steady = max(decay * math.log(1 / case.time.steady) / step, STEPS_TO_STEADY)
        count = steady if count is None else min(count, steady)
    count = None if count is None else min(count, float(case.time.max_steps))
    return Steps(limits, count)


def costs(result: CheckReport, geometry: Geometry, share: float = 1.0) -> None:
    """Neighbours, memory and time. share: see `memory.fluid_round`."""
    case, dim = result.case, result.dim
    result.neighbours = memory.neighbours(case, dim)
    spacing = case.particles.spacing
    finest = (spacing / min(case.spacings)) ** dim
    fluid, labels = result.particles["fluid"] * finest, geometry.labels
    result.memory = memory.estimate(case, dim, geometry.has_solid, fluid, result.particles.get("dummy", 0) * finest,
                                    two=len(case.fluids) > 1, share=share)
    if labels is not None:
        result.memory["image"] = labels.size * memory.BYTES_VOXEL
    runs: float | None = 1.0
    if case.flow == "stokes":
        sizes = sum((spacing / other) ** dim for other in case.spacings) / finest
        runs = sizes * max(len(forcing.steady_axes(case)), 1)
    elif result.steps is not None:
        runs = result.steps.count
    density_of_pairs = result.neighbours / (memory.PAIRS[dim] * 2.1**dim)
    if runs is not None:
        steady = case.flow == "stokes"
        each = MICROSECONDS_STEADY[dim] if steady else MICROSECONDS_MOVING[dim, geometry.has_solid]
        result.seconds = fluid * runs * density_of_pairs * each * 1e-6
