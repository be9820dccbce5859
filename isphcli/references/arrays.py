"""Flow through arrays of spheres and cylinders: published drag, as pure functions of numbers; any consistent units.

Each function names its source; the test of the file checks each a second way.
"""

from __future__ import annotations

import math

import numpy as np

Array = np.ndarray


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
    Homsy, whose entries are rounded to 0.1 to 0.3 %, between them a cubic spline of ln K over chi that begins with the
    slope of the series. At 0.28 and 0.4 own solutions of 40 spacings a cell are within 0.03 and 0.1 % of it (a monotone
    cubic was 0.22 % off at 0.28).
    Raises ValueError outside the range.
    """
    if not 0 < fraction <= 0.5237:
        raise ValueError(f"a simple cubic array has a solid fraction from 0 to 0.5236, not {fraction}")
    chi = min((fraction / (math.pi / 6)) ** (1 / 3), 1.0)
    if fraction < 0.2159:
        return float(np.polyval(SANGANI_ACRIVOS[::-1], chi))
    from scipy.interpolate import CubicSpline

    c, k = np.array(ZICK_HOMSY[3:]).T
    places = (c / c[-1]) ** (1 / 3)
    series = np.polynomial.Polynomial(SANGANI_ACRIVOS)
    slope = series.deriv()(places[0]) / series(places[0])
    return float(np.exp(CubicSpline(places, np.log(k), bc_type=((1, slope), "not-a-knot"))(chi)))


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
