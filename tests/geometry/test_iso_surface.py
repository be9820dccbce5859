"""Images whose wall is the zero of a field: signs, distances, crossings, faces."""

import numpy as np
import pytest

from isphcli.geometry.faces import Walls
from isphcli.geometry.iso_crossings import _place_of_least
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.geometry.labels import ClearLayers
from tests.geometry.fields import phases, plane, sphere, waves

ROUND = (True,) * 3


def iso(field, size=1.0, periodic=ROUND, **more):
    return IsoSurfaceGeometry(phases(field), ImageField(field), size, periodic, **more)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("offset", [5.0, 5.3, 5.75])
def test_planes_between_the_centres_are_exact(axis, offset):
    """A linear field: distances and crossings anywhere between voxels, 1e-5 voxels of float32."""
    normal = np.eye(3)[axis]
    g = iso(plane((12,) * 3, normal, offset), periodic=(False,) * 3)
    x = np.random.default_rng(0).uniform(4, 7, (300, 3))
    depth = x[:, axis] - offset
    near = np.abs(depth) < 0.7
    assert np.abs(g.distance(x) - depth)[near].max() < 2e-3  # the mirror at the faces is five voxels away
    start = x[depth > 0.01]
    end = start.copy()
    end[:, axis] = 4.0
    exact = (start[:, axis] - offset) / (start[:, axis] - 4.0)
    assert np.abs(g.crossing(start, end) - exact).max() < 2e-3


def test_an_oblique_plane_in_anisotropic_voxels():
    voxel, normal = np.array([1.0, 1.6, 0.7]), np.array([0.48, 0.6, 0.64])
    g = iso(plane((24, 12, 16), normal, 14.0, voxel), voxel, (False,) * 3)
    x = np.random.default_rng(1).uniform(5, 12, (4000, 3))
    depth = x @ normal - 14.0
    x, depth = x[np.abs(depth) < 0.5], depth[np.abs(depth) < 0.5]
    assert len(x) > 200 and np.abs(g.distance(x) - depth).max() < 5e-3
    assert np.array_equal(g.phase(x) == 0, depth > 0) or np.abs(depth[(g.phase(x) == 0) != (depth > 0)]).max() < 1e-4


@pytest.mark.parametrize("scale", [1.0, 3e-6])
def test_a_sphere_from_its_field_has_its_wall_within_a_hundredth_of_a_voxel(scale):
    """R = 4.6 voxels: crossings, and distances within a voxel of the wall, along the slope."""
    centre = np.array([8.3, 7.8, 8.1])
    g = iso(sphere(16, 4.6, centre), scale)
    rng = np.random.default_rng(0)
    x = rng.uniform(2, 14, (20000, 3))
    true = np.linalg.norm(x - centre, axis=1) - 4.6
    near = np.abs(true) < 1
    assert np.abs(g.distance(x[near] * scale) / scale - true[near]).max() < 0.05
    start, end = x[(true > 0) & near], rng.permutation(x[(true < -0.1) & near])[: np.sum((true > 0) & near)]
    start = start[: len(end)]
    step = end - start
    met = start + g.crossing(start * scale, end * scale)[:, None] * step
    assert np.abs(np.linalg.norm(met - centre, axis=1) - 4.6).max() < 0.01


def test_the_body_is_the_same_however_it_is_asked():
    """Signs of phase and distance agree; crossings are the first change of phase along 2000 places of a segment."""
    g = iso(waves(10, 10, 4, 3, 0.45), 0.5)
    rng = np.random.default_rng(5)
    x = rng.uniform(-2, 8, (4000, 3))
    phase = g.phase(x)
    assert 0.3 < (phase == 0).mean() < 0.6
    assert np.array_equal(g.distance(x) > 0, phase == 0)
    start = x[phase == 0][:400]
    end = start + rng.uniform(-0.7, 0.7, start.shape)
    t = np.linspace(0, 1, 2001)[1:]
    solid = g.phase((start[:, None] + t[:, None] * (end - start)[:, None]).reshape(-1, 3)).reshape(len(start), -1) < 0
    sampled = np.where(solid.any(1), t[solid.argmax(1)], 1.0)
    found = g.crossing(start, end)
    assert solid.any(1).mean() > 0.2
    assert np.abs(found - sampled).max() < 6e-4


def test_distances_never_reach_past_a_wall():
    """In balls of 0.75 of the distance there is no wall: the slope is small in the middle of a throat, where value over
    slope alone would be far too long."""
    g = iso(waves(10, 10, 3, 4, 0.4))
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 10, (3000, 3))
    d = g.distance(x)
    fluid = d > 0
    direction = rng.standard_normal((fluid.sum(), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    reached = g.phase(x[fluid] + 0.75 * d[fluid, None] * direction)
    assert (reached == 0).mean() > 0.99


def test_far_from_walls_distances_are_those_between_voxels():
    g = iso(sphere(32, 4.6, (16.3, 15.8, 16.1)))
    x = np.array([[16.3, 15.8, 29.0], [5.0, 15.8, 16.1]])
    assert g.distance(x) == pytest.approx([8.3, 6.7], abs=0.8)


def test_faces_that_are_walls():
    """An empty image in sealed sides: distances, crossings and walls as of the box."""
    field = np.ones((4, 5, 6))
    g = iso(field, 0.5, (True, False, False), walls=Walls(face_velocity={(1, 1): (1, 0, 0)}))
    x = np.random.default_rng(0).uniform([0, 0, 0], [3, 2.5, 2], (300, 3))
    d = np.minimum.reduce([x[:, 1], 2.5 - x[:, 1], x[:, 2], 2 - x[:, 2]])
    assert np.abs(g.distance(x) - d).max() < 1e-12
    out = x + [0, 2.5, 0]
    assert np.allclose(g.distance(out), -x[:, 1], atol=1e-12) and (g.phase(out) == -1).all()
    t = g.crossing(x, out)
    assert np.abs(x[:, 1] + t * 2.5 - 2.5).max() < 1e-12
    met = x + t[:, None] * (out - x)
    assert np.mean(g.wall_velocity[g.wall(met)][:, 0]) > 0.99


def test_a_wall_and_a_throat_of_one_voxel_in_labels_stay():
    labels = np.zeros((8, 8, 8), np.int8)
    labels[:, :, 4] = -1
    labels[3, 3, 4] = 0
    g = IsoSurfaceGeometry(labels, None, 1e-6, ROUND)
    start = np.array([[3.5, 6.5, 6.5], [3.5, 3.5, 3.5]]) * 1e-6
    t = g.crossing(start, start + np.array([2e-6, 0, 0]))
    assert 0.15 < t[0] < 0.35 and t[1] == 1
    assert 0 < g.distance(np.array([[4.5, 3.5, 3.5]]) * 1e-6)[0] < 0.6e-6


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("width", [2, 3, 5])
def test_slits_in_labels_keep_their_width(axis, width):
    """Walls along the axes lie on the faces of the voxels, 0.071 voxels off where two of them are two voxels apart:
    the prior is as smooth as the solid beside the slit is wide."""
    labels = np.full((14, 14, 14), -1, np.int8)
    np.moveaxis(labels, 2 - axis, 0)[4 : 4 + width] = 0
    g = IsoSurfaceGeometry(labels, None, 1.0, ROUND)
    start, up = np.full((1, 3), 7.0), np.eye(3)[axis] * 4
    start[0, axis] = 4 + width / 2
    assert g.crossing(start, start + up)[0] * 4 == pytest.approx(width / 2, abs=0.075)
    assert g.crossing(start, start - up)[0] * 4 == pytest.approx(width / 2, abs=0.075)


def test_a_sphere_from_its_labels():
    """R = 8.2 voxels: the wall within 0.2 voxels rms, 0.05 in the mean; the faces of the voxels are 0.3 off."""
    centre, radius = np.array([12.3, 11.8, 12.1]), 8.2
    g = IsoSurfaceGeometry(phases(sphere(24, radius, centre)), None, 1.0, ROUND)
    direction = np.random.default_rng(0).standard_normal((4000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    start, end = centre + 10.5 * direction, centre + 6.0 * direction
    met = start + g.crossing(start, end)[:, None] * (end - start)
    error = np.linalg.norm(met - centre, axis=1) - radius
    assert np.sqrt((error**2).mean()) < 0.15 and abs(error.mean()) < 0.05


def test_the_fluid_is_that_of_the_nearest_fluid_voxel():
    """Between two fluids the faces of voxels; in what the wall leaves of a solid voxel the nearest fluid."""
    labels = np.zeros((6, 6, 6), np.int8)
    labels[:, :, 3:] = 1
    labels[:, 4:, :] = -1
    field = plane((6, 6, 6), (0.0, -1.0, 0.0), -4.4)
    g = IsoSurfaceGeometry(labels, ImageField(field), 1.0, (False,) * 3)
    x = np.array([[1.5, 1.0, 3.0], [4.5, 1.0, 3.0], [1.5, 4.2, 3.0], [4.5, 4.2, 3.0], [4.5, 4.9, 3.0]])
    assert g.phase(x).tolist() == [0, 1, 0, 1, -1]


def test_clear_layers_are_fluid_and_end_at_the_faces_of_the_image():
    field = -np.ones((5, 4, 3))
    g = iso(field, (1.0, 2.0, 3.0), (False,) * 3, layers=ClearLayers(1, 2))
    assert g.upper.tolist() == [3 * 1.0, 16, 15] and g.periodic == (False, True, False)
    assert g.sample_lower.tolist() == [0, 4, 0] and g.sample_upper.tolist() == [3, 12, 15]
    x = np.array([[1.5, 3.5, 7], [1.5, 4.5, 7], [1.5, 11.5, 7], [1.5, 12.5, 7], [-0.1, 1, 7]])
    assert g.phase(x).tolist() == [0, -1, -1, 0, -1]


def test_no_wall_and_only_wall():
    x = np.random.default_rng(0).uniform(0, 4, (10, 3))
    free = iso(np.ones((4, 4, 4)))
    assert not free.has_solid and np.isposinf(free.distance(x)).all() and (free.crossing(x, x + 1) == 1).all()
    full = iso(-np.ones((4, 4, 4)))
    assert full.has_solid and np.isneginf(full.distance(x)).all() and (full.phase(x) == -1).all()


def test_two_dimensions():
    """A disk of R = 4.6 pixels: crossings within 0.01."""
    y, x = np.meshgrid(np.arange(16) + 0.5, np.arange(16) + 0.5, indexing="ij")
    centre = np.array([8.3, 7.8])
    field = np.hypot(x - centre[0], y - centre[1]) - 4.6
    g = IsoSurfaceGeometry(phases(field), ImageField(field), 1.0, (True, True))
    angle = np.linspace(0, 6, 50)
    ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    start, end = centre + 6 * ray, centre + 3.5 * ray
    assert (g.crossing(start, end) * 2.5) == pytest.approx(1.4, abs=0.01)
    assert (g.phase(start) == 0).all() and (g.phase(end) == -1).all()


def test_a_field_of_another_shape_is_refused():
    with pytest.raises(ValueError):
        IsoSurfaceGeometry(np.zeros((3, 3, 3), np.int8), ImageField(np.ones((3, 3, 4))), 1.0, ROUND)


@pytest.mark.parametrize("cubic, place", [
    ((1.0, -1.0, 1.0, 1.0), 0.5),  # a parabola
    ((0.0, -1e-30, 1.0, 5.0), 4 / 9),  # s^2 (3 s - 2), with a slope at 0 that is round-off beside the rest
])
def test_the_least_value_between_two_slopes(cubic, place):
    """Grey images are cut off at their brightest value: the field of a saturated image is flat but for round-off."""
    assert _place_of_least(*cubic) == pytest.approx(place, rel=1e-9)
