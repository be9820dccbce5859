"""Reads npz files: one array of an archive, unpacked only as far as it is needed and as its header allows."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .image import (
    MAX_DEFLATE,
    SPACING,
    Layout,
    Stored,
    VoxelError,
    check_size,
    number_of_voxels,
    stored_part,
    voxel_edges,
)
from .npy import npy_header


def open_npz(path: Path, layout: Layout) -> Stored:
    """The array of an npz file, or the one that is named."""
    array = layout.array
    try:
        with zipfile.ZipFile(path) as archive:
            members = {
                i.filename.removesuffix(".npy"): i for i in archive.infolist() if i.filename.endswith(".npy")
            }
            names = [n for n in members if n != SPACING]
            if array is None and len(names) == 1:
                array = names[0]
            if array not in members:
                missing = "name one" if array is None else f"there is no '{array}'"
                raise VoxelError(f"{path}: holds the arrays {names[:20]}; {missing} with the key 'array'")
            member = members[array]
            shape, fortran, dtype = _header(path, archive, member)
            spacing = None
            if SPACING in members and members[SPACING].file_size < 1000:
                spacing = _spacing(path, archive, members[SPACING], len(shape))
    except VoxelError:
        raise
    except Exception as error:  # zipfile and zlib raise many kinds for broken archives
        if isinstance(error, OSError) and error.errno:
            raise
        raise VoxelError(f"{path}: is not a whole npz archive ({error}); copy or save it again") from None

    @contextmanager
    def data() -> Iterator[BinaryIO]:
        with zipfile.ZipFile(path) as archive, archive.open(member) as file:
            npy_header(path, file)  # type: ignore[arg-type]
            yield file  # type: ignore[misc]

    info = {"format": "npz", "array": array}
    return Stored(shape, dtype, stored_part(path, data, dtype, shape, fortran), spacing, along_xyz=True, info=info)


def _header(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[tuple[int, ...], bool, np.dtype]:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise VoxelError(f"{path}: is compressed in an unknown way; save it with numpy.savez_compressed")
    if member.file_size > MAX_DEFLATE * member.compress_size + 1024:
        raise VoxelError(f"{path}: is damaged (sizes disagree); copy or save it again")
    with archive.open(member) as file:
        shape, fortran, dtype = npy_header(path, file)  # type: ignore[arg-type]
        check_size(path, file.tell() + number_of_voxels(path, shape) * dtype.itemsize, member.file_size)
    return shape, fortran, dtype


def _spacing(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, dim: int) -> tuple[float, ...] | None:
    shape, _, dtype = _header(path, archive, member)
    with archive.open(member) as file:
        npy_header(path, file)  # type: ignore[arg-type]
        sizes: Any = np.frombuffer(file.read(), dtype).reshape(shape)
    return voxel_edges(sizes, dim, path) if sizes.dtype.kind in "iuf" else None
