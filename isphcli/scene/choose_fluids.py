"""The fluids of a case as objects of the method: one, or two with tension, contact angle and slip at the line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..case.force_list import forces_of
from ..case.forcing import body_force, gradient_axis
from ..domain import reduce
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..flow.one_fluid import OneFluid
from ..geometry.protocol import sample_box
from .place import sight_of_fit

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..geometry.protocol import Geometry
    from ..two_phase.contact_angle import ContactAngle
    from ..two_phase.two_fluids import TwoFluids

FROM_WALL = 0.5  # spacings off the wall at which a wall point is tested for being on a face
ON_FACE = 0.9  # of those: along the diagonal of a right angle the wall is 0.71 of the way off


def choose_fluids(case: Case, geometry: Geometry, particles: Particles, force: np.ndarray) -> OneFluid | TwoFluids:
    """OneFluid or TwoFluids of a case; only this function chooses tension, contact angle and slip at the line."""
    present = [case.fluids[name] for k, name in enumerate(case.fluid_names) if reduce.any_true(particles.phase == k)]
    differ = len({(f.density, f.mu) for f in present}) > 1
    axis = gradient_axis(case)
    held = None if axis is None else np.eye(geometry.dim)[axis]
    forces = forces_of(case, geometry)
    if len(present) == 1 or (case.interface is None and not differ):
        return OneFluid(present[0].density, present[0].nu, force, held, forces)
    from ..two_phase.two_fluids import TwoFluidForces, TwoFluids

    spacing = case.particles.spacing
    support = case.support * spacing
    tension = contact = line = None
    if case.interface is not None:
        from ..two_phase.sight import Sight
        from ..two_phase.surface_tension import SurfaceTension

        contact = _contact(case, geometry, particles, support) if geometry.has_solid else None
        sight = Sight(sight_of_fit(case, spacing, geometry.dim), geometry if geometry.has_solid else None)
        tension = SurfaceTension(case.interface.tension, case.interface.method, [f.density for f in present], support,
                                 spacing, sight)
        if contact is not None and case.interface.slip_length > 0.0:
            from ..two_phase.contact_angle import SlipAtLine

            line = SlipAtLine(case.interface.slip_length, exchange=_exchange_of_dummies(particles))
    body = body_force(case, geometry.dim)
    moved = TwoFluidForces(body, force - body, held, forces)
    return TwoFluids([f.density for f in present], [f.mu for f in present], moved, spacing, tension, contact, line)


def _contact(case: Case, geometry: Geometry, particles: Particles, support: float) -> ContactAngle:
    from ..geometry.wall_normals import wall_normals
    from ..two_phase.contact_angle import ContactAngle, WallDummies

    assert case.interface is not None
    dummies = particles.dummies_in_sight
    depth, normal = np.maximum(-geometry.distance(dummies), 0.0), wall_normals(geometry, dummies, support)
    # off a concave edge, whose angle the fluid fills, the wall is farther along than off a face
    ahead = FROM_WALL * case.particles.spacing
    depth[geometry.distance(dummies + (depth + ahead)[:, None] * normal) < ON_FACE * ahead] = np.inf
    walls = WallDummies(dummies, depth, normal, _of_reservoirs(case, geometry, dummies),
                        _exchange_of_dummies(particles))
    return ContactAngle(case.interface.contact_angle, walls, case.particles.spacing)


def _exchange_of_dummies(particles: Particles) -> Exchange:
    return NO_EXCHANGE if particles.share is None else particles.share.of_dummies


def _of_reservoirs(case: Case, geometry: Geometry, dummies: np.ndarray) -> np.ndarray | None:
    """(n_dummy,) bool, which dummies are of the walls of reservoirs; None without reservoirs. These walls are neutral,
    so that no capillary pressure falls off in the reservoirs, nor where they meet."""
    if case.reservoirs is None:
        return None
    axis = "xyz".index(case.reservoirs.axis)
    lower, upper = (corner[axis] for corner in sample_box(geometry))
    return (dummies[:, axis] < lower) | (dummies[:, axis] > upper)
