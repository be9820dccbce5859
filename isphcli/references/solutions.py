"""Published values and analytic solutions, as pure functions of arrays and numbers.

Any consistent units. `nu` is the kinematic viscosity, `mu` the dynamic one, `acceleration` a body force per
mass, `gradient` a driving pressure gradient (force per volume) G = -dp/dx. Each function names its source;
tests/references/test_solutions.py checks each a second way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(__file__).parents[1] / "data"
Array = np.ndarray


# -- flow between plates ---------------------------------------------------------------------------------


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

    Morris, Fox and Zhu (1997), J. Comput. Phys. 136, 214, eq. 22.
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
    y: Array, t: float, height: float, nu: float, acceleration: float, omega: float
) -> Array:
    """Velocity (n,) of the periodic flow that acceleration * cos(omega t) drives in a slit.

    Womersley's flow between plates: Landau and Lifshitz, Fluid Mechanics, section 24, problem 6.
    """
    k = np.sqrt(1j * omega / nu)
    middle = np.asarray(y) - height / 2
    wave = acceleration / (1j * omega) * (1 - _cosh_ratio(k * middle, k * height / 2))
    return (wave * np.exp(1j * omega * t)).real


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


def _cosh_ratio(a: complex | np.ndarray, b: complex | np.ndarray) -> np.ndarray:
    """cosh a / cosh b for |Re a| <= Re b, without overflow."""
    return (np.exp(a - b) + np.exp(-a - b)) / (1 + np.exp(-2 * b))


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

    gradient: driving force per volume, one number or one a layer (a body force on unlike densities).
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


# -- ducts and annuli ------------------------------------------------------------------------------------


def square_duct(y: Array, z: Array, side: float, gradient: float, mu: float, terms: int = 150) -> Array:
    """Steady axial velocity (n,) in a square duct, 0 <= y, z <= side.

    White, Viscous Fluid Flow, eq. 3-48 (series of cos cosh about the axis).
    """
    a = side / 2
    y, z = np.asarray(y, dtype=float) - a, np.asarray(z, dtype=float) - a
    series = np.zeros_like(y)
    for n in range(terms):
        k = (2 * n + 1) * math.pi / (2 * a)
        series += (-1) ** n / k**3 * np.cos(k * y) * _cosh_ratio(k * z, k * a)
    return gradient / mu * ((a**2 - y**2) / 2 - 2 / a * series)


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


def taylor_couette(r: Array, inner: float, outer: float, omega_inner: float, omega_outer: float) -> Array:
    """Azimuthal velocity (n,) between cylinders that turn at omega (rad/s). White, section 3-2.3."""
    r = np.asarray(r)
    squares = outer**2 - inner**2
    a = (omega_outer * outer**2 - omega_inner * inner**2) / squares
    b = (omega_inner - omega_outer) * inner**2 * outer**2 / squares
    return a * r + b / r


# -- arrays of spheres and cylinders ---------------------------------------------------------------------

# Simple cubic array: solid fraction, K = F / (6 pi mu a U), U the superficial velocity, F the mean pressure
# gradient times the volume of a cell. Zick and Homsy (1982), J. Fluid Mech. 115, 13, table 2.
ZICK_HOMSY = (
    (0.027, 2.008), (0.064, 2.810), (0.125, 4.292), (0.216, 7.442), (0.343, 15.4), (0.45, 28.1),
    (0.5236, 42.1),
)  # fmt: skip
# K = sum q_n chi^n, chi = (fraction / (pi/6))^(1/3). Sangani and Acrivos (1982), Int. J. Multiphase
# Flow 8, 343.
SANGANI_ACRIVOS = (
    1.0, 1.418649, 2.012564, 2.331523, 2.564809, 2.584787, 2.873609, 3.340163, 3.536763, 3.504092, 3.253622,
    2.689757, 2.037769, 1.809341, 1.877347, 1.534685, 0.9034708, 0.2857896, -0.5512626, -1.278724, 1.013350,
    5.492491, 4.615388, -0.5736023, -2.865924, -4.709215, -6.870076, 0.1455304, 12.51891, 9.742811, -5.566269,
)  # fmt: skip


def sphere_array_drag(fraction: float) -> float:
    """Drag coefficient K of a simple cubic array of spheres, 0 < fraction <= 0.5236 (touching).

    Up to 0.216 the series of Sangani and Acrivos (it meets the table of Zick and Homsy within the table's
    rounding there, and drifts off above: 0.9 % at 0.343, 20 % at contact); beyond it the table of Zick and
    Homsy, between its entries a monotone cubic of ln K over chi, good to about 1 %.
    Raises ValueError outside the range.
    """
    if not 0 < fraction <= 0.5237:
        raise ValueError(f"a simple cubic array has a solid fraction from 0 to 0.5236, not {fraction}")
    chi = min((fraction / (math.pi / 6)) ** (1 / 3), 1.0)
    if fraction < 0.2159:
        return float(np.polyval(SANGANI_ACRIVOS[::-1], chi))
    from scipy.interpolate import PchipInterpolator

    c, k = np.array(ZICK_HOMSY).T
    return float(np.exp(PchipInterpolator((c / c[-1]) ** (1 / 3), np.log(k))(chi)))


def sphere_array_permeability(fraction: float, cell: float = 1.0) -> float:
    """Permeability of a simple cubic array, k = L^2 / (6 pi K a/L) with L = `cell` and a the radius."""
    radius = (3 * fraction / (4 * math.pi)) ** (1 / 3)
    return cell**2 / (6 * math.pi * sphere_array_drag(fraction) * radius)


def cylinder_array_drag(fraction: float, terms: int = 24) -> float:
    """Drag K = F / (mu U) per length on a square array of cylinders, flow along a side; 0 < fraction <= 0.5.

    U: superficial velocity; F: pressure gradient times the area of a cell. Our own solution after the idea
    of Sangani and Acrivos (1982), Int. J. Multiphase Flow 8, 193: the stream function in a quarter cell as a
    sum of biharmonic functions that vanish with their slope on the cylinder, symmetry on the cell's sides
    by least squares. It gives their 51.53 at 0.2 and 532.55 at 0.5, and 30.3506 at radius 0.2 of a cell
    (Morris, Fox and Zhu 1997). Raises ValueError outside the range.
    """
    if not 0 < fraction <= 0.5:
        raise ValueError(f"the series for cylinders holds for solid fractions up to 0.5, not {fraction}")
    a = math.sqrt(fraction / math.pi)
    s = (np.arange(6 * terms) + 0.5) / (12 * terms)
    half, zero = np.full_like(s, 0.5), np.zeros_like(s)
    top = _biharmonics(s, half, a, terms)  # y = 1/2: stream function 1/2 (half the flux), no vorticity
    side = _biharmonics(half, s, a, terms)  # x = 1/2: no velocity across the flow, vorticity even in x
    matrix = np.concatenate([top["psi"], top["vorticity"], side["psi_x"], side["vorticity_x"]])
    right = np.concatenate([half, zero, zero, zero])
    size = np.linalg.norm(matrix, axis=0)
    coefficients = np.linalg.lstsq(matrix / size, right, rcond=1e-15)[0] / size
    # The force is that of the Stokeslet: psi = C r ln r sin(theta) + ... gives F / mu = 4 pi C
    return float(4 * math.pi * coefficients[1] * math.sqrt(2))


def _biharmonics(x: Array, y: Array, a: float, terms: int) -> dict[str, Array]:
    """Stream functions f(r) sin(n theta), n odd, with f = f' = 0 at r = a, and their derivatives.

    Two for each n: (r/a)^n and (r/a)^(n+2), for n = 1 (r/a)^3 and r/a ln(r/a), each scaled to 1 or so at
    the corner of the cell, less the two decaying functions that make it vanish. (points, 2 terms) arrays.
    """
    r, theta = np.hypot(x, y), np.arctan2(y, x)
    s = r / a
    columns: dict[str, list[Array]] = {"psi": [], "vorticity": [], "psi_x": [], "vorticity_x": []}
    for n in range(1, 2 * terms, 2):
        decaying = (1, -1) if n == 1 else (-n, 2 - n)
        sin, cos = np.sin(n * theta), np.cos(n * theta)
        along, turn = np.cos(theta) / a * sin, np.sin(theta) / r * n * cos  # d/dx = along d/ds - turn
        for power in (3, LOG) if n == 1 else (n, n + 2):
            slope = 1 if power == LOG else power
            weights = np.linalg.solve([[1.0, 1.0], decaying], [-float(power != LOG), -float(slope)])
            parts = ((1.0, power), (weights[0], decaying[0]), (weights[1], decaying[1]))
            scale = (a * math.sqrt(2)) ** slope
            f = [scale * sum(weight * _power(s, e, order) for weight, e in parts) for order in range(4)]
            w = f[2] + f[1] / s - n**2 * f[0] / s**2
            w_s = f[3] + f[2] / s - f[1] / s**2 - n**2 * (f[1] / s**2 - 2 * f[0] / s**3)
            columns["psi"].append(f[0] * sin)
            columns["vorticity"].append(w * sin)
            columns["psi_x"].append(f[1] * along - f[0] * turn)
            columns["vorticity_x"].append(w_s * along - w * turn)
    return {name: np.stack(column, axis=1) for name, column in columns.items()}


LOG = 0  # the exponent that stands for s ln s


def _power(s: Array, exponent: int, order: int) -> Array:
    """Derivative of s^exponent, or of s ln s."""
    if exponent == LOG:
        return (s * np.log(s), np.log(s) + 1, 1 / s, -1 / s**2)[order]
    return math.prod(exponent - i for i in range(order)) * s ** float(exponent - order)


def cylinder_array_permeability(fraction: float, cell: float = 1.0) -> float:
    """Permeability of a square array of cylinders across them, k = L^2 / K."""
    return cell**2 / cylinder_array_drag(fraction)


# -- Taylor-Green vortices -------------------------------------------------------------------------------


def taylor_green_2d(
    x: Array, t: float, nu: float, speed: float = 1.0, k: float = 2 * math.pi, density: float = 1.0
) -> tuple[Array, Array]:
    """Velocity (n, 2) and pressure (n,) of the decaying vortex, an exact solution. x: (n, 2).

    u = U sin kx cos ky e^(-2 nu k^2 t), v = -U cos kx sin ky e^..., p = rho U^2/4 (cos 2kx + cos 2ky) e^2...
    (G. I. Taylor 1923, Phil. Mag. 46, 671.)
    """
    x = np.asarray(x)
    kx, ky = k * x[:, 0], k * x[:, 1]
    decay = math.exp(-2 * nu * k**2 * t)
    u = speed * decay * np.stack([np.sin(kx) * np.cos(ky), -np.cos(kx) * np.sin(ky)], axis=1)
    p = density * (speed * decay) ** 2 / 4 * (np.cos(2 * kx) + np.cos(2 * ky))
    return u, p


def taylor_green_3d(
    times: Sequence[float], nu: float, speed: float = 1.0, k: float = 2 * math.pi, n: int = 32
) -> tuple[Array, list[Array]]:
    """Mean kinetic energy per mass (len(times),) of the 3D Taylor-Green vortex and its fields, computed.

    At t = 0 u = U (sin kx cos ky cos kz, -cos kx sin ky cos kz, 0) in a box of 2 pi / k (Taylor and Green
    1937, Proc. R. Soc. A 158, 499). times: ascending. Each field can be handed to `spectral_velocity`.
    Pseudo-spectral with n^3 points; relative error of the energy with n = 32, against finer grids:

        U / (nu k)    t U k = 2    t U k = 5
            16          < 1e-8       < 1e-8      (Reynolds number 100 on the box)
            50           3e-7         2e-5
           100           2e-6         5e-4       (n = 48: < 1e-8 at 2)

    About 1 s of computing a unit of t U k with n = 32, 3 s with 48.
    """
    grid = 2 * math.pi * np.arange(n) / n
    x, y, z = np.meshgrid(grid, grid, grid, indexing="ij", sparse=True)
    start = np.stack([np.sin(x) * np.cos(y) * np.cos(z), -np.cos(x) * np.sin(y) * np.cos(z), 0 * (x + y + z)])
    fields = navier_stokes_spectral(start, [t * speed * k for t in times], nu * k / speed)
    return np.array([speed**2 * spectral_energy(f) for f in fields]), [speed * f for f in fields]


def navier_stokes_spectral(
    velocity: Array, times: Sequence[float], nu: float, step: float = 0.025
) -> list[Array]:
    """TimeLoop an incompressible flow in the periodic box (2 pi)^3; returns its Fourier coefficients at `times`.

    velocity: (3, n, n, n) at t = 0, divergence-free. Rotational form u x curl u, 2/3 dealiasing, viscous
    terms exact by an integrating factor, Runge-Kutta of order 4 (Canuto et al., Spectral Methods in Fluid
    Dynamics, chapter 7). Coefficients: (3, n, n, n/2 + 1) as of numpy.fft.rfftn with norm="forward".
    """
    n = velocity.shape[1]
    whole, half = np.fft.fftfreq(n, 1 / n), np.fft.rfftfreq(n, 1 / n)
    k = np.stack(np.meshgrid(whole, whole, half, indexing="ij"))
    k2 = (k**2).sum(axis=0)
    kept = (np.abs(k) < n / 3).all(axis=0)
    projector = k / np.where(k2 > 0, k2, 1)

    def rate(w: Array) -> Array:
        u = np.fft.irfftn(w, (n,) * 3, axes=(1, 2, 3), norm="forward")
        curl = np.fft.irfftn(1j * np.cross(k, w, axis=0), (n,) * 3, axes=(1, 2, 3), norm="forward")
        f = np.fft.rfftn(np.cross(u, curl, axis=0), axes=(1, 2, 3), norm="forward") * kept
        return f - k * (projector * f).sum(axis=0)

    w = np.fft.rfftn(velocity, axes=(1, 2, 3), norm="forward") * kept
    fields, now = [], 0.0
    for t in times:
        steps = math.ceil((t - now) / step - 1e-9)
        if steps > 0:
            dt = (t - now) / steps
            e = np.exp(-nu * k2 * dt / 2)
            for _ in range(steps):
                a = rate(w)
                b = rate(e * (w + dt / 2 * a))
                c = rate(e * w + dt / 2 * b)
                d = rate(e * (e * w + dt * c))
                w = e * e * (w + dt / 6 * a) + dt / 3 * e * (b + c) + dt / 6 * d
            now = t
        fields.append(w.copy())
    return fields


def spectral_energy(coefficients: Array) -> float:
    """Mean of |u|^2 / 2 from the coefficients of `navier_stokes_spectral`."""
    power = (np.abs(coefficients) ** 2).sum(axis=0)
    return float(power.sum() - power[..., 0].sum() / 2 - (power[..., -1].sum() / 2))


def spectral_velocity(coefficients: Array, x: Array, k: float = 2 * math.pi) -> Array:
    """Velocity (n, 3) at arbitrary points x (n, 3) of the box 2 pi / k: the Fourier series itself."""
    n = coefficients.shape[1]
    m = np.arange(-(n // 3), n // 3 + 1)
    kept = coefficients[:, m[:, None, None], m[None, :, None], np.arange(n // 3 + 1)]
    kept = kept * np.where(np.arange(n // 3 + 1) == 0, 1.0, 2.0)
    u = np.empty((len(x), 3))
    for start in range(0, len(x), 1024):
        part = k * np.asarray(x[start : start + 1024])
        ex, ey = np.exp(1j * np.multiply.outer(part[:, 0], m)), np.exp(1j * np.multiply.outer(part[:, 1], m))
        ez = np.exp(1j * np.multiply.outer(np.arange(n // 3 + 1), part[:, 2]))
        along_z = kept.reshape(-1, n // 3 + 1) @ ez
        field = along_z.reshape(3, len(m), len(m), len(part))
        u[start : start + 1024] = np.einsum("cijp,pi,pj->pc", field, ex, ey, optimize=True).real
    return u


# -- lid-driven cavity -----------------------------------------------------------------------------------

GHIA_MISPRINTS = {400: (0.9063,)}  # x at which the printed v, -0.23827, lies 0.1 off any smooth curve


def cavity(reynolds: int) -> dict[str, Array]:
    """Lid-driven cavity of side 1, lid velocity 1 at y = 1: y and u at x = 1/2, x and v at y = 1/2.

    Ghia, Ghia and Shin (1982), J. Comput. Phys. 48, 387, tables I and II; Reynolds number 100, 400 or 1000.
    Left out is v at x = 0.9063 for 400, a misprint. Raises KeyError for another Reynolds number.
    """
    u, v = table("ghia_cavity_u"), table("ghia_cavity_v")
    kept = ~np.isin(v["x"], GHIA_MISPRINTS.get(reynolds, ()))
    return {"y": u["y"], "u": u[str(reynolds)], "x": v["x"][kept], "v": v[str(reynolds)][kept]}


# -- drops, bubbles and waves ----------------------------------------------------------------------------


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


def capillary_wave(
    t: Array,
    wavelength: float,
    tension: float,
    density: Sequence[float],
    nu: float,
    gravity: float = 0.0,
    amplitude: float = 1.0,
    speed: float = 0.0,
) -> Array:
    """Height (n,) of the crest of a small wave between two deep fluids of the same kinematic viscosity.

    amplitude, speed: height and upward velocity of the crest at t = 0, the flow irrotational in each fluid.
    density: (lower, upper). Prosperetti (1981), Phys. Fluids 24, 1217, eqs 22 to 24.
    """
    from scipy.special import erfc, wofz

    t = np.asarray(t, dtype=float)
    k = 2 * math.pi / wavelength
    total = sum(density)
    beta = density[0] * density[1] / total**2
    omega2 = (density[0] - density[1]) / total * gravity * k + tension * k**3 / total
    v = nu * k**2
    z = np.roots(
        [
            1,
            -4 * beta * v**0.5,
            2 * (1 - 6 * beta) * v,
            4 * (1 - 3 * beta) * v**1.5,
            (1 - 4 * beta) * v**2 + omega2,
        ]
    )
    a = 4 * (1 - 4 * beta) * v**2 / (8 * (1 - 4 * beta) * v**2 + omega2) * amplitude * erfc(np.sqrt(v * t)) + 0j
    for i in range(4):
        others = np.prod(np.delete(z, i) - z[i])
        # exp((z^2 - v) t) erfc(z sqrt t) = exp(-v t) w(i z sqrt t), which does not overflow
        part = z[i] / others * (omega2 * amplitude / (z[i] ** 2 - v) - speed)
        a += part * np.exp(-v * t) * wofz(1j * z[i] * np.sqrt(t))
    return a.real


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


# Rising bubble, case 1 of Hysing et al. (2009), Int. J. Numer. Meth. Fluids 60, 1259: densities 1000 and 100,
# viscosities 10 and 1, tension 24.5, gravity 0.98, diameter 0.5 in a box of 1 x 2 from y = 0.5.
RISING_BUBBLE: dict[str, Any] = {
    "rise_velocity_max": 0.2417,
    "time_of_rise_velocity_max": (0.921, 0.924),
    "circularity_min": 0.9013,
    "time_of_circularity_min": 1.90,
    "centre_height_at_3": 1.0817,
}
# Berea sandstone, 128^3 voxels (LukasMosser/PorousMediaGan, MIT): permeability by finite volumes on this very
# cube, flow along each axis with the sides sealed, in voxel^2. (The published file took 2 um a voxel.)
BEREA_128 = {"porosity": 0.20692, "permeability_in_voxels": (0.0677227, 0.0552978, 0.0490182)}


def berea_permeability(axis: int, voxel_size: float) -> float:
    """Published permeability of the 128^3 Berea cube along `axis` (0, 1, 2 for x, y, z), in voxel_size^2."""
    return BEREA_128["permeability_in_voxels"][axis] * voxel_size**2  # type: ignore[index]


def table(name: str) -> dict[str, Array]:
    """Columns of a table in `isphcli/data`, by name of file without `.csv`; see its README."""
    path = DATA / f"{name}.csv"
    with open(path, encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)))
