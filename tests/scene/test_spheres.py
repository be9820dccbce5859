"""Spheres at random, and what is odd about those of a file: overlaps, places outside the box."""

import numpy as np
import pytest

from isphcli.geometry.bodies import Cylinder, Shape, ShapeError, Spheres
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.scene import spheres as spheres_module
from isphcli.scene.spheres import random_spheres, sphere_findings


def test_spheres_outside_the_box_and_overlaps_are_counted():
    centres = [[0.5, 0.5], [0.65, 0.5], [1.5, 0.5], [-0.05, 0.3], [7.95, 0.8], [0.3, -0.5], [0.95, 0.31], [0.3, 0.05]]
    body, lower, upper = Spheres(np.array(centres), 0.1), np.zeros(2), np.ones(2)
    facts, odd = sphere_findings(body, lower, upper, np.array([1, np.inf]), "b.csv")
    assert facts == ["1 spheres repeat another one, or its periodic image; they count once"]
    assert odd[0].startswith("b.csv: 1 of 8 spheres lie outside the box and are left out")
    assert odd[1].startswith("b.csv: 3 of 8 spheres have their centre outside the box and are wrapped into it, 2 of")
    assert odd[2].startswith("b.csv: 2 pairs of spheres overlap, by up to 190 %")
    touching = Spheres(np.array([[0.3, 0.5], [0.4999, 0.5]]), 0.1)  # 0.1 % of the radius: how packings touch
    assert sphere_findings(touching, lower, upper, np.array([1, np.inf]), "b.csv") == ([], [])
    with pytest.raises(ShapeError, match=r"b\.csv: a radius of 400 m in a periodic box of 1 m; check the unit"):
        sphere_findings(Spheres(np.zeros((1, 2)), 400.0), lower, upper, np.ones(2), "b.csv")


def test_random_spheres_keep_apart():
    """From each other, over periodic faces too, and from the solids; the same seed gives the same places."""
    body = Cylinder(2, [0.5, 0.5, 0.0], 0.5)
    scene = ShapeGeometry([0, 0, 0], [1, 1, 1], [False, False, True], 0, [Shape(body, -1, outside=True)])
    spheres = random_spheres(scene, 30, 0.08, 0.01, seed=3)
    assert (scene.distance(spheres.centres) >= 0.09).all()
    offset = spheres.centres[:, None] - spheres.centres
    offset[..., 2] -= np.round(offset[..., 2])
    apart = np.linalg.norm(offset, axis=2)[np.triu_indices(30, 1)]
    assert apart.min() >= 0.17
    assert np.array_equal(spheres.centres, random_spheres(scene, 30, 0.08, 0.01, seed=3).centres)
    assert not np.array_equal(spheres.centres, random_spheres(scene, 30, 0.08, 0.01, seed=4).centres)


def test_random_spheres_that_find_no_room(monkeypatch):
    monkeypatch.setattr(spheres_module, "TRIES", 20)
    scene = ShapeGeometry([0, 0], [1, 1], [True, True])
    with pytest.raises(ShapeError, match=r"only \d of 7 spheres of radius 0.2 found room"):
        random_spheres(scene, 7, 0.2)
    with pytest.raises(ShapeError, match=r"9 spheres of radius 0\.2 would fill 113 %"):
        random_spheres(scene, 9, 0.2)
