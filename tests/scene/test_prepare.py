"""From a case to its first state: velocities of formulas, bounds, and a velocity that is held."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import SPREAD, prepare

VORTEX = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.1, jitter: 0.1}
fluids: {water: {density: 3, viscosity: 0.1}}
initial: {velocity: ["2*sin(2*pi*y)", "0"]}
drive: {body_force: [3, 4]}
time: {end: 0.1}
"""
CHANNEL = """
geometry: {box: [2, 1], periodic: [x], shapes: [{box: {lower: [-1, 0.6], upper: [3, 2]}, is: solid}]}
particles: {spacing: 0.1}
fluids: {water: {density: 3, viscosity: 0.1}}
drive: {superficial_velocity: {x: 0.3}}
time: {end: 1}
"""


def prepared(text, *sets):
    case = read_case(text.encode(), "case.yaml", sets)
    return prepare(case, build_geometry(case), Clock())


def test_the_first_state_has_the_velocities_of_the_formulas():
    state, stepper, particles = prepared(VORTEX)
    assert np.array_equal(state.x, particles.x) and not state.p.any() and state.time == 0 and state.step == 0
    assert np.allclose(state.u[:, 0], 2 * np.sin(2 * np.pi * state.x[:, 1]), atol=1e-15) and not state.u[:, 1].any()
    assert np.array_equal(state.u, state.u_old)
    assert state.pressure_gradient is None and stepper.held_velocity is None


def test_a_formula_without_a_value_is_told_with_its_key():
    with pytest.raises(ValueError, match=r"initial\.velocity\.1: '1/\(x-x\)' is not finite everywhere"):
        prepared(VORTEX, "initial.velocity=['0', '1/(x-x)']")


def test_bounds_know_the_start_the_force_and_the_walls():
    """The root mean square of 2 sin is sqrt 2, within what jitter changes; the force is 5; a wall of 7."""
    _, stepper, _ = prepared(VORTEX)
    assert stepper.bounds.start == pytest.approx(2**0.5, rel=0.02)
    assert stepper.bounds.force == 5 and stepper.bounds.other == 0
    _, lid, _ = prepared(VORTEX, "geometry.periodic=[x]", "geometry.walls={y_max: {velocity: [7, 0]}}")
    assert lid.bounds.other == 7


def test_a_velocity_is_held_over_the_pores():
    """Superficial 0.3 m/s in a channel that fills six tenths of the box: 0.5 m/s in it; density times length 6."""
    state, stepper, _ = prepared(CHANNEL)
    held = stepper.held_velocity
    assert (held.axis, held.wanted, held.areal) == (0, 0.3, 6)
    assert held.flux(state.x, np.ones_like(state.x)) == pytest.approx(0.6) and held.speed == pytest.approx(0.5)
    assert stepper.bounds.other == pytest.approx(SPREAD * 0.5) and state.pressure_gradient == 0
    assert stepper.fluids.held.tolist() == [1, 0] and not stepper.fluids.force.any()
