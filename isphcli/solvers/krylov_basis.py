"""An orthonormal basis of a Krylov space in single precision (Aliaga, Anzt, Gruetzmacher, Quintana-Orti and
Tomas-Dominguez 2022): half of the memory, and of what orthogonalisation reads.

Vectors are orthogonalised in double precision against what is stored, so that the Arnoldi relation holds to 6e-8 of a
vector: less than a solve is asked for, and a solve that is asked for more starts again from its true residual.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.row_threads import REDUCE, over_blocks, over_rows

CHUNK = 1024  # entries of a block: those of 50 vectors stay in the cache between the two uses of a pass
# Entries of a piece that BLAS gets, at least: six pieces of a vector of 48^3. To make ten such vectors orthogonal takes
# 6.4 CPU ms by these, 7 by half, as by whole vectors; those of three times the length 8.5, 10, and 15 by whole ones
PIECE = 16384
# What a vector may still have of the others, of its length, before it is orthogonalised once more
LEFT = 1e-4


class Basis(Protocol):
    """Orthonormal vectors of unknowns."""

    def append(self, vector: np.ndarray, length: float) -> np.ndarray:
        """See `KrylovBasis`."""

    def orthogonalise(self, vector: np.ndarray) -> tuple[np.ndarray, float]:
        """See `KrylovBasis`."""

    def combine(self, weights: np.ndarray) -> np.ndarray:
        """See `KrylovBasis`."""


class DoubleBasis:
    """A `KrylovBasis` in double precision, by BLAS on pieces of vectors: of solves with few vectors, without kernels
    to compile."""

    def __init__(self, most: int, size: int):
        self._vectors = np.empty((most, size))
        self._edges = np.linspace(0, size, 1 + max(size // PIECE, 1)).astype(np.int64)
        self.count = 0

    def append(self, vector: np.ndarray, length: float) -> np.ndarray:
        """See `KrylovBasis`."""
        stored = self._vectors[self.count]
        self._over_pieces(lambda _, part: np.multiply(vector[part], 1.0 / length, out=stored[part]))
        self.count += 1
        return stored  # not to be written to

    def orthogonalise(self, vector: np.ndarray) -> tuple[np.ndarray, float]:
        """See `KrylovBasis`."""
        known = self._vectors[: self.count]
        sums = np.zeros((len(self._edges) - 1, self.count + 1))  # products with the basis and, last, the own square

        def multiply(k: int, part: slice) -> None:
            sums[k, :-1] = known[:, part] @ vector[part]

        def take_out(k: int, part: slice) -> None:
            rest = vector[part]
            rest -= coefficients @ known[:, part]
            sums[k, :-1], sums[k, -1] = known[:, part] @ rest, rest @ rest  # while they are in the cache

        self._over_pieces(multiply)
        coefficients = whole = reduce.total(sums)[:-1]
        self._over_pieces(take_out)
        left = reduce.total(sums)
        if not np.abs(left[:-1]).max(initial=0.0) <= LEFT * np.sqrt(left[-1]):
            coefficients, whole = left[:-1], whole + left[:-1]
            self._over_pieces(take_out)
            left = reduce.total(sums)
        return whole, float(np.sqrt(left[-1]))

    def combine(self, weights: np.ndarray) -> np.ndarray:
        """See `KrylovBasis`."""
        known, out = self._vectors[: len(weights)], np.empty(self._vectors.shape[1])
        self._over_pieces(lambda _, part: np.matmul(weights, known[:, part], out=out[part]))
        return out

    def _over_pieces(self, function: Callable[[int, slice], object]) -> None:
        """Calls function(k, part) for all pieces, on all threads."""

        def some(blocks: tuple[int, int], edges: np.ndarray) -> None:
            for k in range(*blocks):
                function(k, slice(edges[k], edges[k + 1]))

        over_blocks(some, self._edges)


class KrylovBasis:
    """Vectors of unknowns (size,), at most `most`."""

    def __init__(self, most: int, size: int):
        self._vectors = np.empty((most, size), np.float32)
        self._edges = np.minimum(np.arange(0, size + CHUNK, CHUNK), size)
        self.count = 0

    def append(self, vector: np.ndarray, length: float) -> np.ndarray:
        """The next vector, of this length and orthogonal to the others; returns it as it is stored, in double precision
        and of length one, (size,), in its place."""
        over_rows(_store, len(vector), vector, 1.0 / length, self._vectors[self.count])
        self.count += 1
        return vector

    def orthogonalise(self, vector: np.ndarray) -> tuple[np.ndarray, float]:
        """Takes the coefficients along the basis out of a vector in place: (coefficients (count,), length of the rest).

        Gram and Schmidt once, and once more where more than LEFT of it is left."""
        blocks = len(self._edges) - 1
        dots, squares = np.zeros((blocks, self.count)), np.zeros((blocks, 1))
        over_blocks(_coefficients, self._edges, self._vectors, vector, dots)
        coefficients = reduce.total(dots)
        over_blocks(_take_out, self._edges, self._vectors, coefficients, vector, (dots, squares))
        more, length = reduce.total(dots), float(np.sqrt(reduce.total(squares)[0]))
        if not np.abs(more).max(initial=0.0) <= LEFT * length:
            over_blocks(_take_out, self._edges, self._vectors, more, vector, (dots, squares))
            coefficients, length = coefficients + more, float(np.sqrt(reduce.total(squares)[0]))
        return coefficients, length

    def combine(self, weights: np.ndarray) -> np.ndarray:
        """The sum of the first vectors with weights (k,), (size,)."""
        out, blocks = np.zeros(self._vectors.shape[1]), len(self._edges) - 1
        over_blocks(_take_out, self._edges, self._vectors, -weights, out,
                    (np.empty((blocks, len(weights))), np.empty((blocks, 1))))
        return out


@njit(cache=True, nogil=True)
def _store(rows, vector, factor, stored):
    """The vector times the factor into single precision, and from there back."""
    for k in range(np.uint64(rows[0]), np.uint64(rows[1])):
        stored[k] = factor * vector[k]
        vector[k] = stored[k]


@njit(cache=True, nogil=True, fastmath=REDUCE, forceinline=True)
def _coefficients(blocks, edges, basis, vector, dots):
    """Products of the vector with those of the basis by blocks of entries, dots (blocks, k)."""
    for block in range(blocks[0], blocks[1]):
        for j in range(dots.shape[1]):
            s = 0.0
            for k in range(np.uint64(edges[block]), np.uint64(edges[block + 1])):
                s += basis[j, k] * vector[k]
            dots[block, j] = s


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _take_out(blocks, edges, basis, weights, vector, left):
    """Subtracts the vectors of the basis with weights; left: (dots, squares), of the rest by blocks of entries."""
    dots, squares = left
    for block in range(blocks[0], blocks[1]):
        begin, end = np.uint64(edges[block]), np.uint64(edges[block + 1])
        for j in range(len(weights)):
            for k in range(begin, end):
                vector[k] -= weights[j] * basis[j, k]
        square = 0.0
        for k in range(begin, end):
            square += vector[k] * vector[k]
        squares[block, 0] = square
        _coefficients((block, block + 1), edges, basis, vector, dots)  # while they are in the cache
