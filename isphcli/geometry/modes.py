"""Fields on voxel centres, mode by mode: waves along periodic axes, cosines along mirrored ones."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numba import get_num_threads
from scipy import fft


def frequencies(n: int, repeats: bool) -> np.ndarray:
    """Frequencies (n,), 1 / voxel, along an axis of n voxels: of waves where it repeats, else of cosines."""
    return fft.fftfreq(n) if repeats else np.arange(n) / (2 * n)


def sum_of_squares(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Sum of the squares of one entry an axis, for all combinations: an array with as many axes as there are parts."""
    return functools.reduce(np.add.outer, [part**2 for part in parts])


class Modes:
    """The modes of fields of a shape [z, y, x]. around: (3,) bool x, y, z, periodic; axes of one voxel have none."""

    def __init__(self, shape: tuple[int, ...], around: np.ndarray):
        self.shape = shape
        axes = [a for a in range(3) if shape[a] > 1]
        self.repeats = [a for a in axes if around[2 - a]]
        self.mirrored = [a for a in axes if not around[2 - a]]

    @property
    def dim(self) -> int:
        """Axes that have modes."""
        return len(self.repeats) + len(self.mirrored)

    def square_frequencies(self) -> np.ndarray:
        """Sum of the squares of the frequencies, 1 / voxel^2, of every mode."""
        every = [frequencies(n, a in self.repeats) if n > 1 else np.zeros(1) for a, n in enumerate(self.shape)]
        if self.repeats:  # the waves of a real field come in pairs: `rfftn` keeps half of them
            last = self.repeats[-1]
            every[last] = fft.rfftfreq(self.shape[last])
        return sum_of_squares(every)

    def filtered(self, field: np.ndarray, share: np.ndarray) -> np.ndarray:
        """The field with `share` of each of its modes."""
        workers = get_num_threads()
        for a in self.mirrored:
            field = fft.dct(field, axis=a, norm="ortho", workers=workers)
        if self.repeats:
            modes = fft.rfftn(field, axes=self.repeats, workers=workers)
            modes *= share
            lengths = [self.shape[a] for a in self.repeats]
            field = fft.irfftn(modes, lengths, axes=self.repeats, workers=workers, overwrite_x=True)
        else:
            field = field * share
        for a in self.mirrored:
            field = fft.idct(field, axis=a, norm="ortho", workers=workers, overwrite_x=True)
        return field
