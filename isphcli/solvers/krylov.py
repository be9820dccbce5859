"""GMRES from either side, and what a solve reports. Constants are projected out by `domain.components` (eqs 25-26)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.sparse.linalg as sla
from scipy.linalg import solve_triangular

from ..domain import reduce
from .krylov_basis import KrylovBasis

Apply = Callable[[np.ndarray], np.ndarray]  # a linear map of vectors (m,)
Watch = Callable[[int, float], None]  # told of each iteration and its relative residual


class SolveError(RuntimeError):
    """A linear system that missed its tolerance. Attributes: system, report; violation: (n,) residual of each particle,
    or None; worst: the file of the particles of the largest ones, or None."""

    violation: np.ndarray | None = None
    worst: Path | None = None

    def __init__(self, system: str, report: Report):
        self.system, self.report = system, report
        # a steady solve has no time step, and what it fails on are pores that the lattice does not resolve
        advice = "a smaller particles.spacing" if system == "Stokes" else "smaller time steps (time.step or time.cfl)"
        super().__init__(
            f"the {system} system did not converge: residual {report.residual:.2e} after {report.iterations} "
            f"iterations (asked: {report.tolerance:.1e}; {report.reason}); try a larger solver.max_iterations, "
            f"{advice} or a larger solver.tolerance"
        )


class Limits(NamedTuple):
    """Where a solve ends: at a residual of `tolerance` times the right-hand side, or after max_iterations; restart:
    Krylov vectors."""

    tolerance: float
    restart: int
    max_iterations: int

    def times(self, factor: int) -> Limits:
        """The same tolerance, with `factor` times the Krylov vectors and iterations."""
        return Limits(self.tolerance, factor * self.restart, factor * self.max_iterations)


@dataclass(frozen=True)
class Report:
    """How a solve went: preconditioner calls, relative true residual, tolerance asked, and why it ended."""

    iterations: int
    residual: float
    tolerance: float
    reason: str

    @property
    def converged(self) -> bool:
        """Whether the solution is as good as was asked for."""
        return self.reason in ("converged", "zero right-hand side")


def gmres(apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
          start: np.ndarray | None = None, watch: Watch | None = None) -> tuple[np.ndarray, Report]:
    """GMRES preconditioned from the left.

    apply, precondition: functions of an (m,) vector; rhs: (m,); start: first guess or None;
    watch: called with (iteration, relative residual). Returns (solution, Report).
    The singular pressure systems of moving particles are solved so: from the right, small ones break down at 1e-4.
    """
    tolerance, restart, max_iterations = limits
    norm = reduce.norm(rhs)
    if norm == 0.0:
        return np.zeros_like(rhs), Report(0, 0.0, tolerance, "zero right-hand side")
    size = len(rhs)
    count = 0

    def each(residual: float) -> None:
        nonlocal count
        count += 1
        if watch is not None:
            watch(count, residual)

    solution, _ = sla.gmres(
        sla.LinearOperator((size, size), matvec=apply, dtype=float),
        rhs,
        x0=start,
        rtol=tolerance,
        atol=0.0,
        restart=min(restart, size, max_iterations),
        maxiter=max(1, max_iterations // restart),
        M=sla.LinearOperator((size, size), matvec=precondition, dtype=float),
        callback=each,
        callback_type="pr_norm",
    )
    return solution, report_of(count, reduce.norm(rhs - apply(solution)) / norm, tolerance)


def gmres_from_the_right(apply: Apply, rhs: np.ndarray, precondition: Apply, limits: Limits,
                         start: np.ndarray | None = None, watch: Watch | None = None) -> tuple[np.ndarray, Report]:
    """GMRES preconditioned from the right, which makes the true residual small.

    Arguments and results as those of `gmres`. scipy's preconditions from the left: the residual that it watches is
    another one, and meeting it too early costs a restart; and its vectors are twice as long as a `KrylovBasis`.
    """
    tolerance, restart, max_iterations = limits
    norm = reduce.norm(rhs)
    if norm == 0.0:
        return np.zeros_like(rhs), Report(0, 0.0, tolerance, "zero right-hand side")
    count = 0
    solution = np.zeros_like(rhs) if start is None else start.copy()
    rest = rhs - apply(solution) if start is not None else rhs
    residual = reduce.norm(rest) / norm

    def each(relative: float) -> None:
        nonlocal count
        count += 1
        if watch is not None:
            watch(count, relative * residual)

    while residual > tolerance and count < max_iterations:
        y = _arnoldi(lambda v: apply(precondition(v)), rest, tolerance * norm,
                     min(restart, reduce.number(rhs), max_iterations - count), each)
        solution += precondition(y)
        rest = rhs - apply(solution)
        before, residual = residual, reduce.norm(rest) / norm
        if not residual < before:  # also where it is not finite
            break
    return solution, report_of(count, residual, tolerance)


def _arnoldi(operator: Apply, rest: np.ndarray, enough: float, most: int, each: Callable[[float], None]) -> np.ndarray:
    """The vector y (m,) of the Krylov space for which rest - operator(y) is least, after at most `most` products or
    where that is `enough`. each: called with its norm over that of `rest` after each product."""
    norm = reduce.norm(rest)
    basis = KrylovBasis(most + 1, len(rest))
    basis.append(rest, norm)
    triangle, turned, known = np.zeros((most, most)), np.zeros(most + 1), 0
    turned[0] = norm
    turns: list[tuple[float, float]] = []  # Givens rotations that make the Hessenberg matrix a triangle
    for k in range(most):
        vector = operator(basis.last())
        column, length = basis.orthogonalise(vector)
        for m, (c, s) in enumerate(turns):
            column[m], column[m + 1] = c * column[m] + s * column[m + 1], c * column[m + 1] - s * column[m]
        size = float(np.hypot(column[k], length))
        if size == 0.0:  # the operator has lost this vector
            break
        c, s = column[k] / size, length / size
        turns.append((c, s))
        column[k], known = size, k + 1
        triangle[:known, k] = column
        turned[k], turned[k + 1] = c * turned[k], -s * turned[k]
        each(abs(turned[k + 1]) / norm)
        if not abs(turned[k + 1]) > enough or length == 0.0:  # also where it is not finite
            break
        basis.append(vector, length)
    return basis.combine(solve_triangular(triangle[:known, :known], turned[:known], check_finite=False))


def report_of(iterations: int, residual: float, tolerance: float) -> Report:
    """The Report of a solve that ended with a relative residual."""
    if not np.isfinite(residual):
        reason = "not finite"
    elif residual <= tolerance:
        reason = "converged"
    else:
        reason = "out of iterations"
    return Report(iterations, residual, tolerance, reason)
