"""What a check says of menisci in narrow pores."""

import pytest

from isphcli.preflight.menisci import menisci_findings
from tests.preflight.cases import read

TUBE = """
geometry:
  {box: [24, 10, 10], periodic: [x], fluid: brine, shapes: [{box: {lower: [6, 0, 0], upper: [18, 10, 10]}, is: co2}]}
particles: {spacing: 1}
fluids: {brine: {density: 1000, viscosity: 0.01}, co2: {density: 500, viscosity: 0.001}}
interface: {tension: 2, contact_angle: 30}
drive: {superficial_velocity: {x: HELD}}
time: {end: 1}
"""


class Seen:
    """A report of pores so many particles wide."""

    connectivity = None

    def __init__(self, held, across):
        self.case = read(TUBE.replace("HELD", str(held)))
        self.throats = type("Widths", (), {"narrow": 0.5 * across, "median": 2.0 * across})


@pytest.mark.parametrize("across, number", [(2.0, 1.1e-3), (3.0, 1.1e-3), (6.0, 1.2e-4), (8.0, 3.5e-5)])
def test_a_flux_is_compared_with_menisci_at_rest(across, number):
    """Ten times their speed, which falls as pores are wider, is enough."""
    enough = 10.0 * number * 2.0 / 0.01
    assert not list(menisci_findings(Seen(1.01 * enough, across)))
    (found,) = menisci_findings(Seen(0.99 * enough, across))
    assert f"capillary number {number:.0e}" in found and f"{across} particles wide" in found
    assert list(menisci_findings(Seen(0.99 * enough, across + 2.0))) == [] or across == 2.0


def test_other_cases_are_not_told():
    seen = Seen(1e-9, 3.0)
    assert list(menisci_findings(seen))
    seen.throats = None
    assert not list(menisci_findings(seen))
    seen = Seen(1e-9, 3.0)
    seen.case = read(TUBE.replace("drive: {superficial_velocity: {x: HELD}}", ""))
    assert not list(menisci_findings(seen))
