"""What the Laplacian of eq. 6 makes of functions of fourth order, from which `flow/viscous_solve.py` takes one that is
exact for them too."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from ..domain.row_threads import REDUCE, over_rows

if TYPE_CHECKING:
    from .pair_weights import Operators

# c_i times the sum of the weights is 0.35 on a cubic lattice and 0.29 on a square one; below a half the rows of 1 + c L
# are dominated by their diagonals, however close two particles of a stencil are
DOMINANT = 0.45


def laplacian_excess(ops: Operators) -> np.ndarray:
    """c (n,), m2, by which the Laplacian L f = lap f + c lap lap f misses functions of fourth order, averaged over
    directions; zero beside walls. ops: Operators.

    On lattices c / dx^2 is 0.08 in 3D with a support of 2.1, and 0.09 in 2D with 2.3.
    """
    near_wall = ops.walls.near_wall if ops.walls is not None else np.zeros(ops.n, np.bool_)
    out = np.zeros(ops.n)
    over_rows(_laplacian_excess, ops.n, ops.neighbours, ops.lap, near_wall, out)
    return out


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _laplacian_excess(rows, neighbours, lap, near_wall, out):
    start, row, x = neighbours.start, neighbours.row, neighbours.x
    dim = x.shape[1]
    last, deep = dim - 1, 1.0 if dim == 3 else 0.0
    for i in range(rows[0], rows[1]):
        fourth, total, x0, x1, x2 = 0.0, 0.0, x[i, 0], x[i, 1], x[i, last]
        for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            j = np.uint32(row[p])
            r2 = (x[j, 0] - x0) ** 2 + (x[j, 1] - x1) ** 2 + deep * (x[j, last] - x2) ** 2
            fourth += lap[p] * r2 * r2
            total += abs(lap[p])
        if not near_wall[i] and fourth > 0.0:
            out[i] = min(fourth / (8.0 * dim * (dim + 2)), DOMINANT / total)  # lap lap r^4 = 8 dim (dim + 2)
