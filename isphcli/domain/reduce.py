"""Sums, means, extremes and norms over the particles: the only place that combines values of different particles.

Each function takes an array whose first axis is the particles of this process, and returns what holds for the particles
of all processes (`communicator.current`). Elsewhere in the physics rooms arrays are reduced over components and axes
only; tests/domain/test_reduce.py holds that, with the exceptions. Compiled loops over neighbours are no reductions:
they need the particle and its halo.

A process may have no particles; it then adds nothing to the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .communicator import current


def total(values: np.ndarray) -> Any:
    """Sum over the particles of values (n,) or (n, k): a number or (k,)."""
    return current().sum(values.sum(axis=0, dtype=_summed_in(values)))


def totals(*values: np.ndarray | float) -> list[Any]:
    """Sums over the particles of several arrays (n,) or (n, k), and over the processes of numbers, which each has:
    between processes in one message, in double precision."""
    sums = [part.sum(axis=0, dtype=_summed_in(part)) if isinstance(part, np.ndarray) else part for part in values]
    return sums if current().size == 1 else _each(current().sum(_joined(sums)), sums)


def _summed_in(values: np.ndarray) -> Any:
    """The type in which values are summed: single ones in double, so that sums hardly depend on their parts."""
    return float if values.dtype == np.float32 else None


def largest_of_each(*values: np.ndarray) -> list[float]:
    """Largest entries of several arrays (n,) or (n, k), -inf where there is none: between processes in one message."""
    return [float(most) for most in current().max(np.array([part.max(initial=-np.inf) for part in values]))]


def _joined(values: Sequence[Any]) -> np.ndarray:
    """Numbers and vectors as one vector."""
    return np.concatenate([np.atleast_1d(np.asarray(part, float)) for part in values])


def _each(joined: np.ndarray, like: Sequence[Any]) -> list[Any]:
    """The inverse of `_joined`: numbers and vectors of the shapes of `like`."""
    ends = np.cumsum([np.size(part) for part in like])
    return [joined[end - np.size(part) : end] if np.ndim(part) else joined[end - 1] for end, part in zip(ends, like)]


def mean(values: np.ndarray, weights: np.ndarray | None = None) -> Any:
    """Mean over the particles of values (n,) or (n, k), a number or (k,); with weights (n,) of values (n,) only."""
    if current().size == 1:
        return values.mean(axis=0, dtype=_summed_in(values)) if weights is None else np.average(values, weights=weights)
    if weights is None:
        whole, count = totals(values, len(values))
    else:
        whole, count = current().sum(np.array([weights @ values, weights.sum()]))
    return whole / count


def largest(values: np.ndarray) -> Any:
    """Largest entry of values (n,) or (n, k)."""
    if current().size == 1:
        return values.max()
    return current().max(values.max(initial=_least(values.dtype)))


def smallest(values: np.ndarray) -> Any:
    """Smallest entry of values (n,) or (n, k)."""
    if current().size == 1:
        return values.min()
    return -largest(-values)


def _least(dtype: np.dtype) -> Any:
    """The smallest value of a number type."""
    return -np.inf if dtype.kind == "f" else np.iinfo(dtype).min


def norm(vector: np.ndarray) -> float:
    """Euclidean norm of a vector of unknowns, (m,)."""
    if current().size == 1:
        return float(np.linalg.norm(vector))
    return float(np.sqrt(dot(vector, vector)))


def dot(a: np.ndarray, b: np.ndarray) -> Any:
    """Sum over the particles of a b, for a (n,) and b (n,) or (n, k)."""
    return current().sum(a @ b)


def count(mask: np.ndarray) -> int:
    """Number of particles for which mask (n,) is true."""
    return int(current().sum(np.count_nonzero(mask)))


def number(values: np.ndarray) -> int:
    """Number of particles that values (n,) or (n, k) are of."""
    return int(current().sum(len(values)))


def any_true(mask: np.ndarray) -> bool:
    """Whether mask (n,) is true of any particle."""
    return bool(current().max(int(mask.any())))


def total_by(label: np.ndarray, values: np.ndarray | None = None, labels: int = 0) -> np.ndarray:
    """Sums (labels,) of values (n,) over the particles of each label, or without values their numbers.

    label: (n,) int from 0; labels: how many there are, where that is known. Raises ValueError for labels beyond.
    """
    if current().size > 1 and not labels:
        labels = int(current().max(int(label.max(initial=-1)) + 1))
    found = np.bincount(label, values, minlength=labels)
    if labels and len(found) > labels:
        raise ValueError(f"label {len(found) - 1} of {labels} labels")
    return current().sum(found if values is None else found.astype(float))  # numpy makes integers of no values at all


def totals_by(labels: int, *given: tuple[np.ndarray, np.ndarray | None]) -> list[np.ndarray]:
    """`total_by` of several (label, values), in double precision: between processes in one message."""
    return list(current().sum(np.array([np.bincount(*part, minlength=labels) for part in given], float)))


def largest_by(label: np.ndarray, values: np.ndarray, labels: int) -> np.ndarray:
    """Largest (labels,) of values (n,) over the particles of each label (n,), -inf where there is none."""
    found = np.full(labels, -np.inf)
    np.maximum.at(found, label, values)
    return current().max(found)


def together(*values: np.ndarray) -> list[np.ndarray]:
    """The rows (m, ...) of arrays of all processes, on each: few rows, such as points of a drop near a wall."""
    return [np.concatenate(parts) for parts in zip(*current().collect(values))]


def quantiles(values: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    """Quantiles (m,) of values (n,) at shares (m,) between 0 and 1, interpolated between the values next to them.

    Between processes the two values are found by halving the interval of all numbers, which are ordered as their bits
    are: after 64 counts they are exact, and no process holds the values of the others. NaN without particles.
    """
    if current().size == 1:
        return np.quantile(values, shares)
    have = number(values)
    if have == 0:
        return np.full(len(shares), np.nan)
    place = np.asarray(shares) * (have - 1)
    lower = np.floor(place).astype(np.int64)
    ranks = np.concatenate([lower, np.minimum(lower + 1, have - 1)])
    bits = np.sort(values.astype(np.float64)).view(np.int64)
    ordered = np.where(bits < 0, np.iinfo(np.int64).min - bits - 1, bits)  # bits of negative ones descend
    low, high = np.full(len(ranks), np.iinfo(np.int64).min), np.full(len(ranks), np.iinfo(np.int64).max)
    while np.any(low < high):
        middle = (low >> 1) + (high >> 1) + (low & high & 1)
        enough = current().sum(np.searchsorted(ordered, middle, side="right")) > ranks
        low, high = np.where(enough, low, middle + 1), np.where(enough, middle, high)
    found = np.where(low < 0, np.iinfo(np.int64).min - low - 1, low).view(np.float64)
    below, above = found[: len(lower)], found[len(lower) :]
    return below + (place - lower) * (above - below)


def least_of_largest(values: np.ndarray, share: float) -> float:
    """The smallest of the fewest values (n,), none below zero, that hold a share of the sum of all; 0 of none.

    Found by halving the interval of the numbers from 0 to the largest, which are ordered as their bits are: 63 sums at
    most, and no process holds the values of the others.
    """
    ordered = np.sort(values.astype(np.float64))
    above = np.append(np.cumsum(ordered[::-1])[::-1], 0.0)  # sums of each and those behind it
    low, high = 0, int(np.float64(max(largest_of_each(ordered)[0], 0.0)).view(np.int64))
    wanted = share * current().sum(above[0])
    while low < high:
        middle = (low + high + 1) // 2
        least = np.int64(middle).view(np.float64)
        if current().sum(above[np.searchsorted(ordered, least)]) >= wanted:
            low = middle
        else:
            high = middle - 1
    return float(np.int64(low).view(np.float64))
