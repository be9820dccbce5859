"""Poisson on jittered particles: second order, and iterations that do not grow."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve_triangular

from isphcli.domain.components import pair_components
from isphcli.domain.null_space import ComponentMeans
from isphcli.domain.row_threads import BLOCKS
from isphcli.operators.assemble import assemble
from isphcli.solvers import multigrid
from isphcli.solvers.multigrid import hierarchy
from tests.solvers.systems import operators, solve
from tests.threads import on_threads


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


def test_a_hierarchy_does_not_depend_on_random_numbers():
    """Two runs agree bit for bit, whatever was drawn before; the caller's numbers are left as they are."""
    _, ops = operators(2, 32, 2.1)
    matrix, found, drawn = assemble(ops.start, ops.column, ops.lap, 0.0, 1.0), [], []
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002 - what a library would draw from
        found.append(hierarchy(matrix))
        drawn.append(np.random.rand())  # noqa: NPY002
        np.random.seed(seed)  # noqa: NPY002
        assert drawn[-1] == np.random.rand()  # noqa: NPY002
    for one, other in zip(found[0].levels, found[1].levels):
        assert np.array_equal(one.A.data, other.A.data)


def v_cycle(levels, k, b, edges):
    """Forward and backward sweeps of Gauss and Seidel inside blocks of rows, by triangular matrices."""
    if k + 1 == len(levels):
        return np.linalg.pinv(levels[k].A.toarray(), rcond=1e-9) @ b
    block = np.searchsorted(edges[k], np.arange(len(b)), side="right")
    inside = levels[k].A.tocoo()
    near = block[inside.row] == block[inside.col]
    inside = sp.csr_matrix((inside.data[near], (inside.row[near], inside.col[near])), inside.shape)
    x = spsolve_triangular(sp.tril(inside, format="csr"), b, lower=True)
    x += levels[k].P @ v_cycle(levels, k + 1, levels[k].R @ (b - levels[k].A @ x), edges)
    return x + spsolve_triangular(sp.triu(inside, format="csr"), b - levels[k].A @ x, lower=False)


def test_the_bits_of_block_cycles_do_not_depend_on_the_threads(monkeypatch):
    """So small blocks that there are many. Columns are those of a V-cycle by matrices, to the single precision of the
    cycle's."""
    monkeypatch.setattr(multigrid, "ROWS", 60)
    monkeypatch.setattr(multigrid, "COARSE_ROWS", 60)
    _, ops = operators(2, 64, 2.1)
    matrix = assemble(ops.start, ops.column, ops.lap, 100.0, 1.0)
    levels = hierarchy(matrix)
    cycle = multigrid.BlockCycle(levels)
    assert len(cycle.blocks[0]) == BLOCKS + 1
    b = np.random.default_rng(3).standard_normal((ops.n, 3))
    first, *others = on_threads(monkeypatch, lambda: cycle(b))
    assert all(np.array_equal(first, other) for other in others)
    expected = v_cycle(levels.levels, 0, b, cycle.blocks)
    np.testing.assert_allclose(first, expected, atol=1e-5 * np.abs(expected).max())


def test_sweeps_by_blocks_of_rows(monkeypatch):
    """Of the cycle of one right-hand side: the bits do not depend on the threads, and a cycle leaves as much of the
    right-hand side as PyAMG's sweeps through all rows do, within a fifth: of 1.6 layers a block."""
    _, ops = operators(2, 64, 2.1)
    matrix = assemble(ops.start, ops.column, ops.lap, 100.0, 1.0)
    levels, b = hierarchy(matrix), np.random.default_rng(4).standard_normal(ops.n)
    through = multigrid.cycle(levels)(b)
    monkeypatch.setattr(multigrid, "ROWS", 60)
    monkeypatch.setattr(multigrid, "COARSE_ROWS", 60)
    first, *others = on_threads(monkeypatch, lambda: multigrid.cycle(levels)(b))
    assert all(np.array_equal(first, other) for other in others)
    one, other = (np.linalg.norm(b - matrix @ x) for x in (through, first))
    assert 0.0 < abs(other - one) < 0.2 * one


def test_a_particle_that_bears_no_pressure_stays_without(monkeypatch):
    """A row of zeros, as of a particle that sees nobody: in large matrices too, which are swept through by blocks."""
    monkeypatch.setattr(multigrid, "ROWS", 60)
    _, ops = operators(2, 64, 2.1)
    matrix = assemble(ops.start, ops.column, ops.lap, 0.0, 1.0).tolil()
    matrix[7, :] = 0.0
    matrix[:, 7] = 0.0
    matrix = matrix.tocsr()
    matrix[7, 7] = 0.0
    matrix.setdiag(matrix.diagonal() - np.asarray(matrix.sum(axis=1)).ravel())
    right = np.random.default_rng(0).normal(size=ops.n)
    right[7] = 0.0
    found = multigrid.cycle(hierarchy(matrix))(right)
    assert np.isfinite(found).all() and found[7] == 0.0 and found.any()


def test_a_closed_pair_whose_constant_the_coarse_matrix_does_not_see(monkeypatch):
    """Its coarse row has no entries. Values there are right up to that constant, those elsewhere are as without it."""
    monkeypatch.setattr(multigrid, "ROWS", 60)
    monkeypatch.setattr(multigrid, "COARSE_ROWS", 20)
    _, ops = operators(2, 64, 2.1)
    alone = assemble(ops.start, ops.column, ops.lap, 100.0, 1.0)
    both = sp.block_diag([sp.csr_matrix([[1.0, -1.0], [-1.0, 1.0]]), alone], format="csr")
    right = np.random.default_rng(5).standard_normal(ops.n)
    found = multigrid.cycle(hierarchy(both))(np.concatenate([[1.0, -1.0], right]))
    assert found[0] - found[1] == pytest.approx(1.0, rel=1e-6)
    expected = multigrid.cycle(hierarchy(alone))(right)
    residuals = [np.linalg.norm(right - alone @ x) for x in (found[2:], expected)]
    assert residuals[0] == pytest.approx(residuals[1], rel=0.1) and residuals[1] < 0.5 * np.linalg.norm(right)
