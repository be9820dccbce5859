"""The particles of a case: fluid particles on a lattice, and dummies within a support of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..domain.halo import wrap
from ..domain.lattice import Lattice, ParticleError, Particles, make_lattice
from ..geometry.protocol import Geometry, inside_sample, sample_box

if TYPE_CHECKING:
    from ..case.blocks import Case


def lattice_at(case: Case, geometry: Geometry, spacing: float) -> Lattice:
    """The Lattice of a case at a spacing. Raises ParticleError where the spacing does not fit the box."""
    return make_lattice(case.lattice_in(geometry.dim), geometry.lower, geometry.upper, geometry.periodic, spacing,
                        case.support * spacing, case.particles.offset)


def place_case(case: Case, geometry: Geometry, spacing: float) -> Particles:
    """The particles of a case at a spacing, which may be another than its own. Raises ParticleError."""
    asked = case.particles
    particles = place(geometry, lattice_at(case, geometry, spacing), case.support * spacing, asked.jitter, spacing,
                      asked.seed)
    flood = case.initial.flood if case.initial is not None else None
    if flood is not None:
        particles = flooded(particles, geometry, case.fluid_names.index(flood.fluid), flood.face, flood.saturation)
    if case.reservoirs is not None:
        fluids = tuple(case.fluid_names.index(name) for name in (case.reservoirs.inlet, case.reservoirs.outlet))
        particles = filled(particles, geometry, "xyz".index(case.reservoirs.axis), fluids)
    return particles


def filled(particles: Particles, geometry: Geometry, axis: int, fluids: Sequence[int]) -> Particles:
    """The particles, those below the sample along an axis of fluid fluids[0], those above it of fluid fluids[1]."""
    along = particles.x[: particles.n_fluid, axis]
    lower, upper = (corner[axis] for corner in sample_box(geometry))
    phase = particles.phase.copy()
    phase[along < lower], phase[along > upper] = fluids
    return replace(particles, phase=phase)


def flooded(particles: Particles, geometry: Geometry, fluid: int, face: str, saturation: float) -> Particles:
    """The particles, those nearest to a face of fluid `fluid`, up to a share `saturation` of those in the sample.

    Raises ParticleError where the sample holds no fluid.
    """
    axis, side = "xyz".index(face[0]), 1.0 if face.endswith("min") else -1.0
    x = particles.x[: particles.n_fluid]
    lower, upper = sample_box(geometry)
    depth = side * x[:, axis]
    inside = np.sort(depth[inside_sample(geometry, x)])
    if not len(inside):
        raise ParticleError("no fluid particle in the sample: there is nothing to flood; "
                            f"check {what_is_solid(geometry)}, or take a smaller particles.spacing")
    last = inside[max(round(saturation * len(inside)), 1) - 1]
    phase = particles.phase.copy()
    phase[depth <= last + 1e-9 * abs(upper[axis] - lower[axis])] = fluid
    return replace(particles, phase=phase)


def what_is_solid(geometry: Geometry) -> str:
    """Key that says what is solid in a scene."""
    return "geometry.voxels.labels" if geometry.labels is not None else "geometry.shapes and geometry.fluid"


def place(geometry: Geometry, lattice: Lattice, support: float, jitter: float = 0.0, spacing: float = 0.0,
          seed: int = 0) -> Particles:
    """Fluid particles and dummies of a lattice.

    jitter: random displacement of the fluid particles, as a fraction of `spacing`; one that would end in a solid
    stays. Raises ParticleError where there is no fluid.
    """
    fluid, phases, dummies, inside, left_out = [], [], [], 0, 0
    for sites in lattice.slabs():
        # an offset lattice sticks out of the box along periodic axes
        x = wrap(sites, geometry.lower, geometry.upper, geometry.periodic)
        phase = geometry.phase(x)
        is_fluid = phase >= 0
        fluid.append(x[is_fluid])
        phases.append(phase[is_fluid])
        if geometry.has_solid:
            solid = x[~is_fluid]
            seen = -geometry.distance(solid) < support * (1.0 + 1e-9)
            dummies.append(solid[seen])
            left_out += int((~seen).sum())
        inside += int(np.all((x >= geometry.lower) & (x <= geometry.upper), axis=1).sum())
    x, phase = np.concatenate(fluid), np.concatenate(phases)
    if len(x) == 0:
        raise ParticleError("no fluid particle: the scene is solid everywhere at this spacing; "
                            f"check {what_is_solid(geometry)}, or take a smaller particles.spacing")
    if jitter > 0.0:
        rng = np.random.default_rng(seed)
        moved = x + rng.uniform(-jitter, jitter, x.shape) * spacing
        moved = wrap(moved, geometry.lower, geometry.upper, geometry.periodic)
        stays = geometry.phase(moved) != phase
        x = np.where(stays[:, None], x, moved)
    rows = np.concatenate([x, *dummies]) if dummies else x
    return Particles(rows, phase, lattice.site_volume, inside, left_out)
