"""Many spheres: read from a file, placed at random, and what is odd about them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..domain.halo import build_halo
from ..geometry.bodies import ROUND_OFF, ShapeError, Spheres, _nearest_image, _overlaps
from ..geometry.shape_geometry import ShapeGeometry


def read_spheres(
    path: str | Path, dim: int = 3, radius: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (m, dim) and radii (m,) of a CSV file, m; see `spheres_of_file`."""
    found = spheres_of_file(path, dim, radius)
    return found.centres, np.broadcast_to(np.asarray(found.radii, float), len(found.centres))


def spheres_of_file(path: str | Path, dim: int = 3, radius: float | None = None) -> Spheres:
    """Balls of a CSV file with columns x, y(, z)[, radius or diameter].

    Lines starting with # are skipped. A header line may be there, after a # too; it names the columns and perhaps their
    unit, x_mm or radius [um], in which case the lengths are converted to m. Names that are not understood, columns in
    another order and lengths of which only some have a unit are refused. radius, m, is used where the file has no such
    column. Raises ShapeError.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ShapeError(f"{path}: cannot be read as text ({error}); give rows of x,y,z[,radius]") from None
    rows: list[list[float]] = []
    header: _Header | None = None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        if line.lstrip().startswith("#"):
            if not rows and header is None:  # numpy.savetxt puts a # before its header
                header = _commented_header(line, dim, f"{path}:{number}")
            continue
        if ";" in line and "," in line:
            raise ShapeError(f"{path}:{number}: holds ; and ,: numbers need a decimal point, columns one separator")
        cells = [c.strip() for c in line.replace(";", ",").split(",")]
        try:
            values = [float(c) for c in cells]
        except ValueError:
            if not rows and not any(_is_number(c) for c in cells):
                header = _Header.of(cells, dim, f"{path}:{number}")
                continue
            raise ShapeError(
                f"{path}:{number}: '{line.strip()[:60]}' is not a row of numbers; fix it"
            ) from None
        if len(values) not in (dim, dim + 1) or (rows and len(values) != len(rows[0])):
            want = f"{dim} or {dim + 1}" if not rows else str(len(rows[0]))
            raise ShapeError(f"{path}:{number}: {len(values)} columns where {want} are expected")
        if not np.isfinite(values).all():
            raise ShapeError(f"{path}:{number}: a value is not finite; remove the row or correct it")
        if header is not None and len(values) != len(header.scale):
            raise ShapeError(f"{path}:{number}: {len(values)} columns where the header has {len(header.scale)}")
        rows.append(values)
    if not rows:
        raise ShapeError(f"{path}: holds no sphere; give rows of x,y,z[,radius]")
    table = np.array(rows) * (header.scale if header is not None else 1.0)
    if table.shape[1] == dim and radius is None:
        raise ShapeError(f"{path}: has no column of radii; add one or give the key 'radius'")
    radii = table[:, dim] if table.shape[1] > dim else np.full(len(table), float(radius))  # type: ignore[arg-type]
    if not (radii > 0).all() or not np.isfinite(table).all():
        raise ShapeError(f"{path}: radius {radii.min()} is not positive, or a length leaves the range of numbers")
    return Spheres(np.ascontiguousarray(table[:, :dim]), radii, header.said if header is not None else "")


TRIES = 2000  # random places tried for each sphere before there is said to be no room
MOST_TRIES = 2_000_000  # for all of them: some seconds
DENSEST = {2: 0.907, 3: 0.741}  # share of space that equal balls can fill at all


def random_spheres(
    geometry: ShapeGeometry, count: int, radius: float, clearance: float = 0.0, seed: int = 0
) -> Spheres:
    """Balls of a radius at random places in the box, no two nearer than `clearance`, nor any to a wall, m.

    Raises ShapeError where not all of them find room.
    """
    rng = np.random.default_rng(seed)
    box, size = geometry.upper - geometry.lower, 2.0 * radius + clearance
    with np.errstate(over="ignore"):
        share = count * np.pi / (2 * geometry.dim) * float(np.prod(size / box))  # of balls with half their clearance
    if share > DENSEST[geometry.dim]:
        raise ShapeError(f"{count} spheres of radius {radius:g} would fill {100 * share:.3g} % of the box with their "
                         f"clearance, and no more than {100 * DENSEST[geometry.dim]:.0f} % can be; ask for fewer or "
                         f"smaller ones")
    centres = np.empty((count, geometry.dim))
    placed = 0
    for _ in range(min(TRIES, max(1, MOST_TRIES // count))):
        places = geometry.lower + rng.random((count, geometry.dim)) * box
        places = places[geometry.distance(places) >= radius + clearance]
        if placed:  # most of those that are too near are found at once
            images = build_halo(centres[:placed], geometry.lower, geometry.upper, np.array(geometry.periodic), size)
            places = places[cKDTree(images.positions(centres[:placed])).query(places)[0] >= size * (1.0 - 1e-9)]
        for place in places:
            apart = np.linalg.norm(_nearest_image(centres[:placed] - place, geometry.period), axis=1)
            if (apart >= size).all():
                centres[placed] = place
                placed += 1
                if placed == count:
                    return Spheres(centres, radius)
    raise ShapeError(
        f"only {placed} of {count} spheres of radius {radius:g} found room at random; ask for fewer or smaller ones"
    )


UNITS = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "cm": 1e-2, "mm": 1e-3, "millimeter": 1e-3,
    "millimeters": 1e-3, "millimetre": 1e-3, "millimetres": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6,
    "micron": 1e-6, "microns": 1e-6, "micrometer": 1e-6, "micrometers": 1e-6, "micrometre": 1e-6, "micrometres": 1e-6,
    "nm": 1e-9,
}  # fmt: skip
RADIUS, DIAMETER = ("r", "rad", "radius", "radii"), ("d", "dia", "diam", "diameter", "diameters")


@dataclass(frozen=True)
class _Header:
    """scale: (columns,) factors that make the columns metres and diameters radii; said: what it took, or nothing."""

    scale: np.ndarray
    said: str

    @classmethod
    def of(cls, cells: list[str], dim: int, where: str) -> _Header:
        """Header of the names in a line; raises ShapeError where they are not understood."""
        found = [_column(cell) for cell in cells]
        names, shown = [name for name, _ in found], ",".join(cells)[:60]
        wanted = f"{','.join('xyz'[:dim])}[,radius]"
        strange = [cell for cell, name in zip(cells, names) if not name]
        if strange:
            raise ShapeError(f"{where}: no such column: {', '.join(strange)[:60]}; give {wanted} and no others")
        if names[:dim] != list("xyz"[:dim]) or names[dim:] not in ([], ["radius"], ["diameter"]):
            raise ShapeError(f"{where}: the columns are {shown}; give {wanted} in this order")
        units = [unit for _, unit in found]
        if None in units and any(units):
            without = ", ".join(cell for cell, unit in zip(cells, units) if unit is None)
            raise ShapeError(f"{where}: only some columns have a unit; name that of {without} too, or of none")
        scale = np.array([1.0 if unit is None else UNITS[unit] for unit in units])
        said = f"lengths in {', '.join(dict.fromkeys(u for u in units if u))}" if any(units) else ""
        if any(u is not None and UNITS[u] != 1.0 for u in units):
            said += " converted to m"
        if names[-1] == "diameter":
            scale[-1] /= 2
            said += f"{', ' if said else ''}diameters halved"
        return cls(scale, said)


def _column(cell: str) -> tuple[str, str | None]:
    """('x', 'y', 'z', 'radius', 'diameter' or '' for another, its unit or None) of the name of a column."""
    text = cell.strip().strip("'\"").lower()
    words = [w for w in re.split(r"[\s_\[\](){}/]+", text) if w]
    unit = words.pop() if len(words) > 1 and words[-1] in UNITS else None
    words = [w for w in words if w not in ("centre", "center", "pos", "position", "coordinate", "in", "bead", "sphere")]
    if len(words) != 1:
        return "", unit
    (word,) = words
    if word in RADIUS or word in DIAMETER:
        return "radius" if word in RADIUS else "diameter", unit
    return word if word in ("x", "y", "z") else "", unit


def _commented_header(line: str, dim: int, where: str) -> _Header | None:
    """The header in a comment, if all its words are names of columns."""
    text = line.lstrip("# \t")
    for cells in (re.split(r"[,;]", text), text.split()):
        cells = [c.strip() for c in cells]
        if len(cells) >= dim and all(_column(c)[0] for c in cells):
            return _Header.of(cells, dim, where)
    return None


LARGE = 10.0  # radii over the smallest period: then one ball has 8000 images and lengths are in another unit


def sphere_findings(
    body: Spheres, lower: np.ndarray, upper: np.ndarray, period: np.ndarray, name: str
) -> tuple[list[str], list[str]]:
    """(facts, warnings) on balls against their box: those outside, wrapped or left out, and those that overlap.

    lower, upper: (dim,) corners, m; period: (dim,) m, infinite along closed axes. Raises ShapeError for balls far
    larger than a periodic box.
    """
    centres = np.atleast_2d(np.asarray(body.centres, float))
    radii = np.broadcast_to(np.asarray(body.radii, float), len(centres))
    facts, odd = [], []
    count, size = len(centres), upper - lower
    if radii.max() > LARGE * period.min():
        raise ShapeError(f"{name}: a radius of {radii.max():g} m in a periodic box of {period.min():g} m; check the "
                         "unit: lengths are in m unless the header names another (x_mm)")  # fmt: skip
    beyond = np.maximum(lower - centres, centres - upper)  # of the centre, along each axis
    closed = ~np.isfinite(period)
    out = (beyond[:, closed] >= radii[:, None]).any(axis=1)
    wrapped = (beyond[:, ~closed] > ROUND_OFF * size[~closed]).any(axis=1) & ~out
    far = ((beyond - radii[:, None] >= 0.0)[:, ~closed]).any(axis=1) & ~out
    if out.any():
        odd.append(f"{name}: {out.sum()} of {count} spheres lie outside the box and are left out; check lengths "
                   "and origin")  # fmt: skip
    if wrapped.any():
        text = f"{wrapped.sum()} of {count} spheres have their centre outside the box and are wrapped into it"
        most = float((beyond / size)[:, ~closed].max())
        if far.any():
            odd.append(f"{name}: {text}, {far.sum()} of them from wholly outside (up to {most:.3g} box lengths); "
                       "check lengths and origin")  # fmt: skip
        else:
            facts.append(text)
    kept = np.flatnonzero(~out)
    pairs, copies, most = _overlaps(centres[kept], radii[kept], period) if len(kept) > 1 else (0, 0, 0.0)
    if copies:
        facts.append(f"{copies} spheres repeat another one, or its periodic image; they count once")
    if pairs:
        odd.append(f"{name}: {pairs} pairs of spheres overlap, by up to {100 * most:.0f} % of the smaller radius; "
                   "what they share counts once")  # fmt: skip
    return facts, odd


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
