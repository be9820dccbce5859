"""Values of particles that other processes own: each process has a slot for every one that its own particles see.

Rows of operators are the n own particles, columns the own ones and then the remote ones. One process has no remote
particles, and `forward` returns the given array.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from .communicator import TRAFFIC


class Exchange(Protocol):
    """Fetches the values of remote particles from the processes that own them.

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

    def forward_each(self, *values: np.ndarray) -> tuple[np.ndarray, ...]:
        """`forward` of each of several arrays, in one message to each process."""
        ...

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Sum over the processes of their values (n + remote, ...) of each particle, for own and remote particles."""
        ...


class NoExchange:
    """`Exchange` of one process, which owns all particles."""

    remote = 0

    def numbers(self, n: int) -> np.ndarray:
        """0, 1, ..., n - 1."""
        return np.arange(n)

    def forward(self, values: np.ndarray) -> np.ndarray:
        """The same array."""
        return values

    summed = forward

    def forward_each(self, *values: np.ndarray) -> tuple[np.ndarray, ...]:
        """The same arrays."""
        return values


NO_EXCHANGE = NoExchange()


class NeighbourExchange:
    """`Exchange` between processes that hold each other's neighbours; every call is one message to each of them.

    send: (m,) own particles that others see, process by process; give: (size,) how many of these each process gets;
    want: (size,) how many this one gets of each; slot: (g,) places of the received values, process by process, among
    the remote particles, None where both orders are the same. All processes make it, and call `forward`, together.
    """

    def __init__(self, comm: Any, send: np.ndarray, give: np.ndarray, want: np.ndarray,
                 slot: np.ndarray | None = None):
        self.remote, self._comm, self._send, self._slot = int(want.sum()), comm, send, slot
        self._targets, self._sources = _parts(give), _parts(want)

    @staticmethod
    def of_sites(comm: Any, ids: np.ndarray, owner: np.ndarray, own_ids: np.ndarray) -> NeighbourExchange:
        """The exchange of particles that this process knows by their sites; it asks the owners once.

        ids: (g,) int64 sites of the remote particles, each once; owner: (g,) process of each; own_ids: (n,) sites of
        the own particles.
        """
        order = np.argsort(owner, kind="stable")
        want = np.bincount(owner, minlength=comm.size).astype(np.int64)
        asked, give = deliver(comm, owner[order], ids[order])
        by_id = np.argsort(own_ids)
        send = by_id[np.searchsorted(own_ids[by_id], asked)]
        return NeighbourExchange(comm, send, give, want, order)

    def numbers(self, n: int) -> np.ndarray:
        """See `Exchange`."""
        first = self._comm.exscan(n) or 0  # nothing for the first process
        return self.forward(first + np.arange(n))

    def forward(self, values: np.ndarray) -> np.ndarray:
        """See `Exchange`."""
        return self.forward_each(values)[0]

    def forward_each(self, *values: np.ndarray) -> tuple[np.ndarray, ...]:
        """See `Exchange`."""
        sent = _bytes([part[self._send] for part in values])
        come = np.empty((self.remote, sent.shape[1]), np.uint8)
        _send(self._comm, (sent, self._targets), (come, self._sources))
        place, found = slice(None) if self._slot is None else self._slot, []
        for part, there in zip(values, _of_bytes(come, values)):
            out = np.empty((len(part) + self.remote, *part.shape[1:]), part.dtype)
            out[: len(part)], out[len(part) :][place] = part, there
            found.append(out)
        return tuple(found)

    def summed(self, values: np.ndarray) -> np.ndarray:
        """See `Exchange`."""
        n = len(values) - self.remote
        known = np.ascontiguousarray(values[n:] if self._slot is None else values[n + self._slot])
        come = np.empty((len(self._send), *values.shape[1:]), values.dtype)
        _send(self._comm, (known, self._sources), (come, self._targets))
        own = values[:n].copy()
        np.add.at(own, self._send, come)
        return self.forward(own)


def deliver(comm: Any, owner: np.ndarray, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """Sends each row of arrays (m, ...) to the process `owner` (m,) of it. Returns the rows that this process receives,
    ordered by their senders and for each sender as it had them, and behind the arrays the number of rows from each
    process, (size,). All processes call it together."""
    order = np.argsort(owner, kind="stable")
    give = np.bincount(owner, minlength=comm.size).astype(np.int64)
    want = np.empty_like(give)
    with TRAFFIC.counted(collectives=1):
        comm.Alltoall(give, want)
    sent = _bytes([values[order] for values in arrays])
    come = np.empty((int(want.sum()), sent.shape[1]), np.uint8)
    _send(comm, (sent, _parts(give)), (come, _parts(want)))
    return (*_of_bytes(come, arrays), want)


def _send(comm: Any, given: tuple[np.ndarray, list[tuple[int, slice]]],
          taken: tuple[np.ndarray, list[tuple[int, slice]]]) -> None:
    """One message of rows to each process, and one from each: (array, its `_parts`), sent and received.
    Messages between two processes keep their order: no tags are needed."""
    (sent, targets), (found, sources) = given, taken
    swap(comm, [(target, sent[part]) for target, part in targets], [(source, found[part]) for source, part in sources])


def swap(comm: Any, given: Sequence[tuple[int, np.ndarray]], taken: Sequence[tuple[int, np.ndarray]]) -> None:
    """Sends an array to each of some processes, and fills one by each of some others: (process, contiguous array)."""
    with TRAFFIC.counted(len(given), sum(values.nbytes for _, values in given)):
        pending = [comm.Irecv(values, source) for source, values in taken]
        pending += [comm.Isend(values, target) for target, values in given]
        for request in pending:
            request.Wait()


def _bytes(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays (m, ...) as one array of bytes (m, bytes of a row of all arrays), for a message."""
    rows = [np.ascontiguousarray(values).reshape(len(values), math.prod(values.shape[1:])).view(np.uint8)
            for values in arrays]
    return rows[0] if len(rows) == 1 else np.concatenate(rows, axis=1)


def _of_bytes(rows: np.ndarray, like: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
    """The inverse of `_bytes`: arrays (m, ...) from rows (m, bytes). like: arrays of the same kinds of rows."""
    end = 0
    for values in like:
        begin, end = end, end + values.itemsize * math.prod(values.shape[1:])
        part = np.ascontiguousarray(rows[:, begin:end])
        yield part.view(values.dtype).reshape(len(rows), *values.shape[1:])


def _parts(counts: np.ndarray) -> list[tuple[int, slice]]:
    """(process, slice of its rows) of the processes with rows; counts: (size,) rows of each process, in order."""
    ends = np.cumsum(counts)
    return [(int(k), slice(int(ends[k] - counts[k]), int(ends[k]))) for k in np.flatnonzero(counts)]
