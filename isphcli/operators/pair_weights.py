"""The operators of one configuration as weights of each pair (eqs 5-6), without walls; what walls add is `WallSums`.

Sums are taken once a configuration: one weight of the Laplacian and `dim` of the gradient for each pair.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from ..domain import reduce
from ..domain.neighbours import Neighbourhood
from .moments import (
    CHUNKS,
    correction,
    gather_stencil,
    new_correction,
    new_stencil,
    stencil_moments,
    stencil_size,
    stencil_weights,
)


@dataclass(frozen=True)
class Operators:
    """Weights of one configuration; the first `n` rows are the fluid particles.

    neighbours: fluid neighbours in sight;
    lap: (n_pairs,) weights of the velocity Laplacian, 1/m2; grad: (n_pairs, dim) of its gradient, 1/m;
    lap_p, grad_p: the same for the pressure (the very same arrays where a scene has no walls);
    volume: (n,) m^dim; deficient: particles that fell back on a simpler correction;
    walls: sums over the neighbours beyond a wall, or None (see `WallSums`).
    """

    neighbours: Neighbourhood
    lap: np.ndarray
    grad: np.ndarray
    lap_p: np.ndarray
    grad_p: np.ndarray
    volume: np.ndarray
    deficient: int = 0
    walls: WallSums | None = None

    @property
    def n(self) -> int:
        """Number of fluid particles."""
        return self.neighbours.n

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self.grad.shape[1]

    @property
    def start(self) -> np.ndarray:
        """(n + 1,) row pointers of the pairs."""
        return self.neighbours.start

    @property
    def column(self) -> np.ndarray:
        """(n_pairs,) int32 particles that the neighbours are or image."""
        return self.neighbours.column


def build_operators(neighbours: Neighbourhood, volume: np.ndarray, order: int = 2) -> Operators:
    """Operators of a scene without walls. volume: (n,) m^dim; order: 1 (eq. 5) or 2 (gradient exact for quadratics)."""
    lap, grad, deficient = _rows(neighbours, volume, order)
    return Operators(neighbours, lap, grad, lap, grad, volume, int(reduce.total(deficient)))


@njit(cache=True, parallel=True)
def _rows(neighbours, volume, order):
    start = neighbours.start
    n, dim, size = len(start) - 1, neighbours.x.shape[1], stencil_size(start)
    lap = np.empty(len(neighbours.row))
    grad = np.empty((len(neighbours.row), dim))
    deficient = np.zeros(CHUNKS, np.int64)
    for chunk in prange(CHUNKS):
        stencil, moments, out = new_stencil(size), np.empty(41), np.empty((4, size))
        tensors = new_correction()
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            padded = gather_stencil(neighbours, i, volume, stencil)
            stencil_moments(stencil, padded, moments)
            deficient[chunk] += correction(moments, dim, order, tensors)
            stencil_weights(stencil, padded, tensors, order, out)
            _store(out, start[i], start[i + 1], neighbours.support, lap, grad)
    return lap, grad, deficient


@njit(cache=True)
def _store(out, begin, end, support, lap, grad):
    """Weights of one row to their places, with their units."""
    per_length = 1.0 / support
    per_area = per_length * per_length
    for k in range(end - begin):
        p = np.uint64(begin + k)
        lap[p] = out[0, k] * per_area
        grad[p, 0], grad[p, 1] = out[1, k] * per_length, out[2, k] * per_length
        if grad.shape[1] == 3:
            grad[p, 2] = out[3, k] * per_length


@dataclass(frozen=True)
class WallSums:
    """What the wall contributes to the rows of the fluid particles, walls moving with velocity u_W.

    lap: (n,) sum of the Laplacian weights a_iW; lap_velocity: (n, dim) sum a_iW u_W;
    div: (n, dim) sum of the gradient weights g_iW; div_velocity: (n,) sum g_iW . u_W;
    slip: (n, dim, dim) what a slip wall takes off the diagonal, or None where no wall slips;
    symmetric_laplacian: (n_pairs,) symmetric-form weights of the pressure Laplacian;
    near: (n,) bool, particle sees a wall, or fluid that it shares no pressure with;
    narrow, isolated: (n,) bool, see `narrow_pores.classify_neighbourhoods`, or None where there are none;
    slope_velocity: (n, dim, dim) sum u_W g_iW, component of u_W first, or None where a wall slips;
    balanced: (n,) bool, rows whose `grad` and `div` are a balance of fluxes and no gradient, or None.
    """

    lap: np.ndarray
    lap_velocity: np.ndarray
    div: np.ndarray
    div_velocity: np.ndarray
    slip: np.ndarray | None
    symmetric_laplacian: np.ndarray
    near: np.ndarray
    narrow: np.ndarray | None = None
    isolated: np.ndarray | None = None
    slope_velocity: np.ndarray | None = None
    balanced: np.ndarray | None = None
