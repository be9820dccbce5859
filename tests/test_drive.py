"""A superficial velocity that is held: the pressure drop that it takes, one fluid and two, and how it gets there."""

import numpy as np
import pytest
from test_step import run

from isphcli.case import CaseError, read_case
from isphcli.references import two_layer_poiseuille

SLIT = """
geometry: {{box: [0.25, 1], periodic: [x]{layers}}}
particles: {{spacing: 0.0625}}
fluids: {{water: {{density: 2, viscosity: 0.5}}{oil}}}
drive: {{superficial_velocity: {{x: {held}}}}}
time: {{steady: 1.0e-5, end: 100}}
"""
LAYERS = ", fluid: water, shapes: [{box: {lower: [-1, 0.5], upper: [2, 2]}, is: oil}]"


@pytest.mark.parametrize("held", [0.1, -0.1])
def test_a_slit_takes_the_drop_of_its_permeability(held):
    """12 mu U L / h^2. Plane Poiseuille flow on a lattice is exact: what is left is the test for a steady state."""
    state, _, stepper, rows = run(SLIT.format(layers="", oil="", held=held))
    assert rows[-1]["superficial_velocity_x"] == pytest.approx(held, rel=1e-3)
    assert rows[-1]["pressure_drop_x"] == pytest.approx(12 * 0.5 * held * 0.25, rel=2e-3)
    assert rows[-1]["pressure_drop_x"] == stepper.rate.drop(state)


def test_two_layers_take_the_drop_of_their_common_flow():
    """Oil of half the density and a fifth of the viscosity above: 5 % for 8 particles a layer."""
    state, _, stepper, rows = run(SLIT.format(layers=LAYERS, oil=", oil: {density: 1, viscosity: 0.1}", held=0.1))
    y = (np.arange(1000) + 0.5) / 1000
    mean = two_layer_poiseuille(y, 1.0, 0.5, [0.5, 0.1], [1.0, 1.0]).mean()
    assert rows[-1]["superficial_velocity_x"] == pytest.approx(0.1, rel=1e-3)
    assert rows[-1]["pressure_drop_x"] == pytest.approx(0.1 * 0.25 / mean, rel=0.05)
    assert state.hold[0] > 0 and stepper.fluids.held.tolist() == [1, 0]


def test_fluid_without_walls_is_brought_to_its_speed_and_left_there():
    """Nothing resists: the velocity closes in from below, and the drop ends."""
    *_, rows = run("""
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.125, jitter: 0.1}
fluids: {water: {density: 2, viscosity: 0.3}}
drive: {superficial_velocity: {y: 0.5}}
time: {end: 6, scheme: euler}
""")
    speed, drop = (np.array([row[name] for row in rows]) for name in ("superficial_velocity_y", "pressure_drop_y"))
    assert np.all(np.diff(speed) > 0) and speed[-1] == pytest.approx(0.5, rel=1e-3) and speed.max() < 0.5
    assert drop.argmax() == 0 and drop[-1] < 1e-2 * drop[0]
    # momentum: the integral of the drop over the time is density times length times velocity
    assert sum(d * row["dt"] for d, row in zip(drop, rows)) == pytest.approx(2 * speed[-1], rel=1e-6)


@pytest.mark.parametrize("drive, message", [
    ("{superficial_velocity: {x: 1, y: 1}}", "needs one axis"),
    ("{superficial_velocity: {x: 0}}", "other than zero"),
    ("{superficial_velocity: {y: 1}}", "y ends at walls"),
    ("{superficial_velocity: {x: 1}, pressure_drop: {x: 1}}", "finds its own pressure drop"),
])  # fmt: skip
def test_what_cannot_be_held_is_refused(drive, message):
    text = SLIT.format(layers="", oil="", held=1).replace("{superficial_velocity: {x: 1}}", drive)
    with pytest.raises(CaseError, match=message):
        read_case(text.encode(), "case.yaml")
    with pytest.raises(CaseError, match="needs flow: navier_stokes"):
        read_case(SLIT.format(layers="", oil="", held=1).replace("time:", "flow: stokes\n#").encode(), "case.yaml")
