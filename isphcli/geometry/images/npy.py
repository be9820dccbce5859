"""Reads npy files; pickled objects are never loaded."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .image import Layout, Stored, VoxelError, check_size, number_of_voxels, stored_part


def open_npy(path: Path, layout: Layout) -> Stored:
    """An npy file."""
    with open(path, "rb") as file:
        shape, fortran, dtype = npy_header(path, file)
        start = file.tell()
    check_size(path, start + number_of_voxels(path, shape) * dtype.itemsize, os.path.getsize(path))

    @contextmanager
    def data() -> Iterator[BinaryIO]:
        with open(path, "rb") as file:
            file.seek(start)
            yield file

    return Stored(shape, dtype, stored_part(path, data, dtype, shape, fortran), info={"format": "npy"})


def npy_header(path: Path, file: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype]:
    """(shape, whether its first axis runs fastest, type) of an npy stream, which is left at the first value."""
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
    return tuple(map(int, shape)), fortran, dtype  # True is a size for numpy's parser
