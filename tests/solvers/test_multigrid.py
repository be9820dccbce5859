"""Poisson on jittered particles: second order, and iterations that do not grow."""

import numpy as np
import pytest

from isphcli.domain.components import ComponentMeans, pair_components
from isphcli.operators.assemble import assemble
from tests.solvers.systems import operators, solve


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


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [2.1, 2.5, 3.0])
@pytest.mark.parametrize(("dim", "sizes"), [(2, [32, 64, 128]), (3, [12, 16, 24, 32])])
def test_poisson_is_of_second_order_and_iterations_are_flat(dim, sizes, ratio):
    errors, iterations = zip(*[poisson(dim, n, ratio) for n in sizes])
    order = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert order >= 1.9, (errors, order)
    flat = np.array(iterations if dim == 2 else iterations[1:])  # 12^3 is a coarse grid already
    assert np.abs(flat / flat.mean() - 1).max() <= 0.2, iterations
