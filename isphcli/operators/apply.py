"""Operators in pair weights, applied to fields without what walls add: gradient, Laplacian, divergence (eqs 5-6).

The sums are in `pair_sums`; the weights of eqs 5-7 come from `moments`, those beside walls (eq. 11) from
`wall_weights`.
What either storage of operators does, walls included, are its methods: see `protocol`.
"""

from __future__ import annotations

import numpy as np

from . import pair_sums
from .pair_weights import Operators


def laplacian(ops: Operators, f: np.ndarray) -> np.ndarray:
    """Velocity Laplacian of f (n, k) without the wall terms."""
    return pair_sums.laplacian(ops.start, ops.column, ops.lap, ops.exchange.forward(f))


def gradient(ops: Operators, f: np.ndarray) -> np.ndarray:
    """Velocity gradient d f_c / d x_k of f (n, c) as (n, c, k), without the wall terms."""
    return pair_sums.gradient(ops.start, ops.column, ops.grad, ops.exchange.forward(f))


def gradient_one_sided(ops: Operators, f: np.ndarray) -> np.ndarray:
    """Gradients (n, c, dim) of f (n, c) with the weights of the pressure: over fluid neighbours only beside walls."""
    return pair_sums.gradient(ops.start, ops.column, ops.grad_p, ops.exchange.forward(f))


def divergence(ops: Operators, u: np.ndarray) -> np.ndarray:
    """Divergence (n,) of u (n, dim) without the wall terms."""
    return pair_sums.divergence(ops.start, ops.column, ops.grad, ops.exchange.forward(u))
