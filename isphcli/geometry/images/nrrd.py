"""Reads NRRD files: nrrd, and nhdr with its data in another file (pynrrd reads the header)."""

from __future__ import annotations

import bz2
import gzip
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..lengths import metres
from .image import (
    Layout,
    Part,
    Readable,
    Stored,
    VoxelError,
    check_deflated,
    check_size,
    number_of_voxels,
    stored_part,
    voxel_edges,
)

TYPES = {
    "signed char": "i1", "int8": "i1", "int8_t": "i1", "uchar": "u1", "unsigned char": "u1", "uint8": "u1",
    "uint8_t": "u1", "short": "i2", "short int": "i2", "signed short": "i2", "signed short int": "i2", "int16": "i2",
    "int16_t": "i2", "ushort": "u2", "unsigned short": "u2", "unsigned short int": "u2", "uint16": "u2",
    "uint16_t": "u2", "int": "i4", "signed int": "i4", "int32": "i4", "int32_t": "i4", "uint": "u4",
    "unsigned int": "u4", "uint32": "u4", "uint32_t": "u4", "longlong": "i8", "long long": "i8", "long long int": "i8",
    "signed long long": "i8", "signed long long int": "i8", "int64": "i8", "int64_t": "i8", "ulonglong": "u8",
    "unsigned long long": "u8", "unsigned long long int": "u8", "uint64": "u8", "uint64_t": "u8", "float": "f4",
    "double": "f8",
}  # fmt: skip


def open_nrrd(path: Path, layout: Layout) -> Stored:
    """NRRD: sizes with the fastest axis first; spacings or the lengths of space directions, and their unit."""
    import nrrd

    with open(path, "rb") as file:
        try:
            header = nrrd.read_header(file)
        except Exception as error:  # whatever broken text makes the library raise
            raise VoxelError(f"{path}: is no NRRD header ({error}); save it again") from None
        start = file.tell()
    shape, dtype = _array(path, header)
    name = header.get("data file", header.get("datafile"))
    source = path if name is None else path.parent / str(name)
    if not source.is_file():
        raise VoxelError(f"{path}: its data file {source} does not exist; correct 'data file'")
    encoding = str(header.get("encoding", "")).lower()
    start = start if name is None else 0
    needed, there = number_of_voxels(path, shape) * dtype.itemsize, os.path.getsize(source)
    skip = int(header.get("byte skip", header.get("byteskip", 0)))
    lines = int(header.get("line skip", header.get("lineskip", 0)))
    spacing, key = _spacing(path, header, len(shape))
    info = {"format": "NRRD", "encoding": encoding}
    if encoding in ("ascii", "text", "txt"):
        return Stored(shape, dtype, _of_text(path, header, shape), spacing, key, info=info)
    if encoding not in ("raw", "gz", "gzip", "bz2", "bzip2"):
        raise VoxelError(f"{path}: its encoding '{encoding}' is not known; save it as raw or gzip")
    if encoding == "raw":
        if skip == -1:
            skip = there - start - needed
        if not lines:
            check_size(source, start + skip + needed, there)
    elif encoding.startswith("g"):
        check_deflated(source, there - start, needed)

    @contextmanager
    def data() -> Iterator[Readable]:
        with open(source, "rb") as file:
            file.seek(start)
            for _ in range(lines):
                file.readline()
            if encoding == "raw":
                file.seek(max(skip, 0), os.SEEK_CUR)
                yield file
                return
            with gzip.GzipFile(fileobj=file) if encoding.startswith("g") else bz2.BZ2File(file) as packed:
                packed.read(max(skip, 0))
                yield packed

    return Stored(shape, dtype, stored_part(source, data, dtype, shape), spacing, key, info=info)


def _array(path: Path, header: dict[str, Any]) -> tuple[tuple[int, ...], np.dtype]:
    code = TYPES.get(str(header.get("type", "")).lower())
    if code is None:
        raise VoxelError(f"{path}: its type '{header.get('type')}' is not known; save it as uint8 or uint16")
    if "sizes" not in header:
        raise VoxelError(f"{path}: its header has no sizes; save it again")
    shape = tuple(int(n) for n in header["sizes"])[::-1]
    if int(header.get("dimension", len(shape))) != len(shape):
        raise VoxelError(f"{path}: has {len(shape)} sizes but dimension {header['dimension']}; correct the header")
    return shape, np.dtype((">" if str(header.get("endian", "little")).lower() == "big" else "<") + code)


def _of_text(path: Path, header: dict[str, Any], shape: tuple[int, ...]) -> Any:
    def part(keep: Part) -> np.ndarray:
        import nrrd

        with open(path, "rb") as file:
            nrrd.read_header(file)
            values = nrrd.read_data(header, file, str(path), index_order="C")
        return values[keep]

    return part


def _spacing(path: Path, header: dict[str, Any], dim: int) -> tuple[tuple[float, ...] | None, str]:
    """Edges of a voxel along the axes of the file, and the entry that holds them if it does not say their unit."""
    if "space directions" in header:
        found = np.linalg.norm(np.asarray(header["space directions"], float), axis=-1)
        key = "space directions"
    elif "spacings" in header:
        found, key = np.asarray(header["spacings"], float), "spacings"
    else:
        return None, ""
    found = found[np.isfinite(found)]  # an axis of channels has none
    if len(found) != dim or not (found > 0).all():
        return None, ""
    units = header.get("space units", header.get("units"))
    scales = {metres(str(unit)) for unit in np.ravel(units)} if units is not None else {None}
    scale = scales.pop() if len(scales) == 1 else None
    sizes = voxel_edges(found, dim, path)
    return (sizes, key) if scale is None else (tuple(s * scale for s in sizes), "")
