"""Where the pairs of a configuration meet a wall: the fraction of the way from a fluid particle to its neighbour.

Pairs of fluid particles that see each other only through a wall are wall pairs as well. `wall_weights` says what the
fraction is for (eq. 11).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.neighbours import Neighbourhood

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry

AT_ONCE = 4_000_000  # pairs asked of the geometry in one go: bounds the memory of large scenes
NEAREST = 0.02  # of a pair: nearest a wall may be; nearer ones triple the iterations and change k by 1e-5


class WallTable(NamedTuple):
    """Wall data of every row of the table of positions, as kernels take them.

    fluid: (n_rows,) bool; distance: (n_rows,) signed, m; wall: (n_rows,) int32 nearest wall;
    velocity: (n_walls, dim) m/s; slip_length: (n_walls,) m; normal: (n_rows, dim) into the fluid,
    used by slip walls only (else empty); spin: (n_walls, dim, dim) 1/s where walls turn, u_W = velocity + spin x, else
    (0, dim, dim).
    """

    fluid: np.ndarray
    distance: np.ndarray
    wall: np.ndarray
    velocity: np.ndarray
    slip_length: np.ndarray
    normal: np.ndarray
    spin: np.ndarray


@dataclass(frozen=True)
class WallStencils:
    """What operators beside walls are built from.

    neighbours: all of them, dummies included; walls: wall data of their rows; fraction: (n_pairs,) their crossings, see
    `crossings`; volume: (n_owned,) of fluid particles and dummies, m^dim.
    """

    neighbours: Neighbourhood
    walls: WallTable
    fraction: np.ndarray
    volume: np.ndarray


def crossings(geometry: Geometry, neighbours: Neighbourhood, walls: WallTable) -> np.ndarray:
    """Fraction t of each pair at which it meets a wall, (n_pairs,) in (0, 1]; 2.0 for fluid pairs in sight."""
    x = neighbours.x
    fraction = np.full(len(neighbours.row), 2.0)
    ask = _suspects(neighbours, walls.fluid, walls.distance)
    for begin in range(0, len(ask), AT_ONCE):
        some = ask[begin : begin + AT_ONCE]
        i = np.searchsorted(neighbours.start, some, side="right") - 1
        j = neighbours.row[some]
        t = geometry.crossing(x[i], x[j])
        # a fluid neighbour in sight stays one; a dummy that the geometry calls free is met at its own place
        sees = walls.fluid[j] & (t >= 1.0)
        fraction[some] = np.where(sees, 2.0, np.clip(t, NEAREST, 1.0))
    return fraction


@njit(cache=True)
def _suspects(neighbours, fluid, distance):
    """Pairs that may cross a wall: those with a dummy, and fluid pairs that two free balls do not cover."""
    x, start, index = neighbours.x, neighbours.start, neighbours.row
    count = 0
    keep = np.empty(len(index), np.bool_)
    for i in range(len(start) - 1):
        for p in range(start[i], start[i + 1]):
            j = index[p]
            keep[p] = not fluid[j]
            if fluid[j]:
                r2 = 0.0
                for k in range(x.shape[1]):
                    r2 += (x[j, k] - x[i, k]) ** 2
                clear = (distance[i] + distance[j]) * (1.0 + 1e-9)
                keep[p] = clear * clear < r2
            count += keep[p]
    out = np.empty(count, np.int64)
    count = 0
    for p in range(len(index)):
        if keep[p]:
            out[count] = p
            count += 1
    return out


@njit(cache=True)
def in_sight(start, fraction):
    """Neighbours (n,) of each particle that no wall hides."""
    counts = np.zeros(len(start) - 1, np.int64)
    for i in range(len(counts)):
        for p in range(start[i], start[i + 1]):
            counts[i] += fraction[p] > 1.0
    return counts
