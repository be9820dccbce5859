"""The operators of one configuration as weights of each pair; `wall_weights` builds those beside walls.

The weights are those of `moments.stencil_weights` (eqs 5 and 6); steady flow has them in `lattice_weights`.

Sums are taken once a configuration: one weight of the Laplacian and `dim` of the gradient for each pair.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..domain.neighbours import Neighbourhood
from ..domain.row_threads import over_rows
from . import pair_sums
from .moments import correction, gather_stencil, new_workspace, stencil_moments, stencil_weights
from .neighbourhood_class import ISOLATED, NARROW
from .protocol import WallSums


@dataclass(frozen=True)
class Operators:
    """Weights of one configuration, of the protocol `DiscreteOperators`; the first `n` rows are the fluid particles.

    neighbours: fluid neighbours in sight;
    lap: (n_pairs,) weights of the velocity Laplacian, 1/m2; grad: (n_pairs, dim) of its gradient, 1/m;
    grad_p: the same for the pressure (the very same array where a scene has no walls); lap_far: (n_pairs,) weights of
    the Laplacian of the pressure of rows that see no wall, see `lap_p`: lap over the density, the very same array
    where that is 1;
    volume: (n + remote,) m^dim; deficient: particles that fell back on a simpler correction;
    walls: sums over the neighbours beyond a wall, and what pairs and particles are beside walls, or None;
    exchange: where the values of remote particles come from, whose columns are n and more.
    """

    neighbours: Neighbourhood
    lap: np.ndarray
    grad: np.ndarray
    lap_far: np.ndarray
    grad_p: np.ndarray
    volume: np.ndarray
    deficient: int = 0
    walls: WallRows | None = None
    exchange: Exchange = NO_EXCHANGE

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

    @property
    def lap_p(self) -> np.ndarray:
        """(n_pairs,) weights of the pressure Laplacian, 1/m2; of rows that see a wall those of the symmetric form,
        which they share with `walls`, so that an array of all is made only where it is asked for."""
        if self.walls is None:
            return self.lap_far
        lap_p = self.lap_far.copy()
        over_rows(_put_rows_of, self.n, self.start, self.walls.near_wall, self.walls.symmetric_laplacian, lap_p)
        return lap_p

    def gradient_p(self, p: np.ndarray) -> np.ndarray:
        """Pressure gradient (n, dim) of p (n,)."""
        return self.gradient_with_remote(self.exchange.forward(p))

    def gradient_with_remote(self, p: np.ndarray) -> np.ndarray:
        """Pressure gradient (n, dim) of p (n + remote,)."""
        return pair_sums.gradient_of_scalar(self.start, self.column, self.grad_p, p)

    def laplacian_p(self, p: np.ndarray) -> np.ndarray:
        """Laplacian (n,) of the pressure p (n,) in weights of eq. 6, walls left out."""
        return pair_sums.laplacian_of_scalar(self.start, self.column, self.lap_p, self.exchange.forward(p))

    def potential_gradient(self, force: np.ndarray) -> np.ndarray:
        """The acceleration force (dim,) as the gradient of its potential, (n, dim): see `DiscreteOperators`."""
        return pair_sums.gradient_of_potential(self.neighbours, self.grad_p, force)

    def total_divergence(self, u: np.ndarray) -> np.ndarray:
        """Divergence (n,) of u (n, dim), walls and their velocities included."""
        div = pair_sums.divergence(self.start, self.column, self.grad, self.exchange.forward(u))
        if self.walls is not None:
            div += self.walls.divergence(u)
        return div


def build_operators(neighbours: Neighbourhood, volume: np.ndarray, order: int = 2,
                    exchange: Exchange = NO_EXCHANGE) -> Operators:
    """Operators of a scene without walls. volume: (n + remote,) m^dim; order: 1 (eq. 5) or 2 (gradient exact for
    quadratics); exchange: of the remote particles."""
    pairs = len(neighbours.row)
    lap, grad = np.empty(pairs), np.empty((pairs, neighbours.x.shape[1]))
    work = partial(new_workspace, neighbours)
    deficient = over_rows(_rows, neighbours.n, neighbours, volume, order, lap, grad, work=work)
    return Operators(neighbours, lap, grad, lap, grad, volume, int(reduce.total(np.array(deficient))),
                     exchange=exchange)


@njit(cache=True, nogil=True)
def _rows(rows, work, neighbours, volume, order, lap, grad):
    """Weights of the pairs of rows into lap (n_pairs,) and grad (n_pairs, dim); returns how many rows are deficient."""
    start, deficient = neighbours.start, 0
    for i in range(rows[0], rows[1]):
        padded = gather_stencil(neighbours, i, volume, work.stencil)
        stencil_moments(work.stencil, padded, work.moments)
        deficient += correction(work.moments, grad.shape[1], order, work.tensors)
        stencil_weights(work.stencil, padded, work.tensors, order, work.weights)
        _store(work.weights, start[i], start[i + 1], neighbours.support, lap, grad)
    return deficient


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


@njit(cache=True, nogil=True)
def _put_rows_of(rows, start, which, values, out):
    """The values (n_pairs,) of rows which (n,) to their places in out (n_pairs,)."""
    for i in range(rows[0], rows[1]):
        if which[i]:
            for p in range(start[i], start[i + 1]):
                out[p] = values[p]


@dataclass(frozen=True)
class WallRows(WallSums):
    """Sums over walls, and what else the rows of particles beside them need.

    symmetric_laplacian: (n_pairs,) symmetric-form weights of the pressure Laplacian;
    classes: (n,) int8, see `neighbourhood_class`; near_wall: (n,) bool, particle sees a wall, or fluid that it shares
    no pressure with;
    slope_velocity: (n, dim, dim) sum u_W g_iW, component of u_W first, or None where a wall slips;
    distance: (n + remote,) of the particles to the nearest wall, m.
    """

    symmetric_laplacian: np.ndarray
    near_wall: np.ndarray
    classes: np.ndarray
    slope_velocity: np.ndarray | None
    distance: np.ndarray

    @property
    def narrow(self) -> np.ndarray:
        """(n,) bool, in a pore narrower than a corner, or isolated."""
        return self.classes >= NARROW

    @property
    def isolated(self) -> np.ndarray:
        """(n,) bool, in a dead end that shares no pressure with the rest."""
        return self.classes == ISOLATED

    @cached_property
    def dead_ends(self) -> bool:
        """Whether a particle is isolated."""
        return reduce.any_true(self.isolated)
