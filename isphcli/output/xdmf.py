"""Snapshots as HDF5 with an XDMF file that says what is in them: `output.format: xdmf`.

Each snapshot is a file of its own, whole or not there, as those of VTK are; `<name>.xdmf` lists them with their times.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

from .files import SNAPSHOTS, NotFiniteError, Series, field_arrays, replacing, require_finite, write_text

if TYPE_CHECKING:
    from .grid import Grid

POINTS, TOPOLOGY = "points", "topology"  # datasets beside the fields
HEAD = '<?xml version="1.0"?>\n<Xdmf Version="3.0">\n  <Domain>\n'
COLLECTION = '    <Grid Name={} GridType="Collection" CollectionType="Temporal">\n'


class XdmfSeries(Series):
    """As `files.Series`: snapshots `snapshots/<name>_<step>.h5` and the `<name>.xdmf` that lists them."""

    def __init__(self, directory: str | os.PathLike, name: str = "particles", resume_time: float | None = None):
        """See `files.Series`."""
        self.directory, self.name = Path(directory), name
        self.entries: list[tuple[float, str]] = []
        self.parts: dict[str, str] = {}  # what the list says of each file
        (self.directory / SNAPSHOTS).mkdir(parents=True, exist_ok=True)
        if resume_time is not None and self.path.exists():
            for time, file, text in listed(self.path):
                if time <= resume_time:
                    self.entries.append((time, file))
                    self.parts[file] = text
            self._list()

    @property
    def path(self) -> Path:
        """The .xdmf file."""
        return self.directory / f"{self.name}.xdmf"

    def write(self, step: int, time: float, x: np.ndarray, fields: Mapping[str, np.ndarray]) -> Path:
        """Write the particles at `time` (s) and renew the list; returns the path of the snapshot."""
        file = self._file(step, time)
        x, arrays = field_arrays(Path(file), x, fields)
        numbers = np.arange(len(x), dtype=np.int64)[:, None]
        _write_datasets(self.directory / file, {POINTS: x, TOPOLOGY: numbers, **arrays})
        shape = (f'        <Topology TopologyType="Polyvertex" NumberOfElements="{len(x)}" NodesPerElement="1">\n'
                 f"{_item(file, TOPOLOGY, numbers)}        </Topology>\n"
                 f'        <Geometry GeometryType="XYZ">\n{_item(file, POINTS, x)}        </Geometry>\n')
        return self._add(file, time, shape, arrays, 1)

    def write_grid(self, step: int, time: float, grid: Grid) -> Path:
        """As `write`, of a grid: points in the middles of its cells."""
        file = self._file(step, time)
        counts = (*grid.counts, 1)[:3]
        origin = [*(grid.lower + 0.5 * grid.cell), 0.0][:3]
        edges = [*grid.cell, float(grid.cell.min())][:3]
        dim = len(grid.cell)
        arrays = {name: _on_grid(require_finite(f"{file}: {name}", v), dim) for name, v in grid.arrays.items()}
        _write_datasets(self.directory / file, arrays)
        size = " ".join(map(str, counts[::-1]))
        lists = "".join(
            f'          <DataItem Dimensions="3" NumberType="Float" Precision="8" Format="XML">'
            f"{' '.join(repr(float(v)) for v in values[::-1])}</DataItem>\n" for values in (origin, edges))
        shape = (f'        <Topology TopologyType="3DCoRectMesh" Dimensions="{size}"/>\n'
                 f'        <Geometry GeometryType="ORIGIN_DXDYDZ">\n{lists}        </Geometry>\n')
        return self._add(file, time, shape, arrays, 3)

    def _file(self, step: int, time: float) -> str:
        if not math.isfinite(time):
            raise NotFiniteError(f"{self.name}: the time of step {step} is {time}; nothing was written")
        return f"{SNAPSHOTS}/{self.name}_{step:06d}.h5"

    def _add(self, file: str, time: float, shape: str, arrays: Mapping[str, np.ndarray], axes: int) -> Path:
        """Lists a file that was written. axes: of an array, before those of a vector."""
        fields = "".join(
            f'        <Attribute Name={quoteattr(name)} AttributeType="{"Vector" if a.ndim > axes else "Scalar"}" '
            f'Center="Node">\n{_item(file, name, a)}        </Attribute>\n'
            for name, a in arrays.items())
        self.parts[file] = (f'      <Grid Name={quoteattr(self.name)} GridType="Uniform">\n'
                            f'        <Time Value="{float(time)!r}"/>\n{shape}{fields}      </Grid>\n')
        self.entries = [e for e in self.entries if e[1] != file] + [(float(time), file)]
        self._list()
        return self.directory / file

    def _list(self) -> None:
        parts = "".join(self.parts[file] for _, file in self.entries)
        head = f"{HEAD}{COLLECTION.format(quoteattr(self.name))}"
        write_text(self.path, f"{head}{parts}    </Grid>\n  </Domain>\n</Xdmf>\n")


def read_h5(path: str | os.PathLike) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) and fields of the particles of a snapshot; of a grid no points and its arrays."""
    import h5py

    with h5py.File(path) as file:
        arrays = {name: np.asarray(file[name]) for name in file}
    arrays.pop(TOPOLOGY, None)
    return arrays.pop(POINTS, np.zeros((0, 3))), arrays


def listed(path: Path) -> list[tuple[float, str, str]]:
    """(time, file, what the list says of it) of each snapshot."""
    found = []
    for grid in ElementTree.parse(path).iter("Grid"):
        when = grid.find("Time")
        if when is None:
            continue
        items = [(item.text or "").strip() for item in grid.iter("DataItem") if item.get("Format") == "HDF"]
        text = "      " + ElementTree.tostring(grid, encoding="unicode").strip() + "\n"
        found.append((float(when.get("Value", "nan")), items[0].rpartition(":")[0], text))
    return found


def _write_datasets(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """An HDF5 file of some arrays, compressed, whole or not at all."""
    import h5py

    with replacing(path) as temporary, h5py.File(temporary, "w") as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values, compression="gzip", compression_opts=4, shuffle=True)


def _item(file: str, name: str, values: np.ndarray) -> str:
    kind = "Float" if values.dtype.kind == "f" else "UInt" if values.dtype.kind == "u" else "Int"
    if values.dtype.itemsize == 1:
        kind = "UChar" if values.dtype.kind == "u" else "Char"
    size = " ".join(map(str, values.shape))
    return (f'          <DataItem Dimensions="{size}" NumberType="{kind}" Precision="{values.dtype.itemsize}" '
            f'Format="HDF">{file}:/{name}</DataItem>\n')


def _on_grid(values: np.ndarray, dim: int) -> np.ndarray:
    """An array of a grid as [z, y, x] or [z, y, x, 3]; 2D ones get one layer, vectors three components."""
    values = np.asarray(values)
    found: Any = values if dim == 3 else values[None]
    if values.ndim > dim and values.shape[-1] < 3:
        found = np.concatenate([found, np.zeros((*found.shape[:-1], 3 - found.shape[-1]), found.dtype)], axis=-1)
    return np.ascontiguousarray(found)
