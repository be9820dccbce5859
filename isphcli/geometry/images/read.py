"""Reads an image of any format that is known, by the suffix of its file."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .image import MAX_HEADER, SPACING, Image, VoxelError, _checked, _thin
from .metaimage import _meta_header, _meta_numbers, _read_meta
from .npy import _read_npy_file
from .npz import _read_npz


def read_image(path: str | Path, array: str | None = None, grey: bool = False) -> Image:
    """Read an npy, npz (`array`: which of several), mhd or mha file.

    Values are labels, integers of 0 or more in the smallest unsigned type; with `grey`, numbers of any type, integers
    or floating point (never NaN). Raises VoxelError where the file is no such image, or a picture in colours.
    """
    path = Path(path)
    if not path.is_file():
        raise VoxelError(f"{path}: no such file; give the path of an npy, npz, mhd or mha image")
    readers = {".npy": _read_npy_file, ".npz": _read_npz, ".mhd": _read_meta, ".mha": _read_meta}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise VoxelError(f"{path}: '{path.suffix}' images are not read; give npy, npz, mhd (with raw) or mha")
    try:
        values, spacing, info = reader(path, array)
    except OSError as error:
        raise VoxelError(f"{path}: cannot be read ({error.strerror or error}); check the file") from None
    values = _checked(path, values, grey)
    return Image(values, spacing, info, _thin(path, values))


def image_shape(path: str | Path, array: str | None = None) -> tuple[int, ...] | None:
    """Shape [z, y, x] or [y, x] by the header of an image, its values unread.

    None where the header does not tell: `read_image` then says what is wrong.
    """
    path = Path(path)
    try:
        if path.suffix.lower() in (".mhd", ".mha"):
            with open(path, "rb") as file:
                header, _ = _meta_header(path, file.read(MAX_HEADER))
            return tuple(_meta_numbers(path, header, "DimSize", int)[::-1])
        if path.suffix.lower() == ".npy":
            with open(path, "rb") as file:
                return _npy_shape(file)
        if path.suffix.lower() == ".npz":
            with zipfile.ZipFile(path) as archive:
                names = [n for n in archive.namelist() if n not in (SPACING, f"{SPACING}.npy")]
                with archive.open(names[0] if array is None else f"{array}.npy") as file:
                    return _npy_shape(file)  # type: ignore[arg-type]
    except Exception:  # whatever broken bytes make the parsers raise
        return None
    return None


def _npy_shape(file: BinaryIO) -> tuple[int, ...]:
    """Shape in the header of an npy stream, sides of one in front left out as `read_image` does."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape = tuple(int(n) for n in read(file)[0])
    while len(shape) > 3 and shape[0] == 1:
        shape = shape[1:]
    return shape
