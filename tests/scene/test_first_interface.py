"""Where the interface is at the start: exact of shapes, and from the fluids of particles."""

import numpy as np
import pytest

from isphcli.scene.first_interface import from_labels
from tests.two_phase.scenes import drop, layers, scene


def test_the_distance_of_a_shape_is_exact():
    _, _, state, _, particles = scene(drop(dx=1 / 24))
    exact = 0.3 - np.linalg.norm(state.x - 0.5, axis=1)
    near = np.abs(exact) < 4 / 24
    assert np.abs(state.phi - exact)[near].max() < 1e-12
    assert np.array_equal(state.phi <= 0.0, particles.phase == 1)


def test_a_later_shape_lies_on_top():
    """A ring: water in a disk of oil."""
    text = drop(dx=1 / 32).replace("is: a}]", "is: a}, {sphere: {centre: [0.5, 0.5], radius: 0.12}, is: b}]")
    _, _, state, _, _particles = scene(text)
    r = np.linalg.norm(state.x - 0.5, axis=1)
    exact = np.minimum(0.3 - r, r - 0.12)
    near = np.abs(exact) < 4 / 32
    assert np.abs(state.phi - exact)[near].max() < 1e-12


@pytest.mark.parametrize("text, place", [(drop(dx=1 / 24), lambda x: 0.3 - np.linalg.norm(x - 0.5, axis=1)),
                                         (layers(1 / 16, mu=2), lambda x: 0.5 - x[:, 1])])
def test_labels_alone_say_it_to_a_part_of_a_spacing(text, place):
    """A third of a spacing at most, an eighth root mean square: labels alone do not say more."""
    _case, _, state, stepper, particles = scene(text)
    reach = np.abs(state.phi).max()
    phi = from_labels(stepper, state.x, particles.phase, reach)
    near, spacing = np.abs(state.phi) < 1.5 * stepper.spacing, stepper.spacing
    exact = place(state.x)
    exact = exact if np.sign(exact[0]) == np.sign(state.phi[0]) else -exact
    error = (phi - exact)[near] / spacing
    assert np.abs(error).max() < 0.34 and np.sqrt((error**2).mean()) < 0.125


def test_the_pore_behind_the_wall_of_a_slug_has_no_interface():
    """The face of the slug along the plate is none, and the shape goes on behind it: there phi was small beside the
    two planes of its ends, without another fluid anywhere."""
    _, _, state, stepper, _ = scene("""
geometry:
  {box: [1, 1], periodic: [x], fluid: a, shapes: [
    {box: {lower: [0.25, -1], upper: [0.75, 0.5]}, is: b}, {box: {lower: [-1, 0.5], upper: [2, 0.625]}, is: solid}]}
particles: {spacing: 0.0625}
fluids: {a: {density: 1, viscosity: 0.05}, b: {density: 2, viscosity: 0.05}}
time: {end: 1}
""")
    behind = state.x[:, 1] > 0.6
    far = np.abs(state.phi).max()
    assert state.phi[behind] == pytest.approx(far)
    ends = np.abs(np.abs(state.x[:, 0] - 0.5) - 0.25) < 0.1
    assert np.abs(state.phi[~behind & ends]).max() < 0.1 and stepper.spacing < far
