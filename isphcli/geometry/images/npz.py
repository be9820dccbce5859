"""Reads npz files: one array of an archive, unpacked only as far as its header allows."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from .image import MAX_DEFLATE, SPACING, VoxelError, _sizes
from .npy import _read_npy


def _read_npz(path: Path, array: str | None) -> tuple[np.ndarray, tuple | None, dict]:
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
            values = _read_member(path, archive, members[array])
            spacing = None
            if SPACING in members and members[SPACING].file_size < 1000:
                sizes = _read_member(path, archive, members[SPACING])
                spacing = _sizes(sizes, values.ndim, path) if sizes.dtype.kind in "iuf" else None
    except VoxelError:
        raise
    except Exception as error:  # zipfile and zlib raise many kinds for broken archives
        if isinstance(error, OSError) and error.errno:
            raise
        raise VoxelError(f"{path}: is not a whole npz archive ({error}); copy or save it again") from None
    return values, spacing, {"format": "npz", "array": array}


def _read_member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise VoxelError(f"{path}: is compressed in an unknown way; save it with numpy.savez_compressed")
    if member.file_size > MAX_DEFLATE * member.compress_size + 1024:
        raise VoxelError(f"{path}: is damaged (sizes disagree); copy or save it again")
    with archive.open(member) as file:
        return _read_npy(path, file, member.file_size)  # type: ignore[arg-type]
