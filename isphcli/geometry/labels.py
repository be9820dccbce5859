"""Labels of an image: cropping, solid and fluid values, opposite faces that do not fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..domain.slabs import Slabs
from .images.image import VoxelError

FEW = 16  # values: an image of at most so many different ones holds labels, any other grey values
# Faces of voxels across an axis, over the mean of those across the others, up to which walls run straight on along it.
# Of the known bodies that are no prisms the least is 0.75, of cases/berea.yaml 0.94. A pipe of radius 5.2 voxels whose
# grey values have noise of a tenth of the step at its wall has 0.12 at the threshold, a fifth 0.48: but then noise
# spreads the wall over the voxels beside it, which hold its place again
STRAIGHT = 0.25

def crop(
    values: np.ndarray, ranges: Sequence[Sequence[int]] | None, path: str | Path = "image"
) -> np.ndarray:
    """Part [first, end) of an image along x, y(, z)."""
    if ranges is None:
        return values
    sizes = values.shape[::-1]
    if len(ranges) != values.ndim:
        raise VoxelError(
            f"{path}: crop has {len(ranges)} ranges for {values.ndim} dimensions; give one per axis"
        )
    for name, (first, end), size in zip("xyz", ranges, sizes):
        if not 0 <= first < end <= size:
            raise VoxelError(f"{path}: crop {name} [{first}, {end}) does not lie in 0 to {size}; shorten it")
    return values[tuple(slice(int(first), int(end)) for first, end in reversed(list(ranges)))]


def mirrored(values: np.ndarray, axes: Sequence[str]) -> np.ndarray:
    """An image [z, y, x] or [y, x] with its mirror image behind it along each of the named axes."""
    for name in axes:
        axis = values.ndim - 1 - "xyz".index(name)
        values = np.concatenate([values, np.flip(values, axis)], axis=axis)
    return values


class ClearLayers(NamedTuple):
    """Layers of clear fluid at both ends of an axis of an image (0 x, 1 y, 2 z), each so many `voxels` thick, > 0."""

    axis: int
    voxels: int


def with_clear_layers(values: np.ndarray, layers: ClearLayers | None, fill: float) -> np.ndarray:
    """An image [z, y, x] or [y, x] with its clear layers, of the value `fill`."""
    if layers is None:
        return values
    along, thick = values.ndim - 1 - layers.axis, layers.voxels
    widths = [(thick, thick) if a == along else (0, 0) for a in range(values.ndim)]
    return np.pad(values, widths, constant_values=fill)


def apply_labels(
    values: np.ndarray,
    labels: Mapping[str, int | Sequence[int]],
    fluids: Sequence[str],
    path: str | Path = "image",
    counts: Mapping[int, int] | None = None,
) -> np.ndarray:
    """Phases int8: -1 where the value is one of labels['solid'], k for those of fluids[k].

    Every value of the image needs a label, and every fluid with labels a voxel. counts: {value: voxels} of the image
    that the values are a part of.
    """
    found = dict(counts) if counts is not None else histogram(values)
    phase_of: dict[int, int] = {}
    for name, wanted in labels.items():
        if name != "solid" and name not in fluids:
            raise VoxelError(f"{path}: label '{name}' is neither solid nor a fluid ({', '.join(fluids)})")
        numbers = [int(v) for v in np.ravel(np.asarray(wanted))]
        if name != "solid" and not any(v in found for v in numbers):
            raise VoxelError(
                f"{path}: no voxel has the label of '{name}' {numbers}; it holds {counts_text(found)}"
            )
        phase_of.update({v: -1 if name == "solid" else fluids.index(name) for v in numbers})
    unknown = [v for v in found if v not in phase_of]
    if unknown:
        raise VoxelError(f"{path}: voxels of value {unknown[:8]} have no label; it holds {counts_text(found)}")
    phases = np.empty(values.shape, dtype=np.int8)
    for value in found:
        phases[values == value] = phase_of[value]
    return phases


def histogram(values: np.ndarray) -> dict[int, int]:
    """{value: voxels}, ascending."""
    if values.dtype.itemsize <= 2 and values.dtype.kind == "u":
        counts = np.zeros(256**values.dtype.itemsize, np.int64)
        for layer in values:  # np.bincount makes eight bytes of every voxel
            counts += np.bincount(layer.ravel(), minlength=len(counts))
        return {int(v): int(counts[v]) for v in np.flatnonzero(counts)}
    found, counts = np.unique(values, return_counts=True)
    return {int(v): int(n) for v, n in zip(found, counts)}


def counts_text(found: Mapping[int, int]) -> str:
    """'0 (12 voxels), 1 (7 voxels)', shortened."""
    text = ", ".join(f"{v} ({n} voxels)" for v, n in list(found.items())[:8])
    return text + (f" and {len(found) - 8} other values" if len(found) > 8 else "")


def unlike_next(pores: np.ndarray, axis: int, repeats: bool) -> np.ndarray:
    """Where the walls of an image have a face across an axis of its array: whether a voxel differs from the next.

    pores: bool, along any axes; repeats: the last voxel has the first for its next, otherwise none and is left out.
    """
    return pores != np.roll(pores, -1, axis) if repeats else np.diff(pores, axis=axis)


def runs_straight(faces: Sequence[float]) -> bool:
    """Whether the walls of a 3D image run straight on along an axis, as in a bundle of pipes: few of its faces lie
    across that axis. faces: (3,), how many do across each."""
    across, *others = sorted(faces)
    return across <= STRAIGHT * 0.5 * sum(others)


def faces_and_pairs(pores: np.ndarray, slabs: Slabs, around: Sequence[bool] | np.ndarray,
                    axes: Sequence[int] = (0, 1, 2)) -> tuple[int, int]:
    """(pairs of neighbours along the axes of an image of which just one is pore, all pairs of neighbours).

    pores: bool [z, y, x], the own layers of `slabs`; around: (3,) bool x, y, z, the first voxel is next to the last;
    axes: 0 z, 1 y, 2 x.
    """
    faces = pairs = 0
    for axis in axes:
        if slabs.shape[axis] > 1:
            repeats = bool(around[2 - axis])
            if axis == 0 and slabs.ranks.size > 1:
                differ = unlike_next(slabs.beside(pores, 0, 1, repeats)[0], 0, False)
            else:
                differ = unlike_next(pores, axis, repeats)
            faces += int(np.count_nonzero(differ))
            pairs += differ.size
    faces, pairs = slabs.ranks.sum(np.array([faces, pairs]))
    return int(faces), int(pairs)


def faces_that_differ(solid: np.ndarray, periodic: Sequence[bool], slabs: Slabs | None = None) -> tuple[str, ...]:
    """Sentences on the periodic axes along which an image does not go on at the opposite face.

    solid: bool [z, y, x] or [y, x]; periodic: per axis x, y(, z); slabs: how the processes share the image, of which
    each has its layers [z, y, x]; without it one process has all. Voxels differ from one layer to the next inside the
    image too; two faces are called different where they are nearer to two unrelated layers than to two neighbours.
    """
    grid = solid.reshape(-1, *solid.shape[-2:])
    slabs = slabs or Slabs.whole(grid.shape)
    cells, of_solid = slabs.ranks.sum(np.array([grid.size, np.count_nonzero(grid)]))
    share, said = float(of_solid / cells), []
    for axis, name in enumerate("xyz"[: len(periodic)]):
        if not periodic[axis] or slabs.shape[2 - axis] < 3:
            continue
        faces, pairs = faces_and_pairs(grid, slabs, (False,) * 3, [2 - axis])
        inside = faces / pairs
        across = (faces_and_pairs(grid, slabs, (True,) * 3, [2 - axis])[0] - faces) / (cells / slabs.shape[2 - axis])
        unrelated = 2.0 * share * (1.0 - share)
        if across > 0.05 and across > 0.5 * (inside + max(unrelated, inside)) and across > 1.5 * inside:
            said.append(
                f"geometry.periodic: the two faces across {name} differ in {100 * across:.0f} % of their voxels, "
                f"neighbouring layers in {100 * inside:.0f} %: the image does not repeat along {name}; leave {name} "
                "out of geometry.periodic, or name it in geometry.mirror"
            )
    return tuple(said)


class LabelGuess(NamedTuple):
    """Guess of what the values of an image are, where the user has not said: solid, pores: values; shares: {value:
    voxels} of all of them, ascending."""

    solid: int
    pores: list[int]
    shares: dict[int, int]


def guess_labels(values: np.ndarray) -> LabelGuess | None:
    """Of an image of at most `FEW` integers or bools: of two values the higher one is solid, else the most frequent
    one. None of more values and of real numbers: they are grey."""
    shares = _few_values(values)
    if shares is None:
        return None
    solid = max(shares) if len(shares) == 2 else max(shares, key=shares.__getitem__)
    return LabelGuess(solid, [value for value in shares if value != solid], shares)


def _few_values(values: np.ndarray) -> dict[int, int] | None:
    """{value: voxels}, ascending, of an image of few integers or bools, else None."""
    if values.dtype.kind == "f":
        return None
    found: dict[int, int] = {}
    for layer in values:
        for value, count in zip(*np.unique(layer, return_counts=True)):
            found[int(value)] = found.get(int(value), 0) + int(count)
        if len(found) > FEW:
            return None
    return dict(sorted(found.items()))
