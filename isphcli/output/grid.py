"""Fields on a grid: particles -> the middles of cells of one size, and VTI files of them.

ParaView takes streamlines, contours and slices of a VTI (image data) as it is; of particles it first needs a mesh.
"""

from __future__ import annotations

import base64
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from scipy.spatial import cKDTree

from ..domain.communicator import current
from .files import replacing, require_finite

if TYPE_CHECKING:
    from ..domain.cut import Share
    from ..geometry.protocol import Geometry

UNITS = {"velocity": "m/s", "pressure": "Pa", "distance": "m", "divergence": "1/s"}
REACH = 1.8  # spacings within which particles count for the middle of a cell: those of its corners, and the next ones
AT_ONCE = 100_000  # cells that are fitted in one go: bounds the memory
BLOCK = 1 << 20  # bytes that are compressed together
TYPES = {"f8": "Float64", "i4": "Int32", "u1": "UInt8"}


@dataclass(frozen=True)
class GridCells:
    """The cells of one size that fill a box. lower: (dim,) m, corner of the box; edges: (dim,) m, of a cell; counts:
    (dim,) int along x, y(, z)."""

    lower: np.ndarray
    edges: np.ndarray
    counts: np.ndarray

    @staticmethod
    def of(geometry: Geometry, spacing: float, cell: float | np.ndarray | None = None) -> GridCells:
        """Those of the box of a scene. cell: edges, m, made to fit the box a whole number of times; without it the
        spacing, m."""
        length = geometry.upper - geometry.lower
        counts = np.maximum(np.rint(length / (spacing if cell is None else cell)).astype(int), 1)
        return GridCells(np.array(geometry.lower), length / counts, counts)

    @property
    def shape(self) -> tuple[int, ...]:
        """Of an array, [z, y, x] or [y, x]."""
        return tuple(self.counts[::-1])

    def middles(self, number: np.ndarray) -> np.ndarray:
        """(m, dim) m from the corner of the box, of cells (m,) by their place in an array."""
        return (np.stack(np.unravel_index(number, self.shape)[::-1], axis=1) + 0.5) * self.edges


@dataclass(frozen=True)
class Grid:
    """Fields in the middles of the cells that fill the box of a scene.

    lower: (dim,) m, corner of the box; cell: (dim,) m, edges of a cell; arrays: {name: [z, y, x] or [y, x]}, vectors
    with their components last. `solid` is 1 where the middle of a cell lies in a solid, all other fields are 0 there,
    but `phase`, which is -1. A pocket in which no particles were placed has zeros, too.
    """

    lower: np.ndarray
    cell: np.ndarray
    arrays: dict[str, np.ndarray]

    @property
    def counts(self) -> tuple[int, ...]:
        """Cells along x, y(, z)."""
        return self.arrays["solid"].shape[::-1]

    def in_parts(self) -> GridParts:
        """The same, layer by layer."""
        fields = {name: (v.dtype, v.shape[len(self.cell):]) for name, v in self.arrays.items()}
        layout = GridLayout(GridCells(self.lower, self.cell, np.array(self.counts)), fields)
        layers = len(self.arrays["solid"])
        deep = max(AT_ONCE * layers // self.arrays["solid"].size, 1)
        return GridParts(layout, ({name: v[low : low + deep] for name, v in self.arrays.items()}
                              for low in range(0, layers, deep)))


@dataclass(frozen=True)
class GridLayout:
    """A grid without its values. fields: {name: (type, components)}, () of a scalar."""

    cells: GridCells
    fields: dict[str, tuple[np.dtype, tuple[int, ...]]]


@dataclass(frozen=True)
class GridParts:
    """A grid in parts: layers of its cells along the last axis, one part after the other, so that no process
    holds the whole. values: of each part the arrays of all fields, [z, y, x, ...] or [y, x, ...]. Of several processes
    all iterate over them together; only rank 0 has arrays that are not empty."""

    layout: GridLayout
    values: Iterator[dict[str, np.ndarray]]

    def in_parts(self) -> GridParts:
        """Itself."""
        return self


def make_grid(geometry: Geometry, x: np.ndarray, fields: Mapping[str, np.ndarray], spacing: float,
              cell: float | np.ndarray | None = None) -> Grid:
    """The fields of the fluid particles on a grid over the box of a scene.

    x: (n, dim) m; fields: {name: (n,) or (n, dim)}, integers are taken of the nearest particle; spacing: of the
    particles, m; cell: edges of the cells, m, made to fit the box a whole number of times; without it the spacing.

    A cell whose middle is the place of a particle takes its values. Others take those in their middle of a linear
    function, fitted to the particles within REACH that no wall hides, with the inverse squares of the distances as
    weights: linear fields are exact. It keeps within the range of these particles. Of none, zero.
    """
    values = _Values(geometry, x, fields, spacing, GridCells.of(geometry, spacing, cell))
    cells, total = values.layout.cells, int(values.layout.cells.counts.prod())
    arrays = _empty(values.layout, cells.shape)
    for first in range(0, total, AT_ONCE):
        number = np.arange(first, min(first + AT_ONCE, total))
        for name, found in values(number).items():
            arrays[name].reshape(-1, *found.shape[1:])[number] = found
    return Grid(cells.lower, cells.edges, arrays)


def _empty(layout: GridLayout, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Arrays of some cells that are all solid."""
    arrays = {name: np.zeros((*shape, *components), kind) for name, (kind, components) in layout.fields.items()}
    arrays["solid"][:] = 1
    if "phase" in arrays:
        arrays["phase"][:] = -1
    return arrays


class _Values:
    """Fields in the middles of cells. Arguments as those of `make_grid`."""

    def __init__(self, geometry: Geometry, x: np.ndarray, fields: Mapping[str, np.ndarray], spacing: float,
                 cells: GridCells):
        self.geometry, self.fields, self.spacing = geometry, fields, spacing
        self.layout = GridLayout(cells, {name: (np.dtype(np.int32 if v.dtype.kind in "iub" else float), v.shape[1:])
                                     for name, v in fields.items()} | {"solid": (np.dtype(np.uint8), ())})
        length = geometry.upper - geometry.lower
        inside = np.mod(x - geometry.lower, length)
        periodic = np.array(geometry.periodic)
        self.tree = cKDTree(np.where(periodic, np.where(inside >= length, 0.0, inside), x - geometry.lower),
                            boxsize=np.where(periodic, length, 0.0))

    def __call__(self, number: np.ndarray) -> dict[str, np.ndarray]:
        """{name: (m, ...)} of cells (m,), by their place in an array."""
        found = _empty(self.layout, (len(number),))
        middle = self.layout.cells.middles(number)
        fluid = np.flatnonzero(self.geometry.phase(self.geometry.lower + middle) >= 0)
        found["solid"][fluid] = 0
        if len(fluid) and self.tree.n:
            self._fill(found, fluid, middle[fluid])
        return found

    def _fill(self, out: dict[str, np.ndarray], rows: np.ndarray, middle: np.ndarray) -> None:
        """The values in middles (m, dim), from the corner of the box, into rows (m,) of `out`."""
        geometry, tree, spacing, dim = self.geometry, self.tree, self.spacing, middle.shape[1]
        away, which = tree.query(middle, k=min(2 ** (dim + 1), tree.n), distance_upper_bound=REACH * spacing)
        away, which = away.reshape(len(rows), -1), which.reshape(len(rows), -1)
        seen = which < tree.n
        which = np.where(seen, which, 0)
        there = away[:, 0] < 1e-6 * spacing
        step = tree.data[which] - middle[:, None]
        length = geometry.upper - geometry.lower
        step -= np.where(geometry.periodic, np.rint(step / length) * length, 0.0)
        if geometry.has_solid:
            asked = np.nonzero(seen & ~there[:, None])
            start = geometry.lower + middle[asked[0]]
            seen[asked] = geometry.crossing(start, start + step[asked]) >= 1.0
        near = np.argmax(seen, axis=1)  # particles are sorted by their distance
        every, some = np.arange(len(rows)), seen.any(axis=1)
        nearest = which[every, near]
        fitted = _Fit(np.nonzero(some & ~there)[0], which, step / spacing, seen)
        for name, values in self.fields.items():
            found = np.zeros((len(rows), *values.shape[1:]), out[name].dtype)
            found[some] = values[nearest[some]]
            if values.dtype.kind not in "iub":
                found[fitted.cells] = fitted(values)
            out[name][rows[some]] = found[some]


class _Fit:
    """Linear functions fitted to the values of particles around some cells, in the middles of these cells.

    cells: (k,) rows of which; which: (m, q) particles; step: (m, q, dim) from the middles, in spacings; seen: (m, q).
    """

    def __init__(self, cells: np.ndarray, which: np.ndarray, step: np.ndarray, seen: np.ndarray):
        self.cells, self.which, self.seen = cells, which[cells], seen[cells]
        step = step[cells]
        weight = np.where(self.seen, 1.0 / np.maximum((step**2).sum(axis=2), 1e-12), 0.0)
        terms = np.concatenate([np.ones((*step.shape[:2], 1)), step], axis=2)
        normal = np.einsum("mq,mqa,mqb->mab", weight, terms, terms)
        size = terms.shape[2]
        # particles on a plane or a line do not determine all slopes: the others are then zero
        normal[:, range(1, size), range(1, size)] += 1e-9 * normal[:, :1, 0]
        first = np.zeros((len(cells), size, 1))
        first[:, 0] = 1.0
        middle = np.linalg.solve(normal, first)[:, :, 0] if len(cells) else first[:, :, 0]
        self.share = weight * np.einsum("mqa,ma->mq", terms, middle)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """The values in the middles, (k,) or (k, dim), of values (n,) or (n, dim) of the particles."""
        known = values[self.which]
        seen = self.seen if values.ndim == 1 else self.seen[:, :, None]
        found = np.einsum("mq,mq...->m...", self.share, known)
        return np.clip(found, np.where(seen, known, np.inf).min(axis=1), np.where(seen, known, -np.inf).max(axis=1))


def grid_in_parts(geometry: Geometry, x: np.ndarray, fields: Mapping[str, np.ndarray], spacing: float,
                  cell: float | np.ndarray | None, share: Share) -> GridParts:
    """As `make_grid`, of several processes: each finds the values of the cells in its brick from its own particles and
    those beside it, rank 0 gathers layer by layer. x, fields: of the own particles; share: of this process."""
    from ..domain.migration import Migration

    reach = REACH * spacing
    near = Migration(share, geometry.lower, geometry.upper, geometry.periodic, reach).around(x, np.arange(len(x)))
    known = {name: near.exchange.forward(np.ascontiguousarray(v)) for name, v in fields.items()}
    values = _Values(geometry, np.concatenate([x, near.ghosts]), known, spacing, GridCells.of(geometry, spacing, cell))
    return GridParts(values.layout, _gathered(values, share))


def _gathered(values: _Values, share: Share) -> Iterator[dict[str, np.ndarray]]:
    """Layers of a grid, about AT_ONCE cells each, on rank 0; empty ones on the others."""
    ranks, cells = current(), values.layout.cells
    layer = int(np.prod(cells.counts[:-1]))
    deep = max(AT_ONCE // layer, 1)
    # the cells of the own brick lie in a box of cells, taken one cell larger on each side
    first = np.clip(np.floor((share.lower - cells.lower) / cells.edges - 0.5).astype(int), 0, cells.counts)
    end = np.clip(np.ceil((share.upper - cells.lower) / cells.edges + 0.5).astype(int), 0, cells.counts)
    for low in range(0, int(cells.counts[-1]), deep):
        high = min(low + deep, int(cells.counts[-1]))
        sides = [np.arange(a, b) for a, b in zip(first, end)]
        sides[-1] = np.arange(max(low, first[-1]), min(high, end[-1]))
        index = np.meshgrid(*sides[::-1], indexing="ij")
        number = np.ravel_multi_index([axis.ravel() for axis in index], cells.shape)
        number = number[share.cut.owner(cells.lower + cells.middles(number)) == ranks.rank]
        found = ranks.gather((number - low * layer, values(number)))
        shape = (high - low if ranks.rank == 0 else 0, *cells.shape[1:])
        arrays = _empty(values.layout, shape)
        for place, part in found or []:
            for name, of_part in part.items():
                arrays[name].reshape(-1, *of_part.shape[1:])[place] = of_part
        yield arrays


def write_vti(path: str | os.PathLike, grid: Grid | GridParts, time: float | None = None) -> None:
    """Write a grid as VTK image data: points in the middles of the cells, so that streamlines pass pores one cell wide.

    Vectors have three components; 2D grids one layer. The units (`UNITS`) are in the file, as ParaView reads them;
    time: s. Of several processes all call it, with GridParts, and rank 0 writes. Raises NotFiniteError for NaN or
    infinity.
    """
    parts = grid.in_parts()
    if current().rank > 0:
        for _ in parts.values:
            pass
        return
    with replacing(path) as temporary, ExitStack() as files:
        blocks = {name: _Compressed(files.enter_context(TemporaryFile(dir=temporary.parent)))
                  for name in parts.layout.fields}
        for arrays in parts.values:
            for name, values in arrays.items():
                blocks[name].add(_columns(require_finite(name, values), len(parts.layout.cells.counts)).tobytes())
        with open(temporary, "wb") as out:
            out.write(_vti_head(parts.layout, {name: of.end() for name, of in blocks.items()}, time).encode())
            for of in blocks.values():
                of.write_to(out)
            out.write(b"\n  </AppendedData>\n</VTKFile>\n")


def _vti_head(layout: GridLayout, sizes: Mapping[str, int], time: float | None) -> str:
    """The XML before the values. sizes: bytes of each field in the file."""
    cells, dim = layout.cells, len(layout.cells.counts)
    counts = (*cells.counts.tolist(), 1)[:3]
    origin = [*(cells.lower + 0.5 * cells.edges), 0.0][:3]
    spacing = [*cells.edges, float(cells.edges.min())][:3]
    extent = " ".join(f"0 {n - 1}" for n in counts)
    entries, offset = [], 0
    for name, (kind, components) in layout.fields.items():
        data = _columns(np.zeros((0,) * dim + components, kind), dim)
        key = "" if name not in UNITS else (
            f'<InformationKey name="UNITS_LABEL" location="vtkDataArray">{escape(UNITS[name])}</InformationKey>')
        entries.append(f'        <DataArray type="{TYPES[data.dtype.str[1:]]}" Name={quoteattr(name)} '
                       f'NumberOfComponents="{3 if components else 1}" format="appended" offset="{offset}">{key}'
                       "</DataArray>\n")
        offset += sizes[name]
    when = "" if time is None else (
        '    <FieldData>\n      <DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">'
        f"{time!r}</DataArray>\n    </FieldData>\n")
    return (
        '<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor">\n'
        f'  <ImageData WholeExtent="{extent}" Origin="{" ".join(map(repr, map(float, origin)))}" '
        f'Spacing="{" ".join(map(repr, map(float, spacing)))}">\n{when}'
        f'    <Piece Extent="{extent}">\n      <PointData Vectors="velocity">\n{"".join(entries)}'
        '      </PointData>\n      <CellData/>\n    </Piece>\n  </ImageData>\n  <AppendedData encoding="base64">\n_')


def _columns(values: np.ndarray, dim: int) -> np.ndarray:
    """Values in the order of the file, little-endian; vectors get three components."""
    kind = {"f": "<f8", "i": "<i4", "u": "|u1", "b": "|u1"}[values.dtype.kind]
    if values.ndim == dim:
        return np.ascontiguousarray(values, kind)
    padded = np.zeros((*values.shape[:-1], 3), kind)
    padded[..., : values.shape[-1]] = values
    return padded


class _Compressed:
    """Bytes in the encoding of VTK: compressed blocks behind a header of their sizes, base64. spool: an open file for
    the blocks, whose sizes are known at the end only."""

    def __init__(self, spool: IO[bytes]):
        self.spool, self.sizes, self.rest, self.length = spool, list[int](), b"", 0

    def add(self, data: bytes) -> None:
        """Bytes behind those that came before."""
        self.length += len(data)
        data = self.rest + data
        whole = len(data) // BLOCK * BLOCK
        for first in range(0, whole, BLOCK):
            self._block(data[first : first + BLOCK])
        self.rest = data[whole:]

    def _block(self, data: bytes) -> None:
        self.sizes.append(self.spool.write(zlib.compress(data)))

    def end(self) -> int:
        """Compresses the last block; returns the number of bytes that `write_to` writes."""
        if self.rest:
            self._block(self.rest)
        return sum(4 * -(-length // 3) for length in (8 * (3 + len(self.sizes)), sum(self.sizes)))

    def write_to(self, out: IO[bytes]) -> None:
        """The header and the blocks."""
        sizes = [len(self.sizes), BLOCK, self.length % BLOCK, *self.sizes]
        out.write(base64.b64encode(struct.pack(f"<{len(sizes)}Q", *sizes)))
        self.spool.seek(0)
        while data := self.spool.read(3 * BLOCK):  # base64 has no padding but at the end
            out.write(base64.b64encode(data))
