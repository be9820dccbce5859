"""Normals of walls point into the fluid, and are exact where the wall is a plane or a sphere."""

import numpy as np

from isphcli.geometry.bodies import Shape, Sphere
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.geometry.wall_normals import wall_normals


def test_normals_of_a_plane_and_of_a_sphere():
    """Central differences over 1e-3 of the scale: exact of a plane, (h / r)^2 / 6 off of a sphere."""
    rng = np.random.default_rng(0)
    channel = ShapeGeometry((0, 0), (1, 1), (True, False))
    below, above = rng.uniform([0, -0.2], [1, 0.4], (50, 2)), rng.uniform([0, 0.6], [1, 1.2], (50, 2))
    assert np.allclose(wall_normals(channel, below, 0.1), [0, 1], atol=1e-12)
    assert np.allclose(wall_normals(channel, above, 0.1), [0, -1], atol=1e-12)
    ball = ShapeGeometry((0, 0, 0), (1, 1, 1), (True,) * 3, shapes=[Shape(Sphere((0.5, 0.5, 0.5), 0.3))])
    away = rng.standard_normal((50, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    x = 0.5 + rng.uniform(0.2, 0.4, (50, 1)) * away
    assert np.allclose(wall_normals(ball, x, 0.1), away, atol=1e-6)


def test_no_normal_in_the_middle_of_a_channel():
    channel = ShapeGeometry((0, 0), (1, 1), (True, False))
    assert not wall_normals(channel, np.array([[0.3, 0.5]]), 0.1).any()
