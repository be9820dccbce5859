"""From positions to operators with walls: `WallScene`, the volumes it takes, and what keeps particles off the walls."""

import numpy as np
import pytest

from isphcli.domain.lattice import make_lattice
from isphcli.geometry.bodies import Disk, Shape
from isphcli.geometry.faces import Walls
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.operators.apply import laplacian
from isphcli.operators.wall_scene import WallScene
from isphcli.scene.place import place

SPACING = 1 / 8
SUPPORT = 2.5 * SPACING


def scene_of(geometry, jitter=0.0):
    """(WallScene, positions of the fluid) of a geometry on a lattice."""
    kind = "square" if geometry.dim == 2 else "cubic"
    lattice = make_lattice(kind, geometry.lower, geometry.upper, geometry.periodic, SPACING, SUPPORT)
    particles = place(geometry, lattice, SUPPORT, jitter, SPACING)
    n = particles.n_fluid
    return WallScene(geometry, particles.x[n:], SUPPORT, 0, particles.site_volume), particles.x[:n]


def channel(dim, **options):
    """Walls at y = 0 and y = 1, periodic along the others."""
    return ShapeGeometry(np.zeros(dim), np.ones(dim), [axis != 1 for axis in range(dim)], **options)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_parabola_between_walls_is_exact(dim):
    scene, x = scene_of(channel(dim), jitter=0.1)
    ops, *_ = scene.configure(x)
    u = np.zeros_like(x)
    u[:, 0] = x[:, 1] * (1 - x[:, 1])
    lap = laplacian(ops, u) + ops.walls.laplacian(u)
    # round-off of weights of about 1 / (d dx), d the distance of a wall
    size = 1e-10 * (1 + ops.walls.lap.max() * SPACING**2)
    assert np.abs(lap[:, 0] + 2).max() < size and np.abs(lap[:, 1:]).max() < size
    assert np.abs(ops.total_divergence(u)).max() < size


def test_a_wall_that_moves_hands_its_velocity_on():
    scene, x = scene_of(channel(2, walls=Walls(face_velocity={(1, 1): [0.7, 0.0]})), jitter=0.1)
    ops, *_ = scene.configure(x)
    u = np.stack([0.7 * x[:, 1], 0.0 * x[:, 1]], axis=1)
    lap = laplacian(ops, u) + ops.walls.laplacian(u)
    assert np.abs(lap).max() < 1e-10 * (1 + ops.walls.lap.max() * SPACING**2)
    # and to nobody who sees only the other wall
    far = x[:, 1] < 1 - SUPPORT
    assert far.any() and not ops.walls.lap_velocity[far].any() and ops.walls.lap_velocity[~far, 0].max() > 0


def test_volumes_are_those_of_sites_where_particles_stay_on_them():
    scene, x = scene_of(channel(2), jitter=0.1)
    fixed, moving = scene.stencils(x, fixed=True)[0].volume, scene.stencils(x)[0].volume
    assert np.all(fixed == scene.site_volume)
    assert np.all(moving[len(x) :] == scene.site_volume) and np.all(moving[: len(x)] != scene.site_volume)
    # of disorder of a tenth of the spacing; together they fill the box
    assert np.abs(moving[: len(x)] / scene.site_volume - 1).max() < 0.3
    assert moving[: len(x)].sum() == pytest.approx(1.0, rel=0.03)


def disk():
    return ShapeGeometry([0, 0], [1, 1], [True, True], shapes=[Shape(Disk([0.5, 0.5], 0.23))])


@pytest.mark.parametrize("geometry", [channel(2), disk()], ids=["plates", "disk"])
def test_particles_are_kept_off_the_walls(geometry):
    """Those that would come nearer than they may end there, pushed along the wall's normal; others are left alone."""
    scene, x = scene_of(geometry, jitter=0.1)
    nearest = 0.3 * SPACING
    assert scene.clamp_wall_distance(x, np.zeros_like(x), None, 0.0) is None
    rng = np.random.default_rng(0)
    displacement, shift = (rng.uniform(-0.2, 0.2, x.shape) * SPACING for _ in range(2))
    dr = scene.clamp_wall_distance(x, displacement, shift.copy(), nearest)
    ahead, kept = geometry.distance(x + displacement + shift), geometry.distance(x + displacement + dr)
    pushed = ahead < np.minimum(nearest, geometry.distance(x))
    assert 0 < pushed.sum() < len(x) / 2
    assert np.array_equal(dr[ahead >= nearest], shift[ahead >= nearest])
    # one that starts nearer than it may does not approach; normals are differences over 1e-4 of the support or so
    least = np.minimum(geometry.distance(x), nearest)
    assert kept[pushed] == pytest.approx(least[pushed], abs=1e-6 * SPACING)
    added = (dr - shift)[pushed]
    assert np.linalg.norm(added, axis=1) == pytest.approx((least - ahead)[pushed], abs=1e-6 * SPACING)


def test_each_particle_has_its_own_distance():
    """Those in narrow pores may come nearer than others."""
    scene, x = scene_of(channel(2))
    below = np.flatnonzero(x[:, 1] < SPACING)
    towards = np.where(x[:, 1:] < SPACING, [[0.0, -0.4 * SPACING]], 0.0)
    odd = np.round(x[:, 0] / SPACING - 0.5) % 2 == 1
    nearest = np.where(odd, 0.05, 0.3) * SPACING
    dr = scene.clamp_wall_distance(x, towards, None, nearest)
    ends = (x + towards + dr)[below, 1]  # half a spacing less 0.4 is 0.1
    assert ends == pytest.approx(np.where(odd[below], 0.1, 0.3) * SPACING, abs=1e-6 * SPACING)
    assert 0 < odd[below].sum() < len(below)
