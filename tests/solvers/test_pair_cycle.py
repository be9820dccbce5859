"""A cycle whose finest matrix is not stored is the cycle of that matrix."""

import numpy as np
import pytest

from isphcli.domain.row_threads import BLOCKS
from isphcli.operators.conductances import Conductances
from isphcli.solvers import multigrid, pair_cycle
from tests.operators.test_lattice_weights import SPACING, both
from tests.threads import on_threads


def conductances():
    rows = both(3, 0.0)[1]
    return Conductances(rows, 1.0 + np.random.default_rng(0).random(rows.n), SPACING)


@pytest.mark.parametrize("rows", [20, multigrid.ROWS])
def test_it_is_the_cycle_of_the_matrix(monkeypatch, rows):
    """By kernels, whose coarse entries are in single precision, and by PyAMG's sweeps."""
    monkeypatch.setattr(pair_cycle, "SLAB", 300)  # several slabs make one coarse matrix
    monkeypatch.setattr(pair_cycle, "COARSE_STRENGTH", multigrid.STRENGTH)
    monkeypatch.setattr(multigrid, "MAX_COARSE", 20)
    for module in (multigrid, pair_cycle):
        monkeypatch.setattr(module, "ROWS", rows)
    monkeypatch.setattr(multigrid, "COARSE_ROWS", rows)
    matrix = conductances()
    b = np.random.default_rng(1).standard_normal(matrix.n)
    b -= b.mean()
    expected, found = multigrid.cycle(multigrid.hierarchy(matrix.tocsr()))(b), pair_cycle.PairCycle(matrix)(b)
    # constants are divided by GROUND, 1e-6, their round-off too
    expected, found = expected - expected.mean(), found - found.mean()
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_the_bits_of_blocks_do_not_depend_on_the_threads(monkeypatch):
    """And it reduces a residual as a cycle does: to less than a third."""
    monkeypatch.setattr(multigrid, "ROWS", 20)
    monkeypatch.setattr(pair_cycle, "ROWS", 20)
    matrix = conductances()
    b = np.random.default_rng(3).standard_normal(matrix.n)
    b -= b.mean()

    def cycled():
        cycle = pair_cycle.PairCycle(matrix)
        assert len(cycle.blocks) == BLOCKS + 1
        return cycle(b)

    first, *others = on_threads(monkeypatch, cycled)
    assert all(np.array_equal(first, other) for other in others)
    assert np.linalg.norm(b - matrix.tocsr() @ first) < np.linalg.norm(b) / 3
