"""Operators in factors are those of `walls`, on lattices and off them; the matrices are what they apply."""

import numpy as np
import pytest

from isphcli.domain.exchange import NeighbourExchange
from isphcli.domain.halo import wrap
from isphcli.domain.lattice import make_lattice
from isphcli.domain.neighbours import Neighbourhood
from isphcli.geometry.bodies import Shape, Sphere
from isphcli.geometry.faces import Walls
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.operators import lattice_weights as factored
from isphcli.operators.apply import laplacian
from isphcli.operators.crossings import SHARES_PRESSURE
from isphcli.operators.wall_scene import WallScene
from isphcli.operators.wall_weights import build_wall_operators
from isphcli.scene.place import place
from tests.domain.wires import counts, on_all, wires
from tests.threads import on_threads

SPACING = 1 / 12


def both(dim, jitter, slip=0.0, order=2, radius=0.31, kind=None, centre=0.5):
    """Weights per pair and in factors of a disk that moves and turns, or of a sphere that moves, in a periodic cell."""
    turn = 0.7 if dim == 2 else None
    body = Shape(Sphere([centre] * dim, radius), velocity=[0.3, -0.2, 0.1][:dim], angular_velocity=turn)
    geometry = ShapeGeometry([0] * dim, [1] * dim, [True] * dim, shapes=[body], walls=Walls(slip))
    kind = kind or ("square" if dim == 2 else "cubic")
    support = 2.1 * SPACING
    particles = place(geometry, make_lattice(kind, geometry.lower, geometry.upper, geometry.periodic, SPACING, support),
                      support, jitter, SPACING)
    n = particles.n_fluid
    x = wrap(particles.x[:n], geometry.lower, geometry.upper, geometry.periodic)
    scene = WallScene(geometry, particles.x[n:], support, 0, particles.site_volume)
    stencils, _ = scene.stencils(x, jitter == 0.0)
    return build_wall_operators(stencils, order), factored.build_lattice_weights(stencils, order)[0]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("dim", "jitter", "slip"), [(2, 0.0, 0.0), (3, 0.0, 0.0), (2, 0.1, 0.0), (3, 0.1, 0.05)])
def test_factors_are_the_weights(dim, jitter, slip, order):
    ops, rows = both(dim, jitter, slip, order)
    rng = np.random.default_rng(0)
    u, p = rng.standard_normal((ops.n, dim)), rng.standard_normal(ops.n)
    assert (len(rows.pairs.step) < 40) == (jitter == 0.0)  # a lattice has few offsets
    grad = rows.gradient_p(p)
    out = np.empty_like(u)
    factored.coupled(rows, u, (p, grad), (SPACING, 0.0, 0.0), (out, np.empty(ops.n)))
    expected = laplacian(ops, u) - ops.walls.lap[:, None] * u
    whole = rows.walls.lap_velocity - rows.walls.lap[:, None] * u
    if slip:
        whole += np.einsum("nkm,nm->nk", rows.walls.slip, u)
    np.testing.assert_allclose(whole, ops.walls.laplacian(u), atol=1e-10 * np.abs(whole).max())
    np.testing.assert_allclose(grad, ops.gradient_p(p), atol=1e-10 * np.abs(grad).max())
    np.testing.assert_allclose(out, -SPACING**2 * expected + SPACING * grad, atol=1e-10 * np.abs(out).max())
    force = rng.standard_normal(dim)
    balanced = rows.potential_gradient(force)
    np.testing.assert_allclose(balanced, ops.potential_gradient(force), atol=1e-10 * np.abs(balanced).max())
    assert np.array_equal(rows.start, ops.start) and np.array_equal(rows.column, ops.column)
    div = ops.total_divergence(u)
    np.testing.assert_allclose(rows.total_divergence(u), div, atol=1e-10 * np.abs(div).max())
    symmetric = np.zeros(ops.n)
    for i in range(ops.n):
        part = slice(ops.start[i], ops.start[i + 1])
        symmetric[i] = ops.walls.symmetric_laplacian[part] @ (p[ops.column[part]] - p[i])
    np.testing.assert_allclose(factored.symmetric_laplacian(rows, p), symmetric, atol=1e-10 * np.abs(symmetric).max())


def test_numbers_of_offsets_depend_on_the_order_of_pairs_alone(monkeypatch):
    """Not on the blocks of rows, the first of which has half of the offsets, nor on the threads."""
    x = np.argwhere(np.ones((40, 6))).astype(float)
    near = np.abs(x[:, None] - x).max(axis=2) <= 1.0
    near[:12] &= (x[:12, None] <= x).all(axis=2)  # neighbours ahead alone
    start, row = np.concatenate([[0], np.cumsum(near.sum(axis=1))]), np.nonzero(near)[1].astype(np.int32)

    def found(x):
        owner, link = np.arange(len(x), dtype=np.int32), np.full(len(row), SHARES_PRESSURE, np.int8)
        return factored._pairs_in_sight(Neighbourhood(start, row, row, x, owner, 0, 1.5), link, start)

    *pairs, number, step = found(x)
    assert len(step) == 9 and all(np.array_equal(part, row) for part in pairs)
    assert np.array_equal(step[number], x[row] - x.repeat(near.sum(axis=1), axis=0))
    monkeypatch.setattr(factored, "edges_of", lambda n: np.linspace(0, n, 21).astype(np.int64))
    for _, _, other, others in on_threads(monkeypatch, lambda: found(x)):
        assert np.array_equal(other, number) and np.array_equal(others, step)
    *pairs, _, off_lattice = found(x + np.random.default_rng(0).random(x.shape))
    assert len(off_lattice) > factored.MOST_OFFSETS and all(np.array_equal(part, row) for part in pairs)


def test_the_matrix_is_what_the_rows_apply():
    ops, rows = both(3, 0.0)
    p = np.random.default_rng(0).standard_normal(ops.n)
    u = np.stack([p] * 3, axis=1)
    out, zeros = np.empty_like(u), (np.zeros(ops.n), np.zeros_like(u))
    factored.coupled(rows, u, zeros, (SPACING, 0.0, 0.0), (out, np.empty(ops.n)))
    np.testing.assert_allclose(factored.velocity_matrix(rows, SPACING) @ p, out[:, 0], atol=1e-12 * np.abs(out).max())


@pytest.mark.parametrize(("dim", "radius", "jitter"), [(2, 0.5, 0.1), (3, 0.6, 0.1), (3, 0.65, 0.0)])
def test_divergence_of_narrow_particles_is_the_adjoint_of_the_gradient(dim, radius, jitter):
    """sum V p div u = - sum V u . grad p for pressures of narrow particles, any velocities, walls that move; between
    disks that touch and in the throats of spheres that overlap. Round-off."""
    ops, rows = both(dim, jitter, radius=radius)
    rng = np.random.default_rng(5)
    assert rows.narrow.any() and not rows.narrow.all()
    u, p = rng.standard_normal((ops.n, dim)), rng.standard_normal(ops.n) * rows.narrow
    left = ops.volume * p * rows.total_divergence(u)
    right = (ops.volume[:, None] * u * rows.gradient_p(p)).sum()
    assert abs(left.sum() + right) < 1e-12 * np.abs(left).sum()


@pytest.mark.parametrize("radius", [0.31, 0.65])
def test_share_in_sight(radius):
    """The trace of the second moments of the pairs in sight, over that of a whole neighbourhood: 1 where nothing is
    hidden, less beside one sphere and between spheres that overlap. To round-off."""
    ops, rows = both(3, 0.0, radius=radius)
    share, seen = factored.share_in_sight(rows), np.diff(rows.start)
    np.testing.assert_allclose(share[seen == 32], 1.0, atol=1e-12)
    assert (share[seen < 32] < 1.0 - 1e-6).all() and share.min() > 0.0
    x, owner = ops.neighbours.x, np.repeat(np.arange(ops.n), seen)
    square = ((x[ops.neighbours.row] - x[owner]) ** 2).sum(axis=1)
    traces = np.bincount(owner, ops.walls.symmetric_laplacian * square) / 6.0
    np.testing.assert_allclose(share, traces, atol=1e-12)


@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_beside_one_body_no_particle_is_narrow(jitter):
    """A wall that curves away hides less than half of a neighbourhood, and the divergence is the consistent one."""
    assert not both(2, jitter)[1].narrow.any() and not both(3, jitter)[1].narrow.any()

@pytest.mark.parametrize("dim", [2, 3])
def test_the_nearest_neighbours_give_the_laplacian_of_a_quadratic_function(dim):
    """Where all of them are in sight, and the box does not close on itself; symmetric and dominated by its diagonal
    everywhere, to round-off: what smoothed aggregation needs."""
    ops, rows = both(dim, 0.0)
    matrix = factored.nearest_matrix(rows, SPACING)
    assert matrix.nnz <= (1 + 2 * dim) * ops.n and abs(matrix - matrix.T).max() < 1e-12
    assert np.all(matrix.sum(axis=1) > -1e-12)
    x = ops.neighbours.x[: ops.n]
    inner = (np.diff(matrix.indptr) == 1 + 2 * dim) & (ops.walls.lap == 0.0) & np.all(np.abs(x - 0.5) < 0.4, axis=1)
    assert inner.any()
    np.testing.assert_allclose((matrix @ (x**2).sum(axis=1))[inner], -2.0 * dim * SPACING**2, atol=1e-12)


@pytest.mark.parametrize(("kind", "count"), [("square", 4), ("hexagonal", 6), ("cubic", 6), ("bcc", 8)])
@pytest.mark.parametrize("stretch", [[1.0, 1.0, 1.0], [1.03, 0.97, 1.0], [0.96, 1.0, 1.04]])
def test_a_stretched_lattice_has_the_same_nearest_neighbours(kind, count, stretch):
    """By up to 4 %, unlike along the axes: what a box that is no multiple of the spacing does."""
    dim = 2 if kind in ("square", "hexagonal") else 3
    box = SPACING * np.array([8.0, 8.0 * np.sqrt(3) if kind == "hexagonal" else 8.0, 8.0])[:dim] * stretch[:dim]
    lattice = make_lattice(kind, np.zeros(dim), box, [True] * dim, SPACING, 0.0)
    x = np.concatenate(list(lattice.slabs()))
    step = x - x[np.linalg.norm(x - box / 2, axis=1).argmin()]
    step = step[(np.linalg.norm(step, axis=1) < 2.1 * SPACING) & (np.abs(step).max(axis=1) > 0.0)]
    assert np.count_nonzero(factored._nearest(step, SPACING)) == count


def test_bits_do_not_depend_on_the_threads(monkeypatch):
    """Every kernel of a steady solve."""
    def results():
        ops, rows = both(3, 0.0)
        u, p = np.random.default_rng(0).standard_normal((ops.n, 3)), np.random.default_rng(1).standard_normal(ops.n)
        grad, out, mass = rows.gradient_p(p), np.empty_like(u), np.empty(ops.n)
        factored.coupled(rows, u, (p, grad), (SPACING, SPACING, 1.0), (out, mass))
        return [ops.lap, ops.grad_p, out, mass, grad, rows.total_divergence(u),
                factored.nearest_matrix(rows, SPACING).data]

    first, *others = on_threads(monkeypatch, results)
    for other in others:
        assert all(np.array_equal(a, b) for a, b in zip(first, other))


def test_a_process_that_sees_nobody_sends_its_tensors_to_those_who_see_it():
    """The first of two processes has no remote particle, the second sees two of its particles: it waits for them."""
    a, b = wires(2)
    one = NeighbourExchange(a, np.array([1, 0]), counts(0, 2), counts(0, 0))
    other = NeighbourExchange(b, np.zeros(0, np.int64), counts(0, 0), counts(2, 0))
    rng, blank = np.random.default_rng(0), np.zeros(0)
    row = np.array([0, 1, 0], np.int32)  # of the first; the second has one particle
    factors = [factored.Factors(row[:n], blank, blank, rng.normal(size=(2, 2, 2)), np.zeros(2), blank,
                                rng.normal(size=(2, 2, 6))) for n in (3, 1)]
    first, second = on_all([lambda: factored._with_remote(factors[0], one),
                            lambda: factored._with_remote(factors[1], other)])
    assert np.array_equal(first.row, row) and second.row.tolist() == [0, 2, 3]
    for name in ("gradient_p", "k_tensor_p"):
        mine, seen = getattr(factors[0], name), getattr(second, name)
        assert np.array_equal(getattr(first, name), mine) and np.array_equal(seen[2:], mine[[1, 0]])
