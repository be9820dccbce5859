"""Faces of a box as walls: exact distances, and the table of walls."""

import numpy as np
import pytest

from isphcli.geometry.faces import Walls, block_distance, face_distance


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_distance_of_a_block_against_its_nearest_points(dim):
    """Outside: to the point clipped to the block. Inside: to the nearest face, negative."""
    rng = np.random.default_rng(0)
    half = np.array([0.3, 0.5, 0.8])[:dim]
    x = rng.uniform(-1.5, 1.5, (500, dim))
    found = block_distance(np.abs(x) - half)
    outside = np.linalg.norm(x - np.clip(x, -half, half), axis=1)
    inside = (half - np.abs(x)).min(axis=1)
    assert (inside > 0).sum() > 10
    assert np.allclose(found, np.where(inside > 0, -inside, outside), atol=1e-15)


def test_the_nearest_face_and_its_number():
    """A box 2 x 4 x 8 with z periodic: only x and y have walls, 1 + 2 axis + side."""
    lower, upper = np.array([-1.0, 0.0, 0.0]), np.array([1.0, 4.0, 8.0])
    x = np.array([[-0.9, 2, 0.01], [0.75, 2, 4], [0, 0.5, 4], [0.1, 3.9, 4], [1.5, 2, 4], [4, 8, 4]])
    distance, wall = face_distance(x, lower, upper, (False, False, True))
    assert distance == pytest.approx([0.1, 0.25, 0.5, 0.1, -0.5, -5.0])  # the last: 3 and 4 beyond an edge
    assert wall[:5].tolist() == [1, 2, 3, 4, 2] and wall.dtype == np.int32
    assert wall[5] == 4  # of the face that it is farthest beyond


def test_a_periodic_box_has_no_faces():
    distance, wall = face_distance(np.zeros((3, 2)), np.zeros(2), np.ones(2), (True, True))
    assert np.isposinf(distance).all() and not wall.any()


def test_the_table_of_walls():
    velocity, slip = Walls(0.1, {(1, 1): (3.0, 0.0)}, {(0, 0): 0.7}).table(2, 2)
    assert velocity.shape == (7, 2) and velocity[4].tolist() == [3, 0]
    assert np.count_nonzero(velocity) == 1
    assert slip.tolist() == [0.1, 0.7, 0.1, 0.1, 0.1, 0.1, 0.1]
