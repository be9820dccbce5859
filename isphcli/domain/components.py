"""Connected components of the fluid."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numba import njit

from .communicator import current
from .exchange import NO_EXCHANGE, Exchange


def pair_components(start: np.ndarray, column: np.ndarray, joined: np.ndarray | None = None,
                    exchange: Exchange = NO_EXCHANGE) -> tuple[int, np.ndarray]:
    """Connected components of the pair graph: (count, labels (n,) int32). joined: (n_pairs,) bool, pairs that count.

    exchange: that of the remote particles among the columns; components are then those of all processes.
    """
    n = len(start) - 1
    labels = np.arange(n + exchange.remote, dtype=np.int32)  # remote particles have no rows here
    count = _join(start, column, np.zeros(0, np.bool_) if joined is None else joined, labels)
    return (count, labels) if current().size == 1 else _join_processes(n, labels, exchange)


@njit(cache=True)
def _join(start, column, joined, parent):
    """Connected components of the pairs of `joined` (n_pairs,), of all pairs where it is empty; returns their number.

    parent: (n,) the number of each particle, replaced by that of its component; components are numbered in the order of
    their first particles. scipy's function needs the pairs and their transpose in double precision, 24 bytes per pair.
    """
    for i in range(len(start) - 1):
        a = root(parent, i)
        for q in range(start[i], start[i + 1]):
            if len(joined) == 0 or joined[q]:
                b = root(parent, np.int64(column[q]))
                if a != b:
                    a, b = min(a, b), max(a, b)
                    parent[b] = a
    return numbered(parent)


@njit(cache=True)
def numbered(parent):
    """Number of components; their numbers replace the parents (n,). The first particle of each is its own parent."""
    count = 0
    for i in range(len(parent)):
        if parent[i] == i:  # the first of its component: the particles before it have their labels
            parent[i] = count
            count += 1
        elif parent[i] >= 0:  # < 0: a particle outside of the parts of `parts_of`
            parent[i] = parent[parent[i]]
    return count


@njit(cache=True)
def root(parent, i):
    """The first particle that i is joined with so far; shortens the chain of parents that leads there."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


def parts_of(start: np.ndarray, column: np.ndarray, inside: np.ndarray, joined: np.ndarray | None = None,
             exchange: Exchange = NO_EXCHANGE) -> tuple[int, np.ndarray]:
    """Connected parts of the particles `inside` (n + remote,) bool alone: (count, part (n,) int32, -1 of the others).
    joined, exchange: as in `pair_components`, which numbers every particle; this function sends and holds little where
    few particles are inside."""
    parts = np.where(inside, np.arange(len(inside), dtype=np.int32), np.int32(-1))
    count = _join_inside(start, column, np.zeros(0, np.bool_) if joined is None else joined, parts)
    return (count, parts) if current().size == 1 else _join_processes(len(start) - 1, parts, exchange)


@njit(cache=True)
def _join_inside(start, column, joined, parent):
    """As `_join`, of the particles whose parent is not -1."""
    for i in range(len(start) - 1):
        if parent[i] >= 0:
            a = root(parent, i)
            for q in range(start[i], start[i + 1]):
                if parent[column[q]] >= 0 and (len(joined) == 0 or joined[q]):
                    b = root(parent, np.int64(column[q]))
                    if a != b:
                        a, b = min(a, b), max(a, b)
                        parent[b] = a
    return numbered(parent)


def _join_processes(n: int, labels: np.ndarray, exchange: Exchange) -> tuple[int, np.ndarray]:
    """Components over all processes from those of each, labels (n + remote,), -1 outside. A remote particle
    has a label here and one on the process that owns it, and both are labels of one component. Only components that
    cross a cut have such links, and they are few."""
    ranks = current()
    counts = ranks.collect(int(labels.max(initial=-1)) + 1)
    own = np.where(labels >= 0, np.int64(sum(counts[: ranks.rank])) + labels, -1)
    home = exchange.forward(own[:n])
    links = np.stack([own[n:], home[n:]], axis=1)[labels[n:] >= 0]
    links = np.concatenate(ranks.collect(np.unique(links, axis=0)))
    total = sum(counts)
    graph = sp.coo_matrix((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(total, total))
    _, joined = sp.csgraph.connected_components(graph, directed=False)
    # a label that only remote particles have is also that of a component of another process: no number is left out
    return int(joined.max(initial=-1)) + 1, np.append(joined, -1)[own[:n]].astype(np.int32)
