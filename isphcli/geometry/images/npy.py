"""Reads npy files; pickled objects are never loaded."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .image import VoxelError, _check_size, _product


def _read_npy_file(path: Path, array: str | None) -> tuple[np.ndarray, None, dict]:
    with open(path, "rb") as file:
        return _read_npy(path, file, os.path.getsize(path)), None, {"format": "npy"}


def _read_npy(path: Path, file: BinaryIO, size: int) -> np.ndarray:
    """One npy stream of `size` bytes; the header is checked before anything is allocated."""
    try:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[
            version
        ]
        shape, fortran, dtype = read(file)
    except Exception:  # whatever the bytes make numpy's parser raise
        raise VoxelError(f"{path}: is not an npy array; save it again with numpy.save") from None
    if dtype.hasobject or dtype.kind not in "buif":
        raise VoxelError(f"{path}: holds data of type {dtype}; save integers, such as uint8")
    count = _product(path, shape)
    _check_size(path, file.tell() + count * dtype.itemsize, size)
    data = bytearray()
    while len(data) < count * dtype.itemsize:
        part = file.read(min(2**26, count * dtype.itemsize - len(data)))
        if not part:
            raise VoxelError(f"{path}: is truncated; copy it again")
        data += part
    values, shape = np.frombuffer(data, dtype=dtype), tuple(map(int, shape))  # True is a size for numpy's parser
    return values.reshape(shape[::-1]).transpose() if fortran else values.reshape(shape)
