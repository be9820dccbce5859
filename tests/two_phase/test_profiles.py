"""Profiles along an axis: slices of the box, whatever the axis."""

import numpy as np
import pytest

from isphcli.flow.state import State
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.two_phase.profiles import Profiles


@pytest.mark.parametrize("axis, name", [(0, "x"), (1, "y")])
def test_slices_have_the_shares_and_the_means_of_what_lies_in_them(axis, name):
    """One slice of two spacings holds two rows of particles: a third of them of the second fluid, pressures 1 and 2."""
    geometry = ShapeGeometry([1.0, 1.0], [2.0, 2.0], [True, True], 0, [])
    x = np.full((6, 2), 1.5)
    x[:3, axis], x[3:, axis] = 1.1, 1.9
    phase = np.array([0, 0, 1, 0, 0, 0])
    state = State(x, x, x, np.zeros(6), time=3.0, step=5)
    profiles = Profiles(axis, ("water", "gas"), geometry, 0.25, lambda state: np.array([1.0, 1.0, 4.0, 2.0, 2.0, 2.0]))
    first, last = profiles.rows(state, phase)
    assert first == {"step": 5, "time": 3.0, name: 1.25, "saturation_water": pytest.approx(2 / 3),
                     "saturation_gas": pytest.approx(1 / 3), "pressure": 2.0, "pressure_water": 1.0,
                     "pressure_gas": 4.0}
    assert last[name] == 1.75 and last["pressure"] == 2.0 and last["pressure_gas"] is None
