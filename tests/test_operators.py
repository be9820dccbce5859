"""Consistent operators: exact for polynomials, convergent, finite on poor neighbourhoods, free of units."""

import numba
import numpy as np
import pytest

from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.neighbours import neighbourhood
from isphcli.operators.apply import divergence, gradient, gradient_p, laplacian
from isphcli.operators.kernel import KERNELS
from isphcli.operators.moments import particle_volumes
from isphcli.operators.pair_weights import build_operators

SUPPORTS = [2.1, 2.5, 3.0]


def jittered(dim, n, jitter=0.1, seed=0):
    """n^dim particles in the unit box, each moved by up to `jitter` spacings an axis."""
    ax = (np.arange(n) + 0.5) / n
    x = np.stack(np.meshgrid(*[ax] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = x + np.random.default_rng(seed).uniform(-jitter, jitter, x.shape) / n
    return wrap(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool))


def build(x, support, kind=0, order=2, length=1.0):
    """Operators in a periodic box."""
    dim = x.shape[1]
    halo = build_halo(x, np.zeros(dim), np.full(dim, length), np.ones(dim, bool), support)
    rows, owner = halo.positions(x), halo.owners(len(x))
    neighbours = neighbourhood(rows, owner, len(x), kind, support)
    return build_operators(neighbours, particle_volumes(neighbours), order)


def free(x, support, kind=0, order=2):
    """Operators of particles alone in space, volumes of a lattice of a third of the support."""
    neighbours = neighbourhood(x, np.arange(len(x), dtype=np.int32), len(x), kind, support)
    return build_operators(neighbours, np.full(len(x), (support / 3) ** x.shape[1]), order)


def quadratic(dim, seed=1):
    """c + b.x + x.H.x / 2 and its gradient as functions of x (n, dim), and its Laplacian."""
    rng = np.random.default_rng(seed)
    h = rng.uniform(-1, 1, (dim, dim))
    h, b, c = h + h.T, rng.uniform(-1, 1, dim), rng.uniform(-1, 1)
    centre = np.full(dim, 0.5)

    def f(x):
        d = x - centre
        return c + d @ b + 0.5 * np.einsum("nk,km,nm->n", d, h, d)

    return f, lambda x: b + (x - centre) @ h, np.trace(h)


def inside(x, support):
    """Particles whose neighbourhoods do not cross a face of the unit box."""
    rows = np.all((x > support) & (x < 1 - support), axis=1)
    assert rows.any()
    return rows


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", SUPPORTS)
@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("kind", KERNELS.values(), ids=KERNELS)
def test_polynomials_are_exact(dim, ratio, jitter, kind):
    n = 10
    if (kind, ratio) == (KERNELS["wendland_c4"], 2.1):
        jitter *= 0.5  # it weighs its outer neighbours so little that one star in a thousand would fall back at 20 %
    x = jittered(dim, n, jitter)
    rows = inside(x, ratio / n)
    f, df, lap_f = quadratic(dim)
    linear = x @ np.arange(1.0, dim + 1)
    for order in (1, 2):
        ops = build(x, ratio / n, kind, order)
        assert ops.deficient == 0
        # relative to the largest terms that cancel: n^2 max|f|, n max|f|
        size = np.abs(f(x)).max()
        lap = laplacian(ops, f(x)[:, None])[rows, 0]
        assert np.abs(lap - lap_f).max() < 1e-12 * n**2 * size * 10
        assert np.abs(lap / lap_f - 1).max() < 1e-10
        grad = gradient(ops, np.stack([linear, f(x)], axis=1))[rows]
        assert np.abs(grad[:, 0] - np.arange(1.0, dim + 1)).max() < 1e-12 * n * 10
        error = np.abs(grad[:, 1] - df(x)[rows]).max()
        assert (error < 1e-11) if order == 2 else (error < 3.0 / n)
        assert np.array_equal(gradient_p(ops, f(x)), gradient(ops, f(x)[:, None])[:, 0])


@pytest.mark.parametrize("dim", [2, 3])
def test_divergence_is_the_trace_of_the_gradient(dim):
    x = jittered(dim, 8)
    ops = build(x, 2.1 / 8)
    u = np.random.default_rng(0).normal(size=x.shape)
    trace = np.einsum("nkk->n", gradient(ops, u))
    assert divergence(ops, u) == pytest.approx(trace, abs=1e-11)


@pytest.mark.parametrize("dim", [2, 3])
def test_constants_vanish(dim):
    x = jittered(dim, 8)
    ops = build(x, 2.1 / 8)
    assert np.all(laplacian(ops, np.full((len(x), 2), 3.7)) == 0.0)
    assert np.all(gradient_p(ops, np.full(len(x), 3.7)) == 0.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_volumes_fill_the_box(dim):
    """Sum of 1 / sum_j W_ij over a box: its volume to a few percent; uniform on a lattice."""
    n, support = 10, 2.5 / 10
    for jitter in (0.0, 0.1):
        x = jittered(dim, n, jitter)
        halo = build_halo(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool), support)
        volume = particle_volumes(neighbourhood(halo.positions(x), halo.owners(len(x)), len(x), 0, support))
        assert volume.sum() == pytest.approx(1.0, rel=0.03)
        if jitter == 0.0:
            assert volume == pytest.approx(volume[0], rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", SUPPORTS)
def test_order_of_consistency(dim, ratio):
    """Gradient of a wave: order 2 for `order=2`."""
    errors, sizes = [], ([24, 48, 96] if dim == 2 else [16, 22, 32])
    for n in sizes:
        x = jittered(dim, n)
        ops = build(x, ratio / n)
        f = np.sin(2 * np.pi * x).prod(axis=1)
        exact = 2 * np.pi * f[:, None] / np.tan(2 * np.pi * x)
        errors.append(np.linalg.norm(gradient_p(ops, f) - exact) / np.linalg.norm(exact))
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 1.9


def finite(ops):
    return all(np.isfinite(a).all() for a in (ops.lap, ops.grad, ops.lap_p, ops.grad_p))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_poor_neighbourhoods(dim, order):
    """A line, a pair, an isolated particle, coincident ones, a plane in 3D: finite, counted, no NaN."""
    unit = np.eye(dim)[0]
    line = np.arange(7.0)[:, None] * unit
    scenes = {
        "line": line,
        "oblique line": np.arange(7.0)[:, None] * np.array([0.6, 0.48, 0.64][:dim]),
        "pair": line[:2],
        "alone": line[:1],
        "coincident": np.concatenate([line[:2], line[:2]]),
        "all in one place": np.zeros((5, dim)),
        "two lines": np.concatenate([line, line + np.eye(dim)[1]]),
    }
    for name, x in scenes.items():
        ops = free(x * 1e-6, 2.5e-6, order=order)
        assert finite(ops), name
        if name != "two lines":
            assert ops.deficient == len(x), name
        # a linear function along the line is still differentiated along it
        if name in ("line", "pair", "oblique line"):
            t = x @ (x[-1] - x[0]) / np.linalg.norm(x[-1] - x[0])
            got = gradient(ops, t[:, None])[:, 0] / 1e6
            assert got == pytest.approx(np.broadcast_to((x[-1] - x[0]) / t[-1], got.shape), abs=1e-9), name


def test_plane_in_three_dimensions():
    """Particles in a plane of a 3D scene: counted; gradients in the plane exact, none across."""
    x = np.concatenate([jittered(2, 8), np.full((64, 1), 0.5)], axis=1)
    ops = free(x, 2.5 / 8)
    assert ops.deficient == 64 and finite(ops)
    assert gradient_p(ops, x @ [1.0, 2.0, 3.0]) == pytest.approx(
        np.broadcast_to([1.0, 2.0, 0.0], (64, 3)), abs=1e-10
    )


def test_coincident_particles_in_a_full_neighbourhood():
    """A doubled particle does not act on its twin and takes nothing from the others."""
    x = jittered(2, 8)
    x = np.concatenate([x, x[[27]]])
    ops = build(x, 2.5 / 8)
    assert ops.deficient == 0 and finite(ops)
    rows = inside(x, 2.5 / 8)
    f, df, lap_f = quadratic(2)
    assert laplacian(ops, f(x)[:, None])[rows, 0] == pytest.approx(lap_f, rel=1e-10)
    assert gradient_p(ops, f(x))[rows] == pytest.approx(df(x)[rows], abs=1e-11)
    pair = np.repeat(np.arange(65), np.diff(ops.start))
    twin = ((pair == 27) & (ops.column == 64)) | ((pair == 64) & (ops.column == 27))
    assert twin.sum() == 2 and np.all(ops.lap[twin] == 0.0) and np.all(ops.grad[twin] == 0.0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("power", [-20, 13])
def test_units_do_not_matter(dim, power):
    """Lengths times 2^k: gradient weights times 2^-k, Laplacian weights times 4^-k."""
    x, scale = jittered(dim, 8), 2.0**power
    for order in (1, 2):
        a, b = build(x, 2.1 / 8, order=order), build(x * scale, 2.1 / 8 * scale, order=order, length=scale)
        assert np.array_equal(a.start, b.start) and np.array_equal(a.column, b.column)
        np.testing.assert_allclose(b.lap * scale**2, a.lap, rtol=1e-12)
        np.testing.assert_allclose(b.grad * scale, a.grad, rtol=1e-12)
        np.testing.assert_allclose(b.volume / scale**dim, a.volume, rtol=1e-12)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one thread only")
def test_threads_do_not_matter():
    x = jittered(3, 10)
    u = np.random.default_rng(0).normal(size=x.shape)

    def results():
        ops = build(x, 2.1 / 10)
        return (
            ops.lap,
            ops.grad,
            laplacian(ops, u),
            gradient(ops, u),
            divergence(ops, u),
            gradient_p(ops, u[:, 0]),
        )

    many = results()
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        one = results()
    finally:
        numba.set_num_threads(threads)
    for a, b in zip(one, many):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-10 * np.abs(b).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_rotation_turns_the_gradient(dim):
    """No direction is preferred: operators of a turned cloud are the turned operators."""
    rng = np.random.default_rng(2)
    x = jittered(dim, 6, 0.2)
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    f = rng.normal(size=len(x))
    rows = np.all(np.abs(x - 0.5) < 0.25, axis=1)
    a, b = free(x, 2.5 / 6), free(x @ turn.T, 2.5 / 6)
    np.testing.assert_allclose(
        gradient_p(b, f)[rows], (gradient_p(a, f) @ turn.T)[rows], rtol=1e-9, atol=1e-9
    )
    la, lb = laplacian(a, f[:, None])[rows], laplacian(b, f[:, None])[rows]
    np.testing.assert_allclose(lb, la, rtol=1e-9, atol=1e-9 * np.abs(la).max())
