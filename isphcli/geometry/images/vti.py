"""Reads VTK image data in XML (vti): arrays in text, base64 or appended, compressed with zlib or not."""

from __future__ import annotations

import base64
import os
import re
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .image import Layout, Part, Stored, VoxelError, number_of_voxels, stored_part, voxel_edges

TYPES = {"Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
         "UInt64": "u8", "Float32": "f4", "Float64": "f8"}  # fmt: skip
PIECE = 2**20  # bytes in which the beginning of appended data is looked for
MOST_XML = 2**31  # bytes of XML, arrays in it included, that are parsed
MOST_BLOCKS = 2**24  # of a compressed array


def open_vti(path: Path, layout: Layout) -> Stored:
    """The only array of one number per point or cell, or the named one."""
    text, start = _xml(path)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise VoxelError(f"{path}: is no whole VTK file ({error}); copy or save it again") from None
    grid = root.find("ImageData")
    pieces = [] if grid is None else grid.findall("Piece")
    if grid is None or len(pieces) != 1:
        raise VoxelError(f"{path}: holds no image data in one piece (type '{root.get('type')}'); save it as ImageData")
    name, data, per_cell = _chosen(path, pieces[0], layout.array)
    extent = [int(n) for n in str(pieces[0].get("Extent", grid.get("WholeExtent"))).split()]
    if len(extent) != 6:
        raise VoxelError(f"{path}: its extent '{pieces[0].get('Extent')}' is no range along x, y, z; save it again")
    counts = [max(b - a + (0 if per_cell else 1), 1) for a, b in zip(extent[::2], extent[1::2])]
    shape = tuple(counts[::-1]) if counts[2] > 1 else tuple(counts[1::-1])
    code = TYPES.get(str(data.get("type")))
    if code is None:
        raise VoxelError(f"{path}: '{name}' is of the type '{data.get('type')}', which is not known; save it as UInt8")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    dtype = np.dtype(order + code)
    needed = number_of_voxels(path, shape) * dtype.itemsize
    length = np.dtype(order + ("u8" if root.get("header_type") == "UInt64" else "u4"))
    spacing = voxel_edges([float(n) for n in str(grid.get("Spacing", "1 1 1")).split()][: len(shape)], len(shape), path)
    packed = root.get("compressor")
    if packed not in (None, "vtkZLibDataCompressor"):
        raise VoxelError(f"{path}: is compressed by {packed}; save it with zlib or without compression")
    kind = data.get("format")
    source = _Source(path, dtype, shape, needed, length, packed is not None)
    if kind == "ascii":
        part = source.of_text(data.text or "")
    elif kind == "binary":
        part = source.of_base64("".join((data.text or "").split()).encode())
    elif kind == "appended" and start is not None:
        appended, offset = root.find("AppendedData"), int(data.get("offset", "0"))
        if appended is not None and appended.get("encoding") == "base64":
            with open(path, "rb") as file:
                file.seek(start + offset)
                part = source.of_base64(b"".join(file.read().partition(b"<")[0].split()))
        else:
            part = source.of_raw(start + offset)
    else:
        raise VoxelError(f"{path}: the data of '{name}' are stored as '{kind}', which is not known; save it again")
    return Stored(shape, dtype, part, spacing, "Spacing", info={"format": "VTI", "array": name})


def _xml(path: Path) -> tuple[bytes, int | None]:
    """The XML without appended data, and the offset of these data in the file, behind the underscore."""
    found = b""
    with open(path, "rb") as file:
        while len(found) < MOST_XML and (more := file.read(PIECE)):
            at = max(len(found) - 20, 0)
            found += more
            if (place := found.find(b"<AppendedData", at)) >= 0:
                found += file.read(PIECE)
                mark = found.find(b"_", found.find(b">", place))
                if mark < 0:
                    raise VoxelError(f"{path}: is truncated before its data; copy it again")
                tag = found[place : found.find(b">", place) + 1]
                text = found[:place] + tag.rstrip(b"/>") + b"/></VTKFile>"
                return _harmless(path, text), mark + 1
    return _harmless(path, found), None


def _harmless(path: Path, text: bytes) -> bytes:
    if re.search(rb"<!(DOCTYPE|ENTITY)", text[:PIECE]):
        raise VoxelError(f"{path}: declares a document type, which no VTK file does; save it again")
    return text


def _chosen(path: Path, piece: ElementTree.Element, name: str | None) -> tuple[str, ElementTree.Element, bool]:
    """(name, element, whether it has a value per cell and not per point) of the named array, or of the only one."""
    found = [
        (str(a.get("Name")), a, group == "CellData")
        for group in ("PointData", "CellData")
        for a in piece.findall(f"{group}/DataArray")
    ]
    named = [
        one for one in found if (one[0] == name if name is not None else one[1].get("NumberOfComponents", "1") == "1")
    ]
    if name is None:
        marked = [g.get("Scalars") for g in piece if g.get("Scalars")]
        named = [one for one in named if one[0] in marked] if len(named) > 1 and len(marked) == 1 else named
    if len(named) != 1:
        missing = "name one" if name is None else f"there is no '{name}'"
        raise VoxelError(f"{path}: holds the arrays {[one[0] for one in found][:20]}; {missing} with the key 'array'")
    if named[0][1].get("NumberOfComponents", "1") != "1":
        raise VoxelError(f"{path}: '{named[0][0]}' has several components; name an array of one number per voxel")
    return named[0]


class _Source:
    """Readers of an array in each encoding: text, base64 and raw bytes."""

    def __init__(
        self, path: Path, dtype: np.dtype, shape: tuple[int, ...], needed: int, length: np.dtype, packed: bool
    ):
        self.path, self.dtype, self.shape, self.needed, self.length, self.packed = (
            path,
            dtype,
            shape,
            needed,
            length,
            packed,
        )

    def of_text(self, text: str) -> Callable[[Part], np.ndarray]:
        """Reader of numbers as text, separated by blanks."""
        words = text.split()
        if len(words) * self.dtype.itemsize != self.needed:
            raise VoxelError(f"{self.path}: holds {len(words)} numbers for {self.shape[::-1]} voxels; save it again")
        return lambda keep: np.array(words).astype(float).astype(self.dtype).reshape(self.shape)[keep]

    def of_base64(self, text: bytes) -> Callable[[Part], np.ndarray]:
        """Reader of base64, in which length and data are encoded separately or together."""

        def part(keep: Part) -> np.ndarray:
            size = self.length.itemsize
            if self.packed:
                blocks = int(np.frombuffer(_decoded(text, 0, size), self.length)[0])
                if blocks > MOST_BLOCKS:
                    raise VoxelError(f"{self.path}: says that it has {blocks} blocks; copy it again")
                head = np.frombuffer(_decoded(text, 0, (3 + blocks) * size), self.length)
                data = _decoded(text, _encoded((3 + blocks) * size), int(head[3:].sum()))
                return self._shaped(self._inflated(head, data))[keep]
            apart = text[_encoded(size) - 1 : _encoded(size)] == b"="
            data = (
                _decoded(text, _encoded(size), self.needed) if apart else _decoded(text, 0, size + self.needed)[size:]
            )
            return self._shaped(data)[keep]

        return part

    def of_raw(self, start: int) -> Callable[[Part], np.ndarray]:
        """Reader of bytes from an offset in the file on, which begin with their length."""
        size, there = self.length.itemsize, os.path.getsize(self.path)
        if not self.packed:
            if start + size + self.needed > there:
                raise VoxelError(f"{self.path}: is truncated; copy it again")

            @contextmanager
            def data() -> Iterator[BinaryIO]:
                with open(self.path, "rb") as file:
                    file.seek(start + size)
                    yield file

            return stored_part(self.path, data, self.dtype, self.shape)

        def part(keep: Part) -> np.ndarray:
            with open(self.path, "rb") as file:
                file.seek(start)
                blocks = int(np.frombuffer(file.read(size), self.length)[0])
                if blocks * size > there:
                    raise VoxelError(f"{self.path}: says that it has {blocks} blocks; copy it again")
                file.seek(start)
                head = np.frombuffer(file.read((3 + blocks) * size), self.length)
                return self._shaped(self._inflated(head, file.read(min(int(head[3:].sum()), there))))[keep]

        return part

    def _inflated(self, head: np.ndarray, data: bytes) -> bytes:
        """Blocks of a compressed array: [number, bytes of each, bytes of the last, compressed bytes of each]."""
        found, at = bytearray(), 0
        try:
            for count in head[3:]:
                inflater = zlib.decompressobj()
                found += inflater.decompress(data[at : at + int(count)], self.needed - len(found) + 1)
                at += int(count)
        except zlib.error as error:
            raise VoxelError(f"{self.path}: compressed data is damaged ({error}); copy it again") from None
        return bytes(found)

    def _shaped(self, data: bytes) -> np.ndarray:
        if len(data) != self.needed:
            raise VoxelError(f"{self.path}: is truncated: {len(data)} bytes of {self.needed}; copy it again")
        return np.frombuffer(data, self.dtype).reshape(self.shape)


def _encoded(count: int) -> int:
    """Characters of base64 of so many bytes."""
    return 4 * -(-count // 3)


def _decoded(text: bytes, start: int, count: int) -> bytes:
    return base64.b64decode(text[start : start + _encoded(count)])[:count]
