"""PETSc as the engine of one process: it solves what PyAMG and SciPy solve. With walls, see tests/test_ranks.py."""

import importlib.util
import os

import numpy as np
import pytest

from isphcli.domain.exchange import NO_EXCHANGE
from isphcli.operators.assemble import assemble
from isphcli.solvers.engine import ONE_PROCESS, engine_of
from isphcli.solvers.krylov import Limits, Maps
from tests.solvers.systems import operators

pytestmark = pytest.mark.skipif(importlib.util.find_spec("petsc4py") is None and "ISPH_REQUIRE_MPI" not in os.environ,
                                reason="petsc4py is not here: .ci/mpi")


def small():
    _, ops = operators(2, 24, 2.1)
    matrix = assemble(ops.start, ops.column, ops.lap, 100.0, 1.0)
    return matrix, np.random.default_rng(0).normal(size=ops.n)


def solved(engine, limits, how="gmres", **more):
    matrix, rhs = small()
    once = engine.cycle(matrix, NO_EXCHANGE)
    if how == "gmres":
        return engine.gmres(Maps(matrix.dot, once), rhs, limits, **more)
    return engine.gmres_of_step(matrix.dot, rhs, once, limits, **more)


def test_both_engines_solve_the_same_system():
    seen = []
    one, first = solved(ONE_PROCESS, Limits(1e-10, 50, 100))
    two, second = solved(engine_of("petsc"), Limits(1e-10, 50, 100), watch=lambda *a: seen.append(a))
    matrix, rhs = small()
    true = np.linalg.norm(rhs - matrix @ two) / np.linalg.norm(rhs)
    assert first.converged and second.converged and second.residual == pytest.approx(true, rel=1e-3)
    np.testing.assert_allclose(two, one, atol=1e-8 * np.abs(one).max())
    assert [k for k, _ in seen] == list(range(1, second.iterations + 1))
    assert second.iterations <= 2 * first.iterations
    three, third = solved(engine_of("petsc"), Limits(1e-10, 50, 100), "gmres_of_step")
    assert third.converged and np.linalg.norm(rhs - matrix @ three) <= 1.01e-10 * np.linalg.norm(rhs)
    np.testing.assert_allclose(three, one, atol=1e-8 * np.abs(one).max())


def test_without_hypre():
    """GAMG, of PETSc itself, is a preconditioner too: the wheels have no hypre."""
    from isphcli.solvers.petsc import GAMG

    engine = engine_of("petsc")
    engine.settings = GAMG
    matrix, rhs = small()
    x, report = solved(engine, Limits(1e-10, 50, 100))
    assert report.converged and report.iterations <= 25
    assert np.linalg.norm(rhs - matrix @ x) <= 1.01e-10 * np.linalg.norm(rhs)


def test_a_block_is_its_columns():
    """In 2D the third column is zero, and stays so."""
    matrix, rhs = small()
    engine = engine_of("petsc")
    once, block = engine.cycle(matrix, NO_EXCHANGE), engine.block_cycle(matrix, NO_EXCHANGE, 0.05)
    columns = np.stack([rhs, 2.0 * rhs[::-1], 0.0 * rhs], axis=1)
    np.testing.assert_allclose(block(columns), np.stack([once(c) for c in columns.T], axis=1), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("how", ["gmres", "gmres_of_step"])
def test_where_a_solve_ends(how):
    """Out of iterations, and started from a solution: restarts count all iterations."""
    engine = engine_of("petsc")
    x, short = solved(engine, Limits(1e-12, 2, 3), how)
    assert not short.converged and short.iterations == 3 and short.reason == "out of iterations"
    x, whole = solved(engine, Limits(1e-9, 3, 100), how, start=x)
    assert whole.converged
    again, none = solved(engine, Limits(1e-8, 3, 100), how, start=x)
    assert none.converged and none.iterations == 0 and np.array_equal(again, x)
