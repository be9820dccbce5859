"""Fields on a grid: particles -> the middles of cells of one size, and VTI files of them.

ParaView takes streamlines, contours and slices of a VTI (image data) as it is; of particles it first needs a mesh.
"""

from __future__ import annotations

import base64
import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from scipy.spatial import cKDTree

from .files import replacing, require_finite

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry

UNITS = {"velocity": "m/s", "pressure": "Pa", "distance": "m", "divergence": "1/s"}
REACH = 1.8  # spacings within which particles count for the middle of a cell: those of its corners, and the next ones
AT_ONCE = 100_000  # cells that are fitted in one go: bounds the memory
BLOCK = 1 << 20  # bytes that are compressed together
TYPES = {"f8": "Float64", "i4": "Int32", "u1": "UInt8"}


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


def make_grid(geometry: Geometry, x: np.ndarray, fields: Mapping[str, np.ndarray], spacing: float,
              cell: float | np.ndarray | None = None) -> Grid:
    """The fields of the fluid particles on a grid over the box of a scene.

    x: (n, dim) m; fields: {name: (n,) or (n, dim)}, integers are taken of the nearest particle; spacing: of the
    particles, m; cell: edges of the cells, m, made to fit the box a whole number of times; without it the spacing.

    A cell whose middle is the place of a particle takes its values. Others take those in their middle of a linear
    function, fitted to the particles within REACH that no wall hides, with the inverse squares of the distances as
    weights: linear fields are exact. It keeps within the range of these particles. Of none, zero.
    """
    length = geometry.upper - geometry.lower
    counts = np.maximum(np.rint(length / (spacing if cell is None else cell)).astype(int), 1)
    edges = length / counts
    shape = tuple(counts[::-1])
    solid = np.ones(shape, np.uint8)
    arrays = {name: np.zeros((*shape, *v.shape[1:]), np.int32 if v.dtype.kind in "iub" else float)
              for name, v in fields.items()}
    if "phase" in arrays:
        arrays["phase"][:] = -1
    flat = {name: a.reshape(-1, *a.shape[len(shape):]) for name, a in arrays.items()}
    inside = np.mod(x - geometry.lower, length)
    periodic = np.array(geometry.periodic)
    tree = cKDTree(np.where(periodic, np.where(inside >= length, 0.0, inside), x - geometry.lower),
                   boxsize=np.where(periodic, length, 0.0))
    total = int(counts.prod())
    for first in range(0, total, AT_ONCE):
        number = np.arange(first, min(first + AT_ONCE, total))
        index = np.stack(np.unravel_index(number, shape)[::-1], axis=1)
        middle = (index + 0.5) * edges
        fluid = geometry.phase(geometry.lower + middle) >= 0
        solid.reshape(-1)[number] = ~fluid
        _fill(flat, fields, (number[fluid], middle[fluid]), tree, geometry, spacing)
    return Grid(np.array(geometry.lower), edges, {**arrays, "solid": solid})


def _fill(flat: dict[str, np.ndarray], fields: Mapping[str, np.ndarray], cells: tuple[np.ndarray, np.ndarray],
          tree: cKDTree, geometry: Geometry, spacing: float) -> None:
    """The values of some cells, numbers (m,) and middles (m, dim) from the corner of the box, into `flat`."""
    number, middle = cells
    if not len(number):
        return
    dim = middle.shape[1]
    away, which = tree.query(middle, k=min(2 ** (dim + 1), tree.n), distance_upper_bound=REACH * spacing)
    away, which = away.reshape(len(number), -1), which.reshape(len(number), -1)
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
    near = np.argmax(seen, axis=1)  # they come by their distance
    every, some = np.arange(len(number)), seen.any(axis=1)
    nearest = which[every, near]
    fitted = _Fit(np.nonzero(some & ~there)[0], which, step / spacing, seen)
    for name, values in fields.items():
        found = np.zeros((len(number), *values.shape[1:]), flat[name].dtype)
        found[some] = values[nearest[some]]
        if values.dtype.kind not in "iub":
            found[fitted.cells] = fitted(values)
        flat[name][number[some]] = found[some]


class _Fit:
    """Linear functions through what the particles around some cells have, in the middles of these cells.

    cells: (k,) rows of which; which: (m, q) particles; step: (m, q, dim) from the middles, in spacings; seen: (m, q).
    """

    def __init__(self, cells: np.ndarray, which: np.ndarray, step: np.ndarray, seen: np.ndarray):
        self.cells, self.which, self.seen = cells, which[cells], seen[cells]
        step = step[cells]
        weight = np.where(self.seen, 1.0 / np.maximum((step**2).sum(axis=2), 1e-12), 0.0)
        terms = np.concatenate([np.ones((*step.shape[:2], 1)), step], axis=2)
        normal = np.einsum("mq,mqa,mqb->mab", weight, terms, terms)
        size = terms.shape[2]
        # particles on a plane or a line leave slopes open, which are then taken as none
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


def write_vti(path: str | os.PathLike, grid: Grid, time: float | None = None) -> None:
    """Write a grid as VTK image data: points in the middles of the cells, so that streamlines pass pores one cell wide.

    Vectors have three components; 2D grids one layer. The units (`UNITS`) are in the file, as ParaView reads them;
    time: s. Raises NotFiniteError for NaN or infinity.
    """
    counts = (*grid.counts, 1)[:3]
    origin = [*(grid.lower + 0.5 * grid.cell), 0.0][:3]
    spacing = [*grid.cell, float(grid.cell.min())][:3]
    extent = " ".join(f"0 {n - 1}" for n in counts)
    entries, blobs, offset = [], [], 0
    for name, values in grid.arrays.items():
        data, components = _columns(require_finite(name, values), len(grid.cell))
        key = "" if name not in UNITS else (
            f'<InformationKey name="UNITS_LABEL" location="vtkDataArray">{escape(UNITS[name])}</InformationKey>')
        entries.append(f'        <DataArray type="{TYPES[data.dtype.str[1:]]}" Name={quoteattr(name)} '
                       f'NumberOfComponents="{components}" format="appended" offset="{offset}">{key}</DataArray>\n')
        blobs.append(_compressed(data.tobytes()))
        offset += len(blobs[-1])
    when = "" if time is None else (
        '    <FieldData>\n      <DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">'
        f"{time!r}</DataArray>\n    </FieldData>\n")
    head = (
        '<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor">\n'
        f'  <ImageData WholeExtent="{extent}" Origin="{" ".join(map(repr, map(float, origin)))}" '
        f'Spacing="{" ".join(map(repr, map(float, spacing)))}">\n{when}'
        f'    <Piece Extent="{extent}">\n      <PointData Vectors="velocity">\n{"".join(entries)}'
        '      </PointData>\n      <CellData/>\n    </Piece>\n  </ImageData>\n  <AppendedData encoding="base64">\n_')
    with replacing(path) as temporary:
        temporary.write_bytes(head.encode() + b"".join(blobs) + b"\n  </AppendedData>\n</VTKFile>\n")


def _columns(values: np.ndarray, dim: int) -> tuple[np.ndarray, int]:
    """(values in the order of the file, little-endian, number of components); vectors get three."""
    kind = {"f": "<f8", "i": "<i4", "u": "|u1", "b": "|u1"}[values.dtype.kind]
    if values.ndim == dim:
        return np.ascontiguousarray(values, kind), 1
    padded = np.zeros((*values.shape[:-1], 3), kind)
    padded[..., : values.shape[-1]] = values
    return padded, 3


def _compressed(data: bytes) -> bytes:
    """Bytes as VTK has them, in compressed blocks behind a header of their sizes, base64."""
    blocks = [zlib.compress(data[first : first + BLOCK]) for first in range(0, len(data), BLOCK)]
    sizes = [len(blocks), BLOCK, len(data) % BLOCK, *map(len, blocks)]
    return base64.b64encode(struct.pack(f"<{len(sizes)}Q", *sizes)) + base64.b64encode(b"".join(blocks))
