"""Consistent operators: exact for polynomials, convergent, free of units and directions."""

import numpy as np
import pytest

from isphcli.operators.apply import divergence, gradient, laplacian
from isphcli.operators.kernel import KERNELS
from tests.operators.clouds import build, free, inside, jittered, quadratic
from tests.threads import on_threads

SUPPORTS = [2.1, 2.5, 3.0]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", SUPPORTS)
@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("kind", KERNELS.values(), ids=KERNELS)
def test_polynomials_are_exact(dim, ratio, jitter, kind):
    n = 10
    if (kind, ratio) == (KERNELS["wendland_c4"], 2.1):
        jitter *= 0.5  # it weighs its outer neighbours so little that one row in a thousand would fall back at 20 %
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
        assert np.array_equal(ops.gradient_p(f(x)), gradient(ops, f(x)[:, None])[:, 0])


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
        errors.append(np.linalg.norm(ops.gradient_p(f) - exact) / np.linalg.norm(exact))
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 1.9


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


def test_bits_do_not_depend_on_the_threads(monkeypatch):
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
            ops.gradient_p(u[:, 0]),
        )

    first, *others = on_threads(monkeypatch, results)
    for other in others:
        assert all(np.array_equal(a, b) for a, b in zip(first, other))


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
        b.gradient_p(f)[rows], (a.gradient_p(f) @ turn.T)[rows], rtol=1e-9, atol=1e-9
    )
    la, lb = laplacian(a, f[:, None])[rows], laplacian(b, f[:, None])[rows]
    np.testing.assert_allclose(lb, la, rtol=1e-9, atol=1e-9 * np.abs(la).max())
