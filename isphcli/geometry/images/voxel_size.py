"""The size of a voxel, from the case or from the file, with warnings where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .image import UNITS, Image, VoxelError

COARSE = 1e-3  # m: images of rock have finer voxels
SAME_SIZE = 1e-3  # relative difference up to which two voxel sizes are the same, rounded differently


def voxel_size_of(
    image: Image, given: float | Sequence[float] | None, path: str | Path
) -> tuple[np.ndarray, str, tuple[str, ...]]:
    """Edges of a voxel along x, y(, z), m, (1,) or (dim,); where they come from; warnings.

    given: of the case, or None: then that of the file. Raises VoxelError where neither has one.
    """
    spacing, key = known_spacing(image), image.spacing_key
    name = Path(path).name
    if given is None:
        if spacing is None:
            raise VoxelError(f"{path}: holds no voxel size; give geometry.voxels.voxel_size, in m")
        source = f"from {name}"
        if not key:
            return np.array(spacing), source, ()
        where = f"{source}, whose {key} has no unit: taken as metres"
        most = max(spacing)
        if most < COARSE:
            return np.array(spacing), where, ()
        units = [f"{most * size:g} m if it is in {unit}" for unit, size in UNITS.items()]
        hint = (f"{name}: {key} {_numbers(spacing)} has no unit and is taken as metres; voxels of rock are "
                f"finer: give the voxel size, {' or '.join(units[:2])} (geometry.voxels.voxel_size, "
                "--voxel-size)")  # fmt: skip
        return np.array(spacing), where, (hint,)
    size = np.ravel(np.asarray(given, dtype=float))
    source = "as given"
    if spacing is None or len(size) not in (1, len(spacing)):
        return size, source, ()
    ratio = np.broadcast_to(size, len(spacing)) / np.array(spacing)
    if np.allclose(ratio, 1.0, rtol=SAME_SIZE, atol=0.0):
        return size, f"{source}, as in {name}", ()
    for unit, length in UNITS.items() if key else ():
        if np.allclose(ratio, length, rtol=SAME_SIZE, atol=0.0):
            return size, f"{source}, as in {name} if that is in {unit}", ()
    unit = " (without a unit)" if key else " m"
    said = (f"the voxel size given, {_numbers(size)} m, is not that of {name}, {_numbers(spacing)}{unit}; the one "
            "given is taken: leave it out (geometry.voxels.voxel_size, --voxel-size) for that of the file")  # fmt: skip
    return size, f"{source}; {name} has {_numbers(spacing)}{unit}", (said,)


def known_spacing(image: Image) -> tuple[float, ...] | None:
    """Edges of a voxel along x, y(, z) that the file tells, or None; 1 1 1 without a unit stands for not known."""
    if image.spacing is None or (image.spacing_key and all(s == 1.0 for s in image.spacing)):
        return None
    return image.spacing


def _numbers(sizes: Sequence[float] | np.ndarray) -> str:
    """'5e-06' where all are equal, else '1e-06 x 1e-06 x 2e-06'."""
    words = [f"{s:.6g}" for s in sizes]
    return words[0] if len(set(words)) == 1 else " x ".join(words)
