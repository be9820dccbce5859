"""Taylor-Green vortices in two and three dimensions, as pure functions of arrays and numbers; any consistent units.

Each function names its source; the test of the file checks each a second way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Array = np.ndarray


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
    """Solves an incompressible flow in the periodic box (2 pi)^3; returns its Fourier coefficients at `times`.

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
