"""Ducts and annuli a second way: another formula, the equation it solves, a table, or a limit."""

import math

import numpy as np
import pytest
from scipy.integrate import simpson

from isphcli.references import ducts, plates


def test_square_duct():
    assert math.isclose(ducts.square_duct_flux(2.0, 1.0, 1.0), 0.56230806, rel_tol=1e-7)
    g = np.linspace(0, 1, 201)
    y, z = np.meshgrid(g, g, indexing="ij")
    u = ducts.square_duct(y.ravel(), z.ravel(), 1.0, 1.0, 1.0).reshape(201, 201)
    assert np.abs(u - u.T).max() < 2e-7  # the series treats y and z differently; its tail is 1e-7 at a wall
    assert max(np.abs(u[[0, -1]]).max(), np.abs(u[:, [0, -1]]).max()) < 2e-7
    assert math.isclose(
        simpson(simpson(u, dx=g[1]), dx=g[1]), ducts.square_duct_flux(1.0, 1.0, 1.0), rel_tol=1e-5
    )
    assert math.isclose(u[100, 100] / ducts.square_duct_flux(1.0, 1.0, 1.0), 2.096256, rel_tol=1e-5)


def test_permeability_of_ducts():
    """Of a square as by the other series; between plates with unequal slip by the parabola -y^2 / 2 + A (y + b); of a
    duct with a wide side that of plates less 0.63 of a width over the other (White, eq. 3-48)."""
    square = ducts.duct_permeability([2.0, 2.0], [(0.0, 0.0)] * 2)
    assert math.isclose(square, ducts.square_duct_flux(2.0, 1.0, 1.0) / 4, rel_tol=1e-7)
    h, b, c = 2.0, 0.2, 0.7
    slope = (h**2 / 2 + c * h) / (h + b + c)
    exact = -(h**2) / 6 + slope * (h / 2 + b)
    assert math.isclose(ducts.duct_permeability([h], [(b, c)]), exact, rel_tol=1e-8)
    assert math.isclose(ducts.duct_permeability([9.0, h], [None, (b, c)]), exact, rel_tol=1e-8)
    wide = ducts.duct_permeability([20.0, h], [(0.0, 0.0)] * 2)
    assert math.isclose(wide, plates.slit_permeability(h) * (1 - 0.630249 * h / 20), rel_tol=1e-6)
    assert math.isclose(ducts.duct_permeability([h], [(1e6, 1e6)]), h * 1e6 / 2, rel_tol=1e-5)
    assert ducts.duct_permeability([1.0, 2.0], [None, None]) == math.inf


def test_annulus():
    r = np.linspace(0.3, 1.0, 2001)
    u = ducts.annulus(r, 0.3, 1.0, 2.0, 0.5)
    assert abs(u[0]) + abs(u[-1]) < 1e-14
    assert math.isclose(simpson(2 * math.pi * r * u, x=r), ducts.annulus_flux(0.3, 1.0, 2.0, 0.5), rel_tol=1e-9)
    flux = np.diff(u) / np.diff(r) * (r[1:] + r[:-1]) / 2
    assert np.allclose(np.diff(flux) / np.diff(r[1:]) / r[1:-1], -4.0, rtol=1e-6)
    thin = ducts.annulus_flux(0.99, 1.01, 1.0, 1.0)
    assert math.isclose(thin, 2 * math.pi * 0.02 * plates.slit_permeability(0.02), rel_tol=1e-4)
    # the core slows the flow only by 1 / ln: the pipe is the limit
    assert math.isclose(ducts.annulus_flux(1e-30, 1.0, 1.0, 1.0), ducts.pipe_flux(1.0, 1.0, 1.0), rel_tol=0.04)


def test_taylor_couette():
    r = np.linspace(1.0, 2.0, 2001)
    u = ducts.taylor_couette(r, 1.0, 2.0, 3.0, -1.0)
    assert math.isclose(u[0], 3.0) and math.isclose(u[-1], -2.0)
    circulation = np.diff(r * u) / np.diff(r) / ((r[1:] + r[:-1]) / 2)  # curl: constant
    assert np.ptp(circulation) < 1e-9
    assert np.allclose(ducts.taylor_couette(r, 1.0, 2.0, 0.5, 0.5), 0.5 * r)


@pytest.mark.parametrize("omega", [0.3, 25.0, 2e4])
def test_an_oscillating_pipe_solves_its_equation(omega):
    """u_t = a cos(omega t) + nu (u'' + u' / r) by differences over 1e-4 of the radius, and rest at the wall."""
    r, h, t, dt = np.linspace(0.05, 0.95, 50), 1e-4, 0.7 / omega, 1e-4 / omega
    u = lambda r, t: ducts.oscillating_pipe(r, t, 1.0, 0.5, 2.0, omega)  # noqa: E731
    rate = (u(r, t + dt) - u(r, t - dt)) / (2 * dt)
    viscous = (u(r + h, t) - 2 * u(r, t) + u(r - h, t)) / h**2 + (u(r + h, t) - u(r - h, t)) / (2 * h * r)
    assert np.abs(rate - 2 * np.cos(omega * t) - 0.5 * viscous).max() < 2e-4
    assert abs(ducts.oscillating_pipe(np.array([1.0]), t, 1.0, 0.5, 2.0, omega)[0]) < 1e-12


@pytest.mark.slow
def test_an_oscillating_pipe_from_rest():
    """At rest at t = 0 within the 200 terms of a series that falls as n^-5/2, then the same as the periodic one;
    means by Simpson's rule."""
    r, args = np.linspace(0, 1, 2001), (1.0, 1.0, 2.0, 25.0)
    assert np.abs(ducts.oscillating_pipe(r, 0.0, *args, True)).max() < 1e-4 * 2 / 25
    for t in (0.0, 0.02, 0.2):
        for rest in (False, True):
            mean = simpson(2 * r * ducts.oscillating_pipe(r, t, *args, rest), dx=r[1])
            assert mean == pytest.approx(float(ducts.oscillating_pipe_mean(t, *args, rest)), abs=1e-6 * 2 / 25)
    late = [ducts.oscillating_pipe(r, 4.0, *args, rest) for rest in (False, True)]
    assert np.allclose(*late, atol=1e-11)


def test_a_slow_oscillation_is_that_of_hagen_and_poiseuille():
    mean = ducts.oscillating_pipe_mean(0.0, 0.5, 2.0, 3.0, 1e-6)
    assert mean * math.pi * 0.25 == pytest.approx(ducts.pipe_flux(0.5, 3.0, 2.0), rel=1e-6)
