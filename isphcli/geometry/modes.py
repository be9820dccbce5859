"""Fields on voxel centres, mode by mode: waves along periodic axes, cosines along mirrored ones."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from scipy import fft

from ..domain.row_threads import threads_here
from ..domain.slabs import Slabs


def frequencies(n: int, repeats: bool) -> np.ndarray:
    """Frequencies (n,), 1 / voxel, along an axis of n voxels: of waves where it repeats, else of cosines."""
    return fft.fftfreq(n) if repeats else np.arange(n) / (2 * n)


def sum_of_squares(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Sum of the squares of one entry an axis, for all combinations: an array with as many axes as there are parts."""
    return functools.reduce(np.add.outer, [part**2 for part in parts])


class Modes:
    """The modes of fields of a shape [z, y, x]. around: (3,) bool x, y, z, periodic; axes of one voxel have none.

    slabs: how the processes share the fields; the modes that a process has are then those of its part along y, of all
    layers, where there are modes along z. Without it one process has all. Of the waves of a real field, which come in
    pairs, one axis has half.
    """

    def __init__(self, shape: tuple[int, ...], around: np.ndarray, slabs: Slabs | None = None):
        self.shape, self.slabs = shape, slabs or Slabs.whole(shape)
        axes = [a for a in range(3) if shape[a] > 1]
        self.repeats = [a for a in axes if around[2 - a]]
        self.mirrored = [a for a in axes if not around[2 - a]]
        # waves last, since what they make is complex; but lines along z, for which processes change parts, in the end
        self._order = sorted([*self.mirrored, *reversed(self.repeats)], key=lambda a: a == 0)
        halved = [n // 2 + 1 if a in self.repeats[-1:] else n for a, n in enumerate(shape)]
        # how the processes share what is left to transform along z
        self._before_z = Slabs([shape[0], *halved[1:]], self.slabs.ends, self.slabs.ranks)

    @property
    def dim(self) -> int:
        """Axes that have modes."""
        return len(self._order)

    def square_frequencies(self) -> np.ndarray:
        """Sum of the squares of the frequencies, 1 / voxel^2, of every mode of this process."""
        every = [frequencies(n, a in self.repeats) if n > 1 else np.zeros(1) for a, n in enumerate(self.shape)]
        if self.repeats:
            last = self.repeats[-1]
            every[last] = fft.rfftfreq(self.shape[last])
        if 0 in self._order:
            every[1] = every[1][self._before_z.columns]
        elif self.slabs.ranks.size > 1:
            every[0] = every[0][slice(*self.slabs.own)]
        return sum_of_squares(every)

    def filtered(self, field: np.ndarray, share: np.ndarray) -> np.ndarray:
        """The field with `share` of each of its modes; of several processes their own layers, and their own modes."""
        for a in self._order:
            field = self._to_modes(self._before_z.turned(field) if a == 0 else field, a)
        if self._order:
            field *= share  # what was transformed is an array of its own
        else:
            field = field * share
        for a in reversed(self._order):
            field = self._of_modes(field, a)
            field = self._before_z.back(field) if a == 0 else field
        return field

    def _to_modes(self, field: np.ndarray, axis: int) -> np.ndarray:
        """Along one axis."""
        workers = threads_here()
        if axis in self.mirrored:
            return fft.dct(field, axis=axis, norm="ortho", workers=workers)
        if axis == self.repeats[-1]:
            return fft.rfft(field, axis=axis, workers=workers)
        return fft.fft(field, axis=axis, workers=workers, overwrite_x=True)

    def _of_modes(self, field: np.ndarray, axis: int) -> np.ndarray:
        """The inverse of `_to_modes`."""
        workers = threads_here()
        if axis in self.mirrored:
            return fft.idct(field, axis=axis, norm="ortho", workers=workers, overwrite_x=True)
        if axis == self.repeats[-1]:
            return fft.irfft(field, self.shape[axis], axis=axis, workers=workers, overwrite_x=True)
        return fft.ifft(field, axis=axis, workers=workers, overwrite_x=True)
