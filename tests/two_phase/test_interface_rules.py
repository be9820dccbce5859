"""What an interface changes beyond the equations, by the numbers that decide it."""

import numpy as np
import pytest

from isphcli.two_phase.interface_rules import ADDED_VISCOSITY, OHNESORGE_FULL_SHIFTING, OHNESORGE_MIN, interface_rules


@pytest.mark.parametrize("density", [(1.0, 1.0), (1000.0, 1.0)])
def test_an_interface_gets_what_its_viscosity_lacks(density):
    """Up to the smallest Ohnesorge number of a spacing; none above, and none without tension."""
    tension, spacing = 0.07, 1e-4
    unit = np.sqrt(np.mean(density) * tension * spacing)
    for ohnesorge in (0.0, 0.01, 0.039, 0.041, 1.0):
        mu = ohnesorge * unit
        lacks = max(OHNESORGE_MIN - ohnesorge, 0.0) * unit
        rules = interface_rules(density, (1.5 * mu, 0.5 * mu), tension, spacing)
        assert rules.added_viscosity == pytest.approx(ADDED_VISCOSITY * lacks, abs=1e-12 * unit)
        assert rules.full_shifting == (ohnesorge < OHNESORGE_FULL_SHIFTING)
    rules = interface_rules(density, (1e-9, 1e-9))
    assert rules.added_viscosity == 0.0 and not rules.full_shifting


def test_the_old_pressure_keeps_its_odd_even_part_between_like_fluids_with_tension_alone():
    for density, viscosity, tension, damped in (
        ((1, 1), (1, 1), 0.1, False), ((1, 1), (1, 1), 0.0, True), ((2, 1), (1, 1), 0.1, True),
        ((1, 1), (1, 2), 0.1, True)):  # fmt: skip
        assert interface_rules(density, viscosity, tension, 0.1).damps_odd_even == damped


def test_the_rotational_viscosity_is_at_most_that_of_either_fluid():
    """And that of one fluid where both are alike."""
    assert interface_rules((3.0, 3.0), (0.5, 0.5)).rotational_viscosity == 0.5
    assert interface_rules((1000.0, 1.0), (1e-3, 2e-5)).rotational_viscosity == pytest.approx(1e-6)
