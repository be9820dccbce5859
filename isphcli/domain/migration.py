"""Particles that move between processes: each goes, with its values, to the process whose brick it is in.

Bricks stay as they were cut at the start: incompressible fluid keeps the number of particles in each.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .communicator import current
from .cut import Share
from .exchange import NeighbourExchange, deliver


class Numbered(NeighbourExchange):
    """The exchange of particles that keep their numbers when they change the process.

    number: (n,) int64 of the own particles; those of all processes are 0 to below their count.
    """

    number: np.ndarray

    def from_other_side(self, told: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
                        asked: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """Values of pairs (i, j) that other processes hold, for the pairs (j, i) of this process.

        told: own rows (m,), remote columns (m,), x_column - x_row (m, dim), m, and values (m, k) of pairs; asked: the
        same without values, (w,). Returns (w, k), zero where the other process has no such pair: round-off at the edge
        of a support may leave a pair with one of the two. `told` has to hold every pair that others ask for.
        """
        number, n = self.forward(self.number), len(self.number)
        owner = self.forward(np.full(n, self._comm.rank))
        row, column, offset, values = told
        mine, other, back, come, _ = deliver(self._comm, owner[column], number[column], number[row], -offset, values)
        row, column, offset = asked
        count = self._comm.allreduce(n)
        key = mine * count + other
        order = np.argsort(key, kind="stable")
        key, wanted = key[order], number[row] * count + number[column]
        found, at = np.zeros((len(row), values.shape[1])), np.searchsorted(key, wanted)
        left = np.arange(len(row))
        while len(left):  # in a thin box a particle is seen through several of its sides
            left = left[at[left] < len(key)]
            left = left[key[at[left]] == wanted[left]]
            place = order[at[left]]
            same = ((back[place] - offset[left]) ** 2).sum(axis=1) < 1e-12 * (offset[left] ** 2).sum(axis=1)
            found[left[same]] = come[place[same]]
            left = left[~same]
            at[left] += 1
        return found


def numbers_of(sites: np.ndarray, count: int) -> np.ndarray:
    """(n,) int64 place of each own site, (n,) int64 below `count`, among the sites of all processes in rising order:
    the number of its particle in a run of one process."""
    comm, size = current().raw, current().size  # type: ignore[attr-defined]
    block = sites * size // count
    come, want = deliver(comm, block, sites)
    found = np.empty_like(come)
    found[np.argsort(come)] = (comm.exscan(len(come)) or 0) + np.arange(len(come))
    answers, _ = deliver(comm, np.repeat(np.arange(size), want), found)
    out = np.empty_like(sites)
    out[np.argsort(block, kind="stable")] = answers
    return out


class Migration:
    """Sends particles between the bricks of a box.

    share: of this process, of the lattice; lower, upper: (dim,) corners of the box, m; periodic: (dim,); sight: how far
    particles see, m.
    """

    def __init__(self, share: Share, lower: np.ndarray, upper: np.ndarray, periodic: Sequence[bool] | np.ndarray,
                 sight: float):
        self.share, self.lower, self.upper = share, lower, upper
        self.periodic, self.sight = np.array(periodic), sight
        self._near = self._near_bricks()

    def reaching(self, reach: float) -> Migration:
        """The same bricks, for particles that see as far as `reach`, m."""
        return Migration(self.share, self.lower, self.upper, self.periodic, reach)

    def _near_bricks(self) -> list[tuple[int, np.ndarray]]:
        """(process, shift (dim,) by whole boxes, m) of every brick, or image of one, in sight of the own brick."""
        size, bricks, reach = self.upper - self.lower, self.share.cut.bricks, self.sight * (1.0 + 1e-9)
        most = np.where(self.periodic, np.ceil(reach / size), 0).astype(int)
        found = []
        for boxes in itertools.product(*(range(-k, k + 1) for k in most)):
            moved = np.array(boxes) * size
            near = np.all((bricks[:, 0] - reach < self.share.upper + moved)
                          & (bricks[:, 1] + reach > self.share.lower + moved), axis=1)
            found += [(int(process), moved) for process in np.flatnonzero(near) if process != current().rank]
        return sorted(found, key=lambda entry: (entry[0], np.abs(entry[1]).sum()))

    def settled(self, x: np.ndarray, *carried: np.ndarray) -> tuple[np.ndarray, ...]:
        """Positions x (n, dim) in the box and further arrays (n, ...) of the particles, on the processes that own them
        now; the last array is their numbers, by which they are sorted."""
        owner = self.share.cut.owner(x)
        goes = owner != current().rank
        if not current().max(int(goes.any())):
            return (x, *carried)
        *come, _ = deliver(current().raw, owner[goes], *(values[goes] for values in (x, *carried)))  # type: ignore[attr-defined]
        found = [np.concatenate([values[~goes], more]) for values, more in zip((x, *carried), come)]
        order = np.argsort(found[-1])
        return tuple(values[order] for values in found)

    def around(self, x: np.ndarray, number: np.ndarray) -> Share:
        """The particles of other processes that the own ones at x (n, dim) see. number: (n,) int64."""
        comm: Any = current().raw  # type: ignore[attr-defined]
        bricks, reach = self.share.cut.bricks, self.sight * (1.0 + 1e-9)
        rows: list[np.ndarray] = [np.zeros(0, np.int64)]
        places = [np.zeros((0, x.shape[1]))]
        give = np.zeros(current().size, np.int64)
        for process, entries in itertools.groupby(self._near, key=lambda entry: entry[0]):
            sent = np.zeros(len(x), bool)
            for _, moved in entries:  # the first image of each that is near: the others follow from it
                image = x + moved
                near = np.all((image > bricks[process, 0] - reach) & (image < bricks[process, 1] + reach), axis=1)
                here = np.flatnonzero(near & ~sent)
                sent[here] = True
                rows.append(here)
                places.append(image[here])
                give[process] += len(here)
        ghosts, want = deliver(comm, np.repeat(np.arange(current().size), give), np.concatenate(places))
        exchange = Numbered(comm, np.concatenate(rows), give, want)
        exchange.number = number
        shift = np.floor((ghosts - self.lower) / np.where(self.periodic, self.upper - self.lower, np.inf))
        return replace(self.share, ghosts=ghosts, shift=shift.astype(np.int8), exchange=exchange)
