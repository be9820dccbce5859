"""Steady creeping flow on the fixed lattice: one coupled solve for velocity and pressure (design.md 8).

    -nu lap u + grad p / rho = f,        div u + S p = 0

in the scaled unknowns u and P = p dx / (rho nu), each equation multiplied by dx^2 / nu and dx, so that all entries
are of order one whatever the units. S damps the odd-even pressure mode: see `coupling`.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from .coupling import divergence_and_jump
from .linear import BlockCycle, ComponentMeans, SolveError, assemble, components, cycle, gmres, hierarchy
from .operators import gradient_p

TAU = 0.05  # strength of S, measured in design.md 8
# The Schur complement falls from 1 for long pressure modes to 0.2 for those that alternate from particle to particle,
# where little but S is left. Its inverse is 1 - ROUGH dx^2 lap to within 30 % on a lattice.
ROUGH = 0.4
# Aggregates of the velocity hierarchy and W-cycles an iteration, from 16 to 64 spacings a cell of the sphere array:
# 14 to 16 iterations; one cycle 16 to 19; with the strength of `linear` 15 to 18 and 18 to 21
STRENGTH, CYCLES = 0.05, 2


@dataclass(frozen=True)
class StokesFlow:
    """velocity: (n, dim) m/s; pressure: (n,) Pa over density, i.e. m2/s2; report: linear.Report."""

    velocity: np.ndarray
    pressure: np.ndarray
    report: object


class StokesSystem:
    """Matrices of one lattice; every right-hand side shares them.

    ops: Operators with walls (without them no steady flow exists); x: (n_rows, dim) table of positions;
    spacing: m; viscosity: kinematic, m2/s;
    conservative: take the divergence as a balance of fluxes, on lattices only (see `coupling`).
    """

    def __init__(self, ops, x, spacing, viscosity, tau=TAU, conservative=True):
        walls = ops.walls
        self.ops, self.x, self.row, self.natural = ops, x, walls.row, walls.natural
        self.spacing, self.viscosity, self.tau = spacing, viscosity, tau
        self.dim = ops.grad.shape[1]
        self.conservative = conservative
        self.wall_lap, self.wall_div, self.slip = walls.lap, walls.div, walls.slip
        self.count, labels = components(ops.start, ops.column)
        self.means = ComponentMeans(labels)
        matrix = assemble(ops.start, ops.column, ops.lap, 0.0, spacing**2, self.wall_lap)
        self._velocity = BlockCycle(hierarchy(matrix, STRENGTH), CYCLES)
        self._darcy = cycle(hierarchy(self._conductance()))

    def _conductance(self):
        """-div(w grad) of the pressure, w the response of the velocity to a unit force without pressure.

        In a pore of width h, w is about h^2 / 12: pressure modes much longer than the pore is wide obey Darcy's law,
        and the Schur complement of the coupled system is this operator there, the identity for short modes.
        """
        o = self.ops
        w = np.maximum(self._velocity(np.ones((o.n, 3)))[:, 0], 1e-3)
        pair = _harmonic(o.start, o.column, w)
        return assemble(o.start, o.column, self.natural * pair, 0.0, self.spacing**2)

    def split(self, v):
        """(velocity (n, dim), scaled pressure (n,)) of a vector of unknowns."""
        n = self.ops.n
        return v[: n * self.dim].reshape(n, self.dim), v[n * self.dim :]

    def apply(self, v):
        """The coupled matrix times v, pressures without their means (eq. 25)."""
        u, p = self.split(v)
        out = np.empty_like(v)
        momentum, mass = self.split(out)
        o = self.ops
        grad_p = np.empty((o.n, self.dim))
        _momentum(o.start, o.column, o.lap, o.grad_p, self.wall_lap, self.spacing, u, p, momentum, grad_p)
        if self.slip is not None:
            momentum -= self.spacing**2 * np.einsum("nkm,nm->nk", self.slip, u)
        dx = self.spacing
        both = divergence_and_jump(o, self.x, self.row, self.natural, self.wall_div, u, p, grad_p,
                                   dx, -self.tau * dx * dx, self.conservative)
        mass[:] = self.means.remove(both)
        return out

    def precondition(self, v):
        """Block-triangular: the inverse Schur complement as the sum of its limits (Cahouet and Chabard), for short
        modes 1 - ROUGH dx^2 lap and for long ones Darcy's law; then W-cycles for all velocity components at once."""
        momentum, mass = self.split(v)
        out = np.empty_like(v)
        u, p = self.split(out)
        o, dx = self.ops, self.spacing
        mass = self.means.remove(mass)
        p[:] = mass + self.means.remove(self._darcy(mass) - ROUGH * dx * dx * _sum(o.start, o.column, self.natural, mass))
        rest = np.zeros((o.n, 3))
        rest[:, : self.dim] = momentum - dx * gradient_p(o, p)
        u[:] = self._velocity(rest)[:, : self.dim]
        return out

    def drive(self, force):
        """The acceleration `force` (dim,) as the gradient of its potential in the pressure's own operator, (n, dim).

        It is `force` itself where fluid neighbours lie in all directions. In a pore one particle wide no pressure can
        balance the part across it, and in a pocket of one particle none at all: there that part is left out, and fluid
        at rest stays at rest.
        """
        o = self.ops
        return _potential_gradient(o.start, self.row, self.x, o.grad_p, np.asarray(force, float))

    def solve(self, force, tolerance, restart=60, max_iterations=400, watch=None):
        """Flow under the acceleration `force` ((dim,), m/s2) and the motion of the walls.

        Where the tolerance is missed, the divergence becomes a balance of fluxes (if it was not), then the restart
        length is doubled, then SolveError is raised.
        """
        n, walls = self.ops.n, self.ops.walls
        rhs = np.zeros(n * (self.dim + 1))
        momentum, mass = self.split(rhs)
        momentum[:] = self.drive(force) * (self.spacing**2 / self.viscosity)
        momentum += self.spacing**2 * walls.lap_velocity
        if not self.conservative:  # walls move along themselves: no flux passes them
            mass[:] = self.means.remove(-self.spacing * walls.div_velocity)
        solution, report = gmres(self.apply, rhs, self.precondition, tolerance, restart, max_iterations, watch=watch)
        if not report.converged and not self.conservative:
            # pores that the lattice does not resolve: only a balance of fluxes is well posed there
            self.conservative = True
            mass[:] = 0.0
            solution, report = gmres(self.apply, rhs, self.precondition, tolerance, restart, max_iterations,
                                     watch=watch)
        if not report.converged:
            solution, report = gmres(self.apply, rhs, self.precondition, tolerance, 2 * restart,
                                     2 * max_iterations, start=solution, watch=watch)
        if not report.converged:
            raise SolveError("Stokes", report)
        u, p = self.split(solution)
        return StokesFlow(u.copy(), self.means.remove(p) * (self.viscosity / self.spacing), report)


@njit(cache=True, parallel=True)
def _momentum(start, column, lap, grad_p, wall_lap, dx, u, p, momentum, gradient):
    """-dx^2 lap u + dx grad P into momentum; grad P into gradient."""
    n, dim = u.shape
    for i in prange(n):
        for k in range(dim):
            momentum[i, k] = wall_lap[i] * u[i, k]
            gradient[i, k] = 0.0
        for q in range(start[i], start[i + 1]):
            j = column[q]
            dp = p[j] - p[i]
            for k in range(dim):
                momentum[i, k] -= lap[q] * (u[j, k] - u[i, k])
                gradient[i, k] += grad_p[q, k] * dp
        for k in range(dim):
            momentum[i, k] = dx * dx * momentum[i, k] + dx * gradient[i, k]


@njit(cache=True, parallel=True)
def _sum(start, column, weight, f):
    """sum_j weight_ij (f_j - f_i), (n,)."""
    out = np.zeros(len(f))
    for i in prange(len(f)):
        for q in range(start[i], start[i + 1]):
            out[i] += weight[q] * (f[column[q]] - f[i])
    return out


@njit(cache=True, parallel=True)
def _harmonic(start, column, w):
    """Harmonic means of w over the pairs, (n_pairs,)."""
    out = np.empty(len(column))
    for i in prange(len(w)):
        for q in range(start[i], start[i + 1]):
            out[q] = 2.0 * w[i] * w[column[q]] / (w[i] + w[column[q]])
    return out


@njit(cache=True, parallel=True)
def _potential_gradient(start, row, x, grad_p, force):
    n, dim = len(start) - 1, len(force)
    out = np.zeros((n, dim))
    for i in prange(n):
        for q in range(start[i], start[i + 1]):
            rise = 0.0
            for k in range(dim):
                rise += force[k] * (x[row[q], k] - x[i, k])
            for k in range(dim):
                out[i, k] += grad_p[q, k] * rise
    return out
