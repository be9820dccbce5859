"""Reads Palabos geometry files: whole numbers as text (.dat), z fastest."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from .image import Layout, Part, Stored, VoxelError, check_memory, number_of_voxels
from .raw import SIZES, array_shape, of_name

PIECE = 2**24  # bytes of text that are read at a time
ALLOWED = b"0123456789 \t\r\n"


def open_palabos(path: Path, layout: Layout) -> Stored:
    """One whole number per voxel, separated by blanks or lines; the sizes are given or stand in the name of the
    file."""
    shape = layout.shape or of_name(path.stem)[0]
    if shape is None:
        raise VoxelError(
            f"{path}: text without a header: give its sizes along x, y, z, such as {SIZES}"
        )
    array, voxels, size = array_shape(shape, layout.axes or "xyz"), number_of_voxels(path, shape), os.path.getsize(path)
    if size < 2 * voxels - 1:
        raise VoxelError(
            f"{path}: {size} bytes of text cannot hold {' x '.join(map(str, shape))} voxels; correct the shape"
        )

    def part(keep: Part) -> np.ndarray:
        check_memory(path, voxels)
        values = np.empty(voxels, np.uint8)
        count, rest = 0, b""
        with open(path, "rb") as file:
            while text := file.read(PIECE):
                if text.translate(None, ALLOWED):
                    raise VoxelError(f"{path}: holds more than whole numbers; give a file of 0, 1, 2 parted by blanks")
                text, last = _cut(rest + text)
                rest = last
                count = _put(path, values, count, text)
        count = _put(path, values, count, rest)
        if count != voxels:
            raise VoxelError(f"{path}: holds {count} numbers where {' x '.join(map(str, shape))} are {voxels}; correct "
                             "the shape")  # fmt: skip
        return values.reshape(array)[keep]

    note = () if layout.shape else (f"{path.name}: sizes by its name: {' x '.join(map(str, shape))} along x, y, z",)
    return Stored(array, np.dtype(np.uint8), part, info={"format": "Palabos text"}, warnings=note)


def _cut(text: bytes) -> tuple[bytes, bytes]:
    """The text up to its last blank, and the rest, perhaps the beginning of a number."""
    at = max(text.rfind(sign) for sign in (b" ", b"\n", b"\t", b"\r")) + 1
    return text[:at], text[at:]


def _put(path: Path, values: np.ndarray, count: int, text: bytes) -> int:
    words = text.split()
    if count + len(words) > len(values):
        raise VoxelError(f"{path}: holds more than {len(values)} numbers; correct the shape")
    numbers = np.array(words or [], dtype="S3").astype(np.int64) if words else np.empty(0, np.int64)
    if len(numbers) and numbers.max() > 255:
        raise VoxelError(f"{path}: holds the value {numbers.max()}; labels of this format are 0 to 255")
    values[count : count + len(words)] = numbers
    return count + len(words)
