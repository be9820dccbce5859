"""Reads arrays of MATLAB files: version 5 to 7 from its elements, version 7.3 as HDF5.

Version 5: MathWorks, MAT-File Format, chapter 1: elements of a type, a number of bytes and data that fill up to 8
bytes; an array is an element that holds flags, sizes, a name and numbers, perhaps packed as a whole. (scipy.io.loadmat
1.17 ends the process where some bytes are damaged.)
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .hdf import open_hdf5
from .image import Inflated, Layout, Part, Readable, Stored, VoxelError, check_deflated, number_of_voxels, stored_part

MATRIX, COMPRESSED = 14, 15  # types of elements in a file
STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}  # types of numbers
NUMERIC = range(6, 16)  # classes of arrays: double, single, integers
COMPLEX = 0x0800  # bit of the flags
MOST_AXES = 32
MOST_NAME = 4096  # bytes


@dataclass(frozen=True)
class _Array:
    """An array: where its element begins, and in it its numbers, of the type `dtype`; dtype None: no numbers."""

    start: int
    packed: bool
    name: str
    shape: tuple[int, ...]
    dtype: np.dtype | None
    offset: int


def open_matlab(path: Path, layout: Layout) -> Stored:
    """The only array with more than one number, or the named one; its axes in the order of MATLAB."""
    with open(path, "rb") as file:
        head = file.read(520)
    if b"MATLAB 7.3" in head[:128] or b"\x89HDF\r\n\x1a\n" in head:
        return open_hdf5(path, layout, matlab=True)
    if len(head) < 136 or head[126:128] not in (b"IM", b"MI"):
        raise VoxelError(f"{path}: is no MATLAB file of version 5 or later; save it again with save -v7")
    order = "<" if head[126:128] == b"IM" else ">"
    arrays = {array.name: array for array in _arrays(path, order)}
    usable = [n for n, a in arrays.items() if a.dtype is not None and np.prod(a.shape, dtype=object) > 1]
    name = layout.array or (usable[0] if len(usable) == 1 else None)
    if name not in arrays:
        missing = "name one" if name is None else f"there is no '{name}'"
        raise VoxelError(f"{path}: holds the arrays {list(arrays)[:20]}; {missing} with the key 'array'")
    found = arrays[name]
    if found.dtype is None:
        raise VoxelError(f"{path}: '{name}' is no full array of real numbers; save one")
    part = stored_part(path, lambda: _numbers(path, found), found.dtype, found.shape, fortran=True)
    is_float = found.dtype.kind == "f"
    info = {"format": "MATLAB", "array": name}
    return Stored(found.shape, found.dtype, _whole(part) if is_float else part, info=info)


@contextmanager
def _numbers(path: Path, array: _Array) -> Iterator[Readable]:
    """A stream at the first number of an array."""
    with open(path, "rb") as file:
        file.seek(array.start)
        stream: Readable = Inflated(path, file) if array.packed else file
        stream.read(array.offset)
        yield stream


def _arrays(path: Path, order: str) -> Iterator[_Array]:
    """The arrays of a file, by their headers."""
    there = os.path.getsize(path)
    with open(path, "rb") as file:
        at = 128
        while at + 8 <= there:
            file.seek(at)
            kind, count = struct.unpack(f"{order}II", file.read(8))
            if kind not in (MATRIX, COMPRESSED) or at + 8 + count > there:
                raise VoxelError(f"{path}: is damaged or truncated at byte {at}; copy or save it again")
            packed = kind == COMPRESSED
            yield _header(path, file, order, at if not packed else at + 8, packed, count)
            at += 8 + count
    if at != there:
        raise VoxelError(f"{path}: is truncated; copy it again")


def _header(path: Path, file: BinaryIO, order: str, start: int, packed: bool, count: int) -> _Array:
    file.seek(start)
    stream = _Elements(path, Inflated(path, file) if packed else file, order)
    kind, inside = stream.tag()[:2]
    if kind != MATRIX:
        raise VoxelError(f"{path}: is damaged at byte {start}; copy or save it again")
    flags = stream.data(8, 16)
    (word,) = struct.unpack_from(f"{order}I", flags)
    sizes = stream.data(8, 4 * MOST_AXES)
    shape = tuple(struct.unpack(f"{order}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4]))
    name = stream.data(0, MOST_NAME).decode("latin-1")
    if word & 0xFF not in NUMERIC or word & COMPLEX or min(shape) < 1:
        return _Array(start, packed, name, shape, None, 0)
    kind, length, _ = stream.tag()
    if kind not in STORED:
        raise VoxelError(f"{path}: '{name}' holds numbers of a type that is not known ({kind}); save it again")
    dtype = np.dtype(order + STORED[kind])
    if number_of_voxels(path, shape) * dtype.itemsize != length or (not packed and stream.at + length > inside + 8):
        raise VoxelError(f"{path}: '{name}' is {length} bytes long, which {shape} numbers are not; save it again")
    if packed:
        check_deflated(path, count, length)
    return _Array(start, packed, name, shape, dtype, stream.at)


class _Elements:
    """The elements of an array, one after the other; at: bytes that were read."""

    def __init__(self, path: Path, stream: Readable, order: str):
        self.path, self.stream, self.order, self.at = path, stream, order, 0

    def read(self, count: int) -> bytes:
        """The next `count` bytes."""
        found = self.stream.read(count)
        if len(found) < count:
            raise VoxelError(f"{self.path}: is truncated; copy it again")
        self.at += count
        return found

    def tag(self) -> tuple[int, int, bool]:
        """(type, bytes, whether the data are in the tag itself) of the next element."""
        (word,) = struct.unpack(f"{self.order}I", self.read(4))
        if word >> 16:  # a small element: bytes and type in one word, the data in the next
            return word & 0xFFFF, word >> 16, True
        (count,) = struct.unpack(f"{self.order}I", self.read(4))
        return word, count, False

    def data(self, least: int, most: int) -> bytes:
        """The data of the next element, of `least` to `most` bytes."""
        _, count, small = self.tag()
        if not least <= count <= (4 if small else most):
            raise VoxelError(f"{self.path}: has a header that is damaged; copy or save it again")
        return self.read(4)[:count] if small else self.read(-(-count // 8) * 8)[:count]


def _whole(part: Callable[[Part], np.ndarray]) -> Callable[[Part], np.ndarray]:
    """Doubles that are whole numbers, in which MATLAB stores labels by default, as integers."""

    def whole(keep: Part) -> np.ndarray:
        values = part(keep)
        if np.isfinite(values).all() and (values == np.rint(values)).all() and abs(values).max() < 2**31:
            return values.astype(np.int32)
        return values

    return whole
