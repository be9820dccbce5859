"""What an interface changes beyond the equations, by the numbers that decide it."""

import numpy as np
import pytest

from isphcli.two_phase.interface_rules import OHNESORGE_MIN, interface_rules, lacking_viscosity


@pytest.mark.parametrize("density", [(1.0, 1.0), (1000.0, 1.0)])
def test_an_interface_gets_what_its_viscosity_lacks(density):
    """Up to the smallest Ohnesorge number of a spacing; none above, and none without tension."""
    tension, spacing = 0.07, 1e-4
    unit = np.sqrt(np.mean(density) * tension * spacing)
    for ohnesorge in (0.0, 0.01, 0.039, 0.041, 1.0):
        mu = ohnesorge * unit
        lacks = max(OHNESORGE_MIN - ohnesorge, 0.0) * unit
        rules = interface_rules(density, (1.5 * mu, 0.5 * mu), tension, spacing)
        assert rules.added_viscosity == pytest.approx(lacks, abs=1e-12 * unit)
    assert interface_rules(density, (1e-9, 1e-9)).added_viscosity == 0.0


def test_the_rotational_viscosity_is_at_most_that_of_either_fluid():
    """And that of one fluid where both are alike."""
    assert interface_rules((3.0, 3.0), (0.5, 0.5)).rotational_viscosity == 0.5
    assert interface_rules((1000.0, 1.0), (1e-3, 2e-5)).rotational_viscosity == pytest.approx(1e-6)


@pytest.mark.parametrize("density, viscosity, lacking", [
    ((1000.0, 1.0), (1e-3, 2e-5), 1.9e-5),  # water and air: nearly all of that of air
    ((1000.0, 500.0), (1e-3, 1e-4), 0.0),  # brine and CO2: the thinner one in both ways
    ((800.0, 800.0), (0.3, 1e-3), 0.0),
    ((1.0, 0.1), (1.0, 1.0), 9.0),
])
def test_what_the_rotational_term_lacks_in_the_thinner_fluid(density, viscosity, lacking):
    assert lacking_viscosity(density, viscosity) == pytest.approx(lacking, rel=1e-9)
