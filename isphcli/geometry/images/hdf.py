"""Reads HDF5 files, one dataset by slabs (h5py)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .image import SPACING, Layout, Part, Stored, VoxelError, voxel_edges

INSTALL = "the package h5py reads HDF5 files: pip install h5py"


def open_hdf5(path: Path, layout: Layout, matlab: bool = False) -> Stored:
    """The only dataset of 2 or 3 dimensions that holds numbers, or the named one; `matlab`: its axes are in the order
    of MATLAB.

    Edges of a voxel: the attribute voxel_size (x, y, z, m) or element_size_um (z, y, x, micrometres) of it or the file.
    """
    try:
        import h5py
    except ImportError:
        raise VoxelError(f"{path}: {INSTALL}") from None
    with h5py.File(path, "r") as file:
        found = _datasets(file)
        name = layout.array
        if name is None:
            usable = [n for n, d in found.items() if d.ndim >= 2 and d.dtype.kind in "buif"]
            if len(usable) != 1:
                raise VoxelError(f"{path}: holds the datasets {list(found)[:20]}; name one with the key 'array'")
            (name,) = usable
        if name.strip("/") not in found:
            raise VoxelError(
                f"{path}: holds the datasets {list(found)[:20]}; there is no '{name}': correct the key 'array'"
            )
        data = found[name.strip("/")]
        shape, dtype = tuple(map(int, data.shape)), data.dtype
        if dtype.kind not in "buif":
            raise VoxelError(f"{path}: '{name}' holds data of type {dtype}; save integers, such as uint8")
        spacing, along = _spacing(path, data.attrs, len(shape))
        if spacing is None:
            spacing, along = _spacing(path, file.attrs, len(shape))
    dataset = name

    def part(keep: Part) -> np.ndarray:
        with h5py.File(path, "r") as file:
            values = file[dataset][keep[::-1] if matlab else keep]
        return values.transpose() if matlab else values

    return Stored(
        shape[::-1] if matlab else shape, dtype, part, spacing, along_xyz=along, info={"format": "HDF5", "array": name}
    )


def _datasets(file: Any) -> dict[str, Any]:
    import h5py

    found: dict[str, Any] = {}
    file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    return found


def _spacing(path: Path, attributes: Any, dim: int) -> tuple[tuple[float, ...] | None, bool]:
    if SPACING in attributes:
        return voxel_edges(attributes[SPACING], dim, path), True
    if "element_size_um" in attributes:
        sizes = np.ravel(np.asarray(attributes["element_size_um"], float))
        if len(sizes) in (1, dim):
            return voxel_edges(sizes[::-1] * 1e-6, dim, path), False
    return None, False
