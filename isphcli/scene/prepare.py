"""From a case to the state and the stepper of moving particles."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..case import expressions, forcing
from ..case.force_list import forces_of
from ..case.forcing import drives, held_flux
from ..domain import reduce
from ..domain.communicator import current
from ..flow.forces import largest_of
from ..flow.held_velocity import Beyond, HeldVelocity
from ..flow.one_fluid import OneFluid
from ..flow.state import State
from ..flow.step import Stepper
from ..flow.step_limits import Bounds
from ..geometry.extents import part_of_sample
from ..geometry.protocol import sample_box
from ..operators.kernel import KERNELS
from ..output.environment import keep_freed_memory
from ..solvers.engine import engine_of
from ..solvers.kept_hierarchies import KeptHierarchies
from . import memory
from .choose_fluids import choose_fluids
from .place import jittered, lattice_at, place_case, sight_of, with_fluids

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.cut import Share
    from ..domain.lattice import Lattice, Particles
    from ..domain.migration import Migration
    from ..flow.seam import Seam
    from ..flow.timed_drive import TimedDrive
    from ..flow.volume_control import KeptVolume
    from ..geometry.protocol import Geometry
    from ..output.clock import Clock


def held_velocity(case: Case, particles: Particles, reference: float, geometry: Geometry) -> HeldVelocity | None:
    """HeldVelocity of a case, or None. reference: density of the first fluid, kg/m3."""
    held = held_flux(case)
    if held is None:
        return None
    axis, wanted = held
    place, porosity = beyond_the_sample(case, particles, geometry, axis)
    length = float((geometry.upper - geometry.lower)[axis])
    return HeldVelocity(wanted, place, porosity, reference * length)


def beyond_the_sample(case: Case, particles: Particles, geometry: Geometry, axis: int) -> tuple[Beyond, float]:
    """What lies beyond the ends of the sample along an axis, and the porosity of the sample, or of the box where
    nothing does."""
    lattice, x = lattice_at(case, geometry, case.particles.spacing), particles.x[: particles.n_fluid]
    box, thick = float(np.prod(geometry.upper - geometry.lower)), float(lattice.thick[axis])
    lower, upper = (float(corner[axis]) for corner in sample_box(geometry))
    if lower <= geometry.lower[axis] and upper >= geometry.upper[axis]:
        weight = particles.site_volume / box
        return Beyond(axis, np.inf, -np.inf, thick, weight), reduce.number(x) * weight
    sample = box * (upper - lower) / float((geometry.upper - geometry.lower)[axis])
    held = reduce.total(part_of_sample(geometry, x, lattice.thick))
    # clear layers of an image are all fluid, whatever the distance of the last particles from the walls along them
    filled = _filled(lattice, geometry, axis) if geometry.voxel_size is not None else 1.0
    weight = particles.site_volume / (filled * (box - sample))
    return Beyond(axis, lower, upper, thick, weight), float(held) * particles.site_volume / sample


def _filled(lattice: Lattice, geometry: Geometry, axis: int) -> float:
    """Share of the cross section of the box along an axis that the cells of sites within it have."""
    share = 1.0
    for a in np.flatnonzero(~np.array(geometry.periodic)):
        if a != axis:
            layers = np.add.outer(np.arange(lattice.counts[a]), np.unique(lattice.basis[:, a])) * lattice.cell[a]
            within = (layers + lattice.corner[a] > geometry.lower[a]) & (layers + lattice.corner[a] < geometry.upper[a])
            share *= float(within.sum() * lattice.thick[a] / (geometry.upper - geometry.lower)[a])
    return share


SPREAD = 10.0  # root mean square speed over the mean of a held flow, at most; in rock it is 2 to 3


def prepare(case: Case, geometry: Geometry, clock: Clock) -> tuple[State, Stepper, Particles]:
    """(State, Stepper, Particles) of a case at rest or with its initial velocity.

    Raises ParticleError where the scene has no fluid or needs more memory than is left.
    """
    keep_freed_memory()
    assert case.time is not None  # of moving particles
    spacing, support = case.particles.spacing, case.support * case.particles.spacing
    with clock("geometry"):
        memory.refuse_lattice(case, geometry, spacing)
        particles = place_case(case, geometry, spacing)
        share, number = particles.share, None
        if share is not None:
            from ..domain.migration import numbers_of

            geometry = geometry.within(share.lower, share.upper, sight_of(case, spacing, geometry.dim))
            number = numbers_of(share.sites, lattice_at(case, geometry, spacing).sites)
            if case.particles.jitter > 0.0:
                particles = jittered(case, geometry, particles, number, spacing)
            particles = with_fluids(case, geometry, particles)
    n = particles.n_fluid
    two = particles.two_fluids
    need = memory.estimate(case, geometry.dim, geometry.has_solid, n, particles.n_dummy, two=two,
                           share=memory.neighbours_held(case, geometry, particles.x[:n], spacing))
    most = float(reduce.largest(np.array([sum(need.values())])))
    memory.refuse(most * current().here, f"{n:,} fluid particles{' of two fluids' * two}", memory.too_large(case))
    x = particles.x[:n].copy()
    u = initial_velocity(case, x)
    force = sum((force for _, force in drives(case, geometry)), np.zeros(geometry.dim))
    fluids = choose_fluids(case, geometry, particles, force)
    held = held_velocity(case, particles, fluids.reference, geometry)
    drive = timed_drive(case, geometry) if forcing.changes(case) else None
    stepper = Stepper(
        geometry=geometry, dummies=particles.dummies_in_sight, spacing=spacing, support=support,
        kind=KERNELS[case.particles.kernel], site_volume=particles.site_volume,
        fluids=fluids, shifting=case.particles.shifting, second_order=case.time.scheme == "bdf2",
        solvers=KeptHierarchies(case.solver.tolerance, case.solver.restart, case.solver.max_iterations, clock,
                                engine_of(case.solver.engine)),
        bounds=bounds(case, geometry, particles, u, held, drive), held_velocity=held,
        volume=kept_volume(case, geometry, x), timed_drive=drive, seam=seam(case, particles, geometry),
        migration=migration(share, geometry, max(support, fluids.reach)),
    )
    gradient, phi, volume = None if forcing.gradient_axis(case) is None else 0.0, None, None
    if not isinstance(fluids, OneFluid):
        from .first_interface import first_interface

        with clock("geometry"):
            phi, volume = first_interface(case, geometry, particles, stepper, number)
    elif two:  # fluids that differ in name only: phi has the fluid of each particle
        phi = np.where(particles.phase == 0, spacing, -spacing)
    state = State(x, u, u.copy(), np.zeros(n), pressure_gradient=gradient,
                  phi=phi, number=number, volume=volume)
    if forcing.drive_steps(case) is not None:
        from ..runs.drive_steps import begun

        state = replace(state, drive_step=begun(0, 0.0))
    return state, stepper, particles


def migration(share: Share | None, geometry: Geometry, reach: float) -> Migration | None:
    """Between the bricks of processes, each of which sees as far as `reach`, m; None of one process."""
    if share is None:
        return None
    from ..domain.migration import Migration

    return Migration(share, geometry.lower, geometry.upper, geometry.periodic, reach)


def initial_velocity(case: Case, x: np.ndarray) -> np.ndarray:
    """Velocity (n, dim), m/s, at x (n, dim), m, by the formulas of a case; without any the fluid is at rest."""
    u = np.zeros_like(x)
    if case.initial is not None and case.initial.velocity:
        names = dict(zip("xyz", x.T))
        for k, formula in enumerate(case.initial.velocity):
            try:
                u[:, k] = expressions.evaluate(formula, **names)
            except expressions.ExpressionError as error:
                raise expressions.ExpressionError(f"initial.velocity.{k}: {error}") from None
    return u


def seam(case: Case, particles: Particles, geometry: Geometry) -> Seam | None:
    """The Seam between the two reservoirs of a case; None without reservoirs, and where all particles are of one
    fluid."""
    if case.reservoirs is None or not particles.two_fluids:
        return None
    from ..flow.seam import Seam

    axis = "xyz".index(case.reservoirs.axis)
    fluids = (case.fluid_names.index(case.reservoirs.inlet), case.fluid_names.index(case.reservoirs.outlet))
    length = float(geometry.sample_lower[axis] - geometry.lower[axis])
    depth = min(case.support * case.particles.spacing, 0.5 * length)  # no support at the seam reaches another one
    reservoirs, _ = beyond_the_sample(case, particles, geometry, axis)
    area = float(np.prod(np.delete(geometry.upper - geometry.lower, axis)))
    return Seam(axis, float(geometry.lower[axis]), float(geometry.upper[axis]), depth, fluids, reservoirs, area)


def bounds(case: Case, geometry: Geometry, particles: Particles, u: np.ndarray, rate: HeldVelocity | None,
           drive: TimedDrive | None) -> Bounds:
    """Bounds of a case that starts with velocities u (n, dim). rate, drive: of the Stepper, or None."""
    density = np.array([fluid.density for fluid in case.fluids.values()])[particles.phase]
    walls = np.max(geometry.wall_speed, initial=0.0)
    tension = case.interface.tension if case.interface is not None else 0.0
    capillary = np.sqrt(tension / (reduce.mean(density) * case.particles.spacing))
    speed = rate.speed if rate is not None else 0.0
    steps = forcing.drive_steps(case)
    if rate is not None and steps is not None and steps.superficial_velocity:
        speed = max(replace(rate, wanted=wanted).speed for wanted in steps.superficial_velocity)
    other = walls + capillary + SPREAD * speed
    force = float(forcing.strongest_acceleration(case, geometry.upper - geometry.lower))
    force += largest_of(forces_of(case, geometry))
    largest = drive.largest_force if drive is not None else None
    found = Bounds(geometry, particles.site_volume, 0.0, force, other, largest)
    return replace(found, start=found.speed(u, density))


def timed_drive(case: Case, geometry: Geometry) -> TimedDrive:
    """TimedDrive of a case of which a formula of the time drives the flow."""
    from ..flow.timed_drive import TimedDrive

    lengths, dim = geometry.upper - geometry.lower, geometry.dim
    start = forcing.wall_velocities(case, dim)

    def forces(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        body = forcing.body_force(case, dim, times)
        return body, forcing.acceleration(case, lengths, times) - body

    def walls(times: np.ndarray) -> np.ndarray:
        found = np.repeat(geometry.wall_velocity[None], len(times), axis=0)  # of the start, with what turns
        for wall, velocity in forcing.wall_velocities(case, dim, times).items():
            found[:, wall] += velocity - start[wall]
        return found

    def strongest(times: np.ndarray) -> np.ndarray:
        return forcing.strongest_acceleration(case, lengths, times)

    return TimedDrive(forces, strongest, walls if forcing.walls_change(case) else None)


def kept_volume(case: Case, geometry: Geometry, x: np.ndarray) -> KeptVolume | None:
    """KeptVolume of a case, or None. x: (n, dim) fluid particles where they begin, m."""
    if not case.particles.keep_volume:
        return None
    from ..flow.volume_control import KeptVolume

    return KeptVolume(geometry, x, case.particles.spacing, case.particles.keep_volume)
