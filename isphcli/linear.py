"""Linear systems: GMRES with a smoothed-aggregation preconditioner, null spaces, reports (paper 2.4, eqs 25-26)."""

from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from numba import njit

# strength-of-connection threshold; at 0.08 the Poisson solve of 32^3 jittered particles (`benchmarks/iterations.py`)
# takes 1.4 times as long, and its set-up 0.7 times (2026-11-29)
STRENGTH = 0.02


class SolveError(RuntimeError):
    """A linear system that missed its tolerance. Attributes: system, report."""

    def __init__(self, system, report):
        self.system, self.report = system, report
        # a steady solve has no time step, and what it fails on are pores that the lattice does not resolve
        advice = "a smaller particles.spacing" if system == "Stokes" else "smaller time steps (time.step or time.cfl)"
        super().__init__(
            f"the {system} system did not converge: residual {report.residual:.2e} after {report.iterations} "
            f"iterations (asked: {report.tolerance:.1e}; {report.reason}); try a larger solver.max_iterations, "
            f"{advice} or a larger solver.tolerance"
        )


@dataclass(frozen=True)
class Report:
    """How a solve went: preconditioner calls, relative true residual, tolerance asked, and why it ended."""

    iterations: int
    residual: float
    tolerance: float
    reason: str

    @property
    def converged(self):
        """Whether the solution is as good as was asked for."""
        return self.reason in ("converged", "zero right-hand side")


class ComponentMeans:
    """The projection P of eq. 26 for one constant vector a connected component.

    labels: (n,) component of each particle.
    """

    def __init__(self, labels):
        self.labels = labels
        self.count = np.bincount(labels)

    def remove(self, v):
        """v without its mean over each component, (n,)."""
        if len(self.count) == 1:
            return v - v.mean()
        return v - (np.bincount(self.labels, weights=v, minlength=len(self.count)) / self.count)[self.labels]


def pair_components(start, column, joined=None):
    """Connected components of the pair graph: (count, labels (n,) int32). joined: (n_pairs,) bool, pairs that count."""
    n = len(start) - 1
    if joined is not None:
        start, column = np.concatenate([[0], np.cumsum(joined)])[start], column[joined]
    graph = sp.csr_matrix((np.ones(len(column), dtype=np.int8), column, start), shape=(n, n))
    return sp.csgraph.connected_components(graph, directed=False)


def assemble(start, column, weights, shift, scale, diagonal=None):
    """The matrix  shift - scale * L  in canonical CSR form, L f_i = sum_j w_ij (f_j - f_i) - diagonal_i f_i.

    weights: (n_pairs,); shift, scale: numbers; diagonal: (n,) wall sums or None.
    """
    n = len(start) - 1
    total = row_sums(start, weights)
    if diagonal is not None:
        total = total + diagonal
    # scipy sorts in place: it must not reorder the columns that the operators hold
    matrix = sp.csr_matrix((-scale * weights, column.copy(), start.copy()), shape=(n, n))
    matrix = matrix + sp.diags_array(shift + scale * total).tocsr()
    matrix.sum_duplicates()
    if max(matrix.nnz, n) < 2**31:
        matrix.indptr, matrix.indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
    return matrix


def row_sums(start, values):
    """Sums of the entries of each row, (n,); empty rows give zero."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return total[start[1:]] - total[start[:-1]]


@contextmanager
def _same_random_numbers():
    """pyamg estimates spectral radii from numpy's global random numbers: without this no two runs agree bit for bit."""
    before = np.random.get_state()  # noqa: NPY002 - pyamg draws from it
    np.random.seed(26)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def hierarchy(matrix, strength=STRENGTH):
    """Smoothed aggregation on `matrix`; the coarse solve is a pseudo-inverse that leaves the null space out.

    strength: threshold of the connections that are aggregated; a larger one makes smaller aggregates.
    """
    import pyamg

    with _same_random_numbers():
        levels = pyamg.smoothed_aggregation_solver(
            matrix,
            symmetry="symmetric",
            strength=("symmetric", {"theta": strength}),
            smooth=("jacobi", {"omega": 4.0 / 3.0, "filter_entries": True}),
            presmoother=("gauss_seidel", {"sweep": "forward"}),
            postsmoother=("gauss_seidel", {"sweep": "backward"}),
            coarse_solver=("pinv", {"rtol": 1e-9}),
            max_coarse=300,
        )
    # the aggregation leaves coarse matrices in block form with blocks of one, ten times slower to sweep over
    for level in levels.levels:
        level.A = level.A.tocsr()
        if hasattr(level, "P"):
            level.P, level.R = level.P.tocsr(), level.R.tocsr()
    return levels


def cycle(levels):
    """One W-cycle of a hierarchy from a zero guess, as a function of the right-hand side.

    pyamg's own cycle measures the residual before and after: two of the five products with the finest matrix.
    """

    def descend(k, b):
        level = levels.levels[k]
        if k == len(levels.levels) - 1:
            return levels.coarse_solver(level.A, b)
        x = np.zeros_like(b)
        level.presmoother(level.A, x, b)
        coarse = level.R @ (b - level.A @ x)
        y = descend(k + 1, coarse)
        if k + 2 < len(levels.levels):
            y += descend(k + 1, coarse - levels.levels[k + 1].A @ y)
        x += level.P @ y
        level.postsmoother(level.A, x, b)
        return x

    return lambda b: descend(0, b)


class BlockCycle:
    """W-cycles of a hierarchy on three right-hand sides at once: the matrices are read once for all three.

    levels: hierarchy of a matrix; count: cycles. Called with (n, 3), returns the same. Matrices are kept in single
    precision, vectors are not: their round-off would make the preconditioner a little nonlinear, and GMRES stalled at
    residuals of 1e-5 on long pores.
    """

    def __init__(self, levels, count):
        self.count = count if len(levels.levels) > 1 else 1  # the coarsest is solved exactly
        self.levels = [(single(level.A), level.P, level.R) for level in levels.levels[:-1]]
        self.coarse = _pseudo_inverse(levels.levels[-1].A)

    def __call__(self, b):
        x = self._descend(0, b)
        for _ in range(self.count - 1):
            x += self._descend(0, self._residual(0, b, x))
        return x

    def _residual(self, k, b, x):
        out = np.empty_like(b)
        a = self.levels[k][0]
        _residual3(a.indptr, a.indices, a.data, b, x, out)
        return out

    def _descend(self, k, b):
        if k == len(self.levels):
            return self.coarse @ b
        a, p, r = self.levels[k]
        x, rest = np.empty_like(b), np.empty_like(b)
        _forward3(a.indptr, a.indices, a.data, b, x, rest)
        coarse = r @ rest
        y = self._descend(k + 1, coarse)
        if k + 1 < len(self.levels):
            y += self._descend(k + 1, self._residual(k + 1, coarse, y))
        x += p @ y
        _backward3(a.indptr, a.indices, a.data, b, x)
        return x


def single(matrix):
    """A CSR matrix with its entries in single precision and sorted rows."""
    matrix = matrix.tocsr().astype(np.float32)
    matrix.sort_indices()
    return matrix


def _pseudo_inverse(matrix):
    """Of the coarsest matrix, without its null space."""
    from scipy.linalg import pinv

    return pinv(matrix.toarray(), rtol=1e-9)


# Three columns are written out: a loop over them costs twice the time


@njit(cache=True)
def _forward3(indptr, indices, data, b, x, rest):
    """One forward Gauss-Seidel sweep from zero into x, and what it leaves of b: only later columns have changed."""
    n = len(indptr) - 1
    for i in range(n):
        s0, s1, s2, diagonal = b[i, 0], b[i, 1], b[i, 2], 1.0
        for q in range(indptr[i], indptr[i + 1]):
            j, a = indices[q], data[q]
            if j >= i:
                diagonal = float(a)
                break
            s0 -= a * x[j, 0]
            s1 -= a * x[j, 1]
            s2 -= a * x[j, 2]
        x[i, 0], x[i, 1], x[i, 2] = s0 / diagonal, s1 / diagonal, s2 / diagonal
    for i in range(n):
        s0 = s1 = s2 = 0.0
        for q in range(indptr[i + 1] - 1, indptr[i] - 1, -1):
            j, a = indices[q], data[q]
            if j <= i:
                break
            s0 -= a * x[j, 0]
            s1 -= a * x[j, 1]
            s2 -= a * x[j, 2]
        rest[i, 0], rest[i, 1], rest[i, 2] = s0, s1, s2


@njit(cache=True)
def _backward3(indptr, indices, data, b, x):
    """One backward Gauss-Seidel sweep over x."""
    for i in range(len(indptr) - 2, -1, -1):
        s0, s1, s2, diagonal = b[i, 0], b[i, 1], b[i, 2], 1.0
        for q in range(indptr[i], indptr[i + 1]):
            j, a = indices[q], data[q]
            if j == i:
                diagonal = float(a)
            else:
                s0 -= a * x[j, 0]
                s1 -= a * x[j, 1]
                s2 -= a * x[j, 2]
        x[i, 0], x[i, 1], x[i, 2] = s0 / diagonal, s1 / diagonal, s2 / diagonal


@njit(cache=True)
def _residual3(indptr, indices, data, b, x, out):
    """b - A x."""
    for i in range(len(indptr) - 1):
        s0, s1, s2 = b[i, 0], b[i, 1], b[i, 2]
        for q in range(indptr[i], indptr[i + 1]):
            j, a = indices[q], data[q]
            s0 -= a * x[j, 0]
            s1 -= a * x[j, 1]
            s2 -= a * x[j, 2]
        out[i, 0], out[i, 1], out[i, 2] = s0, s1, s2


def gmres(apply, rhs, precondition, tolerance, restart, max_iterations, start=None, watch=None):
    """GMRES preconditioned from the left; the tolerance is relative to the right-hand side.

    apply, precondition: functions of an (m,) vector; rhs: (m,); start: first guess or None;
    watch: called with (iteration, relative residual). Returns (solution, Report).
    The singular pressure systems of moving particles are solved so: from the right, small ones break down at 1e-4.
    """
    norm = np.linalg.norm(rhs)
    if norm == 0.0:
        return np.zeros_like(rhs), Report(0, 0.0, tolerance, "zero right-hand side")
    size = len(rhs)
    count = 0

    def each(residual):
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
    return solution, _report(count, float(np.linalg.norm(rhs - apply(solution)) / norm), tolerance)


def gmres_from_the_right(apply, rhs, precondition, tolerance, restart, max_iterations, start=None, watch=None):
    """GMRES preconditioned from the right, which makes the true residual small; the tolerance is relative to `rhs`.

    Arguments and results as those of `gmres`.
    """
    norm = np.linalg.norm(rhs)
    if norm == 0.0:
        return np.zeros_like(rhs), Report(0, 0.0, tolerance, "zero right-hand side")
    size, count = len(rhs), 0
    solution = np.zeros_like(rhs) if start is None else start.copy()
    rest = rhs - apply(solution) if start is not None else rhs
    residual = np.linalg.norm(rest) / norm

    def each(relative):
        nonlocal count
        count += 1
        if watch is not None:
            watch(count, relative * residual)

    # scipy preconditions from the left: the residual that it watches is another one, and meeting it too early costs
    # a restart
    operator = sla.LinearOperator((size, size), matvec=lambda v: apply(precondition(v)), dtype=float)
    while residual > tolerance and count < max_iterations:
        y, _ = sla.gmres(
            operator,
            rest,
            rtol=0.0,
            atol=tolerance * norm,
            restart=min(restart, size, max_iterations - count),
            maxiter=1,
            callback=each,
            callback_type="pr_norm",
        )
        solution += precondition(y)
        rest = rhs - apply(solution)
        before, residual = residual, np.linalg.norm(rest) / norm
        if not residual < before:  # also where it is not finite
            break
    return solution, _report(count, float(residual), tolerance)


def _report(iterations, residual, tolerance):
    if not np.isfinite(residual):
        reason = "not finite"
    elif residual <= tolerance:
        reason = "converged"
    else:
        reason = "out of iterations"
    return Report(iterations, residual, tolerance, reason)
