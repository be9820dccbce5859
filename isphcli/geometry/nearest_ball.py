"""Signed distances to the nearest of many balls, by lists of those that may be nearest to a point of a cell.

Of a cell with its middle c and half its diagonal r let D be the least signed distance of c. The ball that is nearest to
a point of the cell is within D + r of it, and so within D + 2 r of c: the list of the cell has those balls, and the
least over them is exact.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numba import njit

# Edge of a cell over the distance between neighbouring balls of a lattice as dense as these, and over their mean
# radius, whichever is more. A cell of the pack of cases/bead_pack.yaml has 4.4 balls on its list, 16 at most
APART, ACROSS = 1 / 3, 0.7
REACH = 2.0  # edges of a cell: farther from all balls than that a middle has no list
SLACK = 2.0 + 1e-9  # halves of the diagonal, with what is lost to rounding
MIDDLES, NUMBERS, ENTRIES = range(3)  # turns of `fill`
MOST = 64  # balls on a list; a cell with more has none, and is left to a search tree


class BallLists(NamedTuple):
    """Balls and their periodic images, and those that may be nearest by cells, for kernels.

    lower, edge (dim,): of the cells, m; counts (dim,); ball (m, dim + 1): centre and radius, m; start (cells + 1,),
    entry: balls of each cell, the last axis first; half: m, of the diagonal of a cell.
    """

    lower: np.ndarray
    edge: np.ndarray
    counts: np.ndarray
    ball: np.ndarray
    start: np.ndarray
    entry: np.ndarray
    half: float

    @classmethod
    def of(cls, centres: np.ndarray, radii: np.ndarray, period: np.ndarray) -> BallLists:
        """Of balls at centres (n, dim), m, within [0, period) along axes where that is finite; radii (n,), m."""
        n, dim = centres.shape
        around = np.isfinite(period)
        lower = np.where(around, 0.0, (centres - radii[:, None]).min(axis=0))
        size = np.where(around, period, (centres + radii[:, None]).max(axis=0)) - lower
        wanted = max(APART * float(np.prod(size) / n) ** (1.0 / dim),
                     ACROSS * float(np.mean(radii**dim)) ** (1.0 / dim))
        counts = np.maximum(np.rint(size / wanted), 1).astype(np.int64)
        edge = size / counts
        half = 0.5 * float(np.linalg.norm(edge))
        reach = REACH * wanted
        ball = _with_images(np.column_stack([centres, radii]), period, reach + 2.0 * half)
        cells = int(np.prod(counts))
        least, number = np.full(cells, np.inf), np.zeros(cells, np.int64)
        lists = cls(lower, edge, counts, ball, np.zeros(cells + 1, np.int64), np.zeros(0, np.int32), half)
        for turn in (MIDDLES, NUMBERS):
            fill(lists, reach, (least, number), turn)
        number[number > MOST] = 0
        lists.start[1:] = np.cumsum(number)
        number[:] = 0
        lists = lists._replace(entry=np.zeros(lists.start[-1], np.int32))
        fill(lists, reach, (least, number), ENTRIES)
        return lists


def _with_images(ball: np.ndarray, period: np.ndarray, reach: float) -> np.ndarray:
    """Balls with those nearest images that come within `reach`, m, of the box; see `BallLists`."""
    around, dim = np.isfinite(period), len(period)
    found = []
    for shift in itertools.product(*((0, -1, 1) if a else (0,) for a in around)):
        at = ball.copy()
        at[:, :dim] += np.array(shift) * np.where(around, period, 0.0)
        far = reach + at[:, dim:]
        near = ((at[:, :dim] + far >= 0.0) & (at[:, :dim] - far <= period)) | ~around
        found.append(at[near.all(axis=1)])
    return np.concatenate(found)


@njit(cache=True)
def fill(lists, reach, cells, turn):  # pragma: no cover
    """Of each cell the least signed distance of its middle (MIDDLES), then the number of balls on its list (NUMBERS)
    into `cells`, then the lists themselves (ENTRIES), counted once more."""
    (lower, edge, counts, ball, start, entry, half), (least, number) = lists, cells
    dim = len(edge)
    first, last = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for b in range(len(ball)):
        radius = ball[b, dim]
        far = radius + reach + 2.0 * half
        for a in range(dim):
            first[a] = min(max(int((ball[b, a] - far - lower[a]) / edge[a]), 0), counts[a] - 1)
            last[a] = min(max(int((ball[b, a] + far - lower[a]) / edge[a]), 0), counts[a] - 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    away, cell = 0.0, 0
                    for a in range(dim):
                        index = i if a == 0 else j if a == 1 else k
                        cell = cell * counts[a] + index
                        away += (lower[a] + (index + 0.5) * edge[a] - ball[b, a]) ** 2
                    away = np.sqrt(away) - radius
                    if turn == MIDDLES:
                        least[cell] = min(least[cell], away)
                    elif least[cell] <= reach and away <= least[cell] + SLACK * half:
                        if turn == NUMBERS:
                            number[cell] += 1
                        elif start[cell] < start[cell + 1]:
                            entry[start[cell] + number[cell]] = b
                            number[cell] += 1


@njit(cache=True, nogil=True)
def put_nearest(rows, x, lists, d):  # pragma: no cover
    """Lowers d (n,) to the signed distance of points x (n, dim) to the nearest ball; NaN where no list says which one.
    x: m, within [0, period) along periodic axes."""
    lower, edge, counts, ball, start, entry, _ = lists
    dim = len(edge)
    for p in range(rows[0], rows[1]):
        cell, inside = 0, True
        for a in range(dim):
            at = (x[p, a] - lower[a]) / edge[a]
            inside &= 0.0 <= at <= counts[a]
            cell = cell * counts[a] + min(int(at), counts[a] - 1) if inside else 0
        if not inside or start[cell] == start[cell + 1]:
            d[p] = np.nan
            continue
        best = d[p]
        for q in range(start[cell], start[cell + 1]):
            b, away = entry[q], 0.0
            for a in range(dim):
                away += (x[p, a] - ball[b, a]) ** 2
            best = min(best, np.sqrt(away) - ball[b, dim])
        d[p] = best
