"""Reads an image, or a part of it, of any known format by the suffix of its file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from .hdf import open_hdf5
from .image import (
    Image,
    Layout,
    Part,
    Stored,
    VoxelError,
    as_labels,
    check_colours,
    check_memory,
    may_be_colours,
    number_of_voxels,
    thin_axis_warning,
)
from .matlab import open_matlab
from .metaimage import open_metaimage
from .npy import open_npy
from .npz import open_npz
from .nrrd import open_nrrd
from .palabos import open_palabos
from .picture import open_picture
from .raw import open_raw
from .slices import open_slices
from .tiff import open_tiff
from .vti import open_vti
from .vtk import open_vtk

T = TypeVar("T")


@dataclass(frozen=True)
class Format:
    """open: reads the header. axes: directions of the axes of its arrays, unless the layout gives others; convention:
    whether they are only a convention, as of a plain array."""

    name: str
    open: Callable[[Path, Layout], Stored]
    axes: str = "zyx"
    convention: bool = False


FORMATS = {
    ".npy": Format("npy", open_npy, convention=True),
    ".npz": Format("npz", open_npz, convention=True),
    ".mhd": Format("MetaImage", open_metaimage),
    ".mha": Format("MetaImage", open_metaimage),
    ".tif": Format("TIFF", open_tiff),
    ".tiff": Format("TIFF", open_tiff),
    ".raw": Format("raw", open_raw, convention=True),
    ".bin": Format("raw", open_raw, convention=True),
    ".nrrd": Format("NRRD", open_nrrd),
    ".nhdr": Format("NRRD", open_nrrd),
    ".h5": Format("HDF5", open_hdf5, convention=True),
    ".hdf5": Format("HDF5", open_hdf5, convention=True),
    ".vti": Format("VTI", open_vti),
    ".vtk": Format("VTK", open_vtk),
    ".png": Format("PNG", open_picture),
    ".bmp": Format("BMP", open_picture),
    ".mat": Format("MATLAB", open_matlab, axes="yxz", convention=True),
    ".dat": Format("Palabos text", open_palabos, axes="xyz"),
}
FOLDER = Format("folder of slices", open_slices)


def format_of(path: Path) -> Format:
    """The format of a file, or of a folder of slices; raises VoxelError where it is none that is read."""
    if path.is_dir():
        return FOLDER
    known = ", ".join(suffix[1:] for suffix in FORMATS)
    if not path.is_file():
        raise VoxelError(f"{path}: no such file; give the path of an image ({known}) or of a folder of slices")
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        raise VoxelError(f"{path}: '{path.suffix}' images are not read; give {known}, or a folder of slices; "
            "a file of bare values is read as .raw")
    return found


def axes_of(path: str | Path, axes: str | None = None) -> str:
    """Directions of the axes of an array, the slowest first: as given, else as the format has them."""
    if axes is not None:
        return axes
    path = Path(path)
    return FORMATS[path.suffix.lower()].axes if not path.is_dir() and path.suffix.lower() in FORMATS else FOLDER.axes


def open_image(path: str | Path, layout: Layout | None = None) -> Stored:
    """An image whose header has been read and fits its file; its array has 2 or 3 axes."""
    path, layout = Path(path), layout or Layout()
    kind = format_of(path)
    layout = replace(layout, axes=layout.axes or kind.axes)
    stored = _clean(path, kind.name, lambda: kind.open(path, layout))
    whole = stored
    while len(stored.shape) > 3 and stored.shape[0] == 1:
        stored = replace(stored, shape=stored.shape[1:], part=_first_of(stored.part))
    if stored.dtype.kind not in "buif":
        raise VoxelError(f"{path}: holds data of type {stored.dtype}; save integers, such as uint8")
    if may_be_colours(stored.shape, stored.dtype):
        check_memory(path, number_of_voxels(path, stored.shape) * stored.dtype.itemsize)
        every = tuple(slice(0, n) for n in whole.shape)
        check_colours(path, _clean(path, kind.name, lambda: whole.part(every)).reshape(stored.shape))
    if len(stored.shape) not in (2, 3):
        raise VoxelError(f"{path}: has {len(stored.shape)} dimensions; an image has 2 or 3")
    number_of_voxels(path, stored.shape)
    return stored


def read_image(
    path: str | Path,
    array: str | None = None,
    grey: bool = False,
    layout: Layout | None = None,
    crop: Sequence[Sequence[int]] | None = None,
) -> Image:
    """Read the part `crop`, ranges [first, end) along x, y(, z), of an image, or all of it.

    Values are [z, y, x] or [y, x]: labels, integers of 0 or more in the smallest unsigned type; with `grey`, numbers of
    any type, integers or floating point (never NaN). array: as in `Layout`, where none is given. Raises VoxelError
    where the file is no such image, or a picture in colours.
    """
    path = Path(path)
    layout = layout or Layout(array=array)
    stored = open_image(path, layout)
    axes = axes_of(path, layout.axes)
    axes = axes if len(stored.shape) == 3 else axes.replace("z", "")
    keep = _kept(path, tuple(stored.shape[axes.index(a)] for a in "xyz"[: len(axes)]), crop)
    part = tuple(keep["xyz".index(a)] for a in axes)
    check_memory(path, number_of_voxels(path, [k.stop - k.start for k in part]) * stored.dtype.itemsize)
    values = _clean(path, format_of(path).name, lambda: stored.part(part))
    if values.shape != tuple(k.stop - k.start for k in part):
        raise VoxelError(f"{path}: its header says {stored.shape} voxels, and its data do not fit that; copy it again")
    values = values.transpose([axes.index(a) for a in "zyx"[3 - len(axes) :]])
    if values.dtype.byteorder not in "=|":
        values = values.astype(values.dtype.newbyteorder("="))
    values = as_labels(path, values, grey)
    spacing = stored.spacing
    if spacing is not None:
        spacing = spacing[: len(axes)]
        if not stored.along_xyz:
            spacing = tuple(spacing[len(axes) - 1 - axes.index(a)] for a in "xyz"[: len(axes)])
    return Image(
        values,
        spacing,
        stored.spacing_key,
        axes,
        stored.shape,
        stored.info,
        (*stored.warnings, *thin_axis_warning(path, stored.shape)),
    )


def image_shape(path: str | Path, array: str | None = None, layout: Layout | None = None) -> tuple[int, ...] | None:
    """Shape [z, y, x] or [y, x] by the header of an image, its values unread.

    None where the header does not tell: `read_image` then says what is wrong.
    """
    layout = layout or Layout(array=array)
    try:
        shape = open_image(path, layout).shape
    except VoxelError:
        return None
    axes = axes_of(path, layout.axes)
    axes = axes if len(shape) == 3 else axes.replace("z", "")
    return tuple(shape[axes.index(a)] for a in "zyx"[3 - len(axes) :])


def _kept(path: Path, sizes: tuple[int, ...], ranges: Sequence[Sequence[int]] | None) -> tuple[slice, ...]:
    """The ranges along x, y(, z) that are kept of an image of `sizes`; raises VoxelError where they do not fit."""
    if ranges is None:
        return tuple(slice(0, n) for n in sizes)
    if len(ranges) != len(sizes):
        raise VoxelError(f"{path}: crop has {len(ranges)} ranges for {len(sizes)} dimensions; give one per axis")
    for name, (first, end), size in zip("xyz", ranges, sizes):
        if not 0 <= first < end <= size:
            raise VoxelError(f"{path}: crop {name} [{first}, {end}) does not lie in 0 to {size}; shorten it")
    return tuple(slice(int(first), int(end)) for first, end in ranges)


def _first_of(part: Callable[[Part], np.ndarray]) -> Callable[[Part], np.ndarray]:
    return lambda keep: part((slice(0, 1), *keep))[0]


def _clean(path: Path, name: str, function: Callable[[], T]) -> T:
    """The result of a function; any error that a library raises for damaged bytes becomes a VoxelError."""
    try:
        return function()
    except (VoxelError, MemoryError):
        raise
    except OSError as error:
        if error.errno:
            raise VoxelError(f"{path}: cannot be read ({error.strerror or error}); check the file") from None
        raise VoxelError(f"{path}: is no whole {name} file ({error}); copy or save it again") from None
    except Exception as error:
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise VoxelError(f"{path}: is no whole {name} file ({said}); copy or save it again") from None
