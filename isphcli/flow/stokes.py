"""Steady creeping flow on the fixed lattice: one coupled solve for velocity and pressure.

    -nu lap u + nu r u + grad p / rho = f,        div u + S p = 0

in the scaled unknowns u and P = p dx / (rho nu), each equation multiplied by dx^2 / nu and dx, so that all entries
are of order one whatever the units. S damps the odd-even pressure mode: see `operators.div_grad`. r is what resists the
fluid beside its viscosity, the inverse of a permeability (`flow/forces.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..domain import reduce
from ..domain.components import pair_components
from ..domain.null_space import ComponentMeans
from ..operators.conductances import Conductances, sparse_pairs
from ..operators.lattice_weights import (
    LatticeWeights,
    add_gradient_p,
    add_symmetric_laplacian,
    coupled,
    divergence_and_rhie_chow,
    nearest_matrix,
    share_in_sight,
    velocity_matrix,
)
from ..solvers.engine import ONE_PROCESS, Engine
from ..solvers.krylov import Convergence, Limits, Maps, SolveError, Watch
from .forces import Force, acceleration_of, resistance_of

# Strength of S, of which 0.05 to 0.1 take the fewest iterations; k is 0.04 to 0.44 % larger with 0.1, 0.02 to 0.33 %
# smaller with 0.025 (`benchmarks/odd_even_strength.py`, 2026-11-30)
TAU = 0.05
# The Schur complement falls from 1 for long pressure modes to 0.2 for those that alternate from particle to particle,
# where little but S is left. Its inverse is 1 - ROUGH dx^2 lap to within 30 % on a lattice.
ROUGH = 0.4
# The same for the Laplacian of nearest neighbours on a lattice, a fifth of the pairs, which is larger for short modes.
# Iterations of Berea 128^3, spheres 0.216 at 64 and the 64^3 corner: with ROUGH and all pairs 35, 24, 26; with 0.2
# 35, 23, 26; with this 34, 23, 26, the bead pack 59 for 58 (0.12 and 0.09: spheres 23, 24, the corner 26, 25;
# 2026-12-01, a script that is not kept)
ROUGH_NEAREST = 0.15
# Aggregates of the velocity hierarchy, from 16 to 64 spacings a cell of the sphere array: 16 to 19 iterations; with
# `multigrid.STRENGTH` 18 to 21
STRENGTH = 0.05
# Smallest response of the velocity to a unit force, in squares of the spacing: dead ends have a conductance too
LEAST_RESPONSE = 1e-3


@dataclass(frozen=True)
class StokesFlow:
    """velocity: (n, dim) m/s; pressure: (n,) Pa over density, i.e. m2/s2; convergence: of the solve."""

    velocity: np.ndarray
    pressure: np.ndarray
    convergence: Convergence


class StokesSystem:
    """Matrices of one lattice; every right-hand side shares them.

    ops: LatticeWeights (without walls no steady flow exists);
    spacing: m; viscosity: kinematic, m2/s; forces: at the particles x (n, dim), m, beside the force of each flow;
    engine: what solves the linear systems.
    """

    def __init__(self, ops: LatticeWeights, spacing: float, viscosity: float, forces: Sequence[Force] = (),
                 x: np.ndarray | None = None, engine: Engine = ONE_PROCESS):
        self.ops, self.spacing, self.viscosity = ops, spacing, viscosity
        self.dim, self.engine = ops.dim, engine
        self.acceleration = acceleration_of(forces, x) if x is not None else None
        self.resistance = resistance_of(forces, x) if x is not None else None
        self.drag = None if self.resistance is None else spacing**2 * self.resistance
        self.count, labels = pair_components(ops.start, ops.column, exchange=ops.exchange)
        self.means = ComponentMeans(labels, self.count)
        matrix = nearest_matrix(ops, spacing) if ops.on_lattice else velocity_matrix(ops, spacing)
        if self.drag is not None:
            own = np.arange(ops.n + 1)
            matrix = matrix + sp.csr_matrix((self.drag, own[:-1], own), shape=matrix.shape)
        self._velocity = engine.block_cycle(matrix, ops.exchange, STRENGTH)
        del matrix
        self._near, self._rough = (sparse_pairs(ops, spacing), ROUGH_NEAREST) if ops.on_lattice else (ops, ROUGH)
        self._darcy = engine.cycle(self._conductance(), ops.exchange)

    def _conductance(self) -> Conductances:
        """-div(w grad) of the pressure, w the response of the velocity to a unit force without pressure.

        In a pore of width h, w is about h^2 / 12: pressure modes much longer than the pore is wide obey Darcy's law,
        and the Schur complement of the coupled system is this operator there, the identity for short modes.

        In narrow pores, where the divergence is the adjoint of the pressure gradient, a linear pressure has its whole
        gradient by the few pairs in sight, and so much more of the velocity answers to each of them.
        """
        # of a strong drag w is its inverse
        least = LEAST_RESPONSE if self.drag is None else LEAST_RESPONSE / np.maximum(1.0, 1e-2 * self.drag)
        w = np.maximum(self._velocity(np.ones((self.ops.n, 3)))[:, 0], least)
        ops = self._near
        share = share_in_sight(ops)
        few = ops.narrow & (share > 0.0)
        w[few] /= share[few]
        return Conductances(ops, w, self.spacing)

    def split(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(velocity (n, dim), scaled pressure (n,)) of a vector of unknowns."""
        n = self.ops.n
        return v[: n * self.dim].reshape(n, self.dim), v[n * self.dim :]

    def apply(self, v: np.ndarray) -> np.ndarray:
        """The coupled matrix times v: eq. 1 without inertia, and the mass balance without its means (eq. 25)."""
        u, p = self.split(v)
        return self._apply(u, p, self.ops.gradient_p(p))

    def _apply(self, u: np.ndarray, p: np.ndarray, grad_p: np.ndarray) -> np.ndarray:
        """The same of the parts of v, with the gradient (n, dim) of the pressure."""
        out, dx = np.empty(self.ops.n * (self.dim + 1)), self.spacing
        forces, mass = self.split(out)
        # eq. 1 without inertia; dx div u - tau dx^2 S p
        coupled(self.ops, u, (p, grad_p), (dx, dx, -TAU * dx * dx), (forces, mass))
        if self.ops.walls.slip is not None:
            forces -= dx**2 * np.einsum("nkm,nm->nk", self.ops.walls.slip, u)
        if self.drag is not None:
            forces += self.drag[:, None] * u
            mass += self._less_odd_even(self.drag, u, p, grad_p)
        self.means.remove(mass, out=mass)  # eq. 25
        return out

    def _less_odd_even(self, drag: np.ndarray, u: np.ndarray, p: np.ndarray, grad_p: np.ndarray) -> np.ndarray:
        """What -tau dx^2 S p, (n,), becomes less by where a drag holds the fluid back: pressure moves it as much less.
        tau is 1 / the diagonal of -dx^2 lap, which the drag adds to."""
        factors, held = (0.0, -TAU * self.spacing**2), TAU * drag
        return divergence_and_rhie_chow(self.ops, u, (p, grad_p), factors) * (-held / (1.0 + held))

    def laplacian(self, flow: StokesFlow, force: Sequence[float] | np.ndarray) -> np.ndarray:
        """Laplacian (n, dim) of the velocity of a flow under `force`, 1/(m s), by the balance of momentum."""
        found = (self.ops.gradient_p(flow.pressure) - self._driven(force)) / self.viscosity
        return found if self.resistance is None else found + self.resistance[:, None] * flow.velocity

    def _driven(self, force: Sequence[float] | np.ndarray) -> np.ndarray:
        """(n, dim) m/s2 of a force (dim,) and those that act beside it."""
        along = self.balanced_force(force)
        return along if self.acceleration is None else along + self.acceleration

    def precondition(self, v: np.ndarray) -> np.ndarray:
        """Block-triangular: the inverse Schur complement as the sum of its limits (Cahouet and Chabard), for short
        modes 1 - ROUGH dx^2 lap and for long ones Darcy's law; then cycles for all velocity components at once."""
        u, p, _ = self._precondition(v)
        return np.concatenate([u.ravel(), p])

    def product(self, v: np.ndarray) -> np.ndarray:
        """`apply` of `precondition`, which both need the gradient of the same pressure."""
        return self._apply(*self._precondition(v))

    def _precondition(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The velocities (n, dim) and pressures (n,) of `precondition`, and the gradient (n, dim) of the pressures."""
        (forces, mass), dx = self.split(v), self.spacing
        mass = self.means.remove(mass)
        p = self._darcy(mass)
        add_symmetric_laplacian(self._near, -self._rough * dx * dx, mass, p)
        self.means.remove(p, out=p)
        p += mass
        grad_p, left = np.empty_like(forces), np.empty_like(forces)
        add_gradient_p(self.ops, -dx, p, forces, (grad_p, left))
        if self.dim < 3:
            left = np.hstack([left, np.zeros((self.ops.n, 3 - self.dim))])
        return self._velocity(left)[:, : self.dim], p, grad_p

    def balanced_force(self, force: Sequence[float] | np.ndarray) -> np.ndarray:
        """The acceleration `force` (dim,) as the gradient of its potential in the pressure's own operator, (n, dim).

        It is `force` itself where fluid neighbours lie in all directions. In a pore one particle wide no pressure can
        balance the part across it, and in a pocket of one particle none at all: there that part is left out, and fluid
        at rest stays at rest.
        """
        return self.ops.potential_gradient(np.asarray(force, float))

    def solve(self, force: Sequence[float] | np.ndarray, limits: Limits, watch: Watch | None = None) -> StokesFlow:
        """Flow under the acceleration `force` ((dim,), m/s2) and the motion of the walls.

        Where the tolerance is missed the restart length is doubled, then SolveError is raised; its attribute
        `violation` is the residual of each particle, (n,), over the largest right-hand side.
        """
        ops = self.ops
        rhs = np.zeros(ops.n * (self.dim + 1))
        forces, mass = self.split(rhs)
        forces[:] = self._driven(force) * (self.spacing**2 / self.viscosity)
        forces += self.spacing**2 * ops.walls.lap_velocity
        mass[:] = self.means.remove(-self.spacing * ops.walls.div_velocity)
        maps = Maps(self.apply, self.precondition, self.product)
        solution, convergence = self.engine.gmres(maps, rhs, limits, watch=watch)
        if not convergence.converged:
            solution, convergence = self.engine.gmres(maps, rhs, limits.times(2), solution, watch)
        if not convergence.converged:
            error = SolveError("Stokes", convergence)
            forces, mass = self.split(np.abs(rhs - self.apply(solution)) / reduce.largest(np.abs(rhs)))
            error.violation = np.maximum(forces.max(axis=1), mass)
            raise error
        u, p = self.split(solution)
        return StokesFlow(u.copy(), self.means.remove(p) * (self.viscosity / self.spacing), convergence)
