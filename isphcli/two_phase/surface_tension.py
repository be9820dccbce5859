"""Surface tension: the curvature of the interface, and the force that it makes (paper eqs 14-24).

Curvature. Eq. 23 takes the divergence of the normals over neighbours of the same fluid and is 30 % off. We take the
derivative of the normals along the interface only, by least squares over both fluids:

    K_i = argmin sum_j w_ij |(n_j - n_i) - K P x_ji|^2,   kappa_i = - tr K,   P = 1 - n_i (x) n_i,  w_ij = F V_j / r

with n into the first fluid, so that a drop of it has kappa > 0, and its pressure is higher by sigma kappa.

Force, `jump` (default): the pressure of unlike neighbours differs by J_ij = sigma kappa_ij (c_j - c_i), c the colour.
Eq. 2 sees what is left of the difference, so that each particle is accelerated by  sum_j b_ij J_ij grad_ij  with the
very weights b_ij grad_ij of its pressure gradient: a constant curvature is balanced to round-off by a pressure.
`csf` (eq. 24): the force sigma kappa grad C in the band, per mean density.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numba import njit, prange

from ..operators.kernel import slope
from ..operators.neighbourhood_class import THIN
from .normals import Band, averages, find_band, ghost_arrays

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..operators.pair_weights import Operators
    from .contact_angle import ContactAngle

SMOOTHINGS = 3  # kernel averages of the curvature over the band


class SurfaceTension:
    """tension: N/m; method: jump or csf; density: (2,) kg/m3; kind: kernel number; support, spacing: m;
    contact: contact_angle.ContactAngle or None."""

    def __init__(self, tension: float, method: str, density: Sequence[float] | np.ndarray, kind: int, support: float,
                 spacing: float, contact: ContactAngle | None = None):
        self.tension, self.method, self.density = tension, method, np.asarray(density, float)
        self.kind, self.support, self.spacing = kind, support, spacing
        self.contact = contact

    @property
    def largest_step(self) -> float:
        """sqrt(rho dx^3 / (2 pi sigma)), rho the mean density, s: the limit of Brackbill, Kothe and Zemach (1992)."""
        return math.sqrt(self.density.mean() * self.spacing**3 / (2.0 * math.pi * self.tension))

    def force(self, ops: Operators, weighted: Operators, neighbours: Neighbourhood, colour: np.ndarray,
              near: np.ndarray, reference: float) -> tuple[np.ndarray, np.ndarray | None, Band]:
        """Acceleration (n, dim), m/s2; what the Laplacian of the pressure makes of the jump
        (`Terms.laplacian_of_jump`), or None; the Band of this configuration.

        ops: Operators; weighted: the same with its pressure weights divided by the density of each pair over
        `reference`; neighbours: all of them, dummies included; colour: (n,); near: (n,) of `near_interface`.
        """
        ghosts = None
        if self.contact is not None:
            ghosts = self.contact.ghosts(ops, neighbours, colour, near)
        band = find_band(ops, colour, near, self.spacing, ghosts)
        curvature = _curvature(ops.neighbours, ops.volume, band.normal, band.strength,
                               ghost_arrays(ghosts, len(colour), ops.dim))
        curvature = averages(ops.neighbours, band.strength * ops.volume, curvature, SMOOTHINGS)
        band = replace(band, curvature=curvature)
        if self.method == "jump":
            across = weighted.lap_p if weighted.walls is None else weighted.walls.symmetric_laplacian
            jump = _jump(weighted.neighbours, weighted.grad_p, across, colour, curvature, band.strength,
                         self.tension / reference)
            return *jump, band
        push = self.tension * curvature * band.strength / self.density.mean()  # eq. 24
        return push[:, None] * band.normal, None, band


@njit(cache=True, parallel=True, error_model="numpy")
def _curvature(neighbours, volume, normal, strength, ghosts):
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kernel = neighbours.kind, neighbours.support
    ghost_start, ghost_offset, _, ghost_normal, ghost_volume = ghosts
    n, dim = len(start) - 1, x.shape[1]
    kappa = np.zeros(n)
    for i in prange(n):
        if strength[i] > 0.0:
            dz, turn_z = 0.0, 0.0
            sums = NO_TURN  # scalars: several times faster than small arrays
            for p in range(start[i], start[i + 1]):
                j, q = column[p], row[p]
                if strength[j] > 0.0:
                    turn_x, turn_y = normal[j, 0] - normal[i, 0], normal[j, 1] - normal[i, 1]
                    if dim == 3:
                        dz, turn_z = x[q, 2] - x[i, 2], normal[j, 2] - normal[i, 2]
                    offset = x[q, 0] - x[i, 0], x[q, 1] - x[i, 1], dz
                    sums = _add_turn(sums, offset, (turn_x, turn_y, turn_z), volume[j], kernel)
            for p in range(ghost_start[i], ghost_start[i + 1]):
                if ghost_normal[p, 0] != 0.0 or ghost_normal[p, 1] != 0.0 or ghost_normal[p, dim - 1] != 0.0:
                    turn_x, turn_y = ghost_normal[p, 0] - normal[i, 0], ghost_normal[p, 1] - normal[i, 1]
                    if dim == 3:
                        dz, turn_z = ghost_offset[p, 2], ghost_normal[p, 2] - normal[i, 2]
                    offset = ghost_offset[p, 0], ghost_offset[p, 1], dz
                    sums = _add_turn(sums, offset, (turn_x, turn_y, turn_z), ghost_volume, kernel)
            kappa[i] = -_divergence(sums, normal[i])  # eq. 23, by least squares along the interface
    return kappa


NO_TURN = (0.0,) * 15


@njit(cache=True, inline="always")
def _add_turn(s, offset, turn, volume, kernel):
    """The sums of w d (x) d (xx, yy, zz, yz, xz, xy) and w (n_j - n_i) (x) d, row by row, with one more neighbour."""
    x, y, z = offset
    turn_x, turn_y, turn_z = turn
    r = math.sqrt(x * x + y * y + z * z)
    if r == 0.0:
        return s
    w = volume * slope(kernel[0], r / kernel[1]) / r
    a, b, c = w * x, w * y, w * z
    return (s[0] + x * a, s[1] + y * b, s[2] + z * c, s[3] + y * c, s[4] + x * c, s[5] + x * b,
            s[6] + turn_x * a, s[7] + turn_x * b, s[8] + turn_x * c,
            s[9] + turn_y * a, s[10] + turn_y * b, s[11] + turn_y * c,
            s[12] + turn_z * a, s[13] + turn_z * b, s[14] + turn_z * c)  # fmt: skip


@njit(cache=True, error_model="numpy")
def _divergence(s, normal):
    """tr K of the sums of `_add_turn`: both tensors are taken to two directions along the interface."""
    if len(normal) == 2:
        x, y = -normal[1], normal[0]
        along = x * x * s[0] + y * y * s[1] + 2.0 * x * y * s[5]
        return (x * (s[6] * x + s[7] * y) + y * (s[9] * x + s[10] * y)) / along if along > 0.0 else 0.0
    # (x, y, z) is across the normal and the axis that it leans to least, (u, v, w) across both
    a, b, c = normal[0], normal[1], normal[2]
    if abs(a) <= min(abs(b), abs(c)):
        x, y, z = 0.0, -c, b
    elif abs(b) <= abs(c):
        x, y, z = c, 0.0, -a
    else:
        x, y, z = -b, a, 0.0
    size = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
    # what the sums make of either
    ex, ey, ez = s[0] * x + s[5] * y + s[4] * z, s[5] * x + s[1] * y + s[3] * z, s[4] * x + s[3] * y + s[2] * z
    fx, fy, fz = s[0] * u + s[5] * v + s[4] * w, s[5] * u + s[1] * v + s[3] * w, s[4] * u + s[3] * v + s[2] * w
    gx, gy, gz = s[6] * x + s[7] * y + s[8] * z, s[9] * x + s[10] * y + s[11] * z, s[12] * x + s[13] * y + s[14] * z
    hx, hy, hz = s[6] * u + s[7] * v + s[8] * w, s[9] * u + s[10] * v + s[11] * w, s[12] * u + s[13] * v + s[14] * w
    ee, ef, ff = x * ex + y * ey + z * ez, u * ex + v * ey + w * ez, u * fx + v * fy + w * fz
    eg, fg, fh = x * gx + y * gy + z * gz, u * gx + v * gy + w * gz, u * hx + v * hy + w * hz
    both = fg + x * hx + y * hy + z * hz
    trace, apart = ee + ff, math.hypot(ee - ff, 2.0 * ef)
    small, large = 0.5 * (trace - apart), 0.5 * (trace + apart)
    if small > THIN * trace:
        return (eg * ff - both * ef + fh * ee) / (ee * ff - ef * ef)
    # the neighbours lie along one line: only what they turn along it is known
    return (eg * (ee - small) + both * ef + fh * (ff - small)) / (apart * large) if large > 0.0 else 0.0


@njit(cache=True, parallel=True)
def _jump(neighbours, grad, lap, colour, kappa, strength, tension):
    start, column = neighbours.start, neighbours.column
    n, dim = len(start) - 1, grad.shape[1]
    out, laplacian_of_jump = np.zeros((n, dim)), np.zeros(n)
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            if colour[j] != colour[i]:
                both = strength[i] + strength[j]
                if both > 0.0:
                    # eqs 14 and 24 as the jump of the pressure that balances the force
                    jump = tension * (strength[i] * kappa[i] + strength[j] * kappa[j]) / both * (colour[j] - colour[i])
                    laplacian_of_jump[i] += lap[p] * jump
                    for k in range(dim):
                        out[i, k] += grad[p, k] * jump
    return out, laplacian_of_jump
