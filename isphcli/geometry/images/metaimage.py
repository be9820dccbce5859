"""Reads MetaImage files: mhd with a raw file, and mha."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .image import (
    MAX_HEADER,
    Inflated,
    Layout,
    Readable,
    Stored,
    VoxelError,
    check_deflated,
    check_size,
    number_of_voxels,
    stored_part,
    voxel_edges,
)

META_TYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}


def open_metaimage(path: Path, layout: Layout) -> Stored:
    """MetaImage: a text header of `Key = value` lines, the data in the same file (LOCAL) or another."""
    with open(path, "rb") as file:
        header, data_start = _meta_header(path, file.read(MAX_HEADER))
    dims = _meta_numbers(path, header, "DimSize", int)
    if "NDims" in header and [len(dims)] != _meta_numbers(path, header, "NDims", int):
        raise VoxelError(
            f"{path}: DimSize has {len(dims)} numbers but NDims is {header['NDims']}; correct it"
        )
    if header.get("BinaryData", "True").lower() != "true":
        raise VoxelError(f"{path}: holds text data (BinaryData = False); save it as binary")
    if header.get("ElementNumberOfChannels", "1") != "1":
        raise VoxelError(f"{path}: has several channels; save one")
    code = META_TYPES.get(header.get("ElementType", ""))
    if code is None:
        raise VoxelError(f"{path}: ElementType '{header.get('ElementType')}' is not known; use MET_UCHAR")
    big = header.get("BinaryDataByteOrderMSB", header.get("ElementByteOrderMSB", "False")).lower() == "true"
    dtype = np.dtype((">" if big else "<") + code)
    needed = number_of_voxels(path, dims) * dtype.itemsize
    local = header["ElementDataFile"] == "LOCAL"
    data_path = path if local else path.parent / header["ElementDataFile"]
    if not data_path.is_file():
        raise VoxelError(f"{path}: its data file {data_path} does not exist; correct ElementDataFile")
    skip = data_start if local else _meta_numbers(path, header, "HeaderSize", int, [0])[0]
    there = os.path.getsize(data_path)
    compressed = header.get("CompressedData", "False").lower() == "true"
    if skip == -1 and not compressed:
        skip = there - needed
    start = max(skip, 0)
    if compressed:
        check_deflated(data_path, there - start, needed)
    else:
        check_size(data_path, needed, there - start)

    @contextmanager
    def data() -> Iterator[Readable]:
        with open(data_path, "rb") as file:
            file.seek(start)
            yield Inflated(data_path, file) if compressed else file

    key = "ElementSpacing" if "ElementSpacing" in header else "ElementSize"
    spacing = voxel_edges(_meta_numbers(path, header, key, float), len(dims), path) if key in header else None
    shape = tuple(dims[::-1])
    return Stored(shape, dtype, stored_part(data_path, data, dtype, shape), spacing, "ElementSpacing",
                  info={"format": "MetaImage", **header})


def _meta_header(path: Path, head: bytes) -> tuple[dict[str, str], int]:
    """Header as a dict, and where the data starts after its last line, ElementDataFile."""
    header: dict[str, str] = {}
    start = 0
    while start < len(head):
        end = head.find(b"\n", start)
        line = head[start : end if end >= 0 else len(head)].decode("latin-1").strip()
        start = end + 1 if end >= 0 else len(head)
        name, equals, value = line.partition("=")
        if not equals and line:
            break
        header[name.strip()] = value.strip()
        if name.strip() == "ElementDataFile":
            if not value.strip() or "\0" in value or value.strip() == "LIST" or "%" in value:
                raise VoxelError(f"{path}: ElementDataFile must name one file; join the slices")
            return header, start
    raise VoxelError(f"{path}: is not a MetaImage header (no ElementDataFile); see docs on mhd files")


def _meta_numbers(
    path: Path, header: Mapping[str, str], key: str, kind: type, default: list | None = None
) -> list:
    if key not in header and default is not None:
        return default
    try:
        return [kind(word[:40]) for word in header[key].split()[:16]]
    except (KeyError, ValueError):
        found = f"'{header[key][:40]}'" if key in header else "missing"
        raise VoxelError(f"{path}: {key} is {found}; give numbers, such as {key} = 128 128 128") from None
