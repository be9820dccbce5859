"""Reads files without a header: their layout is given, or found in their name or in a header file beside them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .image import Layout, Stored, VoxelError, check_size, number_of_voxels, stored_part
from .metaimage import open_metaimage
from .nrrd import open_nrrd

DTYPES = ("uint8", "uint16", "uint32", "uint64", "int8", "int16", "int32", "int64", "float32", "float64")
HEADERS = {".mhd": open_metaimage, ".nhdr": open_nrrd}
BY_SIZE = {1: "uint8", 2: "uint16"}  # the usual type of images with so many bytes per voxel
_SIZES = re.compile(r"(?<!\d)(\d{1,5})[xX_×](\d{1,5})(?:[xX_×](\d{1,5}))?(?!\d)")
_WORDS = {
    "uint8": "uint8", "u8": "uint8", "uchar": "uint8", "8bit": "uint8", "8bits": "uint8", "byte": "uint8",
    "uint16": "uint16", "u16": "uint16", "ushort": "uint16", "16bit": "uint16", "16bits": "uint16", "int8": "int8",
    "int16": "int16", "short": "int16", "int32": "int32", "uint32": "uint32", "float32": "float32", "float": "float32",
    "32bit": "float32", "f32": "float32", "float64": "float64", "double": "float64", "int64": "int64",
    "uint64": "uint64",
}  # fmt: skip
# a type and the order of its bytes: uint16be, 16bit_be, float32-bigendian
_ORDER = re.compile(
    r"(u?int\d+|[uf]\d+|\d+bits?|float\d*|u?short|double)[ _-]?"
    r"(be|le|big[ _-]?endian|little[ _-]?endian)(?![a-z0-9])"
)

# the options that give the shape of an image without a header, for messages
SIZES = "--set 'geometry.voxels.shape=[100, 100, 50]' (convert-voxels: --shape 100,100,50)"


def open_raw(path: Path, layout: Layout) -> Stored:
    """Values that follow one another in the order of `layout.axes`, x fastest in zyx.

    Missing entries of the layout are taken from the sizes and the type in the file's name, or from an mhd or nhdr
    beside it that names it, where they fit its size in bytes. Raises VoxelError, with likely shapes, where the layout
    is unknown.
    """
    size = os.path.getsize(path)
    if layout.shape is None and layout.dtype is None and (header := _header_beside(path)) is not None:
        return header
    name_shape, name_dtype = of_name(path.stem)
    shape = layout.shape or name_shape
    offset = layout.offset or 0
    if shape is None:
        raise VoxelError(
            f"{path}: has no header: give its sizes along x, y, z and its type, such as {SIZES}, "
            f"--set geometry.voxels.dtype=uint8{_cube(size - offset, layout.dtype or name_dtype)}"
        )
    voxels = number_of_voxels(path, shape)
    dtype = layout.dtype or name_dtype or BY_SIZE.get((size - offset) // voxels if (size - offset) % voxels == 0 else 0)
    sizes = " x ".join(map(str, shape))
    if dtype is None:
        raise VoxelError(
            f"{path}: {size - offset} bytes are {(size - offset) / voxels:.4g} for each of {sizes} voxels; "
            f"give the type ({', '.join(DTYPES)}: geometry.voxels.dtype, --dtype), and an offset if there "
            "is a header"
        )
    order = layout.byte_order or order_of_name(path.stem)
    kind = np.dtype(dtype).newbyteorder(">" if order == "big" else "<")
    if offset + voxels * kind.itemsize != size:
        raise VoxelError(
            f"{path}: holds {size} bytes; {sizes} voxels of {dtype} after {offset} bytes are "
            f"{offset + voxels * kind.itemsize}: correct shape, dtype or offset"
        )
    check_size(path, offset + voxels * kind.itemsize, size)

    @contextmanager
    def data() -> Iterator[BinaryIO]:
        with open(path, "rb") as file:
            file.seek(offset)
            yield file

    array = array_shape(shape, layout.axes or "zyx")
    asked = [key for key, value in (("shape", layout.shape), ("dtype", layout.dtype)) if value is None]
    asked += ["byte_order"] if layout.byte_order is None and order == "big" else []
    note: tuple[str, ...] = ()
    if asked:
        along = ", ".join("xyz"[: len(shape)])
        keys = " and ".join(asked) if len(asked) < 3 else "shape, dtype and byte_order"
        said = f"{path.name}: {keys} by its name and size: {sizes} voxels along {along}, {dtype}"
        note = (said + ("" if kind.itemsize == 1 else f", {order} endian"),)
    return Stored(
        array, kind, stored_part(path, data, kind, array), info={"format": "raw", "shape": array}, warnings=note
    )


def array_shape(shape: tuple[int, ...], axes: str) -> tuple[int, ...]:
    """Shape of an array with these axes whose sizes along x, y(, z) are given."""
    return tuple(shape["xyz".index(a)] for a in axes if "xyz".index(a) < len(shape))


def of_name(stem: str) -> tuple[tuple[int, ...] | None, str | None]:
    """Sizes along x, y(, z) and type in a name such as rock_1000x1000x800_uint8, each None where it is not there."""
    found = _SIZES.findall(stem)
    sizes = [tuple(int(n) for n in numbers if n) for numbers in found]
    plain = _ORDER.sub(lambda found: found[1], stem.lower())
    words = [_WORDS[word] for word in re.split(r"[^a-z0-9]+", plain) if word in _WORDS]
    return (max(sizes, key=len) if sizes else None), (words[-1] if words else None)


def order_of_name(stem: str) -> str:
    """'big' or 'little': the order of bytes behind the type in a name such as rock_10x10x10_uint16be, else little."""
    found = _ORDER.search(stem.lower())
    return "big" if found and found[2].startswith("b") else "little"


def _header_beside(path: Path) -> Stored | None:
    for suffix, opened in HEADERS.items():
        for header in (path.with_suffix(suffix), path.with_name(path.name + suffix)):
            if header.is_file() and path.name in header.read_bytes()[:65536].decode("latin-1"):
                return opened(header, Layout())
    return None


def _cube(size: int, dtype: str | None) -> str:
    """A guess, in words, of the edge and type of a cubic image of so many bytes."""
    for kind in (dtype,) if dtype else ("uint8", "uint16", "float32"):
        side = round((size / np.dtype(kind).itemsize) ** (1 / 3))
        if side > 1 and side**3 * np.dtype(kind).itemsize == size:
            return f"; its {size} bytes would be {side} x {side} x {side} of {kind}"
    square = math.isqrt(size)
    return f"; its {size} bytes would be {square} x {square} of uint8" if square > 1 and square**2 == size else ""
