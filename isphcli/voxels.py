"""Images of rock: reading, writing, labelling and converting npy, npz and MetaImage (mhd + raw, mha) files.

Arrays are indexed [z, y, x] or [y, x]. Nothing in a file is believed before it is checked: sizes are compared
with the header before memory is taken, and pickled objects are never loaded.
"""

from __future__ import annotations

import itertools
import os
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .geometry import report
from .output import replacing

MAX_HEADER = 65536  # bytes of a MetaImage header
MAX_DEFLATE = 1032  # greatest compression of deflate
SPACING = "voxel_size"  # array of an npz that holds the spacing x, y, z
META_TYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}


class VoxelError(ValueError):
    """An image that cannot be used: the file, what is wrong, what to do."""


@dataclass(frozen=True)
class Image:
    """values: integers [z, y, x] or [y, x]; spacing: edges of a voxel in the order x, y(, z), or None.

    spacing of npz files is in m; a MetaImage does not say its unit. info: format and header; warnings: sentences.
    """

    values: np.ndarray
    spacing: tuple[float, ...] | None = None
    info: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def read_image(path: str | Path, array: str | None = None, grey: bool = False) -> Image:
    """Read an npy, npz (`array`: which of several), mhd or mha file.

    Values are labels, integers of 0 or more in the smallest unsigned type; with `grey`, numbers of any type, integers
    or floating point (never NaN). Raises VoxelError where the file is no such image, or a picture in colours.
    """
    path = Path(path)
    if not path.is_file():
        raise VoxelError(f"{path}: no such file; give the path of an npy, npz, mhd or mha image")
    readers = {".npy": _read_npy_file, ".npz": _read_npz, ".mhd": _read_meta, ".mha": _read_meta}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise VoxelError(f"{path}: '{path.suffix}' images are not read; give npy, npz, mhd (with raw) or mha")
    try:
        values, spacing, info = reader(path, array)
    except OSError as error:
        raise VoxelError(f"{path}: cannot be read ({error.strerror or error}); check the file") from None
    values = _checked(path, values, grey)
    return Image(values, spacing, info, _thin(path, values))


def image_shape(path: str | Path, array: str | None = None) -> tuple[int, ...] | None:
    """Shape [z, y, x] or [y, x] by the header of an image, its values unread.

    None where the header does not tell: `read_image` then says what is wrong.
    """
    path = Path(path)
    try:
        if path.suffix.lower() in (".mhd", ".mha"):
            with open(path, "rb") as file:
                header, _ = _meta_header(path, file.read(MAX_HEADER))
            return tuple(_meta_numbers(path, header, "DimSize", int)[::-1])
        if path.suffix.lower() == ".npy":
            with open(path, "rb") as file:
                return _npy_shape(file)
        if path.suffix.lower() == ".npz":
            with zipfile.ZipFile(path) as archive:
                names = [n for n in archive.namelist() if n not in (SPACING, f"{SPACING}.npy")]
                with archive.open(names[0] if array is None else f"{array}.npy") as file:
                    return _npy_shape(file)  # type: ignore[arg-type]
    except Exception:  # whatever broken bytes make the parsers raise
        return None
    return None


def _npy_shape(file: BinaryIO) -> tuple[int, ...]:
    """Shape in the header of an npy stream, sides of one in front left out as `read_image` does."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape = tuple(int(n) for n in read(file)[0])
    while len(shape) > 3 and shape[0] == 1:
        shape = shape[1:]
    return shape


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


def crop(
    values: np.ndarray, ranges: Sequence[Sequence[int]] | None, path: str | Path = "image"
) -> np.ndarray:
    """Part [first, end) of an image along x, y(, z)."""
    if ranges is None:
        return values
    sizes = values.shape[::-1]
    if len(ranges) != values.ndim:
        raise VoxelError(
            f"{path}: crop has {len(ranges)} ranges for {values.ndim} dimensions; give one an axis"
        )
    for name, (first, end), size in zip("xyz", ranges, sizes):
        if not 0 <= first < end <= size:
            raise VoxelError(f"{path}: crop {name} [{first}, {end}) does not lie in 0 to {size}; shorten it")
    return values[tuple(slice(int(first), int(end)) for first, end in reversed(list(ranges)))]


def apply_labels(
    values: np.ndarray,
    labels: Mapping[str, int | Sequence[int]],
    fluids: Sequence[str],
    path: str | Path = "image",
) -> np.ndarray:
    """Phases int8: -1 where the value is one of labels['solid'], k for those of fluids[k].

    Every value of the image needs a label, and every fluid with labels a voxel.
    """
    found = {int(v): int(n) for v, n in _histogram(values).items()}
    phase_of: dict[int, int] = {}
    for name, wanted in labels.items():
        if name != "solid" and name not in fluids:
            raise VoxelError(f"{path}: label '{name}' is neither solid nor a fluid ({', '.join(fluids)})")
        numbers = [int(v) for v in np.ravel(np.asarray(wanted))]
        if name != "solid" and not any(v in found for v in numbers):
            raise VoxelError(
                f"{path}: no voxel has the label of '{name}' {numbers}; it holds {_counts(found)}"
            )
        phase_of.update({v: -1 if name == "solid" else fluids.index(name) for v in numbers})
    unknown = [v for v in found if v not in phase_of]
    if unknown:
        raise VoxelError(f"{path}: voxels of value {unknown[:8]} have no label; it holds {_counts(found)}")
    phases = np.empty(values.shape, dtype=np.int8)
    for value in found:
        phases[values == value] = phase_of[value]
    return phases


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


def _histogram(values: np.ndarray) -> dict[int, int]:
    """{value: voxels}, ascending."""
    if values.dtype.itemsize <= 2 and values.dtype.kind == "u":
        counts = np.bincount(values.ravel())
        return {int(v): int(counts[v]) for v in np.flatnonzero(counts)}
    found, counts = np.unique(values, return_counts=True)
    return {int(v): int(n) for v, n in zip(found, counts)}


def _counts(found: Mapping[int, int]) -> str:
    """'0 (12 voxels), 1 (7 voxels)', shortened."""
    text = ", ".join(f"{v} ({n} voxels)" for v, n in list(found.items())[:8])
    return text + (f" and {len(found) - 8} other values" if len(found) > 8 else "")


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


UNITS = {"millimetres": 1e-3, "micrometres": 1e-6, "nanometres": 1e-9}  # that imaging tools write without saying so
COARSE = 1e-3  # m: images of rock have finer voxels
SAME_SIZE = 1e-3  # relative difference up to which two voxel sizes are one, written with different digits


def voxel_size_of(
    image: Image, given: float | Sequence[float] | None, path: str | Path, axes: str = "zyx"
) -> tuple[np.ndarray, str, tuple[str, ...]]:
    """Edges of a voxel along x, y(, z), m, (1,) or (dim,); where they come from; warnings.

    given: of the case, or None: then that of the file. axes: order of the axes of the array. Raises VoxelError
    where neither has one.
    """
    spacing, meta = known_spacing(image, axes), image.info.get("format") == "MetaImage"
    name = Path(path).name
    if given is None:
        if spacing is None:
            raise VoxelError(f"{path}: holds no voxel size; give geometry.voxels.voxel_size, in m")
        source = f"from {name}"
        if not meta:
            return np.array(spacing), source, ()
        where = f"{source}, whose ElementSpacing has no unit: taken as metres"
        most = max(spacing)
        if most < COARSE:
            return np.array(spacing), where, ()
        units = [f"{most * size:g} m if it is in {unit}" for unit, size in UNITS.items()]
        hint = (f"{name}: ElementSpacing {_numbers(spacing)} has no unit and is taken as metres; voxels of rock are "
                f"finer: give the voxel size, {' or '.join(units[:2])} (geometry.voxels.voxel_size, "
                "--voxel-size)")  # fmt: skip
        return np.array(spacing), where, (hint,)
    size = np.ravel(np.asarray(given, dtype=float))
    source = "as given"
    if spacing is None or len(size) not in (1, len(spacing)):
        return size, source, ()
    ratio = np.broadcast_to(size, len(spacing)) / np.array(spacing)
    if np.allclose(ratio, 1.0, rtol=SAME_SIZE, atol=0.0):
        return size, f"{source}, as in {name}", ()
    for unit, length in UNITS.items() if meta else ():
        if np.allclose(ratio, length, rtol=SAME_SIZE, atol=0.0):
            return size, f"{source}, as in {name} if that is in {unit}", ()
    unit = " (without a unit)" if meta else " m"
    said = (f"the voxel size given, {_numbers(size)} m, is not that of {name}, {_numbers(spacing)}{unit}; the one "
            "given is taken: leave it out (geometry.voxels.voxel_size, --voxel-size) for that of the file")  # fmt: skip
    return size, f"{source}; {name} has {_numbers(spacing)}{unit}", (said,)


def known_spacing(image: Image, axes: str = "zyx") -> tuple[float, ...] | None:
    """Edges of a voxel along x, y(, z) that the file tells, or None; 1 1 1 in a MetaImage stands for not known."""
    if image.spacing is None:
        return None
    spacing = image.spacing[: image.values.ndim]
    if image.info.get("format") != "MetaImage":
        return spacing
    return None if all(s == 1.0 for s in spacing) else spacing[::-1] if axes == "xyz" else spacing


def _numbers(sizes: Sequence[float] | np.ndarray) -> str:
    """'5e-06' where all are equal, else '1e-06 x 1e-06 x 2e-06'."""
    words = [f"{s:.6g}" for s in sizes]
    return words[0] if len(set(words)) == 1 else " x ".join(words)


def faces_that_differ(solid: np.ndarray, periodic: Sequence[bool]) -> tuple[str, ...]:
    """Sentences on the periodic axes along which an image does not go on at the opposite face.

    solid: bool [z, y, x] or [y, x]; periodic: per axis x, y(, z). Voxels differ from one layer to the next inside the
    image too; two faces are called different where they are nearer to two unrelated layers than to two neighbours.
    """
    share = float(solid.mean())
    said = []
    for axis, name in enumerate("xyz"[: solid.ndim]):
        layers = np.moveaxis(solid, solid.ndim - 1 - axis, 0)
        if not periodic[axis] or len(layers) < 3:
            continue
        across = float((layers[0] != layers[-1]).mean())
        inside = float(np.mean([(a != b).mean() for a, b in itertools.pairwise(layers)]))
        unrelated = 2.0 * share * (1.0 - share)
        if across > 0.05 and across > 0.5 * (inside + max(unrelated, inside)) and across > 1.5 * inside:
            said.append(
                f"geometry.periodic: the two faces across {name} differ in {100 * across:.0f} % of their voxels, "
                f"neighbouring layers in {100 * inside:.0f} %: the image does not repeat along {name}; leave {name} "
                "out of geometry.periodic, or mirror the image"
            )
    return tuple(said)


def _sizes(voxel_size: float | Sequence[float] | np.ndarray, dim: int, path: str | Path) -> tuple[float, ...]:
    sizes = np.ravel(np.asarray(voxel_size, dtype=float))
    if sizes.size not in (1, dim) or not np.isfinite(sizes).all() or not (sizes > 0).all():
        raise VoxelError(f"{path}: voxel size {voxel_size} must be positive: one number or {dim}")
    return tuple(float(s) for s in np.broadcast_to(sizes, dim))


def _checked(path: Path, values: np.ndarray, grey: bool) -> np.ndarray:
    """Values as the smallest unsigned integers, or an error that says why they are no labels."""
    if values.dtype.kind not in "buif":
        raise VoxelError(f"{path}: holds data of type {values.dtype}; save integers, such as uint8")
    while values.ndim > 3 and values.shape[0] == 1:
        values = values[0]
    _check_colours(path, values)
    if values.ndim not in (2, 3):
        raise VoxelError(f"{path}: has {values.ndim} dimensions; an image has 2 or 3")
    if values.size == 0:
        raise VoxelError(f"{path}: is empty (shape {values.shape}); give at least one voxel")
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise VoxelError(f"{path}: holds NaN; replace them before the conversion")
    if grey:
        return values
    if values.dtype.kind == "f":
        raise VoxelError(
            f"{path}: holds {values.dtype} numbers; save integer labels or convert with a threshold"
        )
    if values.dtype.kind == "i" and values.min() < 0:
        raise VoxelError(
            f"{path}: holds negative values ({values.min()}); labels are 0 or more: relabel them"
        )
    return _smallest(values)


THICK = 8  # a picture is at least so many times as wide as it has channels


def _check_colours(path: Path, values: np.ndarray) -> None:
    """Refuse a picture with channels: colours, or one and the same grey, and perhaps an opacity.

    Only unsigned bytes and floating point are pictures: a scan three voxels thick can be saved in another type.
    """
    if values.ndim not in (3, 4) or values.shape[-1] not in (3, 4) or values.size == 0:
        return
    if values.ndim == 3 and (values.dtype.kind not in "uf" or values.dtype in ("u2", "u4", "u8")):
        return
    height, width, channels = values.shape[-3:]
    if min(height, width) < THICK * channels and values.ndim == 3:
        return
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


def _thin(path: Path, values: np.ndarray) -> tuple[str, ...]:
    """A warning where an axis may be channels and not voxels."""
    if values.ndim != 3 or values.shape[0] == 1:  # [1, y, x] is 2D
        return ()
    thin = [a for a in (0, 2) if values.shape[a] <= 4 and min(np.delete(values.shape, a)) >= THICK * values.shape[a]]
    if len(thin) != 1:
        return ()
    (a,) = thin
    which, n = ("first", values.shape[a]) if a == 0 else ("last", values.shape[a])
    return (
        f"{path.name}: the {which} axis of the array has {n} entr{'y' if n == 1 else 'ies'} and is taken for an axis "
        f"of space, {n} voxel{'s' * (n > 1)} thick; if it is that of colours, save one number a voxel (an array [y, x] "
        "is 2D)",
    )


def _smallest(values: np.ndarray) -> np.ndarray:
    """Non-negative integers in the smallest unsigned type that holds them, C order, native bytes."""
    if values.dtype == bool:
        return values.astype(np.uint8)
    return np.ascontiguousarray(values, dtype=np.min_scalar_type(int(values.max())))


def _memory() -> int:
    """Bytes that one image may take: half of the machine's memory."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    except (AttributeError, OSError, ValueError):
        return 2**32


def _check_size(path: Path, needed: int, there: int) -> None:
    """The header's bytes against the bytes of the file and the memory of the machine."""
    if needed > _memory():
        raise VoxelError(
            f"{path}: the header asks for {needed} bytes, more than half of the memory; crop the image"
        )
    if needed > there:
        raise VoxelError(
            f"{path}: is truncated: {there} bytes of {needed}; copy it again or correct the header"
        )
    if needed < there:
        raise VoxelError(f"{path}: holds {there} bytes where the header says {needed}; correct the header")


def _read_npy_file(path: Path, array: str | None) -> tuple[np.ndarray, None, dict]:
    with open(path, "rb") as file:
        return _read_npy(path, file, os.path.getsize(path)), None, {"format": "npy"}


def _read_npy(path: Path, file: BinaryIO, size: int) -> np.ndarray:
    """One npy stream of `size` bytes; the header is checked before anything is allocated."""
    try:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[
            version
        ]
        shape, fortran, dtype = read(file)
    except Exception:  # whatever the bytes make numpy's parser raise
        raise VoxelError(f"{path}: is not an npy array; save it again with numpy.save") from None
    if dtype.hasobject or dtype.kind not in "buif":
        raise VoxelError(f"{path}: holds data of type {dtype}; save integers, such as uint8")
    count = _product(path, shape)
    _check_size(path, file.tell() + count * dtype.itemsize, size)
    data = bytearray()
    while len(data) < count * dtype.itemsize:
        part = file.read(min(2**26, count * dtype.itemsize - len(data)))
        if not part:
            raise VoxelError(f"{path}: is truncated; copy it again")
        data += part
    values, shape = np.frombuffer(data, dtype=dtype), tuple(map(int, shape))  # True is a size for numpy's parser
    return values.reshape(shape[::-1]).transpose() if fortran else values.reshape(shape)


def _product(path: Path, shape: Sequence[int]) -> int:
    """Number of voxels in exact integers."""
    count = 1
    for n in shape:
        if n < 0:
            raise VoxelError(f"{path}: has a negative size in shape {tuple(shape)}; correct the header")
        count *= int(n)
    if count == 0 or len(shape) > 8:
        raise VoxelError(f"{path}: is empty or no image (shape {tuple(shape)}); give 2 or 3 dimensions")
    return count


def _read_npz(path: Path, array: str | None) -> tuple[np.ndarray, tuple | None, dict]:
    try:
        with zipfile.ZipFile(path) as archive:
            members = {
                i.filename.removesuffix(".npy"): i for i in archive.infolist() if i.filename.endswith(".npy")
            }
            names = [n for n in members if n != SPACING]
            if array is None and len(names) == 1:
                array = names[0]
            if array not in members:
                missing = "name one" if array is None else f"there is no '{array}'"
                raise VoxelError(f"{path}: holds the arrays {names[:20]}; {missing} with the key 'array'")
            values = _read_member(path, archive, members[array])
            spacing = None
            if SPACING in members and members[SPACING].file_size < 1000:
                sizes = _read_member(path, archive, members[SPACING])
                spacing = _sizes(sizes, values.ndim, path) if sizes.dtype.kind in "iuf" else None
    except VoxelError:
        raise
    except Exception as error:  # zipfile and zlib raise many kinds for broken archives
        if isinstance(error, OSError) and error.errno:
            raise
        raise VoxelError(f"{path}: is not a whole npz archive ({error}); copy or save it again") from None
    return values, spacing, {"format": "npz", "array": array}


def _read_member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise VoxelError(f"{path}: is compressed in an unknown way; save it with numpy.savez_compressed")
    if member.file_size > MAX_DEFLATE * member.compress_size + 1024:
        raise VoxelError(f"{path}: is damaged (sizes disagree); copy or save it again")
    with archive.open(member) as file:
        return _read_npy(path, file, member.file_size)  # type: ignore[arg-type]


def _read_meta(path: Path, array: str | None) -> tuple[np.ndarray, tuple | None, dict]:
    """MetaImage: a text header of `Key = value` lines, the data in the same file (LOCAL) or another."""
    with open(path, "rb") as file:
        header, data_start = _meta_header(path, file.read(MAX_HEADER))
    dims = _meta_numbers(path, header, "DimSize", int)
    if "NDims" in header and [len(dims)] != _meta_numbers(path, header, "NDims", int):
        raise VoxelError(
            f"{path}: DimSize has {len(dims)} numbers but NDims is {header['NDims']}; correct it"
        )
    if header.get("BinaryData", "True").lower() != "true":
        raise VoxelError(f"{path}: holds text data (BinaryData = False); save it as binary")
    if header.get("ElementNumberOfChannels", "1") != "1":
        raise VoxelError(f"{path}: has several channels; save one")
    code = META_TYPES.get(header.get("ElementType", ""))
    if code is None:
        raise VoxelError(f"{path}: ElementType '{header.get('ElementType')}' is not known; use MET_UCHAR")
    big = header.get("BinaryDataByteOrderMSB", header.get("ElementByteOrderMSB", "False")).lower() == "true"
    dtype = np.dtype((">" if big else "<") + code)
    needed = _product(path, dims) * dtype.itemsize
    local = header["ElementDataFile"] == "LOCAL"
    data_path = path if local else path.parent / header["ElementDataFile"]
    if not data_path.is_file():
        raise VoxelError(f"{path}: its data file {data_path} does not exist; correct ElementDataFile")
    skip = data_start if local else _meta_numbers(path, header, "HeaderSize", int, [0])[0]
    there = os.path.getsize(data_path)
    compressed = header.get("CompressedData", "False").lower() == "true"
    if skip == -1 and not compressed:
        skip = there - needed
    with open(data_path, "rb") as file:
        file.seek(max(skip, 0))
        if compressed:
            data = _inflate(data_path, file, there - max(skip, 0), needed)
        else:
            _check_size(data_path, needed, there - max(skip, 0))
            data = bytearray(file.read(needed))
    key = "ElementSpacing" if "ElementSpacing" in header else "ElementSize"
    spacing = _sizes(_meta_numbers(path, header, key, float), len(dims), path) if key in header else None
    values = np.frombuffer(data, dtype=dtype).reshape(dims[::-1])
    return values, spacing, {"format": "MetaImage", **header}


def _meta_header(path: Path, head: bytes) -> tuple[dict[str, str], int]:
    """Header as a dict, and where the data starts after its last line, ElementDataFile."""
    header: dict[str, str] = {}
    start = 0
    while start < len(head):
        end = head.find(b"\n", start)
        line = head[start : end if end >= 0 else len(head)].decode("latin-1").strip()
        start = end + 1 if end >= 0 else len(head)
        name, equals, value = line.partition("=")
        if not equals and line:
            break
        header[name.strip()] = value.strip()
        if name.strip() == "ElementDataFile":
            if not value.strip() or "\0" in value or value.strip() == "LIST" or "%" in value:
                raise VoxelError(f"{path}: ElementDataFile must name one file; join the slices")
            return header, start
    raise VoxelError(f"{path}: is not a MetaImage header (no ElementDataFile); see docs on mhd files")


def _meta_numbers(
    path: Path, header: Mapping[str, str], key: str, kind: type, default: list | None = None
) -> list:
    if key not in header and default is not None:
        return default
    try:
        return [kind(word[:40]) for word in header[key].split()[:16]]
    except (KeyError, ValueError):
        found = f"'{header[key][:40]}'" if key in header else "missing"
        raise VoxelError(f"{path}: {key} is {found}; give numbers, such as {key} = 128 128 128") from None


def _inflate(path: Path, file: BinaryIO, there: int, needed: int) -> bytearray:
    """Decompress zlib data of a known size, never more than that."""
    _check_size(path, needed, max(needed, 0))
    if needed > MAX_DEFLATE * there + 1024:
        raise VoxelError(
            f"{path}: is truncated: {there} compressed bytes cannot hold {needed}; copy it again"
        )
    inflater, data = zlib.decompressobj(), bytearray()
    try:
        while len(data) < needed and (part := file.read(2**20)):
            while part and len(data) < needed:
                data += inflater.decompress(part, needed - len(data))
                part = inflater.unconsumed_tail
    except zlib.error as error:
        raise VoxelError(f"{path}: compressed data is damaged ({error}); copy it again") from None
    if len(data) < needed:
        raise VoxelError(f"{path}: is truncated: {len(data)} bytes of {needed}; copy it again")
    return data


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
