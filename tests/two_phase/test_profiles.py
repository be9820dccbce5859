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
    x[:3, axis], x[3:, axis] = 1.2, 1.8
    phase = np.array([0, 0, 1, 0, 0, 0])
    state = State(x, x, x, np.zeros(6), time=3.0, step=5)
    p = np.array([1.0, 1.0, 4.0, 2.0, 2.0, 2.0])
    profiles = Profiles(axis, ("water", "gas"), geometry, 0.25, 0.25, lambda state: p)
    first, last = profiles.rows(state, phase)
    assert first == {"step": 5, "time": 3.0, name: 1.25, "saturation_water": pytest.approx(2 / 3),
                     "saturation_gas": pytest.approx(1 / 3), "pressure": 2.0, "pressure_water": 1.0,
                     "pressure_gas": 4.0}
    assert last[name] == 1.75 and last["pressure"] == 2.0 and last["pressure_gas"] is None


def test_profiles_of_rows_that_move_over_a_section_are_those_of_the_fluid():
    """Rows of a front at x = s fill the slices as the front does, wherever rows and slices lie to each other; a slice
    that has one row more than the next one is no more fluid."""
    geometry = ShapeGeometry([0.0, 0.0], [2.0, 1.0], [True, True], 0, [])
    profiles = Profiles(0, ("water", "gas"), geometry, 0.125, 0.125, lambda state: np.zeros(len(state.x)))
    for shift in (0.0, 0.03, 0.05):
        along = (np.arange(16) + 0.5) * 0.125 + shift
        x = np.stack([along, np.full(16, 0.5)], axis=1)
        front = 0.75 + shift
        rows = list(profiles.rows(State(x, x, x, np.zeros(16)), (along > front).astype(int)))
        held = np.clip((front - 0.25 * np.arange(8)) / 0.25, 0.0, 1.0)
        assert [row["saturation_water"] for row in rows] == pytest.approx(held.tolist(), abs=1e-8)
