"""Flow between plates, of one fluid and of two layers: analytic solutions, as pure functions of arrays and numbers.

Any consistent units. `nu` is the kinematic viscosity, `mu` the dynamic one, `acceleration` a body force per
mass, `gradient` a driving pressure gradient (force per volume) G = -dp/dx. Each function names its source; the test of
the file checks each a second way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray


def plane_couette(y: Array, height: float, wall_velocity: float) -> Array:
    """Steady velocity (n,) between a wall at rest (y = 0) and one that moves (y = height)."""
    return wall_velocity * np.asarray(y) / height


def slit_poiseuille(y: Array, height: float, acceleration: float, nu: float) -> Array:
    """Steady velocity (n,) between walls at y = 0 and height, driven by `acceleration`."""
    y = np.asarray(y)
    return acceleration / (2 * nu) * y * (height - y)


def slit_permeability(height: float) -> float:
    """Permeability of a slit, height^2 / 12."""
    return height**2 / 12


def startup_couette(
    y: Array, t: float, height: float, nu: float, wall_velocity: float, terms: int = 400
) -> Array:
    """Velocity (n,) at time t after the wall at y = height began to move.

    Morris, Fox and Zhu (1997), J. Comput. Phys. 136, 214, their (22).
    """
    y = np.asarray(y, dtype=float)
    n = np.arange(1, terms + 1)
    decay = 2 / (n * math.pi) * (-1.0) ** n * np.exp(-nu * (n * math.pi / height) ** 2 * t)
    return wall_velocity * (y / height + _sine_sum(y, n * math.pi / height, decay))


def startup_poiseuille(
    y: Array, t: float, height: float, nu: float, acceleration: float, terms: int = 400
) -> Array:
    """Velocity (n,) at time t after `acceleration` began to act on fluid at rest in a slit.

    Morris, Fox and Zhu (1997), J. Comput. Phys. 136, 214, eq. 21.
    """
    y = np.asarray(y, dtype=float)
    n = 2 * np.arange(terms) + 1
    decay = 4 * acceleration * height**2 / (nu * math.pi**3 * n**3.0)
    decay = decay * np.exp(-nu * (n * math.pi / height) ** 2 * t)
    return slit_poiseuille(y, height, acceleration, nu) - _sine_sum(y, n * math.pi / height, decay)


def _sine_sum(y: Array, k: Array, c: Array) -> Array:
    """sum_n c_n sin(k_n y) over the terms that count, one at a time (no array of points by terms)."""
    total = np.zeros_like(y)
    for n in np.nonzero(np.abs(c) > 1e-18 * np.abs(c).max())[0]:
        total += c[n] * np.sin(k[n] * y)
    return total


def decaying_channel(y: Array, t: float, height: float, nu: float, speed: float, mode: int = 1) -> Array:
    """Velocity (n,) of the shear flow speed * sin(mode pi y / height) that decays between walls at rest.

    Each mode is an eigenfunction of u_t = nu u_yy: Morris, Fox and Zhu (1997), the terms of eqs 21 and 22.
    """
    k = mode * math.pi / height
    return speed * np.sin(k * np.asarray(y)) * math.exp(-nu * k**2 * t)


def oscillating_slit(
    y: Array, t: float, height: float, nu: float, acceleration: float, omega: float, from_rest: bool = False
) -> Array:
    """Velocity (n,) of the flow that acceleration * cos(omega t) drives in a slit: the periodic one, or from rest.

    Womersley's flow between plates: Landau and Lifshitz, Fluid Mechanics, section 24, problem 6. From rest the modes of
    the decaying channel are subtracted with their amplitudes in the periodic flow at t = 0.
    """
    k = np.sqrt(1j * omega / nu)
    middle = np.asarray(y) - height / 2
    wave = acceleration / (1j * omega) * (1 - cosh_ratio(k * middle, k * height / 2))
    u = (wave * np.exp(1j * omega * t)).real
    if from_rest:
        wave_number, amount = _odd_modes(height, nu, acceleration, omega)
        u -= _sine_sum(np.asarray(y, dtype=float), wave_number, amount * np.exp(-nu * wave_number**2 * t))
    return u


def oscillating_slit_mean(
    t: Array, height: float, nu: float, acceleration: float, omega: float, from_rest: bool = False
) -> Array:
    """Mean over the slit of `oscillating_slit` at times t (m,)."""
    t = np.asarray(t, dtype=float)
    half = np.sqrt(1j * omega / nu) * height / 2
    mean = (acceleration / (1j * omega) * (1 - np.tanh(half) / half) * np.exp(1j * omega * t)).real
    if from_rest:
        wave_number, amount = _odd_modes(height, nu, acceleration, omega)
        mean -= np.exp(-nu * np.multiply.outer(t, wave_number**2)) @ (amount * 2 / (wave_number * height))
    return mean


def _odd_modes(height: float, nu: float, acceleration: float, omega: float, terms: int = 400) -> tuple[Array, Array]:
    """Wave numbers k of the modes sin(k y) of a slit, and the amplitude of each in the periodic flow at t = 0."""
    n = 2 * np.arange(terms) + 1
    k = n * math.pi / height
    return k, (4 / (n * math.pi) * acceleration / (1j * omega + nu * k**2)).real


def oscillating_wall(
    y: Array, t: float, height: float, nu: float, wall_velocity: float, omega: float
) -> Array:
    """Velocity (n,) under a wall at y = height that moves with wall_velocity * cos(omega t); y = 0 at rest.

    Landau and Lifshitz, Fluid Mechanics, section 24, problem 1.
    """
    k = np.sqrt(1j * omega / nu)
    a, b = k * np.asarray(y), k * height
    wave = (np.exp(a - b) - np.exp(-a - b)) / (1 - np.exp(-2 * b))
    return wall_velocity * (wave * np.exp(1j * omega * t)).real


def cosh_ratio(a: complex | np.ndarray, b: complex | np.ndarray) -> np.ndarray:
    """cosh a / cosh b for |Re a| <= Re b, without overflow."""
    return (np.exp(a - b) + np.exp(-a - b)) / (1 + np.exp(-2 * b))


# -- two layers -----------------------------------------------------------------------------------------


def two_layer_couette(
    y: Array, height: float, interface: float, mu: Sequence[float], wall_velocity: float
) -> Array:
    """Steady velocity (n,) of two layers, mu[0] under `interface`, under a wall that moves at y = height.

    The shear stress is the same in both layers: tau = U / (h0 / mu0 + h1 / mu1).
    """
    y = np.asarray(y)
    stress = wall_velocity / (interface / mu[0] + (height - interface) / mu[1])
    return np.where(y < interface, stress * y / mu[0], wall_velocity - stress * (height - y) / mu[1])


def two_layer_poiseuille(
    y: Array, height: float, interface: float, mu: Sequence[float], gradient: float | Sequence[float]
) -> Array:
    """Steady velocity (n,) of two layers, mu[0] under `interface`, between walls at rest.

    gradient: driving force per volume, one number or one per layer (a body force on different densities).
    mu u' = c - G y in the lower layer, with u and the stress continuous at the interface (Bird, Stewart and
    Lightfoot, Transport Phenomena, section 2.5, there with one gradient and layers of equal height).
    """
    y = np.asarray(y)
    a, b = interface, height - interface
    g = np.broadcast_to(gradient, 2)
    c = (g[0] * a**2 / (2 * mu[0]) + (g[0] * a * b + g[1] * b**2 / 2) / mu[1]) / (a / mu[0] + b / mu[1])
    lower = (c * y - g[0] * y**2 / 2) / mu[0]
    upper = ((c - g[0] * a) * (y - height) - g[1] * ((y - a) ** 2 - b**2) / 2) / mu[1]
    return np.where(y < a, lower, upper)


def two_layer_hydrostatics(y: Array, interface: float, density: Sequence[float], gravity: float) -> Array:
    """Pressure (n,) of two layers at rest, zero at the interface; density (lower, upper), gravity down y."""
    depth = interface - np.asarray(y)
    return gravity * depth * np.where(depth > 0, density[0], density[1])


class SlitBetweenReservoirs(NamedTuple):
    """A slit that a fluid fills from one reservoir, while another leaves it to a second one.

    width, length: of the slit; narrowing: its width over that of the reservoirs, whose walls slip; outside: lengths of
    the fluid that fills and of the one that leaves along the reservoirs, at the start.
    """

    width: float
    length: float
    narrowing: float = 0.0
    outside: tuple[float, float] = (0.0, 0.0)


ACROSS = 60  # cells over half of the slit; a start of flow between plates is then right to 1e-4


def slit_imbibition(t: Array, slit: SlitBetweenReservoirs, driving: float, density: Sequence[float],
                    mu: Sequence[float], start: float) -> tuple[Array, Array]:
    """Way of the interface into a slit and its velocity, each (n,), at times t from rest; start: way at t = 0.

    driving: capillary pressure, 2 sigma cos(angle) / width; density, mu: (fluid that fills, fluid that leaves).
    Bosanquet (1923), Phil. Mag. 45, 525: the fluid that enters brings no momentum,

        (rho_1 l + rho_2 (L - l) + m) U' + rho_1 U^2 = driving - friction,    l' = U,

    for two fluids and with the inertia m of the fluid outside. His friction is that of a steady flow. Here it is that
    of the velocity profiles u_j(y, t) of both fluids, which have the mean U: rho_j u_j' = G_j + mu_j u_j''; while the
    profiles form it is larger.
    """
    from scipy.integrate import solve_ivp

    t = np.asarray(t, dtype=float)
    h = slit.width / 2 / ACROSS
    beside = np.eye(ACROSS, k=1) + np.eye(ACROSS, k=-1)
    # the wall is half a cell away, and the middle is a mirror
    second = (beside - np.diag([3.0] + [2.0] * (ACROSS - 2) + [1.0])) / h**2
    nu = [m / rho for m, rho in zip(mu, density)]

    def rate(_: float, y: Array) -> Array:
        way, u = y[0], np.split(y[1:], 2)
        mean = float(u[0].mean())
        viscous = [n * (second @ profile) for n, profile in zip(nu, u)]
        moved = slit.narrowing * (way - start)
        lengths = [way + slit.narrowing * (slit.outside[0] - moved),
                   slit.length - way + slit.narrowing * (slit.outside[1] + moved)]
        drag = density[0] * way * viscous[0].mean() + density[1] * (slit.length - way) * viscous[1].mean()
        speeding = (driving - density[0] * mean**2 + drag) / np.dot(density, lengths)
        return np.concatenate([[mean], *(v - v.mean() + speeding for v in viscous)])

    begin = np.zeros(1 + 2 * ACROSS)
    begin[0] = start
    times = np.unique(np.append(t, 0.0))
    y = solve_ivp(rate, (0.0, times[-1]), begin, "LSODA", times, rtol=1e-7, atol=1e-9 * slit.width).y
    return np.interp(t, times, y[0]), np.interp(t, times, y[1 : 1 + ACROSS].mean(axis=0))
