"""What is asked of the operators of one configuration, however their weights are stored.

There are two storages: `pair_weights.Operators` keeps a weight per pair, which particles that move need anew each step,
and `lattice_weights.LatticeWeights` keeps a few tensors per particle, which a steady solve on a lattice applies
hundreds of times. Both hold the same sums over walls, `WallSums` (eq. 11).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class WallSums:
    """What walls contribute to the rows of the fluid particles (eq. 11), walls moving with velocity u_W.

    lap: (n,) sum of the Laplacian weights a_iW; lap_velocity: (n, dim) sum a_iW u_W;
    div: (n, dim) sum of the gradient weights g_iW; div_velocity: (n,) sum g_iW . u_W;
    slip: (n, dim, dim) what a slip wall takes off the diagonal, or None where no wall slips.
    """

    lap: np.ndarray
    lap_velocity: np.ndarray
    div: np.ndarray
    div_velocity: np.ndarray
    slip: np.ndarray | None

    def laplacian(self, u: np.ndarray) -> np.ndarray:
        """What walls add to the velocity Laplacian of u (n, dim)."""
        result = self.lap_velocity - self.lap[:, None] * u
        if self.slip is not None:
            result += np.einsum("nkm,nm->nk", self.slip, u)
        return result

    def divergence(self, u: np.ndarray) -> np.ndarray:
        """What walls add to the divergence of u (n, dim), (n,)."""
        return self.div_velocity - np.einsum("nk,nk->n", self.div, u)


class DiscreteOperators(Protocol):
    """The operators of one configuration; rows are the n fluid particles."""

    @property
    def n(self) -> int:
        """Number of fluid particles."""

    @property
    def dim(self) -> int:
        """2 or 3."""

    @property
    def start(self) -> np.ndarray:
        """(n + 1,) row pointers of the pairs in sight."""

    @property
    def column(self) -> np.ndarray:
        """(n_pairs,) int32 particles that the neighbours are or image."""

    @property
    def walls(self) -> WallSums | None:
        """Sums over the neighbours beyond walls, or None in a scene without walls."""

    def gradient_p(self, p: np.ndarray) -> np.ndarray:
        """Pressure gradient (n, dim) of p (n,)."""

    def potential_gradient(self, force: np.ndarray) -> np.ndarray:
        """A uniform acceleration (dim,) as the gradient of its potential in the pressure's own operator, (n, dim).

        Where the neighbours span all directions it is the force itself; in a dead end one particle wide it is what a
        pressure can balance, and the fluid rests.
        """

    def total_divergence(self, u: np.ndarray) -> np.ndarray:
        """Divergence (n,) of u (n, dim), walls and their velocities included."""
