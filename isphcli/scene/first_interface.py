"""Where two fluids meet at the start: the signed distance of each particle, from shapes, a plane, or labels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from ..domain import reduce
from ..domain.halo import wrap
from ..geometry.protocol import sample_box

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..flow.step import Stepper
    from ..geometry.protocol import Geometry

# From labels the first distance is that to the nearest particle of the other fluid, less half a spacing. Passes that
# smooth its steps: each removes a fifth of what is left.
PASSES = 40
PASS = 0.2


def first_interface(case: Case, geometry: Geometry, particles: Particles, stepper: Stepper,
                    number: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """phi (n,), m, of the fluid particles: exact where shapes say where the interface is, else from the fluid of each
    particle; and `State.volume` (n,), m^dim. The fluids of the stepper get the grid of their volumes. number: (n,) of
    `State`."""
    from ..two_phase.cut_cells import cells_of
    from ..two_phase.interface import Interface, reach_of
    from ..two_phase.kept_volumes import first_shares
    from ..two_phase.two_fluids import TwoFluids, VolumeGrid

    x, phase = particles.x[: particles.n_fluid], particles.phase
    reach = reach_of(stepper.reach, stepper.spacing)
    flood = case.initial.flood if case.initial is not None else None
    phi = geometry.interface_distance(x, stepper.spacing) if flood is None and case.reservoirs is None else None
    phi = from_labels(stepper, x, phase, reach, number) if phi is None else np.clip(phi, -reach, reach)
    assert isinstance(stepper.fluids, TwoFluids)
    brick = None if particles.share is None else (particles.share.lower, particles.share.upper)
    cells, sight = cells_of(geometry, stepper.spacing, particles.site_volume * reduce.number(x), brick), None
    if geometry.has_solid:
        from ..two_phase.cells_in_sight import CellSight

        sight = CellSight(geometry, cells.middle, cells.side)
    lower, upper = sample_box(geometry)
    part = np.any(lower > geometry.lower) or np.any(upper < geometry.upper)  # else it is everywhere
    stepper.fluids = stepper.fluids.measured_on(VolumeGrid(cells, sight, (lower, upper) if part else None))
    config = stepper.configure(x, 0.0, phi, number)
    interface = config.terms.interface
    assert isinstance(interface, Interface) and interface.cut is not None
    return phi, first_shares(interface.cut, config.ops.neighbours, phi, stepper.spacing, config.ops.exchange)


def from_labels(stepper: Stepper, x: np.ndarray, phase: np.ndarray, reach: float,
                number: np.ndarray | None = None) -> np.ndarray:
    """phi (n,), m, of particles x (n, dim) of fluids phase (n,); reach: largest, m; number: (n,) of `State`."""
    from ..two_phase.interface import carried, find_interface
    from ..two_phase.two_fluids import TwoFluids

    geometry, spacing = stepper.geometry, stepper.spacing
    box = np.where(geometry.periodic, geometry.upper - geometry.lower, 0.0)
    side = np.where(phase == 0, 1.0, -1.0)
    phi = side * reach
    others, fluid = x, phase
    if stepper.migration is not None and number is not None:  # as far as phi is known, which is farther than a support
        seen = stepper.migration.reaching(reach).around(x, number)
        others = wrap(np.concatenate([x, seen.ghosts]), geometry.lower, geometry.upper, geometry.periodic)
        fluid = seen.exchange.forward(phase)
    for k in (0, 1):
        other = cKDTree(others[fluid != k] - geometry.lower, boxsize=box)
        mine = np.flatnonzero(phase == k)
        near, _ = other.query(x[mine] - geometry.lower, distance_upper_bound=reach)
        phi[mine] *= np.minimum(np.maximum(near - 0.5 * spacing, 0.1 * spacing), reach) / reach
    assert isinstance(stepper.fluids, TwoFluids)
    config, sight = stepper.configure(x, 0.0, phi, number), stepper.fluids.sight
    for _ in range(PASSES):
        phi = carried(find_interface(config.ops, config.neighbours, phi, spacing, sight=sight), config.ops, None, PASS)
    return phi
