"""-dx^2 div(w grad) between the pairs of a lattice, symmetric, as rows that are computed where they are needed.

The matrix has 12 bytes a pair, and a hierarchy holds it for as long as a steady solve takes; its entries are c_i w_pair
times a number of the offset (`LatticeWeights`), which the pairs are there for anyway.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..domain import reduce
from ..domain.components import pair_components
from ..domain.null_space import GROUND
from ..domain.row_threads import counted_rows, over_blocks, over_rows
from .crossings import in_sight
from .lattice_weights import LatticeWeights, canonical, nearest_weights


def sparse_pairs(ops: LatticeWeights, dx: float) -> LatticeWeights:
    """The same with the pairs of nearest neighbours of the lattice alone, 6 of 32 on a cubic one, and those farther
    ones that join what nearest neighbours leave apart: pockets between bodies that touch.

    The former weigh as much more as makes the symmetric Laplacian of a quadratic function what it was where all are in
    sight; the latter keep their weights. Components, and with them the null space, are those of all pairs. dx: m, the
    spacing.
    """
    pairs, exchange = ops.pairs, ops.exchange
    scale = reduce.largest(ops.tensors.scale)
    weight = nearest_weights(ops, dx) / (scale if scale > 0.0 else 1.0)
    near = weight > 0.0
    kept = near[pairs.offset_id]
    count, labels = pair_components(pairs.start, pairs.column, kept, exchange)
    if count > 1:
        labels = exchange.forward(labels[: ops.n])
        over_rows(_mark_joining, ops.n, pairs.start, pairs.column, labels, kept)
    start = np.zeros(ops.n + 1, np.int64)
    np.cumsum(in_sight(pairs.start, kept.view(np.int8)), out=start[1:])
    return replace(ops, pairs=pairs._replace(
        start=start, column=pairs.column[kept], offset_id=pairs.offset_id[kept],
        pair_laplacian=np.where(near, weight, pairs.pair_laplacian)))


class Conductances:
    """-dx^2 div(w grad) with the symmetric weights and the means of w (n,) of the pairs.

    Means are arithmetic: a pressure acts on the velocities of both particles of a pair, and div A^-1 grad of the one on
    the wall is that of its neighbours. Harmonic means cut it off from them: a solve between beads that touch then takes
    twice the iterations. diagonal: (n,), raised by `GROUND`.
    """

    def __init__(self, ops: LatticeWeights, w: np.ndarray, dx: float):
        pairs, tensors = ops.pairs, ops.tensors
        self._ops = ops
        # as few arrays as possible: every argument of a kernel is compiled
        self._entries = (pairs.start, pairs.column, pairs.offset_id, pairs.pair_laplacian, tensors.row,
                         0.5 * dx * dx * tensors.scale, ops.exchange.forward(w))
        self.diagonal = np.empty(ops.n)
        over_rows(_diagonal, ops.n, self._entries, self.diagonal)

    @property
    def n(self) -> int:
        """Rows of this process."""
        return self._ops.n

    def tocsr(self) -> sp.csr_matrix:
        """All rows in canonical CSR form; columns of remote particles are the last ones."""
        return self.rows(0, self.n)

    def rows(self, begin: int, end: int) -> sp.csr_matrix:
        """Rows from `begin` to before `end`, canonical CSR."""
        start = self._ops.start
        first = (start[begin : end + 1] - start[begin] + np.arange(end - begin + 1)).astype(np.int32)
        index, data = np.empty(first[-1], np.int32), np.empty(first[-1])
        over_rows(_entries, end - begin, begin, self._entries, self.diagonal, (first, index, data))
        return canonical(self._ops, first, index, data)

    def strong(self, threshold: float) -> sp.csr_matrix:
        """The pattern of the pairs with a_ij^2 >= threshold^2 a_ii a_jj and of the diagonal, of one process alone."""

        def connect(fill: bool, first: np.ndarray, index: np.ndarray, _: np.ndarray) -> None:
            over_rows(_strong, self.n, self._entries, self.diagonal, threshold**2, fill, first, index)

        _, index, first = counted_rows(self.n, connect)
        pattern = sp.csr_matrix((np.ones(len(index), np.int8), index, first), shape=(self.n, self.n))
        pattern.sort_indices()  # aggregates depend on the order
        return pattern

    def smoothed(self, aggregate: np.ndarray, size: np.ndarray, threshold: float, omega: float) -> sp.csr_matrix:
        """Prolongation (n, aggregates) of smoothed aggregation: T - U, T of the aggregates with columns of length one,
        U = omega D^-1 F T with F the strong pairs and D the sums of its rows, what it does to constants taken out
        (Vanek, Mandel and Brezina 1996; weights by Gershgorin and constraints as PyAMG has them).

        aggregate: (n,) int32, -1 of particles in none; size: particles of each.
        """
        length, longest = np.sqrt(size), int(np.diff(self._ops.start).max(initial=0)) + 1

        def smooth(fill: bool, *found: np.ndarray) -> None:
            over_rows(_smoothed, self.n, self._entries, self.diagonal, (threshold**2, omega, fill), (aggregate, length),
                      found, work=lambda: (np.empty(longest, np.int32), np.empty(longest)))

        return sp.csr_matrix(counted_rows(self.n, smooth), (self.n, len(size)))

    def sweep_from_zero(self, blocks: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A forward sweep of Gauss and Seidel through blocks of rows (`over_blocks`), and what it leaves of b."""
        x, rest = np.empty_like(b), np.empty_like(b)
        over_blocks(_forward, blocks, self._entries, self.diagonal, b, x)
        over_blocks(_rest, blocks, self._entries, x, rest)
        return x, rest

    def sweep_back(self, blocks: np.ndarray, b: np.ndarray, x: np.ndarray) -> None:
        """A backward sweep in place, each block with the values that the others had before it."""
        over_blocks(_backward, blocks, self._entries, self.diagonal, b, x, x.copy())


@njit(cache=True, nogil=True)
def _mark_joining(rows, start, column, labels, kept):
    """Marks the pairs of particles in different components."""
    for i in range(rows[0], rows[1]):
        for q in range(start[i], start[i + 1]):
            if labels[column[q]] != labels[i]:
                kept[q] = True


@njit(cache=True, inline="always")
def _conductance(entries, i, q):
    """Minus the entry of pair q of particle i, positive."""
    _, column, offset_id, weight, row, half, w = entries
    return half[row[i]] * weight[np.uint32(offset_id[q])] * (w[i] + w[np.uint32(column[q])])


@njit(cache=True, nogil=True)
def _diagonal(rows, entries, diagonal):
    start, column = entries[0], entries[1]
    for i in range(rows[0], rows[1]):
        total = own = 0.0
        for q in range(start[i], start[i + 1]):
            a = _conductance(entries, i, q)
            total += a
            if column[q] == i:  # the neighbour is a periodic image of the particle itself
                own += a
        diagonal[i] = (1.0 + GROUND) * total - own if total > 0.0 else 1.0


@njit(cache=True, nogil=True)
def _entries(rows, begin, entries, diagonal, matrix):
    start, column = entries[0], entries[1]
    first, index, data = matrix
    for k in range(rows[0], rows[1]):
        i, at = begin + k, first[k] + 1
        index[first[k]], data[first[k]] = i, diagonal[i]
        for q in range(start[i], start[i + 1]):
            index[at], data[at] = column[q], 0.0 if column[q] == i else -_conductance(entries, i, q)
            at += 1


@njit(cache=True, nogil=True)
def _strong(rows, entries, diagonal, square, fill, first, index):
    """Strong neighbours into index, or their numbers into first[1:]."""
    start, column = entries[0], entries[1]
    for i in range(rows[0], rows[1]):
        at = first[i] if fill else 0
        if fill:
            index[at] = i
        at += 1
        for q in range(start[i], start[i + 1]):
            j = column[q]
            if j != i and _conductance(entries, i, q) ** 2 >= square * diagonal[i] * diagonal[j]:
                if fill:
                    index[at] = j
                at += 1
        if not fill:
            first[i + 1] = at


@njit(cache=True, nogil=True)
def _smoothed(rows, work, entries, diagonal, how, aggregates, matrix):
    """See `Conductances.smoothed`: entries into index and data, or their numbers into first[1:]."""
    (square, omega, fill), (aggregate, length), (first, index, data), (found, value) = how, aggregates, matrix, work
    start, column = entries[0], entries[1]
    for i in range(rows[0], rows[1]):
        count, total = 0, diagonal[i]
        if aggregate[i] >= 0:
            found[0], value[0], count = aggregate[i], diagonal[i] / length[aggregate[i]], 1
        for q in range(start[i], start[i + 1]):
            j = column[q]
            a = _conductance(entries, i, q)
            if j == i or a * a < square * diagonal[i] * diagonal[j]:
                continue
            total += a
            if aggregate[j] < 0:
                continue
            k = 0
            while k < count and found[k] != aggregate[j]:
                k += 1
            if k == count:
                found[k], value[k] = aggregate[j], 0.0
                count += 1
            value[k] -= a / length[aggregate[j]]
        if not fill:
            first[i + 1] = count
            continue
        constant = square_length = 0.0
        for k in range(count):
            value[k] *= omega / total
            constant += value[k] * length[found[k]]
            square_length += length[found[k]] ** 2
        for k in range(count):
            own = 1.0 / length[found[k]] if found[k] == aggregate[i] else 0.0
            index[first[i] + k] = found[k]
            data[first[i] + k] = own - value[k] + constant / square_length * length[found[k]]


# The sweeps take what all pairs of a particle share out of their sums; indices are unsigned, without a check for those
# that count from the end.


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _forward(blocks, edges, entries, diagonal, b, x):
    start, column, offset_id, weight, row, half, w = entries
    for block in range(blocks[0], blocks[1]):
        begin = np.uint32(edges[block])
        for i in range(edges[block], edges[block + 1]):
            s, own, last = 0.0, w[i], np.uint32(i)
            for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                j = np.uint32(column[q])
                if begin <= j and j < last:
                    s += weight[np.uint32(offset_id[q])] * (own + w[j]) * x[j]
            x[i] = (b[i] + half[row[i]] * s) / diagonal[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _rest(blocks, edges, entries, x, rest):
    start, column, offset_id, weight, row, half, w = entries
    for block in range(blocks[0], blocks[1]):
        begin = np.uint32(edges[block])
        for i in range(edges[block], edges[block + 1]):
            s, own, last = 0.0, w[i], np.uint32(i)
            for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                j = np.uint32(column[q])
                if j > last or j < begin:
                    s += weight[np.uint32(offset_id[q])] * (own + w[j]) * x[j]
            rest[i] = half[row[i]] * s


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _backward(blocks, edges, entries, diagonal, b, x, before):
    start, column, offset_id, weight, row, half, w = entries
    for block in range(blocks[0], blocks[1]):
        end = np.uint32(edges[block + 1])
        for i in range(edges[block + 1] - 1, edges[block] - 1, -1):
            s, own, last = 0.0, w[i], np.uint32(i)
            for q in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                j = np.uint32(column[q])
                value = x[j] if last < j and j < end else before[j]  # those before it have not changed
                if j != last:
                    s += weight[np.uint32(offset_id[q])] * (own + w[j]) * value
            x[i] = (b[i] + half[row[i]] * s) / diagonal[i]
