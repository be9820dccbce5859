"""Velocities that are linear on either side of an interface where the viscosity jumps, among jittered particles."""

import numpy as np
import pytest

from isphcli.flow.shifting import carry
from isphcli.two_phase.kink import Kink
from tests.two_phase.scenes import layers, scene


@pytest.mark.parametrize("ratio", [0.01, 100.0])
def test_a_velocity_with_a_kink_is_exact_on_either_side(ratio):
    """Shear stress and velocity go on over the interface, with a turning and a stretching of the whole: round-off.
    With the slopes of eq. 5 alone a shifted particle is off."""
    _, _, state, stepper, _ = scene(layers(1 / 12, mu=ratio).replace("spacing: ", "jitter: 0.2, spacing: "))
    config = stepper.configure(state.x, phi=state.phi)
    terms, above, n = config.terms, state.phi > 0.0, len(state.x)
    x, y = (state.x - (0.25, 0.5)).T
    # of the particles near the middle of the box, whose neighbours are no images
    inside = (np.abs(x) < 0.01 + 0.5 / 12) & (np.abs(y) < 2.0 / 12)
    shear = np.where(above, 1.0, 1.0 / ratio)  # fluid a has viscosity 1, fluid b `ratio`
    mean, turning, stretching = 0.7, 0.4, 0.3
    u = np.column_stack([mean + shear * y - turning * y + stretching * x, turning * x - stretching * y])
    assert (above & inside).any() and (~above & inside).any()
    scale = max(1.0, 1.0 / ratio)
    dr = np.random.default_rng(1).uniform(-0.01, 0.01, (n, 2))
    there = u + np.column_stack([shear * dr[:, 1] - turning * dr[:, 1] + stretching * dr[:, 0],
                                 turning * dr[:, 0] - stretching * dr[:, 1]])
    fields, there = np.concatenate([u, 2.0 * u], axis=1), np.concatenate([there, 2.0 * there], axis=1)
    moved = carry(config.ops, fields, dr, terms.smooth, terms.kink)
    assert np.abs(moved - there)[inside].max() < 1e-10 * scale
    assert np.abs(carry(config.ops, fields, dr, terms.smooth) - there)[inside].max() > 1e-3 * scale


def test_a_process_without_particles_has_no_slopes():
    none = np.empty((0, 3))
    assert Kink(none, none).one_sided(np.empty((0, 6, 3))).shape == (0, 6, 3)
