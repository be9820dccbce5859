"""GMRES from either side, and how a solve went. Constants are projected out by `ComponentMeans` of
`domain/null_space.py` (eqs 25-26)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from ..domain import reduce
from .krylov_basis import Basis, DoubleBasis, KrylovBasis

# How much farther the preconditioned residual has to fall than in proportion where the true one has not fallen enough
STRICTER = 0.8

Apply = Callable[[np.ndarray], np.ndarray]  # a linear map of vectors (m,)
Watch = Callable[[int, float], None]  # told of each iteration and its relative residual


def recorded(residuals: list[tuple[int, float]], watch: Watch | None) -> Watch:
    """A watch that keeps what it is told, and tells it on."""

    def record(iteration: int, residual: float) -> None:
        residuals.append((iteration, residual))
        if watch is not None:
            watch(iteration, residual)

    return record


class SolveError(RuntimeError):
    """A linear system that missed its tolerance. Attributes: system, convergence; violation: (n,) residual of each
    particle, or None; worst: the file of the particles of the largest ones, or None."""

    violation: np.ndarray | None = None
    worst: Path | None = None

    def __init__(self, system: str, convergence: Convergence):
        self.system, self.convergence = system, convergence
        # a steady solve has no time step, and what it fails on are pores that the lattice does not resolve
        advice = "a smaller particles.spacing" if system == "Stokes" else "smaller time steps (time.step or time.cfl)"
        super().__init__(
            f"the {system} system did not converge: residual {convergence.residual:.2e} after {convergence.iterations} "
            f"iterations (asked: {convergence.tolerance:.1e}; {convergence.reason}); try a larger "
            f"solver.max_iterations, {advice} or a larger solver.tolerance"
        )


class Maps(NamedTuple):
    """A system (m, m) as functions of vectors (m,): apply; precondition, an approximate inverse; and, where they share
    work, apply of precondition as one."""

    apply: Apply
    precondition: Apply
    product: Apply | None = None

    def both(self, v: np.ndarray) -> np.ndarray:
        """apply of precondition, (m,)."""
        return self.apply(self.precondition(v)) if self.product is None else self.product(v)


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
class Convergence:
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
          start: np.ndarray | None = None, watch: Watch | None = None) -> tuple[np.ndarray, Convergence]:
    """GMRES preconditioned from the left.

    apply, precondition: functions of an (m,) vector; rhs: (m,); start: first guess or None;
    watch: called with (iteration, relative preconditioned residual). Returns (solution, Convergence).
    The singular pressure systems of moving particles are solved so: from the right, small ones break down at 1e-4.
    What falls is the preconditioned residual; where the true one has not fallen as much by then, the same Krylov space
    grows on. scipy's starts a new one, which costs two or three products and cycles of a dozen.
    """
    tolerance, restart, max_iterations = limits
    count, norm = 0, reduce.norm(rhs)
    if norm == 0.0:
        return np.zeros_like(rhs), Convergence(0, 0.0, tolerance, "zero right-hand side")
    solution, rest = _first_guess(apply, rhs, start)
    residual = reduce.norm(rest) / norm
    while residual > tolerance and count < max_iterations:
        whole = precondition(rest)
        size = reduce.norm(whole)
        if not 0.0 < size < np.inf:
            residual = residual if size == 0.0 else size
            break
        relative = residual

        def each(left: float) -> None:
            nonlocal count
            count += 1
            if watch is not None:
                watch(count, left * relative)  # noqa: B023 - of this space

        most = min(restart, reduce.number(rhs), max_iterations - count)
        space = KrylovSpace(lambda v: precondition(apply(v)), whole, DoubleBasis(most + 1, len(rhs)), most)
        before, first, enough = residual, solution, size * tolerance / residual
        while True:
            space.grow(enough, each)
            solution = first + space.best()
            rest = rhs - apply(solution)
            residual = reduce.norm(rest) / norm
            if not residual > tolerance or space.complete:
                break
            enough = STRICTER * min(enough, space.left) * tolerance / residual
        if not residual < before:  # also where it is not finite
            break
    return solution, convergence_of(count, residual, tolerance)


def gmres_from_the_right(maps: Maps, rhs: np.ndarray, limits: Limits, start: np.ndarray | None = None,
                         watch: Watch | None = None) -> tuple[np.ndarray, Convergence]:
    """GMRES preconditioned from the right, which makes the true residual small.

    Results and the other arguments as those of `gmres`. scipy's preconditions from the left: the residual that it
    watches is another one, and meeting it too early costs a restart; and its vectors are twice as long as a
    `KrylovBasis`.
    """
    tolerance, restart, max_iterations = limits
    count, norm = 0, reduce.norm(rhs)
    if norm == 0.0:
        return np.zeros_like(rhs), Convergence(0, 0.0, tolerance, "zero right-hand side")
    solution, rest = _first_guess(maps.apply, rhs, start)
    residual = reduce.norm(rest) / norm

    def each(relative: float) -> None:
        nonlocal count
        count += 1
        if watch is not None:
            watch(count, relative * residual)

    while residual > tolerance and count < max_iterations:
        most = min(restart, reduce.number(rhs), max_iterations - count)
        space = KrylovSpace(maps.both, rest.copy() if rest is rhs else rest, KrylovBasis(most + 1, len(rest)), most)
        space.grow(tolerance * norm, each)
        y = space.best()
        del space
        solution += maps.precondition(y)
        rest = rhs - maps.apply(solution)
        before, residual = residual, reduce.norm(rest) / norm
        if not residual < before:  # also where it is not finite
            break
    return solution, convergence_of(count, residual, tolerance)


def _first_guess(apply: Apply, rhs: np.ndarray, start: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """(first solution, its residual), (m,) each: without a guess zero, and no product."""
    if start is None:
        return np.zeros_like(rhs), rhs
    return start.copy(), rhs - apply(start)


class KrylovSpace:
    """The space of a vector `rest` (m,) and its products with an operator, at most `most` of them, as Arnoldi makes it,
    and the vector in it whose product is nearest to `rest`, which is written to.

    basis: an empty one, for most + 1 vectors. known: products so far; left: norm of what the best vector leaves of
    `rest`; complete: no further product can be taken.
    """

    def __init__(self, operator: Apply, rest: np.ndarray, basis: Basis, most: int):
        self.operator, self.basis, self.most = operator, basis, most
        self.norm = self.left = reduce.norm(rest)
        self.known, self.complete = 0, most == 0
        self._next = rest, self.norm
        self._triangle, self._turned = np.zeros((most, most)), np.zeros(most + 1)
        self._turned[0] = self.norm
        self._turns: list[tuple[float, float]] = []  # Givens rotations that make the Hessenberg matrix a triangle

    def grow(self, enough: float, each: Callable[[float], None]) -> None:
        """Products until what is left is `enough`. each: called with that over the norm of `rest` after each."""
        while not self.complete:
            k, turned = self.known, self._turned
            vector = self.operator(self.basis.append(*self._next))
            column, length = self.basis.orthogonalise(vector)
            for m, (c, s) in enumerate(self._turns):
                column[m], column[m + 1] = c * column[m] + s * column[m + 1], c * column[m + 1] - s * column[m]
            size = float(np.hypot(column[k], length))
            if size == 0.0:  # the operator has lost this vector
                self.complete = True
                return
            c, s = column[k] / size, length / size
            self._turns.append((c, s))
            column[k], self.known = size, k + 1
            self._triangle[: k + 1, k] = column
            turned[k], turned[k + 1] = c * turned[k], -s * turned[k]
            self.left, self._next = abs(turned[k + 1]), (vector, length)
            self.complete = self.known == self.most or length == 0.0
            each(self.left / self.norm)
            if not self.left > enough:  # also where it is not finite
                return

    def best(self) -> np.ndarray:
        """That vector, (m,)."""
        k = self.known
        return self.basis.combine(solve_triangular(self._triangle[:k, :k], self._turned[:k], check_finite=False))


def convergence_of(iterations: int, residual: float, tolerance: float) -> Convergence:
    """The Convergence of a solve that ended with a relative residual."""
    if not np.isfinite(residual):
        reason = "not finite"
    elif residual <= tolerance:
        reason = "converged"
    else:
        reason = "out of iterations"
    return Convergence(iterations, residual, tolerance, reason)
