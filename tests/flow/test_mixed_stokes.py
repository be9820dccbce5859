"""Flow of particles of two spacings: exact between plates, wherever the spacings meet."""

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from isphcli.case.load import read_case
from isphcli.domain.components import pair_components
from isphcli.domain.mixed_lattice import MixedLattice
from isphcli.flow.mixed_stokes import MixedStokes
from isphcli.operators.mixed_weights import build_mixed_operators
from isphcli.runs.half_in_throats import place_two
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import lattice_at
from isphcli.solvers.krylov import Limits
from tests.operators.test_mixed_weights import between_plates


@pytest.mark.slow
def test_plane_poiseuille_flow_is_exact():
    """A quadratic velocity and its pressure solve the discrete equations: what is left is the tolerance."""
    ops, faces, particles = between_plates(8)
    u, laplacian, convergence = MixedStokes(ops, faces, particles.spacings, particles.spacing).solve(
        np.array([1.0, 0.0, 0.0]), Limits(1e-9, 100, 400))
    y = particles.x[: ops.n, 1]
    assert convergence.converged and convergence.iterations < 60
    assert np.abs(u - np.outer(0.5 * y * (1.0 - y), [1, 0, 0])).max() < 1e-6 * 0.125
    assert np.abs(laplacian + [1.0, 0.0, 0.0]).max() < 1e-5


# Two channels along x whose cells touch over an edge, where the corners of the solid leave a gap
EDGE = """
geometry:
  box: [0.5, 1, 1]
  periodic: [x]
  shapes:
    - {box: {lower: [-1, -1, 0.53], upper: [2, 0.47, 2]}, is: solid}
    - {box: {lower: [-1, 0.53, -1], upper: [2, 2, 0.47]}, is: solid}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
"""


def test_pores_that_touch_over_an_edge():
    """They see each other, and share one mean of the pressure: the preconditioner has a way between their cells too."""
    case = read_case(EDGE.encode(), "case.yaml", ())
    geometry = build_geometry(case)
    lattice, support = lattice_at(case, geometry, 0.125), case.support * 0.125
    cut = np.argwhere(np.arange(lattice.counts[0])[:, None, None] * np.ones(lattice.counts) < 2)
    particles = place_two(geometry, MixedLattice(lattice, cut, support), 0.125, support)
    ops, faces = build_mixed_operators(geometry, particles, 0, support)
    ways = faces.conductance(np.ones(ops.n))
    assert abs(ways - ways.T).max() < 1e-12
    assert connected_components(ways)[0] == pair_components(ops.start, ops.column)[0] == 1
    _, _, convergence = MixedStokes(ops, faces, particles.spacings, 0.125).solve(
        np.array([1.0, 0.0, 0.0]), Limits(1e-6, 100, 400))
    assert convergence.iterations < 30  # measured 17
