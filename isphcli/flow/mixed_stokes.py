"""Steady creeping flow of particles of two spacings: the coupled solve of `stokes`, rows scaled by their own spacing.

With u and q = p / (rho nu), rows times d^2 and d (d the spacing of the row), S of `operators.div_grad` times d^2. The
preconditioner is that of `stokes` too; its two matrices are those of the cells and their faces, symmetric as balances
over volumes are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..domain import reduce
from ..domain.components import pair_components
from ..operators import pair_sums
from ..operators.div_grad import div_grad_rhie_chow, div_grad_weights
from ..operators.mixed_weights import Faces
from ..operators.pair_weights import Operators
from ..solvers.engine import ONE_PROCESS, Engine
from ..solvers.krylov import Convergence, Limits, Maps, SolveError, Watch
from .stokes import LEAST_RESPONSE, ROUGH, STRENGTH, TAU


class MixedStokes:
    """The system of one set of particles.

    ops, faces: see `operators/mixed_weights.py`; d: (n,) spacings, m; spacing: the larger one, m; engine: what
    solves the linear systems.
    """

    def __init__(self, ops: Operators, faces: Faces, d: np.ndarray, spacing: float, engine: Engine = ONE_PROCESS):
        walls = ops.walls
        assert walls is not None
        self.ops, self.walls, self.d, self.spacing, self.engine = ops, walls, d, spacing, engine
        self.volume = ops.volume[: ops.n] / spacing**ops.dim
        count, self.labels = pair_components(ops.start, ops.column, exchange=ops.exchange)
        self.whole = reduce.total_by(self.labels, self.volume, count)
        resists = np.maximum(walls.lap, 0.0) * spacing**2 * self.volume
        self._velocity = engine.block_cycle(faces.conductance(np.ones(ops.n), resists), ops.exchange, STRENGTH)
        w = self._velocity(np.repeat(self.volume[:, None], 3, axis=1))[:, 0]
        w = np.maximum(w, LEAST_RESPONSE * (d / spacing) ** 2)
        self._darcy = engine.cycle(faces.conductance(w), ops.exchange)
        nothing = replace(ops, grad=np.zeros_like(ops.grad), walls=replace(walls, div=np.zeros_like(walls.div)))
        self._odd_even = div_grad_weights(nothing, walls.symmetric_laplacian)  # of -S alone

    def _without_means(self, v: np.ndarray) -> np.ndarray:
        """v (n,) without its mean over the volume of each component (eqs 25-26)."""
        return v - (reduce.total_by(self.labels, self.volume * v, len(self.whole)) / self.whole)[self.labels]

    def _split(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n, dim = self.ops.n, self.ops.dim
        return v[: n * dim].reshape(n, dim), v[n * dim :] / self.spacing

    def _joined(self, forces: np.ndarray, mass: np.ndarray) -> np.ndarray:
        return np.concatenate([forces.ravel(), mass])

    def apply(self, v: np.ndarray) -> np.ndarray:
        """The coupled matrix times (u, q spacing)."""
        (u, q), ops = self._split(v), self.ops
        everyone, pressures = ops.exchange.forward_each(u, q)
        grad = ops.gradient_with_remote(pressures)
        lap = pair_sums.laplacian(ops.start, ops.column, ops.lap, everyone) + self.walls.laplacian(u)
        mass = pair_sums.divergence(ops.start, ops.column, ops.grad, everyone) + self.walls.divergence(u)
        mass += TAU * self.d**2 * div_grad_rhie_chow(ops, self._odd_even, pressures, grad)
        return self._joined((grad - lap) * (self.d**2)[:, None], self.d * self._without_means(mass))

    def precondition(self, v: np.ndarray) -> np.ndarray:
        """See `StokesSystem.precondition`."""
        n, dim, ops = self.ops.n, self.ops.dim, self.ops
        forces, mass = v[: n * dim].reshape(n, dim), self._without_means(v[n * dim :] / self.d)
        rough = pair_sums.laplacian_of_scalar(ops.start, ops.column, self.walls.symmetric_laplacian,
                                              ops.exchange.forward(mass))
        q = mass + self._without_means(self._darcy(self.volume * mass) - ROUGH * self.d**2 * rough)
        rest = np.zeros((n, 3))
        rest[:, :dim] = (forces / (self.d**2)[:, None] - ops.gradient_p(q)) * self.volume[:, None]
        return self._joined(self._velocity(rest)[:, :dim] * self.spacing**2, q * self.spacing)

    def solve(self, force: np.ndarray, limits: Limits,
              watch: Watch | None = None) -> tuple[np.ndarray, np.ndarray, Convergence]:
        """(velocity (n, dim), its Laplacian (n, dim) by the balance of momentum, Convergence) under a force (dim,) over
        the viscosity. Raises SolveError."""
        ops = self.ops
        along = ops.potential_gradient(np.asarray(force, float))
        rhs = self._joined(along * (self.d**2)[:, None], np.zeros(ops.n))
        solution, convergence = self.engine.gmres(Maps(self.apply, self.precondition), rhs, limits, watch=watch)
        if not convergence.converged:
            raise SolveError("Stokes", convergence)
        u, q = self._split(solution)
        return u.copy(), ops.gradient_p(q) - along, convergence
