"""Flow in ducts, pipes and between cylinders: analytic solutions, as pure functions of arrays and numbers.

Any consistent units. `nu` is the kinematic viscosity, `mu` the dynamic one, `acceleration` a body force per
mass, `gradient` a driving pressure gradient (force per volume) G = -dp/dx. Each function names its source; the test of
the file checks each a second way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .plates import cosh_ratio

Array = np.ndarray


def square_duct(y: Array, z: Array, side: float, gradient: float, mu: float, terms: int = 150) -> Array:
    """Steady axial velocity (n,) in a square duct, 0 <= y, z <= side.

    White, Viscous Fluid Flow, eq. 3-48 (series of cos cosh about the axis).
    """
    a = side / 2
    y, z = np.asarray(y, dtype=float) - a, np.asarray(z, dtype=float) - a
    series = np.zeros_like(y)
    for n in range(terms):
        k = (2 * n + 1) * math.pi / (2 * a)
        series += (-1) ** n / k**3 * np.cos(k * y) * cosh_ratio(k * z, k * a)
    return gradient / mu * ((a**2 - y**2) / 2 - 2 / a * series)


def duct_permeability(edges: Sequence[float], slip: Sequence[tuple[float, float] | None]) -> float:
    """Permeability of a clear duct, nu times its mean velocity over the acceleration, m2; inf without a wall.

    edges: of its cross section, m, one of a plane flow or two; slip: for each, the slip lengths of its two walls, m, or
    None where it is periodic. The velocity is the sum of products of the modes sin(k y + a) of either axis, which meet
    the walls' conditions where k h + atan(b k) + atan(c k) = n pi, b and c the slip lengths, tan a = b k; without slip
    it is that of White, Viscous Fluid Flow, eq. 3-48.
    """
    square, share = np.zeros(1), np.ones(1)
    for edge, walls in zip(edges, slip):
        if walls is not None:
            more, part = _duct_modes(edge, *walls)
            square, share = np.add.outer(square, more).ravel(), np.multiply.outer(share, part).ravel()
    return float(np.sum(share / square)) if square.any() else math.inf


def _duct_modes(edge: float, lower: float, upper: float, terms: int = 400) -> tuple[Array, Array]:
    """Squares (terms,) of the wave numbers between two walls with slip lengths, and the share of each mode in a
    constant."""
    n = np.arange(1.0, terms + 1)
    k = (n - 1) * math.pi / edge  # left of the roots of a concave function, so that Newton's steps stay there
    for _ in range(60):
        miss = k * edge + np.arctan(lower * k) + np.arctan(upper * k) - n * math.pi
        k = k - miss / (edge + lower / (1 + (lower * k) ** 2) + upper / (1 + (upper * k) ** 2))
    a, b = np.arctan(lower * k), np.arctan(upper * k)
    mean = (np.cos(a) - (-1) ** n * np.cos(b)) / k
    square = edge / 2 + (np.sin(2 * a) + np.sin(2 * b)) / (4 * k)
    return k**2, mean**2 / (square * edge)


def square_duct_flux(side: float, gradient: float, mu: float) -> float:
    """Volume flux through a square duct; Q mu / (G a^4) = 0.56230806 with a = side / 2. White, eq. 3-48."""
    n = 2.0 * np.arange(40) + 1
    series = np.sum(np.tanh(n * math.pi / 2) / n**5)
    return float(gradient * (side / 2) ** 4 / mu * 4 / 3 * (1 - 192 / math.pi**5 * series))


def annulus(r: Array, inner: float, outer: float, gradient: float, mu: float) -> Array:
    """Steady axial velocity (n,) between coaxial cylinders at rest. White, Viscous Fluid Flow, eq. 3-51."""
    r = np.asarray(r)
    log = np.log(outer / r) / math.log(outer / inner)
    return gradient / (4 * mu) * (outer**2 - r**2 - (outer**2 - inner**2) * log)


def annulus_flux(inner: float, outer: float, gradient: float, mu: float) -> float:
    """Volume flux through an annulus. White, Viscous Fluid Flow, eq. 3-52."""
    squares = outer**2 - inner**2
    return math.pi * gradient / (8 * mu) * (outer**4 - inner**4 - squares**2 / math.log(outer / inner))


def pipe_flux(radius: float, gradient: float, mu: float) -> float:
    """Volume flux through a round pipe (Hagen and Poiseuille)."""
    return math.pi * gradient * radius**4 / (8 * mu)


def oscillating_pipe(
    r: Array, t: float, radius: float, nu: float, acceleration: float, omega: float, from_rest: bool = False
) -> Array:
    """Axial velocity (n,) of the flow that acceleration * cos(omega t) drives in a pipe: periodic, or from rest.

    Womersley (1955), J. Physiol. 127, 553, eq. 8; from rest the modes J0(lambda r / radius), which decay, are
    subtracted with their amplitudes in the periodic flow at t = 0.
    """
    from scipy.special import jv, jve

    r = np.asarray(r, dtype=float)
    k = 1j**1.5 * np.sqrt(omega / nu)
    # jve = J exp(-|Im z|): nothing overflows
    ratio = jve(0, k * r) / jve(0, k * radius) * np.exp(abs(k.imag) * (r - radius))
    u = (acceleration / (1j * omega) * (1 - ratio) * np.exp(1j * omega * t)).real
    if from_rest:
        root, amount = _pipe_modes(radius, nu, acceleration, omega)
        u -= jv(0, np.multiply.outer(r / radius, root)) @ (amount * np.exp(-nu * (root / radius) ** 2 * t))
    return u


def oscillating_pipe_mean(
    t: Array, radius: float, nu: float, acceleration: float, omega: float, from_rest: bool = False
) -> Array:
    """Mean over the pipe of `oscillating_pipe` at times t (m,)."""
    from scipy.special import jv, jve

    t = np.asarray(t, dtype=float)
    z = 1j**1.5 * np.sqrt(omega / nu) * radius
    mean = acceleration / (1j * omega) * (1 - 2 * jve(1, z) / (z * jve(0, z)))
    u = (mean * np.exp(1j * omega * t)).real
    if from_rest:
        root, amount = _pipe_modes(radius, nu, acceleration, omega)
        u -= np.exp(-nu * np.multiply.outer(t, (root / radius) ** 2)) @ (amount * 2 * jv(1, root) / root)
    return u


def _pipe_modes(radius: float, nu: float, acceleration: float, omega: float, terms: int = 200) -> tuple[Array, Array]:
    """Zeros of J0, and the amplitude of the mode of each in the periodic flow at t = 0."""
    from scipy.special import jn_zeros, jv

    root = jn_zeros(0, terms)
    return root, (2 / (root * jv(1, root)) * acceleration / (1j * omega + nu * (root / radius) ** 2)).real


def taylor_couette(r: Array, inner: float, outer: float, omega_inner: float, omega_outer: float) -> Array:
    """Azimuthal velocity (n,) between cylinders that turn at omega (rad/s). White, section 3-2.3."""
    r = np.asarray(r)
    squares = outer**2 - inner**2
    a = (omega_outer * outer**2 - omega_inner * inner**2) / squares
    b = (omega_inner - omega_outer) * inner**2 * outer**2 / squares
    return a * r + b / r
