"""Velocities with a kink: where the viscosity jumps, the slope of the velocity across the interface jumps too.

The stress is continuous: a fluid that is a hundred times as viscous as the other is sheared a hundredth as fast. Only
the velocity along the interface has a kink, u_t. That across it, u_n, has none, because d u_n / d n is minus the
divergence of u_t along the interface.

- What a shift changes of a velocity (eq. 9). A slope over neighbours on both sides is that of neither side: the more
  viscous fluid would take in a part of the slope of the other one at every shift. The slopes are those of a linear
  function fitted to the neighbours of the own fluid, by least squares with the weight of the kernel.
- The divergence (eq. 5). Among particles in disorder the weights of the derivative along the interface do not cancel
  for a function of the distance beyond it, psi_ij = (1 - t) n . x_ji, t where the pair meets the interface. What a kink
  of size a makes of the divergence is

      a_i . l_i,   l_i = (1 - n n) sum_j psi_ij grad_ij,   a_i = (1 - n n) (mean_j d u_j / d n - d u_i / d n),

  over neighbours of the other fluid, with d u / d n of the own fluid of each, and a_i is one vector for all of them. A
  kink that varies along the interface comes with a normal velocity that is curved across it, and eq. 5 cancels the one
  by the other: with a_ij of each pair in the place of a_i one of the two would be taken out, and where a bubble rises
  6 % more volume went up than down. The mean is that of a linear function along the interface at the particle: where
  the neighbours lie to one side, l_i points there too, and their plain mean is of a place on that side.

Slopes and mean are weights of pairs: they are made once a configuration, for each velocity that asks for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.row_threads import REDUCE, in_one_piece, over_rows
from ..operators.kernel import put_shapes, shape

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..operators.pair_weights import Operators
    from .interface import UnlikePairs

# Determinant of the second moments of the neighbours of the own fluid over that of moments alike in all directions, of
# one trace: below this they lie in a row or are too few, and there is no slope of the own fluid
LEAST_SPREAD = 0.05


@dataclass(frozen=True)
class Kinks:
    """The particles beside an interface where the viscosity jumps.

    ops: Operators; rows: (m,) particles with neighbours of both fluids, that see no wall; first: (m + 1,) where the
    weights of each begin; slope: (n_pairs of those, dim), weights of its slopes, zero of the other fluid; known: (n,)
    which of all particles have slopes; unlike: pairs that the interface parts; normal: (n, dim) of it; along: (m, dim)
    l_i; share: (n_unlike,) of the jump over each of these pairs in that of its particle, zero where a slope is missing.
    """

    ops: Operators
    rows: np.ndarray
    first: np.ndarray
    slope: np.ndarray
    known: np.ndarray
    unlike: UnlikePairs
    normal: np.ndarray
    along: np.ndarray
    share: np.ndarray

    @classmethod
    def build(cls, ops: Operators, phase: np.ndarray, rows: np.ndarray, unlike: UnlikePairs,
              normal: np.ndarray) -> Kinks:
        """Of one configuration; phase: (n + remote,) int8 fluid of each particle; the others as the attributes."""
        first = np.concatenate([[0], np.cumsum(np.diff(ops.start)[rows])])
        slope, known = np.empty((first[-1], ops.dim)), np.zeros(ops.n, np.bool_)
        over_rows(_slope_weights, len(rows), rows, ops.neighbours, phase, (first, slope, known),
                  work=lambda: _scratch(ops.neighbours))
        along, share = np.zeros((len(rows), ops.dim)), np.zeros(len(unlike.pair))
        over_rows(_sums_along, len(rows), rows, ops.neighbours, unlike, (ops.grad, normal),
                  ops.exchange.forward(known), (along, share))
        return cls(ops, rows, first, slope, known, unlike, normal, along, share)

    def put_slopes(self, fields: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Puts the slopes of fields (n + remote, c) in the own fluid, for eq. 9, into gradients (n, c, dim); returns
        which particles have them, (n,) bool."""
        weights = self.rows, self.first, self.slope, self.known
        over_rows(_put_slopes, len(self.rows), weights, (self.ops.start, self.ops.column), fields, gradients)
        return self.known

    def divergence(self, u: np.ndarray) -> np.ndarray:
        """What the kink makes of the divergence of u (n, dim), (n,), 1/s."""
        ops, out = self.ops, np.zeros(self.ops.n)
        gradients = np.zeros((ops.n, ops.dim, ops.dim))
        self.put_slopes(ops.exchange.forward(u.copy()), gradients)  # numba compiles once more for a read-only u
        across = ops.exchange.forward(np.einsum("ick,ik->ic", gradients, self.normal))
        interface = self.unlike.start, self.unlike.pair, self.along, self.share
        over_rows(_divergence, len(self.rows), self.rows, ops.column, interface, across, out)
        return out


class _Scratch(NamedTuple):
    """Of the neighbours of one particle: ways (3, places) there over the support, weight (places,)."""

    ways: np.ndarray
    weight: np.ndarray


def _scratch(neighbours: Neighbourhood) -> _Scratch:
    most = int(neighbours.longest)
    return _Scratch(*in_one_piece((3, most), (most,)))


@njit(cache=True, nogil=True, error_model="numpy")
def _slope_weights(turns, work, rows, neighbours, phase, out):
    x, column, row, start = neighbours.x, neighbours.column, neighbours.row, neighbours.start
    first, slope, known = out
    ways, weight, over, last = work.ways, work.weight, 1.0 / neighbours.support, neighbours.x.shape[1] - 1
    deep = 1.0 if last == 2 else 0.0
    for turn in range(turns[0], turns[1]):
        i = rows[turn]
        begin, own = np.uint64(start[i]), phase[i]
        count = np.uint64(start[i + 1]) - begin
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, last]
        for k in range(count):
            j = np.uint32(row[begin + k])
            ways[0, k], ways[1, k] = (x[j, 0] - x0) * over, (x[j, 1] - x1) * over
            ways[2, k] = deep * (x[j, last] - x2) * over
        put_shapes(neighbours.kind, ways, count, weight)
        for k in range(count):
            weight[k] *= 1.0 if phase[np.uint32(column[begin + k])] == own else 0.0
        xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            d0, d1, d2 = weight[k] * ways[0, k], weight[k] * ways[1, k], weight[k] * ways[2, k]
            xx, xy, xz = xx + d0 * ways[0, k], xy + d0 * ways[1, k], xz + d0 * ways[2, k]
            yy, yz, zz = yy + d1 * ways[1, k], yz + d1 * ways[2, k], zz + d2 * ways[2, k]
        mean = (xx + yy + zz) / (last + 1)
        zz += (1.0 - deep) * mean  # in 2D nothing is along z
        # cofactors of the moments
        a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        determinant = xx * a + xy * b + xz * c
        known[i] = determinant > LEAST_SPREAD * mean**3
        scale, here = over / determinant if known[i] else 0.0, np.uint64(first[turn])
        for k in range(count):
            w, d0, d1, d2 = scale * weight[k], ways[0, k], ways[1, k], ways[2, k]
            slope[here + k, 0] = w * (a * d0 + b * d1 + c * d2)
            slope[here + k, 1] = w * (b * d0 + d * d1 + e * d2)
            if last == 2:
                slope[here + k, 2] = w * (c * d0 + e * d1 + f * d2)


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _put_slopes(turns, weights, pairs, fields, gradients):
    (rows, first, slope, known), (start, column) = weights, pairs
    last = slope.shape[1] - 1
    for turn in range(turns[0], turns[1]):
        i = rows[turn]
        if known[i]:
            begin, here = np.uint64(start[i]), np.uint64(first[turn])
            for c in range(fields.shape[1]):
                s0, s1, s2, own = 0.0, 0.0, 0.0, fields[i, c]
                for k in range(np.uint64(start[i + 1]) - begin):
                    rise = fields[np.uint32(column[begin + k]), c] - own
                    s0, s1 = s0 + slope[here + k, 0] * rise, s1 + slope[here + k, 1] * rise
                    s2 += slope[here + k, last] * rise
                gradients[i, c, 0], gradients[i, c, 1] = s0, s1
                if last == 2:
                    gradients[i, c, 2] = s2


@njit(cache=True, nogil=True, error_model="numpy")
def _sums_along(turns, rows, neighbours, unlike, given, known, out):
    """l_i, and the shares of the jumps over the pairs in the mean of a linear function along the interface at i."""
    (first, pair, fraction), (grad, normal), (along, share) = unlike, given, out
    x, row, column, last = neighbours.x, neighbours.row, neighbours.column, neighbours.x.shape[1] - 1
    over, deep = 1.0 / neighbours.support, 1.0 if last == 2 else 0.0
    for turn in range(turns[0], turns[1]):
        i = rows[turn]
        x0, x1, x2, n0, n1, n2 = x[i, 0], x[i, 1], x[i, last], normal[i, 0], normal[i, 1], deep * normal[i, last]
        l0, l1, l2, total, square = 0.0, 0.0, 0.0, 0.0, 0.0
        w0, w1, w2 = 0.0, 0.0, 0.0  # sums of the ways along the interface
        for q in range(first[i], first[i + 1]):
            p = pair[q]
            j = row[p]
            d0, d1, d2 = x[j, 0] - x0, x[j, 1] - x1, deep * (x[j, last] - x2)
            off = d0 * n0 + d1 * n1 + d2 * n2
            beyond = (1.0 - fraction[q]) * off
            l0, l1, l2 = l0 + beyond * grad[p, 0], l1 + beyond * grad[p, 1], l2 + beyond * grad[p, last]
            r2 = d0 * d0 + d1 * d1 + d2 * d2
            w = shape(neighbours.kind, math.sqrt(r2) * over) if known[i] and known[column[p]] else 0.0
            share[q] = w
            total += w
            square += w * (r2 - off * off)
            w0, w1, w2 = w0 + w * (d0 - off * n0), w1 + w * (d1 - off * n1), w2 + w * (d2 - off * n2)
        across = l0 * n0 + l1 * n1 + deep * l2 * n2
        along[turn, 0], along[turn, 1] = l0 - across * n0, l1 - across * n1
        if last == 2:
            along[turn, 2] = l2 - across * n2
        if total > 0.0:
            w0, w1, w2 = w0 / total, w1 / total, w2 / total
            away = w0 * w0 + w1 * w1 + w2 * w2
            spread = square / total - away
            bent = last / spread if last * away < spread else 0.0  # dim - 1 ways along the interface
            for q in range(first[i], first[i + 1]):
                j = row[pair[q]]
                d0, d1, d2 = x[j, 0] - x0, x[j, 1] - x1, deep * (x[j, last] - x2)
                off = d0 * n0 + d1 * n1 + d2 * n2
                way = w0 * (d0 - off * n0) + w1 * (d1 - off * n1) + w2 * (d2 - off * n2)
                share[q] *= (1.0 - bent * (way - away)) / total


@njit(cache=True, nogil=True)
def _divergence(turns, rows, column, interface, across, out):
    first, pair, along, share = interface
    last = across.shape[1] - 1
    deep = 1.0 if last == 2 else 0.0
    for turn in range(turns[0], turns[1]):
        i = rows[turn]
        l0, l1, l2, jump = along[turn, 0], along[turn, 1], deep * along[turn, last], 0.0
        a0, a1, a2 = across[i, 0], across[i, 1], across[i, last]
        for q in range(first[i], first[i + 1]):
            j = column[pair[q]]
            jump += share[q] * ((across[j, 0] - a0) * l0 + (across[j, 1] - a1) * l1 + (across[j, last] - a2) * l2)
        out[i] = jump
