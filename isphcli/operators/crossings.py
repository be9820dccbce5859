"""What links a fluid particle with each neighbour: whether a wall is between the two, and where the pair meets it.

Pairs of fluid particles that see each other only through a wall are wall pairs as well. `wall_weights` says what the
fraction of the way is for (eq. 11).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain.neighbours import Neighbourhood
from ..domain.row_threads import cut, over_parts, over_rows

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry

AT_ONCE = 2048  # particles whose pairs a thread asks of the geometry in one go: bounds the memory of large scenes
NEAREST_CROSSING = 0.02  # smallest t of a pair at a wall; smaller ones triple the iterations and change k by 1e-5
# What links a pair: a wall is met on the way; the two see each other but share no pressure (`narrow_pores`); they do
MEETS_WALL, IN_SIGHT, SHARES_PRESSURE = 0, 1, 2


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


class Links(NamedTuple):
    """How each pair is linked, as kernels take it.

    link: (n_pairs,) int8, MEETS_WALL, IN_SIGHT or SHARES_PRESSURE; t: of those that meet a wall, in their order, in
    (0, 1], fraction of the way from the fluid particle at which they do; first: (n + 1,) int64, where those of each
    particle begin in it.
    """

    link: np.ndarray
    t: np.ndarray
    first: np.ndarray


@dataclass(frozen=True)
class WallStencils:
    """What operators beside walls are built from.

    neighbours: all of them, dummies included; walls: wall data of their rows; links: how they are linked; volume:
    (n_owned,) of fluid particles and dummies by their numbers, m^dim. Of particles that sit on their lattice all
    volumes are the same: there the columns of the neighbours are their rows, and volume is (n_rows,).
    """

    neighbours: Neighbourhood
    walls: WallTable
    links: Links
    volume: np.ndarray


def crossings(geometry: Geometry, neighbours: Neighbourhood, walls: WallTable) -> Links:
    """Where each pair meets a wall: its t and MEETS_WALL, or SHARES_PRESSURE for fluid pairs in sight."""
    x, start, n = neighbours.x, neighbours.start, neighbours.n
    link, suspect = np.full(len(neighbours.row), SHARES_PRESSURE, np.int8), np.empty(len(neighbours.row), np.bool_)
    many = np.empty(n, np.int64)
    over_rows(_may_cross_a_wall, n, neighbours, walls.fluid, walls.distance, suspect, many)

    def met_walls(part: tuple[int, int]) -> np.ndarray:
        some = start[part[0]] + np.flatnonzero(suspect[start[part[0]] : start[part[1]]])
        j = neighbours.row[some]
        met = geometry.crossing(np.repeat(x[slice(*part)], many[slice(*part)], axis=0), x[j])
        # a pair with a dummy always meets a wall: at the place of the dummy, t = 1, where the geometry finds none
        wall = ~(walls.fluid[j] & (met >= 1.0))
        link[some[wall]] = MEETS_WALL
        return np.clip(met[wall], NEAREST_CROSSING, 1.0)

    t = over_parts(met_walls, cut(n, -(-n // AT_ONCE)))
    first = np.concatenate([[0], np.cumsum(np.diff(start) - in_sight(start, link))])
    return Links(link, np.concatenate([np.zeros(0), *t]), first)


@njit(cache=True, nogil=True)
def _may_cross_a_wall(rows, neighbours, fluid, distance, keep, many):
    """Which pairs may cross a wall, into keep (n_pairs,) bool: those with a dummy, and fluid pairs that two free balls
    do not cover. How many of each particle goes into many (n,)."""
    x, start, index = neighbours.x, neighbours.start, neighbours.row
    for i in range(rows[0], rows[1]):
        count = 0
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
        many[i] = count


def in_sight(start: np.ndarray, link: np.ndarray) -> np.ndarray:
    """Neighbours (n,) of each particle that no wall hides. link: (n_pairs,), see `Links`."""
    counts = np.zeros(len(start) - 1, np.int64)
    over_rows(_count_in_sight, len(counts), start, link, counts)
    return counts


@njit(cache=True, nogil=True)
def _count_in_sight(rows, start, link, counts):
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            counts[i] += link[p] != MEETS_WALL
