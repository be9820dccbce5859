"""Reads arrays of MATLAB files: up to version 7 by scipy, version 7.3 as HDF5."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .hdf import open_hdf5
from .image import Layout, Part, Stored, VoxelError, _check_memory, _product

CLASSES = {"uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2", "uint32": "u4", "int32": "i4", "uint64": "u8",
           "int64": "i8", "single": "f4", "double": "f8", "logical": "u1"}  # fmt: skip


def open_matlab(path: Path, layout: Layout) -> Stored:
    """The only array of 2 or 3 dimensions with more than one number, or the one that is named."""
    from scipy import io

    with open(path, "rb") as file:
        head = file.read(520)
    if b"MATLAB 7.3" in head[:128] or b"\x89HDF\r\n\x1a\n" in head:
        return open_hdf5(path, layout, matlab=True)
    arrays = {name: (shape, kind) for name, shape, kind in io.whosmat(path)}
    usable = [n for n, (shape, kind) in arrays.items() if kind in CLASSES and np.prod(shape, dtype=object) > 1]
    name = layout.array or (usable[0] if len(usable) == 1 else None)
    if name not in arrays:
        missing = "name one" if name is None else f"there is no '{name}'"
        raise VoxelError(f"{path}: holds the arrays {list(arrays)[:20]}; {missing} with the key 'array'")
    shape, kind = arrays[name]
    if kind not in CLASSES:
        raise VoxelError(f"{path}: '{name}' is a {kind} and no array of numbers; save one")
    shape = tuple(map(int, shape))

    def part(keep: Part) -> np.ndarray:
        _check_memory(path, _product(path, shape) * np.dtype(CLASSES[kind]).itemsize)
        values = io.loadmat(path, variable_names=[name])[name]
        if values.shape != shape:
            raise VoxelError(f"{path}: '{name}' is not what its header says; save it again")
        return _whole(values[keep])

    return Stored(shape, np.dtype(CLASSES[kind]), part, info={"format": "MATLAB", "array": name})


def _whole(values: np.ndarray) -> np.ndarray:
    """Doubles that are whole numbers, as MATLAB saves labels unless told otherwise, as integers."""
    if (
        values.dtype.kind == "f"
        and np.isfinite(values).all()
        and (values == np.rint(values)).all()
        and abs(values).max() < 2**31
    ):
        return values.astype(np.int32)
    return values
