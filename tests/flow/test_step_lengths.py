"""How long a step may be, by what is known of the flow."""

import pytest

from isphcli.flow.step_lengths import FIRST, GROWTH_AT_WALLS, STEP_GROWTH, StepLengths, next_due, shortest


def lengths(**given):
    return StepLengths(**{"fixed": None, "reach": 0.02, "viscous": 0.5, "steady": False, "capillary": None,
                          "walls": False} | given)


def test_a_fluid_that_is_accelerated_moves_no_farther_than_it_may():
    dt = lengths().limits(2.0, 5.0, 1.0)["cfl"]
    assert 2.0 * dt + 5.0 * dt**2 / 2.0 == pytest.approx(0.02)


def test_the_decay_counts_in_a_run_to_a_steady_state_only_where_nothing_moves():
    assert "viscous" not in lengths(steady=True).limits(1.0, 0.0, 1.0)
    assert lengths(steady=True).limits(0.0, 0.0, 1.0)["viscous"] == 0.5


def test_the_pressure_keeps_up_in_runs_to_a_steady_state_too():
    assert lengths(steady=True, pressure=0.004).limits(1.0, 0.0, 1.0)["pressure"] == 0.004


def test_a_drive_is_followed_within_the_other_limits():
    found = lengths(capillary=0.3).limits(1.0, 0.0, 1.0, follow=lambda dt: 0.5 * dt)
    assert found == {"cfl": 0.02, "viscous": 0.5, "drive": 0.01, "capillary": 0.3, "start": STEP_GROWTH}


def test_the_first_step_is_a_part_of_the_limits_and_the_others_grow():
    assert lengths(fixed=0.1).limits(9.0, 9.0, 0.0) == {"start": FIRST * 0.1}
    assert lengths(fixed=0.1, walls=True).limits(0.0, 0.0, 0.2) == {"step": 0.1, "start": GROWTH_AT_WALLS * 0.2}


def test_steps_end_where_something_is_due():
    """Two like ones, where one would leave a stump."""
    assert shortest({"cfl": 0.1, "start": 0.2}, 1.0) == (0.1, "cfl")
    assert shortest({"cfl": 0.1}, 0.1) == (0.1, "end") and shortest({"cfl": 0.1}, 0.05) == (0.05, "end")
    assert shortest({"cfl": 0.1}, 0.12) == (0.06, "cfl")
    assert next_due(0.3, 0.1) == pytest.approx(0.4) and next_due(0.3, None) == float("inf")
