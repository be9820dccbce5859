"""Reads TIFF files: a slice or a stack of them, of any number of bits, compressed or not (tifffile)."""

from __future__ import annotations

import logging
import os
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from ..lengths import metres
from .image import Layout, Part, Stored, VoxelError, one_grey, stored_part

MOST_PACKED = 100_000  # bytes of a picture in a byte of its file: zstd makes 796 bytes of a blank slice of 2000^2

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPageSeries


def open_tiff(path: Path, layout: Layout) -> Stored:
    """The largest series of pages of a TIFF file; a voxel size where ImageJ or OME wrote one with its unit."""
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what is wrong is said once, by VoxelError
    size = os.path.getsize(path)
    with tifffile.TiffFile(path) as file:
        _check_chain(path, file)
        if not file.series:
            raise VoxelError(f"{path}: holds no picture; save the stack again")
        which = max(range(len(file.series)), key=lambda k: file.series[k].size)
        series = file.series[which]
        shape, page, dtype = tuple(map(int, series.shape)), series.keyframe, series.dtype
        assert dtype is not None
        dtype = dtype.newbyteorder(file.byteorder)
        spacing = _spacing(file, series, len(shape))
        start, compression = series.dataoffset, tifffile.COMPRESSION(page.compression)
        chunk = int(np.prod(page.chunks, dtype=object)) * dtype.itemsize
        if max(int(np.prod(series.shape, dtype=object)) * dtype.itemsize, chunk) > MOST_PACKED * size:
            raise VoxelError(f"{path}: its header asks for more than {size} bytes can hold; copy it again")
        last = max((p.dataoffsets[-1] + p.databytecounts[-1] for p in series.pages if p and p.dataoffsets), default=0)
        if last > size:
            raise VoxelError(f"{path}: is truncated: its pages go beyond its {size} bytes; copy it again")
        colours, axes = str(series.axes).endswith("S"), str(series.axes)
        pages, several = len(series.pages), len(file.series) > 1
    shape = shape[:-1] if colours else shape
    notes = [f"{path.name}: holds several pictures of different kinds; the largest is taken"] * several
    notes += [f"{path.name}: has channels that hold the same grey; one of them is taken"] * colours

    @contextmanager
    def data() -> Iterator[BinaryIO]:
        with open(path, "rb") as stream:
            stream.seek(start or 0)  # None: not in one piece, and not read so
            yield stream

    def by_pages(keep: Part) -> np.ndarray:
        with tifffile.TiffFile(path) as file:
            series = file.series[which]
            try:
                if len(shape) == 3 and pages == shape[0]:
                    wanted = range(keep[0].start, keep[0].stop)
                    return np.stack([_page(path, series, k, shape[1:], colours)[keep[1:]] for k in wanted])
                values = series.asarray()
                return (one_grey(path, values) if colours else values)[keep]
            except (AttributeError, ImportError, ValueError) as error:
                if "imagecodecs" in str(error) or isinstance(error, ImportError):
                    raise VoxelError(
                        f"{path}: is stored in a way ({compression.name}, {page.bitspersample} bits a voxel) that "
                        "the package imagecodecs reads: pip install imagecodecs, or save it in 8 or 16 bits, plain or "
                        "with deflate"
                    ) from None
                raise

    plain = not colours and start is not None and compression == 1 and dtype.itemsize * 8 == page.bitspersample
    part = stored_part(path, data, dtype, shape) if plain else by_pages
    return Stored(shape, dtype, part, spacing, info={"format": "TIFF", "axes": axes}, warnings=tuple(notes))


def _check_chain(path: Path, file: TiffFile) -> None:
    """Raises VoxelError where the chain of pages is broken: each has the offset of the next, the last one 0, and
    tifffile stops without an error at a page that is cut off."""
    form, last = file.tiff, file.pages[len(file.pages) - 1]
    assert last is not None
    file.filehandle.seek(last.offset)
    (tags,) = struct.unpack(form.tagnoformat, file.filehandle.read(form.tagnosize))
    file.filehandle.seek(tags * form.tagsize, os.SEEK_CUR)
    (after,) = struct.unpack(form.offsetformat, file.filehandle.read(form.offsetsize))
    if after:
        raise VoxelError(f"{path}: is truncated: no page behind the first {len(file.pages)} can be read; copy it again")


def _page(path: Path, series: TiffPageSeries, k: int, shape: tuple[int, ...], colours: bool) -> np.ndarray:
    page = series.pages[k]
    if page is None:
        raise VoxelError(f"{path}: has no slice {k}; copy it again")
    values = one_grey(path, page.asarray()) if colours else page.asarray()
    if values.shape != shape:
        raise VoxelError(f"{path}: slice {k} has the shape {values.shape}, the others {shape}; save it again")
    return values


def _spacing(file: TiffFile, series: TiffPageSeries, dim: int) -> tuple[float, ...] | None:
    """Edges of a voxel x, y(, z), m: of an ImageJ or OME description; the resolution of other files is for printing."""
    if file.is_imagej and file.imagej_metadata is not None:
        unit = metres(str(file.imagej_metadata.get("unit", "")))
        tags = file.pages.first.tags
        found = [tags.get(name) for name in ("XResolution", "YResolution")]
        if unit is None or any(tag is None or not tag.value[0] for tag in found):
            return None
        edges = [tag.value[1] / tag.value[0] * unit for tag in found if tag is not None]
        edges += [abs(float(file.imagej_metadata.get("spacing", 0.0))) * unit] if dim == 3 else []
        return tuple(edges) if min(edges) > 0.0 else None
    if file.is_ome and file.ome_metadata is not None:
        text = file.ome_metadata
        pixels = None if "<!ENTITY" in text else ElementTree.fromstring(text).find(".//{*}Pixels")
        if pixels is None:
            return None
        edges = []
        for axis in "XYZ"[:dim]:
            size = pixels.get(f"PhysicalSize{axis}")
            unit = metres(pixels.get(f"PhysicalSize{axis}Unit", "um"))
            if size is None or unit is None or not float(size) > 0.0:
                return None
            edges.append(float(size) * unit)
        return tuple(edges)
    return None
