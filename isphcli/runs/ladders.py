"""Measures that take several runs of a case: inertia over a ladder of forces (Forchheimer), gas that slips along walls
over a ladder of slip lengths (Klinkenberg), growing parts of an image (representative volume).
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import acceleration, flow_axis, force_is_given, scaled, walls_move
from ..output.files import csv_text, write_text
from .run import solve_case

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry

Said = Callable[[str], None]
SHARES = (0.25, 0.375, 0.5, 0.75, 1.0)  # edges of the parts of an image that are solved, over its shortest side
GOLDEN = 1.2207440846057596  # x^4 = x + 1: multiples of its powers spread places evenly in three dimensions
LEAST_VOXELS = 8  # smallest edge of a part: in smaller ones walls at the sides dominate


class LadderError(ValueError):
    """A case that a ladder cannot be made of."""


@dataclass(frozen=True)
class Fit:
    """y = first + second x + ..., fitted by least squares of the relative deviations.

    values: coefficients; errors: their standard errors, None where there are no more points than coefficients.
    """

    values: np.ndarray
    errors: np.ndarray | None


def fitted(x: np.ndarray, y: np.ndarray, degree: int = 1) -> Fit:
    """The polynomial (degree) through points (m,), m > degree, y > 0."""
    matrix = x[:, None] ** np.arange(degree + 1) / y[:, None]
    size = np.linalg.norm(matrix, axis=0)
    values = np.linalg.lstsq(matrix / size, np.ones(len(x)), rcond=None)[0] / size
    spare = len(x) - degree - 1
    if spare < 1:
        return Fit(values, None)
    rest = matrix @ values - 1.0
    scaled_inverse = np.linalg.inv((matrix / size).T @ (matrix / size))
    return Fit(values, np.sqrt(np.diag(scaled_inverse) * (rest @ rest) / spare) / size)


# -- Forchheimer -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Forchheimer:
    """g = nu U / k + beta U^2 (Forchheimer 1901), g the force per mass, m/s2, and U the superficial velocity, m/s.

    permeability: m2; beta: 1/m; errors: their standard errors by the scatter of the runs about the law, or None; rows:
    `factor`, `force`, `superficial_velocity`, `reynolds` (U sqrt(k) / nu) and `apparent_permeability` (nu U / g, m2) of
    every run.
    """

    permeability: float
    beta: float
    errors: tuple[float, float] | None
    rows: list[dict[str, float]]


def forchheimer(case: Case, factors: Sequence[float], out: Path, quiet: bool = True, overwrite: bool = False,
                say: Said | None = None) -> Forchheimer:
    """Runs a case with its force times each factor to a steady state and fits the law of Forchheimer.

    Leaves the runs in folders of `out`, forchheimer.csv and forchheimer.png. Raises LadderError for a case without a
    given force, of other than one fluid between walls, or that does not run to a steady state, and the errors of runs.
    """
    if case.flow != "navier_stokes" or case.time is None or case.time.steady is None:
        raise LadderError("a ladder of forces needs flow: navier_stokes and time.steady: inertia is what it measures")
    if not force_is_given(case) or len(case.fluids) != 1 or walls_move(case):
        raise LadderError("a ladder of forces needs one fluid, walls at rest and drive.body_force or "
                          "drive.pressure_drop")
    if len(factors) < 2 or min(factors) <= 0.0:
        raise LadderError("give two or more factors above zero")
    nu = next(iter(case.fluids.values())).nu
    rows: list[dict[str, float]] = []
    for factor in sorted(factors):
        run = _put(scaled(case, factor), out / f"{factor:g}")
        summary, flow = solve_case(run, quiet, overwrite=overwrite)
        if summary["status"] != "steady":
            raise LadderError(f"the run with {factor:g} times the force is not steady: {summary.get('message')}")
        force = acceleration(run, flow.geometry.upper - flow.geometry.lower)
        axis = int(np.argmax(np.abs(force)))
        velocity = abs(float(np.asarray(summary["superficial_velocity"])[axis]))
        rows.append({"factor": factor, "force": abs(float(force[axis])), "superficial_velocity": velocity})
        if say is not None:
            say(f"{factor:g} times the force: {velocity:.4g} m/s")
    found = fit_forchheimer(rows, nu)
    _table(out / "forchheimer.csv", found.rows)
    if case.output.plots:
        from ..output.panels import plot_fit

        u = np.array([row["superficial_velocity"] for row in found.rows])
        apparent = np.array([row["apparent_permeability"] for row in found.rows])
        line = np.linspace(0.0, float(u.max()), 100)
        label = f"k = {found.permeability:.3g} m², beta = {found.beta:.3g} /m"
        law = 1.0 / found.permeability + found.beta * line / nu
        plot_fit(out / "forchheimer.png", (u, 1.0 / apparent), (line, law),
                 ("superficial velocity (m/s)", "force over nu U (1/m²)", label), case.title)
    return found


def fit_forchheimer(rows: Sequence[Mapping[str, float]], nu: float) -> Forchheimer:
    """The law through runs with `force`, m/s2, and `superficial_velocity`, m/s; nu: kinematic viscosity, m2/s."""
    force, u = (np.array([row[name] for row in rows], float) for name in ("force", "superficial_velocity"))
    fit = fitted(u, force / u)
    k = float(nu / fit.values[0])
    errors = None if fit.errors is None else (float(k * fit.errors[0] / fit.values[0]), float(fit.errors[1]))
    more = [{**row, "reynolds": float(v * np.sqrt(abs(k)) / nu), "apparent_permeability": float(nu * v / g)}
            for row, v, g in zip(rows, u, force)]
    return Forchheimer(k, float(fit.values[1]), errors, more)


# -- Klinkenberg -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Klinkenberg:
    """k(s) = k (1 + c s + ...) over the slip length s of the walls, which of a gas is inverse to its pressure: with
    s = S / p the law of Klinkenberg (1941) k(p) = k (1 + b / p) has b = c S.

    coefficients: of the powers of s, from m2 on; rows: `slip_length` and `permeability` of every run.
    """

    coefficients: np.ndarray
    rows: list[dict[str, float]]

    @property
    def permeability(self) -> float:
        """Of a liquid, without slip, m2."""
        return float(self.coefficients[0])

    @property
    def slope(self) -> float:
        """c, 1/m."""
        return float(self.coefficients[1] / self.coefficients[0])


def klinkenberg(case: Case, slip_lengths: Sequence[float], out: Path, quiet: bool = True, overwrite: bool = False,
                say: Said | None = None) -> Klinkenberg:
    """Runs a steady case with walls of several slip lengths, m, and extrapolates its permeability to none.

    Of three lengths and more the fit is quadratic: c is the slope at zero. Leaves the runs in folders of `out`,
    klinkenberg.csv and klinkenberg.png. Raises LadderError for a case that is not steady or asks for several axes, and
    the errors of runs.
    """
    if case.flow != "stokes":
        raise LadderError("a ladder of slip lengths needs flow: stokes")
    if len(set(slip_lengths)) < 2 or min(slip_lengths) < 0.0:
        raise LadderError("give two or more slip lengths of zero and above")
    rows: list[dict[str, float]] = []
    for length in sorted(set(slip_lengths)):
        run = _put(replace(case, geometry=replace(case.geometry, slip_length=length)), out / f"{length:g}")
        k = solve_case(run, quiet, overwrite=overwrite)[0]["permeability"]
        if not isinstance(k, float):
            raise LadderError("a ladder of slip lengths needs a flow along one axis: drive: {axes: [x]}")
        rows.append({"slip_length": length, "permeability": k})
        if say is not None:
            say(f"slip length {length:g} m: {k:.4g} m2")
    found = fit_klinkenberg(rows)
    _table(out / "klinkenberg.csv", found.rows)
    if case.output.plots:
        from ..output.panels import plot_fit

        s, k = (np.array([row[name] for row in rows]) for name in ("slip_length", "permeability"))
        line = np.linspace(0.0, float(s.max()), 100)
        plot_fit(out / "klinkenberg.png", (s, k), (line, np.polyval(found.coefficients[::-1], line)),
                 ("slip length (m)", "permeability (m²)", f"k = {found.permeability:.3g} m² at no slip"), case.title)
    return found


def fit_klinkenberg(rows: Sequence[Mapping[str, float]]) -> Klinkenberg:
    """The law through runs with `slip_length`, m, and `permeability`, m2."""
    s, k = (np.array([row[name] for row in rows], float) for name in ("slip_length", "permeability"))
    return Klinkenberg(fitted(s, k, min(2, len(s) - 1)).values, [dict(row) for row in rows])


# -- representative volume -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """A cube of an image (a square in 2D): ranges: [first, end) along x, y(, z); voxels: its edge."""

    ranges: tuple[tuple[int, int], ...]
    voxels: int


def parts_of(sizes: Sequence[int], start: Sequence[int] | None = None, each: int = 3,
             shares: Sequence[float] = SHARES) -> list[Part]:
    """Growing cubes of an image: `each` of every edge, the first one in the middle, the others spread evenly; one where
    there is no room for others.

    sizes: voxels along x, y(, z); start: first voxel of the cropped image; shares: edges over the shortest side.
    """
    start = [0] * len(sizes) if start is None else start
    edges = sorted({max(round(share * min(sizes)), min(LEAST_VOXELS, min(sizes))) for share in shares})
    found: dict[tuple[tuple[int, int], ...], Part] = {}
    for edge in edges:
        room = np.array(sizes) - edge
        for number in range(each if room.any() else 1):
            place = np.mod(0.5 + number * GOLDEN ** -np.arange(1.0, len(sizes) + 1.0), 1.0)
            first = [int(a + v) for a, v in zip(start, np.rint(place * room))]
            ranges = tuple((a, a + edge) for a in first)
            found.setdefault(ranges, Part(ranges, edge))
    return list(found.values())


def representative_volume(case: Case, out: Path, each: int = 3, quiet: bool = True,
                          say: Said | None = None) -> list[dict[str, Any]]:
    """Porosity and permeability of growing cubes of the image of a steady case: a dict of each.

    Leaves rev.csv and rev.png in `out`. A cube without a percolating path has the permeability 0. Raises LadderError
    for a case without an image, that is not steady, or that asks for several axes, and the errors of runs.
    """
    from ..geometry.images.read import image_shape
    from ..scene.image_file import layout_of
    from .steady import NoFlowError

    spec, axis = case.geometry.voxels, flow_axis(case)
    if spec is None or case.flow != "stokes" or axis is None:
        raise LadderError("a representative volume needs an image, flow: stokes and an axis: drive: {axes: [x]}")
    shape = image_shape(spec.file, layout=layout_of(spec))
    if shape is None:
        raise LadderError(f"{spec.file}: the size of the image is not known; isph convert-voxels says what is wrong")
    ranges = spec.crop or tuple((0, n) for n in shape[::-1])
    rows: list[dict[str, Any]] = []
    for part in parts_of([end - first for first, end in ranges], [first for first, _ in ranges], each):
        row: dict[str, Any] = {"voxels": part.voxels, "edge": 0.0, "porosity": 0.0, "permeability": 0.0}
        row |= {f"first_{a}": first for a, (first, _) in zip("xyz", part.ranges)}
        cropped = replace(case.geometry, voxels=replace(spec, crop=part.ranges))
        folder = Path(tempfile.mkdtemp(prefix="isph-rev-"))
        run = _put(replace(case, geometry=cropped, refine=(), reference=None), folder / "run")
        run = replace(run, output=replace(run.output, snapshots=False, plots=False, grid=None))
        try:
            summary, flow = solve_case(run, quiet)
            row["porosity"] = float(summary["porosity"])
            k = summary["permeability"]
            row["permeability"] = float(k["xyz"[axis]] if isinstance(k, dict) else k)
            assert flow.geometry.voxel_size is not None
            row["edge"] = part.voxels * float(np.min(flow.geometry.voxel_size))
        except NoFlowError:
            from ..scene.build_geometry import build_geometry

            geometry = build_geometry(run, axis)
            size = geometry.voxel_size
            assert size is not None
            row["edge"] = part.voxels * float(np.min(size))
            row["porosity"] = porosity_of(geometry)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        rows.append(row)
        if say is not None:
            say(f"{part.voxels} voxels: porosity {row['porosity']:.4g}, k {row['permeability']:.4g} m2")
    _table(out / "rev.csv", rows)
    if case.output.plots:
        from ..output.panels import plot_representative_volume

        plot_representative_volume(out / "rev.png", rows, case.title)
    return rows


def porosity_of(geometry: Geometry) -> float:
    """Share of the voxels of the sample that are pores; microporous rock is left out."""
    from ..geometry.protocol import sample_voxels

    labels = geometry.labels
    assert labels is not None  # of an image
    sample, pores = sample_voxels(geometry), np.zeros(labels.shape, bool)
    pores[sample] = labels[sample] >= 0
    middles = geometry.lower + (np.argwhere(pores)[:, ::-1] + 0.5) * np.asarray(geometry.voxel_size)
    return np.count_nonzero(geometry.microporous(middles) < 0) / labels[sample].size


def _put(case: Case, directory: Path) -> Case:
    """The case with another output directory."""
    return replace(case, output=replace(case.output, directory=directory))


def _table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Comma-separated values with a head, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, csv_text(rows))
