"""The interface for Python: `run`, `load_case`, `permeability`, and their results. The commands use it too.

    import isphcli
    found = isphcli.permeability(image, voxel_size=2.25e-6, axis="x", refine="auto")
    found.permeability, found.permeability_error, found.warnings
    found.grid().arrays["velocity"]      # [z, y, x, 3]

No numerical library is imported before a function is called. docs/python.md shows more.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import COMPLETE
from .output.environment import launched, settle_threads

if TYPE_CHECKING:
    import numpy as np

    from .case.blocks import Case
    from .output.grid import Grid
    from .references.result import Result
    from .runs.results import Look


@dataclass(frozen=True)
class Picture:
    """A picture, PNG: shown by notebooks, `save(path)` writes it."""

    png: bytes

    def save(self, path: str | Path) -> None:
        """Writes the picture; what is there is replaced."""
        Path(path).write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png


@dataclass(frozen=True)
class RunResult:
    """The result of a run: numbers, error bars and warnings, and the flow at the end.

    case: as it was run, all defaults filled in; summary: the keys of summary.json (docs/output.md); flow: the flow at
    the end of the run, of a steady solve at its finest spacing along its first axis; directory: the folder with its
    files, None where none were kept.
    """

    case: Case
    summary: Mapping[str, Any] = field(repr=False)
    flow: Result = field(repr=False)
    directory: Path | None = None

    @property
    def complete(self) -> bool:
        """Whether the run has what it was asked for; where not, `warnings` says why."""
        return self.summary.get("status", "finished") in COMPLETE

    @property
    def permeability(self) -> float | dict[str, float] | None:
        """m2 along the drive, {axis: m2} of several axes, None where there is none."""
        return self.summary["permeability"]

    @property
    def permeability_error(self) -> float | dict[str, float] | None:
        """The error bar, m2, as `permeability`; None without one: ask for a second spacing (refine)."""
        return self.summary.get("permeability_error")

    @property
    def permeability_range(self) -> Sequence[float] | dict[str, Sequence[float]] | None:
        """(lowest, highest) k within the expected errors, m2, as `permeability`; None where they are unknown."""
        return self.summary.get("permeability_range")

    @property
    def porosity(self) -> float | None:
        """Share of the pores in the sample, without microporous rock."""
        return self.summary.get("porosity")

    @property
    def warnings(self) -> list[str]:
        """Sentences: what may be wrong with the case or its result, and why a run stopped short."""
        message = self.summary.get("message")
        return [*(self.summary.get("warnings") or ()), *([message] if message else [])]

    @property
    def x(self) -> np.ndarray:
        """(n, dim) m, positions of the fluid particles; velocity, pressure and phase are in the same order."""
        return self.flow.x

    @property
    def velocity(self) -> np.ndarray:
        """(n, dim) m/s."""
        return self.flow.velocity

    @property
    def pressure(self) -> np.ndarray:
        """(n,) Pa, without the part that the body force balances."""
        return self.flow.pressure

    @property
    def phase(self) -> np.ndarray:
        """(n,) int8, index of the fluid in `case.fluid_names`."""
        return self.flow.phase

    @property
    def history(self) -> Sequence[Mapping[str, Any]]:
        """A dict per step, or per solve: the columns of history.csv."""
        return self.flow.history

    def grid(self, cell: float | None = None) -> Grid:
        """velocity, pressure, phase and solid on a grid over the box: `Grid.arrays`, [z, y, x] as images.

        cell: its spacing, m. Without it: the voxels of an image, else the spacing of the particles.
        """
        from .output.grid import make_grid

        fields = {"velocity": self.velocity, "pressure": self.pressure, "phase": self.phase}
        geometry = self.flow.geometry
        return make_grid(geometry, self.x, fields, self.flow.spacing, geometry.voxel_size if cell is None else cell)

    def plot(self) -> Picture:
        """Speed of the flow: of a 2D scene the whole, of a 3D one a plane that holds the direction of the flow."""
        from .output.plots import Frame, plot_slice

        geometry = self.flow.geometry
        frame = Frame(geometry.dim, self.flow.spacing, self.case.title, geometry.lower, geometry.upper,
                      geometry.periodic, geometry.distance if geometry.has_solid else None)
        k = self.permeability
        two = len(set(self.phase.tolist())) > 1
        with tempfile.TemporaryDirectory(prefix="isph-") as folder:
            path = Path(folder, "slice.png")
            plot_slice(path, self.x, self.velocity, frame, permeability=k if isinstance(k, float) else None,
                       phase=self.phase if two else None)
            return Picture(path.read_bytes())

    def __str__(self) -> str:
        from .output.lines import closing_lines

        return closing_lines(self.case, self.summary, self.directory)


def load_case(case: Case | Mapping[str, Any] | str | Path, overrides: Sequence[str] = ()) -> Case:
    """A case from its file, or from nested dicts with the keys of docs/keys.md; one that was read is returned as it is.

    overrides: 'key.sub=value', as --set. Paths of inputs start from the folder of the file, of a dict from the working
    directory. Raises CaseError with everything that is wrong with it, ValueError for overrides of a case that was read.
    """
    from .case import load
    from .case.blocks import Case

    if isinstance(case, Case):
        if overrides:
            raise ValueError("overrides are for the file or the dict that a case is read from; this one was read")
        return case
    if isinstance(case, Mapping):
        return _case_of(case, overrides)
    return load.load_case(case, tuple(overrides))


def run(case: Case | Mapping[str, Any] | str | Path, *, out: str | Path | None = None, overrides: Sequence[str] = (),
        overwrite: bool = False, restart: str | Path | None = None, check: bool = True, quiet: bool = False,
        threads: int | None = None) -> RunResult:
    """Runs a case, as `isph run` does, and returns what it found.

    case, overrides: see `load_case`. out: folder for its files (docs/output.md); without it none are kept. overwrite:
    replace the results that `out` holds. restart: folder whose restart.npz a run of moving particles goes on from.
    check: look at the scene before, for warnings. quiet: no display of the progress. threads: of the kernels, all
    without it; BLAS has one while the run goes.

    A run that stops short of what it was asked for is no error: see `RunResult.complete`. Raises ValueError (CaseError,
    VoxelError, ShapeError, ParticleError, NoFlowError, FolderError, RestartError) for a case that cannot run, before
    anything is written, and SolveError, StepError or RunError for one that had to stop.
    """
    note = settle_threads(threads)
    if note and not quiet:
        print(note, file=sys.stderr, flush=True)
    if launched() > 1:
        from .domain.communicator import join
        from .output.compile_once import compile_once

        join(launched())
        compile_once()
    asked = load_case(case, overrides)
    from .runs.run import solve_case

    def looked() -> Look | None:
        if not check:
            return None
        from .preflight.look import look

        return look

    with _folder(out) as directory:
        output = replace(asked.output, directory=directory)
        if out is None:
            output = replace(output, snapshots=False, plots=False, grid=None)
        asked = replace(asked, output=output)
        summary, flow = solve_case(asked, quiet, restart, overwrite, looked())
        return RunResult(asked, summary, flow, None if out is None else directory)


def permeability(image: np.ndarray, *, voxel_size: float | str | Sequence[float | str],
                 axis: str | Sequence[str] = "x", solid: int | Sequence[int] | None = None,
                 grey: Mapping[str, Any] | None = None, order: str = "zyx",
                 refine: str | float | Sequence[float] = (), spacing: float | None = None,
                 options: Mapping[str, Any] | None = None, out: str | Path | None = None, quiet: bool = False,
                 threads: int | None = None) -> RunResult:
    """Permeability of an image by steady creeping flow, one particle per voxel unless `spacing` says otherwise.

    image: (2D or 3D) integers or bools; voxel_size: m, or "2.25 um", one or one along each of x, y(, z). axis: of the
    flow, several as "xyz" or a list. solid: the value or values that are solid, all others are pores: 1 without it, but
    of bools, of which some programs mark the pores, it has to be said. grey: of an image that is not segmented what the
    block geometry.voxels.grey of a case says, {"threshold": "otsu", "solid": "above"}. order: of the axes of the array,
    zyx or xyz (PoreSpy). refine: further spacings, m, or "auto" or "throats", for an error bar. spacing: of the
    particles, m. options: further keys of the case, nested dicts. out, quiet, threads: see `run`.

    Raises ValueError for an image or values that cannot be used, and what `run` raises.
    """
    import numpy as np

    from .case.units import number_in

    image = np.asarray(image)
    axes = list(axis)
    voxels: dict[str, Any] = {"voxel_size": voxel_size, "axes": order}
    if grey is not None:
        voxels["grey"] = grey
    else:
        image, voxels["labels"] = _labelled(image, solid)
    sizes = [number_in(str(size), "m") for size in np.atleast_1d(voxel_size)]
    further = [refine] if isinstance(refine, float) else refine if isinstance(refine, str) else list(refine)
    with tempfile.TemporaryDirectory(prefix="isph-") as folder:
        file = Path(folder, "image.npy")
        np.save(file, image)
        case = {
            "title": f"permeability along {', '.join(axes)}",
            "geometry": {"voxels": {**voxels, "file": file}},
            "particles": {"spacing": min(sizes) if spacing is None else spacing},
            "fluids": {"water": {"density": 1000.0, "viscosity": 1e-3}},
            "flow": "stokes",
            "drive": {"axes": axes},
            "refine": further,
        }
        return run(_merged(case, options or {}), out=out, quiet=quiet, threads=threads)


def _labelled(image: np.ndarray, solid: int | Sequence[int] | None) -> tuple[np.ndarray, dict[str, Any]]:
    """(image of integers, labels of a case) where `solid` lists the values of the solid."""
    import numpy as np

    if image.dtype == bool:
        if solid is None:
            raise ValueError("an image of bools does not say what is solid: give solid=True or solid=False")
        image = image.astype(np.uint8)
    if image.dtype.kind not in "iu":
        raise ValueError(f"an image of type {image.dtype} has no labels: give integers or bools, or grey={{...}}")
    solids = np.atleast_1d(np.asarray(1 if solid is None else solid)).astype(int)
    values = np.unique(image)
    missing = [int(value) for value in solids if value not in values]
    if len(missing) == len(solids):
        raise ValueError(f"no voxel has the value {missing[0]} that is solid; the image holds "
                         f"{', '.join(map(str, values[:10]))}: say which with solid=...")
    pores = [int(value) for value in values if value not in solids]
    if not pores:
        raise ValueError("every voxel is solid")
    return image, {"solid": [int(value) for value in solids if value in values], "water": pores}


def _case_of(values: Mapping[str, Any], overrides: Sequence[str]) -> Case:
    """The case that nested dicts say; problems name keys alone, as there is no file with lines."""
    import yaml

    from .case.load import read_case
    from .case.yaml import CaseError

    text = yaml.safe_dump(_plain(values), sort_keys=False, allow_unicode=True)
    try:
        return replace(read_case(text.encode(), Path("case"), overrides), path=None, places={})
    except CaseError as error:
        raise CaseError(tuple(replace(p, file="case" if p.line else p.file, line=None)
                              for p in error.problems)) from None


def _plain(value: Any) -> Any:
    """Values as YAML knows them: numbers of numpy as Python's, arrays and tuples as lists, paths as text."""
    if isinstance(value, Mapping):
        return {str(name): _plain(v) for name, v in value.items()}
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value


def _merged(values: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Nested dicts, the values of `more` in place of those of the same keys."""
    found = dict(values)
    for name, value in more.items():
        inner = found.get(name)
        found[name] = _merged(inner, value) if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return found


@contextlib.contextmanager
def _folder(out: str | Path | None) -> Iterator[Path]:
    """The folder of a run: `out`, or one that is gone at the end."""
    if out is not None:
        yield Path(out).absolute()
        return
    with tempfile.TemporaryDirectory(prefix="isph-") as folder:
        yield Path(folder, "run")
