"""The transposed stress: exact second derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.two_phase.transposed_stress import TransposedStress
from tests.two_phase.scenes import layers, scene


def test_the_stress_of_a_quadratic_velocity_is_exact():
    """Constant viscosity, any arrangement: 2 grad div u, which a linear part of the velocity is no part of."""
    _, _, state, stepper, _ = scene(layers(1 / 12, mu=2).replace("spacing: ", "jitter: 0.2, spacing: "))
    ops = stepper.configure(state.x, phi=state.phi).ops
    rows = np.flatnonzero(~ops.walls.near_wall & (np.abs(state.x[:, 0] - 3 / 12) < 0.5 / 12))
    transposed_stress = TransposedStress.build(ops, ops.lap, rows)
    (x, y), out = state.x.T, np.zeros_like(state.x)
    u = state.x @ np.array([[0.3, 2.0], [-1.0, -0.3]])
    u += np.stack([x * x - 3.0 * x * y, 0.5 * x * y + 2.0 * y * y], axis=1)
    transposed_stress.add(u, out, 1.0)
    assert len(rows) and np.abs(out[rows] - 2.0 * np.array([2.5, 1.0])).max() < 1e-9 * np.abs(ops.lap).max()


def test_what_neighbours_on_a_line_do_not_resolve_stays_bounded():
    """Second derivatives across a line of particles have no weights, those along it do."""
    _, _, state, stepper, _ = scene(layers(1 / 12, mu=2))
    ops = stepper.configure(state.x, phi=state.phi).ops
    row = np.flatnonzero(~ops.walls.near_wall)[7]
    i = np.repeat(np.arange(ops.n), np.diff(ops.start))
    beside = np.abs(ops.neighbours.x[ops.neighbours.row, 1] - state.x[i, 1]) < 1e-9  # of the same height
    lap = np.where(beside, ops.lap, 0.0)
    tensor = TransposedStress.build(replace(ops, lap=lap), lap, np.array([row])).tensor
    nobody = np.zeros(len(lap))
    lone = TransposedStress.build(replace(ops, lap=nobody), nobody, np.array([row])).tensor
    away = ops.neighbours.x[ops.neighbours.row, 0] - state.x[i, 0]
    mine = i == row
    assert tensor[:, 0] @ away[mine] ** 2 / 2 == pytest.approx(2.0)  # of x^2 / 2
    assert np.abs(tensor[:, 1:]).max() < 1e-6 * np.abs(tensor).max() and not lone.any()
