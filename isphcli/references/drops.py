"""Drops and waves of an interface with tension: analytic solutions, as pure functions of arrays and numbers.

Any consistent units; `mu` is the dynamic viscosity, `nu` the kinematic one. Each function names its source; the test of
the file checks each a second way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray


def laplace_jump(tension: float, radius: float, dim: int) -> float:
    """Pressure inside minus outside of a drop: sigma / R in 2D, 2 sigma / R in 3D (Young and Laplace)."""
    return (dim - 1) * tension / radius  # eq. 27 of the paper


def drop_radius(size: float, dim: int) -> float:
    """Radius of the disk of an area (2D) or the ball of a volume (3D)."""
    return math.sqrt(size / math.pi) if dim == 2 else (3 * size / (4 * math.pi)) ** (1 / 3)


def drop_on_wall(size: float, angle: float, dim: int = 2) -> dict[str, float]:
    """Radius, height, base width and height of the centre of mass of a resting drop without gravity.

    A cap that meets the wall at `angle` (degrees, measured through the drop). size: area (2D) or volume (3D).
    Segments of circles and caps of spheres: Bronshtein and Semendyayev, Handbook of Mathematics, 3.1 and 3.3.
    """
    theta = math.radians(angle)
    sine, cosine = math.sin(theta), math.cos(theta)
    if dim == 2:
        radius = math.sqrt(size / (theta - sine * cosine))
        centre = 2 * sine**3 / (3 * (theta - sine * cosine)) - cosine
    else:
        radius = (3 * size / (math.pi * (1 - cosine) ** 2 * (2 + cosine))) ** (1 / 3)
        centre = 3 * (1 + cosine) ** 2 / (4 * (2 + cosine)) - cosine
    return {"radius": radius, "height": radius * (1 - cosine), "base": 2 * radius * sine, "centre": radius * centre}


class Layer(NamedTuple):
    """Fluid on one side of a flat interface. depth: to a wall at rest that does not slip."""

    density: float
    mu: float
    depth: float = math.inf


def capillary_wave(
    t: Array,
    wavelength: float,
    tension: float,
    layers: Sequence[Layer],
    gravity: float = 0.0,
    start: tuple[float, float] = (1.0, 0.0),
) -> Array:
    """Height (n,) of the crest of a small wave between two fluids; layers: the lower and the upper one.

    start: height and upward velocity of the crest at t = 0, the flow irrotational in each fluid. The initial value
    problem of Prosperetti (1981), Phys. Fluids 24, 1217, for fluids that need not be alike: the Laplace transform of
    the linear problem is solved at the points of a contour like Talbot's, as in Weideman (2006), SIAM J. Numer. Anal.
    44, 2342, but stretched along the imaginary axis, where the poles of the wave are. Times within a factor of two
    share it.
    """
    t = np.asarray(t, dtype=float)
    k = 2 * math.pi / wavelength
    below, above = layers
    stiffness = (below.density - above.density) * gravity + tension * k**2
    omega = math.sqrt(abs(stiffness) * k / (below.density + above.density))
    out, last = np.full(t.shape, float(start[0])), float(t.max(initial=0.0))
    while last > 0.0 and (t > 0.0).any():
        inside = (t > last / 2) & (t <= last)
        if inside.any():
            stretch = max(1.0, omega * last / 2.5)  # the poles are 5 / last to the left of the contour, or farther
            n = 2 * math.ceil(CONTOUR * stretch)
            theta = math.pi * ((2.0 * np.arange(n) + 1.0) / n - 1.0)
            angle = 0.6407 * theta
            s = CONTOUR / last * (0.5017 * theta / np.tan(angle) - 0.6122 + 0.2645j * stretch * theta)
            slope = CONTOUR / last * (0.5017 * (1 / np.tan(angle) - angle / np.sin(angle) ** 2) + 0.2645j * stretch)
            height = _wave_transform(s, k, stiffness, layers, start)
            out[inside] = (np.exp(np.outer(t[inside], s)) @ (slope * height) / (1j * n)).real
        if last < t[t > 0.0].min():
            break
        last /= 2
    return out


CONTOUR = 32  # points of a contour without stretch, over two; with 16 waves of ten periods are wrong by 1e-5


def _wave_transform(s: Array, k: float, stiffness: float, layers: Sequence[Layer], start: tuple[float, float]) -> Array:
    """Laplace transform (n,) of the height of the crest at s (n,), 1/s. stiffness: force of the interface over its
    height, N/m3.

    At the distance d from the interface the vertical velocity is a sum of exp(-k d), exp(-q d), exp(-k (h - d)) and
    exp(-q (h - d)), q^2 = k^2 + s / nu. Velocity and shear stress go on over the interface, the normal stress jumps by
    the stiffness times the height, and nothing moves at the walls: eight equations for the parts of both layers.
    """
    amplitude, speed = start
    system, right = np.zeros((len(s), 8, 8), complex), np.zeros((len(s), 8, 1), complex)
    one, zero = np.ones(len(s)), np.zeros(len(s))
    for place, (density, mu, depth) in enumerate(layers):
        side = 1.0 - 2.0 * place  # d falls along y in the lower layer
        h = min(depth, 60.0 / k)  # nothing arrives from farther away
        q, kk = np.sqrt(k**2 + s * density / mu), k * one
        far_k, far_q = np.exp(-kk * h), np.exp(-q * h)
        parts = slice(4 * place, 4 * place + 4)
        value = np.stack([one, one, far_k, far_q], axis=1)
        slope = side * np.stack([kk, q, -k * far_k, -q * far_q], axis=1)  # along y
        bent = np.stack([2 * kk**2, kk**2 + q**2, 2 * k**2 * far_k, (k**2 + q**2) * far_q], axis=1)
        # density (s u - u(0)) = -grad p of the irrotational parts; the others have no pressure
        pressure = -side * density / k * s[:, None] * np.stack([one, zero, -far_k, zero], axis=1)
        system[:, 0, parts] = side * value
        system[:, 1, parts] = side * slope
        system[:, 2, parts] = side * mu * bent
        system[:, 3, parts] = side * (2 * mu * slope - pressure)
        right[:, 3, 0] += density * speed / (k * math.tanh(k * h))
        row = 4 + 2 * place
        system[:, row, parts] = np.stack([far_k, far_q, one, one], axis=1)
        system[:, row + 1, parts] = np.stack([k * far_k, q * far_q, -kk, -q], axis=1)
        if place == 0:  # s height = amplitude + velocity
            system[:, 3, parts] += (stiffness / s)[:, None] * value
            velocity_of = value
    right[:, 3, 0] -= stiffness * amplitude / s
    found = np.linalg.solve(system, right)[:, :4, 0]
    return (amplitude + (velocity_of * found).sum(axis=1)) / s


def drop_oscillation(
    radius: float,
    tension: float,
    density: Sequence[float],
    mu: Sequence[float],
    mode: int = 2,
    wall: float = math.inf,
) -> complex:
    """Complex rate s (1/s) of a 2D drop r = R + a e^(s t) cos(mode theta): -damping + i frequency.

    density, mu: (drop, fluid around it; a density of 0 is vacuum); wall: radius of a round wall at rest about
    it. The full linear problem: stream function g(r) e^(i n theta + s t), g a sum of r^n and I_n(kr) in the
    drop, of r^-n and K_n(kr) around it, and with a wall of r^n and I_n(kr) too, k^2 = s / nu; velocity and
    shear stress continuous, normal stress jumping by the curvature (Lamb, Hydrodynamics, section 355, has it
    for a sphere in vacuum; Miller and Scriven 1968, J. Fluid Mech. 32, 417, for two fluids).

    Followed from small viscosity, where it is i sqrt(n (n^2 - 1) sigma / (rho_total R^3)), to that asked for.
    Raises ValueError where the drop creeps back without oscillating.
    """
    from scipy.optimize import newton

    n, sigma = mode, tension / radius**3  # lengths in radii from here on
    mirror = (radius / wall) ** (2 * n)
    s = 1j * math.sqrt(n * (n**2 - 1) * sigma / (density[0] + density[1] * (1 + mirror) / (1 - mirror)))
    for thinner in np.geomspace(1e-4, 1.0, 41):
        thin = [thinner * m / radius**2 for m in mu]
        # the damping of a drop in vacuum moves the guess off the imaginary axis
        guess = s - 2 * n * (n - 1) * thin[0] / density[0] * (thinner == 1e-4)
        arguments = (n, sigma, density, thin, wall / radius)
        s, found = newton(
            _drop_determinant, guess, args=arguments, tol=1e-10 * abs(s), full_output=True, disp=False
        )
        if not found.converged or s.imag < 1e-6 * abs(s):
            raise ValueError("the viscosity is so large that the drop does not oscillate")
    return complex(s)


def _drop_determinant(
    s: complex, n: int, sigma: float, density: Sequence[float], mu: Sequence[float], wall: float
) -> complex:
    """Determinant of the conditions at r = 1 and at the wall on the parts of the stream function."""
    inside = _stream_parts(1.0, s, n, density[0], mu[0], ("r^n", "I"))
    stress = [_shear(g, n, mu[0]) for g in inside], [
        _pressure(g, n, mu[0]) - sigma * n * (n**2 - 1) * g[0] / s for g in inside
    ]
    if density[1] == 0:
        return np.linalg.det(np.array(stress))
    kinds = ("r^-n", "K") if math.isinf(wall) else ("r^-n", "K", "r^n", "I")
    around = _stream_parts(1.0, s, n, density[1], mu[1], kinds, wall)
    rows = [
        [g[0] for g in inside] + [-g[0] for g in around],
        [g[1] for g in inside] + [-g[1] for g in around],
        stress[0] + [-_shear(g, n, mu[1]) for g in around],
        stress[1] + [-_pressure(g, n, mu[1]) for g in around],
    ]
    if not math.isinf(wall):
        far = _stream_parts(wall, s, n, density[1], mu[1], kinds, wall)
        rows += [[0, 0] + [g[0] for g in far], [0, 0] + [g[1] for g in far]]
    return np.linalg.det(np.array(rows))


def _stream_parts(
    r: float, s: complex, n: int, density: float, mu: float, kinds: Sequence[str], largest: float = 1.0
) -> list[tuple[complex, complex, complex, complex]]:
    """g, g', g'' and the pressure (over i) at r of parts of the stream function.

    Potential parts are 1 at r = 1, viscous ones have g'' of order 1 there; largest: where the I have it instead.
    rho s u = -grad p for the potential parts; the viscous ones have no pressure.
    """
    from scipy.special import ive, kve

    z = np.sqrt(density * s / mu)
    parts: list[tuple[complex, complex, complex, complex]] = []
    for kind in kinds:
        if kind == "r^n":
            parts.append((r**n, n * r ** (n - 1), n * (n - 1) * r ** (n - 2), -density * s * r**n))
        elif kind == "r^-n":
            parts.append((r**-n, -n * r ** (-n - 1), n * (n + 1) * r ** (-n - 2), density * s * r**-n))
        else:
            function, sign = (ive, 1) if kind == "I" else (kve, -1)
            # ive = I e^-|Re z|, kve = K e^z: scaled to what they are where they are largest
            size = (np.exp(z.real * r - z * largest) if kind == "I" else np.exp(-z * (r - 1))) / z**2
            g = size * function(n, z * r)
            slope = sign * size * (function(n - 1, z * r) + function(n + 1, z * r)) / 2 * z
            parts.append((g, slope, (z**2 + (n / r) ** 2) * g - slope / r, 0.0))
    return parts


def _shear(g: Sequence[complex], n: int, mu: float) -> complex:
    """Shear stress at r = 1 of u_r = i n g / r, u_theta = -g'."""
    return mu * (g[1] - g[2] - n**2 * g[0])


def _pressure(g: Sequence[complex], n: int, mu: float) -> complex:
    """p - 2 mu du_r/dr at r = 1, over i."""
    return g[3] - 2 * mu * n * (g[1] - g[0])
