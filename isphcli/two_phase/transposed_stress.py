"""The transposed stress of the particles at the interface, div(mu (grad u)^T), which does not vanish where mu jumps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.row_threads import REDUCE, in_one_piece, over_rows
from .least_squares import LANES, TOGETHER, factors, higher_powers, powers, put_moments, solve_factored, terms_of

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..operators.pair_weights import Operators

SINGULAR = 1e-10  # of the moments of neighbours: what they do not resolve, like a second derivative of a plane of them


@dataclass(frozen=True)
class TransposedStress:
    """The transposed stress of the particles at the interface that see no wall, over their density.

    sum_j m_ij 2 H_ij (u_j - u_i) / rho_i with H_ij the weights of the second derivatives d_k d_l, exact for quadratic
    functions. For a like viscosity it is 2 grad div u, with m_ij it makes of mu lap u the full stress. Two other forms,
    (grad u)^T grad mu and the same without its part in div u, have growing modes at a viscosity ratio of 100 (smallest
    eigenvalue of the velocity matrix -72 and -5000, against +36 and more of this one).

    rows: (m,) particles; start: (m + 1,), column: neighbours; tensor: (n_pairs of those, dim (dim + 1) / 2), the
    upper half, row by row.
    """

    rows: np.ndarray
    start: np.ndarray
    column: np.ndarray
    tensor: np.ndarray

    @classmethod
    def build(cls, ops: Operators, weighted_lap: np.ndarray, rows: np.ndarray) -> TransposedStress:
        """ops: Operators; weighted_lap: (n_pairs,) its `lap` times m_ij / rho_i; rows: (m,)."""
        count = np.diff(ops.start)[rows]
        start = np.concatenate([[0], np.cumsum(count)])
        column, tensor = np.empty(start[-1], np.int32), np.empty((start[-1], ops.dim * (ops.dim + 1) // 2))
        over_rows(_tensors, len(rows), ops.neighbours, (ops.lap, weighted_lap), rows,
                  (start, column, tensor), work=lambda: _scratch(ops.neighbours))
        return cls(rows, start, column, tensor)

    def add(self, u: np.ndarray, out: np.ndarray, factor: float) -> None:
        """out += factor times the stress; u: (n + remote, dim); out: (n, dim)."""
        given = self.rows, self.start, self.column, self.tensor
        over_rows(_add, len(self.rows), given, u, out, factor)


class _Scratch(NamedTuple):
    """What `least_squares` asks for; right (size, TOGETHER); inverse (entries, size, TOGETHER), the columns of second
    derivatives; least (TOGETHER,), the smallest pivot; over (places,), the weights of the stress; at (10,), a column by
    the place of each term."""

    matrix: np.ndarray
    right: np.ndarray
    inverse: np.ndarray
    ways: np.ndarray
    weight: np.ndarray
    product: np.ndarray
    sums: np.ndarray
    over: np.ndarray
    least: np.ndarray
    at: np.ndarray
    seen: np.ndarray
    place: np.ndarray
    pair: np.ndarray
    scale: np.ndarray


def _scratch(neighbours: Neighbourhood) -> _Scratch:
    dim, most = neighbours.x.shape[1], int(neighbours.longest) + LANES
    terms = terms_of(dim, (1, 2))
    size = len(terms[0])
    arrays = in_one_piece((size, size, TOGETHER), (size, TOGETHER), (size - dim, size, TOGETHER), (TOGETHER, 3, most),
                          (TOGETHER, most), (most,), (35,), (most,), (TOGETHER,), (10,))
    work = _Scratch(*[*arrays, np.zeros(TOGETHER, np.int64), *terms])
    work.matrix[:] = 0.0  # of fewer particles than TOGETHER
    return work


@njit(cache=True, nogil=True, error_model="numpy")
def _tensors(turns, work, neighbours, weights, rows, out):
    (lap, weighted_lap), (new_start, new_column, tensor) = weights, out
    start, column = neighbours.start, neighbours.column
    matrix, right, inverse, least = work.matrix, work.right, work.inverse, work.least
    size, entries, scale = len(right), len(inverse), 2.0 / (neighbours.support * neighbours.support)
    for first in range(turns[0], turns[1], TOGETHER):
        lanes, deficient = min(TOGETHER, turns[1] - first), False
        for m in range(lanes):
            _gather(rows[first + m], m, neighbours, lap, work)
            _moments(work, m)
            total = 0.0
            for a in range(size):
                total += matrix[a, a, m]
            least[m] = SINGULAR * total if total > 0.0 else 1.0
        factors(matrix)
        for m in range(lanes):
            smallest = least[m]
            least[m] = 0.0
            for a in range(size):
                if not matrix[a, a, m] ** 2 * smallest < 1.0:  # one over the square root of a pivot
                    least[m], deficient = smallest, True
        if deficient:
            for m in range(lanes):
                _moments(work, m)
                for a in range(size):
                    matrix[a, a, m] += least[m]  # as good as a pseudo-inverse, which takes numba 15 s to compile
            factors(matrix)
        # least squares: the coefficients of the quadratic terms are the second derivatives
        for v in range(entries):
            for a in range(size):
                for m in range(TOGETHER):
                    right[a, m] = 1.0 if a == size - entries + v else 0.0
            solve_factored(matrix, right)
            for a in range(size):
                for m in range(TOGETHER):
                    inverse[v, a, m] = right[a, m]
        for m in range(lanes):
            begin, there = np.uint64(start[rows[first + m]]), np.uint64(new_start[first + m])
            count = np.uint64(new_start[first + m + 1]) - there
            for k in range(count):
                new_column[there + k] = column[begin + k]
                work.over[k] = scale * weighted_lap[begin + k] if lap[begin + k] > 0.0 else 0.0
            _put(work, m, there, count, tensor)


@njit(cache=True, error_model="numpy", forceinline=True)
def _gather(i, m, neighbours, lap, work):
    """The ways to the neighbours of particle i, in units of the support, and their weights are written to place m,
    filled up to whole vectors without weight."""
    row, x, weight = neighbours.row, neighbours.x, work.weight[m]
    d0, d1, d2, begin = work.ways[m, 0], work.ways[m, 1], work.ways[m, 2], np.uint64(neighbours.start[i])
    count, over, last = np.uint64(neighbours.start[i + 1]) - begin, 1.0 / neighbours.support, x.shape[1] - 1
    deep, x0, x1, x2 = 1.0 if last == 2 else 0.0, x[i, 0], x[i, 1], x[i, last]
    padded = (count + np.uint64(LANES - 1)) // np.uint64(LANES) * np.uint64(LANES)
    for k in range(count):
        j = np.uint32(row[begin + k])
        d0[k], d1[k], d2[k] = (x[j, 0] - x0) * over, (x[j, 1] - x1) * over, deep * (x[j, last] - x2) * over
        weight[k] = max(lap[begin + k], 0.0)
    for k in range(count, padded):
        d0[k], d1[k], d2[k], weight[k] = 0.0, 0.0, 0.0, 0.0
    work.seen[m] = padded


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _moments(work, m):
    powers(work, m, work.weight[m])
    higher_powers(work, m)
    put_moments(work, m)


@njit(cache=True, error_model="numpy", fastmath=REDUCE, forceinline=True)
def _put(work, m, there, count, tensor):
    """The entries of the tensors of the neighbours of place m, from the row `there` on."""
    x, y, z, over, here, c = work.ways[m, 0], work.ways[m, 1], work.ways[m, 2], work.over, work.product, work.at
    for v in range(len(work.inverse)):
        for a in range(10):
            c[a] = 0.0
        for a in range(len(work.place)):
            c[work.place[a]] = work.scale[a] * work.inverse[v, a, m]
        c1, c2, c3, c4, c5, c6, c7, c8, c9 = c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9]
        for k in range(count):
            along = x[k] * (c1 + c4 * x[k] + c5 * y[k] + c6 * z[k])
            here[k] = over[k] * (along + y[k] * (c2 + c7 * y[k] + c8 * z[k]) + z[k] * (c3 + c9 * z[k]))
        for k in range(count):  # a loop that computes is one of vectors only where it writes along the memory
            tensor[there + k, v] = here[k]


@njit(cache=True, nogil=True)
def _add(turns, given, u, out, factor):
    rows, start, column, tensor = given
    flat = u.shape[1] == 2
    for m in range(turns[0], turns[1]):
        i = rows[m]
        a, b, c = 0.0, 0.0, 0.0
        for p in range(start[m], start[m + 1]):
            j = column[p]
            du, dv = u[j, 0] - u[i, 0], u[j, 1] - u[i, 1]
            if flat:
                a += tensor[p, 0] * du + tensor[p, 1] * dv
                b += tensor[p, 1] * du + tensor[p, 2] * dv
            else:
                dw = u[j, 2] - u[i, 2]
                a += tensor[p, 0] * du + tensor[p, 1] * dv + tensor[p, 2] * dw
                b += tensor[p, 1] * du + tensor[p, 3] * dv + tensor[p, 4] * dw
                c += tensor[p, 2] * du + tensor[p, 4] * dv + tensor[p, 5] * dw
        out[i, 0] += factor * a
        out[i, 1] += factor * b
        if not flat:
            out[i, 2] += factor * c
