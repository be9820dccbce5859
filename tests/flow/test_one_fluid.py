"""The terms of one fluid: the force as it is, or as the gradient of its potential beside walls."""

import numpy as np

from isphcli.flow.one_fluid import OneFluid, balanced_force
from tests.flow.steps import scene

OPEN = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.1, jitter: 0.2}
fluids: {water: {density: 2, viscosity: 0.6}}
drive: {body_force: [3, -1]}
time: {end: 1}
"""
POCKETS = """
geometry: {box: [1, 1], periodic: [x], walls: {}, shapes: [{box: {lower: [0.4, -1], upper: [0.6, 2]}, is: solid}]}
particles: {spacing: 0.1}
fluids: {water: {density: 2, viscosity: 0.6}}
drive: {body_force: [3, -1]}
time: {end: 1}
"""


def test_without_walls_the_force_is_one_vector():
    stepper, _, config = scene(OPEN)
    assert np.array_equal(config.terms.force, [3, -1])
    terms = config.terms
    assert terms.viscous.factor == 0.3 and terms.rotational_viscosity == 0.3 and terms.along is None
    assert stepper.fluids.reference == 2 and stepper.fluids.nu_max == stepper.fluids.nu_min == 0.3


def test_beside_walls_the_force_is_the_gradient_of_its_potential():
    """Exact for a linear potential where no wall is seen, and nowhere larger than twice the force: what the pressure
    gradient can balance."""
    _, _, config = scene(POCKETS)
    force = np.broadcast_to(config.terms.force, config.x.shape)
    walls = config.ops.walls
    free = ~walls.near_wall
    assert free.any()
    assert np.allclose(force[free], [3, -1], atol=1e-12)
    assert np.abs(force).max() < 6
    gradient = config.terms.pressure_gradient(config.x @ [3.0, -1.0])
    seam = np.abs(config.x[:, 0] - 0.5) > 0.5 - 0.24  # the potential jumps over the periodic face, a support away
    assert (~seam).sum() > 20 and np.allclose(gradient[~seam], force[~seam], atol=1e-10)


def test_no_force_stays_the_vector_that_it_was():
    _, _, config = scene(POCKETS)
    zero = np.zeros(2)
    assert balanced_force(config.ops, zero) is zero


def test_a_held_direction_is_what_a_unit_gradient_accelerates_by():
    _, _, config = scene(OPEN)
    fluid = OneFluid(2.0, 0.3, np.zeros(2), np.array([0.0, 1.0]))
    terms = fluid.terms(config.ops, config.neighbours)
    assert np.array_equal(terms.along, [0, 1])
    u = np.tile(terms.along, (len(config.x), 1))
    assert np.abs(config.ops.total_divergence(u)).max() < 1e-12  # a uniform flow


def test_under_other_forces_a_fluid_keeps_all_else():
    """What changes with time are the forces; what else a fluid was given stays, of a class derived from it too."""

    class Marked(OneFluid):
        mark = 0

    fluid = Marked(2.0, 0.3, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    fluid.mark = 7
    other = fluid.driven_by(np.array([0.0, 3.0]), np.array([0.5, 0.0]))
    assert np.array_equal(other.force, [0.5, 3.0]) and np.array_equal(fluid.force, [1.0, 0.0])
    assert isinstance(other, Marked) and other.mark == 7 and other.held is fluid.held
    assert (other.reference, other.nu_max) == (2.0, 0.3)
