"""Smoothed aggregation as a preconditioner: hierarchies, and cycles of our own (the paper's section 2.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numba import njit

if TYPE_CHECKING:
    from pyamg.multilevel import MultilevelSolver

    from .krylov import Apply

# strength-of-connection threshold; at 0.08 the Poisson solve of 32^3 jittered particles (`benchmarks/iterations.py`)
# takes 1.4 times as long, and its set-up 0.7 times (2026-11-29)
STRENGTH = 0.02


def hierarchy(matrix: sp.csr_matrix, strength: float = STRENGTH) -> MultilevelSolver:
    """Smoothed aggregation on `matrix`; the coarse solve is a pseudo-inverse that leaves the null space out.

    strength: threshold of the connections that are aggregated; a larger one makes smaller aggregates.
    """
    import pyamg

    # local: each row over the sum of its entries, by Gershgorin, in place of a spectral radius from random vectors
    levels = pyamg.smoothed_aggregation_solver(
        matrix,
        symmetry="symmetric",
        strength=("symmetric", {"theta": strength}),
        smooth=("jacobi", {"omega": 4.0 / 3.0, "filter_entries": True, "weighting": "local"}),
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


def cycle(levels: MultilevelSolver) -> Apply:
    """One W-cycle of a hierarchy from a zero guess, as a function of the right-hand side.

    pyamg's own cycle measures the residual before and after: two of the five products with the finest matrix.
    """

    def descend(k: int, b: np.ndarray) -> np.ndarray:
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

    def __init__(self, levels: MultilevelSolver, count: int):
        self.count = count if len(levels.levels) > 1 else 1  # the coarsest is solved exactly
        self.levels = [(single(level.A), level.P, level.R) for level in levels.levels[:-1]]
        self.coarse = _pseudo_inverse(levels.levels[-1].A)

    def __call__(self, b: np.ndarray) -> np.ndarray:
        x = self._descend(0, b)
        for _ in range(self.count - 1):
            x += self._descend(0, self._residual(0, b, x))
        return x

    def _residual(self, k: int, b: np.ndarray, x: np.ndarray) -> np.ndarray:
        out = np.empty_like(b)
        a = self.levels[k][0]
        _residual3(a.indptr, a.indices, a.data, b, x, out)
        return out

    def _descend(self, k: int, b: np.ndarray) -> np.ndarray:
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


def single(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """A CSR matrix with its entries in single precision and sorted rows."""
    matrix = matrix.tocsr().astype(np.float32)
    matrix.sort_indices()
    return matrix


def _pseudo_inverse(matrix: sp.csr_matrix) -> np.ndarray:
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
