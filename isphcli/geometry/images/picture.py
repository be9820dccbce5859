"""Reads single pictures, PNG and BMP: slices and thin sections (Pillow)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .image import Layout, Part, Stored, VoxelError, one_grey

TYPES = {"1": "?", "L": "u1", "P": "u1", "I;16": "<u2", "I;16B": ">u2", "I": "i4", "F": "f4"}  # by Pillow's modes
CHANNELS = {"LA": 2, "RGB": 3, "RGBA": 4, "PA": 2}


def open_picture(path: Path, layout: Layout) -> Stored:
    """A picture [y, x]; of a palette its indices. Of channels that all hold the same grey one is taken."""
    from PIL import Image as Pillow

    Pillow.MAX_IMAGE_PIXELS = None  # the size is checked against the memory
    with Pillow.open(path) as picture:
        width, height = picture.size
        mode = picture.mode
    if mode not in TYPES and mode not in CHANNELS:
        raise VoxelError(f"{path}: is a picture of kind {mode}; save it as grey values")
    note: tuple[str, ...] = ()
    if mode in CHANNELS:
        note = (f"{path.name}: has {CHANNELS[mode]} channels that hold the same grey; one of them is taken",)

    def part(keep: Part) -> np.ndarray:
        with Pillow.open(path) as picture:
            values = np.asarray(picture)
        return (values if mode in TYPES else one_grey(path, values))[keep]

    return Stored(
        (height, width), np.dtype(TYPES.get(mode, "u1")), part, info={"format": path.suffix[1:].upper()}, warnings=note
    )
