"""Segments through the pieces of shapes: chords by hand, images, and cells that hold what they must."""

import itertools

import numpy as np
import pytest

from isphcli.geometry.bodies import Box, Cylinder, HalfSpace, Shape, Sphere
from isphcli.geometry.segment_walls import _chord, extent_of, fill_cells, periodic_images
from isphcli.geometry.shape_geometry import ShapeGeometry

PERIOD = np.full(3, np.inf)


def piece(body):
    (found,) = body.pieces(PERIOD)
    return found[None]


def chord(pieces, x, dx):
    """Of the line x + t dx in the first of some pieces (m, 8): the kernel takes the way from its centre to x."""
    around = pieces.copy()
    around[:, 1:4] = x - pieces[:, 1:4]
    return _chord(around, 0, np.asarray(dx, float))


@pytest.mark.parametrize(("body", "x", "dx", "ends"), [
    (Sphere((0, 0, 0), 1.0), (-3, 0, 0), (2, 0, 0), (1.0, 2.0)),
    (Sphere((0, 0, 0), 1.0), (-3, 0.6, 0), (1, 0, 0), (2.2, 3.8)),
    (Box((-1, -1, -1), (1, 1, 1)), (-2, -2, 0), (1, 1, 0), (1.0, 3.0)),
    (Cylinder(2, (0, 0, 0), 1.0), (0, -2, 5), (0, 1, 1), (1.0, 3.0)),
    (Cylinder(2, (0, 0, 0), 1.0, (-1, 1)), (0, 0, -3), (0, 0, 1), (2.0, 4.0)),
])
def test_chords_by_hand(body, x, dx, ends):
    assert chord(piece(body), x, dx) == pytest.approx(ends, abs=1e-15)
    back = chord(piece(body), np.array(x, float) + 5 * np.array(dx, float), -np.array(dx, float))
    assert back == pytest.approx((5 - ends[1], 5 - ends[0]), abs=1e-14)  # the same chord the other way


def test_a_line_that_misses_or_runs_along():
    ball, wall = piece(Sphere((0, 0, 0), 1.0)), piece(HalfSpace((0, 0, 0), (0, 0, 1)))
    away = np.array([0.0, 2.0, 0.0]), np.array([1.0, 0.0, 0.0])
    t_in, t_out = chord(ball, *away)
    assert t_in > t_out
    below = chord(wall, [0, 0, -1], [1, 0, 0])
    above = chord(wall, [0, 0, 1], [1, 0, 0])
    assert below == (-np.inf, np.inf) and above[0] > above[1]
    assert chord(wall, [0, 0, 2], [0, 0, -4]) == (0.5, np.inf)


def test_images_are_those_that_reach_into_the_box():
    """A ball near a corner of a periodic square prism: itself and three images; not those along the closed axis."""
    ball, periodic = piece(Sphere((0.1, 0.05, 0.1), 0.2)), np.array([True, True, False])
    pieces, shape, origin, turns = periodic_images(ball, np.array([7]), np.zeros(3), np.ones(3), periodic)
    assert np.allclose(origin + turns, pieces[:, 1:4], rtol=0, atol=1e-15) and np.all(origin == [0.1, 0.05, 0.1])
    assert sorted(map(tuple, np.round(pieces[:, 1:4], 12))) == [(0.1, 0.05, 0.1), (0.1, 1.05, 0.1), (1.1, 0.05, 0.1),
                                                               (1.1, 1.05, 0.1)]
    assert shape.tolist() == [7] * 4


def test_every_cell_lists_the_pieces_that_reach_into_it():
    """Balls and boxes at random: a piece that holds a point is listed in the cell of the point."""
    rng = np.random.default_rng(3)
    bodies = [Sphere(tuple(c), r) for c, r in zip(rng.random((20, 3)), rng.uniform(0.02, 0.2, 20))]
    bodies += [Box(tuple(c), tuple(c + 0.15)) for c in rng.random((10, 3)) * 0.8]
    pieces = np.concatenate([piece(body) for body in bodies])
    counts = np.array([4, 5, 6])
    start, entry = fill_cells(pieces, extent_of(pieces), np.zeros(3), 1.0 / counts, counts)
    x = rng.random((4000, 3))
    cells = np.floor(x * counts).astype(int)
    flat = (cells[:, 2] * counts[1] + cells[:, 1]) * counts[0] + cells[:, 0]
    inside = np.stack([body.signed_distance(x, PERIOD) < 0 for body in bodies], axis=1)
    assert inside.sum() > 500
    for k, p in zip(*np.nonzero(inside)):
        assert p in entry[start[flat[k]] : start[flat[k] + 1]]


def test_a_long_segment_through_many_cells_meets_the_first_ball():
    """Balls of 0.3 in a periodic array of ten along x, between them fluid: the first on the way, exactly."""
    balls = [Shape(Sphere((k + 0.5, 0.5, 0.5), 0.3)) for k in range(10)]
    geometry = ShapeGeometry((0, 0, 0), (10, 1, 1), (True,) * 3, shapes=balls)
    for first, way in itertools.product((0.0, 3.0, 9.0), (1, -1)):
        xi = np.array([[first, 0.5, 0.5]])
        t = geometry.crossing(xi, xi + [[7.5 * way, 0, 0]])
        assert t == pytest.approx([0.2 / 7.5], abs=1e-15)


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_along_a_periodic_face_that_cuts_a_half_space_the_label_of_the_face_counts(towards):
    """Fluid on one side of the face, solid on the other: a point on it is wrapped to the lower one. Other segments from
    the point, which reach to both sides, change nothing."""
    geometry = ShapeGeometry((0, 0), (1, 1), (True, False), shapes=[Shape(HalfSpace((0.3, 0.5), (-towards, 0)))])
    xi = np.repeat([[0.0, 0.25], [1.0, 0.25]], 3, axis=0)
    t = geometry.crossing(xi, xi + np.array([[0.0, 0.5], [-0.2, 0.1], [0.2, 0.1]] * 2))[::3]
    fluid = geometry.phase(xi[::3]) >= 0
    assert fluid.tolist() == [towards > 0] * 2 and np.all((t == 1.0) == fluid)


def test_segments_from_one_point_meet_what_each_meets_alone():
    """Among more balls than are looked through together, balls cut out of them, a block, a tube round all and a
    half-space that ends at the periodic faces; to all digits, and with the first change of the label along samples."""
    rng = np.random.default_rng(5)
    balls = [Shape(Sphere(tuple(c), 0.12)) for c in rng.random((90, 3))]
    others = [Shape(Sphere((0.5, 0.5, 0.5), 0.3), 0), Shape(Box((0.4, 0.4, 0.0), (0.6, 0.6, 0.3))),
              Shape(HalfSpace((0.5, 0.5, 0.9), (0, 0, -1))), Shape(Cylinder(2, (0.5, 0.5, 0), 0.45), outside=True)]
    geometry = ShapeGeometry((0, 0, 0), (1, 1, 1), (False, True, True), shapes=balls + others)
    x = rng.random((4000, 3))
    x = x[geometry.phase(x) >= 0][:20]
    xi = np.repeat(x, 20, axis=0)
    xj = xi + rng.uniform(-1, 1, xi.shape) * np.repeat(rng.choice([0.1, 0.3, 0.6], len(x)), 20)[:, None]
    t, order = geometry.crossing(xi, xj), rng.permutation(len(xi))
    assert len(x) == 20 and 0.5 < np.mean(t < 1) < 0.99
    assert np.all(geometry.crossing(xi[order], xj[order]) == t[order])
    fine = np.linspace(0, 1, 301)
    points = xi[::2, None] + fine[:, None] * (xj - xi)[::2, None]
    walled = (points[..., 0] > 1) | (points[..., 0] < 0)
    walled |= geometry.phase(points.reshape(-1, 3)).reshape(walled.shape) < 0
    first = np.where(walled.any(axis=1), fine[walled.argmax(axis=1)], 1.0)
    assert np.max(np.abs(t[::2] - first + 0.5 / 300)) <= 0.5 / 300 + 1e-12
