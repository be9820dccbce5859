"""Writes images, and converts them: from a scan to labels (`isph convert-voxels`)."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.connectivity import Connectivity, SlabConnectivity, connectivity_of
from ..geometry.image_steps import connected_part, inverted, is_fluid, thresholded, trimmed
from ..geometry.images.image import SPACING, Image, Layout, VoxelError, in_smallest_type, voxel_edges
from ..geometry.images.metaimage import META_TYPES
from ..geometry.images.read import axes_of, image_shape, read_image
from ..geometry.images.voxel_size import known_spacing, voxel_size_of
from ..geometry.labels import counts_text, histogram, mirrored
from .files import replacing, write_text


def write_image(path: str | Path, values: np.ndarray, spacing: Sequence[float] | None = None) -> None:
    """Write an image [z, y, x] or [y, x]; spacing (x, y(, z)), m, is kept by all formats but npy and raw.

    Each file appears whole or not at all, the raw file before the mhd that names it. What is there is replaced.
    """
    path, values = Path(path), np.ascontiguousarray(values)
    if values.dtype == bool:
        values = values.astype(np.uint8)
    write = _writer(path)
    with writing(path):
        write(path, values, spacing)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns errors of the system and of libraries while a file is written into a VoxelError."""
    try:
        yield
    except OSError as error:
        raise VoxelError(f"{path}: cannot be written ({error.strerror or error}); check the folder") from None


def _writer(path: Path) -> Callable[[Path, np.ndarray, Sequence[float] | None], None]:
    writers = {".npy": _write_npy, ".npz": _write_npz, ".mhd": _write_meta, ".mha": _write_meta, ".tif": _write_tiff,
               ".tiff": _write_tiff, ".nrrd": _write_nrrd, ".raw": _write_raw}
    if path.suffix.lower() not in writers:
        known = ", ".join(suffix[1:] for suffix in writers)
        raise VoxelError(f"{path}: '{path.suffix}' images are not written; give {known}")
    return writers[path.suffix.lower()]


def _write_npy(path: Path, values: np.ndarray, spacing: Sequence[float] | None) -> None:
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.save(file, values, allow_pickle=False)


def _write_npz(path: Path, values: np.ndarray, spacing: Sequence[float] | None) -> None:
    extra: dict[str, Any] = {} if spacing is None else {SPACING: np.asarray(spacing, dtype=float)}
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, image=values, **extra)


def _write_raw(path: Path, values: np.ndarray, spacing: Sequence[float] | None) -> None:
    with replacing(path) as temporary, open(temporary, "wb") as file:
        values.astype(values.dtype.newbyteorder("<"), copy=False).tofile(file)


def _write_tiff(path: Path, values: np.ndarray, spacing: Sequence[float] | None) -> None:
    """With the size of a voxel as ImageJ keeps it, in micrometres, where the type is one of ImageJ."""
    import tifffile

    options: dict[str, Any] = {}
    if spacing is not None and values.dtype in ("u1", "u2", "f4"):
        edges = [s * 1e6 for s in spacing]
        options = {"imagej": True, "resolution": (1.0 / edges[0], 1.0 / edges[1]),
                   "metadata": {"unit": "um", **({"spacing": edges[2]} if len(edges) == 3 else {})}}
    with replacing(path) as temporary, open(temporary, "wb") as file:
        tifffile.imwrite(file, values, **options)


def _write_nrrd(path: Path, values: np.ndarray, spacing: Sequence[float] | None) -> None:
    import nrrd

    header: dict[str, Any] = {"encoding": "gzip"}
    if spacing is not None:
        dim = values.ndim
        header |= {"space dimension": dim, "space directions": np.diag(spacing), "space units": ["m"] * dim}
    with replacing(path) as temporary, open(temporary, "wb") as file:
        nrrd.write(file, values, header, index_order="C")


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """How an image is read and changed, in this order.

    layout: of the file; crop_to: ranges along x, y(, z). threshold: grey values from it on are solid (1), others pore
    (0); of two, those between are 2; 'otsu'. invert: the other way round; without a threshold two labels are exchanged.
    labels: {old value: new value}. solid: values that are solid from here on. trim: cut off what is solid outside of
    the pores. mirror: axes along which the mirror image follows. connected: which pores are kept, see
    `image_steps.connected_part`. downsample: edge of the blocks that become one voxel, solid if more than half is, then
    the most frequent value; incomplete blocks at the upper ends are cut off. voxel_size: m, of the source image, where
    its file has none or a wrong one.
    """

    layout: Layout = field(default_factory=Layout)
    crop_to: Sequence[Sequence[int]] | None = None
    threshold: float | Sequence[float] | str | None = None
    invert: bool = False
    labels: Mapping[int, int] = field(default_factory=dict)
    solid: int | Sequence[int] = 1
    trim: bool = False
    mirror: Sequence[str] = ()
    connected: str | None = None
    downsample: int = 1
    voxel_size: float | Sequence[float] | None = None


def convert(source: str | Path, target: str | Path, how: Conversion | None = None, force: bool = False,
            picture: bool = False) -> dict[str, Any]:
    """Read an image, change and write it; returns what it holds.

    force: replace the target (an mhd: its raw file too) where it exists. picture: draw three slices into
    `slices_picture` of the target.

    Raises VoxelError; nothing was written then. The source is never written over.
    """
    how, target = how or Conversion(), Path(target)
    files = [*written_files(target), *([slices_picture(target)] if picture else [])]
    if Path(source).exists():
        _refuse_input(source, None, files)
    _refuse_existing(files, force)
    _writer(target)
    if (shape := slab_shape(source, target, how)) is not None:
        return _convert_by_slabs(Path(source), target, how, picture, shape)
    image = read_image(source, grey=how.threshold is not None, layout=how.layout, crop=how.crop_to)
    _refuse_input(source, image.info.get("ElementDataFile"), files)
    values, facts = _changed(image.values, how, source)
    solids = _solids(how)
    spacing, whence, notes = _edges_written(image, how, values.ndim, source)
    values = _coarsened(values, int(how.downsample), solids, source)
    write_image(target, values, spacing)
    if picture:
        from .image_slices import plot_slices

        facts["picture"] = str(slices_picture(target))
        with writing(slices_picture(target)):
            plot_slices(slices_picture(target), values, solids, spacing, target.name)
    fluid = is_fluid(values, solids)
    cell = 1.0 if spacing is None else float(np.prod(spacing[: values.ndim]))
    found = connectivity_of(fluid, (False,) * values.ndim, cell)
    return _report_of(target, image, values.shape, (spacing, whence, notes), facts, solids, (found, histogram(values)))


def _edges_written(image: Image, how: Conversion, dim: int,
                   source: str | Path) -> tuple[tuple[float, ...] | None, str, tuple[str, ...]]:
    """Edges of a voxel of what is written, m, None where they are not known; where they are from; warnings."""
    if how.voxel_size is None and known_spacing(image) is None:
        return None, "", image.warnings
    given = None if how.voxel_size is None else voxel_edges(how.voxel_size, dim, source)
    edges, whence, more = voxel_size_of(image, given, source)
    return tuple(int(how.downsample) * float(s) for s in edges), whence, image.warnings + more


def _report_of(target: Path, image: Image, shape: tuple[int, ...], sized: tuple[Any, str, tuple[str, ...]],
               facts: Mapping[str, Any], solids: list[int],
               held: tuple[Connectivity, dict[int, int]]) -> dict[str, Any]:
    """What `convert` returns. image: of the source, or of a part of it; sized: edges of a voxel, where they are from,
    warnings; held: connectivity and {value: voxels} of what was written."""
    (spacing, whence, notes), (found, labels) = sized, held
    axes = "xyz"[: len(shape)]
    if not set(labels) & set(solids):
        notes += (f"no voxel is solid (--solid {','.join(map(str, solids))}): it holds {counts_text(labels)}; name the "
                  "values that are with --solid, or make them 1 with --labels",)  # fmt: skip
    return {
        "file": str(target),
        "read": f"{image.info.get('format', '')}, array {' x '.join(map(str, image.whole))}, its axes taken as "
                f"{', '.join(image.axes)}",
        "shape": dict(zip(axes, shape[::-1])),
        "voxel_size": spacing,
        "voxel_size_from": whence,
        "warnings": notes,
        **facts,
        "solid": solids,
        **asdict(found),
        "percolates": dict(zip(axes, found.percolates)),
        "percolating_porosity": dict(zip(axes, found.percolating_porosity)),
        "labels": labels,
    }  # fmt: skip


SLAB = 2**24  # voxels that are converted at a time; their labels take four bytes each
LARGE = 2**26  # voxels from which on an image is converted by slabs
BY_SLABS = (".raw", ".bin", ".npy", ".mhd", ".h5", ".hdf5")  # formats whose parts are read without the data before
APPENDED = (".raw", ".npy", ".npz", ".mhd", ".mha")  # formats that are written from one end to the other


def slab_shape(source: str | Path, target: Path, how: Conversion) -> tuple[int, ...] | None:
    """Shape [z, y, x] of an image that is converted slab by slab along z, never whole in memory; None where it is not.

    Slabs are used where the image is large, its file can be read and the target written in parts, and no step needs the
    whole image, as a threshold by Otsu, trim, mirror, connected, and labels beside a threshold do.
    """
    source = Path(source)
    if source.suffix.lower() not in BY_SLABS or target.suffix.lower() not in APPENDED or source.is_dir():
        return None
    if how.threshold == "otsu" or how.trim or how.mirror or how.connected is not None:
        return None
    if how.threshold is not None and how.labels:
        return None
    if axes_of(source, how.layout.axes)[0] != "z" or (shape := image_shape(source, layout=how.layout)) is None:
        return None
    if how.crop_to is not None:
        if len(how.crop_to) != len(shape):
            return None
        shape = tuple(end - first for first, end in reversed(list(how.crop_to)))
    return shape if len(shape) == 3 and int(np.prod(shape, dtype=object)) >= LARGE else None


def _slabs(source: Path, how: Conversion, shape: tuple[int, ...]) -> Iterator[Image]:
    """The image of a source in slabs along z of whole blocks of `downsample`; layers of an incomplete block are the
    last slab."""
    block = max(int(how.downsample), 1)
    thick = max(SLAB // (shape[1] * shape[2]) // block, 1) * block
    ranges = [list(r) for r in how.crop_to] if how.crop_to is not None else [[0, n] for n in shape[::-1]]
    start, end = ranges[2]
    for first in range(start, end, thick):
        ranges[2] = [first, min(first + thick, end)]
        yield read_image(source, grey=how.threshold is not None, layout=how.layout, crop=ranges)


def _values_of(source: Path, how: Conversion, shape: tuple[int, ...]) -> dict[int, int]:
    """{value: voxels} of all slabs."""
    found: dict[int, int] = {}
    for image in _slabs(source, how, shape):
        for value, count in histogram(image.values).items():
            found[value] = found.get(value, 0) + count
    return found


def _convert_by_slabs(source: Path, target: Path, how: Conversion, picture: bool,
                      shape: tuple[int, ...]) -> dict[str, Any]:
    """`convert` of an image of shape [z, y, x], slab by slab: once over its values where their labels are asked for or
    have to be known, and once to write it."""
    block, solids, facts = int(how.downsample), _solids(how), dict[str, Any]()
    if block < 1 or min(shape) < block:
        raise VoxelError(f"{source}: downsample {block} must be from 1 to the smallest side {min(shape)}")
    table: dict[int, int] | None = None
    if how.threshold is None:
        table = _new_values(source, how, _values_of(source, how, shape))
        if block > 1 and len(set(table.values())) > 64:
            raise VoxelError(f"{source}: {len(set(table.values()))} values are too many labels to downsample; give a "
                             "threshold")
    first = next(iter(_slabs(source, how, shape)))
    spacing, whence, notes = _edges_written(first, how, 3, source)
    first = replace(first, values=first.values[:0])  # frees the slab
    dtype = np.dtype(np.uint8) if table is None else np.min_scalar_type(max(table.values()))
    written = _Written(tuple(n // block for n in shape), dtype, solids)
    with writing(target):
        _append(target, _changed_slabs(source, how, shape, table, written, facts), written.shape, dtype, spacing)
    if picture:
        from .image_slices import plot_cuts

        facts["picture"] = str(slices_picture(target))
        with writing(slices_picture(target)):
            plot_cuts(slices_picture(target), written.cuts, written.shape, solids, spacing, target.name)
    known = written.found.connectivity(1.0 if spacing is None else float(np.prod(spacing)))
    labels = dict(sorted(written.labels.items()))
    return _report_of(target, first, written.shape, (spacing, whence, notes), facts, solids, (known, labels))


class _Written:
    """Collects, of an image of shape [z, y, x] that is written slab by slab, its connected parts, {value: voxels}, and
    the three slices of its picture, across z, y and x."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype, solids: list[int]):
        self.shape, self.dtype, self.solids = shape, dtype, solids
        self.found, self.labels, self.layer = SlabConnectivity(), dict[int, int](), 0
        self.cuts = [np.zeros([n for a, n in enumerate(shape) if a != cut], dtype) for cut in range(3)]

    def add(self, values: np.ndarray) -> None:
        """The next slab."""
        self.found.add(is_fluid(values, self.solids))
        for value, count in histogram(values).items():
            self.labels[value] = self.labels.get(value, 0) + count
        layer, (middle, y, x) = self.layer, (n // 2 for n in self.shape)
        if layer <= middle < layer + len(values):
            self.cuts[0][...] = values[middle - layer]
        self.cuts[1][layer : layer + len(values)] = values[:, y]
        self.cuts[2][layer : layer + len(values)] = values[:, :, x]
        self.layer += len(values)


def _changed_slabs(source: Path, how: Conversion, shape: tuple[int, ...], table: Mapping[int, int] | None,
                   written: _Written, facts: dict[str, Any]) -> Iterator[np.ndarray]:
    """The slabs as they are written, which are added to `written`; table: new value of each, None with a threshold,
    which is added to `facts` at the end."""
    block, low, high = int(how.downsample), np.inf, -np.inf
    limits = how.threshold if isinstance(how.threshold, (str, Sequence)) else (how.threshold or 0.0,)
    for image in _slabs(source, how, shape):
        values = image.values
        if table is None:
            low, high = min(low, values.min()), max(high, values.max())
            values, _ = thresholded(values, limits, how.invert, source)
        else:
            values = _looked_up(values, table, written.dtype)
        if len(values) < block:
            continue
        values = np.ascontiguousarray(_coarsened(values, block, written.solids, source), written.dtype)
        written.add(values)
        yield values
    if table is None:
        _, facts["threshold"] = thresholded(np.array([low, high]), limits, how.invert, source)


def _new_values(source: Path, how: Conversion, known: Mapping[int, int]) -> dict[int, int]:
    """{value of the source: value that is written}, with the checks of `inverted` and `_relabelled`."""
    values = {v: v for v in known}
    if how.invert:
        if len(values) != 2:
            inverted(np.array(sorted(values)), source)  # says what is wrong
        low, high = sorted(values)
        values = {low: high, high: low}
    if not how.labels:
        return values
    there = np.array(sorted(set(values.values())))
    renamed = _relabelled(there, how.labels, source)
    new = dict(zip(there.tolist(), renamed.tolist()))
    return {old: int(new[v]) for old, v in values.items()}


def _looked_up(values: np.ndarray, table: Mapping[int, int], dtype: np.dtype) -> np.ndarray:
    """Values by a table, one layer at a time."""
    if all(old == new for old, new in table.items()):
        return values.astype(dtype, copy=False)
    if values.dtype.itemsize <= 2:
        new = np.zeros(256**values.dtype.itemsize, dtype)
        new[list(table)] = list(table.values())
        return new[values]
    result = np.empty(values.shape, dtype)
    for value, replaced in table.items():
        result[values == value] = replaced
    return result


def _append(path: Path, slabs: Iterator[np.ndarray], shape: tuple[int, ...], dtype: np.dtype,
            spacing: Sequence[float] | None) -> None:
    """Write slabs of an image [z, y, x] one behind the other; see `write_image`."""
    suffix, little = path.suffix.lower(), dtype.newbyteorder("<")

    def head(file: Any) -> None:
        np.lib.format.write_array_header_1_0(
            file, {"descr": np.lib.format.dtype_to_descr(little), "fortran_order": False, "shape": shape})

    def into(file: Any) -> None:
        for slab in slabs:
            file.write(np.ascontiguousarray(slab, little).data)

    if suffix == ".npz":
        with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            with archive.open("image.npy", "w", force_zip64=True) as file:
                head(file)
                into(file)
            if spacing is not None:
                with archive.open(f"{SPACING}.npy", "w") as file:
                    np.lib.format.write_array(file, np.asarray(spacing, float), allow_pickle=False)
        return
    if suffix == ".mhd":
        with replacing(path.with_suffix(".raw")) as temporary, open(temporary, "wb") as file:
            into(file)
        write_text(path, _meta_header(path, shape, dtype, spacing))
        return
    with replacing(path) as temporary, open(temporary, "wb") as file:
        if suffix == ".npy":
            head(file)
        elif suffix == ".mha":
            file.write(_meta_header(path, shape, dtype, spacing).encode())
        into(file)


def _solids(how: Conversion) -> list[int]:
    return sorted({int(v) for v in np.ravel(np.asarray(how.solid))})


def _changed(values: np.ndarray, how: Conversion, source: str | Path) -> tuple[np.ndarray, dict[str, Any]]:
    """The labels before they are made coarser, and {name: value} of the steps for the report."""
    facts: dict[str, Any] = {}
    solids = _solids(how)
    if how.threshold is not None:
        limits = how.threshold if isinstance(how.threshold, (str, Sequence)) else (how.threshold,)
        values, facts["threshold"] = thresholded(values, limits, how.invert, source)
    elif how.invert:
        values = inverted(values, source)
    values = _relabelled(values, how.labels, source)
    if how.trim:
        values, cut = trimmed(values, solids, source)
        facts["trimmed"] = cut
    absent = set(how.mirror) - set("xyz"[: values.ndim])
    if absent:
        raise VoxelError(f"{source}: an image of {values.ndim} dimensions has no axis {', '.join(sorted(absent))}")
    values = mirrored(values, how.mirror)
    if how.connected is not None:
        values, facts["filled"] = connected_part(values, solids, how.connected, source)
    return values, facts


def _relabelled(values: np.ndarray, labels: Mapping[int, int], path: str | Path) -> np.ndarray:
    if not labels:
        return values
    found = histogram(values)
    absent = [v for v in labels if v not in found]
    if absent:
        raise VoxelError(f"{path}: no voxel has the value {absent}; it holds {counts_text(found)}")
    if min(labels.values()) < 0 or max(labels.values()) > 255:
        raise VoxelError(f"{path}: new labels {sorted(labels.values())} must lie in 0 to 255")
    result = values.copy()
    for old, new in labels.items():
        result[values == old] = new
    return in_smallest_type(result)


def _coarsened(values: np.ndarray, block: int, solids: Sequence[int], path: str | Path) -> np.ndarray:
    if block == 1:
        return values
    if block < 1 or min(values.shape) < block:
        raise VoxelError(
            f"{path}: downsample {block} must be from 1 to the smallest side {min(values.shape)}"
        )
    found = list(histogram(values))
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
    header = _meta_header(path, values.shape, values.dtype, spacing).encode()
    data = values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()
    local = path.suffix.lower() == ".mha"
    if not local:
        with replacing(path.with_suffix(".raw")) as temporary:
            temporary.write_bytes(data)
    with replacing(path) as temporary:
        temporary.write_bytes(header + data if local else header)


def _meta_header(path: Path, shape: Sequence[int], dtype: np.dtype, spacing: Sequence[float] | None) -> str:
    types = {v: k for k, v in reversed(META_TYPES.items())}
    code = dtype.str[1:]
    if code not in types:
        raise VoxelError(f"{path}: data of type {dtype} cannot be written; use integers or floats")
    lines = {
        "ObjectType": "Image",
        "NDims": len(shape),
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "False",
        **({} if spacing is None else {"ElementSpacing": " ".join(repr(float(s)) for s in spacing)}),
        "DimSize": " ".join(str(n) for n in shape[::-1]),
        "ElementType": types[code],
        "ElementDataFile": "LOCAL" if path.suffix.lower() == ".mha" else path.with_suffix(".raw").name,
    }
    return "".join(f"{key} = {value}\n" for key, value in lines.items())


def written_files(path: str | Path) -> list[Path]:
    """The files that `write_image` writes for a path: itself and, for an mhd, the raw file beside it."""
    path = Path(path)
    return [path, path.with_suffix(".raw")] if path.suffix.lower() == ".mhd" else [path]


def slices_picture(target: str | Path) -> Path:
    """Where the picture of three slices of a converted image goes."""
    target = Path(target)
    return target.with_name(f"{target.stem}_slices.png")


def _refuse_existing(files: Sequence[Path], force: bool) -> None:
    for path in files:
        if os.path.lexists(path) and not force:
            raise VoxelError(f"{path}: exists; choose another name, or replace it with --force")


def _refuse_input(source: str | Path, data_file: str | None, files: Sequence[Path]) -> None:
    """Raises VoxelError where a file to be written is the source itself, under any name; data_file: of an mhd, beside
    it."""
    source = Path(source)
    read = [source] if data_file in (None, "LOCAL") else [source, source.parent / str(data_file)]
    for path in files:
        if any(path.exists() and path.samefile(given) for given in read):
            raise VoxelError(f"{path}: is read from, and cannot be written over; choose another name")
