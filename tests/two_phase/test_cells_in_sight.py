"""Cells see no particles behind walls."""

import numpy as np
import pytest

from tests.two_phase.scenes import scene

# Two channels that a plate of a third of a spacing parts, a slug in each, half a length apart: behind the plate there
# is the other fluid along half of either slug.
PLATE = """
geometry:
  {box: [1, 1], periodic: [x], fluid: a, shapes: [
    {box: {lower: [0.25, -1], upper: [0.75, 0.5]}, is: b}, {box: {lower: [0.5, 0.5], upper: [1.0, 2]}, is: b},
    {box: {lower: [-1, 0.5], upper: [2, 0.51]}, is: solid}]}
particles: {spacing: 0.03125}
fluids: {a: {density: 1, viscosity: 0.05}, b: {density: 2, viscosity: 0.05}}
time: {end: 1}
"""


def test_no_interface_is_seen_through_a_thin_plate():
    """Each channel has its own volumes, to 0.2 %, and its two ends; none of the cells that they cut has its two fluids
    on two sides of the plate."""
    _, _, state, stepper, _ = scene(PLATE)
    cut = stepper.configure(state.x, phi=state.phi).terms.interface.cut
    below, above = cut.cells.middle[:, 1] < 0.5, cut.cells.middle[:, 1] > 0.54
    for channel in (below, above):
        assert cut.volume[channel].sum() == pytest.approx(0.5 * cut.cells.fluid[channel].sum(), rel=2e-3)
    assert cut.area.sum() == pytest.approx(2 * 0.5 + 2 * (1 - 0.51), rel=0.02)
    parted = cut.area > 0.0
    sides = state.x[cut.nearest[parted], 1] > 0.5
    assert (sides[:, 0] == sides[:, 1]).all() and parted.sum() > 30


def test_a_plate_parts_what_kept_volumes_joins():
    """The fluid of each slug touches that around it in its own channel alone."""
    _, geometry, state, stepper, _ = scene(PLATE)
    sight, cells = stepper.fluids.grid.sight, stepper.fluids.grid.cells
    every = np.flatnonzero(cells.fluid > 0.0)
    seen = sight.seen(state.x, every, 2.0 * cells.side.max(), geometry.distance(state.x))
    near = np.abs(cells.middle[:, 1] - 0.5) < 2.1 * stepper.spacing
    assert np.isin(seen.cells, np.flatnonzero(near)).all() and len(seen.cells) >= 2 * 32
    assert ((sight.point[seen.cell, 1] > 0.5) == (state.x[seen.particle, 1] > 0.5)).all()
