"""Reads a folder of slices: TIFF, PNG or BMP files in the order of the numbers in their names."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np

from .image import Layout, Part, Stored, VoxelError
from .picture import open_picture
from .tiff import open_tiff

OPENERS = {".tif": open_tiff, ".tiff": open_tiff, ".png": open_picture, ".bmp": open_picture}


def open_slices(folder: Path, layout: Layout) -> Stored:
    """The pictures of a folder as one image [z, y, x]; all of one format, size and type."""
    files = sorted(
        (f for f in folder.iterdir() if f.suffix.lower() in OPENERS and not f.name.startswith(".")), key=_order
    )
    if not files:
        raise VoxelError(f"{folder}: is a folder without slices (tif, png or bmp)")
    kinds = sorted({f.suffix.lower() for f in files})
    if len({OPENERS[kind] for kind in kinds}) > 1 or len(kinds) > 1:
        raise VoxelError(f"{folder}: holds slices of the kinds {', '.join(kinds)}; leave one kind in the folder")
    first = _slice(files[0])
    if len(first.shape) != 2:
        raise VoxelError(f"{files[0]}: is no single slice but an array {first.shape}; name it in place of its folder")

    def part(keep: Part) -> np.ndarray:
        values = np.empty([k.stop - k.start for k in keep], first.dtype.newbyteorder("="))
        for k, file in enumerate(files[keep[0]]):
            one = _slice(file)
            if one.shape != first.shape or one.dtype != first.dtype:
                raise VoxelError(
                    f"{file}: is a slice of {one.shape[::-1]} {one.dtype}, {files[0].name} one of "
                    f"{first.shape[::-1]} {first.dtype}; leave slices of one size and type in the folder"
                )
            values[k] = one.part(keep[1:])
        return values

    info = {"format": f"folder of {kinds[0][1:]} slices", "slices": len(files)}
    return Stored((len(files), *first.shape), first.dtype, part, info=info, warnings=(*first.warnings, *_gaps(files)))


def _slice(file: Path) -> Stored:
    try:
        return OPENERS[file.suffix.lower()](file, Layout())
    except VoxelError:
        raise
    except Exception as error:  # any error that the libraries raise for damaged bytes
        raise VoxelError(f"{file}: is no whole picture ({error}); copy it again") from None


def _order(file: Path) -> list[tuple[int, str]]:
    """Numbers in a name count as numbers: slice_2 comes before slice_10."""
    return [(int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"(\d+)", file.name)]


def _gaps(files: list[Path]) -> tuple[str, ...]:
    numbers = [int(found[-1]) for f in files if (found := re.findall(r"\d+", f.stem))]
    if len(numbers) < len(files):
        return ()
    missing = [a + 1 for a, b in itertools.pairwise(numbers) if b > a + 1]
    if not missing or len(missing) > 0.5 * len(files):  # numbered in steps
        return ()
    return (
        f"{files[0].parent.name}: slice {missing[0]}{' and others are' * (len(missing) > 1) or ' is'} missing; those "
        "around are taken for neighbours",
    )
