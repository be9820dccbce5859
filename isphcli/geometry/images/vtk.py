"""Reads image data of legacy VTK files: STRUCTURED_POINTS in text or binary."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .image import Layout, Part, Stored, VoxelError, check_memory, number_of_voxels, stored_part, voxel_edges

TYPES = {"char": "i1", "signed_char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2", "int": "i4",
         "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "vtktypeint64": "i8", "vtktypeuint64": "u8",
         "float": "f4", "double": "f8"}  # fmt: skip
MOST_LINES = 1000  # of headers in front of the data of an array


@dataclass(frozen=True)
class _Array:
    """Where the numbers of an array begin in the file, behind the line that names it."""

    name: str
    kind: str
    components: int
    count: int
    start: int


def open_vtk(path: Path, layout: Layout) -> Stored:
    """The first array of one number per point or cell of STRUCTURED_POINTS, or the named one."""
    with open(path, "rb") as file:
        if not file.readline(256).startswith(b"# vtk DataFile"):
            raise VoxelError(
                f"{path}: is no VTK file (its first line should be '# vtk DataFile Version'); save it again"
            )
        file.readline(512)
        text = file.readline(64).split() == [b"ASCII"]
        header = _header(path, file)
        arrays = list(_arrays(path, file, header, text))
    usable = [a for a in arrays if a.components == 1 and layout.array in (None, a.name)]
    if not usable or (len(usable) > 1 and layout.array is None):
        missing = "name one" if layout.array is None else f"there is no '{layout.array}'"
        raise VoxelError(f"{path}: holds the arrays {[a.name for a in arrays][:20]}; {missing} with the key 'array'")
    found = usable[0]
    points = [int(n) for n in header["DIMENSIONS"]]
    cells = [max(n - 1, 1) for n in points]
    counts = points if number_of_voxels(path, points) == found.count else cells
    shape = tuple(counts[::-1]) if counts[2] > 1 else tuple(counts[1::-1])
    if number_of_voxels(path, shape) != found.count:
        raise VoxelError(f"{path}: '{found.name}' has {found.count} values for {points} points; save it again")
    dtype = np.dtype(">" + TYPES[found.kind])
    edges = header.get("SPACING", header.get("ASPECT_RATIO", ["1", "1", "1"]))
    spacing = voxel_edges([float(n) for n in edges][: len(shape)], len(shape), path)
    if not text and found.start + found.count * dtype.itemsize > os.path.getsize(path):
        raise VoxelError(f"{path}: is truncated; copy it again")

    @contextmanager
    def data() -> Iterator[BinaryIO]:
        with open(path, "rb") as stream:
            stream.seek(found.start)
            yield stream

    def of_text(keep: Part) -> np.ndarray:
        check_memory(path, 8 * found.count)
        with open(path, "rb") as stream:
            stream.seek(found.start)
            words = stream.read().split(maxsplit=found.count)[: found.count]
        if len(words) < found.count:
            raise VoxelError(f"{path}: is truncated: {len(words)} numbers of {found.count}; copy it again")
        try:
            values = np.array(words).astype(float)
        except ValueError:
            raise VoxelError(f"{path}: holds words among the numbers of '{found.name}'; save it again") from None
        return values.astype(dtype).reshape(shape)[keep]

    part = of_text if text else stored_part(path, data, dtype, shape)
    return Stored(shape, dtype, part, spacing, "SPACING", info={"format": "VTK", "array": found.name})


def _header(path: Path, file: BinaryIO) -> dict[str, list[str]]:
    header: dict[str, list[str]] = {}
    for _ in range(MOST_LINES):
        where = file.tell()
        words = file.readline(512).decode("latin-1").split()
        if words and words[0] in ("POINT_DATA", "CELL_DATA"):
            file.seek(where)
            break
        if words:
            header[words[0].upper()] = words[1:]
    if header.get("DATASET") != ["STRUCTURED_POINTS"] or len(header.get("DIMENSIONS", [])) != 3:
        raise VoxelError(
            f"{path}: holds no image (DATASET {' '.join(header.get('DATASET', ['missing']))}); save it as "
            "STRUCTURED_POINTS"
        )
    return header


def _arrays(path: Path, file: BinaryIO, header: dict[str, list[str]], text: bool) -> Iterator[_Array]:
    """The arrays of a file; their numbers are skipped."""
    count = 0
    for _ in range(MOST_LINES):
        line = file.readline(512)
        if not line:
            return
        words = line.decode("latin-1").split()
        if len(words) == 2 and words[0] in ("POINT_DATA", "CELL_DATA"):
            count = int(words[1])
        elif len(words) in (3, 4) and words[0] == "SCALARS":
            table = file.readline(512)  # LOOKUP_TABLE
            if not table.startswith(b"LOOKUP_TABLE"):
                raise VoxelError(f"{path}: has no LOOKUP_TABLE behind SCALARS; save it again")
            yield _passed(path, file, words[1], words[2], int(words[3]) if len(words) == 4 else 1, count, text)
        elif len(words) == 4 and words[2].isdigit() and words[3].lower() in TYPES:  # of a FIELD
            yield _passed(path, file, words[0], words[3], int(words[1]), int(words[2]), text)
        elif words and words[0] not in ("FIELD", "METADATA", "LOOKUP_TABLE", "INFORMATION", "NAME", "DATA"):
            return  # vectors and others, which are no images


def _passed(path: Path, file: BinaryIO, name: str, kind: str, components: int, count: int, text: bool) -> _Array:
    if kind.lower() not in TYPES:
        raise VoxelError(f"{path}: '{name}' is of the type '{kind}', which is not known; save it as unsigned_char")
    found = _Array(name, kind.lower(), components, count, file.tell())
    left = components * count
    if not text:
        file.seek(left * np.dtype(TYPES[found.kind]).itemsize, os.SEEK_CUR)
        return found
    while left > 0 and (line := file.readline()):
        left -= len(line.split())
    return found
