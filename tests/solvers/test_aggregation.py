"""The set-up of hierarchies on all threads makes those of PyAMG."""

import numpy as np
import pytest

from isphcli.operators.assemble import assemble
from isphcli.solvers import multigrid
from tests.solvers.systems import operators
from tests.threads import on_threads


def matrix():
    """-lap of jittered particles in 3D; the first has no neighbours, and is in no aggregate."""
    _, ops = operators(3, 14, 2.1)
    found = assemble(ops.start, ops.column, ops.lap, 0.0, 1.0).tolil()
    found[0, :], found[:, 0], found[0, 0] = 0.0, 0.0, 1.0
    return found.tocsr()


@pytest.mark.parametrize("strength", [0.02, 0.1])
def test_hierarchies_are_those_of_pyamg(monkeypatch, strength):
    """Aggregates and the order of columns are the same, entries to round-off: the bound is on sums of some ten numbers
    of order one."""
    near_null = 1.0 + np.random.default_rng(5).random(14**3)
    assert_same(monkeypatch, matrix(), strength, near_null)


def test_a_vector_that_vanishes_on_a_whole_aggregate_leaves_no_entries_there(monkeypatch):
    """Two particles that see each other alone."""
    system, near_null = matrix().tolil(), np.ones(14**3)
    system[:2, :], system[:, :2], near_null[:2] = 0.0, 0.0, 0.0
    system[:2, :2] = [[2.0, -1.0], [-1.0, 2.0]]
    monkeypatch.setattr(multigrid, "IMPROVED", 0)
    assert_same(monkeypatch, system.tocsr(), 0.02, near_null)


def assert_same(monkeypatch, matrix, strength, near_null):
    expected = multigrid.hierarchy(matrix, strength, near_null)
    monkeypatch.setattr(multigrid, "COMPILED", 0)
    found = multigrid.hierarchy(matrix, strength, near_null)
    assert len(found.levels) == len(expected.levels) > 1
    for one, other in zip(found.levels, expected.levels):
        for part in "APR" if hasattr(other, "P") else "A":
            a, b = getattr(one, part), getattr(other, part)
            assert a.shape == b.shape and np.array_equal(a.indptr, b.indptr) and np.array_equal(a.indices, b.indices)
            np.testing.assert_allclose(a.data, b.data, rtol=0.0, atol=1e-14 * np.abs(b.data).max())


def test_the_bits_of_hierarchies_do_not_depend_on_the_threads(monkeypatch):
    monkeypatch.setattr(multigrid, "COMPILED", 0)
    first, *others = on_threads(monkeypatch, lambda: multigrid.hierarchy(matrix()).levels)
    for other in others:
        assert all(np.array_equal(a.A.data, b.A.data) for a, b in zip(first, other, strict=True))
