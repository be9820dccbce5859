"""Whether a published permeability is of what a case runs: of the same part of an image, its voxels and axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..case import forcing
from ..case.blocks import AXES
from ..geometry.images.read import image_shape
from ..scene.image_file import layout_of

if TYPE_CHECKING:
    from ..case.blocks import Case, Voxels
    from ..geometry.protocol import Geometry

Ranges = tuple[tuple[int, int], ...]


def other_sample(case: Case, geometry: Geometry) -> str | None:
    """Why the permeability of `reference` cannot be compared with that of a case, a sentence; None where it can.

    geometry: of the case, whose voxels have their size (m) by the case or by the file.
    """
    reference, spec = case.reference, case.geometry.voxels
    if reference is None or reference.kind != "permeability":
        return None
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


def _whole(spec: Voxels) -> Ranges | None:
    """Ranges of the whole image by its header, None where that does not tell."""
    shape = image_shape(spec.file, layout=layout_of(spec))
    return None if shape is None else tuple((0, int(n)) for n in shape[::-1])


def _in_words(ranges: Ranges | None) -> str:
    return "the whole image" if ranges is None else "voxels " + " x ".join(f"{first}:{end}" for first, end in ranges)


def _sizes(edges: np.ndarray) -> str:
    return " x ".join(f"{edge:g}" for edge in dict.fromkeys(edges.tolist()))
