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

import math

import numpy as np
from numba import njit, prange

from .interface import average, find_band, ghost_arrays, invert
from .kernel import slope

SMOOTHINGS = 3  # kernel averages of the curvature over the band
# Mean viscosity over sqrt(rho sigma dx) below which an interface is helped (docs/method.md 12), and how much viscosity
# it then gets for what it lacks. With 1 a drop of Laplace number 1e6 lost particles after 1000 steps, with 2.5 not
# after 1500 (support 2.3). Particles are shifted there in full already below LOOSE: with a third of it a drop at 0.041
# blew up after 500 steps (support 2.8), with all of it it holds 2500; at 0.043 it holds either way.
HELD, HELP, LOOSE = 0.04, 2.5, 0.044


def damping(tension, density, viscosity, spacing):
    """Dynamic viscosity that pairs at an interface get on top of their own, Pa s (0 where it damps enough by itself),
    and whether particles are shifted there in full.

    tension: N/m; density, viscosity: (2,) kg/m3 and dynamic, Pa s; spacing: m."""
    unit = math.sqrt(np.mean(density) * tension * spacing)
    own = float(np.mean(viscosity)) / unit
    return HELP * max(HELD - own, 0.0) * unit, own < LOOSE


class SurfaceTension:
    """tension: N/m; method: jump or csf; density: (2,) kg/m3; kind: kernel number; support, spacing: m;
    contact: contact_angle.ContactAngle or None."""

    def __init__(self, tension, method, density, kind, support, spacing, contact=None):
        self.tension, self.method, self.density = tension, method, np.asarray(density, float)
        self.kind, self.support, self.spacing = kind, support, spacing
        self.contact = contact
        self.band = self.curvature = None

    @property
    def largest_step(self):
        """Time in which a capillary wave of two spacings moves on by its radian, sqrt(rho dx^3 / (2 pi sigma)), s."""
        return math.sqrt(self.density.mean() * self.spacing**3 / (2.0 * math.pi * self.tension))

    def damping(self, viscosity):
        """`damping` of this interface between fluids of dynamic viscosities (2,), Pa s."""
        return damping(self.tension, self.density, viscosity, self.spacing)

    def force(self, ops, weighted, x, row, pairs, owner, colour, near, reference):
        """Acceleration (n, dim), m/s2, and what the Laplacian of the pressure makes of the jump (Terms.lift), or None.

        ops: Operators; weighted: the same with its pressure weights divided by the density of each pair over
        `reference`; x, row, pairs, owner: as in `TwoFluids.terms`; colour: (n,); near: (n,) of `near_interface`.
        """
        ghosts = None
        if self.contact is not None:
            ghosts = self.contact.ghosts(ops, x, row, pairs, owner, colour, near)
        start, offset, _, ghost_normal, volume = ghost_arrays(ghosts, len(colour), x.shape[1])
        band = find_band(ops, x, row, colour, near, self.kind, self.support, self.spacing, ghosts)
        curvature = _curvature(ops.start, ops.column, row, x, ops.volume, self.kind, self.support,
                               band.normal, band.strength, start, offset, ghost_normal, volume)
        start, offset, none, _, volume = ghost_arrays(None, len(colour), x.shape[1])
        for _ in range(SMOOTHINGS):
            curvature = average(ops.start, ops.column, row, x, band.strength * ops.volume, self.kind, self.support,
                                curvature, band.strength > 0.0, start, offset, none, volume)
        self.band, self.curvature = band, curvature
        if self.method == "jump":
            across = weighted.lap_p if ops.walls is None else weighted.walls.natural
            return _jump(ops.start, ops.column, weighted.grad_p, across, colour, curvature, band.strength,
                         self.tension / reference)
        push = self.tension * curvature * band.strength / self.density.mean()
        return push[:, None] * band.normal, None


@njit(cache=True, parallel=True)
def _curvature(start, column, row, x, volume, kind, support, normal, strength,
               ghost_start, ghost_offset, ghost_normal, ghost_volume):
    n, dim = len(start) - 1, x.shape[1]
    kappa = np.zeros(n)
    for i in prange(n):
        if strength[i] > 0.0:
            along, bend = np.zeros((3, 3)), np.zeros((3, 3))
            offset, trace = np.empty(dim), 0.0
            for p in range(start[i], start[i + 1]):
                j = column[p]
                if strength[j] > 0.0:
                    for k in range(dim):
                        offset[k] = x[row[p], k] - x[i, k]
                    trace += _add_turn(offset, normal, i, normal, j, volume[j], kind, support, along, bend)
            for p in range(ghost_start[i], ghost_start[i + 1]):
                size = 0.0
                for k in range(dim):
                    offset[k] = ghost_offset[p, k]
                    size += ghost_normal[p, k] ** 2
                if size > 0.0:
                    trace += _add_turn(offset, normal, i, ghost_normal, p, ghost_volume, kind, support, along, bend)
            if trace > 0.0:
                inverse = np.zeros((3, 3))
                for k in range(dim):
                    for m in range(dim):
                        along[k, m] += trace * normal[i, k] * normal[i, m]
                invert(along, dim, inverse)
                for k in range(dim):
                    for m in range(dim):
                        kappa[i] -= bend[k, m] * inverse[m, k]
    return kappa


@njit(cache=True)
def _add_turn(offset, normals, i, others, j, volume, kind, support, along, bend):
    """Adds w P d (x) P d to `along` and w P (n_j - n_i) (x) P d to `bend`; returns the trace of the first. n_i is
    normals[i], n_j is others[j]."""
    dim = len(offset)
    r2, up, turned = 0.0, 0.0, 0.0
    for k in range(dim):
        r2 += offset[k] ** 2
        up += offset[k] * normals[i, k]
        turned += others[j, k] * normals[i, k]
    if r2 == 0.0:
        return 0.0
    r = math.sqrt(r2)
    w = volume * slope(kind, r / support) / r
    for m in range(dim):
        d = w * (offset[m] - up * normals[i, m])
        for k in range(dim):
            along[k, m] += (offset[k] - up * normals[i, k]) * d
            bend[k, m] += (others[j, k] - turned * normals[i, k]) * d
    return w * (r2 - up * up)


@njit(cache=True, parallel=True)
def _jump(start, column, grad, lap, colour, kappa, strength, tension):
    n, dim = len(start) - 1, grad.shape[1]
    out, lift = np.zeros((n, dim)), np.zeros(n)
    for i in prange(n):
        for p in range(start[i], start[i + 1]):
            j = column[p]
            if colour[j] != colour[i]:
                both = strength[i] + strength[j]
                if both > 0.0:
                    jump = tension * (strength[i] * kappa[i] + strength[j] * kappa[j]) / both * (colour[j] - colour[i])
                    lift[i] += lap[p] * jump
                    for k in range(dim):
                        out[i, k] += grad[p, k] * jump
    return out, lift
