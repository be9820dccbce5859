"""Smoothing kernels: unit integral and slope, by quadrature that is exact for their polynomials."""

import numpy as np
import pytest

from isphcli.operators.kernel import KERNELS, normalisation, shape, slope

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)  # exact up to degree 19
# the quintic spline has knots at thirds of its support
PIECES = [(0.0, 1 / 3), (1 / 3, 2 / 3), (2 / 3, 1.0)]


def over_support(f):
    """Integral of f over 0 < q < 1."""
    return sum(
        (b - a) / 2 * sum(w * f((a + b) / 2 + (b - a) / 2 * t) for t, w in zip(NODES, WEIGHTS))
        for a, b in PIECES
    )


@pytest.mark.parametrize("kind", KERNELS.values(), ids=KERNELS)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("support", [1.0, 2.3e-6, 4e3])
def test_integral_is_one(kind, dim, support):
    sphere = 2 * np.pi if dim == 2 else 4 * np.pi
    integral = over_support(lambda q: sphere * q ** (dim - 1) * shape(kind, q)) * support**dim
    assert integral * normalisation(kind, support, dim) == pytest.approx(1.0, rel=1e-13)


@pytest.mark.parametrize("kind", KERNELS.values(), ids=KERNELS)
@pytest.mark.parametrize("dim", [2, 3])
def test_slope_integrates_to_minus_the_dimension(kind, dim):
    """Integration by parts: the integral of r W' is -dim for a kernel of unit integral."""
    sphere = 2 * np.pi if dim == 2 else 4 * np.pi
    integral = over_support(lambda q: sphere * q**dim * slope(kind, q)) * normalisation(kind, 1.0, dim)
    assert integral == pytest.approx(dim, rel=1e-13)


@pytest.mark.parametrize("kind", KERNELS.values(), ids=KERNELS)
def test_slope_is_minus_the_derivative(kind):
    step = 1e-5
    for q in np.linspace(0.01, 0.99, 50):
        difference = (shape(kind, q - step) - shape(kind, q + step)) / (2 * step)
        assert slope(kind, q) == pytest.approx(difference, rel=1e-6, abs=1e-6 * shape(kind, 0.0))
        assert slope(kind, q) > 0.0


@pytest.mark.parametrize("kind", KERNELS.values(), ids=KERNELS)
def test_ends(kind):
    """No slope at the centre, nothing from the support radius on, and continuous there."""
    assert slope(kind, 0.0) == pytest.approx(0.0, abs=1e-10)
    for q in (1.0, 1.0 + 1e-15, 3.0):
        assert shape(kind, q) == 0.0
        assert slope(kind, q) == 0.0
    assert 0.0 <= shape(kind, 1.0 - 1e-6) < 1e-10
