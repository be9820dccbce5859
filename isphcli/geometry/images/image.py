"""An image in memory, and the checks that the readers of all formats share.

Arrays are indexed [z, y, x] or [y, x]. Nothing in a file is believed before it is checked: sizes are compared
with the header before memory is taken, and pickled objects are never loaded.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

MAX_HEADER = 65536  # bytes of a MetaImage header
MAX_DEFLATE = 1032  # greatest compression of deflate
SPACING = "voxel_size"  # array of an npz that holds the spacing x, y, z


class VoxelError(ValueError):
    """An image that cannot be used: the file, what is wrong, what to do."""


@dataclass(frozen=True)
class Image:
    """values: integers [z, y, x] or [y, x]; spacing: edges of a voxel in the order x, y(, z), or None.

    spacing of npz files is in m; a MetaImage does not say its unit. info: format and header; warnings: sentences.
    """

    values: np.ndarray
    spacing: tuple[float, ...] | None = None
    info: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


UNITS = {"millimetres": 1e-3, "micrometres": 1e-6, "nanometres": 1e-9}  # that imaging tools write without saying so


def _sizes(voxel_size: float | Sequence[float] | np.ndarray, dim: int, path: str | Path) -> tuple[float, ...]:
    sizes = np.ravel(np.asarray(voxel_size, dtype=float))
    if sizes.size not in (1, dim) or not np.isfinite(sizes).all() or not (sizes > 0).all():
        raise VoxelError(f"{path}: voxel size {voxel_size} must be positive: one number or {dim}")
    return tuple(float(s) for s in np.broadcast_to(sizes, dim))


def _checked(path: Path, values: np.ndarray, grey: bool) -> np.ndarray:
    """Values as the smallest unsigned integers, or an error that says why they are no labels."""
    if values.dtype.kind not in "buif":
        raise VoxelError(f"{path}: holds data of type {values.dtype}; save integers, such as uint8")
    while values.ndim > 3 and values.shape[0] == 1:
        values = values[0]
    _check_colours(path, values)
    if values.ndim not in (2, 3):
        raise VoxelError(f"{path}: has {values.ndim} dimensions; an image has 2 or 3")
    if values.size == 0:
        raise VoxelError(f"{path}: is empty (shape {values.shape}); give at least one voxel")
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise VoxelError(f"{path}: holds NaN; replace them before the conversion")
    if grey:
        return values
    if values.dtype.kind == "f":
        raise VoxelError(
            f"{path}: holds {values.dtype} numbers; save integer labels or convert with a threshold"
        )
    if values.dtype.kind == "i" and values.min() < 0:
        raise VoxelError(
            f"{path}: holds negative values ({values.min()}); labels are 0 or more: relabel them"
        )
    return _smallest(values)


THICK = 8  # a picture is at least so many times as wide as it has channels


def _check_colours(path: Path, values: np.ndarray) -> None:
    """Refuse a picture with channels: colours, or one and the same grey, and perhaps an opacity.

    Only unsigned bytes and floating point are pictures: a scan three voxels thick can be saved in another type.
    """
    if values.ndim not in (3, 4) or values.shape[-1] not in (3, 4) or values.size == 0:
        return
    if values.ndim == 3 and (values.dtype.kind not in "uf" or values.dtype in ("u2", "u4", "u8")):
        return
    height, width, channels = values.shape[-3:]
    if min(height, width) < THICK * channels and values.ndim == 3:
        return
    colours = values[..., :3]
    grey = bool((colours == colours[..., :1]).all())
    opaque = channels == 4 and bool((values[..., 3] == values[..., 3].flat[0]).all())
    many = len(np.unique(colours)) > 16
    if grey or opaque or many or values.ndim == 4:
        fix = "image[..., 0]" if grey else "image[..., :3].mean(axis=-1)"
        raise VoxelError(
            f"{path}: looks like a picture in colours, {channels} channels in its last axis (shape {values.shape}); "
            f"save one number a voxel, such as {fix}. A scan that is {channels} voxels thick along its last axis: save "
            "it as bool or uint16"
        )


def _thin(path: Path, values: np.ndarray) -> tuple[str, ...]:
    """A warning where an axis may be channels and not voxels."""
    if values.ndim != 3 or values.shape[0] == 1:  # [1, y, x] is 2D
        return ()
    thin = [a for a in (0, 2) if values.shape[a] <= 4 and min(np.delete(values.shape, a)) >= THICK * values.shape[a]]
    if len(thin) != 1:
        return ()
    (a,) = thin
    which, n = ("first", values.shape[a]) if a == 0 else ("last", values.shape[a])
    return (
        f"{path.name}: the {which} axis of the array has {n} entr{'y' if n == 1 else 'ies'} and is taken for an axis "
        f"of space, {n} voxel{'s' * (n > 1)} thick; if it is that of colours, save one number a voxel (an array [y, x] "
        "is 2D)",
    )


def _smallest(values: np.ndarray) -> np.ndarray:
    """Non-negative integers in the smallest unsigned type that holds them, C order, native bytes."""
    if values.dtype == bool:
        return values.astype(np.uint8)
    return np.ascontiguousarray(values, dtype=np.min_scalar_type(int(values.max())))


def _memory() -> int:
    """Bytes that one image may take: half of the machine's memory."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    except (AttributeError, OSError, ValueError):
        return 2**32


def _check_size(path: Path, needed: int, there: int) -> None:
    """The header's bytes against the bytes of the file and the memory of the machine."""
    if needed > _memory():
        raise VoxelError(
            f"{path}: the header asks for {needed} bytes, more than half of the memory; crop the image"
        )
    if needed > there:
        raise VoxelError(
            f"{path}: is truncated: {there} bytes of {needed}; copy it again or correct the header"
        )
    if needed < there:
        raise VoxelError(f"{path}: holds {there} bytes where the header says {needed}; correct the header")


def _product(path: Path, shape: Sequence[int]) -> int:
    """Number of voxels in exact integers."""
    count = 1
    for n in shape:
        if n < 0:
            raise VoxelError(f"{path}: has a negative size in shape {tuple(shape)}; correct the header")
        count *= int(n)
    if count == 0 or len(shape) > 8:
        raise VoxelError(f"{path}: is empty or no image (shape {tuple(shape)}); give 2 or 3 dimensions")
    return count


def _inflate(path: Path, file: BinaryIO, there: int, needed: int) -> bytearray:
    """Decompress zlib data of a known size, never more than that."""
    _check_size(path, needed, max(needed, 0))
    if needed > MAX_DEFLATE * there + 1024:
        raise VoxelError(
            f"{path}: is truncated: {there} compressed bytes cannot hold {needed}; copy it again"
        )
    inflater, data = zlib.decompressobj(), bytearray()
    try:
        while len(data) < needed and (part := file.read(2**20)):
            while part and len(data) < needed:
                data += inflater.decompress(part, needed - len(data))
                part = inflater.unconsumed_tail
    except zlib.error as error:
        raise VoxelError(f"{path}: compressed data is damaged ({error}); copy it again") from None
    if len(data) < needed:
        raise VoxelError(f"{path}: is truncated: {len(data)} bytes of {needed}; copy it again")
    return data
