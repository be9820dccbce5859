"""Images whose walls are the faces of voxels: distances, signs and crossings."""

import itertools

import numpy as np
import pytest

from isphcli.geometry.faces import Walls
from isphcli.geometry.labels import ClearLayers
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.geometry.wall_distance import signed_centre_distance
from tests.geometry.images.files import rock


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("width", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("scale", [1.0, 2.0**-20])
def test_slits_along_the_axes_are_exact_at_centres(axis, width, scale):
    """Slits and walls of any width, also one voxel: distances at the centres to round-off."""
    h = np.array([1.0, 1.0, 1.0]) * scale
    labels = np.full((16, 16, 16), -1, np.int8)
    np.moveaxis(labels, 2 - axis, 0)[5 : 5 + width] = 0
    centres = (np.arange(3, 7 + width) + 0.5) * scale
    x = np.full((len(centres), 3), 3.5 * scale)
    x[:, axis] = centres
    exact = np.minimum(centres - 5 * scale, (5 + width) * scale - centres)
    for phases, sign in ((labels, 1), (-1 - labels, -1)):
        d = VoxelGeometry(phases, h, (True,) * 3).distance(x)
        near = np.abs(exact) < 1.5 * scale
        assert np.abs(d - sign * exact)[near].max() < 1e-12 * scale


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("thick", [1, 2, 3, 5])
@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("inverse", [False, True])
def test_layers_at_a_sealed_face_are_exact_at_centres(axis, thick, side, inverse):
    """A layer of any thickness next to a face that is not periodic; faces themselves are added exactly."""
    inside = np.zeros(12)
    inside[:thick] = -1
    exact = thick - (np.arange(12) + 0.5)
    if side:
        inside, exact = inside[::-1], exact[::-1]
    labels, exact = (-1 - inside, exact) if inverse else (inside, -exact)
    grid = np.empty((12, 12, 12), np.int8)
    np.moveaxis(grid, 2 - axis, 2)[:] = labels
    around = np.array([a != axis for a in range(3)])
    for faces in (around, np.zeros(3, bool)):
        found = np.moveaxis(signed_centre_distance(grid < 0, np.ones(3), faces), 2 - axis, 2)
        assert np.abs(found - exact).max() < 1e-6


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_planes_between_anisotropic_voxels(axis):
    h = np.array([1.0, 1.7, 0.6])
    labels = np.zeros((12, 12, 12), np.int8)
    np.moveaxis(labels, 2 - axis, 0)[6:] = -1
    g = VoxelGeometry(labels, h, (True,) * 3)
    x = np.random.default_rng(0).uniform(4, 8, (200, 3)) * h
    assert np.abs(g.distance(x) - (6 * h[axis] - x[:, axis])).max() < 1e-6


def test_faces_are_exact_planes():
    """An empty image in sealed sides: distances, crossings and walls as of the box."""
    g = VoxelGeometry(
        np.zeros((4, 5, 6), np.int8), 0.5, (True, False, False), walls=Walls(face_velocity={(1, 1): (1, 0, 0)})
    )
    rng = np.random.default_rng(0)
    x = rng.uniform([0, 0, 0], [3, 2.5, 2], (300, 3))
    d = np.minimum.reduce([x[:, 1], 2.5 - x[:, 1], x[:, 2], 2 - x[:, 2]])
    assert np.abs(g.distance(x) - d).max() < 1e-14
    out = x + [0, 2.5, 0]
    assert np.allclose(g.distance(out), -x[:, 1], atol=1e-14) and (g.phase(out) == -1).all()
    t = g.crossing(x, out)
    assert np.abs(x[:, 1] + t * 2.5 - 2.5).max() < 1e-13
    met = x + t[:, None] * (out - x)
    assert np.mean(g.wall_velocity[g.wall(met)][:, 0]) > 0.99


@pytest.mark.parametrize("shape", [(5, 6, 7), (8, 9)])
def test_signs_agree_with_the_labels_anywhere(shape):
    dim = len(shape)
    rng = np.random.default_rng(1)
    x = rng.uniform(-2, 11, (3000, dim))
    for periodic in itertools.product([True, False], repeat=dim):
        g = VoxelGeometry(rock(shape), 1.0, periodic)
        phase = g.phase(x)
        assert np.array_equal(g.distance(x) > 0, phase >= 0)
        inside = ((x >= 0) & (x < shape[::-1]) | np.array(periodic)).all(1)
        index = np.floor(x).astype(int) % shape[::-1]
        assert np.array_equal(phase, np.where(inside, g.labels[tuple(index.T[::-1])], -1))


def test_stairs_distance_is_exact_within_a_voxel():
    labels = rock((6, 6, 6), 0.75, seed=3)
    g = VoxelGeometry(labels, 1.0, (True,) * 3)
    x = np.random.default_rng(2).uniform(0, 6, (500, 3))
    every = np.argwhere(np.tile(labels < 0, (3, 3, 3)))[:, ::-1] - 6
    free = np.argwhere(np.tile(labels >= 0, (3, 3, 3)))[:, ::-1] - 6
    to = [
        np.linalg.norm(np.maximum(np.maximum(v[None] - x[:, None], x[:, None] - v[None] - 1), 0), axis=2).min(
            1
        )
        for v in (every, free)
    ]
    exact = np.where(g.phase(x) >= 0, to[0], -to[1])
    near = np.abs(exact) < 1
    assert near.mean() > 0.9 and np.abs(g.distance(x) - exact)[near].max() < 1e-12


def test_no_wall_and_only_wall():
    x = np.random.default_rng(0).uniform(0, 4, (10, 3))
    free = VoxelGeometry(np.zeros((4, 4, 4), np.int8), 1.0, (True,) * 3)
    assert not free.has_solid and np.isposinf(free.distance(x)).all() and (free.crossing(x, x + 1) == 1).all()
    full = VoxelGeometry(np.full((4, 4, 4), -1, np.int8), 1.0, (True,) * 3)
    assert full.has_solid and np.isneginf(full.distance(x)).all() and (full.phase(x) == -1).all()


# crossings


@pytest.mark.parametrize("shape", [(6, 6, 6), (6, 7)])
@pytest.mark.parametrize("scale", [1.0, 3e-6])
def test_march_against_samples(shape, scale):
    rng = np.random.default_rng(5)
    dim = len(shape)
    for periodic in [(True,) * dim, (False,) * dim]:
        g = VoxelGeometry(rock(shape, 0.75), scale, periodic)
        xi = rng.uniform(0, 6, (400, dim)) * scale
        xi = xi[g.phase(xi) >= 0]
        xj = xi + rng.uniform(-2.4, 2.4, xi.shape) * scale
        t = np.linspace(0, 1, 4001)[1:]
        solid = (
            g.phase((xi[:, None] + t[:, None] * (xj - xi)[:, None]).reshape(-1, dim)).reshape(len(xi), -1) < 0
        )
        sampled = np.where(solid.any(1), t[solid.argmax(1)], 1.0)
        assert np.abs(g.crossing(xi, xj) - sampled).max() < 3e-4


@pytest.mark.parametrize("scale", [1.0, 3e-6, 1e5 / 3])
def test_diagonals_of_the_lattice(scale):
    """Centre to centre through an edge: blocked where both neighbours are solid, open where one is fluid."""
    labels = np.zeros((4, 4), np.int8)
    xi, xj = np.array([[1.5, 1.5]]) * scale, np.array([[2.5, 2.5]]) * scale
    labels[1, 2] = -1
    assert VoxelGeometry(labels, scale, (True, True)).crossing(xi, xj)[0] == 1
    labels[2, 1] = -1
    assert VoxelGeometry(labels, scale, (True, True)).crossing(xi, xj)[0] == pytest.approx(0.5)
    far = VoxelGeometry(labels, scale, (True, True)).crossing(xi + 400 * scale, xj + 400 * scale)
    assert far[0] == pytest.approx(0.5)


def test_corners_of_three_voxels():
    """Along a space diagonal: open as long as a way over faces of fluid voxels is left."""
    xi, xj = np.array([[1.5] * 3]), np.array([[2.5] * 3])
    for around in itertools.product([0, -1], repeat=6):
        labels = np.zeros((4, 4, 4), np.int8)
        places = [p for p in itertools.product([1, 2], repeat=3) if p not in ((1, 1, 1), (2, 2, 2))]
        for place, phase in zip(places, around):
            labels[place] = phase
        ways = any(
            all(labels[tuple(1 + int(axis in order[:k]) for axis in range(3))] == 0 for k in (1, 2))
            for order in itertools.permutations(range(3))
        )
        t = VoxelGeometry(labels, 1.0, (True,) * 3).crossing(xi, xj)[0]
        assert (t == 1) == ways


def test_walls_and_throats_of_one_voxel_are_seen():
    labels = np.zeros((8, 8, 8), np.int8)
    labels[:, :, 4] = -1
    labels[3, 3, 4] = 0  # the throat
    g = VoxelGeometry(labels, 1e-6, (True,) * 3)
    xi = np.array([[3.5, 6.5, 6.5], [3.5, 3.5, 3.5]]) * 1e-6
    t = g.crossing(xi, xi + np.array([2e-6, 0, 0]))
    assert t[0] == pytest.approx(0.25) and t[1] == 1
    assert g.distance(np.array([[4.5, 3.5, 3.5]]) * 1e-6)[0] == pytest.approx(0.5e-6)


def test_clear_layers():
    labels = np.full((5, 4, 3), -1, np.int8)
    g = VoxelGeometry(labels, (1.0, 2.0, 3.0), (False, False, False), layers=ClearLayers(1, 2))
    assert g.upper.tolist() == [3, 16, 15] and g.periodic == (False, True, False)
    assert g.sample_lower.tolist() == [0, 4, 0] and g.sample_upper.tolist() == [3, 12, 15]
    x = np.array([[1.5, 1, 7], [1.5, 5, 7], [1.5, 15, 7], [1.5, 17, 7], [-0.1, 1, 7]])
    assert g.phase(x).tolist() == [0, -1, 0, 0, -1]


@pytest.mark.parametrize(
    "change",
    [
        {"labels": np.zeros((0, 2), np.int8)},
        {"voxel_size": 0},
        {"voxel_size": np.nan},
        {"periodic": (True,)},
    ],
)
def test_bad_arguments(change):
    with pytest.raises(ValueError):
        VoxelGeometry(
            **({"labels": np.zeros((2, 2), np.int8), "voxel_size": 1.0, "periodic": (True, True)} | change)
        )
