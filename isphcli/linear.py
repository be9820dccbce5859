"""Linear systems: GMRES with a smoothed-aggregation preconditioner, null spaces, reports (paper 2.4, eqs 25-26)."""

from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

STRENGTH = 0.02  # strength-of-connection threshold; 0.08 costs twenty times the set-up (design.md 6)


class SolveError(RuntimeError):
    """A linear system that missed its tolerance. Attributes: system, report."""

    def __init__(self, system, report):
        self.system, self.report = system, report
        super().__init__(
            f"the {system} system did not converge: residual {report.residual:.2e} after {report.iterations} "
            f"iterations (asked: {report.tolerance:.1e}; {report.reason}); try a larger solver.max_iterations, "
            f"a smaller time step or a larger solver.tolerance"
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


def components(start, column):
    """Connected components of the pair graph: (count, labels (n,) int32)."""
    n = len(start) - 1
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
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(26)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def hierarchy(matrix):
    """Smoothed aggregation on `matrix`; the coarse solve is a pseudo-inverse that leaves the null space out."""
    import pyamg

    with _same_random_numbers():
        levels = pyamg.smoothed_aggregation_solver(
            matrix,
            symmetry="symmetric",
            strength=("symmetric", {"theta": STRENGTH}),
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


def gmres(apply, rhs, precondition, tolerance, restart, max_iterations, start=None, watch=None):
    """Preconditioned GMRES; the tolerance is relative to the right-hand side.

    apply, precondition: functions of an (m,) vector; rhs: (m,); start: first guess or None;
    watch: called with (iteration, relative residual). Returns (solution, Report).
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
    residual = float(np.linalg.norm(rhs - apply(solution)) / norm)
    if not np.isfinite(residual):
        reason = "not finite"
    elif residual <= tolerance:
        reason = "converged"
    else:
        reason = "out of iterations"
    return solution, Report(count, residual, tolerance, reason)
