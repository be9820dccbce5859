"""Steps from a scan to labels: thresholds, cutting off a solid border, keeping only the percolating pores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .connectivity import components
from .grey import otsu_threshold
from .images.image import VoxelError

PORE, SOLID, BETWEEN = 0, 1, 2  # labels that thresholds make


def thresholded(
    values: np.ndarray, thresholds: Sequence[float] | str, invert: bool = False, path: str | Path = "image"
) -> tuple[np.ndarray, str]:
    """(labels uint8 of the shape of values, the rule in words) of grey values at one or two thresholds, or 'otsu'.

    Values from the (upper) threshold on are SOLID, those below the (lower) one PORE, those of two thresholds in between
    BETWEEN; `invert` turns solid and pore round. Raises VoxelError where there are not one or two that ascend.
    """
    by_otsu = isinstance(thresholds, str)
    limits = (otsu_threshold(values),) if isinstance(thresholds, str) else tuple(thresholds)
    if len(limits) not in (1, 2) or list(limits) != sorted(set(limits)):
        raise VoxelError(
            f"{path}: {len(limits)} thresholds {', '.join(map(str, limits))}; give one, or two that ascend"
        )
    low, high = values.min(), values.max()
    idle = [f"{limit:g}" for limit in limits if not low < limit <= high]
    labels = np.zeros(values.shape, np.uint8)
    bright, dark = (PORE, SOLID) if invert else (SOLID, PORE)
    labels[...] = dark
    if len(limits) == 2:
        labels[values >= limits[0]] = BETWEEN
    labels[values >= limits[-1]] = bright
    sign, limit = ("<", limits[0]) if invert else (">=", limits[-1])
    rule = f"grey {sign} {limit}{' (Otsu)' * by_otsu} is solid"
    rule += f", from {limits[0]} to {limits[1]} {BETWEEN}" if len(limits) == 2 else ""
    return labels, rule + (
        f"; {', '.join(idle)} parts nothing: all grey values lie from {low:g} to {high:g}" if idle else ""
    )


def inverted(values: np.ndarray, path: str | Path = "image") -> np.ndarray:
    """An image of two labels with each in the place of the other; raises VoxelError where there are not two."""
    low, high = values.min(), values.max()
    is_low = values == low
    if low == high or not (is_low | (values == high)).all():
        raise VoxelError(
            f"{path}: does not hold two labels, which --invert exchanges; give --threshold for grey values, or "
            "--labels for others"
        )
    return np.where(is_low, high, low)


def is_fluid(values: np.ndarray, solids: Sequence[int]) -> np.ndarray:
    """Mask of the values that are none of solids; one byte per voxel, where np.isin takes nine."""
    fluid = np.ones(values.shape, bool)
    for value in solids:
        fluid &= values != value
    return fluid


def trimmed(
    values: np.ndarray, solids: Sequence[int], path: str | Path = "image"
) -> tuple[np.ndarray, tuple[int, ...]]:
    """(the smallest part of an image outside of which all is solid, voxels cut off in all along x, y(, z))."""
    fluid = is_fluid(values, solids)
    if not fluid.any():
        raise VoxelError(
            f"{path}: all voxels are solid (values {', '.join(map(str, solids))}): nothing would be left; name "
            "the values that are solid with --solid"
        )
    keep = []
    for axis in range(values.ndim):
        rest = tuple(a for a in range(values.ndim) if a != axis)
        (there,) = np.nonzero(fluid.any(axis=rest))
        keep.append(slice(int(there[0]), int(there[-1]) + 1))
    part = values[tuple(keep)]
    return part, tuple(a - b for a, b in zip(values.shape[::-1], part.shape[::-1]))


def connected_part(
    values: np.ndarray, solids: Sequence[int], which: str, path: str | Path = "image"
) -> tuple[np.ndarray, int]:
    """(the image with all other pores filled with the first value of solids, how many voxels those were).

    which: 'x', 'y' or 'z' keeps the pores that lead from face to face along that axis, 'any' along any of them,
    'largest' the largest connected pore. Raises VoxelError where none is left.
    """
    labels, n, through = components(is_fluid(values, solids), (False,) * values.ndim)
    if which == "largest":
        sizes = np.zeros(n + 1, np.int64)
        for layer in labels:
            sizes += np.bincount(layer.ravel(), minlength=n + 1)
        sizes[0] = 0
        kept = np.arange(n + 1) == (np.argmax(sizes) if n else -1)
    elif which == "any":
        kept = through.any(axis=1)
    elif which in "xyz"[: values.ndim]:
        kept = through[:, "xyz".index(which)]
    else:
        raise VoxelError(f"{path}: an image of {values.ndim} dimensions has no pores along '{which}'")
    if not kept.any():
        where = f"along {which}" if which in "xyz" else "along any axis" if which == "any" else "at all"
        raise VoxelError(f"{path}: no pore leads through {where}; look at the values that are solid")
    fill = ~kept[labels] & (labels > 0)
    result = values.copy()
    result[fill] = solids[0]
    return result, int(np.count_nonzero(fill))
