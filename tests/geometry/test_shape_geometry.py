"""Exact distances and crossings of shapes, against brute force and plane geometry."""

import itertools

import numpy as np
import pytest
from scipy import ndimage

from isphcli.geometry import shape_geometry
from isphcli.geometry.bodies import Box, Cylinder, Disk, HalfSpace, Shape, ShapeError, Sphere, Spheres
from isphcli.geometry.faces import Walls
from isphcli.geometry.shape_geometry import ShapeGeometry

SCALES = [1.0, 1e-6, 1e3]


def images(dim, reach=2):
    return np.array(list(itertools.product(range(-reach, reach + 1), repeat=dim)))


def first_solid(geometry, xi, xj, n=2000):
    """Fraction of the way to the first of n samples that is solid; 1 without one."""
    t = np.linspace(0, 1, n + 1)[1:]
    x = xi[:, None] + t[None, :, None] * (xj - xi)[:, None]
    solid = geometry.phase(x.reshape(-1, xi.shape[1])).reshape(len(xi), n) < 0
    return np.where(solid.any(1), t[solid.argmax(1)], 1.0)


@pytest.mark.parametrize("scale", SCALES)
def test_planes_off_the_lattice_are_exact(scale):
    """Couette walls: crossing and distance to 1e-13 of the box whatever the lattice and the unit."""
    rng = np.random.default_rng(0)
    g = ShapeGeometry(
        np.array([0, 0.013]) * scale,
        np.array([1, 1.07]) * scale,
        (True, False),
        walls=Walls(face_velocity={(1, 1): (1, 0)}),
    )
    xi = np.c_[rng.uniform(0, 1, 500), rng.uniform(0.02, 1.06, 500)] * scale
    xj = xi + rng.uniform(-0.5, 0.5, xi.shape) * scale
    t = g.crossing(xi, xj)
    y = (xi + t[:, None] * (xj - xi))[:, 1] / scale
    low, high = xj[:, 1] < 0.013 * scale, xj[:, 1] > 1.07 * scale
    assert low.sum() > 20 and high.sum() > 20
    assert np.abs(y[low] - 0.013).max() < 1e-13 and np.abs(y[high] - 1.07).max() < 1e-13
    assert (t[~low & ~high] == 1).all()
    assert np.allclose(
        g.distance(xi) / scale, np.minimum(xi[:, 1] / scale - 0.013, 1.07 - xi[:, 1] / scale), atol=1e-15
    )
    assert (g.wall_velocity[g.wall(xj[high])] == [1, 0]).all() and (
        g.wall_velocity[g.wall(xj[low])] == 0
    ).all()


@pytest.mark.parametrize("centre", [(0.1, 0.5, 0.5), (0.0, 0.0, 0.0), (0.99, 0.02, 0.5)])
def test_a_sphere_acts_across_periodic_faces(centre):
    rng = np.random.default_rng(1)
    g = ShapeGeometry((0, 0, 0), (1, 1, 1), (True,) * 3, shapes=[Shape(Sphere(centre, 0.35))])
    x = rng.uniform(-1, 2, (500, 3))
    exact = (np.linalg.norm(x[:, None] - (images(3, 3) + centre), axis=2) - 0.35).min(1)
    assert np.abs(g.distance(x) - exact).max() < 1e-14
    assert (g.phase(x) == np.where(exact <= 0, -1, 0)).all()


def test_walls_do_not_let_shapes_through():
    """Along a non-periodic axis there is no image: only the face counts."""
    g = ShapeGeometry((0, 0), (1, 1), (True, False), shapes=[Shape(Disk((0.5, 0.05), 0.2))])
    assert g.distance(np.array([[0.5, 0.95]]))[0] == pytest.approx(0.05)
    assert g.phase(np.array([[0.5, 1.01], [0.5, -0.01], [1.6, 0.5], [0.55, 0.2]])).tolist() == [-1, -1, 0, -1]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("equal", [True, False])
def test_overlapping_spheres_against_brute_force(dim, equal):
    rng = np.random.default_rng(2)
    centres = rng.uniform(-0.2, 1.2, (60, dim))  # some lie outside the box and are wrapped
    radii = 0.08 if equal else rng.uniform(0.02, 0.12, 60)
    g = ShapeGeometry([0] * dim, [1] * dim, [True] * dim, shapes=[Shape(Spheres(centres, radii))])
    x = rng.uniform(-0.5, 1.5, (400, dim))
    every = (centres[None] + images(dim)[:, None]).reshape(-1, dim)
    r = np.tile(np.broadcast_to(radii, 60), len(images(dim)))
    nearest = (np.linalg.norm(x[:, None] - every, axis=2) - r).min(1)
    d, fluid = g.distance(x), nearest > 0
    assert np.abs(d - nearest)[fluid].max() < 1e-14
    # in the solid where balls overlap, their fluid lies deeper than the surface of one of them
    assert (d[~fluid] <= nearest[~fluid] + 1e-14).all() and (dim == 3 or (d < nearest - 1e-3).any())
    ways = rng.normal(size=(300, dim))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    inside = x[~fluid, None] + 0.999 * d[~fluid, None, None] * ways
    assert (g.phase(inside.reshape(-1, dim)) < 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("scale", SCALES)
def test_crossings_of_beads_lie_on_the_surface(scale):
    rng = np.random.default_rng(3)
    beads = Spheres(rng.uniform(0, 1, (80, 3)) * scale, rng.uniform(0.05, 0.12, 80) * scale)
    g = ShapeGeometry([0] * 3, [scale] * 3, (True, True, False), shapes=[Shape(beads)])
    xi = rng.uniform(0, 1, (1500, 3)) * scale
    xi = xi[g.phase(xi) == 0]
    xj = xi + rng.normal(0, 0.06, xi.shape) * scale
    t = g.crossing(xi, xj)
    hit = t < 1
    assert np.abs(g.distance((xi + t[:, None] * (xj - xi))[hit])).max() < 2e-12 * scale
    sampled = first_solid(g, xi, xj, 1000)
    assert np.mean(np.abs(t - sampled) > 1.1e-3) == 0
    far = np.array([7, -3, 0]) * scale
    assert np.allclose(t, g.crossing(xi + far, xj + far), atol=1e-9, rtol=0)


def test_distances_of_many_points_are_found_in_parts(monkeypatch):
    disks = [Shape(Disk((0.5, 0.4), 0.2)), Shape(Disk((0.6, 0.5), 0.2))]
    g = ShapeGeometry((0, 0), (1, 1), (True, False), shapes=disks)
    x = np.random.default_rng(3).uniform(0, 1, (250, 2))
    together = g.nearest(x)
    monkeypatch.setattr(shape_geometry, "AT_ONCE", 100)
    assert all(np.array_equal(one, other) for one, other in zip(g.nearest(x), together))


def test_a_thin_plate_between_two_fluid_points_is_seen():
    plate = Shape(Box((-1, 0.5), (2, 0.52)), velocity=(0.3, 0))
    g = ShapeGeometry((0, 0), (1, 1), (True, True), shapes=[plate])
    xi, xj = np.array([[0.2, 0.4], [0.2, 0.61]]), np.array([[0.3, 0.63], [0.2, 0.4]])
    t = g.crossing(xi, xj)
    y = (xi + t[:, None] * (xj - xi))[:, 1]
    assert np.allclose(y, [0.5, 0.52], atol=1e-12)
    assert (g.wall_velocity[g.wall(xj)] == [0.3, 0]).all()


def test_a_box_across_the_whole_period_has_no_seam():
    g = ShapeGeometry((0, 0), (1, 1), (True, True), shapes=[Shape(Box((0, 0.4), (1, 0.6)))])
    x = np.c_[np.linspace(-1, 2, 61), np.full(61, 0.5)]
    assert np.allclose(g.distance(x), -0.1, atol=1e-15)


def test_later_shapes_lie_on_top():
    """Solid, a fluid lens carved out of it, a solid bead in the lens. The fourth point is 0.1 from where the
    half-space was before the carving and 0.15 from the bead, the next wall."""
    shapes = [
        Shape(HalfSpace((0.5, 0.5), (1, 0))),
        Shape(Disk((0.5, 0.5), 0.2), phase=1),
        Shape(Disk((0.4, 0.5), 0.05), slip_length=0.1),
    ]
    g = ShapeGeometry((0, 0), (1, 1), (False, False), shapes=shapes, walls=Walls(0.02))
    x = np.array([[0.2, 0.5], [0.32, 0.5], [0.4, 0.5], [0.6, 0.5], [0.9, 0.5]])
    assert g.phase(x).tolist() == [-1, 1, -1, 1, 0]
    assert np.allclose(g.distance(x), [-0.1, 0.02, -0.05, 0.15, 0.1], atol=1e-14)
    assert g.slip_length[g.wall(x)].tolist() == [0.02, 0.02, 0.1, 0.1, 0.02]


def block(lower, upper, phase=-1):
    return Shape(Box(lower, upper), phase)


# The same scenes of one or of several shapes: (box, periodic, filled with, shapes, shapes)
SAME = {
    "duct of two boxes": ((2, 1), (True, True), 0, [block((0, 0), (2, 1)), block((0, 0.25), (2, 0.75), 0)],
                          [block((0, 0), (2, 1)), block((0, 0.25), (1, 0.75), 0), block((1, 0.25), (2, 0.75), 0)]),
    "of two fluids": ((2, 1), (True, True), -1, [block((0, 0.25), (2, 0.75), 0)],
                      [block((0, 0.25), (1, 0.75), 0), block((1, 0.25), (2, 0.75), 1)]),
    "of three that overlap": ((2, 1), (True, False), -1, [block((0, 0.25), (2, 0.75), 0)],
                              [block((0, 0.25), (1, 0.75), 0), block((0.9, 0.25), (1.7, 0.75), 0),
                               block((1.7, 0.25), (2.0, 0.75), 0)]),
    "solids that touch": ((2, 1), (True, True), 0, [block((0.5, 0.2), (1.5, 0.8))],
                          [block((0.5, 0.2), (1, 0.8)), block((1, 0.2), (1.5, 0.5)), block((1, 0.5), (1.5, 0.8))]),
    "bore to the fluid": ((2, 1), (True, False), 0, [block((0.5, 0), (1.5, 0.3)), block((0.5, 0.7), (1.5, 1))],
                          [block((0.5, 0), (1.5, 1)), block((0.5, 0.3), (1.5, 0.7), 0)]),
    "tube of two cylinders": ((1, 1, 1), (True, True, True), -1, [Shape(Cylinder(0, (0, 0.5, 0.5), 0.3), 0)],
                              [Shape(Cylinder(0, (0, 0.5, 0.5), 0.3, (0, 0.4)), 0),
                               Shape(Cylinder(0, (0, 0.5, 0.5), 0.3, (0.4, 1)), 1)]),
    "tube in a cube": ((1, 1, 1), (True, False, False), 0, [Shape(Cylinder(2, (0.5, 0.5, 0), 0.3), outside=True)],
                       [block((0, 0, 0), (1, 1, 0.5)), block((0, 0, 0.5), (1, 1, 1)),
                        Shape(Cylinder(2, (0.5, 0.5, 0), 0.3, (-1, 0.5)), 0),
                        Shape(Cylinder(2, (0.5, 0.5, 0), 0.3, (0.5, 2)), 0)]),
    "boxes in 3D": ((1, 1, 1), (True, True, True), -1, [block((0, 0.3, 0.3), (1, 0.7, 0.7), 0)],
                    [block((0, 0.3, 0.3), (0.5, 0.7, 0.7), 0), block((0.5, 0.3, 0.3), (1, 0.7, 0.5), 0),
                     block((0.5, 0.3, 0.5), (1, 0.7, 0.7), 0)]),
}  # fmt: skip


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("name", SAME)
def test_no_wall_where_shapes_of_a_kind_touch(name, scale):
    """A scene of parts has the distances, phases and crossings of the whole, on the seams too."""
    box, periodic, filled, *scenes = SAME[name]

    def scaled(body):
        lengths = {"lower", "upper", "centre", "radius", "ends"}
        values = {k: v for k, v in vars(body).items() if v is not None}
        return type(body)(**{k: np.asarray(v) * scale if k in lengths else v for k, v in values.items()})

    one, parts = (
        ShapeGeometry([0] * len(box), np.array(box) * scale, periodic, filled,
                      [Shape(scaled(s.body), s.phase, s.outside) for s in shapes])
        for shapes in scenes
    )  # fmt: skip
    rng = np.random.default_rng(7)
    x = rng.uniform(-0.1, 1.1, (1500, len(box))) * box
    x[:500, 0] = rng.choice([0, 0.4, 0.5, 1.0, 1.5, 1.7, 2.0], 500)  # seams
    x[500:600, -1] = 0.5
    x *= scale
    fluid = one.phase(x) >= 0
    off_wall = np.abs(one.distance(x)) > 1e-9 * scale
    assert (fluid == (parts.phase(x) >= 0)).all() and 0.05 < fluid.mean() < 0.95
    # a side that two coplanar faces make is found to 1e-9 of the box
    near = one.distance(x)
    assert np.abs(parts.distance(x) - near)[fluid & off_wall].max() < 2e-9 * 2 * scale
    inside = ((x >= 0) & (x <= np.array(box) * scale) | np.array(periodic)).all(1)  # behind faces: a lower bound
    assert np.abs(parts.distance(x) - near)[inside & off_wall].max() < 2e-9 * 2 * scale
    xj = x + rng.normal(0, 0.3, x.shape) * scale
    assert np.abs(one.crossing(x[fluid], xj[fluid]) - parts.crossing(x[fluid], xj[fluid])).max() < 1e-8


CARVED = {
    "box and disk": ((2, 1), (True, False), -1, [block((0, 0.4), (1, 0.6), 0), Shape(Disk((1, 0.5), 0.3), 0)]),
    "a T of three": ((2, 1), (True, False), -1, [block((0, 0.4), (2, 0.6), 0), block((0.9, 0.6), (1.1, 0.8), 1),
                                                 block((0.9, 0.8), (1.1, 1), 0)]),
    "box, tube and ball": ((1, 1, 1), (True, False, False), -1, [
        block((0, 0.4, 0.4), (0.5, 0.6, 0.6), 0), Shape(Cylinder(0, (0, 0.5, 0.5), 0.25, (0.5, 1)), 0),
        Shape(Sphere((0.5, 0.5, 0.5), 0.3), 1)]),
    "crossing tubes": ((1, 1, 1), (True, True, False), -1, [
        Shape(Cylinder(0, (0, 0.5, 0.5), 0.2), 0), Shape(Cylinder(1, (0.5, 0, 0.5), 0.25), 0)]),
    "ball on a plate": ((1, 1, 1), (True, True, False), 0, [block((0, 0, 0), (1, 1, 0.3)),
                                                          Shape(Sphere((0.5, 0.5, 0.3), 0.25))]),
    "pore bodies": ((1, 1), (True, True), -1, [
        Shape(Spheres(np.array([[0.2, 0.5], [0.5, 0.6], [0.8, 0.4], [0.55, 0.25]]),
                      np.array([0.2, 0.17, 0.22, 0.18])), 0)]),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", CARVED)
def test_distances_where_shapes_join_against_a_grid_of_labels(name):
    """The nearest site of the other kind is at least as far as the wall, and a diagonal of a cell (1.5 of them at
    edges) farther at most."""
    box, periodic, filled, shapes = CARVED[name]
    g = ShapeGeometry([0] * len(box), box, periodic, filled, shapes)
    n = 48 if g.dim == 3 else 200
    h = np.array(box) / n
    x = ((np.indices((n,) * g.dim).reshape(g.dim, -1).T) + 0.5) * h
    fluid = (g.phase(x) >= 0).reshape((n,) * g.dim)
    tiled = np.pad(fluid, [(n // 2, n // 2) if p else (0, 0) for p in periodic], mode="wrap")
    tiled = np.pad(tiled, [(0, 0) if p else (1, 1) for p in periodic])
    of_sites = ndimage.distance_transform_edt(tiled, h) - ndimage.distance_transform_edt(~tiled, h)
    of_sites = of_sites[tuple(slice(n // 2, n // 2 + n) if p else slice(1, n + 1) for p in periodic)].ravel()
    d = g.distance(x)
    assert ((d > 0) == fluid.ravel()).all()
    farther = np.abs(of_sites) - np.abs(d)
    assert farther.min() > -1e-8 and farther.max() < 1.5 * np.linalg.norm(h)


@pytest.mark.parametrize("name", CARVED)
def test_distances_that_are_exact_to_a_depth_only(name):
    box, periodic, filled, shapes = CARVED[name]
    g = ShapeGeometry([0] * len(box), box, periodic, filled, shapes)
    x = np.random.default_rng(2).uniform(0.0, box, (2000, len(box)))
    exact, found = g.distance(x), g.distance(x, 0.05)
    shallow = exact >= -0.05
    assert 0.1 < shallow.mean() < 0.95
    assert np.array_equal(found[shallow], exact[shallow])
    assert (found[~shallow] < -0.05).all() and (found[~shallow] >= exact[~shallow]).all()


SCENES = {
    "on top": (0, [
        Shape(HalfSpace((0.5, 0.5, 0.5), (1, 0.3, 0.1))),
        Shape(Sphere((0.5, 0.5, 0.5), 0.3), phase=1),
        Shape(Box((0.4, 0.3, 0.2), (0.5, 0.6, 0.9))),
        Shape(Cylinder(2, (0.3, 0.9, 0.5), 0.2, (0.1, 0.7))),
    ]),
    "carved": (-1, [
        Shape(Cylinder(0, (0, 0.5, 0.5), 0.3), phase=0),
        Shape(Spheres(np.array([[0.1, 0.9, 0.4], [0.95, 0.2, 0.1]]), np.array([0.3, 0.2])), phase=1),
    ]),
    "outside": (0, [
        Shape(Spheres(np.array([[0.2, 0.4, 0.4], [0.7, 0.6, 0.5]]), 0.45), outside=True),
        Shape(Box((0, 0.5, 0.3), (1, 0.55, 0.7))),
    ]),
}


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("periodic", [(True, True, True), (False, True, False)])
def test_crossings_against_samples(scene, periodic):
    """Scenes of every body, carved and turned outside in, across periodic faces."""
    rng = np.random.default_rng(6)
    g = ShapeGeometry((0,) * 3, (1,) * 3, periodic, SCENES[scene][0], SCENES[scene][1])
    xi = rng.uniform(0, 1, (1500, 3))
    xi = xi[g.phase(xi) >= 0][:400]
    xj = xi + rng.normal(0, 0.3, xi.shape)
    t = g.crossing(xi, xj)
    assert 0.2 < np.mean(t < 1) < 0.95
    missed = np.abs(t - first_solid(g, xi, xj, 2000)) > 6e-4
    assert missed.mean() < 0.006  # chords shorter than the samples
    met = (xi + t[:, None] * (xj - xi))[t < 1]
    step = (1e-6 * (xj - xi))[t < 1]
    seam = (np.abs(met - np.round(met)) < 1e-9).any(1)  # where a half-space has no images
    assert (g.phase(met - step) >= 0).all() and (g.phase(met + step) == -1)[~seam].all()
    assert np.abs(g.distance(met)[~seam]).max() < 1e-12


def test_solid_with_a_fluid_ball_in_it():
    g = ShapeGeometry((0, 0), (1, 1), (True, True), -1, [Shape(Disk((0.5, 0.5), 0.2), phase=0)])
    x = np.array([[0.5, 0.6], [0.5, 0.9], [0.1, 0.5]])
    assert g.has_solid and g.phase(x).tolist() == [0, -1, -1]
    assert np.allclose(g.distance(x), [0.1, -0.2, -0.2], atol=1e-15)
    assert np.allclose(g.crossing(x[:1], x[1:2]), 1 / 3, atol=1e-14)


def test_fluid_shapes_alone_make_no_wall():
    g = ShapeGeometry((0, 0), (1, 1), (True, True), shapes=[Shape(Disk((0.5, 0.5), 0.2), phase=1)])
    x = np.array([[0.5, 0.5], [0.1, 0.1]])
    assert not g.has_solid and np.isposinf(g.distance(x)).all() and g.phase(x).tolist() == [1, 0]
    assert (g.crossing(x, x + 0.5) == 1).all()


def test_points_on_a_face_and_outside_are_solid():
    g = ShapeGeometry((0, 0), (1, 1), (False, False))
    x = np.array([[0.0, 0.5], [1.0, 0.5], [1.3, 1.4], [0.5, 0.5]])
    assert g.phase(x).tolist() == [-1, -1, -1, 0]
    assert np.allclose(g.distance(x), [0, 0, -0.5, 0.5])


def test_bad_boxes_are_refused():
    for lower, upper, periodic in [
        ((0, 0), (1, 0), (True, True)),
        ((0,), (1,), (True,)),
        ((0, 0), (1, np.inf), (0, 0)),
    ]:
        with pytest.raises(ShapeError):
            ShapeGeometry(lower, upper, periodic)


def test_a_half_space_that_a_periodic_face_cuts_is_told():
    cut = ShapeGeometry((0, 0), (1, 1), (True, False), shapes=[Shape(HalfSpace((0.5, 0.5), (1, 1)))])
    along = ShapeGeometry((0, 0), (1, 1), (True, False), shapes=[Shape(HalfSpace((0.5, 0.5), (0, 1)))])
    assert along.warnings == () and len(cut.warnings) == 1 and "not periodic along x:" in cut.warnings[0]


def test_blocks_of_solid_on_both_sides_of_a_periodic_face_are_one():
    """A channel between two half-spaces: no fluid sees where they end."""
    below, above = Shape(HalfSpace((0, 0.3), (0, 1))), Shape(HalfSpace((0, 0.7), (0, -1)))
    assert ShapeGeometry((0, 0), (1, 1), (True, True), shapes=[below, above]).warnings == ()
    assert len(ShapeGeometry((0, 0), (1, 1), (True, True), shapes=[below]).warnings) == 1


def test_what_cannot_turn():
    for shape, box, said in (
        (Shape(Box([0, 0], [1, 1]), angular_velocity=1.0), [3.0, 3.0], "only cylinders"),
        (Shape(Disk([0.2, 1.5], 0.5), angular_velocity=1.0), [3.0, 3.0], "reaches over a periodic face"),
    ):
        with pytest.raises(ShapeError, match=said):
            ShapeGeometry([0.0, 0.0], box, [True, True], shapes=[shape])
    speed = ShapeGeometry([0, 0], [3, 3], [True] * 2, shapes=[Shape(Disk([1, 1], 0.5), angular_velocity=-4)]).wall_speed
    assert speed.max() == 2.0


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_on_the_axis_of_a_tube_all_directions_are_alike(axis):
    """The wall is a radius off, also where a pocket of fluid has taken it away on the side that is looked at first."""
    first = 1 if axis == 0 else 0
    pocket = np.full(3, 0.5)
    pocket[first] = 0.8
    shapes = [Shape(Cylinder(axis, (0.5, 0.5, 0.5), 0.3), outside=True), Shape(Sphere(pocket, 0.1), phase=0)]
    g = ShapeGeometry((0, 0, 0), (1, 1, 1), (True,) * 3, shapes=shapes)
    x = np.full((4, 3), 0.5)
    x[:, axis] = [0.1, 0.45, 0.5, 0.9]
    assert np.abs(g.distance(x) - 0.3).max() < 1e-14
