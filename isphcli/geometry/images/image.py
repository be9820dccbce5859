"""An image in memory, and the checks that the readers of all formats share.

Arrays are indexed [z, y, x] or [y, x]. Files are checked before they are used: the size by the header is compared with
that of the file before memory is allocated, and pickled objects are never loaded.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

MAX_HEADER = 65536  # bytes of a header in text
MAX_DEFLATE = 1032  # greatest compression of deflate
SPACING = "voxel_size"  # name of the entry with the edges x, y, z of a voxel, m, in an npz or HDF5 file written by isph

Part = tuple[slice, ...]  # [start, stop) along each axis of an array, without steps


class VoxelError(ValueError):
    """An image that cannot be used: the file, what is wrong, what to do."""


@dataclass(frozen=True)
class Layout:
    """The layout of an image, as far as its file does not tell it.

    array: name of one of several arrays. axes: directions of the axes of the array, the slowest first, such as zyx;
    None: as the format has them. Of files without a header: shape along x, y(, z), dtype in numpy's words, offset of
    the first voxel in bytes, byte_order little or big; None where they are to be found out.
    """

    array: str | None = None
    axes: str | None = None
    shape: tuple[int, ...] | None = None
    dtype: str | None = None
    offset: int | None = None
    byte_order: str | None = None


@dataclass(frozen=True)
class Stored:
    """An image in its file, of which no more than the header is read.

    shape, dtype: of the array in the file. part: reads a part of it. spacing: edges of a voxel along the axes of the
    array, the last one (x of zyx) first, or None; in m, or in an unknown unit where `spacing_key` names the entry of
    the file that holds them. along_xyz: whether they are along x, y, z whatever the axes. info: format and header;
    warnings: sentences.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    part: Callable[[Part], np.ndarray]
    spacing: tuple[float, ...] | None = None
    spacing_key: str = ""
    along_xyz: bool = False
    info: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Image:
    """values: [z, y, x] or [y, x]; spacing: edges of a voxel in the order x, y(, z), or None.

    spacing is in m unless `spacing_key` names the entry of the file that holds it without a unit. axes: directions of
    the axes of the array in the file, whose shape is `whole`. info: format and header; warnings: sentences.
    """

    values: np.ndarray
    spacing: tuple[float, ...] | None = None
    spacing_key: str = ""
    axes: str = "zyx"
    whole: tuple[int, ...] = ()
    info: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


UNITS = {"millimetres": 1e-3, "micrometres": 1e-6, "nanometres": 1e-9}  # m, used by imaging programs without a name


def voxel_edges(voxel_size: float | Sequence[float] | np.ndarray, dim: int, path: str | Path) -> tuple[float, ...]:
    """Edges of a voxel, m, one per axis, of one number or of one per axis; VoxelError where they are not positive
    lengths."""
    sizes = np.ravel(np.asarray(voxel_size, dtype=float))
    if sizes.size not in (1, dim) or not np.isfinite(sizes).all() or not (sizes > 0).all():
        raise VoxelError(f"{path}: voxel size {voxel_size} must be positive: one number or {dim}")
    return tuple(float(s) for s in np.broadcast_to(sizes, dim))


def as_labels(path: Path, values: np.ndarray, grey: bool) -> np.ndarray:
    """Values as the smallest unsigned integers, or an error that says why they are no labels."""
    if values.dtype.kind not in "buif":
        raise VoxelError(f"{path}: holds data of type {values.dtype}; save integers, such as uint8")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        what = "NaN" if np.isnan(values).any() else "infinite values"
        raise VoxelError(f"{path}: holds {what}; replace them before the conversion")
    if grey:  # of half precision no histogram can be made
        return values.astype(np.float32) if values.dtype == np.float16 else values
    if values.dtype.kind == "f":
        raise VoxelError(
            f"{path}: holds {values.dtype} numbers; save integer labels or convert with a threshold"
        )
    if values.dtype.kind == "i" and values.min() < 0:
        raise VoxelError(
            f"{path}: holds negative values ({values.min()}); labels are 0 or more: relabel them"
        )
    return in_smallest_type(values)


THICK = 8  # a picture is at least so many times as wide as it has channels


def may_be_colours(shape: tuple[int, ...], dtype: np.dtype) -> bool:
    """Whether the last axis of an array may hold channels.

    Only unsigned bytes and floating point are pictures: a scan three voxels thick can be saved in another type.
    """
    if len(shape) not in (3, 4) or shape[-1] not in (3, 4) or 0 in shape:
        return False
    if len(shape) == 4:
        return True
    return (dtype.kind == "f" or dtype == "u1") and min(shape[:2]) >= THICK * shape[-1]


def check_colours(path: Path, values: np.ndarray) -> None:
    """Refuse a picture with channels in its last axis: colours, or one and the same grey, and perhaps an opacity."""
    channels = values.shape[-1]
    colours = values[..., :3]
    grey = bool((colours == colours[..., :1]).all())
    opaque = channels == 4 and bool((values[..., 3] == values[..., 3].flat[0]).all())
    many = len(np.unique(colours)) > 16
    if grey or opaque or many or values.ndim == 4:
        fix = "image[..., 0]" if grey else "image[..., :3].mean(axis=-1)"
        raise VoxelError(
            f"{path}: looks like a picture in colours, {channels} channels in its last axis (shape {values.shape}); "
            f"save one number a voxel, such as {fix}. A scan that is {channels} voxels thick along its last axis: save "
            "it as bool or uint16"
        )


def one_grey(path: Path, values: np.ndarray) -> np.ndarray:
    """The one channel of a picture (..., channels) whose colours are the same grey, its opacity the same everywhere.

    Raises VoxelError where it has colours.
    """
    colours = values[..., : values.shape[-1] - (values.shape[-1] % 2 == 0)]
    rest = values[..., colours.shape[-1] :]
    if (colours == colours[..., :1]).all() and (rest.size == 0 or (rest == rest.flat[0]).all()):
        return colours[..., 0]
    raise VoxelError(f"{path}: is a picture in colours; save it with one grey value a pixel (8 or 16 bit), or label it "
                     "by colour first")


def thin_axis_warning(path: Path, shape: tuple[int, ...]) -> tuple[str, ...]:
    """A warning where an axis of an array may be channels and not voxels."""
    if len(shape) != 3 or shape[0] == 1:  # [1, y, x] is 2D
        return ()
    thin = [a for a in (0, 2) if shape[a] <= 4 and min(np.delete(shape, a)) >= THICK * shape[a]]
    if len(thin) != 1:
        return ()
    (a,) = thin
    which, n = ("first", shape[a]) if a == 0 else ("last", shape[a])
    return (
        f"{path.name}: the {which} axis of the array has {n} entr{'y' if n == 1 else 'ies'} and is taken for an axis "
        f"of space, {n} voxel{'s' * (n > 1)} thick; if it is that of colours, save one number a voxel (an array [y, x] "
        "is 2D)",
    )


def in_smallest_type(values: np.ndarray) -> np.ndarray:
    """Non-negative integers in the smallest unsigned type that holds them, C order, native bytes."""
    if values.dtype == bool:
        return values.astype(np.uint8)
    return np.ascontiguousarray(values, dtype=np.min_scalar_type(int(values.max())))


def machine_memory() -> int:
    """Bytes of memory of this machine, used or free."""
    import psutil

    return int(psutil.virtual_memory().total)


def check_size(path: Path, needed: int, there: int) -> None:
    """Raises VoxelError where a file does not have as many bytes as its header says."""
    if needed > there:
        raise VoxelError(
            f"{path}: is truncated: {there} bytes of {needed}; copy it again or correct the header"
        )
    if needed < there:
        raise VoxelError(f"{path}: holds {there} bytes where the header says {needed}; correct the header")


def check_memory(path: Path, needed: int) -> None:
    """Raises VoxelError where an array of `needed` bytes takes more than half of the memory of the machine."""
    if needed > machine_memory() // 2:
        raise VoxelError(
            f"{path}: the header asks for {needed} bytes, more than half of the memory; crop the image"
        )


def number_of_voxels(path: Path, shape: Sequence[int]) -> int:
    """Number of voxels in exact integers."""
    count = 1
    for n in shape:
        if n < 0:
            raise VoxelError(f"{path}: has a negative size in shape {tuple(shape)}; correct the header")
        count *= int(n)
    if count == 0 or len(shape) > 8:
        raise VoxelError(f"{path}: is empty or no image (shape {tuple(shape)}); give 2 or 3 dimensions")
    return count


class Readable(Protocol):
    """A stream from which parts of an array are read."""

    def read(self, n: int, /) -> bytes:
        """The next n bytes at most."""
        ...


PIECE = 2**22  # bytes read at a time where they are only skipped


def stored_part(path: Path, open_data: Callable[[], AbstractContextManager[Readable]], dtype: np.dtype,
                shape: tuple[int, ...], fortran: bool = False) -> Callable[[Part], np.ndarray]:
    """A function that reads a part of the values in a stream, `shape` in C order (`fortran`: the first axis runs
    fastest), and holds at most one layer of the slowest axis beside that part.

    open_data: opens the stream at the first value. The part raises VoxelError where the stream ends before it.
    """

    def part(keep: Part) -> np.ndarray:
        sizes, ranges = (shape[::-1], keep[::-1]) if fortran else (shape, keep)
        row = dtype.itemsize * int(np.prod(sizes[2:], dtype=object))
        layer, first, length = row * sizes[1], row * ranges[1].start, row * (ranges[1].stop - ranges[1].start)
        values = np.empty([r.stop - r.start for r in ranges], dtype)
        with open_data() as stream:
            at = 0
            for k in range(ranges[0].start, ranges[0].stop):
                _pass_over(stream, k * layer + first - at)
                data = _read_all(stream, length)
                if len(data) < length:
                    raise VoxelError(f"{path}: is truncated; copy it again")
                rows = np.frombuffer(data, dtype).reshape(-1, *sizes[2:])
                values[k - ranges[0].start] = rows[(slice(None), *ranges[2:])]
                at = k * layer + first + length
        return values.transpose() if fortran else values

    return part


def _pass_over(stream: Readable, count: int) -> None:
    seek = getattr(stream, "seek", None)  # a stream that is decompressed as it is read has none
    if seek is not None and count > PIECE:
        seek(count, os.SEEK_CUR)
        return
    while count > 0 and (data := stream.read(min(count, PIECE))):
        count -= len(data)


def _read_all(stream: Readable, count: int) -> bytes:
    data = stream.read(count)
    while len(data) < count and (more := stream.read(count - len(data))):
        data += more
    return data


class Inflated:
    """A stream that decompresses zlib data of a known size, as many bytes at a time as are read."""

    def __init__(self, path: Path, file: BinaryIO):
        self.path, self.file, self.inflater = path, file, zlib.decompressobj()

    def __enter__(self) -> Inflated:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def read(self, n: int, /) -> bytes:
        """The next n bytes at most; raises VoxelError where the data are damaged."""
        found = bytearray()
        try:
            while len(found) < n:
                given = self.inflater.unconsumed_tail or self.file.read(2**20)
                more = self.inflater.decompress(given, n - len(found))
                if not given and not more:
                    break
                found += more
        except zlib.error as error:
            raise VoxelError(f"{self.path}: compressed data is damaged ({error}); copy it again") from None
        return bytes(found)


def check_deflated(path: Path, there: int, needed: int) -> None:
    """VoxelError where `there` compressed bytes are too few for `needed`."""
    if needed > MAX_DEFLATE * there + 1024:
        raise VoxelError(f"{path}: is truncated: {there} compressed bytes cannot hold {needed}; copy it again")
