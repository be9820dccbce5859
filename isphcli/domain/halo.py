"""Periodic images as halo particles: rows of one table (owner, shift); kernels never see periodicity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .row_threads import over_slices


@dataclass(frozen=True)
class Halo:
    """Images of owned particles within one support of a periodic face.

    owner: (n_halo,) int32 index of the particle that is imaged; shift: (n_halo, dim) whole box lengths added
    to its position, m.
    """

    owner: np.ndarray
    shift: np.ndarray

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Owned rows followed by their images, (n + n_halo, dim)."""
        return np.concatenate([x, x[self.owner] + self.shift]) if len(self.owner) else x

    def owners(self, n: int) -> np.ndarray:
        """Owner of every row, (n + n_halo,) int32: the identity for the first n."""
        return np.concatenate([np.arange(n, dtype=np.int32), self.owner])


def wrap(x: np.ndarray, lower: np.ndarray, upper: np.ndarray, periodic: Sequence[bool] | np.ndarray) -> np.ndarray:
    """Positions moved back into the box along periodic axes, (n, dim)."""
    x = x.copy()
    for axis in np.flatnonzero(periodic):
        length = upper[axis] - lower[axis]
        x[:, axis] -= length * np.floor((x[:, axis] - lower[axis]) / length)
        # round-off may put a particle on the far face, which is the near face of the next box, or just below that
        outside = (x[:, axis] >= upper[axis]) | (x[:, axis] < lower[axis])
        x[outside, axis] = lower[axis]
    return x


def nearest_image(way: np.ndarray, size: np.ndarray, periodic: Sequence[bool] | np.ndarray) -> np.ndarray:
    """Ways between points, (..., dim) m, to that of the periodic images of their ends that is nearest; size: (dim,) m,
    of the box."""
    return way - np.where(periodic, size, 0.0) * np.round(way / size)


def build_halo(x: np.ndarray, lower: np.ndarray, upper: np.ndarray, periodic: np.ndarray, support: float,
               brick: tuple[np.ndarray, np.ndarray] | None = None) -> Halo:
    """Images of x within one support of the box; a box thinner than a support gets several images along that axis.

    x: (n, dim) inside the box; lower, upper: (dim,); periodic: (dim,) bool; support: m. brick: corners of the part of
    the box round which images are wanted, the whole without it; x are then within a support of that.
    """
    n, dim = x.shape
    owner = np.arange(n, dtype=np.int32)
    shift = np.zeros((n, dim))
    position = x
    for axis in np.flatnonzero(periodic):
        length = upper[axis] - lower[axis]
        first, last = (lower[axis], upper[axis]) if brick is None else (brick[0][axis], brick[1][axis])
        reach = support if brick is None else last - first + 2.0 * support
        images = []
        for k in range(1, int(np.ceil(reach / length)) + 1):
            for sign in (k, -k):
                near = _within(position[:, axis], sign * length, first - support, last + support)
                images.append((near, sign * length))
        rows = np.concatenate([rows for rows, _ in images])
        added = np.repeat([d for _, d in images], [len(rows) for rows, _ in images])
        new_shift = shift[rows].copy()
        new_shift[:, axis] += added
        owner = np.concatenate([owner, owner[rows]])
        shift = np.concatenate([shift, new_shift])
        position = np.concatenate([position, x[owner[-len(rows):]] + new_shift]) if len(rows) else position
    return Halo(owner[n:], shift[n:])


def _within(column: np.ndarray, shift: float, lower: float, upper: float) -> np.ndarray:
    """Rows of a column (n,) that a shift moves between two bounds."""

    def of(part: slice) -> np.ndarray:
        moved = column[part] + shift
        return part.start + np.flatnonzero((moved > lower) & (moved < upper))

    return np.concatenate(over_slices(of, len(column)))
