"""The image file of a case: how it is laid out, and the part of it that the case keeps, read once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..geometry.images.image import Image, Layout, as_labels
from ..geometry.images.read import read_image

if TYPE_CHECKING:
    from ..case.blocks import Voxels

SEVERAL = (".mhd", ".nhdr", ".raw", ".bin")  # whose data or header may be in another file, which can change by itself
_last: list[tuple[Any, Image]] = []  # the image that was read last: a byte or two per voxel, where its walls take 40


def layout_of(spec: Voxels) -> Layout:
    """The keys of a case on the layout of its image file."""
    return Layout(spec.array, spec.axes, spec.shape, spec.dtype, spec.offset, spec.byte_order)


def image_of(spec: Voxels) -> Image:
    """The part of the image of a case that is kept, [z, y, x] or [y, x]; raises VoxelError."""
    image = grey_image(spec.file, layout_of(spec), spec.crop)
    return image if spec.grey is not None else replace(image, values=as_labels(spec.file, image.values, grey=False))


def grey_image(path: Path, layout: Layout, crop: Sequence[Sequence[int]] | None) -> Image:
    """A part of an image with the values of its file, which are read-only; the last one is kept."""
    known = _identity(path)
    key = None if known is None else (known, layout, crop)
    if key is not None and _last and _last[0][0] == key:
        return _last[0][1]
    _last.clear()  # frees the last image before the next one is read
    image = read_image(path, grey=True, layout=layout, crop=crop)
    image.values.flags.writeable = False
    if key is not None:
        _last.append((key, image))
    return image


def _identity(path: Path) -> tuple[Any, ...] | None:
    """A value that changes whenever the file does; None where its data may lie in another file."""
    if not path.is_file() or path.suffix.lower() in SEVERAL:
        return None
    found = path.stat()
    return path, found.st_mtime_ns, found.st_size, found.st_ino
