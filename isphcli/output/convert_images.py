"""Writes images, and converts them: crop, threshold, relabel, coarsen (`isph convert-voxels`)."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.connectivity import report
from ..geometry.images.image import SPACING, VoxelError, _sizes, _smallest
from ..geometry.images.metaimage import META_TYPES
from ..geometry.images.read import read_image
from ..geometry.images.voxel_size import known_spacing, voxel_size_of
from ..geometry.labels import _counts, _histogram, crop
from .files import replacing


def write_image(path: str | Path, values: np.ndarray, spacing: Sequence[float] | None = None) -> None:
    """Write an npy, npz, mhd (with a raw file) or mha file; spacing (x, y(, z)) is kept, but not by npy.

    Each file appears whole or not at all, the raw file before the mhd that names it. What is there is replaced.
    """
    path, values = Path(path), np.ascontiguousarray(values)
    suffix = path.suffix.lower()
    if values.dtype == bool:
        values = values.astype(np.uint8)
    if suffix not in (".npy", ".npz", ".mhd", ".mha"):
        raise VoxelError(f"{path}: '{path.suffix}' images are not written; give npy, npz, mhd or mha")
    try:
        if suffix == ".npy":
            with replacing(path) as temporary, open(temporary, "wb") as file:
                np.save(file, values, allow_pickle=False)
        elif suffix == ".npz":
            extra: dict[str, Any] = {} if spacing is None else {SPACING: np.asarray(spacing, dtype=float)}
            with replacing(path) as temporary, open(temporary, "wb") as file:
                np.savez_compressed(file, image=values, **extra)
        else:
            _write_meta(path, values, spacing)
    except OSError as error:
        raise VoxelError(f"{path}: cannot be written ({error.strerror or error}); check the folder") from None


def convert(
    source: str | Path,
    target: str | Path,
    threshold: float | None = None,
    invert: bool = False,
    crop_to: Sequence[Sequence[int]] | None = None,
    labels: Mapping[int, int] | None = None,
    solid: int | Sequence[int] = 1,
    downsample: int = 1,
    voxel_size: float | Sequence[float] | None = None,
    array: str | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Read, crop, threshold, relabel, coarsen and write an image; returns what it holds.

    crop_to: ranges along x, y(, z). threshold: a grey value >= threshold is solid (1), the rest pore (0);
    invert turns that round. labels: {old value: new value}. solid: values that are solid afterwards.
    downsample: edge of the blocks that become one voxel, solid if more than half is, then the most frequent
    value; incomplete blocks at the upper ends are cut off. voxel_size: m, of the source image, where its file
    has none or a wrong one. force: replace the target (an mhd: its raw file too) where it exists.

    Raises VoxelError; nothing was written then. The source is never written over.
    """
    if Path(source).exists():
        _refuse_input(source, None, target)
    _refuse_existing(target, force)
    image = read_image(source, array, grey=threshold is not None)
    _refuse_input(source, image.info.get("ElementDataFile"), target)
    values = crop(image.values, crop_to, source)
    if threshold is not None:
        values = ((values >= threshold) != invert).astype(np.uint8)
    values = _relabelled(values, labels or {}, source)
    solids = sorted({int(v) for v in np.ravel(np.asarray(solid))})
    spacing, whence, notes = known_spacing(image), "", image.warnings
    if voxel_size is not None or spacing is not None:
        given = None if voxel_size is None else _sizes(voxel_size, values.ndim, source)
        edges, whence, more = voxel_size_of(image, given, source)
        spacing, notes = tuple(float(s) for s in edges), notes + more
    values = _coarsened(values, int(downsample), solids, source)
    if spacing is not None:
        spacing = tuple(s * int(downsample) for s in spacing)
    write_image(target, values, spacing)
    fluid = ~np.isin(values, solids)
    cell = 1.0 if spacing is None else float(np.prod(spacing[: values.ndim]))
    found = report(fluid, (False,) * values.ndim, cell)
    axes = "xyz"[: values.ndim]
    rule = f"grey {'<' if invert else '>='} {threshold} is solid"
    return {
        "file": str(target),
        "shape": dict(zip(axes, values.shape[::-1])),
        "voxel_size": spacing,
        "voxel_size_from": whence,
        "warnings": notes,
        **({"threshold": rule} if threshold is not None else {}),
        "solid": solids,
        **asdict(found),
        "percolates": dict(zip(axes, found.percolates)),
        "percolating_porosity": dict(zip(axes, found.percolating_porosity)),
        "labels": _histogram(values),
    }


def _relabelled(values: np.ndarray, labels: Mapping[int, int], path: str | Path) -> np.ndarray:
    if not labels:
        return values
    found = _histogram(values)
    absent = [v for v in labels if v not in found]
    if absent:
        raise VoxelError(f"{path}: no voxel has the value {absent}; it holds {_counts(found)}")
    if min(labels.values()) < 0 or max(labels.values()) > 255:
        raise VoxelError(f"{path}: new labels {sorted(labels.values())} must lie in 0 to 255")
    result = values.copy()
    for old, new in labels.items():
        result[values == old] = new
    return _smallest(result)


def _coarsened(values: np.ndarray, block: int, solids: Sequence[int], path: str | Path) -> np.ndarray:
    if block == 1:
        return values
    if block < 1 or min(values.shape) < block:
        raise VoxelError(
            f"{path}: downsample {block} must be from 1 to the smallest side {min(values.shape)}"
        )
    found = list(_histogram(values))
    if len(found) > 64:
        raise VoxelError(f"{path}: {len(found)} values are too many labels to downsample; give a threshold")
    shape = tuple(n // block for n in values.shape)
    values = values[tuple(slice(n * block) for n in shape)]
    blocks = values.reshape([n for pair in zip(shape, [block] * len(shape)) for n in pair])
    within = tuple(range(1, 2 * len(shape), 2))
    n_solid = np.zeros(shape, dtype=np.int64)
    most = np.full((2, *shape), -1, dtype=np.int64)  # voxels of the most frequent fluid and solid value
    value_of = np.zeros((2, *shape), dtype=values.dtype)
    for value in found:
        count = (blocks == value).sum(axis=within)
        kind = int(value in solids)
        n_solid += count * kind
        value_of[kind][count > most[kind]] = value
        most[kind] = np.maximum(most[kind], count)
    return np.where(2 * n_solid > block ** len(shape), value_of[1], value_of[0])


def _write_meta(path: Path, values: np.ndarray, spacing: Sequence[float] | None) -> None:
    types = {v: k for k, v in reversed(META_TYPES.items())}
    code = values.dtype.str[1:]
    if code not in types:
        raise VoxelError(f"{path}: data of type {values.dtype} cannot be written; use integers or floats")
    local = path.suffix.lower() == ".mha"
    raw = path.with_suffix(".raw")
    lines = {
        "ObjectType": "Image",
        "NDims": values.ndim,
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "False",
        **({} if spacing is None else {"ElementSpacing": " ".join(repr(float(s)) for s in spacing)}),
        "DimSize": " ".join(str(n) for n in values.shape[::-1]),
        "ElementType": types[code],
        "ElementDataFile": "LOCAL" if local else raw.name,
    }
    header = "".join(f"{key} = {value}\n" for key, value in lines.items()).encode()
    data = values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()
    if not local:
        with replacing(raw) as temporary:
            temporary.write_bytes(data)
    with replacing(path) as temporary:
        temporary.write_bytes(header + data if local else header)


def written_files(path: str | Path) -> list[Path]:
    """The files that `write_image` writes for a path: itself and, for an mhd, the raw file beside it."""
    path = Path(path)
    return [path, path.with_suffix(".raw")] if path.suffix.lower() == ".mhd" else [path]


def _refuse_existing(target: str | Path, force: bool) -> None:
    for path in written_files(target):
        if os.path.lexists(path) and not force:
            raise VoxelError(f"{path}: exists; choose another name, or replace it with --force")


def _refuse_input(source: str | Path, data_file: str | None, target: str | Path) -> None:
    """No image is replaced by what is made of it, under whatever name; data_file: of an mhd, beside it."""
    source = Path(source)
    read = [source] if data_file in (None, "LOCAL") else [source, source.parent / str(data_file)]
    for path in written_files(target):
        if any(path.exists() and path.samefile(given) for given in read):
            raise VoxelError(f"{path}: is read from, and cannot be written over; choose another name")
