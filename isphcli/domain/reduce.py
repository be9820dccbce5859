"""Sums, means, extremes and norms over the particles: the only place that combines values of different particles.

Each function takes an array whose first axis is the particles of this process, and returns what holds for the particles
of all processes; today there is one. Elsewhere in the physics rooms arrays are reduced over components and axes only;
tests/domain/test_reduce.py holds that, with the exceptions. Compiled loops over neighbours are no reductions: they need
the particle and its halo.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def total(values: np.ndarray) -> Any:
    """Sum over the particles of values (n,) or (n, k): a number or (k,)."""
    return values.sum(axis=0)


def mean(values: np.ndarray, weights: np.ndarray | None = None) -> Any:
    """Mean over the particles of values (n,) or (n, k), a number or (k,); with weights (n,) of values (n,) only."""
    return values.mean(axis=0) if weights is None else np.average(values, weights=weights)


def largest(values: np.ndarray) -> Any:
    """Largest entry of values (n,) or (n, k)."""
    return values.max()


def smallest(values: np.ndarray) -> Any:
    """Smallest entry of values (n,) or (n, k)."""
    return values.min()


def norm(vector: np.ndarray) -> float:
    """Euclidean norm of a vector of unknowns, (m,)."""
    return float(np.linalg.norm(vector))


def dot(a: np.ndarray, b: np.ndarray) -> Any:
    """Sum over the particles of a b, for a (n,) and b (n,) or (n, k)."""
    return a @ b


def count(mask: np.ndarray) -> int:
    """Number of particles for which mask (n,) is true."""
    return int(np.count_nonzero(mask))


def number(values: np.ndarray) -> int:
    """Number of particles that values (n,) or (n, k) are of."""
    return len(values)


def any_true(mask: np.ndarray) -> bool:
    """Whether mask (n,) is true of any particle."""
    return bool(mask.any())


def total_by(label: np.ndarray, values: np.ndarray | None = None, labels: int = 0) -> np.ndarray:
    """Sums (labels,) of values (n,) over the particles of each label, or without values their numbers.

    label: (n,) int from 0; labels: how many there are at least.
    """
    return np.bincount(label, values, minlength=labels)
