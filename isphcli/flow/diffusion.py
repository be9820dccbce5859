"""Steady diffusion (or electric current) through the fluid on the fixed lattice, walls insulating: one scalar solve.

    div v = 0,        v = E - grad phi,        v . n = 0 at walls

with the gradient and the divergence of the pressure, the odd-even mode damped as there (`operators.div_grad`). What
passes an axis, over what would pass a box without solids, is the effective diffusivity over that of the fluid.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..geometry.wall_normals import wall_normals
from ..operators.conductances import Conductances
from ..operators.lattice_weights import LatticeWeights, divergence_and_rhie_chow
from ..solvers.engine import ONE_PROCESS, Engine
from ..solvers.krylov import Limits, Maps, SolveError, Watch

if TYPE_CHECKING:
    from ..domain.null_space import ComponentMeans
    from ..geometry.protocol import Geometry


class DiffusionSystem:
    """The scalar system of one lattice; every axis shares it.

    ops: LatticeWeights; x: (n, dim) m, of the fluid particles; spacing: m; means: of the connected components;
    engine: what solves the linear systems.
    """

    def __init__(self, ops: LatticeWeights, geometry: Geometry, x: np.ndarray, spacing: float, means: ComponentMeans,
                 engine: Engine = ONE_PROCESS):
        self.engine = engine
        self.ops, self.spacing, self.means = _insulated(ops, geometry, x, spacing), spacing, means
        self._cycle = engine.cycle(Conductances(ops, np.ones(ops.n), spacing), ops.exchange)

    def apply(self, phi: np.ndarray) -> np.ndarray:
        """-dx^2 (div grad phi + S phi), (n,)."""
        gradient = self.ops.gradient_p(phi)
        area = self.spacing**2
        return self.means.remove(-divergence_and_rhie_chow(self.ops, gradient, (phi, gradient), (area, area)))

    def precondition(self, rhs: np.ndarray) -> np.ndarray:
        """Multigrid cycles of the symmetric Laplacian."""
        return self.means.remove(self._cycle(self.means.remove(rhs)))

    def solve(self, axis: int, limits: Limits, watch: Watch | None = None) -> np.ndarray:
        """Flux v (n, dim) of a unit gradient along an axis, over the diffusivity of the fluid. Raises SolveError."""
        unit = np.zeros(self.ops.dim)
        unit[axis] = 1.0
        field = self.ops.potential_gradient(unit)
        zero = np.zeros(self.ops.n)
        rhs = divergence_and_rhie_chow(self.ops, field, (zero, np.zeros_like(field)), (-self.spacing**2, 0.0))
        rhs = self.means.remove(rhs)
        # round-off of a field without sources, along straight walls, is no right-hand side
        if reduce.largest(np.abs(rhs)) <= 1e-9 * self.spacing:
            return field
        phi, convergence = self.engine.gmres(Maps(self.apply, self.precondition), rhs, limits, watch=watch)
        if not convergence.converged:
            raise SolveError("diffusion", convergence)
        return field - self.ops.gradient_p(phi)


def _insulated(ops: LatticeWeights, geometry: Geometry, x: np.ndarray, spacing: float) -> LatticeWeights:
    """The operators with walls that a flux runs along: of the divergence's wall part (eq. 11), which takes all of the
    velocity to the wall's, only what is normal to the wall."""
    div = ops.walls.div.copy()
    beside = np.nonzero(np.any(div != 0.0, axis=1))[0]
    normal = wall_normals(geometry, x[beside], spacing)
    div[beside] = np.einsum("nk,nk->n", div[beside], normal)[:, None] * normal
    return replace(ops, walls=replace(ops.walls, div=div))
