"""The image file of a case: how it is laid out, and the part of it that the case keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..geometry.images.image import Image, Layout
from ..geometry.images.read import read_image

if TYPE_CHECKING:
    from ..case.blocks import Voxels


def layout_of(spec: Voxels) -> Layout:
    """What a case says of its file beside the path."""
    return Layout(spec.array, spec.axes, spec.shape, spec.dtype, spec.offset, spec.byte_order)


def image_of(spec: Voxels) -> Image:
    """The part of the image of a case that is kept, [z, y, x] or [y, x]; raises VoxelError."""
    return read_image(spec.file, grey=spec.grey is not None, layout=layout_of(spec), crop=spec.crop)
