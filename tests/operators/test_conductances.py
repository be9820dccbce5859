"""The matrix of the conductances: its rows; its strong pairs, prolongation and sweeps are those of PyAMG."""

import numpy as np
import pytest
from pyamg.aggregation import standard_aggregation
from pyamg.aggregation.smooth import jacobi_prolongation_smoother
from pyamg.aggregation.tentative import fit_candidates
from pyamg.relaxation.relaxation import gauss_seidel
from pyamg.strength import symmetric_strength_of_connection

from isphcli.domain.components import pair_components
from isphcli.domain.null_space import GROUND
from isphcli.operators.conductances import Conductances, sparse_pairs
from isphcli.operators.lattice_weights import nearest_weights, symmetric_laplacian
from tests.operators.test_lattice_weights import SPACING, both
from tests.threads import on_threads

THRESHOLD = 0.05


@pytest.fixture(scope="module")
def matrix():
    rows = both(3, 0.0)[1]
    return Conductances(rows, 1.0 + np.random.default_rng(0).random(rows.n), SPACING)


def test_of_a_constant_they_are_the_symmetric_laplacian():
    rows = both(3, 0.0)[1]
    p = np.random.default_rng(0).standard_normal(rows.n)
    conductance = Conductances(rows, np.full(rows.n, 2.0), SPACING).tocsr()
    expected = -2.0 * SPACING**2 * symmetric_laplacian(rows, p)
    ground = GROUND * conductance.diagonal() / (1 + GROUND)
    np.testing.assert_allclose(conductance @ p - ground * p, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["cubic", "bcc"])
def test_sparse_pairs_give_the_laplacian_of_a_quadratic_function(kind):
    """2 dim where all nearest neighbours are in sight, and the box does not close on itself; to round-off."""
    ops, rows = both(3, 0.0, kind=kind)
    few = sparse_pairs(rows, SPACING)
    nearest = 6 if kind == "cubic" else 8
    x = ops.neighbours.x[: ops.n]
    inner = (np.diff(few.start) == nearest) & np.all(np.abs(x - 0.5) < 0.4, axis=1)
    assert inner.any() and np.diff(few.start).max() == nearest
    np.testing.assert_allclose(symmetric_laplacian(few, (x**2).sum(axis=1))[inner], 6.0, atol=1e-10)


def test_sparse_pairs_join_what_all_pairs_join():
    """Between spheres that overlap, on a body-centred lattice: nearest neighbours alone leave pockets apart."""
    rows = both(3, 0.0, radius=0.6, kind="bcc", centre=0.52)[1]
    few, near = sparse_pairs(rows, SPACING), (nearest_weights(rows, SPACING) > 0.0)[rows.pairs.offset_id]
    count, labels = pair_components(rows.start, rows.column)
    assert pair_components(rows.start, rows.column, near)[0] > count
    joined, found = pair_components(few.start, few.column)
    assert joined == count and np.array_equal(found, labels)
    assert near.sum() < len(few.column) < 0.2 * len(rows.column)


def test_rows_are_those_of_the_whole_matrix(matrix):
    whole = matrix.tocsr()
    assert abs(whole - whole.T).max() < 1e-12 * abs(whole).max()
    assert abs(matrix.rows(100, 300) - whole[100:300]).max() == 0.0
    np.testing.assert_allclose(matrix.diagonal, whole.diagonal(), rtol=1e-15)


def test_strong_pairs_and_prolongation(matrix):
    whole = matrix.tocsr()
    strength = symmetric_strength_of_connection(whole, THRESHOLD)
    strength.sort_indices()
    strong = matrix.strong(THRESHOLD)
    assert np.array_equal(strong.indptr, strength.indptr) and np.array_equal(strong.indices, strength.indices)
    members, _ = standard_aggregation(strong)
    tentative, coarse = fit_candidates(members, np.ones((matrix.n, 1)))
    expected = jacobi_prolongation_smoother(whole.tobsr(blocksize=(1, 1)), tentative, strength, coarse, omega=1.1,
                                            filter_entries=True, weighting="local")
    aggregate = np.full(matrix.n, -1, np.int32)
    aggregate[np.diff(members.indptr) > 0] = members.indices
    found = matrix.smoothed(aggregate, np.bincount(members.indices), THRESHOLD, 1.1)
    np.testing.assert_allclose(found.toarray(), expected.toarray(), atol=1e-12)


def test_sweeps(matrix):
    """Of one block as PyAMG's; of several, what is left of the right-hand side is what it should be."""
    whole, b = matrix.tocsr(), np.random.default_rng(1).standard_normal(matrix.n)
    expected = np.zeros_like(b)
    gauss_seidel(whole, expected, b)
    x, rest = matrix.sweep_from_zero(np.array([0, matrix.n]), b)
    np.testing.assert_allclose(x, expected, atol=1e-12 * np.abs(x).max())
    np.testing.assert_allclose(rest, b - whole @ x, atol=1e-11 * np.abs(b).max())
    gauss_seidel(whole, expected, b, sweep="backward")
    matrix.sweep_back(np.array([0, matrix.n]), b, x)
    np.testing.assert_allclose(x, expected, atol=1e-12 * np.abs(x).max())
    blocks = np.linspace(0, matrix.n, 8).astype(np.int64)
    x, rest = matrix.sweep_from_zero(blocks, b)
    np.testing.assert_allclose(rest, b - whole @ x, atol=1e-11 * np.abs(b).max())


def test_bits_do_not_depend_on_the_threads(monkeypatch):
    rows = both(3, 0.0)[1]
    w, blocks = 1.0 + np.random.default_rng(2).random(rows.n), np.linspace(0, rows.n, 9).astype(np.int64)

    def results():
        matrix = Conductances(sparse_pairs(rows, SPACING), w, SPACING)
        x, rest = matrix.sweep_from_zero(blocks, w)
        matrix.sweep_back(blocks, w, x)
        return [matrix.tocsr().data, matrix.strong(THRESHOLD).indices, x, rest]

    first, *others = on_threads(monkeypatch, results)
    for other in others:
        assert all(np.array_equal(a, b) for a, b in zip(first, other))
