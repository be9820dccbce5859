"""Snapshots as HDF5 with an XDMF file that describes them: `output.format: xdmf`.

Each snapshot is a file of its own, whole or not there, as those of VTK are; `<name>.xdmf` lists them with their times.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

from ..domain.communicator import current, on_first
from .files import SNAPSHOTS, NotFiniteError, Series, field_arrays, replacing, require_finite, write_text

if TYPE_CHECKING:
    from .grid import Grid, GridParts

POINTS, TOPOLOGY = "points", "topology"  # datasets beside the fields
HEAD = '<?xml version="1.0"?>\n<Xdmf Version="3.0">\n  <Domain>\n'
Kinds = Mapping[str, tuple[tuple[int, ...], np.dtype]]  # shape and type of arrays by their names
COLLECTION = '    <Grid Name={} GridType="Collection" CollectionType="Temporal">\n'


class XdmfSeries(Series):
    """As `files.Series`: snapshots `snapshots/<name>_<step>.h5` and the `<name>.xdmf` that lists them."""

    def __init__(self, directory: str | os.PathLike, name: str = "particles", resume_time: float | None = None):
        """See `files.Series`."""
        self.directory, self.name = Path(directory), name
        self.entries: list[tuple[float, str]] = []
        self.parts: dict[str, str] = {}  # entry of each file in the list
        (self.directory / SNAPSHOTS).mkdir(parents=True, exist_ok=True)
        if resume_time is not None and on_first(self.path.exists):
            for time, file, text in on_first(lambda: listed(self.path)):
                if time <= resume_time:
                    self.entries.append((time, file))
                    self.parts[file] = text
            self._list()

    @property
    def path(self) -> Path:
        """The .xdmf file."""
        return self.directory / f"{self.name}.xdmf"

    def write(self, step: int, time: float, x: np.ndarray, fields: Mapping[str, np.ndarray]) -> Path:
        """Write the particles at `time` (s) and renew the list; returns the path of the snapshot. Of several processes
        rank 0 writes, and gets from the others theirs, one after the other."""
        file = self._file(step, time)
        points, arrays = field_arrays(Path(file), x, fields) if len(x) or current().size == 1 else (None, {})
        own = {} if points is None else {POINTS: points, TOPOLOGY: np.zeros((len(x), 1), np.int64), **arrays}
        before = sum(current().collect(len(x))[: current().rank])
        if own:
            own[TOPOLOGY][:, 0] = np.arange(before, before + len(x))
        have = [known for known in current().collect({name: (v.shape[1:], v.dtype) for name, v in own.items()})
                if known]
        number = int(current().sum(len(x)))
        kinds = {name: ((number, *have[0][name][0]), have[0][name][1])
                 for name in have[0] if all(name in known for known in have)}
        fields_of = {name: kind for name, kind in kinds.items() if name not in (POINTS, TOPOLOGY)}
        _write_datasets(self.directory / file, kinds, _from_all(own))
        shape = (f'        <Topology TopologyType="Polyvertex" NumberOfElements="{number}" NodesPerElement="1">\n'
                 f"{_item(file, TOPOLOGY, *kinds[TOPOLOGY])}        </Topology>\n"
                 f'        <Geometry GeometryType="XYZ">\n{_item(file, POINTS, *kinds[POINTS])}        </Geometry>\n')
        return self._add(file, time, shape, fields_of, 1)

    def write_grid(self, step: int, time: float, grid: Grid | GridParts) -> Path:
        """As `write`, of a grid: points in the middles of its cells."""
        file, parts = self._file(step, time), grid.in_parts()
        cells, dim = parts.layout.cells, len(parts.layout.cells.counts)
        counts = (*cells.counts.tolist(), 1)[:3]
        origin = [*(cells.lower + 0.5 * cells.edges), 0.0][:3]
        edges = [*cells.edges, float(cells.edges.min())][:3]
        kinds = {name: ((*counts[::-1], *((3,) if components else ())), kind)
                 for name, (kind, components) in parts.layout.fields.items()}
        # the layers of a 2D grid are its second axis: it has one along z
        layers = ({name: _on_grid(require_finite(f"{file}: {name}", v), dim) for name, v in of.items()}
                  for of in parts.values)
        _write_datasets(self.directory / file, kinds, layers, axis=3 - dim)
        size = " ".join(map(str, counts[::-1]))
        lists = "".join(
            f'          <DataItem Dimensions="3" NumberType="Float" Precision="8" Format="XML">'
            f"{' '.join(repr(float(v)) for v in values[::-1])}</DataItem>\n" for values in (origin, edges))
        shape = (f'        <Topology TopologyType="3DCoRectMesh" Dimensions="{size}"/>\n'
                 f'        <Geometry GeometryType="ORIGIN_DXDYDZ">\n{lists}        </Geometry>\n')
        return self._add(file, time, shape, kinds, 3)

    def _file(self, step: int, time: float) -> str:
        if not math.isfinite(time):
            raise NotFiniteError(f"{self.name}: the time of step {step} is {time}; nothing was written")
        return f"{SNAPSHOTS}/{self.name}_{step:06d}.h5"

    def _add(self, file: str, time: float, shape: str, kinds: Kinds, axes: int) -> Path:
        """Lists a file that was written. axes: of an array, before those of a vector."""
        fields = "".join(
            f'        <Attribute Name={quoteattr(name)} AttributeType="{"Vector" if len(of[0]) > axes else "Scalar"}" '
            f'Center="Node">\n{_item(file, name, *of)}        </Attribute>\n'
            for name, of in kinds.items())
        self.parts[file] = (f'      <Grid Name={quoteattr(self.name)} GridType="Uniform">\n'
                            f'        <Time Value="{float(time)!r}"/>\n{shape}{fields}      </Grid>\n')
        self.entries = [e for e in self.entries if e[1] != file] + [(float(time), file)]
        self._list()
        return self.directory / file

    def _list(self) -> None:
        parts = "".join(self.parts[file] for _, file in self.entries)
        head = f"{HEAD}{COLLECTION.format(quoteattr(self.name))}"
        on_first(lambda: write_text(self.path, f"{head}{parts}    </Grid>\n  </Domain>\n</Xdmf>\n"))


def read_h5(path: str | os.PathLike) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) and fields of the particles of a snapshot; of a grid no points and its arrays."""
    import h5py

    with h5py.File(path) as file:
        arrays = {name: np.asarray(file[name]) for name in file}
    arrays.pop(TOPOLOGY, None)
    return arrays.pop(POINTS, np.zeros((0, 3))), arrays


def listed(path: Path) -> list[tuple[float, str, str]]:
    """(time, file, its entry) of each snapshot in the list."""
    found = []
    for grid in ElementTree.parse(path).iter("Grid"):
        when = grid.find("Time")
        if when is None:
            continue
        items = [(item.text or "").strip() for item in grid.iter("DataItem") if item.get("Format") == "HDF"]
        text = "      " + ElementTree.tostring(grid, encoding="unicode").strip() + "\n"
        found.append((float(when.get("Value", "nan")), items[0].rpartition(":")[0], text))
    return found


def _from_all(own: dict[str, np.ndarray]) -> Iterator[dict[str, np.ndarray]]:
    """The arrays of all processes, one process after the other, on rank 0; on the others nothing."""
    ranks = current()
    if ranks.rank > 0:
        ranks.raw.send(own, dest=0)  # type: ignore[attr-defined]
        return
    yield own
    for other in range(1, ranks.size):
        yield ranks.raw.recv(source=other)  # type: ignore[attr-defined]


def _write_datasets(path: Path, kinds: Kinds, parts: Iterator[dict[str, np.ndarray]], axis: int = 0) -> None:
    """An HDF5 file of some arrays, compressed, whole or not at all. parts: of them, which follow each other along an
    axis. Of several processes rank 0 writes what comes there, and the others go through their parts."""
    if current().rank > 0:
        for _ in parts:
            pass
        return
    import h5py

    with replacing(path) as temporary, h5py.File(temporary, "w") as file:
        sets = {name: file.create_dataset(name, shape, kind, compression="gzip", compression_opts=4, shuffle=True)
                for name, (shape, kind) in kinds.items()}
        first = 0
        for part in parts:
            if not part:  # of a process without particles
                continue
            for name, found in sets.items():
                end = first + part[name].shape[axis]
                found[(*(slice(None),) * axis, slice(first, end))] = part[name]
            first = end


def _item(file: str, name: str, shape: tuple[int, ...], dtype: np.dtype) -> str:
    kind = "Float" if dtype.kind == "f" else "UInt" if dtype.kind == "u" else "Int"
    if dtype.itemsize == 1:
        kind = "UChar" if dtype.kind == "u" else "Char"
    size = " ".join(map(str, shape))
    return (f'          <DataItem Dimensions="{size}" NumberType="{kind}" Precision="{dtype.itemsize}" '
            f'Format="HDF">{file}:/{name}</DataItem>\n')


def _on_grid(values: np.ndarray, dim: int) -> np.ndarray:
    """An array of a grid as [z, y, x] or [z, y, x, 3]; 2D ones get one layer, vectors three components."""
    values = np.asarray(values)
    found: Any = values if dim == 3 else values[None]
    if values.ndim > dim and values.shape[-1] < 3:
        found = np.concatenate([found, np.zeros((*found.shape[:-1], 3 - found.shape[-1]), found.dtype)], axis=-1)
    return np.ascontiguousarray(found)
