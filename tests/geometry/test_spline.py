"""Cubic splines of fields on voxel centres."""

import numpy as np
import pytest

from isphcli.geometry.spline import average, spline_coefficients, value_and_slope
from tests.geometry.fields import centres


def wave(x, n, k):
    return np.cos(2 * np.pi * k * x / n + 0.3), -2 * np.pi * k / n * np.sin(2 * np.pi * k * x / n + 0.3)


def of_waves(n):
    """Field cos x * cos 2y * cos z on n^3 periodic voxels, and its value and slope at points."""
    z, y, x = np.meshgrid(*centres((n,) * 3), indexing="ij")
    field = wave(x, n, 1)[0] * wave(y, n, 2)[0] * wave(z, n, 1)[0]

    def exact(u):
        (a, da), (b, db), (c, dc) = (wave(u[d], n, k) for d, k in enumerate((1, 2, 1)))
        return np.array([a * b * c, da * b * c, a * db * c, a * b * dc])

    return field, exact


def test_a_spline_passes_through_its_values():
    field, _ = of_waves(10)
    around = np.array([True, False, True])
    c = spline_coefficients(field, around)
    for z, y, x in ((0, 0, 0), (9, 9, 9), (4, 7, 2), (0, 9, 5)):
        assert value_and_slope(c, around, x + 0.5, y + 0.5, z + 0.5)[0] == pytest.approx(field[z, y, x], abs=1e-6)


def test_values_are_of_fourth_order_and_slopes_of_third():
    """Twice the voxels: errors fall by 16 and 8 (Unser 1999); 12 and 6 asked, for float32 and places at random."""
    points = np.random.default_rng(0).uniform(0, 1, (300, 3))
    errors = []
    for n in (16, 32):
        field, exact = of_waves(n)
        c, around = spline_coefficients(field, np.ones(3, bool)), np.ones(3, bool)
        found = np.array([value_and_slope(c, around, *(p * n)) for p in points])
        error = np.abs(found - np.array([exact(p * n) for p in points])) * [1, n, n, n]
        errors.append((error[:, 0].max(), error[:, 1:].max()))
    assert errors[0][0] / errors[1][0] > 12 and errors[0][1] / errors[1][1] > 6


def test_a_field_is_mirrored_at_faces_that_are_not_periodic():
    """Its slope across them is zero, so that a wall meets a sealed side at a right angle."""
    field = np.random.default_rng(1).standard_normal((6, 7, 8))
    around = np.array([False, True, False])
    c = spline_coefficients(field, around)
    for x in (0.0, 8.0):
        assert abs(value_and_slope(c, around, x, 3.3, 2.2)[1]) < 1e-6
    inside, outside = value_and_slope(c, around, 0.4, 3.3, 2.2), value_and_slope(c, around, -0.4, 3.3, 2.2)
    assert inside[0] == pytest.approx(outside[0]) and inside[1] == pytest.approx(-outside[1])


def test_an_image_of_one_layer_is_two_dimensional():
    field = np.random.default_rng(2).standard_normal((1, 6, 8))
    around = np.ones(3, bool)
    c = spline_coefficients(field, around)
    thick = spline_coefficients(np.repeat(field, 5, axis=0), around)
    flat, deep = value_and_slope(c, around, 2.7, 3.1, 0.5), value_and_slope(thick, around, 2.7, 3.1, 2.5)
    assert np.allclose(flat, deep, atol=1e-6)


@pytest.mark.parametrize("width", [0.5, 0.8])
def test_an_average_damps_a_wave_as_a_gaussian_does(width):
    """exp(-2 (pi q width)^2) for q waves a voxel; 3 % for the Gaussian that is sampled at the centres."""
    field = wave(np.arange(12)[None, None, :], 12, 2)[0].repeat(3, 0).repeat(3, 1)
    found = average(field, width, np.ones(3, bool))
    assert found / field == pytest.approx(np.exp(-2 * (np.pi * width / 6) ** 2), rel=0.03)
