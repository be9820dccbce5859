"""Flow of particles of two spacings: exact between plates, wherever the spacings meet."""

import numpy as np

from isphcli.flow.mixed_stokes import MixedStokes
from isphcli.solvers.krylov import Limits
from tests.operators.test_mixed_weights import between_plates


def test_plane_poiseuille_flow_is_exact():
    """A quadratic velocity and its pressure solve the discrete equations: what is left is the tolerance."""
    ops, faces, particles = between_plates(8)
    u, laplacian, convergence = MixedStokes(ops, faces, particles.spacings, particles.spacing).solve(
        np.array([1.0, 0.0, 0.0]), Limits(1e-9, 100, 400))
    y = particles.x[: ops.n, 1]
    assert convergence.converged and convergence.iterations < 60
    assert np.abs(u - np.outer(0.5 * y * (1.0 - y), [1, 0, 0])).max() < 1e-6 * 0.125
    assert np.abs(laplacian + [1.0, 0.0, 0.0]).max() < 1e-5
