"""Bodies: distances to spheres, boxes, cylinders and half-spaces, and what is none of them."""

import numpy as np
import pytest

from isphcli.geometry.bodies import Box, Cylinder, HalfSpace, Shape, ShapeError, Sphere, Spheres
from isphcli.geometry.shape_geometry import ShapeGeometry


@pytest.mark.parametrize(
    "body, exact",
    [
        (HalfSpace((0.5, 0.5, 0.5), (1, 2, 2)), lambda x: (x - 0.5) @ np.array([1, 2, 2]) / 3),
        (Cylinder(1, (0.5, 0, 0.4), 0.2), lambda x: np.hypot(x[:, 0] - 0.5, x[:, 2] - 0.4) - 0.2),
        (Sphere((0.5, 0.4, 0.3), 0.2), lambda x: np.linalg.norm(x - [0.5, 0.4, 0.3], axis=1) - 0.2),
    ],
)
def test_bodies_and_their_outsides(body, exact):
    x = np.random.default_rng(4).uniform(0.05, 0.95, (300, 3))
    g = ShapeGeometry((-9,) * 3, (9,) * 3, (False,) * 3, shapes=[Shape(body)])
    assert np.abs(g.distance(x) - exact(x)).max() < 1e-14
    g = ShapeGeometry((-9,) * 3, (9,) * 3, (True,) * 3, shapes=[Shape(body, outside=True)])
    assert np.abs(g.distance(x) + exact(x)).max() < 1e-14
    assert (g.phase(x) == np.where(-exact(x) <= 0, -1, 0)).all()


def test_box_and_capped_cylinder_against_samples_of_their_surface():
    """Distance to a box and to a capped cylinder from the distances to points dense on their surfaces."""
    n = 120
    s, c = (np.arange(n) + 0.5) / n, np.linspace(0, 2 * np.pi, 4 * n)
    u, v = (a.ravel() for a in np.meshgrid(s, s))
    faces = [np.insert(np.c_[u, v], axis, side, axis=1) for axis in range(3) for side in (0, 1)]
    box = np.concatenate(faces) * [0.4, 0.3, 0.5] + [0.3, 0.3, 0.2]
    r, a = (q.ravel() for q in np.meshgrid(s, c))
    caps = [np.c_[0.2 * r * np.cos(a), 0.2 * r * np.sin(a), np.full(r.size, h)] for h in (-0.25, 0.25)]
    side = np.c_[0.2 * np.cos(a), 0.2 * np.sin(a), 0.5 * r - 0.25]
    cylinder = np.concatenate([*caps, side]) + 0.5
    from scipy.spatial import cKDTree

    x = np.random.default_rng(5).uniform(0, 1, (500, 3))
    for body, surface in [
        (Box((0.3, 0.3, 0.2), (0.7, 0.6, 0.7)), box),
        (Cylinder(2, (0.5, 0.5, 0), 0.2, (0.25, 0.75)), cylinder),
    ]:
        d = ShapeGeometry((-9,) * 3, (9,) * 3, (False,) * 3, shapes=[Shape(body)]).distance(x)
        assert np.abs(np.abs(d) - cKDTree(surface).query(x)[0]).max() < 4e-3
        assert 0.02 < (d < 0).mean() < 0.1


@pytest.mark.parametrize(
    "shape, message",
    [
        (Shape(Sphere((0, 0), 1)), "centre"),
        (Shape(Sphere((0, 0, 0), -1)), "radius"),
        (Shape(Box((0, 0, 0), (1, 0, 1))), "upper corner"),
        (Shape(HalfSpace((0, 0, 0), (0, 0, 0))), "normal"),
        (Shape(Cylinder(3, (0, 0, 0), 1)), "axis"),
        (Shape(Cylinder(0, (0, 0, 0), 1, (1, 0))), "ends"),
        (Shape(Spheres(np.zeros((0, 3)), 1.0)), "centres"),
        (Shape(Spheres(np.zeros((2, 3)), np.array([1.0, np.nan]))), "radii"),
    ],
)
def test_bad_bodies_are_refused(shape, message):
    with pytest.raises(ShapeError, match=message):
        ShapeGeometry((0,) * 3, (1,) * 3, (True,) * 3, shapes=[shape])


@pytest.mark.parametrize("length", [1e-300, 1.0, 1e300])
def test_a_normal_of_any_length(length):
    """Whose square leaves the range of numbers, too."""
    half = HalfSpace((0.5, 0.0), (3 * length, 4 * length))
    assert half.signed_distance(np.array([[0.5, 1.0], [1.5, 0.0]]), np.full(2, np.inf)) == pytest.approx([0.8, 0.6])
