"""GMRES and what it reports: converged, out of iterations, not finite."""

import numpy as np
import pytest

from isphcli.operators.assemble import assemble
from isphcli.solvers.krylov import Limits, SolveError, gmres
from isphcli.solvers.multigrid import cycle, hierarchy
from tests.solvers.systems import operators


def small():
    _, ops = operators(2, 12, 2.1)
    matrix = assemble(ops.start, ops.column, ops.lap, 100.0, 1.0)
    return matrix, np.random.default_rng(0).normal(size=ops.n)


def test_report_zero_right_hand_side():
    matrix, rhs = small()
    q, report = gmres(matrix.dot, 0.0 * rhs, lambda v: v, Limits(1e-8, 20, 100))
    assert report.converged and report.iterations == 0 and report.residual == 0.0
    assert report.reason == "zero right-hand side" and np.array_equal(q, 0.0 * rhs)


def test_report_converged():
    matrix, rhs = small()
    seen = []
    q, report = gmres(
        matrix.dot, rhs, cycle(hierarchy(matrix)), Limits(1e-8, 20, 100), watch=lambda *a: seen.append(a)
    )
    assert report.reason == "converged" and report.converged
    true = np.linalg.norm(rhs - matrix @ q) / np.linalg.norm(rhs)
    assert report.residual == pytest.approx(true, rel=1e-6) and true <= 1e-8
    assert [k for k, _ in seen] == list(range(1, report.iterations + 1))
    again, second = gmres(matrix.dot, rhs, cycle(hierarchy(matrix)), Limits(1e-8, 20, 100), start=q)
    assert second.converged and second.iterations <= 1
    np.testing.assert_allclose(again, q, rtol=1e-6, atol=1e-8 * np.abs(q).max())


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_tolerance_is_relative(scale):
    matrix, rhs = small()
    one = gmres(matrix.dot, rhs, lambda v: v, Limits(1e-6, 20, 400))
    other = gmres(matrix.dot, rhs * scale, lambda v: v, Limits(1e-6, 20, 400))
    assert one[1].converged and other[1].converged and one[1].iterations == other[1].iterations
    np.testing.assert_allclose(other[0] / scale, one[0], rtol=1e-9)


def test_report_out_of_iterations():
    matrix, rhs = small()
    q, report = gmres(matrix.dot, rhs, lambda v: v, Limits(1e-12, 3, 6))
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
    _, report = gmres(apply, bad if where == "rhs" else rhs, precondition, Limits(1e-8, 10, 20))
    assert not report.converged and report.reason == "not finite"


def test_a_space_that_is_not_enough_grows_on():
    """Rows weighed by 1 to 1e-4: the residual that is watched from the left is small long before the true one is. The
    space that is there then grows: one cycle an iteration and one of the first residual, however often the true one was
    looked at."""
    matrix, rhs = small()
    weight = 10.0 ** np.random.default_rng(1).uniform(-4.0, 0.0, len(rhs))
    products, cycles = [], []

    def apply(v):
        products.append(v)
        return matrix @ v

    def precondition(v):
        cycles.append(v)
        return weight * v

    q, report = gmres(apply, rhs, precondition, Limits(1e-10, 144, 144))
    assert report.converged and np.linalg.norm(rhs - matrix @ q) <= 1e-10 * np.linalg.norm(rhs)
    assert len(products) > report.iterations + 1 and len(cycles) == report.iterations + 1
