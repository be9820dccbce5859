"""Where fluids meet: not along walls that a shape of fluid ends at."""

import numpy as np
import pytest

from isphcli.geometry.bodies import Box, Cylinder, HalfSpace, Shape, Sphere
from isphcli.geometry.shape_geometry import ShapeGeometry


def points(geometry, count=2000):
    """Random points in its fluid, (n, dim)."""
    x = geometry.lower + np.random.default_rng(0).random((count, geometry.dim)) * (geometry.upper - geometry.lower)
    return x[geometry.phase(x) >= 0]


@pytest.mark.parametrize("beyond", [0.0, 0.03, 1.0])
def test_a_slug_between_plates_ends_at_its_menisci_alone(beyond):
    """However far its box goes on into the plates: the distance is that to its two ends. With faces along the plates it
    was 0 there, and a slug swam along them."""
    slug = Shape(Box([0.5, -beyond, -beyond], [2.0, 1.0 + beyond, 1.0 + beyond]), 0)
    geometry = ShapeGeometry([0, 0, 0], [2.5, 1, 0.6], (True, False, True), 1, [slug])
    x = points(geometry)
    assert geometry.interface_distance(x, 0.05) == pytest.approx(np.minimum(x[:, 0] - 0.5, 2.0 - x[:, 0]), abs=1e-12)


def test_a_slug_in_a_tube_ends_at_its_menisci_alone():
    """A cylinder of fluid as wide as the tube that it lies in."""
    tube = Shape(Cylinder(0, [0, 0.5, 0.5], 0.4), -1, outside=True)
    slug = Shape(Cylinder(0, [0, 0.5, 0.5], 0.4, (0.5, 2.0)), 0)
    geometry = ShapeGeometry([0, 0, 0], [2.5, 1, 1], (True, False, False), 1, [tube, slug])
    x = points(geometry)
    assert geometry.interface_distance(x, 0.05) == pytest.approx(np.minimum(x[:, 0] - 0.5, 2.0 - x[:, 0]), abs=1e-12)


@pytest.mark.parametrize("body", [Box([0.3, 0.2, 0.2], [0.7, 0.6, 0.8]), Box([0.3, -0.5, 0.2], [0.7, 0.6, 0.8]),
                                  Cylinder(0, [0, 0.5, 0.5], 0.3), Cylinder(2, [0.5, 0.5, 0], 0.3, (0.1, 0.8)),
                                  Sphere([0.5, 0.1, 0.5], 0.3), HalfSpace([0.5, 0.4, 0], [0, 1, 0])])
@pytest.mark.parametrize("outside", [False, True])
def test_where_fluids_meet_nothing_changes(body, outside):
    """Drops, threads and layers, in a box with a wall below and above, on both sides of their surfaces."""
    geometry = ShapeGeometry([0, 0, 0], [1, 1, 1], (True, False, True), 1, [Shape(body, 0, outside)])
    x = points(geometry)
    exact = body.signed_distance(x, geometry.period) * (1 if outside else -1)
    near = np.abs(exact) < 0.08  # the part of a box that goes on below the floor has an end there, farther off
    assert near.sum() > 50 and geometry.interface_distance(x, 0.05)[near] == pytest.approx(exact[near], abs=1e-12)


def test_fluid_that_fills_a_cave_meets_nobody():
    """A ball of fluid in a hole of its size, and another fluid in another cave: there is no interface, and each point
    keeps its fluid."""
    rock = Shape(Box([-1, -1], [3, 3]), -1)
    holes = [Shape(Sphere([0.5, 0.5], 0.3), 0), Shape(Sphere([1.5, 0.5], 0.3), 1)]
    geometry = ShapeGeometry([0, 0], [2, 1], (False, False), 1, [rock, *holes])
    x = points(geometry)
    phi = geometry.interface_distance(x, 0.05)
    assert np.array_equal(phi > 0, x[:, 0] < 1.0) and np.isinf(phi).all()


@pytest.mark.parametrize("middle", [0.5, 0.515625])
@pytest.mark.parametrize("body", [Box([-1, -1], [0.2, 2]), HalfSpace([0.2, 0.5], [1, 0])])
def test_fluids_meet_in_an_opening_of_a_few_particles(body, middle):
    """A 38th of the face, wherever it lies: the interface in it is not missed."""
    wall = Shape(Box([0.2, -1], [0.3, 2]), -1)
    slit = Shape(Box([0.2, middle - 0.013], [0.3, middle + 0.013]), 1)
    geometry = ShapeGeometry([0, 0], [1, 1], (False, False), 1, [Shape(body, 0), wall, slit])
    x = np.array([[0.19, middle], [0.21, middle]])
    assert geometry.interface_distance(x, 0.026 / 5) == pytest.approx([0.01, -0.01], abs=1e-12)
