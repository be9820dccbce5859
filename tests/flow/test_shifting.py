"""Shifting: eq. 8 against its sum in numpy, what it evens out and how far; fields carried by their Taylor series."""

import numpy as np
import pytest

from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.neighbours import neighbourhood
from isphcli.flow.shifting import LONGEST, carry, shift
from isphcli.geometry.faces import Walls
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.operators.moments import particle_volumes
from tests.operators.clouds import build, inside, jittered, quadratic
from tests.operators.walls import Walled

RATIO = 2.5  # support over spacing


def periodic(x, spacing):
    """Neighbourhoods of x (n, dim) in the periodic unit box."""
    dim = x.shape[1]
    halo = build_halo(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool), RATIO * spacing)
    return neighbourhood(halo.positions(x), halo.owners(len(x)), len(x), 0, RATIO * spacing)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_lattice_stays_as_it_is(dim):
    dr = shift(periodic(jittered(dim, 8, 0.0), 1 / 8), 1.0, 1e-3, 0.04, 1 / 8)
    assert np.abs(dr).max() < 1e-12 * 0.04 * 1e-3


@pytest.mark.parametrize("dim", [2, 3])
def test_a_shift_is_the_sum_of_eq_8(dim):
    x, speed, dt, coefficient = jittered(dim, 8, 0.2), 1.7, 1e-4, 0.04
    dr = shift(periodic(x, 1 / 8), speed, dt, coefficient, 1 / 8)
    e = x[:, None] - x[None]
    e -= np.round(e)
    r = np.linalg.norm(e, axis=2)
    for i in range(len(x)):
        seen = (r[i] < RATIO / 8) & (r[i] > 0.0)
        ratio = r[i, seen].mean() / r[i, seen]
        expected = coefficient * speed * dt * (ratio[:, None] ** 2 * e[i, seen] / r[i, seen, None]).sum(axis=0)
        assert np.linalg.norm(expected) < LONGEST / 8  # none is cut
        # the sum has up to a hundred terms of order 1
        assert dr[i] == pytest.approx(expected, abs=1e-12 * coefficient * speed * dt)


@pytest.mark.parametrize("dim", [2, 3])
def test_shifts_even_out_the_particles(dim):
    """The spread of the volumes falls, in a box whose particles together go nowhere in particular."""
    n = 10
    x = jittered(dim, n, 0.3)
    spread = []
    for _ in range(30):
        neighbours = periodic(x, 1 / n)
        spread.append(particle_volumes(neighbours).std() * n**dim)
        dr = shift(neighbours, 1.0, 0.1 / n, 0.04, 1 / n)
        assert np.abs(dr.mean(axis=0)).max() < 0.1 * np.abs(dr).max()
        x = wrap(x + dr, np.zeros(dim), np.ones(dim), np.ones(dim, bool))
    assert spread[-1] < 0.5 * spread[0]


def test_no_shift_is_longer_than_a_part_of_the_spacing():
    """Directions stay, lengths are cut."""
    neighbours = periodic(jittered(2, 8, 0.2), 1 / 8)
    short, longer = (shift(neighbours, 1.0, dt, 0.04, 1 / 8) for dt in (1e-6, 0.25))
    length, whole = np.linalg.norm(longer, axis=1), np.linalg.norm(0.25e6 * short, axis=1)
    assert length == pytest.approx(np.minimum(whole, LONGEST / 8), rel=1e-9)
    assert 0.1 < (whole > 1.2 * LONGEST / 8).mean() < 0.9  # some are cut and some are not
    cosine = (short * longer).sum(axis=1) / np.linalg.norm(short, axis=1) / length
    assert cosine == pytest.approx(1.0, abs=1e-12)


def test_particles_in_one_place_part():
    x = jittered(2, 8, 0.0)
    dr = shift(periodic(np.concatenate([x, x[[27]]]), 1 / 8), 1.0, 1e-3, 0.04, 1 / 8)
    assert dr[27, 0] * dr[64, 0] < 0 and abs(dr[27, 0] - dr[64, 0]) > 100 * 0.04 * 1e-3


@pytest.mark.parametrize("dim", [2, 3])
def test_a_quadratic_field_is_carried_exactly(dim):
    """With the second derivative, where all neighbours see whole neighbourhoods; without it (beside walls) by the
    gradient alone."""
    n = 14
    x, (f, df, _) = jittered(dim, n, 0.1), quadratic(dim)
    dr = np.random.default_rng(3).uniform(-0.1, 0.1, x.shape) / n
    ops, everywhere = build(x, RATIO / n), np.ones(len(x), bool)
    rows = inside(x, 2 * RATIO / n)
    moved = carry(ops, f(x)[:, None], dr, everywhere)[rows, 0]
    assert moved == pytest.approx(f(x + dr)[rows], abs=1e-12)
    rows = inside(x, RATIO / n)
    moved = carry(ops, f(x)[:, None], dr, ~everywhere)[rows, 0]
    assert moved == pytest.approx((f(x) + (df(x) * dr).sum(axis=1))[rows], abs=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_beside_walls_quadratic_velocities_are_carried_exactly(dim):
    """Couette and Poiseuille flow in a channel with a lid that slides, from disorder: the velocity of the walls is part
    of the gradient. Of first order, one-sided, a shift of a tenth of a spacing leaves 1e-3 of the lid."""
    n, lid = 8, 2.0
    geometry = ShapeGeometry(np.zeros(dim), np.ones(dim), [axis != 1 for axis in range(dim)],
                             walls=Walls(face_velocity={(1, 1): [lid, *[0.0] * (dim - 1)]}))
    scene = Walled(geometry, 1 / n, RATIO, order=2, jitter=0.1)
    walls = scene.ops.walls

    def flow(y):
        u = np.zeros((len(y), dim))
        u[:, 0], u[:, -1] = lid * y + 3.0 * y * (1.0 - y), u[:, -1] + 2.0 * y * (y - 1.0) * (dim == 3)
        return u

    u = flow(scene.x[:, 1])
    dr = np.random.default_rng(3).uniform(-0.1, 0.1, scene.x.shape) / n
    moved = carry(scene.ops, np.concatenate([u, 2.0 * u - flow(scene.x[:, 1])], axis=1), dr, np.ones(scene.n, bool))
    expected = flow(scene.x[:, 1] + dr[:, 1])
    rows = walls.near_wall
    assert rows.sum() > 2 * n ** (dim - 1)
    assert moved[rows, :dim] == pytest.approx(expected[rows], abs=1e-10)
    assert moved[rows, dim:] == pytest.approx(expected[rows], abs=1e-10)
