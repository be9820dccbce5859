"""Walls: quadratics exact at any wall distance, in slits and corners; walls that move or slip."""

import numpy as np
import pytest

from isphcli.domain.neighbours import neighbourhood
from isphcli.geometry.bodies import Cylinder, Disk, Shape, Spheres
from isphcli.geometry.faces import Walls
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.operators.apply import gradient
from isphcli.operators.crossings import MEETS_WALL, WallStencils, WallTable, crossings
from isphcli.operators.kernel import KERNELS
from isphcli.operators.pair_weights import build_operators
from isphcli.operators.wall_weights import build_wall_operators
from tests.operators.walls import SUPPORTS, Walled, along_x, channel
from tests.threads import on_threads


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", SUPPORTS)
@pytest.mark.parametrize("offset", [0.0, 0.13, 0.3, -0.45, 0.45])
@pytest.mark.parametrize("order", [1, 2])
def test_poiseuille_is_exact_at_any_wall_offset(dim, ratio, offset, order):
    """u = y (h - y): Laplacian -2, wherever the lattice lies, up to 1e-5 spacings from the wall."""
    h, dx = 1.0, 1 / 8
    s = Walled(channel(dim, h), dx, ratio, order=order, offset=np.eye(dim)[1] * offset)
    assert s.n == 8**dim and s.ops.deficient == 0
    u = along_x(s.x[:, 1] * (h - s.x[:, 1]), dim)
    lap = s.lap(u)
    # weights of a wall at distance d are about 1 / (d dx), of values u about d h
    size = np.maximum(s.ops.walls.lap, 1 / dx**2)[:, None] * max(abs(u).max(), h * dx)
    assert np.all(np.abs(lap + along_x(np.full(s.n, 2.0), dim)) < 1e-11 * size)
    # nearest wall not degenerate: to round-off
    if abs(offset) < 0.4:
        assert np.abs(lap[:, 0] / -2 - 1).max() < 1e-10
    assert np.abs(s.div(u)).max() < 1e-9


def test_wall_off_the_lattice_spacing():
    """A channel 7.3 spacings wide."""
    for ratio in SUPPORTS:
        s = Walled(channel(2, 7.3 / 8), 1 / 8, ratio)
        u = along_x(s.x[:, 1] * (7.3 / 8 - s.x[:, 1]), 2)
        assert np.abs(s.lap(u)[:, 0] + 2).max() < 1e-10


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("kind", KERNELS.values(), ids=KERNELS)
def test_jittered_channel_is_exact(dim, jitter, kind):
    s = Walled(channel(dim, 1.0), 1 / 8, 2.5, kind=kind, order=2, jitter=jitter)
    u = along_x(s.x[:, 1] * (1 - s.x[:, 1]), dim)
    u[:, -1] += 3.0 * s.x[:, 1] * (s.x[:, 1] - 1)
    lap = s.lap(u)
    assert np.abs(lap[:, 0] + 2).max() < 1e-10 * (1 + s.ops.walls.lap.max() / 64)
    assert np.abs(lap[:, -1] - 6).max() < 1e-10 * (1 + s.ops.walls.lap.max() / 64)


def general_quadratic(dim):
    rng = np.random.default_rng(3)
    h = rng.uniform(-1, 1, (dim, dim))
    h, b = h + h.T, rng.uniform(-1, 1, dim)
    return (
        (lambda x: 0.7 + x @ b + 0.5 * np.einsum("nk,km,nm->n", x, h, x)),
        (lambda x: b + x @ h),
        np.trace(h),
    )


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", SUPPORTS)
def test_any_quadratic_with_its_wall_values(dim, ratio):
    """Wall values varying along the walls of a closed box, corners included: one wall for each dummy that one
    particle sees, moving with the value of the quadratic where that pair crosses the wall."""
    dx = 1 / 6
    geometry = ShapeGeometry(np.zeros(dim), np.ones(dim), [False] * dim)
    s = Walled(geometry, dx, ratio, jitter=0.1)
    f, df, lap_f = general_quadratic(dim)
    worst = 0.0
    for i in range(0, s.n, 5):
        rows = np.concatenate([[i], np.delete(np.arange(len(s.rows)), i)])
        x = s.rows[rows]
        neighbours = neighbourhood(x, np.arange(len(x), dtype=np.int32), 1, 0, ratio * dx)
        table = WallTable(
            s.table.fluid[rows],
            s.table.distance[rows],
            np.arange(len(x), dtype=np.int32),
            np.zeros((len(x), dim)),
            np.zeros(len(x)),
            np.zeros((0, dim)),
            np.zeros((0, dim, dim)),
        )
        links = crossings(geometry, neighbours, table)
        j = neighbours.row
        t = np.ones(len(j))
        t[links.link == MEETS_WALL] = links.t
        met = x[0] + t[:, None] * (x[j] - x[0])
        table.velocity[j] = f(met)[:, None]
        ops = build_wall_operators(WallStencils(neighbours, table, links, s.volume), 2)
        values = f(x)
        lap = (
            ops.lap @ (values[ops.column] - values[0])
            + ops.walls.lap_velocity[0, 0]
            - ops.walls.lap[0] * values[0]
        )
        slope = ops.grad.T @ (values[ops.column] - values[0]) - ops.walls.div[0] * values[0]
        # what the walls add to the gradient comes as the divergence of (f, f, ...)
        total = slope.sum() + ops.walls.div_velocity[0]
        assert abs(lap / lap_f - 1) < 1e-9 * (1 + ops.walls.lap[0] * dx**2)
        assert abs(total - df(x[:1]).sum()) < 1e-10 * (1 + np.abs(ops.walls.div[0]).sum() * dx) / dx
        worst = max(worst, ops.walls.lap[0] * dx**2)
    assert worst > 0.5  # walls were seen


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", SUPPORTS)
@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_slit_one_particle_wide_is_exact(dim, ratio, offset):
    """One row of particles between two walls: Poiseuille flow is exact, nothing falls back."""
    h = 0.9 / 8
    s = Walled(channel(dim, h), 1 / 8, ratio, offset=np.eye(dim)[1] * (offset - 0.05))
    assert s.n == 8 ** (dim - 1) and s.ops.deficient == 0
    u = along_x(s.x[:, 1] * (h - s.x[:, 1]), dim)
    assert np.abs(s.lap(u)[:, 0] + 2).max() < 1e-10
    # the pressure gradient along the slit is exact, across it is zero
    wave = s.ops.gradient_p(s.x[:, 0])
    interior = (s.x[:, 0] > 3.1 / 8) & (s.x[:, 0] < 1 - 3.1 / 8)
    expected = np.broadcast_to(np.eye(dim)[0], (interior.sum(), dim))
    assert wave[interior] == pytest.approx(expected, abs=1e-10)


def test_particle_on_a_wall_is_finite():
    """Nearer than the limit `NEAREST_CROSSING`: no longer exact, but finite, and the wall dominates the row."""
    for gap in (1e-9, 1e-11):
        s = Walled(channel(2, 1.0), 1 / 8, 2.1, offset=[0.0, 0.5 - gap])
        assert s.n == 64 and np.isfinite(s.ops.walls.lap).all() and np.isfinite(s.ops.lap).all()
        assert s.ops.walls.lap.max() > 10 * 64  # a wall at half a spacing gives about 4


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_couette(dim, order):
    """The upper wall moves: the linear profile has no Laplacian and no divergence, off the lattice too."""
    h, velocity = 0.93, [0.7, 0.0, -0.2][:dim]
    s = Walled(channel(dim, h, walls=Walls(face_velocity={(1, 1): velocity})), 1 / 8, 2.1, order=order, jitter=0.1)
    u = s.x[:, 1:2] / h * velocity
    assert np.abs(s.lap(u)).max() < 1e-11 * 64 * max(1, s.ops.walls.lap.max() / 64)
    assert np.abs(s.div(u)).max() < 1e-11
    # walls that open: u_y = y / h has divergence 1 / h
    s = Walled(
        channel(dim, h, walls=Walls(face_velocity={(1, 1): [0.0, 1.0, 0.0][:dim]})), 1 / 8, 2.1, order=order, jitter=0.1
    )
    u = np.zeros((s.n, dim))
    u[:, 1] = s.x[:, 1] / h
    assert s.div(u) == pytest.approx(1 / h, abs=1e-11 * s.ops.walls.lap.max())
    assert np.abs(s.lap(u)).max() < 1e-11 * 64 * max(1, s.ops.walls.lap.max() / 64)


@pytest.mark.parametrize("dim", [2, 3])
def test_slip_walls(dim):
    """Navier slip at both plates: u_W = b du/dn. The shear flow between a slipping lower and a
    moving upper wall is linear, so exact."""
    b, h = 0.2, 1.0
    rise = 1.0 / (h + b)
    geometry = channel(dim, h, walls=Walls(0.0, {(1, 1): [1.0, 0.0, 0.0][:dim]}, {(1, 0): b}))
    s = Walled(geometry, 1 / 8, 2.1, offset=np.eye(dim)[1] * 0.2)
    u = along_x(rise * (s.x[:, 1] + b), dim)
    assert np.abs(s.lap(u)).max() < 1e-10
    assert np.abs(s.div(u)).max() < 1e-11
    # no flow through the wall: the normal component does not slip
    u = np.zeros((s.n, dim))
    u[:, 1] = s.x[:, 1]
    assert s.ops.walls.slip is not None and np.abs(s.ops.walls.slip[:, :, 1]).max() < 1e-9
    # both walls of a perfect slip channel leave a uniform flow alone
    free = Walled(channel(dim, h, walls=Walls(1e12)), 1 / 8, 2.1)
    assert np.abs(free.lap(along_x(np.ones(free.n), dim))).max() < 1e-8


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_flow_along_a_wall_that_slips_does_not_leak(dim, order):
    """A stagnation point flow on it, linear, has no divergence."""
    s = Walled(channel(dim, 1.0, walls=Walls(1e12)), 1 / 12, 2.1, order=order, jitter=0.15, offset=np.eye(dim)[1] * 0.3)
    u = s.x * ([1.0, -1.0] if dim == 2 else [0.75, -1.0, 0.25])
    inside = (s.x[:, 1] < 0.6) & (np.abs(np.delete(s.x, 1, axis=1) - 0.5) < 0.3).all(axis=1)  # sees no period
    assert (inside & s.ops.walls.near_wall).sum() > 5
    assert np.abs(s.div(u)[inside]).max() < 1e-6


def test_no_wall_in_sight_is_the_scene_without_walls():
    """Far from walls the rows are those of `build_operators`; pressure and velocity weights agree there."""
    geometry = ShapeGeometry([0, 0], [1, 1], [True, True], shapes=[Shape(Disk([0.5, 0.5], 0.2))])
    s = Walled(geometry, 1 / 24, 2.5, jitter=0.1, order=2)
    plain = build_operators(s.neighbours, s.volume, 2)
    f = np.random.default_rng(0).normal(size=(s.n, 2))
    far = ~s.ops.walls.near_wall
    assert far.any() and s.ops.walls.near_wall.any()
    whole = np.concatenate([f, np.zeros((len(s.volume) - s.n, 2))])
    lap = np.array(
        [
            plain.lap[a:b] @ (whole[plain.column[a:b]] - whole[i])
            for i, (a, b) in enumerate(zip(plain.start[:-1], plain.start[1:]))
        ]
    )
    np.testing.assert_allclose(s.lap(f)[far], lap[far], rtol=1e-9, atol=1e-8)
    i = np.repeat(np.arange(s.n), np.diff(s.ops.start))
    assert np.array_equal(s.ops.lap_p[far[i]], s.ops.lap[far[i]])
    assert np.array_equal(s.ops.grad_p[far[i]], s.ops.grad[far[i]])
    assert np.array_equal(s.ops.lap_p[~far[i]], s.ops.walls.symmetric_laplacian[~far[i]])


@pytest.mark.parametrize("dim", [2, 3])
def test_pressure_is_exact_for_linear_functions_at_walls(dim):
    s = Walled(channel(dim, 1.0), 1 / 8, 2.1, jitter=0.1)
    slope = np.arange(1.0, dim + 1)
    slope[0] = 0.0  # periodic
    slope[-1] *= dim == 2
    assert s.ops.gradient_p(s.x @ slope) == pytest.approx(np.broadcast_to(slope, (s.n, dim)), abs=1e-11)
    # symmetric weights: positive, and constants vanish
    assert np.all(s.ops.walls.symmetric_laplacian > 0)


@pytest.mark.parametrize("dim", [2, 3])
def test_symmetric_pressure_weights_are_conservative_on_a_lattice(dim):
    """Every particle of a lattice has the same full neighbourhood: the weights are mutual, fluxes cancel in pairs."""
    s = Walled(channel(dim, 1.0), 1 / 8, 2.1)
    p = np.random.default_rng(0).normal(size=s.n)
    i = np.repeat(np.arange(s.n), np.diff(s.ops.start))
    assert abs((s.ops.walls.symmetric_laplacian * (p[s.ops.column] - p[i])).sum()) < 1e-9


def test_throats_and_corners_are_finite():
    """Random overlapping balls with throats of all sizes: finite, few fallbacks."""
    rng = np.random.default_rng(0)
    geometry = ShapeGeometry(
        np.zeros(3),
        np.ones(3),
        [True, True, False],
        shapes=[Shape(Spheres(rng.random((14, 3)), rng.uniform(0.12, 0.3, 14)))],
    )
    for order in (1, 2):
        s = Walled(geometry, 1 / 14, 2.1, order=order)
        w = s.ops.walls
        for a in (
            s.ops.lap,
            s.ops.grad,
            s.ops.lap_p,
            s.ops.grad_p,
            w.lap,
            w.lap_velocity,
            w.div,
            w.div_velocity,
        ):
            assert np.isfinite(a).all()
        assert s.ops.deficient <= 0.01 * s.n
        u = np.ones((s.n, 3))  # constants only feel the walls
        np.testing.assert_allclose(s.lap(u), -np.repeat(w.lap[:, None], 3, axis=1), rtol=1e-12, atol=1e-9)


def test_particle_alone_in_a_pore():
    """A pore of one particle: its walls are all its neighbours."""
    geometry = ShapeGeometry([0, 0], [1, 1], [False, False])
    s = Walled(geometry, 1.0, 2.1)
    assert s.n == 1 and s.ops.deficient == 0 and len(s.ops.column) == 0
    assert s.ops.walls.lap[0] > 0
    assert np.isfinite(s.ops.walls.lap).all() and np.isfinite(s.ops.walls.div).all()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("power", [-20, 13])
def test_units_do_not_matter(dim, power):
    scale = 2.0**power

    def make(k):
        return Walled(
            channel(
                dim,
                0.95 * k,
                length=k,
                walls=Walls(face_velocity={(1, 1): [1.0, 0.0, 0.0][:dim]}),
                shapes=[Shape(Disk([0.5 * k, 0.5 * k], 0.2 * k))] if dim == 2 else (),
            ),
            k / 8,
            2.1,
            order=2,
            offset=[0.1] * dim,
        ).ops

    a, b = make(1.0), make(scale)
    for field, factor in (("lap", scale**2), ("grad", scale), ("lap_p", scale**2), ("grad_p", scale)):
        np.testing.assert_allclose(getattr(b, field) * factor, getattr(a, field), rtol=1e-11)
    np.testing.assert_allclose(b.walls.lap * scale**2, a.walls.lap, rtol=1e-11)
    np.testing.assert_allclose(b.walls.div * scale, a.walls.div, rtol=1e-11, atol=1e-10)


def test_bits_do_not_depend_on_the_threads(monkeypatch):
    geometry = ShapeGeometry([0, 0], [1, 1], [True, True], shapes=[Shape(Disk([0.5, 0.5], 0.2))])

    def results():
        ops = Walled(geometry, 1 / 24, 2.1).ops
        return ops.lap, ops.grad, ops.lap_p, ops.grad_p, ops.walls.lap, ops.walls.div

    first, *others = on_threads(monkeypatch, results)
    for other in others:
        assert all(np.array_equal(a, b) for a, b in zip(first, other))


def test_gradient_of_a_field_that_is_zero_on_the_walls():
    """The velocity gradient of Poiseuille flow: exact at walls for order 2, first order for order 1."""
    errors = {1: [], 2: []}
    for n in (8, 16):
        for order in errors:
            s = Walled(channel(2, 1.0), 1 / n, 2.1, order=order, offset=[0.0, 0.2])
            y = s.x[:, 1]
            # walls at rest: their part of the gradient is -div_k u_c
            grad = gradient(s.ops, along_x(y * (1 - y), 2))[:, 0] - s.ops.walls.div * (y * (1 - y))[:, None]
            errors[order].append(np.abs(grad - np.stack([0 * y, 1 - 2 * y], axis=1)).max())
    assert max(errors[2]) < 1e-11
    assert errors[1][1] < 0.6 * errors[1][0]


@pytest.mark.parametrize("axis", [None, 0, 1, 2])
def test_walls_that_turn_together_carry_a_rigid_body(axis):
    """Two coaxial walls at one angular velocity, right-handed about the axis: u = omega x r is linear, so its
    Laplacian and divergence vanish to round-off wherever the walls are. Two disks where axis is None."""
    omega, middle = 1.7, np.array([2.3, 1.9, 2.1])
    dim = 2 if axis is None else 3
    middle = middle[:dim]
    bodies = [Disk(middle, r) if axis is None else Cylinder(axis, middle, r) for r in (1.77, 0.83)]
    shapes = [Shape(b, outside=k == 0, angular_velocity=omega) for k, b in enumerate(bodies)]
    lower, upper = middle - 2.0, middle + 2.0
    if axis is not None:
        lower[axis], upper[axis] = 0.0, 0.6
    scene = Walled(ShapeGeometry(lower, upper, [True] * dim, shapes=shapes), 0.15, jitter=0.1)
    spin = np.cross(np.eye(3)[2 if axis is None else axis], np.pad(scene.x - middle, ((0, 0), (0, 3 - dim))))
    u = omega * spin[:, :dim]
    assert np.abs(scene.lap(u)).max() < 1e-9 * omega / 0.15 and np.abs(scene.div(u)).max() < 1e-9 * omega
    # walls that did not turn with it would show
    assert np.abs(scene.lap(1.1 * u)).max() > 1.0
