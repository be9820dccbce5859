"""The implicit viscosity (eq. 2): steps far beyond the explicit limit, and its order."""

import numpy as np
import pytest

from isphcli.flow.one_fluid import Terms, ViscousWeights
from isphcli.flow.viscous_solve import viscous_solve
from isphcli.operators.apply import laplacian
from isphcli.operators.fourth_order import laplacian_excess
from isphcli.output.clock import Clock
from isphcli.solvers.kept_hierarchies import KeptHierarchies
from tests.flow.runs import run
from tests.operators.clouds import build, jittered


def test_start_up_flow_with_steps_far_beyond_the_explicit_limit():
    """Start-up Couette flow with a step 100 times dx^2 / 8 nu: 2 % of the wall's speed is asked, 0.3 % measured."""
    state, *_ = run("""
geometry: {box: [0.125, 1], periodic: [x], walls: {y_max: {velocity: [1, 0]}}}
particles: {spacing: 0.03125}
fluids: {water: {density: 1, kinematic_viscosity: 1}}
time: {end: 0.0225, step: 0.0122}
""")
    n = np.arange(1, 200)
    y = state.x[:, 1:2]
    exact = y[:, 0] + (2 / np.pi * (-1.0) ** n / n * np.sin(n * np.pi * y) * np.exp(-(n * np.pi) ** 2 * 0.0225)).sum(1)
    assert np.abs(state.u[:, 0] - exact).max() < 0.02


@pytest.mark.parametrize(("dim", "support"), [(2, 2.3), (3, 2.1)])
def test_waves_are_damped_as_the_laplacian_of_fourth_order_damps_them(dim, support):
    """A plane wave of 16 spacings on a lattice, along an axis and along the diagonal: nu k^2 of one solve, by what it
    divides the wave by. Eq. 6 alone is 1.3 to 3.5 % off; 0.1 % is asked, 0.003 to 0.07 % measured."""
    n = 16
    x = jittered(dim, n, 0.0)
    ops, nu, rate = build(x, support / n), 1.0, float(n * n)
    terms = Terms(ops, ViscousWeights(nu, ops.lap, None), np.zeros(dim), excess=laplacian_excess(ops))
    solvers = KeptHierarchies(1e-12, 40, 200, Clock())
    for direction in (np.eye(dim)[0], np.ones(dim)):
        wave = np.cos(2 * np.pi * x @ direction)
        right = rate * np.stack([wave] * dim, axis=1)
        u = viscous_solve(terms, nu, 1 / n, rate, right, right / rate, solvers)
        found = rate * (1.0 / (u[:, 0] @ wave / (wave @ wave)) - 1.0)
        k2 = (2 * np.pi) ** 2 * (direction @ direction)
        plain = -(laplacian(ops, right)[:, 0] @ wave) / (right[:, 0] @ wave)
        assert abs(found / k2 - 1.0) < 0.001 < 0.012 < 1.0 - plain / k2


def test_excess_keeps_the_rows_of_the_solve_dominated_by_their_diagonals():
    """However close two particles are, c_i times the sum of a row stays below a half, where 1 + c L could vanish."""
    x = jittered(2, 12, 0.2)
    x = np.concatenate([x, x[[70]] + 1e-3 / 12])
    ops = build(x, 2.3 / 12)
    share = laplacian_excess(ops) * np.add.reduceat(np.abs(ops.lap), ops.start[:-1])
    assert 0.4 < share.max() < 0.5 and share.min() >= 0.0
    assert np.median(share) == pytest.approx(0.29, abs=0.03)  # that of the lattice
