"""Fields on voxel centres, mode by mode: waves along periodic axes, cosines along mirrored ones."""

from __future__ import annotations

import numpy as np
from numba import get_num_threads
from scipy import fft


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
        square = np.zeros((1, 1, 1))
        for a in self.repeats + self.mirrored:
            n = self.shape[a]
            q = (np.arange(n) / (2 * n) if a in self.mirrored
                 else fft.rfftfreq(n) if a == self.repeats[-1] else fft.fftfreq(n))
            square = square + (q**2).reshape([-1 if b == a else 1 for b in range(3)])
        return square

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
