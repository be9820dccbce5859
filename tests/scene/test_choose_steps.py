"""The limits of steps that a case asks for."""

from isphcli.case.load import read_case
from isphcli.scene.choose_steps import step_lengths

CASE = b"""
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1e-3}}
time: {end: 0.25, cfl: 0.3, capillary: 2}
"""


def test_limits_of_a_case():
    found = step_lengths(read_case(CASE, "case.yaml", ()), 2e-3, 0.5, walls=True)
    assert (found.reach, found.viscous, found.capillary, found.walls) == (0.3 * 0.1, 8 * 0.1**2 / 2e-3, 1.0, True)
    assert found.fixed is None and not found.steady
    steady = step_lengths(read_case(CASE, "case.yaml", ("time={steady: 0.1, step: 0.7}",)), 2e-3, None, walls=False)
    assert steady.steady and steady.fixed == 0.7 and steady.capillary is None
    assert steady.pressure is None
    gas = step_lengths(read_case(CASE, "case.yaml", ()), 2e-3, None, walls=True, lacking=0.5)
    assert gas.pressure == 4 * 0.1**2 / 0.5
    assert step_lengths(read_case(CASE, "case.yaml", ()), 2e-3, 0.5, walls=True, lacking=0.5).pressure is None
