"""Eq. 2: the velocity u* before the projection, implicit in the viscous terms.

    (g0 / dt - nu lap) u* = right

One matrix serves all components, unless slip walls or the transposed stress of two fluids couple them.

Eq. 6 is exact for quadratic functions, and of those of fourth order it makes L f = lap f + c lap lap f: waves of 32
spacings are damped 1 % too slowly in 3D. The same pairs give lap f = (1 + c L)^-1 L f to the fourth order (Collatz's
Mehrstellenverfahren, for particles), so that

    (1 + c L) (g0 / dt u* - right) = nu L u*,      c_i = sum_j L_ij r_ij^4 / (8 dim (dim + 2)),

which is the same matrix with nu - c g0 / dt in the place of nu, and right + c L right on the right. c is zero beside
walls, where `right` has no values on the other side, and in scenes of two fluids (`operators/fourth_order.py`). Forces
that resist (`flow/forces.py`) add their drag to g0 / dt on the left; with them c is left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from ..operators import pair_sums
from ..operators.assemble import assemble, row_sums
from ..solvers.kept_hierarchies import RETRY_FACTOR, KeptHierarchies
from ..solvers.krylov import Apply, Convergence

if TYPE_CHECKING:
    from .one_fluid import Terms

JACOBI_LIMIT = 2.0  # nu dt / dx^2 up to which the matrix is solved with its diagonal alone


def viscous_solve(terms: Terms, nu_max: float, spacing: float, rate: float, driven: np.ndarray, guess: np.ndarray,
                  solvers: KeptHierarchies, walls_move: bool = True) -> np.ndarray:
    """u* (n, dim), m/s, of eq. 2. Raises SolveError.

    terms: of the configuration; nu_max: largest kinematic viscosity, m2/s; spacing: m; rate: g0 / dt, 1/s; driven:
    (n, dim) m/s2, the right-hand side without what walls drag along; guess: (n, dim) m/s; walls_move: whether they do.
    """
    viscous, walls = terms.viscous, terms.viscous.walls
    slip = walls.slip if walls is not None else None
    stiff = nu_max > JACOBI_LIMIT * rate * spacing**2
    right = terms.sharpened(driven)
    if walls is not None and walls_move:
        dragged = viscous.factor * walls.lap_velocity
        right, driven = right + dragged, driven + dragged
    if not stiff:
        guess = driven / rate  # the explicit step, which viscosity then changes little
    coupled = slip is not None or terms.transposed_stress is not None
    if not stiff and not coupled:
        found, convergence = _by_pairs(terms, rate, right, guess, solvers)
        if convergence.converged:
            solvers.record("velocity", convergence, lambda: np.zeros(len(right)))
            return found
    if coupled:
        return _coupled(terms, rate, slip, right, guess, stiff, solvers)
    matrix, exchange = _matrix(terms, rate, solvers), terms.ops.exchange

    def product(v: np.ndarray) -> np.ndarray:
        return matrix @ exchange.forward(v)

    out = np.empty_like(right)
    for k in range(right.shape[1]):
        with solvers.clock("krylov"):
            b, x0 = np.ascontiguousarray(right[:, k]), np.ascontiguousarray(guess[:, k])
            out[:, k], convergence = solvers.multigrid("velocity", matrix, product, b, x0, exchange=exchange)
        solvers.record("velocity", convergence, lambda k=k: right[:, k] - product(out[:, k]))  # type: ignore[misc]
    return out


def _shift_and_scale(terms: Terms, rate: float) -> tuple[float | np.ndarray, float | np.ndarray]:
    """What stands before u* and before the weights of the viscous term on the left of eq. 2, numbers or (n,)."""
    scale = terms.viscous.factor if terms.excess is None else terms.viscous.factor - rate * terms.excess
    return (rate if terms.drag is None else rate + terms.drag), scale


def _matrix(terms: Terms, rate: float, solvers: KeptHierarchies) -> sp.csr_matrix:
    """g0 / dt - nu lap of one component, walls included."""
    ops, viscous, walls = terms.ops, terms.viscous, terms.viscous.walls
    with solvers.clock("assembly"):
        shift, scale = _shift_and_scale(terms, rate)
        wall_lap = viscous.factor * walls.lap if walls is not None else None
        weights = viscous.weight * (np.repeat(scale, np.diff(ops.start)) if isinstance(scale, np.ndarray) else scale)
        return assemble(ops.start, ops.column, weights, shift, 1.0, wall_lap, ops.exchange.remote)


def _factors(terms: Terms, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(own, less, diagonal), (n,) each: the product of `_matrix` with u is own u + less L u, with the weights of L."""
    viscous, walls = terms.viscous, terms.viscous.walls
    shift, scale = (np.full(terms.ops.n, part, float) for part in _shift_and_scale(terms, rate))
    own = shift if walls is None else shift + viscous.factor * walls.lap
    return own, -scale, own + scale * row_sums(terms.ops.start, viscous.weight)


def _by_pairs(terms: Terms, rate: float, right: np.ndarray, guess: np.ndarray,
              solvers: KeptHierarchies) -> tuple[np.ndarray, Convergence]:
    """All components at once with the weights of the pairs, preconditioned by the diagonal: a matrix would be made for
    three or four products."""
    ops, viscous, (n, dim) = terms.ops, terms.viscous, right.shape
    with solvers.clock("assembly"):
        own, less, diagonal = _factors(terms, rate)
        inverse = np.repeat(1.0 / diagonal, dim)

    def apply(v: np.ndarray) -> np.ndarray:
        u = ops.exchange.forward(v.reshape(n, dim))
        return pair_sums.laplacian(ops.start, ops.column, viscous.weight, u, own, less).ravel()

    with solvers.clock("krylov"):
        found, convergence = solvers.krylov(apply, right.ravel(), lambda v: inverse * v,
                                            np.ascontiguousarray(guess).ravel())
    return found.reshape(n, dim), convergence


def _coupled(terms: Terms, rate: float, slip: np.ndarray | None, right: np.ndarray, guess: np.ndarray, stiff: bool,
             solvers: KeptHierarchies) -> np.ndarray:
    """All components at once; the preconditioner leaves their coupling out.

    Every row is divided by its diagonal: where viscosities differ by 1e4, the residual of the more viscous fluid would
    hide that of the other.
    """
    n, dim = right.shape
    ops, viscous, transposed_stress, exchange = terms.ops, terms.viscous, terms.transposed_stress, terms.ops.exchange
    with solvers.clock("assembly"):
        own, less, parts = _factors(terms, rate)
        diagonal = parts[:, None]

    def apply(v: np.ndarray) -> np.ndarray:
        u = v.reshape(n, dim)
        everyone = exchange.forward(u)
        out = pair_sums.laplacian(ops.start, ops.column, viscous.weight, everyone, own, less)
        if slip is not None:
            out -= viscous.factor * np.einsum("nkm,nm->nk", slip, u)
        if transposed_stress is not None:
            transposed_stress.add(everyone, out, -1.0)
        out /= diagonal
        return out.ravel()

    def by_component(once: Apply) -> Apply:
        def precondition(v: np.ndarray) -> np.ndarray:
            parts = v.reshape(n, dim) * diagonal
            return np.stack([once(np.ascontiguousarray(parts[:, k])) for k in range(dim)], axis=1).ravel()

        return precondition

    scaled = (right / diagonal).ravel()
    with solvers.clock("krylov"):
        if stiff:
            matrix = _matrix(terms, rate, solvers)
            solution, convergence = solvers.multigrid("velocity", matrix, apply, scaled, guess.ravel(), by_component,
                                                 exchange=exchange)
        else:
            for effort in (1, RETRY_FACTOR):
                solution, convergence = solvers.krylov(apply, scaled, np.copy, guess.ravel(), effort)
                if convergence.converged:
                    break
    solvers.record("velocity", convergence, lambda: np.abs(scaled - apply(solution)).reshape(n, dim).max(axis=1))
    return solution.reshape(n, dim)
