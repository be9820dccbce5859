"""Components of the pressure: null vectors are found and taken out one by one."""

import numpy as np

from isphcli.domain.components import pair_components, parts_of
from isphcli.domain.null_space import ComponentMeans
from isphcli.operators.assemble import assemble
from tests.solvers.systems import operators, solve


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



def test_parts_of_some_particles():
    """Of a row of seven, without the third and without the link between the fifth and the sixth: three parts."""
    start = np.array([0, 1, 3, 5, 7, 9, 11, 12])
    column = np.array([1, 0, 2, 1, 3, 2, 4, 3, 5, 4, 6, 5], np.int32)
    inside = np.arange(7) != 2
    joined = ~np.isin(np.arange(12), [8, 9])
    count, part = parts_of(start, column, inside, joined)
    assert count == 3 and part.tolist() == [0, 0, -1, 1, 1, 2, 2]
    assert parts_of(start, column, np.zeros(7, bool))[0] == 0 and parts_of(start, column, np.ones(7, bool))[0] == 1
