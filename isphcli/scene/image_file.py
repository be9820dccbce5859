"""The image file of a case: how it is laid out, and the part of it that the case keeps, read once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.images.image import Image, Layout, as_labels
from ..geometry.images.read import image_shape, read_image

if TYPE_CHECKING:
    from ..case.blocks import Voxels

SEVERAL = (".mhd", ".nhdr", ".raw", ".bin")  # whose data or header may be in another file, which can change by itself
AT_ONCE = 1 << 28  # voxels read at once where nothing is kept: few parts, each of which may unpack the whole file
_last: list[tuple[Any, Image]] = []  # the image that was read last: a byte or two per voxel, where its walls take 40


def layout_of(spec: Voxels) -> Layout:
    """The keys of a case on the layout of its image file."""
    return Layout(spec.array, spec.axes, spec.shape, spec.dtype, spec.offset, spec.byte_order)


def image_of(spec: Voxels) -> Image:
    """The part of the image of a case that is kept, [z, y, x] or [y, x]; raises VoxelError."""
    image = grey_image(spec.file, layout_of(spec), spec.crop)
    return image if spec.grey is not None else replace(image, values=as_labels(spec.file, image.values, grey=False))


def image_by_layers(spec: Voxels) -> Iterator[np.ndarray]:
    """The values of `image_of`, some layers along the first axis after the other, of which nothing is kept; the type of
    labels is that of the layers."""
    deep, *rest = shape_of(spec)
    step = max(AT_ONCE // math.prod(rest), 1)
    for low in range(0, deep, step):
        yield image_layers(spec, low, min(low + step, deep)).values


def image_layers(spec: Voxels, first: int, end: int) -> Image:
    """The layers from `first` to before `end`, along the first axis, of what `image_of` holds."""
    start = [0, 0, 0] if spec.crop is None else [int(low) for low, _ in spec.crop]
    *rest, _ = ranges = [(low, low + n) for low, n in zip(start, reversed(shape_of(spec)))]
    low = start[len(ranges) - 1]
    return read_image(spec.file, grey=spec.grey is not None, layout=layout_of(spec),
                      crop=[*rest, (low + first, low + end)])


def shape_of(spec: Voxels) -> tuple[int, ...]:
    """Voxels [z, y, x] or [y, x] of what `image_of` holds, by the header of the file."""
    if spec.crop is not None:
        return tuple(int(end - first) for first, end in reversed(spec.crop))
    return image_shape(spec.file, layout=layout_of(spec)) or image_of(spec).values.shape


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
