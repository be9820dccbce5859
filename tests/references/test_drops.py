"""Drops and waves a second way: another formula, the equation it solves, a table, or a limit."""

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.interpolate import BSpline
from scipy.linalg import expm
from scipy.special import erfc, wofz

from isphcli.references import drops, published


@pytest.mark.parametrize("dim", [2, 3])
def test_laplace_jump_is_the_work_of_a_drop_that_grows(dim):
    """p dV = sigma dA."""
    radius = np.array([0.5, 0.5 + 1e-7])
    volume = math.pi * radius**2 if dim == 2 else 4 / 3 * math.pi * radius**3
    area = 2 * math.pi * radius if dim == 2 else 4 * math.pi * radius**2
    assert math.isclose(drops.laplace_jump(0.07, 0.5, dim), 0.07 * np.diff(area)[0] / np.diff(volume)[0], rel_tol=1e-6)


@pytest.mark.parametrize("angle", [30.0, 60.0, 90.0, 150.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_drop_on_wall_has_its_size(dim, angle):
    """Area or volume by integrating the cap over its height."""
    drop = drops.drop_on_wall(1.7, angle, dim)
    z = np.linspace(0, drop["height"], 400001)
    half = np.sqrt(np.maximum(drop["radius"] ** 2 - (z + drop["radius"] - drop["height"]) ** 2, 0))
    slices = 2 * half if dim == 2 else math.pi * half**2
    size = trapezoid(slices, z)
    assert math.isclose(size, 1.7, rel_tol=1e-6) and math.isclose(2 * half[0], drop["base"], rel_tol=1e-6)
    assert math.isclose(trapezoid(z * slices, z) / size, drop["centre"], rel_tol=1e-6)
    # the surface meets the wall at the angle: dz/dx = tan of what is left of it to 180 degrees
    slope = (z[1] - z[0]) / (half[1] - half[0]) if angle != 90.0 else math.inf
    assert angle == 90.0 or math.isclose(slope, -math.tan(math.radians(angle)), rel_tol=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_drop_that_touches_nothing(dim):
    """At 180 degrees the cap is the whole drop, at 90 half of one of twice the size."""
    radius = drops.drop_radius(1.7, dim)
    assert math.isclose((1, math.pi, 4 / 3 * math.pi)[dim - 1] * radius**dim, 1.7)
    assert drops.drop_on_wall(1.7, 180.0, dim) == pytest.approx(
        {"radius": radius, "height": 2 * radius, "base": 0.0, "centre": radius}
    )
    assert math.isclose(drops.drop_on_wall(1.7, 90.0, dim)["radius"], drops.drop_radius(3.4, dim))


def wave_of_like_fluids(t, tension, density, nu, start):
    """Prosperetti (1981), eqs 22 to 24: wavelength 1, deep fluids of one kinematic viscosity, no gravity."""
    (amplitude, speed), total, k = start, sum(density), 2 * math.pi
    beta = density[0] * density[1] / total**2
    omega2, v = tension * k**3 / total, nu * k**2
    last = (1 - 4 * beta) * v**2 + omega2
    z = np.roots([1, -4 * beta * v**0.5, 2 * (1 - 6 * beta) * v, 4 * (1 - 3 * beta) * v**1.5, last])
    a = 4 * (1 - 4 * beta) * v**2 / (8 * (1 - 4 * beta) * v**2 + omega2) * amplitude * erfc(np.sqrt(v * t)) + 0j
    for i in range(4):
        part = z[i] / np.prod(np.delete(z, i) - z[i]) * (omega2 * amplitude / (z[i] ** 2 - v) - speed)
        # exp((z^2 - v) t) erfc(z sqrt t) = exp(-v t) w(i z sqrt t), which does not overflow
        a += part * np.exp(-v * t) * wofz(1j * z[i] * np.sqrt(t))
    return a.real


def layers_of(density, nu):
    return [drops.Layer(rho, nu * rho) for rho in density]


@pytest.mark.parametrize("nu", [0.2, 0.02, 1e-4])
@pytest.mark.parametrize("density", [(1, 1), (3, 1), (1, 0.001)])
def test_capillary_wave_of_like_fluids(density, nu):
    """Closed form; 1e-10 is what the points of the contour leave, and more than round-off for 14 periods."""
    for start in ((1, 0), (1, 2)):
        for last in (0.6, 8.0):
            t = np.linspace(0.0, last, 100)
            a = drops.capillary_wave(t, 1.0, 1.0, layers_of(density, nu), start=start)
            assert np.abs(a - wave_of_like_fluids(t, 1.0, density, nu, start)).max() < 1e-10


def test_capillary_wave_against_the_table():
    columns = published.table("capillary_wave")
    tau, t, amplitude = columns.values()
    layers = layers_of((1.0, 1.0), 0.0182571749236)
    assert np.abs(drops.capillary_wave(t, 1.0, 1.0, layers) - amplitude).max() < 1e-6
    fine = np.linspace(0.0, 0.8, 20001)
    a = drops.capillary_wave(fine, 1.0, 1.0, layers)
    zero = fine[1:][np.diff(np.sign(a)) != 0] * tau[1] / t[1]
    assert np.allclose(zero, [1.787, 5.264, 8.709], atol=1e-3)


def test_capillary_wave_without_viscosity():
    """cos(omega t), omega^2 = (sigma k^3 + (rho1 - rho2) g k) / (rho1 coth(k h1) + rho2 coth(k h2))."""
    t = np.linspace(0, 1, 50)
    k = 2 * math.pi
    for depth in ((math.inf, math.inf), (0.1, 0.2), (math.inf, 0.05)):
        layers = [drops.Layer(rho, 1e-10 * rho, h) for rho, h in zip((3.0, 1.0), depth)]
        inertia = sum(layer.density / math.tanh(k * layer.depth) for layer in layers)
        omega = math.sqrt((0.5 * k**3 + (3 - 1) * 9.81 * k) / inertia)
        a = drops.capillary_wave(t, 1.0, 0.5, layers, gravity=9.81)
        assert np.abs(a - np.cos(omega * t)).max() < 1e-3


def spline_basis(breaks, kink):
    """Quadrature of cubic B-splines on `breaks`, of one derivative only at `kink`: x, weights, [B, B', B'']."""
    inner = np.sort(np.append(breaks[1:-1], [kink] * int(kink < breaks[-1])))  # a double knot
    knots = np.r_[[breaks[0]] * 4, inner, [breaks[-1]] * 4]
    nodes, weights = np.polynomial.legendre.leggauss(5)
    half, middle = np.diff(breaks) / 2, (breaks[1:] + breaks[:-1]) / 2
    x = (middle[:, None] + half[:, None] * nodes).ravel()
    spline = BSpline(knots, np.eye(len(knots) - 4), 3)
    at = [spline.derivative(k)(x) if k else spline(x) for k in range(3)]
    return x, (half[:, None] * weights).ravel(), at, spline(kink)


def gram(weight, left, right):
    return left.T @ (weight[:, None] * right)


def free_motion(mass, damping, stiffness, surface):
    """Matrix of d/dt (g, a): mass g' = -damping g - stiffness surface a, a' = surface . g."""
    n = len(mass)
    right = np.zeros((n + 1, n + 1))
    right[:n, :n], right[:n, n], right[n, :n] = -damping, -stiffness * surface, surface
    right[:n] = np.linalg.solve(mass, right[:n])
    return right


def wave_by_weak_form(times, tension, layers, amplitude, speed):
    """Height of the crest of a wave of wavelength 1 between two fluids, (density, mu, depth) each.

    Vertical velocity v(y) cos kx: kinetic energy rho (v^2 + v'^2 / k^2), dissipation
    mu (4 v'^2 + (v'' + k^2 v)^2 / k^2), work of the surface; the stress at the surface is natural.
    """
    k = 2 * math.pi
    (*below, deep), (*above, high) = layers
    breaks = np.r_[-np.geomspace(1e-4, deep, 90)[::-1], 0.0, np.geomspace(1e-4, high, 90)]
    y, weight, (b, b1, b2), at_surface = spline_basis(breaks, 0.0)
    rho, visc = (np.where(y < 0, *pair) for pair in zip(below, above))
    kept = slice(2, -2)  # at rest, with no slip, far away
    b, b1, b2, surface = b[:, kept], b1[:, kept], b2[:, kept], at_surface[kept]
    shear = b2 + k**2 * b
    mass = gram(weight * rho, b, b) + gram(weight * rho / k**2, b1, b1)
    damping = gram(4 * weight * visc, b1, b1) + gram(weight * visc / k**2, shear, shear)
    rate = free_motion(mass, damping, tension * k**2, surface)
    depth = np.where(y < 0, deep, high)
    start = np.linalg.lstsq(b, speed * np.sinh(k * (depth - np.abs(y))) / np.sinh(k * depth), rcond=None)[0]
    return [(expm(rate * t) @ np.append(start, amplitude))[-1] for t in times]


@pytest.mark.parametrize("layers, amplitude, speed", [
    (((1, 0.02, 4), (1, 0.02, 4)), 0, 3),
    (((3, 0.06, 4), (1, 0.02, 4)), 1, 2),
    (((1, 0.02, 4), (0.5, 0.002, 4)), 1, 2),
    (((0.001, 2e-4, 4), (1, 0.02, 4)), 0, 3),
    (((1, 0.02, 0.2), (0.5, 0.2, 0.1)), 1, 2),
])
def test_capillary_wave_by_the_weak_form(layers, amplitude, speed):
    t = np.array([0.05, 0.15, 0.3, 0.6])
    a = drops.capillary_wave(t, 1.0, 1.0, [drops.Layer(*layer) for layer in layers], start=(amplitude, speed))
    # what the splines leave over: with 180 of them in place of 90 it is less than a half
    assert np.abs(a - wave_by_weak_form(t, 1.0, layers, amplitude, speed)).max() < 5e-4


def drop_by_weak_form(tension, density, mu, n, wall):
    """Rates s (1/s) of a drop of radius 1 in a round wall; wall None: in vacuum. g e^(i n theta) as stream function."""
    outer = wall or 1.0
    near = np.geomspace(1e-3, 0.5, 25)
    breaks = np.r_[np.linspace(0.0, 0.5, 9), 1 - near, 1.0, 1 + near, np.linspace(1.5, max(outer, 1.5), 30)]
    breaks = np.unique(breaks[breaks <= outer])
    r, weight, (g, g1, g2), at_surface = spline_basis(breaks, 1.0)
    weight = weight * r
    inside = r < 1
    rho, visc = np.where(inside, *density), np.where(inside, *mu)
    kept = slice(2, -2 if wall else None)
    g, g1, g2, surface = g[:, kept], g1[:, kept], g2[:, kept], n * at_surface[kept]
    r = r[:, None]
    stretch, shear = g1 / r - g / r**2, g2 - g1 / r + n**2 * g / r**2
    mass = gram(weight * rho, n * g / r, n * g / r) + gram(weight * rho, g1, g1)
    damping = gram(4 * n**2 * weight * visc, stretch, stretch) + gram(weight * visc, shear, shear)
    rates = np.linalg.eigvals(free_motion(mass, damping, tension * (n**2 - 1), surface))
    return rates[rates.imag > 1e-9]


@pytest.mark.parametrize("mode", [2, 3])
@pytest.mark.parametrize(
    "density, mu, wall",
    [
        ((1.0, 0.0), (0.05, 0.0), None),
        ((1.0, 0.0), (0.3, 0.0), None),
        ((1.0, 1.0), (0.02, 0.02), 2.0),
        ((1.0, 0.1), (0.05, 0.005), 3.0),
        ((0.5, 1.0), (0.01, 0.1), 2.5),
    ],
)
def test_drop_oscillation_by_the_weak_form(density, mu, wall, mode):
    s = drops.drop_oscillation(1.0, 0.8, density, mu, mode, wall or math.inf)
    assert np.abs(drop_by_weak_form(0.8, density, mu, mode, wall) / s - 1).min() < 1e-3


def test_drop_oscillation_in_its_limits():
    """Inviscid frequencies; damping 2 n (n - 1) nu / R^2 in vacuum, Lamb's by dissipation; units; a far wall."""
    for n in (2, 3, 4):
        s = drops.drop_oscillation(2.0, 3.0, (5.0, 0.0), (1e-4, 0.0), n)
        assert math.isclose(s.imag, math.sqrt(n * (n**2 - 1) * 3.0 / (5.0 * 2.0**3)), rel_tol=1e-4)
        assert math.isclose(-s.real, 2 * n * (n - 1) * (1e-4 / 5) / 2.0**2, rel_tol=0.02)
    both = drops.drop_oscillation(1.0, 1.0, (1.0, 2.0), (1e-7, 1e-7))
    assert math.isclose(both.imag, math.sqrt(6 / 3), rel_tol=1e-3)
    s = drops.drop_oscillation(1.0, 1.0, (1.0, 1.0), (0.02, 0.05))
    assert abs(drops.drop_oscillation(1.0, 1.0, (1.0, 1.0), (0.02, 0.05), wall=40.0) / s - 1) < 1e-6
    micro = drops.drop_oscillation(1e-6, 1e-3, (1e3, 1e3), (0.02e-3, 0.05e-3))  # t = sqrt(rho R^3 / sigma) = 1e-6
    assert abs(micro * 1e-6 / s - 1) < 1e-9
    with pytest.raises(ValueError, match="does not oscillate"):
        drops.drop_oscillation(1.0, 1.0, (1.0, 0.0), (5.0, 0.0))
