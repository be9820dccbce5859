"""Values of particles that other processes own: each process has a slot for every one that its own particles see.

Rows of operators are the n own particles, columns the own ones and then the remote ones. One process has no remote
particles, and `forward` hands back what it was given.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np


class Exchange(Protocol):
    """How the values of remote particles come.

    remote: their number; numbers: (n + remote,) int64 number of each particle among those of all processes, which
    count their own one after the other.
    """

    remote: int

    def numbers(self, n: int) -> np.ndarray:
        """(n + remote,) int64 number of each own and remote particle in the whole scene."""
        ...

    def forward(self, values: np.ndarray) -> np.ndarray:
        """values (n, ...) of the own particles, those of the remote ones behind them: (n + remote, ...)."""
        ...


class NoExchange:
    """Of one process, which owns all particles."""

    remote = 0

    def numbers(self, n: int) -> np.ndarray:
        """0, 1, ..., n - 1."""
        return np.arange(n)

    def forward(self, values: np.ndarray) -> np.ndarray:
        """The same array."""
        return values


NO_EXCHANGE = NoExchange()


class NeighbourExchange:
    """Between processes that hold each other's neighbours; every call is one message to each of them.

    ids: (g,) int64 sites of the remote particles, each once; owner: (g,) process of each; own_ids: (n,) sites of the
    own particles. All processes make it, and call `forward`, together. It asks the owners once who is wanted.
    """

    def __init__(self, comm: Any, ids: np.ndarray, owner: np.ndarray, own_ids: np.ndarray):
        from mpi4py import MPI

        self._types = {"d": MPI.DOUBLE, "l": MPI.INT64_T, "q": MPI.INT64_T, "i": MPI.INT32_T, "b": MPI.INT8_T}
        self.remote, self._comm = len(ids), comm
        order = np.argsort(owner, kind="stable")
        self._slot = order  # what arrives, process by process, goes to these slots
        want = np.bincount(owner, minlength=comm.size).astype(np.int64)
        give = np.empty_like(want)
        comm.Alltoall(want, give)
        asked = np.empty(int(give.sum()), np.int64)
        comm.Alltoallv([np.ascontiguousarray(ids[order], np.int64), want, _starts(want), MPI.INT64_T],
                       [asked, give, _starts(give), MPI.INT64_T])
        by_id = np.argsort(own_ids)
        self._send = by_id[np.searchsorted(own_ids[by_id], asked)]
        sources, targets = np.flatnonzero(want), np.flatnonzero(give)
        self._want, self._give = want[sources], give[targets]
        self._graph = comm.Create_dist_graph_adjacent(sources.tolist(), targets.tolist(), reorder=False)
        self.sent = 0  # bytes so far

    def numbers(self, n: int) -> np.ndarray:
        """See `Exchange`."""
        first = self._comm.exscan(n) or 0  # nothing for the first process
        return self.forward(first + np.arange(n))

    def forward(self, values: np.ndarray) -> np.ndarray:
        """See `Exchange`."""
        n, width = len(values), int(np.prod(values.shape[1:]))
        out = np.empty((n + self.remote, *values.shape[1:]), values.dtype)
        out[:n] = values
        sent = np.ascontiguousarray(values[self._send])
        found = np.empty((self.remote, *values.shape[1:]), values.dtype)
        kind = self._types[values.dtype.char]
        self._graph.Neighbor_alltoallv([sent, self._give * width, _starts(self._give) * width, kind],
                                       [found, self._want * width, _starts(self._want) * width, kind])
        out[n + self._slot] = found
        self.sent += sent.nbytes
        return out


def _starts(counts: np.ndarray) -> np.ndarray:
    """Where each of several parts begins."""
    return np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64) if len(counts) else counts
