"""How thick a clear layer must be: creeping flow between two faces another way, its limits, and what is asked of it."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.ndimage import gaussian_filter

from isphcli.geometry.clear_layer import clear_voxels, nearness

N = 64  # cells of the faces below, in one period of cos(k y)
K = 2 * np.pi / N
WAVE = 0.3 * np.cos(K * (np.arange(N) + 0.5))


def least_dissipation(k, h, opposite):
    """Of flow w(z) cos(k y) between planes at a distance h through which it is cos(k y), over mu: the mean over y of
    2 w'^2 + (w'' / k + k w)^2 / 2, integrated, is least for creeping flow (Helmholtz). w: a polynomial with w' = 0 at
    the planes, s = 2 z / h."""
    s, weight = np.polynomial.legendre.leggauss(60)
    lift = Polynomial([0, 1.5, 0, -0.5] if opposite else [1.0])
    free = [Polynomial([1, 0, -1]) ** 2 * Polynomial([0] * j + [1]) for j in range(int(opposite), 16, 2)]

    def terms(w):
        w1, w2 = w.deriv()(s) * 2 / h, w.deriv(2)(s) * (2 / h) ** 2
        root = np.sqrt(weight * h / 2)
        return np.concatenate([np.sqrt(2) * w1 * root, (w2 / k + k * w(s)) * root / np.sqrt(2)])

    columns = np.stack([terms(w) for w in free], axis=1)
    left = terms(lift) - columns @ np.linalg.lstsq(columns, terms(lift), rcond=None)[0]
    return float(left @ left)


@pytest.mark.parametrize("h", [3.0, 20.0, 60.0])
def test_the_drop_between_near_faces_is_that_of_the_least_dissipation(h):
    """A power is a drop times U; far apart it is 2 k of a wave of amplitude 1."""
    for last, sign in ((1 + WAVE, -1), (1 - WAVE, 1)):
        found = nearness(1 + WAVE, last, (1.0,), (True,), h)
        known = sign * (least_dissipation(K, h, sign > 0) - 2 * K) * 0.3**2
        assert found == pytest.approx(known, rel=1e-5)


def test_near_faces_are_a_hele_shaw_cell_and_far_ones_do_not_matter():
    """A cell of thickness h has a drop of 12 mu / h^3 times the mean of |inverse gradient of the sources|^2."""
    thin = nearness(1 + WAVE, 1 - WAVE, (1.0,), (True,), 1e-2 / K)
    assert thin == pytest.approx(12 / (1e-2 / K) ** 3 * (2 * 0.3) ** 2 / 2 / K**2, rel=1e-3)
    assert nearness(1 + WAVE, 1 - WAVE, (1.0,), (True,), 40 / K) < 1e-12
    thickness = np.geomspace(1, 100, 20)
    fall = [nearness(1 + WAVE, 1 - WAVE / 2, (1.0,), (True,), h) for h in thickness]
    assert np.all(np.diff(fall) < 0)


def test_sealed_sides_are_mirrors():
    """A face between two walls, and the face with its mirror image that repeats; unequal cells."""
    rng = np.random.default_rng(0)
    first, last = rng.random((2, 6, 5))
    twice = [np.block([[v, v[:, ::-1]], [v[::-1], v[::-1, ::-1]]]) for v in (first, last)]
    between = nearness(first, last, (1.0, 0.7), (False, False), 2.0)
    assert between == pytest.approx(nearness(*twice, (1.0, 0.7), (True, True), 2.0), rel=1e-12)


def blobs(n, width, porosity, seed=3):
    """Fluid of an image of n^3 voxels cut out of a random field: its faces do not fit each other."""
    field = gaussian_filter(np.random.default_rng(seed).standard_normal((2 * n,) * 3), width, mode="wrap")[:n, :n, :n]
    return field > np.quantile(field, 1 - porosity)


def test_the_layer_grows_with_the_pores():
    """The same body in voxels half as wide has a layer of the same thickness, to a voxel and its rounding; voxels
    half as long along the flow the same; and nothing is asked for where nothing flows."""
    fluid = blobs(20, 2.0, 0.4)
    sealed = (False,) * 3
    thick = clear_voxels(fluid, 0, np.ones(3), sealed)
    assert 3 <= thick <= 19
    fine = clear_voxels(fluid.repeat(2, 0).repeat(2, 1).repeat(2, 2), 0, np.full(3, 0.5), sealed)
    assert abs(fine - 2 * thick) <= 2
    along = clear_voxels(fluid.repeat(2, 2), 0, np.array([0.5, 1.0, 1.0]), sealed)
    assert abs(along - 2 * thick) <= 2
    assert clear_voxels(fluid.transpose(2, 1, 0), 2, np.ones(3), sealed) == thick
    fluid[:, :, 10] = False
    assert clear_voxels(fluid, 0, np.ones(3), sealed) == 0


def test_slits_that_lead_straight_on_need_one_voxel():
    fluid = np.zeros((20, 20), bool)
    fluid[::4] = True
    assert clear_voxels(fluid, 0, np.ones(2), (False, False)) == 1
