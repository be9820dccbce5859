"""The nearest of many balls, from lists by cells and, beyond them, by a search tree; the way out of an overlap."""

import itertools

import numpy as np
import pytest

from isphcli.geometry.bodies import Shape, Spheres
from isphcli.geometry.nearest_ball import MOST
from isphcli.geometry.shape_geometry import ShapeGeometry

PERIODS = {"periodic": np.ones(3), "open": np.full(3, np.inf), "one way": np.array([1.0, np.inf, np.inf])}


@pytest.mark.parametrize("name", PERIODS)
def test_the_least_over_all_balls_and_their_images(name):
    """Also far from all of them, and beside one with many on a small part of it."""
    period, rng = PERIODS[name], np.random.default_rng(1)
    crowd = 0.5 + 0.01 * rng.standard_normal((3 * MOST, 3))
    centres = np.concatenate([rng.uniform(-0.2, 1.2, (60, 3)), crowd])
    radii = np.concatenate([rng.lognormal(-3.5, 1.0, 60), np.full(len(crowd), 0.002)])
    body, x = Spheres(centres, radii), rng.uniform(-0.9, 1.0, (300, 3))
    shifts = itertools.product(*((-2, -1, 0, 1) if np.isfinite(p) else (0,) for p in period))
    every = [np.linalg.norm(x[:, None] - centres - np.array(shift), axis=2) - radii for shift in shifts]
    assert np.abs(body.signed_distance(x, period) - np.min(every, axis=(0, 2))).max() < 1e-14
    listed = np.diff(body._lists(period).start)
    assert listed.max() <= MOST and (listed == 0).any() and (listed > 0).any()


def test_the_way_out_of_balls_that_overlap():
    """As far as the nearest of many points of the surface that they have together, on one ball, on the circle where two
    meet or in a corner of three, and no farther than such points lie apart."""
    rng = np.random.default_rng(2)
    centres, radius = rng.uniform(0.25, 0.75, (12, 3)), 0.15
    geometry = ShapeGeometry([0.0] * 3, [1.0] * 3, [True] * 3, shapes=[Shape(Spheres(centres, radius))])
    ways = rng.normal(size=(700, 3))
    points = centres[:, None] + radius * (ways / np.linalg.norm(ways, axis=1)[:, None])
    outside = np.linalg.norm(points[:, :, None] - centres, axis=3).min(axis=2) > radius * (1.0 - 1e-12)
    x = rng.uniform(0.2, 0.8, (700, 3))
    x = x[np.linalg.norm(x[:, None] - centres, axis=2).min(axis=1) < radius]
    surface = np.linalg.norm(x[:, None] - points[outside], axis=2).min(axis=1)
    depth = -geometry.distance(x)
    deeper = depth > radius - np.linalg.norm(x[:, None] - centres, axis=2).min(axis=1) + 1e-9
    assert deeper.sum() > 50
    assert (depth <= surface + 1e-12).all() and (surface - depth < 0.015)[deeper].all()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_wall_of_two_voids_that_overlap_is_farther_than_the_surface_of_either(dim):
    """Balls cut out of a solid: half way between the centres the nearest wall is where both surfaces meet, which no
    fluid lies behind; beside a centre it is the surface of that ball."""
    centres = np.full((2, dim), 0.5)
    centres[:, 0] = 0.35, 0.65
    voids = Shape(Spheres(centres, 0.3), outside=True)
    geometry = ShapeGeometry([0.0] * dim, [1.0] * dim, [True] * dim, shapes=[voids])
    x = np.full((4, dim), 0.5)
    x[:, 0] = 0.5, 0.45, 0.2, 0.02
    rim = np.sqrt(0.3**2 - 0.15**2)
    assert geometry.distance(x) == pytest.approx([rim, np.hypot(rim, 0.05), 0.15, -0.03], abs=1e-12)
