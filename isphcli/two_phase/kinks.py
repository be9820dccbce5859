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
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from ..domain.row_threads import over_rows
from ..operators.kernel import shape

if TYPE_CHECKING:
    from ..operators.pair_weights import Operators
    from .interface import UnlikePairs

# Determinant of the second moments of the neighbours of the own fluid over that of moments alike in all directions, of
# one trace: below this they lie in a row or are too few, and there is no slope of the own fluid
LEAST_SPREAD = 0.05


@dataclass(frozen=True)
class Kinks:
    """The particles beside an interface where the viscosity jumps.

    ops: Operators; phase: (n + remote,) int8 fluid of each particle; rows: (m,) particles with neighbours of both
    fluids, that see no wall; unlike: pairs that the interface parts; normal: (n, dim) of it; along: (m, dim) l_i.
    """

    ops: Operators
    phase: np.ndarray
    rows: np.ndarray
    unlike: UnlikePairs
    normal: np.ndarray
    along: np.ndarray

    @classmethod
    def build(cls, ops: Operators, phase: np.ndarray, rows: np.ndarray, unlike: UnlikePairs,
              normal: np.ndarray) -> Kinks:
        """Of one configuration; arguments as the attributes."""
        along = np.zeros((len(rows), ops.dim))
        over_rows(_sums_along, len(rows), rows, ops.neighbours, unlike, ops.grad, normal, along)
        return cls(ops, phase, rows, unlike, normal, along)

    def put_slopes(self, fields: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Puts the slopes of fields (n + remote, c) in the own fluid, for eq. 9, into gradients (n, c, dim); returns
        which particles have them, (n,) bool."""
        known = np.zeros(self.ops.n, np.bool_)
        over_rows(_put_slopes, len(self.rows), self.rows, self.ops.neighbours, self.phase, fields, gradients, known)
        return known

    def divergence(self, u: np.ndarray) -> np.ndarray:
        """What the kink makes of the divergence of u (n, dim), (n,), 1/s."""
        ops, out = self.ops, np.zeros(self.ops.n)
        gradients = np.zeros((ops.n, ops.dim, ops.dim))
        known = self.put_slopes(ops.exchange.forward(u.copy()), gradients)  # numba compiles once more for a read-only u
        across, known = ops.exchange.forward_each(np.einsum("ick,ik->ic", gradients, self.normal), known)
        interface = self.unlike.start, self.unlike.pair, self.along, self.normal
        over_rows(_divergence, len(self.rows), self.rows, ops.neighbours, interface, (across, known), out,
                  work=lambda: (np.empty(ops.dim), np.empty(ops.dim)))
        return out


@njit(cache=True, nogil=True, error_model="numpy")
def _put_slopes(turns, rows, neighbours, phase, fields, gradients, known):
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    over, last = 1.0 / neighbours.support, x.shape[1] - 1
    deep = 1.0 if last == 2 else 0.0
    for turn in range(turns[0], turns[1]):
        i = rows[turn]
        xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(start[i], start[i + 1]):
            if phase[column[p]] == phase[i]:
                j = row[p]
                d0, d1, d2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], deep * (x[j, last] - x[i, last])
                w = shape(neighbours.kind, math.sqrt(d0 * d0 + d1 * d1 + d2 * d2) * over)
                xx, xy, xz = xx + w * d0 * d0, xy + w * d0 * d1, xz + w * d0 * d2
                yy, yz, zz = yy + w * d1 * d1, yz + w * d1 * d2, zz + w * d2 * d2
        mean = (xx + yy + zz) / (last + 1)
        zz += (1.0 - deep) * mean  # in 2D nothing is along z
        # cofactors of the moments
        a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        determinant = xx * a + xy * b + xz * c
        if not determinant > LEAST_SPREAD * mean**3:
            continue
        known[i] = True
        for k in range(fields.shape[1]):
            for m in range(last + 1):
                gradients[i, k, m] = 0.0
        for p in range(start[i], start[i + 1]):
            if phase[column[p]] == phase[i]:
                j = row[p]
                d0, d1, d2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], deep * (x[j, last] - x[i, last])
                w = shape(neighbours.kind, math.sqrt(d0 * d0 + d1 * d1 + d2 * d2) * over) / determinant
                g0 = w * (a * d0 + b * d1 + c * d2)
                g1 = w * (b * d0 + d * d1 + e * d2)
                g2 = w * (c * d0 + e * d1 + f * d2)
                for k in range(fields.shape[1]):
                    rise = fields[column[p], k] - fields[i, k]
                    gradients[i, k, 0] += g0 * rise
                    gradients[i, k, 1] += g1 * rise
                    if last == 2:
                        gradients[i, k, 2] += g2 * rise


@njit(cache=True, nogil=True)
def _sums_along(turns, rows, neighbours, unlike, grad, normal, along):
    (first, pair, fraction), x, row = unlike, neighbours.x, neighbours.row
    dim = x.shape[1]
    for turn in range(turns[0], turns[1]):
        i = rows[turn]
        for q in range(first[i], first[i + 1]):
            p, beyond = pair[q], 0.0
            for k in range(dim):
                beyond += (1.0 - fraction[q]) * (x[row[p], k] - x[i, k]) * normal[i, k]
            for k in range(dim):
                along[turn, k] += beyond * grad[p, k]
        across = 0.0
        for k in range(dim):
            across += along[turn, k] * normal[i, k]
        for k in range(dim):
            along[turn, k] -= across * normal[i, k]


@njit(cache=True, nogil=True)
def _divergence(turns, work, rows, neighbours, interface, slopes, out):
    (first, pair, along, normal), (across, known) = interface, slopes
    x, row, column = neighbours.x, neighbours.row, neighbours.column
    dim = x.shape[1]
    ways, crossed = work  # sums of the ways along the interface, and of those times what the jump makes of l_i
    for turn in range(turns[0], turns[1]):
        i = rows[turn]
        if not known[i]:
            continue
        total, mean, square = 0.0, 0.0, 0.0
        for k in range(dim):
            ways[k], crossed[k] = 0.0, 0.0
        for q in range(first[i], first[i + 1]):
            p = pair[q]
            j, r2, off, jump = column[p], 0.0, 0.0, 0.0
            if known[j]:
                for k in range(dim):
                    d = x[row[p], k] - x[i, k]
                    r2 += d * d
                    off += d * normal[i, k]
                    jump += (across[j, k] - across[i, k]) * along[turn, k]
                w = shape(neighbours.kind, math.sqrt(r2) / neighbours.support)
                total += w
                mean += w * jump
                square += w * (r2 - off * off)
                for k in range(dim):
                    d = x[row[p], k] - x[i, k] - off * normal[i, k]
                    ways[k] += w * d
                    crossed[k] += w * d * jump
        if total > 0.0:
            # of a linear function along the interface at i
            mean, away, slope = mean / total, 0.0, 0.0
            for k in range(dim):
                way = ways[k] / total
                away += way * way
                slope += way * (crossed[k] / total - way * mean)
            spread = square / total - away
            out[i] = mean - (dim - 1) * slope / spread if (dim - 1) * away < spread else mean
