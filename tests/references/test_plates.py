"""Flow between plates a second way: another formula, the equation it solves, a table, or a limit."""

import math

import numpy as np
import pytest
from scipy.integrate import simpson, trapezoid

from isphcli.references import plates, published

Y = np.linspace(0, 1, 2001)
DY = Y[1]


def second_derivative(f, h):
    return (f[2:] - 2 * f[1:-1] + f[:-2]) / h**2


@pytest.mark.parametrize("name", ["couette", "poiseuille"])
def test_startup_flows_against_the_tables(name):
    """The tables hold ten digits; Crank-Nicolson confirmed them to 1e-6 of the maximum."""
    columns = published.table(f"startup_{name}_morris")
    y = columns.pop("y_m")
    for key, expected in columns.items():
        t = float(key.removeprefix("u_t").removesuffix("s"))
        drive = 1.25e-5 if name == "couette" else 1e-4
        function = plates.startup_couette if name == "couette" else plates.startup_poiseuille
        assert np.allclose(function(y, t, 1e-3, 1e-6, drive), expected, rtol=1e-8, atol=1e-15)


def test_startup_begins_at_rest_and_ends_steady():
    inner = Y[100:-100]
    # 400 terms of a series that falls as 1/n: the ripple near the moving wall is 1/(400 pi 0.05)
    assert np.abs(plates.startup_couette(inner, 0.0, 1, 1, 1)).max() < 0.02
    assert np.abs(plates.startup_poiseuille(inner, 0.0, 1, 1, 1)).max() < 1e-6
    assert np.allclose(plates.startup_couette(Y, 9.0, 1, 1, 1), plates.plane_couette(Y, 1, 1))
    assert np.allclose(plates.startup_poiseuille(Y, 9.0, 1, 1, 1), plates.slit_poiseuille(Y, 1, 1, 1))
    assert math.isclose(simpson(plates.slit_poiseuille(Y, 1, 1, 1), dx=DY), plates.slit_permeability(1))


@pytest.mark.parametrize("mode", [1, 3])
def test_decaying_channel_solves_its_equation(mode):
    """u_t = nu u'' by differences, walls at rest, and a quarter of the start-up series by projection."""
    nu, t, dt = 0.7, 0.1, 1e-4
    u, later, before = (plates.decaying_channel(Y, time, 1.0, nu, 2.0, mode) for time in (t, t + dt, t - dt))
    residual = (later - before)[1:-1] / (2 * dt) - nu * second_derivative(u, DY)
    assert np.abs(residual).max() < 1e-3 * nu * np.abs(second_derivative(u, DY)).max()
    assert abs(u[0]) + abs(u[-1]) < 1e-12
    # what is left of the start-up of Poiseuille flow in this mode dies out in the same way
    left = plates.slit_poiseuille(Y, 1, 1, nu) - plates.startup_poiseuille(Y, t, 1, nu, 1)
    at_start = plates.slit_poiseuille(Y, 1, 1, nu)
    mine = [simpson(f * np.sin(mode * math.pi * Y), dx=DY) for f in (left, at_start)]
    assert math.isclose(mine[0] / mine[1], u[300] / plates.decaying_channel(Y, 0, 1, nu, 2.0, mode)[300], rel_tol=1e-6)


@pytest.mark.parametrize("omega", [0.01, 3.0, 400.0])
def test_oscillating_flows_solve_their_equation(omega):
    """du/dt = F cos(omega t) + nu u'' and the walls' velocity, by differences (second order, 2000 cells)."""
    nu, t, dt = 0.7, 0.4, 1e-4 / omega
    for function, force in ((plates.oscillating_slit, 1.0), (plates.oscillating_wall, 0.0)):
        u = function(Y, t, 1.0, nu, 1.0, omega)
        rate = (function(Y, t + dt, 1.0, nu, 1.0, omega) - function(Y, t - dt, 1.0, nu, 1.0, omega)) / (
            2 * dt
        )
        residual = rate[1:-1] - force * math.cos(omega * t) - nu * second_derivative(u, DY)
        assert np.abs(residual).max() < 1e-4 * max(1.0, omega)
        assert abs(u[0]) < 1e-12 and math.isclose(u[-1], (1 - force) * math.cos(omega * t), abs_tol=1e-12)
    slow = plates.oscillating_slit(Y, 0.0, 1.0, nu, 1.0, 1e-4)
    assert np.allclose(slow, plates.slit_poiseuille(Y, 1.0, 1.0, nu), rtol=1e-4, atol=1e-9)


def test_high_frequency_does_not_overflow():
    assert np.isfinite(plates.oscillating_slit(Y, 0.1, 1.0, 1e-9, 1.0, 1e3)).all()


def test_two_layers():
    u = plates.two_layer_couette(Y, 1.0, 0.4, (1.0, 10.0), 1.0)
    assert math.isclose(np.interp(0.4, Y, u), 0.86956522, rel_tol=1e-8)
    assert math.isclose(trapezoid(u, Y), 0.73478261, rel_tol=1e-7)
    u = plates.two_layer_poiseuille(Y, 1.0, 0.4, (1.0, 10.0), 2.0)
    below, above = Y[1:-1] < 0.3995, Y[1:-1] > 0.4005
    assert np.allclose(second_derivative(u, DY)[below], -2.0, atol=1e-6)
    assert np.allclose(second_derivative(u, DY)[above], -0.2, atol=1e-6)
    i = np.searchsorted(Y, 0.4)
    below, above = (3 * u[i] - 4 * u[i - 1] + u[i - 2]), (-3 * u[i] + 4 * u[i + 1] - u[i + 2])
    assert math.isclose(below, 10 * above, rel_tol=1e-6) and abs(u[0]) + abs(u[-1]) < 1e-15
    same = plates.two_layer_poiseuille(Y, 1.0, 0.3, (2.0, 2.0), 2.0)
    assert np.allclose(same, plates.slit_poiseuille(Y, 1.0, 2.0, 2.0))


def test_two_layers_with_a_force_each():
    """Finite volumes of the same problem, (mu u')' = -G: the mean of mu at each face is exact for layers."""
    n, mu, gradient = 500, (1.0, 10.0), (3.0, -1.0)
    y = (np.arange(n) + 0.5) / n
    low = y < 0.4
    resistance = 0.5 / n / np.where(low, mu[0], mu[1])
    face = 1 / (np.r_[0, resistance] + np.r_[resistance, 0])  # half cells on either side of a face
    matrix = np.diag(face[:-1] + face[1:]) - np.diag(face[1:-1], 1) - np.diag(face[1:-1], -1)
    expected = np.linalg.solve(matrix, np.where(low, *gradient) / n)
    u = plates.two_layer_poiseuille(y, 1.0, 0.4, mu, gradient)
    assert np.abs(u - expected).max() < 1e-4 * np.abs(u).max()


def test_two_layers_at_rest():
    """dp/dy = -rho g in each layer, and no jump between them."""
    y = np.array([0.0, 0.39, 0.4, 0.41, 1.0])
    p = plates.two_layer_hydrostatics(y, 0.4, (3.0, 2.0), 10.0)
    assert np.allclose(np.diff(p) / np.diff(y), [-30, -30, -20, -20]) and p[2] == 0


def test_oscillation_from_rest():
    """At rest at t = 0 within the 400 terms of the series; the difference to the periodic flow solves the equation of
    a decay; the mean is that of the profile by Simpson's rule."""
    args = (1.0, 1.0, 2.0, 25.0)
    assert np.abs(plates.oscillating_slit(Y, 0.0, *args, True)).max() < 1e-5 * 2 / 25
    for t in (0.01, 0.1):
        u = plates.oscillating_slit(Y, t, *args, True)
        assert math.isclose(simpson(u, dx=DY), plates.oscillating_slit_mean(t, *args, True), rel_tol=1e-5)
    dt, left = 1e-4, lambda t: plates.oscillating_slit(Y, t, *args) - plates.oscillating_slit(Y, t, *args, True)
    rate = (left(0.05 + dt) - left(0.05 - dt))[1:-1] / (2 * dt)
    assert np.abs(rate - second_derivative(left(0.05), DY)).max() < 1e-4 * np.abs(rate).max()
    assert np.allclose(plates.oscillating_slit(Y, 9.0, *args, True), plates.oscillating_slit(Y, 9.0, *args), atol=1e-12)


def test_means_of_a_slow_and_of_a_fast_oscillation():
    """Slow: that of the parabola, h^2 / 12 nu; fast: the force's own, whatever the walls."""
    assert plates.oscillating_slit_mean(0.0, 2.0, 0.5, 3.0, 1e-6) == pytest.approx(3 * 4 / 12 / 0.5, rel=1e-6)
    quarter = math.pi / 2 / 1e8
    assert plates.oscillating_slit_mean(quarter, 2.0, 0.5, 3.0, 1e8) == pytest.approx(3 / 1e8, rel=1e-3)


def test_imbibition_of_one_fluid_without_viscosity():
    """Bosanquet: d(rho l l') / dt = p, so that l = t sqrt(p / rho) from the entrance on."""
    t = np.linspace(0.5, 3.0, 6)
    slit = plates.SlitBetweenReservoirs(1.0, 1e3)
    way, velocity = plates.slit_imbibition(t, slit, 2.0, (1.0, 1e-9), (1e-9, 1e-18), 1e-6)
    assert np.allclose(way, t * math.sqrt(2.0), rtol=1e-4) and np.allclose(velocity, math.sqrt(2.0), rtol=1e-4)


@pytest.mark.slow
def test_imbibition_of_one_viscous_fluid():
    """Washburn: l^2 = p width^2 t / (6 mu)."""
    t = np.linspace(1e4, 4e5, 5)
    slit = plates.SlitBetweenReservoirs(0.1, 1e3)
    way, _ = plates.slit_imbibition(t, slit, 1.0, (1.0, 1e-9), (10.0, 1e-9), 1e-3)
    assert np.allclose(way**2, 0.01 * t / 60.0, rtol=1e-3)


def test_imbibition_of_like_fluids_starts_like_any_flow():
    """A pressure too small for momentum to matter; with reservoirs that hold as much again, half of it accelerates."""
    t, y = np.array([0.3, 1.0, 3.0]), np.linspace(0, 1, 4001)
    _, velocity = plates.slit_imbibition(t, plates.SlitBetweenReservoirs(1.0, 2.0), 1e-6, (1, 1), (0.1, 0.1), 0.5)
    expected = [plates.startup_poiseuille(y, at, 1.0, 0.1, 0.5e-6).mean() for at in t]
    assert np.allclose(velocity, expected, rtol=1e-3)  # of 60 cells over half of the slit
    slit = plates.SlitBetweenReservoirs(1.0, 2.0, 0.5, (1.0, 3.0))
    _, velocity = plates.slit_imbibition(np.array([1e-4]), slit, 1e-6, (1, 1), (0.1, 0.1), 0.5)
    assert velocity[0] == pytest.approx(1e-10 / 4.0, rel=0.02)  # less what the walls hold back in a layer of sqrt(nu t)
