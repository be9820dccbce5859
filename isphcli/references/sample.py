"""Whether a reference belongs to the sample of a case: the geometry that it names, and for a permeability the part of
the image, its voxels and axes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case import forcing
from ..case.blocks import AXES, plain
from ..geometry.images.read import image_shape
from ..scene.image_file import layout_of

if TYPE_CHECKING:
    from ..case.blocks import Case, Voxels
    from ..geometry.protocol import Geometry

Ranges = tuple[tuple[int, int], ...]


def other_geometry(case: Case) -> str | None:
    """A sentence on the values of the case that differ from `reference.geometry`; None where none do."""
    assert case.reference is not None
    for name, of, run in _named(plain(case.reference.geometry), plain(case.geometry), "geometry"):
        if not _same(of, run):
            return f"it is of {name} {_shown(of)}, this run has {_shown(run)}"
    return None


def other_sample(case: Case, geometry: Geometry) -> str | None:
    """Why `reference` cannot be compared with a run of the case, a sentence; None where it can.

    geometry: of the case, whose voxels have their size (m) by the case or by the file.
    """
    reference, spec = case.reference, case.geometry.voxels
    if reference is None:
        return None
    other = other_geometry(case)
    if other is not None or reference.kind != "permeability":
        return other
    driven = [AXES[axis] for axis in forcing.driven_axes(case, geometry.upper - geometry.lower)]
    if reference.axes is not None and driven and not set(driven) & set(reference.axes):
        return f"the value is of flow along {', '.join(reference.axes)}, this run of flow along {', '.join(driven)}"
    if spec is None:
        return None
    whole = _whole(spec)
    of, run = reference.crop or whole, spec.crop or whole
    if of != run:
        return f"the value is of {_in_words(of)}, this run of {_in_words(run)}"
    if reference.voxel_size is not None:
        dim = len(geometry.voxel_size)  # type: ignore[arg-type]
        of_size, size = (np.broadcast_to(edges, dim) for edges in (reference.voxel_size, geometry.voxel_size))  # type: ignore[arg-type]
        if not np.allclose(of_size, size, rtol=1e-6):
            return f"the value is of voxels of {_sizes(of_size)} m, this run has voxels of {_sizes(size)} m"
    return None


def _named(part: dict[str, Any], block: dict[str, Any], path: str) -> Iterator[tuple[str, Any, Any]]:
    """(dotted name, value, value in the block or None) of every key of a part of a block."""
    for name, value in part.items():
        there = block.get(name)
        if isinstance(value, dict):
            yield from _named(value, there if isinstance(there, dict) else {}, f"{path}.{name}")
        else:
            yield f"{path}.{name}", value, there


def _same(one: Any, other: Any) -> bool:
    """Whether two values of a key are the same, numbers up to rounding of typed digits, words in any order."""
    if isinstance(one, list) and isinstance(other, list):
        if all(isinstance(entry, str) for entry in one + other):
            return sorted(one) == sorted(other)
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-6)
    return bool(one == other)


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _whole(spec: Voxels) -> Ranges | None:
    """Ranges of the whole image by its header, None where that does not tell."""
    shape = image_shape(spec.file, layout=layout_of(spec))
    return None if shape is None else tuple((0, int(n)) for n in shape[::-1])


def _in_words(ranges: Ranges | None) -> str:
    return "the whole image" if ranges is None else "voxels " + " x ".join(f"{first}:{end}" for first, end in ranges)


def _sizes(edges: np.ndarray) -> str:
    return " x ".join(f"{edge:g}" for edge in dict.fromkeys(edges.tolist()))
