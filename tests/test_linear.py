"""Poisson on jittered particles: order, flat iteration counts, null spaces; what GMRES reports."""

import numpy as np
import pytest

from isphcli.domain.components import ComponentMeans, pair_components
from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.neighbours import neighbourhood
from isphcli.operators.apply import laplacian
from isphcli.operators.assemble import assemble, row_sums
from isphcli.operators.moments import particle_volumes
from isphcli.operators.pair_weights import build_operators
from isphcli.solvers.krylov import SolveError, gmres
from isphcli.solvers.multigrid import cycle, hierarchy


def operators(dim, n, ratio):
    """Operators of n^dim jittered particles in the periodic unit box."""
    ax = (np.arange(n) + 0.5) / n
    x = np.stack(np.meshgrid(*[ax] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = x + np.random.default_rng(0).uniform(-0.1, 0.1, x.shape) / n
    x = wrap(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool))
    halo = build_halo(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool), ratio / n)
    rows, owner = halo.positions(x), halo.owners(len(x))
    neighbours = neighbourhood(rows, owner, len(x), 0, ratio / n)
    return x, build_operators(neighbours, particle_volumes(neighbours))


def solve(matrix, rhs, means, tolerance=1e-8, **kw):
    precondition = cycle(hierarchy(matrix))
    return gmres(
        lambda v: means.remove(matrix @ means.remove(v)),
        means.remove(rhs),
        lambda v: means.remove(precondition(v)),
        tolerance,
        40,
        200,
        **kw,
    )


def poisson(dim, n, ratio):
    """(relative L2 error, iterations) of -lap q = f with q a product of sines."""
    x, ops = operators(dim, n, ratio)
    exact = np.sin(2 * np.pi * x).prod(axis=1)
    matrix = assemble(ops.start, ops.column, ops.lap, 0.0, 1.0)
    means = ComponentMeans(pair_components(ops.start, ops.column)[1])
    q, report = solve(matrix, dim * (2 * np.pi) ** 2 * exact, means)
    assert report.converged and report.residual <= 1e-8 * 1.01
    exact = means.remove(exact)
    return np.linalg.norm(means.remove(q) - exact) / np.linalg.norm(exact), report.iterations


@pytest.mark.parametrize("ratio", [2.1, 2.5, 3.0])
@pytest.mark.parametrize(("dim", "sizes"), [(2, [32, 64, 128]), (3, [12, 16, 24, 32])])
def test_poisson_is_of_second_order_and_iterations_are_flat(dim, sizes, ratio):
    errors, iterations = zip(*[poisson(dim, n, ratio) for n in sizes])
    order = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert order >= 1.9, (errors, order)
    flat = np.array(iterations if dim == 2 else iterations[1:])  # 12^3 is a coarse grid already
    assert np.abs(flat / flat.mean() - 1).max() <= 0.2, iterations


def test_assembled_matrix_is_the_operator():
    x, ops = operators(2, 12, 2.5)
    f = np.random.default_rng(0).normal(size=len(x))
    diagonal = np.random.default_rng(1).random(len(x))
    column = ops.column.copy()
    matrix = assemble(ops.start, ops.column, ops.lap, 3.0, 0.5, diagonal)
    expected = 3.0 * f - 0.5 * (laplacian(ops, f[:, None])[:, 0] - diagonal * f)
    np.testing.assert_allclose(matrix @ f, expected, rtol=1e-11, atol=1e-9)
    assert np.array_equal(ops.column, column)  # the operators keep the order of their pairs
    assert matrix.has_canonical_format and matrix.indices.dtype == np.int32


def test_images_of_one_owner_are_added_up():
    """A box three spacings wide with support 2.5: several images of one neighbour share a matrix entry."""
    _, ops = operators(2, 3, 2.5)
    matrix = assemble(ops.start, ops.column, ops.lap, 0.0, 1.0)
    assert matrix.nnz == 81 and len(ops.column) > 81
    f = np.random.default_rng(0).normal(size=9)
    np.testing.assert_allclose(matrix @ f, -laplacian(ops, f[:, None])[:, 0], rtol=1e-11, atol=1e-9)


def test_row_sums_with_empty_rows():
    start = np.array([0, 0, 2, 2, 5, 5])
    assert row_sums(start, np.array([1.0, 2.0, 3.0, 4.0, 5.0])).tolist() == [0.0, 3.0, 0.0, 12.0, 0.0]


def two_boxes():
    """Two disconnected periodic boxes of different resolution as one system."""
    (xa, a), (xb, b) = operators(2, 24, 2.1), operators(2, 16, 2.5)
    start = np.concatenate([a.start, a.start[-1] + b.start[1:]])
    column = np.concatenate([a.column, b.column + a.n]).astype(np.int32)
    return (xa, a), (xb, b), start, column, np.concatenate([a.lap, b.lap])


def test_one_null_vector_a_component():
    (xa, a), (xb, b), start, column, lap = two_boxes()
    count, labels = pair_components(start, column)
    assert count == 2 and np.array_equal(labels, np.repeat([0, 1], [a.n, b.n]))
    matrix = assemble(start, column, lap, 0.0, 1.0)
    for k in range(2):
        assert np.abs(matrix @ (labels == k)).max() < 1e-9 * np.abs(matrix).max()
    means = ComponentMeans(labels)
    x = np.concatenate([xa, xb])
    exact = np.sin(2 * np.pi * x).prod(axis=1) * np.where(labels == 0, 1.0, -4.0)
    # different constants on the two: one global mean would leave a null vector in
    rhs = 8 * np.pi**2 * exact + np.where(labels == 0, 10.0, -30.0)
    q, report = solve(matrix, rhs, means)
    assert report.converged and report.iterations < 40
    q = means.remove(q)
    assert np.abs(np.bincount(labels, weights=q)).max() < 1e-9
    for k, ops in ((0, a), (1, b)):
        part = labels == k
        alone = ComponentMeans(np.zeros(ops.n, int))
        single, _ = solve(assemble(ops.start, ops.column, ops.lap, 0.0, 1.0), rhs[part], alone)
        np.testing.assert_allclose(q[part], alone.remove(single), atol=1e-6 * np.abs(single).max())
        assert np.linalg.norm(q[part] - exact[part]) < 0.1 * np.linalg.norm(exact[part])


def test_component_means():
    labels = np.array([0, 1, 0, 2, 1])
    v = np.array([1.0, 10.0, 3.0, 7.0, 20.0])
    assert ComponentMeans(labels).remove(v).tolist() == [-1.0, -5.0, 1.0, 0.0, 5.0]
    assert ComponentMeans(np.zeros(5, int)).remove(v).sum() == pytest.approx(0.0, abs=1e-14)
    assert v[0] == 1.0


def small():
    _, ops = operators(2, 12, 2.1)
    matrix = assemble(ops.start, ops.column, ops.lap, 100.0, 1.0)
    return matrix, np.random.default_rng(0).normal(size=ops.n)


def test_report_zero_right_hand_side():
    matrix, rhs = small()
    q, report = gmres(matrix.dot, 0.0 * rhs, lambda v: v, 1e-8, 20, 100)
    assert report.converged and report.iterations == 0 and report.residual == 0.0
    assert report.reason == "zero right-hand side" and np.array_equal(q, 0.0 * rhs)


def test_report_converged():
    matrix, rhs = small()
    seen = []
    q, report = gmres(
        matrix.dot, rhs, cycle(hierarchy(matrix)), 1e-8, 20, 100, watch=lambda *a: seen.append(a)
    )
    assert report.reason == "converged" and report.converged
    true = np.linalg.norm(rhs - matrix @ q) / np.linalg.norm(rhs)
    assert report.residual == pytest.approx(true, rel=1e-6) and true <= 1e-8
    assert [k for k, _ in seen] == list(range(1, report.iterations + 1))
    again, second = gmres(matrix.dot, rhs, cycle(hierarchy(matrix)), 1e-8, 20, 100, start=q)
    assert second.converged and second.iterations <= 1
    np.testing.assert_allclose(again, q, rtol=1e-6, atol=1e-8 * np.abs(q).max())


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_tolerance_is_relative(scale):
    matrix, rhs = small()
    one = gmres(matrix.dot, rhs, lambda v: v, 1e-6, 20, 400)
    other = gmres(matrix.dot, rhs * scale, lambda v: v, 1e-6, 20, 400)
    assert one[1].converged and other[1].converged and one[1].iterations == other[1].iterations
    np.testing.assert_allclose(other[0] / scale, one[0], rtol=1e-9)


def test_report_out_of_iterations():
    matrix, rhs = small()
    q, report = gmres(matrix.dot, rhs, lambda v: v, 1e-12, 3, 6)
    assert not report.converged and report.reason == "out of iterations" and 0 < report.iterations <= 6
    assert report.residual > 1e-12 and np.isfinite(q).all()
    message = str(SolveError("Poisson", report))
    assert "Poisson" in message and "out of iterations" in message and "max_iterations" in message


@pytest.mark.parametrize("where", ["rhs", "matrix", "preconditioner"])
def test_report_not_finite(where):
    matrix, rhs = small()
    bad = rhs.copy()
    bad[5] = np.nan
    apply = (lambda v: matrix @ v + bad) if where == "matrix" else matrix.dot
    precondition = (lambda v: v + bad) if where == "preconditioner" else (lambda v: v)
    _, report = gmres(apply, bad if where == "rhs" else rhs, precondition, 1e-8, 10, 20)
    assert not report.converged and report.reason == "not finite"
