"""Assembled matrices are the operators."""

import numpy as np

from isphcli.operators.apply import laplacian
from isphcli.operators.assemble import assemble, assemble_near, row_sums
from tests.solvers.systems import operators


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


def test_far_pairs_are_left_out():
    """Those below a part of a row's sum, judged by other weights than those that are put in; constants stay zero."""
    _, ops = operators(3, 6, 2.1)
    sizes = np.random.default_rng(0).random(len(ops.column))
    matrix = assemble_near(ops.start, ops.column, ops.lap, sizes, 0.02)
    row = np.repeat(np.arange(ops.n), np.diff(ops.start))
    near = sizes >= 0.02 * np.bincount(row, sizes)[row]
    assert 0.2 < near.mean() < 0.8
    expected = np.zeros((ops.n, ops.n))
    np.add.at(expected, (row[near], ops.column[near]), -ops.lap[near])
    np.add.at(expected, (row[near], row[near]), ops.lap[near])
    np.testing.assert_allclose(matrix.toarray(), expected, atol=1e-12 * np.abs(expected).max())
    assert np.abs(matrix @ np.ones(ops.n)).max() < 1e-12 * np.abs(expected).max()


def test_row_sums_with_empty_rows():
    start = np.array([0, 0, 2, 2, 5, 5])
    assert row_sums(start, np.array([1.0, 2.0, 3.0, 4.0, 5.0])).tolist() == [0.0, 3.0, 0.0, 12.0, 0.0]
