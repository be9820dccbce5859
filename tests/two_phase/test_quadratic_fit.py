"""The fit to phi: exact for quadratic functions, and for slopes at walls."""

import numpy as np
import pytest

from isphcli.two_phase.quadratic_fit import SlopesAtWalls, no_slopes, quadratic_fit
from tests.operators.clouds import build, jittered

SPACING = {2: 1 / 32, 3: 1 / 16}


def cloud(dim):
    """Neighbours of jittered particles in a periodic unit box."""
    return build(jittered(dim, round(1 / SPACING[dim])), 2.8 * SPACING[dim]).neighbours


@pytest.mark.parametrize("dim", [2, 3])
def test_a_quadratic_function_is_its_own_fit(dim):
    """Whatever the arrangement; the ridge of 1e-6 is what is left."""
    neighbours = cloud(dim)
    x = neighbours.x[: neighbours.n]
    rng = np.random.default_rng(1)
    g, h = rng.normal(size=dim), rng.normal(size=(dim, dim))
    h = h + h.T
    middle = np.all(np.abs(x - 0.5) < 0.2, axis=1)
    phi = x @ g + 0.5 * np.einsum("ij,jk,ik->i", x, h, x)
    everywhere = np.ones(neighbours.n, np.bool_)
    fit = quadratic_fit(neighbours, phi, everywhere, middle, no_slopes(neighbours.n, dim))
    assert np.abs(fit.value - phi)[middle].max() < 1e-5 * np.abs(phi).max()
    assert np.abs(fit.slope - g - x @ h)[middle].max() < 1e-4 * np.abs(g).max()
    assert not fit.slope[~middle].any() and np.array_equal(fit.value[~middle], phi[~middle])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("inside", [1, -1])
def test_curvature_is_that_of_the_surface_not_of_the_level(dim, inside):
    """Of a sphere of radius 0.4: (dim - 1) / 0.4 at any distance from it, as the fit is of third order to 1 %."""
    neighbours = cloud(dim)
    x = neighbours.x[: neighbours.n]
    centre = np.full(dim, 0.5) + np.eye(dim)[0] * 0.4
    phi = inside * (0.4 - np.linalg.norm(x - centre, axis=1))
    everywhere = np.ones(neighbours.n, np.bool_)
    wanted = np.all(np.abs(x - 0.5) < 0.1, axis=1)
    fit = quadratic_fit(neighbours, phi, everywhere, wanted, no_slopes(neighbours.n, dim))
    assert fit.curvature[wanted] == pytest.approx(inside * (dim - 1) / 0.4, rel=0.03)


def test_a_slope_at_a_wall_is_part_of_the_fit():
    """Particles above y = 0.5 alone see phi = x; the wall asks for a slope of 0.3: the fit beside it leans that way,
    and far from it knows nothing of it."""
    neighbours = cloud(2)
    x = neighbours.x[: neighbours.n]
    above = (x[:, 1] > 0.5) & np.all(np.abs(x - 0.5) < 0.4, axis=1)
    beside = np.flatnonzero(above & (x[:, 1] < 0.51))
    start = np.zeros(neighbours.n + 1, np.int64)
    start[beside + 1] = 1
    start = np.cumsum(start)
    offset = np.stack([np.zeros(len(beside)), 0.5 - x[beside, 1]], axis=1)
    walls = SlopesAtWalls(start, offset, np.tile([0.0, 1.0], (len(beside), 1)), np.full(len(beside), 0.3),
                          np.full(len(beside), 1e3))
    fit = quadratic_fit(neighbours, x[:, 0], above, above, walls)
    assert fit.slope[beside, 1] == pytest.approx(0.3, abs=0.05)
    far = above & (x[:, 1] > 0.6) & np.all(np.abs(x - 0.5) < 0.25, axis=1)
    assert np.abs(fit.slope[far] - [1.0, 0.0]).max() < 1e-4
