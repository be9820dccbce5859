"""A case from an image alone: the permeability of a scan without a case file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..case.blocks import Case
from ..case.load import read_case
from ..geometry.images.image import Image, VoxelError
from ..geometry.images.read import format_of
from ..geometry.images.voxel_size import COARSE, known_spacing
from ..geometry.labels import counts_text, guess_labels
from . import memory
from .image_file import grey_image, layout_of

LABELS = "labels: {solid: 1, water: 0}"
GREY = "grey: {threshold: otsu, solid: above}"
CASE = """\
geometry:
  voxels: {{file: {file}, {values}, voxel_size: {size}}}   # m
particles: {{spacing: {spacing}}}   # m: one particle per voxel
fluids: {{water: {{density: 1000, viscosity: 1.0e-3}}}}   # kg/m3, Pa s
flow: stokes
drive: {{axes: [x]}}
"""
_SOLID = ("grey values, of which the bright ones are solid; the other way round: "
          "--set geometry.voxels.grey.solid=below")


@dataclass(frozen=True)
class FirstCase:
    """case: as it was read; text: of the equivalent case file; assumed: sentences on what the user has not given."""

    case: Case
    text: str
    assumed: tuple[str, ...]


def case_text(path: Path, values: str = LABELS, size: str = "5.0e-6", spacing: str = "5.0e-6") -> str:
    """The text of a case of an image."""
    return CASE.format(file=repr(path.name), values=values, size=size, spacing=spacing)


def first_case(path: Path, overrides: Sequence[str] = ()) -> FirstCase:
    """Steady flow of water along x through an image, one particle per voxel; overrides: key=value, as of --set.

    Of two values the higher one is solid; grey values are parted by Otsu's threshold, the bright ones solid. Raises
    VoxelError where the size of a voxel is not known or there are several labels, CaseError for wrong overrides.
    """
    case_file = path.with_suffix(".yaml")
    said = {text.partition("=")[0].strip() for text in overrides}
    # a key of `grey` or `labels` is one of the block that the case without it would have
    values = GREY if any(key.startswith("geometry.voxels.grey") for key in said) else LABELS
    asked = read_case(case_text(path, values).encode(), case_file, overrides)
    memory.refuse_image(asked)
    spec = asked.geometry.voxels
    assert spec is not None
    image = grey_image(spec.file, layout_of(spec), spec.crop)
    assumed = []
    if values == GREY:
        assumed += [] if said & {"geometry.voxels.grey", "geometry.voxels.grey.solid"} else [_SOLID]
    elif not any(key.startswith("geometry.voxels.labels") for key in said):
        values, sentence = _understood(path, image)
        assumed.append(sentence)
    if format_of(path).convention and spec.axes is None:
        assumed.append(f"the axes of the array, {' x '.join(map(str, image.whole))}, are {', '.join(image.axes)}; "
                       "others: --set geometry.voxels.axes=xyz")
    if "geometry.voxels.voxel_size" in said:
        size = tuple(np.ravel(np.asarray(spec.voxel_size, float)))
    else:
        known = known_spacing(image)
        if known is None:
            raise VoxelError(f"{path}: holds no voxel size; give it, such as --set geometry.voxels.voxel_size=5um")
        size = known
        if image.spacing_key and max(known) >= COARSE:
            given = " ".join(f"{s:g}" for s in known)
            raise VoxelError(f"{path}: its {image.spacing_key}, {given}, has no unit; say what it is, such as --set "
                             f"geometry.voxels.voxel_size={known[0]:g}um")
        if image.spacing_key:
            assumed.append(f"the voxel size by its {image.spacing_key}, which has no unit: taken as metres")
    shown = f"{size[0]!r}" if len(set(size)) == 1 else f"[{', '.join(repr(float(s)) for s in size)}]"
    text = case_text(path, values, shown.replace("np.float64(", "").replace(")", ""), repr(float(min(size))))
    if "drive.axes" not in said and not any(key.startswith("drive") for key in said):
        assumed.append("flow along x alone, between sealed sides, with clear layers before and behind the image; "
                       "others: --set 'drive.axes=[x, y, z]'")
    # there is no case file to be named
    case = read_case(text.encode(), case_file, overrides)
    case = replace(case, path=path.absolute(), places={key: at for key, at in case.places.items() if at.line is None})
    return FirstCase(case, text, tuple(assumed))


def _understood(path: Path, image: Image) -> tuple[str, str]:
    """How the values of an image are understood: (entry of the case, sentence)."""
    guess = guess_labels(image.values)
    if guess is None:
        return GREY, _SOLID
    solid, pores, shares = guess
    if len(shares) != 2 or min(shares) < 0:
        named = f"{{solid: {solid}, water: {pores}}}" if pores and min(shares) >= 0 else "{solid: 1, water: 0}"
        raise VoxelError(f"{path}: holds {counts_text(shares)}; say which are solid, such as --set "
                         f"'geometry.voxels.labels={named}'")
    pore = pores[0]
    return (f"labels: {{solid: {solid}, water: {pore}}}",
            f"voxels of value {solid} are solid ({100 * shares[solid] / image.values.size:.3g} %), those of {pore} "
            f"pore; the other way round: --set 'geometry.voxels.labels={{solid: {pore}, water: {solid}}}'")
