"""The fit to phi: planes, spheres, two interfaces, and slopes at walls."""

import os
import subprocess
import sys

import numpy as np
import pytest

from isphcli.two_phase.quadratic_fit import SlopesAtWalls, no_slopes, own_gradient, quadratic_fit
from tests.operators.clouds import jittered, neighbours_of

SPACING = {2: 1 / 32, 3: 1 / 16}


def cloud(dim):
    """Neighbours of jittered particles in a periodic unit box."""
    return neighbours_of(jittered(dim, round(1 / SPACING[dim])), 2.8 * SPACING[dim])


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_plane_is_its_own_fit(dim):
    """Whatever the arrangement; the ridge of 1e-6 is what is left."""
    neighbours = cloud(dim)
    x = neighbours.x[: neighbours.n]
    g = 0.8 * unit(np.random.default_rng(1).normal(size=dim))
    middle, everywhere = np.all(np.abs(x - 0.5) < 0.2, axis=1), np.ones(neighbours.n, np.bool_)
    slopes = np.tile(g, (neighbours.n, 1))
    fit = quadratic_fit(neighbours, x @ g, everywhere, middle, slopes, SPACING[dim], no_slopes(neighbours.n, dim))
    assert np.abs(fit.value - x @ g)[middle].max() < 1e-8 and np.abs(fit.slope - g)[middle].max() < 1e-6
    assert np.abs(fit.curvature[middle]).max() < 1e-6 / SPACING[dim]
    assert not fit.slope[~middle].any() and np.array_equal(fit.value[~middle], (x @ g)[~middle])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("inside", [1, -1])
@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("axes", [2, 3])
def test_curvature_is_that_of_the_surface_not_of_the_level(dim, inside, half, axes):
    """Of circles, spheres and cylinders of radius 0.4, 13 spacings (6 in 3D): 1 / 0.4 of each curved direction at any
    distance from them, and the distance its own fit. Also where half of the neighbours are out of sight, as beside a
    wall. What is left is twice what terms of fifth order leave; the quadratic function alone is 2 to 20 times worse."""
    if axes > dim:
        pytest.skip("no sphere in the plane")
    neighbours = cloud(dim)
    x = neighbours.x[: neighbours.n]
    centre = np.full(dim, 0.5) + np.eye(dim)[0] * 0.4
    arm = (x - centre)[:, :axes]
    phi = inside * (0.4 - np.linalg.norm(arm, axis=1))
    gradient = np.zeros((neighbours.n, dim))
    gradient[:, :axes] = -inside * unit(arm)
    seen = (x[:, 1] > 0.5) if half else np.ones(neighbours.n, np.bool_)
    wanted = np.all(np.abs(x - 0.5) < 0.1, axis=1) & seen
    fit = quadratic_fit(neighbours, phi, seen, wanted, gradient, SPACING[dim], no_slopes(neighbours.n, dim))
    rel = {(2, False): 5e-4, (2, True): 6e-3, (3, False): 5e-3, (3, True): 0.02}[dim, half]
    assert fit.curvature[wanted] == pytest.approx(inside * (axes - 1) / 0.4, rel=rel)
    assert np.abs(fit.value - phi)[wanted].max() < (5e-4 if half else 1e-4) * SPACING[dim]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_distance_is_fitted_to_its_own_interface(dim):
    """Between two planes three spacings apart the distance has an edge: the fit does not see it, and gradients that are
    taken across it, turned by it, become whole again."""
    neighbours = cloud(dim)
    x = neighbours.x[: neighbours.n]
    phi = np.abs(x[:, 0] - 0.5) - 1.5 * SPACING[dim]
    side = np.sign(x[:, 0] - 0.5)
    known, exact = np.abs(phi) < 5.0 * SPACING[dim], np.zeros((neighbours.n, dim))
    exact[:, 0] = side
    off = np.abs(x[:, 0] - 0.5) / SPACING[dim]
    rough = exact * np.clip(0.3 + 0.5 * off, 0.0, 1.0)[:, None]
    near = known & (off > 0.3) & (off < 3.0) & np.all(np.abs(x - 0.5) < 0.3, axis=1)
    gradient = own_gradient(neighbours, phi, known, rough, SPACING[dim])
    assert np.abs(gradient - exact)[near].max() < 0.01
    fit = quadratic_fit(neighbours, phi, known, near, gradient, SPACING[dim], no_slopes(neighbours.n, dim))
    assert np.abs(fit.slope - exact)[near].max() < 0.01
    assert np.abs(fit.value - phi)[near].max() < 0.01 * SPACING[dim]
    across = quadratic_fit(neighbours, phi, known, near, np.tile(np.eye(dim)[0], (neighbours.n, 1)), SPACING[dim],
                           no_slopes(neighbours.n, dim))
    assert np.abs(across.slope - exact)[near].max() > 0.3


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
    phi, gradient = x[:, 0].copy(), np.tile([1.0, 0.0], (neighbours.n, 1))
    fit = quadratic_fit(neighbours, phi, above, above, gradient, SPACING[2], walls)
    assert fit.slope[beside, 1] == pytest.approx(0.3, abs=0.05)
    far = above & (x[:, 1] > 0.6) & np.all(np.abs(x - 0.5) < 0.25, axis=1)
    assert np.abs(fit.slope[far] - [1.0, 0.0]).max() < 1e-4


FIT = """
import hashlib
import numpy as np
from tests.two_phase.test_quadratic_fit import SPACING, cloud, no_slopes, quadratic_fit, unit
neighbours = cloud(2)
arm = neighbours.x[: neighbours.n] - 0.4
everywhere = np.ones(neighbours.n, np.bool_)
fit = quadratic_fit(neighbours, 0.3 - np.linalg.norm(arm, axis=1), everywhere, everywhere, -unit(arm), SPACING[2],
                    no_slopes(neighbours.n, 2))
print(hashlib.sha256(fit.curvature.tobytes() + fit.value.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_kernels_that_are_compiled_and_kernels_from_the_cache_give_the_same_bits(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (subprocess.run([sys.executable, "-c", FIT], env=environment, capture_output=True, text=True,
                                    check=True).stdout for _ in range(2))
    assert first == second and len(first.strip()) == 64
