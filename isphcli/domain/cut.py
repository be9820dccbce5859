"""Bricks of a box, one per process, with equal numbers of particles: recursive bisection by histograms.

Every process knows the whole tree of cuts; none ever holds the positions of all particles. `Share` has the brick of a
process and the particles of other processes that its own ones see.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .communicator import current
from .exchange import Exchange

BINS = 1024  # of the histogram of one pass: three passes place a cut to 1e-9 of the edge of its brick
PASSES = 3


@dataclass(frozen=True)
class Share:
    """The brick of a process, and the particles of other processes that its own ones see.

    lower, upper: (dim,) corners of its brick, m. ghosts: (g, dim) m, remote particles within a support of the brick,
    each once, where an image of it is near; shift: (g, dim) int8, box lengths between the particle and that image;
    dummies: (f, dim) m, dummies of other processes within a support; exchange, of_dummies: fetch values of the remote
    particles and of these dummies; cut: the bricks of all; sites: (n,) int64 numbers of the sites of the own particles
    in the lattice.
    """

    lower: np.ndarray
    upper: np.ndarray
    ghosts: np.ndarray
    shift: np.ndarray
    dummies: np.ndarray
    exchange: Exchange
    of_dummies: Exchange
    cut: Cut
    sites: np.ndarray


class Brick(NamedTuple):
    """A brick while it is cut: that of the processes from `first` to before `end`, and its corners (dim,), m."""

    first: int
    end: int
    lower: np.ndarray
    upper: np.ndarray

    @property
    def several(self) -> bool:
        """Whether it belongs to several processes, and is to be cut."""
        return self.end - self.first > 1


class TreeLevel(NamedTuple):
    """One level of the tree: of each of its bricks the axis and place of its cut, and the number of its first part in
    the next level; whole: bricks of one process, which are not cut."""

    axis: np.ndarray
    place: np.ndarray
    first: np.ndarray
    whole: np.ndarray


class Cut:
    """The bricks of all processes. x: (n, dim) m, some of the particles of the scene on each process, each on one;
    lower, upper: (dim,) corners of the box, m. All processes make it together.

    bricks: (size, 2, dim) corners, m; a place on a cut belongs to the upper brick.
    """

    def __init__(self, x: np.ndarray, lower: np.ndarray, upper: np.ndarray):
        self.levels: list[TreeLevel] = []
        nodes = [Brick(0, current().size, np.array(lower, float), np.array(upper, float))]
        of = np.zeros(len(x), np.int64)
        while any(node.several for node in nodes):
            axis = np.array([int(np.argmax(node.upper - node.lower)) for node in nodes])
            along = x[np.arange(len(x)), axis[of]]
            share = np.array([(node.end - node.first) // 2 / (node.end - node.first) for node in nodes])
            low, high = (np.array([corner[a] for corner, a in zip(corners, axis)])
                         for corners in ([node.lower for node in nodes], [node.upper for node in nodes]))
            place = _quantiles(along, of, share, low, high)
            parts: list[Brick] = []
            starts = []
            for node, a, cut in zip(nodes, axis, place):
                starts.append(len(parts))
                if not node.several:
                    parts.append(node)
                    continue
                middle, below, above = (node.first + node.end) // 2, node.upper.copy(), node.lower.copy()
                below[a] = above[a] = cut
                parts += [Brick(node.first, middle, node.lower, below), Brick(middle, node.end, above, node.upper)]
            level = TreeLevel(axis, place, np.array(starts), np.array([not node.several for node in nodes]))
            self.levels.append(level)
            of, nodes = _descend(level, of, along), parts
        self.bricks = np.array([[node.lower, node.upper] for node in nodes])

    def owner(self, x: np.ndarray) -> np.ndarray:
        """(n,) process of each place x (n, dim), m."""
        of = np.zeros(len(x), np.int64)
        for level in self.levels:
            of = _descend(level, of, x[np.arange(len(x)), level.axis[of]])
        return of


def even_bricks(lower: np.ndarray, upper: np.ndarray, count: int) -> np.ndarray:
    """Corners (count, 2, dim) of the bricks of so many processes in a box, corners (dim,), that fluid fills evenly:
    those of `Cut`."""
    bricks = [Brick(0, count, np.array(lower, float), np.array(upper, float))]
    while any(brick.several for brick in bricks):
        parts: list[Brick] = []
        for brick in bricks:
            if not brick.several:
                parts.append(brick)
                continue
            axis = int(np.argmax(brick.upper - brick.lower))
            middle, below, above = (brick.first + brick.end) // 2, brick.upper.copy(), brick.lower.copy()
            share = (middle - brick.first) / (brick.end - brick.first)
            below[axis] = above[axis] = brick.lower[axis] + share * (brick.upper - brick.lower)[axis]
            parts += [Brick(brick.first, middle, brick.lower, below), Brick(middle, brick.end, above, brick.upper)]
        bricks = parts
    return np.array([[brick.lower, brick.upper] for brick in bricks])


def _descend(level: TreeLevel, of: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Bricks (n,) of the next level from those of a level, by the coordinates along the axes of their cuts."""
    return level.first[of] + ((along >= level.place[of]) & ~level.whole[of])


def _quantiles(along: np.ndarray, of: np.ndarray, share: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Places (k,) below which the given shares of the particles of each of k bricks lie, as nearly as planes of a
    lattice allow: in the middle of the gap beside the one that holds the quantile."""
    k, low, high = len(share), low.copy(), high.copy()
    below, whole = np.zeros(k), None
    for _ in range(PASSES):
        bin_of = np.floor((along - low[of]) / (high - low)[of] * BINS)
        inside = (bin_of >= 0) & (bin_of < BINS)
        counts = np.bincount(of[inside] * BINS + bin_of[inside].astype(np.int64), minlength=k * BINS)
        counts = current().sum(counts.reshape(k, BINS))
        whole = counts.sum(axis=1) if whole is None else whole
        upto = below[:, None] + np.cumsum(counts, axis=1)
        hit = np.minimum((upto < (share * whole)[:, None]).sum(axis=1), BINS - 1)
        below = np.where(hit > 0, upto[np.arange(k), np.maximum(hit - 1, 0)], below)
        width = (high - low) / BINS
        low = low + hit * width
        high = low + width
    place: np.ndarray = np.where(upto[np.arange(k), hit] - share * whole < share * whole - below, high, low)
    under, beside = along < place[of], np.full((2, k), -np.inf)
    np.maximum.at(beside[0], of[under], along[under])
    np.maximum.at(beside[1], of[~under], -along[~under])
    beside = current().max(beside)
    both = np.isfinite(beside).all(axis=0)
    place[both] = 0.5 * (beside[0, both] - beside[1, both])
    return place
