"""Reads spheres from tables of text, with columns that a header names, and from dumps of LAMMPS and LIGGGHTS."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..geometry.bodies import ShapeError, Spheres
from ..geometry.lengths import LENGTHS

RADIUS, DIAMETER = ("r", "rad", "radius", "radii"), ("d", "dia", "diam", "diameter", "diameters")
FILLERS = (
    "centre",
    "center",
    "pos",
    "position",
    "coordinate",
    "in",
    "bead",
    "sphere",
)  # that names of columns may have
HINT = "give rows of x,y,z[,radius]"


def spheres_of_file(path: str | Path, dim: int = 3, radius: float | None = None, scale: float | None = None) -> Spheres:
    """Balls of a table with columns x, y(, z)[, radius or diameter], or of the last step of a LAMMPS or LIGGGHTS dump.

    Columns are parted by commas, semicolons, tabs or blanks; numbers may have decimal commas where the columns are
    parted by something else. Lines starting with # are skipped. A header, after a # too, names the columns in any order
    and perhaps their unit, x_mm or radius [um], in which case lengths are converted to m; columns of another name are
    left out. Without a header the columns are x, y(, z)[, radius]. scale: m of a length of 1 in the file, where no
    header names a unit. radius, m, is used where the file has no such column. Raises ShapeError.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ShapeError(f"{path}: cannot be read as text ({error}); {HINT}") from None
    is_dump = any(line.startswith("ITEM:") for line in lines[:3])
    table = _dump(path, lines, dim) if is_dump else _table(path, lines, dim)
    if scale is not None and table.has_unit:
        raise ShapeError(f"{path}: its header names the unit of its lengths; remove the key 'scale'")
    values = table.values * (1.0 if scale is None else scale)
    if values.shape[1] == dim and radius is None:
        raise ShapeError(f"{path}: has no column of radii; add one or give the key 'radius' (init: --radius 1e-4)")
    radii = values[:, dim] if values.shape[1] > dim else np.full(len(values), float(radius))  # type: ignore[arg-type]
    if not np.isfinite(values).all() or not (radii > 0).all():
        raise ShapeError(f"{path}: radius {radii.min()} is not positive, or a length leaves the range of numbers")
    said = [*table.said, *([f"lengths times {scale:g} m"] if scale is not None else [])]
    return Spheres(np.ascontiguousarray(values[:, :dim]), radii, ", ".join(said))


def read_spheres(path: str | Path, dim: int = 3, radius: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Centres (m, dim) and radii (m,) of a file, m; see `spheres_of_file`."""
    found = spheres_of_file(path, dim, radius)
    return found.centres, np.broadcast_to(np.asarray(found.radii, float), len(found.centres))


def box_of_dump(path: str | Path) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Corners (3,) of the box of the last step of a dump, in its unit, and along which axes it repeats; None of other
    files. Raises ShapeError.
    """
    path = Path(path)
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    heads = {line[5:].strip(): k for k, line in enumerate(lines) if line.startswith("ITEM:")}  # the last of each
    bounds = next((name for name in reversed(heads) if name.startswith("BOX BOUNDS")), "")
    repeats = np.array([side == "pp" for side in bounds.split()[2:]])
    return (*_bounds(path, lines, heads, 3), repeats) if len(repeats) == 3 else None


@dataclass(frozen=True)
class _Table:
    """values: (n, dim) or, with radii, (n, dim + 1); said: what was understood; has_unit: lengths are in m."""

    values: np.ndarray
    said: list[str] = field(default_factory=list)
    has_unit: bool = False


@dataclass(frozen=True)
class _Header:
    """Of a table of `width` columns those taken: `columns` x, y(, z)[, radius], times `scale`; said: in words."""

    width: int
    columns: list[int]
    scale: np.ndarray
    said: list[str]
    has_unit: bool

    @classmethod
    def of(cls, cells: list[str], dim: int, where: str) -> _Header:
        """Header of the names in a line; raises ShapeError where a length is missing or its unit is not known."""
        found = [_column(cell) for cell in cells]
        columns = []
        for axis in "xyz"[:dim]:
            there = [k for k, (name, _) in enumerate(found) if name == axis]
            if len(there) != 1:
                raise ShapeError(
                    f"{where}: {len(there) or 'no'} column{'s' * (len(there) > 1)} {axis} among "
                    f"{_shown(cells)}{_unknown_unit(cells, axis)}; name {','.join('xyz'[:dim])}[,radius]"
                )
            columns += there
        sizes = [k for kind in ("radius", "diameter") for k, (name, _) in enumerate(found) if name == kind]
        if not sizes and (strange := _unknown_unit(cells, *RADIUS, *DIAMETER)):
            raise ShapeError(f"{where}: {strange.strip(' ()')}; name a unit of length, as in radius_mm")
        columns += sizes[:1]
        units = [found[k][1] for k in columns]
        if None in units and any(units):
            without = ", ".join(cells[k] for k in columns if found[k][1] is None)
            raise ShapeError(f"{where}: only some columns have a unit; name that of {without} too, or of none")
        scale = np.array([1.0 if unit is None else LENGTHS[unit] for unit in units])
        said = []
        if any(units):
            said.append(
                f"lengths in {', '.join(dict.fromkeys(u for u in units if u))}"
                + " converted to m" * any(u is not None and LENGTHS[u] != 1.0 for u in units)
            )
        if sizes and found[sizes[0]][0] == "diameter":
            scale[-1] /= 2
            said.append("diameters halved")
        left = [cell for k, cell in enumerate(cells) if k not in columns]
        if left:
            said.append(f"columns left out: {_shown(left)}")
        return cls(len(cells), columns, scale, said, any(units))


def _shown(cells: Sequence[str]) -> str:
    return ",".join(cells)[:60]


def _unknown_unit(cells: Sequence[str], *names: str) -> str:
    """' (radius_px has a unit that is not known)' where a column has one of the names and more."""
    for cell in cells:
        words = _words(cell)
        if len(words) > 1 and words[0] in names:
            return f" ({cell} has a unit that is not known)"
    return ""


def _words(cell: str) -> list[str]:
    words = [w for w in re.split(r"[\s_\[\](){}/]+", cell.strip().strip("'\"").lower()) if w]
    return [w for w in words if w not in FILLERS]


def _column(cell: str) -> tuple[str, str | None]:
    """('x', 'y', 'z', 'radius', 'diameter' or '' for another, its unit or None) of the name of a column."""
    words = _words(cell)
    unit = words.pop() if len(words) > 1 and words[-1] in LENGTHS else None
    if len(words) != 1:
        return "", unit
    (word,) = words
    if word in RADIUS or word in DIAMETER:
        return "radius" if word in RADIUS else "diameter", unit
    return word if word in ("x", "y", "z") else "", unit


def _table(path: Path, lines: list[str], dim: int) -> _Table:
    """Rows of a table; raises ShapeError with the line that is wrong."""
    rows: list[list[float]] = []
    header: _Header | None = None
    separator: str | None = None
    begun = False
    for number, line in enumerate(lines, 1):
        where = f"{path}:{number}"
        if not line.strip():
            continue
        if line.lstrip().startswith("#"):
            if not rows and header is None:  # numpy.savetxt puts a # before its header
                header = _commented_header(line, dim, where)
            continue
        if not begun:
            separator, begun = _separator(line), True
        cells = _cells(line, separator)
        try:
            values = [float(c) for c in cells]
        except ValueError:
            if not rows and not any(_is_number(c) for c in cells):
                header, begun = _Header.of(cells, dim, where), False  # the rows may be parted by something else
                continue
            raise ShapeError(f"{where}: '{line.strip()[:60]}' is not a row of numbers; fix it") from None
        if header is not None and len(values) != header.width:
            raise ShapeError(f"{where}: {len(values)} columns where the header has {header.width}")
        if (header is None and len(values) not in (dim, dim + 1)) or (rows and len(values) != len(rows[0])):
            want = f"{dim} or {dim + 1}" if not rows else str(len(rows[0]))
            raise ShapeError(
                f"{where}: {len(values)} columns where {want} are expected; a header names them, x,y,z,radius"
            )
        if not np.isfinite(values if header is None else [values[k] for k in header.columns]).all():
            raise ShapeError(f"{where}: a value is not finite; remove the row or correct it")
        rows.append(values)
    if not rows:
        raise ShapeError(f"{path}: holds no sphere; {HINT}")
    table = np.array(rows)
    if header is None:
        return _Table(table)
    return _Table(table[:, header.columns] * header.scale, header.said, header.has_unit)


def _separator(line: str) -> str | None:
    """The separator of the columns of a line: ; or a tab rather than a comma, a comma rather than blanks (None)."""
    for sign in ";\t":
        if sign in line:
            return sign
    if "," in line and all(
        len(cell.split()) == 1 or not _is_number(cell.split()[0]) for cell in line.split(",") if cell.strip()
    ):
        return ","
    return None


def _cells(line: str, separator: str | None) -> list[str]:
    """Columns of a line; decimal commas become points where commas do not part the columns."""
    if separator is None:
        cells = re.sub(r"(?<=\w)\s+(?=[\[(])", "", line).split()  # x [mm] is one name
    else:
        cells = [c.strip() for c in line.strip().split(separator)]
        if separator == "\t" and cells[-1] == "":
            cells.pop()
    return cells if separator == "," else [re.sub(r"^([-+]?\d*),(\d+)", r"\1.\2", c) for c in cells]


def _commented_header(line: str, dim: int, where: str) -> _Header | None:
    """The header in a comment, if it names x, y(, z) and nothing but columns."""
    text = line.lstrip("# \t")
    for separator in (",", ";", "\t", None):
        cells = _cells(text, separator)
        if len(cells) >= dim and all(_column(c)[0] for c in cells):
            return _Header.of(cells, dim, where)
    return None


def _dump(path: Path, lines: list[str], dim: int) -> _Table:
    """The last step of a dump: its columns x, y, z (xu: unwrapped, xs: over the edges of the box) and radius."""
    items = [k for k, line in enumerate(lines) if line.startswith("ITEM:")]
    atoms = [k for k in items if lines[k].startswith("ITEM: ATOMS")]
    if not atoms:
        raise ShapeError(f"{path}: is a dump without ITEM: ATOMS; dump id type x y z radius")
    head, names = atoms[-1], lines[atoms[-1]].split()[2:]
    before = {lines[k][5:].strip(): k for k in items if k < head}  # the last of each
    step = _after(lines, before, "TIMESTEP")
    count = _after(lines, before, "NUMBER OF ATOMS")
    columns, scaled = [], False
    for axis in "xyz"[:dim]:
        there = [form for form in (axis, f"{axis}u", f"{axis}s", f"{axis}su") if form in names]
        if not there:
            raise ShapeError(
                f"{path}:{head + 1}: no column {axis} among {' '.join(names)[:60]}; dump id type x y z radius"
            )
        columns.append(names.index(there[0]))
        scaled = scaled or "s" in there[0]
    size = next((name for name in ("radius", "diameter", "c_radius", "v_radius", "d") if name in names), None)
    if size is not None:
        columns.append(names.index(size))
    rows = np.array(list(_rows(path, lines, head, len(names), columns)))
    if count is None or not count.isdecimal() or len(rows) != int(count):
        raise ShapeError(f"{path}: the last step holds {len(rows)} of {count} atoms; copy it again")
    said = [f"dump, step {step}"]
    if size in ("diameter", "d"):
        rows[:, dim] /= 2
        said.append("diameters halved")
    lower, upper = _bounds(path, lines, before, dim)
    if scaled:
        rows[:, :dim] = lower + rows[:, :dim] * (upper - lower)
    said.append("its box " + " x ".join(f"{a:g} to {b:g}" for a, b in zip(lower, upper)))
    return _Table(rows, said)


def _after(lines: list[str], before: dict[str, int], item: str) -> str | None:
    k = before.get(item)
    return None if k is None or k + 1 >= len(lines) else lines[k + 1].strip()


def _rows(path: Path, lines: list[str], head: int, width: int, columns: list[int]) -> Iterator[list[float]]:
    for number, line in enumerate(lines[head + 1 :], head + 2):
        words = line.split()
        if not words:
            continue
        if line.startswith("ITEM:"):
            return
        if len(words) != width:
            raise ShapeError(f"{path}:{number}: {len(words)} columns where ITEM: ATOMS names {width}")
        try:
            values = [float(words[k]) for k in columns]
        except ValueError:
            raise ShapeError(f"{path}:{number}: '{line.strip()[:60]}' is not a row of numbers; fix it") from None
        if not np.isfinite(values).all():
            raise ShapeError(f"{path}:{number}: a value is not finite; remove the row or correct it")
        yield values


def _bounds(path: Path, lines: list[str], before: dict[str, int], dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box of a dump; raises ShapeError where it is missing or not along the axes."""
    found = [name for name in before if name.startswith("BOX BOUNDS")]
    if not found:
        raise ShapeError(f"{path}: is a dump without ITEM: BOX BOUNDS; copy it again")
    at = before[found[-1]]
    try:
        numbers = [[float(word) for word in line.split()] for line in lines[at + 1 : at + 4]]
        if any(len(row) > 2 and row[2] != 0.0 for row in numbers):
            raise ShapeError(f"{path}:{at + 1}: the box is tilted; only boxes along the axes can be used")
        return np.array([row[0] for row in numbers])[:dim], np.array([row[1] for row in numbers])[:dim]
    except (ValueError, IndexError) as error:
        if isinstance(error, ShapeError):
            raise
        raise ShapeError(f"{path}:{at + 1}: the bounds of the box are no numbers; copy it again") from None


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
