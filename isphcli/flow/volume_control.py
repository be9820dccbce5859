"""The volume of the fluid in blocks of the scene, kept over long runs (particles.keep_volume).

A divergence of zero is not quite the volume kept: what it misses, a few per cent of the velocity beside walls and
menisci, has the same sign for as long as the flow keeps its shape, and particles gather in one part of a scene and
thin out in another (a Berea corner with spurious currents some twenty times its flux: 3 % in 1500 steps). Shifting
does not see it: it evens out neighbours, not regions. The number of particles that a region holds is known, from the
lattice that the run began with. Each block of SIDE spacings with more of them is therefore made to expand, as Asai et
al. (2012) do particle by particle:

    div u = (N - N_0) / (N_0 T),      T = `keep_volume` steps,

with numbers N of bilinear shares, so that nothing jumps where a particle changes its block. Sums over blocks see
neither the disorder of particles nor their distance from walls, both of which bias the density of a single particle by
more than what is to be taken out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry

SIDE = 6  # spacings: some 50 to 200 particles a block
# Of N_0 of the fullest block, added to that of each: blocks in rock with little fluid are held less strictly
LEAST_FULL = 0.02


class KeptVolume:
    """geometry: Geometry; x: (n, dim) fluid particles where they begin, m; spacing: m; steps: T over the step."""

    def __init__(self, geometry: Geometry, x: np.ndarray, spacing: float, steps: float):
        size = geometry.upper - geometry.lower
        self.lower, self.steps = geometry.lower, steps
        self.blocks = np.array([_blocks(round(length / spacing)) for length in size])
        self.side = size / self.blocks
        self.nodes = np.where(geometry.periodic, self.blocks, self.blocks + 1)
        self.wanted = self._numbers(self._shares(x))

    def expansion(self, x: np.ndarray, dt: float) -> tuple[np.ndarray, float]:
        """Divergence (n,) that the particles at x (n, dim) are to have in a step of dt, 1/s, and the root mean square
        of (N - N_0) / N_0 over the fluid."""
        shares = self._shares(x)
        surplus = (self._numbers(shares) - self.wanted) / (self.wanted + LEAST_FULL * self.wanted.max())
        drift = float(np.sqrt((surplus**2 @ self.wanted) / self.wanted.sum()))
        return sum(share * surplus[node] for share, node in shares) / (self.steps * dt), drift

    def _numbers(self, shares: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        count = int(np.prod(self.nodes))
        return sum((reduce.total_by(node, share, count) for share, node in shares), np.zeros(count))

    def _shares(self, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """[(share (n,), node (n,))] of the 2^dim nodes round each particle."""
        place = (x - self.lower) / self.side
        first = np.clip(np.floor(place).astype(int), 0, self.blocks - 1)
        beyond, found = place - first, []
        for corner in np.ndindex((2,) * x.shape[1]):
            share = np.prod(np.where(corner, beyond, 1.0 - beyond), axis=1)
            found.append((share, np.ravel_multi_index(((first + corner) % self.nodes).T, self.nodes)))
        return found


def _blocks(layers: int) -> int:
    """Number of blocks along an axis of so many layers of particles, of a whole number of layers each if 5 to 8 will
    do: the number of particles in other blocks changes when a lattice is carried through them."""
    whole = [n for n in range(1, layers + 1) if layers % n == 0 and 5 <= layers // n <= 8]
    return min(whole, key=lambda n: abs(layers // n - SIDE)) if whole else max(round(layers / SIDE), 1)
