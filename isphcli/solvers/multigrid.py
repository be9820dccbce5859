"""Smoothed aggregation as a preconditioner: hierarchies, and cycles of our own (the paper's section 2.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..domain.null_space import GROUND
from ..domain.row_threads import ROWS, edges_of, over_blocks, over_rows
from .aggregation import SMOOTHING, coarse_matrix, prolongation
from .aggregation import arrays_of as _csr

if TYPE_CHECKING:
    from pyamg.multilevel import MultilevelSolver

    from .krylov import Apply

# strength-of-connection threshold; at 0.08 the Poisson solve of 32^3 jittered particles (`benchmarks/iterations.py`)
# takes 1.4 times as long, and its set-up 0.7 times (2026-11-29)
STRENGTH = 0.02
MAX_COARSE = 300  # rows of a matrix that is coarse enough
MAX_LEVELS = 10
PINV = "pinv", {"rtol": 1e-9}  # of the coarsest matrix
IMPROVED = 4  # sweeps forth and back that make a vector which the finest matrix hardly changes of the one given
# rows from which a hierarchy is set up by kernels, in half of the time of PyAMG's 2 us a row (Berea 128^3): those take
# 0.9 s to compile
COMPILED = 50_000
# of a block in a sweep below the finest level, whose blocks have ROWS at least: four layers of 4681 aggregates, those
# of 48^3 particles
COARSE_ROWS = 1024


def hierarchy(matrix: sp.csr_matrix, strength: float = STRENGTH,
              near_null: np.ndarray | None = None) -> MultilevelSolver:
    """Smoothed aggregation on `matrix`; the coarse solve is a pseudo-inverse that leaves the null space out.

    strength: threshold of the connections that are aggregated; a larger one makes smaller aggregates. near_null: (m,)
    what the matrix hardly changes, constants without it.
    """
    from pyamg.multilevel import MultilevelSolver

    if matrix.shape[0] < COMPILED:
        return _of_pyamg(matrix, strength, near_null)
    levels = [MultilevelSolver.Level()]
    levels[0].A = matrix
    vector = _improved(matrix, np.ones(matrix.shape[0]) if near_null is None else near_null.copy())
    while len(levels) < MAX_LEVELS and levels[-1].A.shape[0] > MAX_COARSE:
        last = levels[-1]
        last.P, vector = prolongation(last.A, vector, strength)
        last.R = last.P.T.tocsr()
        levels.append(MultilevelSolver.Level())
        levels[-1].A = _with_diagonals(coarse_matrix(last.R, last.A, last.P))
    return MultilevelSolver(levels, coarse_solver=PINV)


def _improved(matrix: sp.csr_matrix, vector: np.ndarray) -> np.ndarray:
    """A vector as PyAMG takes it in place of the one given, in place: constants are no good where walls hold a
    velocity."""
    from pyamg.amg_core import gauss_seidel

    n, zero = len(vector), np.zeros(len(vector))
    for _ in range(IMPROVED):
        gauss_seidel(*_csr(matrix), vector, zero, 0, n, 1)
        gauss_seidel(*_csr(matrix), vector, zero, n - 1, -1, -1)
    return vector


def _of_pyamg(matrix: sp.csr_matrix, strength: float, near_null: np.ndarray | None) -> MultilevelSolver:
    """The same hierarchy to round-off, without kernels to compile."""
    import pyamg

    # local: each row over the sum of its entries, by Gershgorin, in place of a spectral radius from random vectors
    levels = pyamg.smoothed_aggregation_solver(
        matrix,
        B=None if near_null is None else near_null[:, None],
        symmetry="symmetric",
        strength=("symmetric", {"theta": strength}),
        smooth=("jacobi", {"omega": SMOOTHING, "filter_entries": True, "weighting": "local"}),
        improve_candidates=[("block_gauss_seidel", {"sweep": "symmetric", "iterations": IMPROVED}), None],
        presmoother=None,  # `cycle` and `BlockCycle` sweep themselves
        postsmoother=None,
        coarse_solver=PINV,
        max_coarse=MAX_COARSE,
        max_levels=MAX_LEVELS,
    )
    # the aggregation leaves coarse matrices in block form with blocks of one, ten times slower to sweep over
    for k, level in enumerate(levels.levels):
        level.A = level.A.tocsr() if k == 0 else _with_diagonals(level.A.tocsr())
    for level in levels.levels[:-1]:
        level.P, level.R = level.P.tocsr(), level.R.tocsr()
    return levels


def _with_diagonals(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """The same with zeros stored where diagonals are missing, which sweeps look for: scipy's products leave them out in
    the row of an aggregate whose constant the finer matrix does not see, such as a closed pocket."""
    missing = np.flatnonzero(matrix.diagonal() == 0.0)
    if len(missing) == 0:
        return matrix
    known = matrix.tocoo()
    rows, columns = np.append(known.row, missing), np.append(known.col, missing)
    return sp.csr_matrix((np.append(known.data, np.zeros(len(missing))), (rows, columns)), matrix.shape)


def grounded(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """A copy with the diagonal raised by `GROUND`, and 1 in rows of zeros, whose particles bear no pressure."""
    raised, diagonal = matrix.copy(), matrix.diagonal()
    raised.setdiag(np.where(diagonal > 0.0, diagonal * (1.0 + GROUND), 1.0))
    return raised


def by_kernels(levels: MultilevelSolver) -> bool:
    """Whether `cycle` sweeps by kernels, which take entries of any type, or by PyAMG, which takes those of vectors."""
    return levels.levels[0].A.shape[0] >= 2 * ROWS


def cycle(levels: MultilevelSolver) -> Apply:
    """One W-cycle of a hierarchy from a zero guess, as a function of the right-hand side.

    pyamg's own cycle measures the residual before and after: two of the five products with the finest matrix. Where the
    finest level has two ROWS and more, all levels are swept through by blocks of rows, as in `BlockCycle`: small levels
    by blocks of COARSE_ROWS, so that threads share them too. What a sweep from zero leaves is found from the entries
    beyond the diagonal alone. Matrices have sorted rows.
    """
    if not by_kernels(levels):
        return lambda b: _descend_small(levels, 0, b)
    least = [ROWS] + [COARSE_ROWS] * len(levels.levels)
    swept = [(edges_of(level.A.shape[0], rows), _csr(level.A), _places(level.A), _csr(level.P), _csr(level.R))
             for rows, level in zip(least, levels.levels[:-1])]
    return lambda b: _descend(levels, swept, 0, b)


def _descend(levels: MultilevelSolver, swept: list[Any], k: int, b: np.ndarray) -> np.ndarray:
    """`cycle` from level k on. It is no function within another: one that calls itself there is a circle of references,
    which would hold the finest matrix of each step until Python looks for such circles."""
    if k == len(swept):
        return levels.coarse_solver(levels.levels[k].A, b)
    blocks, matrix, at, p, r = swept[k]
    x, other = np.empty_like(b), np.empty_like(b)
    over_blocks(_forward, blocks, matrix, at, b, x)
    over_blocks(_rest, blocks, matrix, at, x, other)
    coarse = np.zeros(len(r[0]) - 1)
    over_rows(_add_product, len(coarse), r, 1.0, other, coarse)
    y = _descend(levels, swept, k + 1, coarse)
    if k + 1 < len(swept):
        over_rows(_add_product, len(y), swept[k + 1][1], -1.0, y, coarse)
        y += _descend(levels, swept, k + 1, coarse)
    over_rows(_add_product, len(x), p, 1.0, y, x)
    over_blocks(_backward, blocks, matrix, at, b, other, x)
    return other


def _descend_small(levels: MultilevelSolver, k: int, b: np.ndarray) -> np.ndarray:
    """As `_descend`, by PyAMG's sweeps through all rows one after the other: small systems need no kernels compiled.
    PyAMG's smoother takes longer to look at its arguments than its compiled sweep does, which is called here."""
    from pyamg.amg_core import gauss_seidel

    level = levels.levels[k]
    if k == len(levels.levels) - 1:
        return levels.coarse_solver(level.A, b)
    x = np.zeros_like(b)
    gauss_seidel(*_csr(level.A), x, b, 0, len(b), 1)
    coarse = level.R @ (b - level.A @ x)
    y = _descend_small(levels, k + 1, coarse)
    if k + 2 < len(levels.levels):
        y += _descend_small(levels, k + 1, coarse - levels.levels[k + 1].A @ y)
    x += level.P @ y
    gauss_seidel(*_csr(level.A), x, b, len(b) - 1, -1, -1)
    return x


class BlockCycle:
    """One V-cycle of a hierarchy on three right-hand sides at once: the matrices are read once for all three. Coarse
    levels have two thirds of the entries of the finest one: a W-cycle takes 1.6 times as long, and saves no iteration
    of Berea 128^3.

    levels: hierarchy of a matrix. Called with (n, 3), returns the same. Matrices are kept in single
    precision, vectors are not: their round-off would make the preconditioner a little nonlinear, and GMRES would stall
    at residuals of 1e-5 on long pores.

    Sweeps of Gauss and Seidel go through BLOCKS blocks of rows side by side, each with the values that the others had
    before: with 64 blocks two cycles on Berea 128^3 leave 0.0105 of a residual instead of 0.0100. Bits do not depend on
    the number of threads.
    """

    def __init__(self, levels: MultilevelSolver):
        known = [(single(level.A), single(level.P), single(level.R)) for level in levels.levels[:-1]]
        self.levels = [(_csr(a), _csr(p), _csr(r)) for a, p, r in known]
        self.blocks = [edges_of(a.shape[0], ROWS) for a, _, _ in known]
        self._diagonals = [_places(a) for a, _, _ in known]
        self.coarse = _pseudo_inverse(levels.levels[-1].A)

    def __call__(self, b: np.ndarray) -> np.ndarray:
        return self._descend(0, b)

    def _descend(self, k: int, b: np.ndarray) -> np.ndarray:
        if k == len(self.levels):
            return self.coarse @ b
        (a, p, r), blocks, at = self.levels[k], self.blocks[k], self._diagonals[k]
        x, other = np.empty_like(b), np.empty_like(b)
        over_blocks(_forward3, blocks, a, at, b, x)
        over_blocks(_rest3, blocks, a, at, x, other)
        coarse = np.zeros((len(r[0]) - 1, b.shape[1]))
        over_rows(_add_product3, len(coarse), r, 1.0, other, coarse)
        over_rows(_add_product3, len(x), p, 1.0, self._descend(k + 1, coarse), x)
        over_blocks(_backward3, blocks, a, at, b, other, x)
        return other


def add_product(matrix: sp.csr_matrix, sign: float, x: np.ndarray, out: np.ndarray) -> None:
    """out += sign A x of vectors (m,) and (n,)."""
    over_rows(_add_product, len(out), _csr(matrix), sign, x, out)


def single(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """A CSR matrix with its entries in single precision and sorted rows."""
    matrix = matrix.tocsr().astype(np.float32)
    matrix.sort_indices()
    return matrix


def _places(matrix: sp.csr_matrix) -> np.ndarray:
    """Where the diagonals stand among the entries, (n,)."""
    matrix.sort_indices()
    at = np.empty(matrix.shape[0], matrix.indptr.dtype)
    over_rows(_diagonals, len(at), matrix.indptr, matrix.indices, at)
    return at


def _pseudo_inverse(matrix: sp.csr_matrix) -> np.ndarray:
    """Of the coarsest matrix, without its null space."""
    from scipy.linalg import pinv

    return pinv(matrix.toarray(), rtol=1e-9)


# Indices are unsigned: loops need no check for those that count from the end. at: (n,) places of the diagonals.


@njit(cache=True, nogil=True)
def _diagonals(rows, indptr, indices, at):
    """Where the diagonal of each row stands, which all rows have."""
    for i in range(rows[0], rows[1]):
        q = indptr[i]
        while indices[q] < i:
            q += 1
        at[i] = q


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _forward(blocks, edges, matrix, at, b, x):
    """One forward Gauss-Seidel sweep from zero over blocks of rows into x."""
    indptr, indices, data = matrix
    for block in range(blocks[0], blocks[1]):
        begin = np.uint32(edges[block])
        for i in range(edges[block], edges[block + 1]):
            s, own = b[i], np.uint64(at[i])
            for q in range(np.uint64(indptr[i]), own):
                j = np.uint32(indices[q])
                if j >= begin:
                    s -= data[q] * x[j]
            x[i] = s / data[own] if data[own] != 0.0 else 0.0  # a row of zeros: a particle that bears no pressure


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _rest(blocks, edges, matrix, at, x, rest):
    """What that sweep leaves of the right-hand side: later columns have changed, and those of other blocks."""
    indptr, indices, data = matrix
    for block in range(blocks[0], blocks[1]):
        begin = np.uint32(edges[block])
        for i in range(edges[block], edges[block + 1]):
            s, q, own = 0.0, np.uint64(indptr[i]), np.uint64(at[i])
            while np.uint32(indices[q]) < begin:
                s -= data[q] * x[np.uint32(indices[q])]
                q += np.uint64(1)
            for k in range(own + np.uint64(1), np.uint64(indptr[i + 1])):
                s -= data[k] * x[np.uint32(indices[k])]
            rest[i] = s


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _backward(blocks, edges, matrix, at, b, x, before):
    """One backward Gauss-Seidel sweep over blocks of rows of `before` into x, of which nothing is read."""
    indptr, indices, data = matrix
    for block in range(blocks[0], blocks[1]):
        end = np.uint32(edges[block + 1])
        for i in range(edges[block + 1] - 1, edges[block] - 1, -1):
            s, own, last = b[i], np.uint64(at[i]), np.uint64(indptr[i + 1])
            for q in range(np.uint64(indptr[i]), own):  # none of these has changed
                s -= data[q] * before[np.uint32(indices[q])]
            q = own + np.uint64(1)
            while q < last and np.uint32(indices[q]) < end:
                s -= data[q] * x[np.uint32(indices[q])]
                q += np.uint64(1)
            for k in range(q, last):
                s -= data[k] * before[np.uint32(indices[k])]
            x[i] = s / data[own] if data[own] != 0.0 else 0.0  # a row of zeros: a particle that bears no pressure


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_product(rows, matrix, sign, x, out):
    """out += sign A x."""
    indptr, indices, data = matrix
    for i in range(rows[0], rows[1]):
        s = 0.0
        for q in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            s += data[q] * x[np.uint32(indices[q])]
        out[i] += sign * s


# Three columns are written out: a loop over them costs twice the time


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _forward3(blocks, edges, matrix, at, b, x):
    """As `_forward`, of three columns."""
    indptr, indices, data = matrix
    for block in range(blocks[0], blocks[1]):
        begin = np.uint32(edges[block])
        for i in range(edges[block], edges[block + 1]):
            s0, s1, s2, own = b[i, 0], b[i, 1], b[i, 2], np.uint64(at[i])
            for q in range(np.uint64(indptr[i]), own):
                j = np.uint32(indices[q])
                if j >= begin:
                    a = data[q]
                    s0, s1, s2 = s0 - a * x[j, 0], s1 - a * x[j, 1], s2 - a * x[j, 2]
            diagonal = float(data[own])
            x[i, 0], x[i, 1], x[i, 2] = s0 / diagonal, s1 / diagonal, s2 / diagonal


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _rest3(blocks, edges, matrix, at, x, rest):
    """As `_rest`, of three columns."""
    indptr, indices, data = matrix
    for block in range(blocks[0], blocks[1]):
        begin = np.uint32(edges[block])
        for i in range(edges[block], edges[block + 1]):
            s0, s1, s2, q, own = 0.0, 0.0, 0.0, np.uint64(indptr[i]), np.uint64(at[i])
            while np.uint32(indices[q]) < begin:
                j, a = np.uint32(indices[q]), data[q]
                s0, s1, s2 = s0 - a * x[j, 0], s1 - a * x[j, 1], s2 - a * x[j, 2]
                q += np.uint64(1)
            for k in range(own + np.uint64(1), np.uint64(indptr[i + 1])):
                j, a = np.uint32(indices[k]), data[k]
                s0, s1, s2 = s0 - a * x[j, 0], s1 - a * x[j, 1], s2 - a * x[j, 2]
            rest[i, 0], rest[i, 1], rest[i, 2] = s0, s1, s2


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _backward3(blocks, edges, matrix, at, b, x, before):
    """As `_backward`, of three columns."""
    indptr, indices, data = matrix
    for block in range(blocks[0], blocks[1]):
        end = np.uint32(edges[block + 1])
        for i in range(edges[block + 1] - 1, edges[block] - 1, -1):
            s0, s1, s2 = b[i, 0], b[i, 1], b[i, 2]
            own, last = np.uint64(at[i]), np.uint64(indptr[i + 1])
            for q in range(np.uint64(indptr[i]), own):  # none of these has changed
                j, a = np.uint32(indices[q]), data[q]
                s0, s1, s2 = s0 - a * before[j, 0], s1 - a * before[j, 1], s2 - a * before[j, 2]
            q = own + np.uint64(1)
            while q < last and np.uint32(indices[q]) < end:
                j, a = np.uint32(indices[q]), data[q]
                s0, s1, s2 = s0 - a * x[j, 0], s1 - a * x[j, 1], s2 - a * x[j, 2]
                q += np.uint64(1)
            for k in range(q, last):
                j, a = np.uint32(indices[k]), data[k]
                s0, s1, s2 = s0 - a * before[j, 0], s1 - a * before[j, 1], s2 - a * before[j, 2]
            diagonal = float(data[own])
            x[i, 0], x[i, 1], x[i, 2] = s0 / diagonal, s1 / diagonal, s2 / diagonal


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_product3(rows, matrix, sign, x, out):
    """out += sign A x."""
    indptr, indices, data = matrix
    for i in range(rows[0], rows[1]):
        s0 = s1 = s2 = 0.0
        for q in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            j, a = np.uint32(indices[q]), data[q]
            s0, s1, s2 = s0 + a * x[j, 0], s1 + a * x[j, 1], s2 + a * x[j, 2]
        out[i, 0], out[i, 1], out[i, 2] = out[i, 0] + sign * s0, out[i, 1] + sign * s1, out[i, 2] + sign * s2
