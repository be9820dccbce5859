"""Files that a run leaves: snapshots and their time series, the history, the summary.

Writers take plain arrays and dictionaries. Two rules hold for all of them: a file appears whole or not at all (a
temporary file is written and renamed), and NaN or infinity never reaches a file.
`docs/output.md` describes every file, column and key.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO
from xml.sax.saxutils import quoteattr

import numpy as np

from ..domain.communicator import current, on_first
from . import folder

SNAPSHOTS = "snapshots"
FLUSH_EVERY = 8  # rows of a table: what a killed run may lose of it
INTEGER_FIELDS = ("phase", "kind", "component")
# The order of keys in summary.json; keys not named here follow in the order in which they came.
SUMMARY_KEYS = (
    "title", "status", "message", "restarts", "warnings", "dimension", "particles", "inputs", "image",
    "porosity", "microporous", "open_axes", "throats", "terms", "steps", "time",
    "permeability", "permeability_error", "permeability_image_error", "permeability_range", "permeability_range_from",
    "permeability_by_spacing", "permeability_by_threshold", "permeability_tensor", "tortuosity", "formation_factor",
    "formation_factor_error", "effective_diffusivity", "effective_diffusivity_error",
    "superficial_velocity", "mean_velocity", "speed", "wall_shear", "pressure_drop",
    "pressure_drop_mean", "pressure_drop_error", "pressure_drop_scatter",
    "two_fluids", "mass_error", "max_divergence", "iterations", "errors", "cpu_seconds", "wall_seconds",
    "peak_memory_bytes", "threads", "ranks", "versions",
)  # fmt: skip


class NotFiniteError(ValueError):
    """A value that was to be written is NaN or infinite."""


@contextlib.contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it there if the block succeeds, remove it if not.

    The bytes are on the disk before the name is: not even a power cut leaves half a file under it. Raises
    folder.FolderError where a file of others in a folder that is held would be overwritten.
    """
    folder.name(path)
    with folder.whole(Path(path)) as temporary:
        yield temporary


def write_text(path: str | os.PathLike, text: str) -> None:
    """Write `text` (UTF-8) to `path`, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def require_finite(name: str, values: Any) -> np.ndarray:
    """`values` as an array; NotFiniteError with the field's name and the count if any is NaN or infinite."""
    values = np.asarray(values)
    if values.dtype.kind in "fc":
        bad = values.size - int(np.count_nonzero(np.isfinite(values)))
        if bad:
            nan = int(np.count_nonzero(np.isnan(values)))
            raise NotFiniteError(
                f"{name}: {bad} of {values.size} values are not finite ({nan} NaN, {bad - nan} infinite); "
                "nothing was written"
            )
    return values


def write_vtu(path: str | os.PathLike, x: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
    """Write points with their fields as a VTU of vertex cells (binary, zlib).

    x: (n, 2 or 3), m. fields: (n,) scalars or (n, 2 or 3) vectors; vectors are written with three
    components, `phase`, `kind` and `component` as int32, flags as int8. `distance` that is +inf everywhere
    says that there is no wall, and is left out. Raises NotFiniteError for NaN or infinity, ValueError for a
    wrong length or no particles at all.
    """
    import meshio

    x, data = field_arrays(Path(path), x, fields)
    mesh = meshio.Mesh(x, [("vertex", np.arange(len(x)).reshape(-1, 1))], point_data=data)
    with replacing(path) as temporary:
        meshio.vtu.write(temporary, mesh, binary=True, compression="zlib")


def field_arrays(path: Path, x: np.ndarray,
                 fields: Mapping[str, np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) and fields of a snapshot as they are written; arguments and errors as those of `write_vtu`."""
    x = require_finite("x", np.asarray(x, dtype=np.float64))
    n = len(x)
    if n == 0:
        raise ValueError(f"{Path(path).name}: there are no particles to write")
    data: dict[str, np.ndarray] = {}
    for name, values in fields.items():
        values = np.asarray(values)
        if values.ndim not in (1, 2) or len(values) != n:
            raise ValueError(f"{name}: shape {values.shape} does not fit {n} particles")
        if name == "distance" and n and np.all(np.isposinf(values)):
            continue
        require_finite(f"{Path(path).name}: {name}", values)
        if name in INTEGER_FIELDS:
            values = values.astype(np.int32)
        elif values.dtype == bool:
            values = values.astype(np.int8)
        data[name] = _three(values) if values.ndim == 2 else np.ascontiguousarray(values)
    return _three(x), data


def _write_pieces(directory: Path, name: str, x: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
    """A snapshot of several processes: a VTU of each, and <name>.pvtu that joins them, by rank 0. All processes call
    it; x and fields: see `write_vtu`, of the particles of each."""
    ranks = current()
    pieces = [f"{name}_{rank:05d}.vtu" for rank in range(ranks.size)]
    shapes = ranks.collect({} if not len(x) else {key: np.asarray(value).dtype.str[1:] + str(np.ndim(value))
                                                  for key, value in fields.items()})
    have = [piece for piece, shape in zip(pieces, shapes) if shape]

    def begin() -> None:
        (directory / SNAPSHOTS).mkdir(exist_ok=True)
        for piece in have:  # the manifest names a piece before it is written
            folder.name(directory / piece)

    on_first(begin)
    if len(x):  # rank 0 has entered the piece in the manifest: the others hold no folder
        write_vtu(directory / pieces[ranks.rank], x, fields)
    ranks.collect(None)  # all pieces are there

    def end() -> None:
        kinds = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "i1": "Int8", "u1": "UInt8"}
        arrays = "".join(f'      <PDataArray type="{"Int32" if key in INTEGER_FIELDS else kinds[shape[:2]]}" '
                         f'Name={quoteattr(key)} NumberOfComponents="{3 if shape[2:] == "2" else 1}"/>\n'
                         for key, shape in next(shape for shape in shapes if shape).items())
        sources = "".join(f'    <Piece Source={quoteattr(Path(piece).name)}/>\n' for piece in have)
        write_text(directory / f"{name}.pvtu", (
            '<?xml version="1.0"?>\n<VTKFile type="PUnstructuredGrid" version="0.1" byte_order="LittleEndian">\n'
            '  <PUnstructuredGrid GhostLevel="0">\n    <PPoints>\n      <PDataArray type="Float64" Name="Points" '
            f'NumberOfComponents="3"/>\n    </PPoints>\n    <PPointData>\n{arrays}    </PPointData>\n{sources}'
            '  </PUnstructuredGrid>\n</VTKFile>\n'))

    on_first(end)


def read_vtu(path: str | os.PathLike) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) and fields of a snapshot that `write_vtu` wrote."""
    import meshio

    mesh = meshio.read(path)
    return mesh.points, dict(mesh.point_data)


def _three(vectors: np.ndarray) -> np.ndarray:
    """(n, 1..3) as C-ordered (n, 3), the missing components zero."""
    if vectors.shape[1] == 3:
        return np.ascontiguousarray(vectors)
    padded = np.zeros((len(vectors), 3), dtype=vectors.dtype)
    padded[:, : vectors.shape[1]] = vectors
    return padded


class Series:
    """Snapshots `snapshots/<name>_<step>.vtu` and the `<name>.pvd` that opens them all in ParaView. Of several
    processes all make it and call it together; the snapshots are `<name>_<step>.pvtu`, which join a VTU of each."""

    def __init__(
        self, directory: str | os.PathLike, name: str = "particles", resume_time: float | None = None
    ):
        """`resume_time`: take up the series in `directory`, without snapshots later than this time (s)."""
        self.directory = Path(directory)
        self.name = name
        self.entries: list[tuple[float, str]] = []
        (self.directory / SNAPSHOTS).mkdir(parents=True, exist_ok=True)
        if resume_time is not None and on_first(self.path.exists):
            self.entries = [e for e in on_first(lambda: read_pvd(self.path)) if e[0] <= resume_time]
            on_first(lambda: write_text(self.path, _pvd(self.entries)))

    @property
    def path(self) -> Path:
        """The .pvd file."""
        return self.directory / f"{self.name}.pvd"

    def write(self, step: int, time: float, x: np.ndarray, fields: Mapping[str, np.ndarray]) -> Path:
        """Write the particles at `time` (s) and renew the .pvd; returns the path of the snapshot.

        x and fields: see `write_vtu`. A step that was written before is replaced.
        """
        if current().size > 1:
            return self.add(step, time, "pvtu", lambda path: _write_pieces(
                self.directory, f"{SNAPSHOTS}/{path.stem}", x, fields))
        return self.add(step, time, "vtu", lambda path: write_vtu(path, x, fields))

    def add(self, step: int, time: float, suffix: str, write: Callable[[Path], None]) -> Path:
        """As `write`, of a file of another kind, which `write` makes."""
        if not math.isfinite(time):
            raise NotFiniteError(f"{self.name}: the time of step {step} is {time}; nothing was written")
        file = f"{SNAPSHOTS}/{self.name}_{step:06d}.{suffix}"
        write(self.directory / file)
        self.entries = [e for e in self.entries if e[1] != file] + [(float(time), file)]
        on_first(lambda: write_text(self.path, _pvd(self.entries)))
        return self.directory / file


def _pvd(entries: list[tuple[float, str]]) -> str:
    rows = "".join(
        f'    <DataSet timestep="{time!r}" group="" part="0" file={quoteattr(file)}/>\n'
        for time, file in entries
    )
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
        f"  <Collection>\n{rows}  </Collection>\n</VTKFile>\n"
    )


def read_pvd(path: str | os.PathLike) -> list[tuple[float, str]]:
    """(time, file relative to the .pvd) of each snapshot of a series."""
    from xml.etree import ElementTree

    return [
        (float(e.get("timestep", "nan")), e.get("file", "")) for e in ElementTree.parse(path).iter("DataSet")
    ]


class History:
    """history.csv: a row per step; the first row's keys are the columns. A context manager."""

    def __init__(self, path: str | os.PathLike, resume_step: int | None = None):
        """`resume_step`: go on with the file there, without its rows after this step."""
        self.path = Path(path)
        self.columns: list[str] | None = None
        self.rows = 0
        self._file: TextIO | None = None
        self._resumed = False
        if resume_step is not None and self.path.exists():
            self._cut_back(resume_step)

    def _cut_back(self, step: int) -> None:
        """Leave the rows up to `step`, whole or not at all, and go on behind them."""
        with open(self.path, newline="", encoding="utf-8", errors="replace") as file:
            # a run that was killed may have left half a line at the end
            head, *lines = [line for line in file if line.endswith("\n")] or [""]
        first = [line.split(",", 1)[0] for line in lines]
        kept = [line for line, number in zip(lines, first) if number.isdecimal() and int(number) <= step]
        if not head.startswith("step,"):
            return
        write_text(self.path, "".join([head, *kept]))
        self.columns, self.rows, self._resumed = next(csv.reader([head])), len(kept), True
        self._file = open(self.path, "a", newline="", encoding="utf-8")

    def _widen(self, names: list[str]) -> None:
        """Columns that the run had not before its restart; the rows before it have empty cells there."""
        self.close()
        head, *lines = self.path.read_text(encoding="utf-8").splitlines()
        rows = [",".join([head, *names]), *(line + "," * len(names) for line in lines)]
        write_text(self.path, "".join(row + "\r\n" for row in rows))
        self.columns = [*(self.columns or []), *names]
        self._file = open(self.path, "a", newline="", encoding="utf-8")

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row. A key that is missing, or None, leaves an empty cell: "there is no such value here".

        Raises NotFiniteError for NaN and infinity, KeyError for a column that the first row did not have.
        """
        if self.columns is None:
            self.columns = list(row)
        unknown = [key for key in row if key not in self.columns]
        if unknown and self._resumed:
            self._widen(unknown)
        elif unknown:
            raise KeyError(f"{self.path.name}: no column {', '.join(unknown)} in its first row")
        cells = [self._cell(key, row.get(key)) for key in self.columns]
        if self._file is None:
            folder.name(self.path)
            self._file = open(self.path, "w", newline="", encoding="utf-8")
            csv.writer(self._file).writerow(self.columns)
        csv.writer(self._file).writerow(cells)
        self.rows += 1
        if self.rows % FLUSH_EVERY == 1:
            self._file.flush()

    def _cell(self, key: str, value: Any) -> str:
        if value is None:
            return ""
        plain = isinstance(value, int | str) or (isinstance(value, float) and math.isfinite(value))
        if not plain:  # plain numbers need no check as arrays, which takes ten times as long
            value = require_finite(f"{self.path.name}: {key} in row {self.rows + 1}", value).item()
        return f"{value:.10g}" if isinstance(value, float) else str(value)

    def sync(self) -> None:
        """Bring every row to the disk."""
        if self._file is not None:
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write what is pending and close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def __enter__(self) -> History:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def write_rows(path: str | os.PathLike, rows: Iterable[Mapping[str, Any]]) -> None:
    """A table as `History` writes it; no file without rows."""
    with History(path) as file:
        for row in rows:
            file.append(row)


def csv_text(rows: Sequence[Mapping[str, Any]], first: Sequence[str] = ()) -> str:
    """Comma-separated values under a head of the names of all rows, those of `first` in front."""
    text = io.StringIO()
    names = dict.fromkeys([*first, *(name for row in rows for name in row)])
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def read_history(path: str | os.PathLike) -> list[dict[str, Any]]:
    """Rows of a history: whole numbers as int, numbers as float, empty cells as None, the rest as text."""
    with open(path, newline="", encoding="utf-8") as file:
        return [{key: _value(text) for key, text in row.items()} for row in csv.DictReader(file)]


def _value(text: str | None) -> Any:
    if not text:
        return None
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return {"True": True, "False": False}.get(text, text)


def write_summary(path: str | os.PathLike, summary: Mapping[str, Any]) -> None:
    """Write the summary as JSON, whole or not at all.

    numpy numbers and arrays become numbers and lists; keys come in the order of `SUMMARY_KEYS`, others
    after them. Raises NotFiniteError, naming the key, for NaN and infinity: give None for "no value".
    """
    order = {key: i for i, key in enumerate(SUMMARY_KEYS)}
    keys = sorted(summary, key=lambda key: order.get(key, len(order)))
    plain = {key: _plain(key, summary[key]) for key in keys}
    write_text(path, json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _plain(name: str, value: Any) -> Any:
    """`value` in types of JSON; `name` is the path of keys that leads to it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(f"{name}.{key}", item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        items = sorted(value) if isinstance(value, (set, frozenset)) else value
        return [_plain(f"{name}[{i}]", item) for i, item in enumerate(items)]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (float, np.generic, np.ndarray)):
        return require_finite(f"summary.json: {name}", value).tolist()
    raise TypeError(f"summary.json: {name}: cannot write a {type(value).__name__}")
