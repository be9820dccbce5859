"""Grey images: the threshold, the blur of the scanner, and the field whose zero is the wall.

Where several processes share an image (`domain/slabs.py`), each gives its own layers: thresholds and means are of all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..domain import reduce
from ..domain.communicator import current
from ..domain.slabs import Slabs
from .images.image import VoxelError
from .modes import Modes

BINS = 1024  # of the histogram of Otsu's threshold: its step is a thousandth of the range of grey values
# voxel^4: weight of the squared Laplacian against the squared misfit. With 3e-4 noise of 10 % of the contrast closes
# the pores: k of scans with blurs of 0, 0.5 and 0.8 voxel is 8, 21 and 32 % low, with 1e-3 0 to 2 %
# (benchmarks/scanner.py, docs/design_notes.md)
ROUGHNESS = 1e-3
# square voxels: variance of a step in an image without blur, 1/12 by the average over a voxel, the rest by the spline
# between samples of it
UNBLURRED = 0.17
# voxels: blur by `scan_fit` up to which an image of two values is taken for a scan without being asked. Scans with a
# blur of 1 voxel have 0.95 to 0.99; gyroids 1.2 and more, fields that rise evenly over 4 voxels 1.1 and more
# (docs/design_notes.md)
WIDEST = 1.1
# Least share of the variance between the two sides of the threshold, or of Otsu's where that is more, in an image of
# two grey values. Random fields have 0.54 to 0.67, scans with a blur of 1.2 voxels and noise of 10 % 0.72, even values
# 0.75 (docs/design_notes.md)
TWO_VALUED = 0.7


def otsu_threshold(values: np.ndarray) -> float:
    """Grey value that parts the histogram into the two classes whose means differ most (Otsu 1979).

    Raises VoxelError where all values are the same.
    """
    counts, centres = _histogram(values)
    weight, moment = np.cumsum(counts), np.cumsum(counts * centres)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * weight / weight[-1] - moment) ** 2 / (weight * (weight[-1] - weight))
    between[~np.isfinite(between)] = 0.0
    best = np.flatnonzero(between >= between.max() * (1.0 - 1e-12))  # flat over an empty range: its middle
    return float(0.5 * (centres[best[0]] + centres[min(best[-1] + 1, len(centres) - 1)]))


def _histogram(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = range_of(values)
    if low == high:
        raise VoxelError(f"all grey values are {low:g}: there is nothing to part; check the image")
    if values.dtype == np.float32:  # its edges would be of single precision: too few between 1 and 1.0001
        values = values.astype(np.float64)
    counts, edges = np.histogram(values, BINS, (low, high))
    return current().sum(counts.astype(float)), 0.5 * (edges[1:] + edges[:-1])


def range_of(values: np.ndarray) -> tuple[float, float]:
    """The least and the largest grey value."""
    ends = np.array([[values.min(), values.max()]] if values.size else np.zeros((0, 2)), float)
    return float(reduce.smallest(ends[:, 0])), float(reduce.largest(ends[:, 1]))


def grey_classes(values: np.ndarray, threshold: float) -> tuple[float, float, float]:
    """(mean below, mean above, share of the variance that lies between them) of grey values at a threshold."""
    values = values.ravel()
    above = values >= threshold
    share, mean = float(reduce.mean(above)), reduce.mean(values)
    if share in (0.0, 1.0):
        return float(mean), float(mean), 0.0
    low, high = float(reduce.mean(values[~above])), float(reduce.mean(values[above]))
    variance = float(reduce.mean(np.square(values - mean)))
    return low, high, share * (1.0 - share) * (high - low) ** 2 / variance


def field_of_grey(values: np.ndarray, threshold: float, solid: str) -> np.ndarray:
    """Field, float32 of the shape of values: > 0 in fluid, 0 at the threshold, in units of half the contrast.

    solid: 'above' or 'below' the threshold.
    """
    low, high, _ = grey_classes(values, threshold)
    half = 0.5 * (high - low) or 1.0
    sign = 1.0 if solid == "above" else -1.0
    return (sign / half * (threshold - values.astype(np.float64))).astype(np.float32)


def labels_of_grey(values: np.ndarray, threshold: float, solid: str, fluids: Mapping[str, tuple[float, float]],
                   names: Sequence[str], path: str | Path = "image") -> np.ndarray:
    """Phases int8 of grey values: -1 in solids, else the index in `names` of the fluid in whose range [from, to) it is.

    Without `fluids` all pores hold the first. Raises VoxelError where a value of the pores is in no range, or a range
    holds no voxel of the pores.
    """
    is_solid = values >= threshold if solid == "above" else values <= threshold
    phases = np.where(is_solid, np.int8(-1), np.int8(0))
    if not fluids:
        return phases
    left = ~is_solid
    for name, (first, end) in fluids.items():
        own = left & (values >= first) & (values < end)
        if not reduce.any_true(own.ravel()):
            raise VoxelError(f"{path}: no voxel of the pores has a grey value of '{name}', {first:g} to {end:g}")
        phases[own] = names.index(name)
        left &= ~own
    if reduce.any_true(left.ravel()):
        low, high = range_of(values[left])
        raise VoxelError(f"{path}: grey values of the pores from {low:g} to {high:g} belong to no fluid; widen "
                         "geometry.voxels.grey.fluids")
    return phases


def sharpen(field: np.ndarray, blur: float, around: np.ndarray, slabs: Slabs | None = None) -> np.ndarray:
    """The field, float32 [z, y, x], without the scanner's Gaussian of `blur` voxels, the average over a voxel and that
    of the spline.

    An average of variance s^2 moves a wall with the principal radii of curvature R and Q by s^2 (1/R + 1/Q) / 2 towards
    its centre: grains and fibres of few voxels become thinner. The regularised inverse that minimises
    |H f - field|^2 + ROUGHNESS |lap f|^2 (Tikhonov), H a Gaussian of the variance blur^2 + UNBLURRED: of every mode
    H / (H^2 + ROUGHNESS k^4) is kept, k its wave number. Periodic and mirrored as `spline_coefficients` continues the
    field; slabs: as there.
    """
    modes = Modes(field.shape if slabs is None else slabs.shape, around, slabs)
    square = (2.0 * np.pi) ** 2 * modes.square_frequencies()
    left = np.exp(-0.5 * (blur * blur + UNBLURRED) * square)
    return modes.filtered(field, (left / (left * left + ROUGHNESS * square * square)).astype(np.float32))
