"""Sums over forces, and the same flow of a force of the list as of one of the drive."""

import numpy as np
import pytest

from isphcli.case import force_list as listed
from isphcli.flow.forces import Force, acceleration_of, largest_of, resistance_of
from isphcli.flow.state import Handover
from tests.flow.steps import scene

X = np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 1.0]])


def test_sums_over_forces():
    forces = (Force("one", "", acceleration=lambda x: np.array([1.0, 0.0]), largest=1.0),
              Force("two", "", acceleration=lambda x: 2.0 * x, largest=8.0, resistance=lambda x: x[:, 0]),
              Force("three", "", resistance=lambda x: np.ones(len(x))))
    assert np.array_equal(acceleration_of(forces, X), 2.0 * X + [1.0, 0.0])
    assert np.array_equal(resistance_of(forces, X), [1.0, 2.0, 4.0])
    assert largest_of(forces) == 9.0


def test_without_forces_nothing_is_added():
    assert acceleration_of((), X) is None and resistance_of((), X) is None and largest_of(()) == 0.0


CHANNEL = """
geometry: {box: [0.8, 1], periodic: [x], walls: {}}
particles: {spacing: 0.2}
fluids: {one: {density: 1, viscosity: 0.5}, two: {density: %s, viscosity: 0.5}}
initial: {flood: {fluid: two, from: y_max, saturation: 0.4}}
%s
time: {end: 1}
"""


@pytest.mark.parametrize("density", [1, 3])
def test_an_acceleration_of_the_list_makes_the_flow_of_a_body_force(density, monkeypatch):
    """One fluid, and two: along x, where the box repeats, no wall stands against the force, and the two are the same
    but for what the gradient of its potential makes beside walls."""
    def first_step(drive):
        stepper, state, config = scene(CHANNEL % (density, drive))
        return stepper, stepper.advance(state, Handover(config), 0.01)

    _, wanted = first_step("drive: {body_force: [0.7, 0]}")
    constant = Force("constant", "", lambda x: np.array([0.7, 0.0]), 0.7)
    known = listed.Known("constant", lambda case, geometry: constant, lambda case, dim: iter(()), "")
    monkeypatch.setattr(listed, "FORCES", (known,))
    stepper, found = first_step("")
    assert stepper.bounds.force == 0.7
    assert np.abs(wanted.state.u[:, 0]).max() > 1e-3
    assert np.allclose(found.state.u, wanted.state.u, atol=1e-5 * np.abs(wanted.state.u).max())  # solver: 1e-6
