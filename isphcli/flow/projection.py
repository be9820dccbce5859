"""Eqs 3-4: the pressure increment that makes the velocity divergence-free, and the new pressure.

    div (grad q) = (g0 rho / dt) div u*,   u = u* - dt grad q / (g0 rho)         (eq. 3)
    p <- p + q - nu rho div u*                                                    (eq. 4, rotational form)

p is the periodic part of the pressure. A pressure gradient that drives the flow is the rest of it, a potential that no
periodic box holds. Where densities differ the whole pressure has a kink at an interface, and so has p, which neither of
its parts is without: what is asked of a pressure there is asked of both parts together (`DrivingPressure`).

Pressures are divided by the density of the first fluid (m2/s2). Another projection, P of eqs 25-26, takes the constants
out of the system for q: `ComponentMeans` of `domain/null_space.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..domain import reduce
from ..operators.assemble import assemble_near, row_sums
from ..solvers.kept_hierarchies import KeptHierarchies
from ..solvers.krylov import Apply

if TYPE_CHECKING:
    from ..operators.div_grad import DivGrad
    from .one_fluid import Terms
    from .state import Configuration

# Part of a row's weights below which a pair is left out of the matrix that preconditions: at a support of 2.1 spacings
# the 14 farthest of 32 neighbours, which have 3 % of the weights together
LEAST_WEIGHT = 0.01
# Fraction of the odd-even part of the pressure that is removed in a step where there is an interface: eigenvalues of A
# are at most twice its diagonal, so that a half over-corrects no mode
ODD_EVEN_REMOVED = 0.5
# Of |A p|: the right-hand side of eq. 3 is a difference of terms of that size, and below this part of it is round-off
ROUND_OFF = 1e-14


class DrivingPressure(NamedTuple):
    """The potential whose gradient drives the flow: the pressure is p less that potential.

    acceleration: (n, dim) m/s2, of the fluid of each particle; image: (n,) 1/s2, A of the potential.
    """

    acceleration: np.ndarray
    image: np.ndarray


@dataclass(frozen=True)
class PressureSystem:
    """The matrix A of eq. 3, which stands for -div grad.

    A is minus the Laplacian of eq. 6 without walls. Beside walls the divergence sees the wall and the pressure gradient
    does not: there the two differ so much that a correction by the Laplacian overshoots and the pressure grows from
    step to step. Scenes with walls therefore take div grad itself, the odd-even mode added, preconditioned by the
    Laplacian.

    laplacian: (n, n + remote) matrix of the preconditioner, without the pairs of the least weights; apply(p): A p of a
    pressure p (n,), with its gradient (n, dim) where that is known: without walls nothing reads it; scale: (n,) by what
    the diagonal of A exceeds that of the Laplacian, or None; weights: of A beside walls, or None; driving: of the step,
    where densities differ, or None.
    """

    laplacian: sp.csr_matrix
    apply: Callable[..., np.ndarray]
    scale: np.ndarray | None
    weights: DivGrad | None = None
    driving: DrivingPressure | None = None


def pressure_system(config: Configuration, solvers: KeptHierarchies) -> PressureSystem:
    """The matrix of eq. 3 of a configuration."""
    ops, terms = config.ops, config.terms
    with solvers.clock("assembly"):
        # weights before densities divide them: the same pairs are left out on both sides of an interface
        sizes = ops.lap_p
        lap_p = sizes if terms.ops is ops else terms.ops.lap_p
        matrix = assemble_near(ops.start, ops.column, lap_p, sizes, LEAST_WEIGHT, ops.exchange.remote)
        own = np.empty(0) if ops.walls is None else row_sums(ops.start, lap_p)
        del sizes, lap_p  # beside walls nobody else has them
    if ops.walls is None:  # eq. 3 by the Laplacian of eq. 6
        return PressureSystem(matrix, lambda p, gradient=None: -terms.ops.laplacian_p(p), None)
    from ..operators.div_grad import diagonal, div_grad_rhie_chow, div_grad_weights

    assert terms.ops.walls is not None
    with solvers.clock("assembly"):
        weights = div_grad_weights(ops, terms.ops.walls.symmetric_laplacian, terms.density)
        exact = diagonal(ops, weights, terms.ops.grad_p)
        scale = np.where(exact > own, exact / np.where(own > 0.0, own, 1.0), 1.0)

    def apply(p: np.ndarray, gradient: np.ndarray | None = None) -> np.ndarray:
        p = ops.exchange.forward(p)
        return div_grad_rhie_chow(ops, weights, p, terms.ops.gradient_with_remote(p) if gradient is None else gradient)

    return PressureSystem(matrix, apply, scale, weights)


def driving_pressure(config: Configuration, system: PressureSystem, slope: np.ndarray) -> DrivingPressure:
    """The DrivingPressure of a gradient that accelerates the first fluid by slope (dim,), m/s2."""
    ops, terms = config.ops, config.terms
    acceleration, image = terms.ops.potential_gradient(slope), -laplacian_of_potential(terms, slope)
    if system.weights is not None:
        from ..operators.div_grad import div_grad_rhie_chow

        image += div_grad_rhie_chow(ops, system.weights, np.zeros(ops.n + ops.exchange.remote), acceleration)
    return DrivingPressure(acceleration, image)


def laplacian_of_potential(terms: Terms, slope: np.ndarray) -> np.ndarray:
    """The Laplacian of eq. 3, (n,) 1/s2, of the potential slope . x: of its differences over the pairs, as
    `DiscreteOperators.potential_gradient`. slope: (dim,) m/s2."""
    ops = terms.ops
    potential, neighbours = ops.neighbours.x @ slope, ops.neighbours
    across = ops.lap_p if ops.walls is None else ops.walls.symmetric_laplacian
    rise = potential[neighbours.row] - np.repeat(potential[: ops.n], np.diff(ops.start))
    return row_sums(ops.start, across * rise)


def pressure_increment(config: Configuration, system: PressureSystem, div: np.ndarray,
                       pressure: tuple[np.ndarray, np.ndarray], rate: float, nu_min: float,
                       solvers: KeptHierarchies) -> tuple[np.ndarray, np.ndarray]:
    """The increment q (n,) of  A q = -w (A + div grad) p - rate div u*  (eq. 3), with the constant of each component
    projected out (eqs 25-26), and what is added to the pressure beside it. Raises SolveError.

    Where there is an interface the odd-even part of p is left out of that system: it is subtracted from the pressure,
    row by row, and changes no velocity. The viscous force jumps at an interface, by the ratio of viscosities. A
    gradient over neighbours on both sides can balance that only with a pressure that is odd-even beside it; solved for,
    it would be a divergence, dt times the jump, and the rows beside a meniscus that is pushed through a tube would
    carry other fluxes than the rest.

    div: (n,) of u*, 1/s; pressure: p (n,) and its gradient (n, dim); rate: g0 / dt, 1/s; nu_min: smallest kinematic
    viscosity, m2/s.
    """
    with solvers.clock("krylov"):
        old, gradient = system.apply(*pressure), pressure[1]
        # eq. 3 for the increment, and the odd-even part of the old pressure taken out
        whole, image = gradient, old
        if system.driving is not None:
            whole, image = gradient - system.driving.acceleration, old - system.driving.image
        odd_even, beside = _odd_even(config, whole, image, rate, nu_min), np.zeros(len(div))
        if config.terms.interface is not None:
            own = system.laplacian.diagonal() * (1.0 if system.scale is None else system.scale)
            odd_even, beside = beside, ODD_EVEN_REMOVED * np.divide(odd_even, own, out=beside.copy(), where=own > 0.0)
        right = config.means.remove(odd_even - rate * div)
        # a small increment is the difference of large pressures: no solve is more exact than their round-off
        size, floor = (float(np.sqrt(square)) for square in reduce.totals(right * right, old * old))
        floor *= ROUND_OFF
        if size <= floor:
            right[:] = 0.0
        tolerance = max(solvers.tolerance, floor / size) if size > 0.0 else solvers.tolerance
    return solve_pressure(config, system, right, tolerance, solvers), beside


def solve_pressure(config: Configuration, system: PressureSystem, right: np.ndarray, tolerance: float,
                   solvers: KeptHierarchies) -> np.ndarray:
    """q (n,) of A q = right without the constant of each component (eqs 25-26). Raises SolveError."""
    means, scale = config.means, system.scale

    def apply(q: np.ndarray) -> np.ndarray:
        return means.remove(system.apply(q))  # eq. 25: P A q

    def remove_constants(once: Apply) -> Apply:
        return lambda v: means.remove(once(v if scale is None else means.remove(v / scale)))

    with solvers.clock("krylov"):
        q, convergence = solvers.multigrid("pressure", system.laplacian, apply, right, None, remove_constants,
                                           tolerance, config.ops.exchange)
    solvers.record("pressure", convergence, lambda: right - apply(q))
    return means.remove(q)  # eq. 26


def without_constants(config: Configuration, p: np.ndarray) -> np.ndarray:
    """A pressure p (n,) without the constant of each component; in dead ends that of the fluid next to them."""
    p, walls = config.means.remove(p), config.ops.walls
    if walls is not None and walls.dead_ends:
        from ..operators.narrow_pores import extrapolate_pressure

        extrapolate_pressure(config.ops, p)
    return p


def _odd_even(config: Configuration, gradient: np.ndarray, old: np.ndarray, rate: float,
              nu_min: float) -> np.ndarray:
    """-w (A + div grad) p of `pressure_increment`, (n,), which damps the odd-even part of the pressure.
    gradient: (n, dim) of p, what drives the flow included; old: (n,) A p, the same.

    w is the share of inertia in the resistance of a particle to a force, rate / (rate + nu sum_j lap_ij), nu that of
    the less viscous fluid. Without this term the odd-even part of p, which A sees and the gradient does not, stays from
    step to step, hardly damped: in layers of density ratio 100 at rest it grows by 5 % a step, whatever the length of
    the step, and a drop of density ratio 1000 blows up. Where drag sets the speed there is nothing to damp, and w = 1
    would keep the pressure from growing to what balances it.
    """
    ops, terms = config.ops, config.terms
    odd_even, drag = -ops.total_divergence(gradient) - old, row_sums(ops.start, ops.lap)
    if ops.walls is not None:
        odd_even += ops.walls.div_velocity
        drag += ops.walls.lap
    if terms.laplacian_of_jump is not None:
        odd_even -= terms.laplacian_of_jump
    return odd_even * (rate / (rate + nu_min * drag))
