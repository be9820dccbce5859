"""report.html: the question of a run, its results and pictures and how to repeat it, in one file without links to the
network; several runs side by side.

Only the files of runs are read: summary.json, case.yaml and the pictures. Nothing that takes long is imported.
"""

from __future__ import annotations

import base64
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import yaml

from .lines import (
    drop_lines,
    measure_lines,
    per_axis,
    permeability_lines,
    scene_lines,
    shown_error,
    time_lines,
    two_fluid_lines,
    velocity_lines,
)

PHYSICAL = {"flow_3d.png": "Rock cut open, streamlines coloured by speed", "slice.png": "Speed of the flow",
            "fluids_3d.png": "Rock cut open, the fluids and their interface", "phases.png": "The fluids",
            "wall_shear_3d.png": "Shear stress at the walls", "profiles.png": "Profiles along the axis",
            "curve.png": "Steps of the drive", "distributions.png": "Sizes of the pores, and speeds",
            "histories.png": "Histories"}
NUMERICAL = {"numerics.png": "Solver, resolution and conservation"}
PICTURES = PHYSICAL | NUMERICAL
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #2f2f2f; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; } th, td { text-align: left; vertical-align: top; padding: .2rem 1rem .2rem 0; }
th { font-weight: 600; } tr { border-bottom: 1px solid #dcdad5; }
.answer { font-size: 1.25rem; } .warning { border-left: 4px solid #d1495b; padding-left: .8rem; }
figure { margin: 1rem 0; } img { max-width: 100%; } pre { background: #f5f4f1; padding: 1rem; overflow-x: auto; }
"""


class ReportError(ValueError):
    """A folder without the files that a report needs."""


@dataclass(frozen=True)
class Run:
    """The results of one run.

    directory: its folder; summary: of summary.json; case: the effective case as YAML reads it; text: of case.yaml;
    pictures: (file name, bytes) in the order of PICTURES.
    """

    directory: Path
    summary: Mapping[str, Any]
    case: Mapping[str, Any]
    text: str
    pictures: tuple[tuple[str, bytes], ...]

    @property
    def title(self) -> str:
        """Of the case, or the name of the folder."""
        return str(self.summary.get("title") or self.directory.name)


def read_run(directory: str | os.PathLike) -> Run:
    """The results of a run in a folder. Raises ReportError where it is not the folder of a run that has ended."""
    folder = Path(directory)
    if not folder.exists():
        raise ReportError(f"{folder}: no such folder; name the folder of a run that has ended")
    if folder.is_file():
        raise ReportError(f"{folder}: is a file; name the folder of a run that has ended")
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        text = (folder / "case.yaml").read_text(encoding="utf-8")
        case = yaml.safe_load(text)
    except FileNotFoundError as error:
        raise ReportError(f"{folder}: has no {Path(str(error.filename)).name}; name the folder of a run that has "
                          "ended") from None
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ReportError(f"{folder}: cannot be read: {str(error).splitlines()[0]}") from None
    if not isinstance(summary, dict) or not isinstance(case, dict):
        raise ReportError(f"{folder}: summary.json or case.yaml is not that of a run")
    pictures = tuple((name, (folder / name).read_bytes()) for name in PICTURES if (folder / name).is_file())
    return Run(folder, summary, case, text, pictures)


def write_report(path: str | os.PathLike, directories: Sequence[str | os.PathLike]) -> None:
    """Write the report on the runs in some folders, whole or not at all. Raises ReportError."""
    from .files import write_text

    write_text(path, report_page([read_run(directory) for directory in directories]))


def report_page(runs: Sequence[Run]) -> str:
    """The page, HTML without links to anything outside of it."""
    title = runs[0].title if len(runs) == 1 else f"{len(runs)} runs side by side"
    body = _of_one(runs[0]) if len(runs) == 1 else _side_by_side(runs)
    return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
            f"<style>{STYLE}</style>\n</head>\n<body>\n<h1>{escape(title)}</h1>\n{body}</body>\n</html>\n")


def question(run: Run) -> str:
    """The question that a case asks, a sentence."""
    drive = run.case.get("drive") or {}
    names = list(run.case.get("fluids") or {})
    if run.case.get("flow") == "stokes":
        axes = drive.get("axes") or [axis for axis, k in _permeabilities(run) if axis]
        along = f" along {', '.join(axes)}" if axes else ""
        return f"What is the permeability{along}? Steady creeping flow of {names[0] if names else 'the fluid'}."
    verb = ("is driven" if drive else "moves") if len(names) == 1 else ("are driven" if drive else "move")
    return f"How {' and '.join(names)} {verb} in time: moving particles, Navier-Stokes equations."


def answer_lines(run: Run) -> list[tuple[str, str]]:
    """The results: permeability with its bar and range, or velocities; measures of two fluids; errors."""
    summary = run.summary
    lines = permeability_lines(summary)
    if summary.get("permeability") is None:
        geometry = run.case.get("geometry") or {}
        part = geometry.get("voxels") or geometry.get("clear_layer") or run.case.get("reservoirs")
        lines += velocity_lines(summary, bool(part))
    lines += [*measure_lines(summary), *drop_lines(summary), *two_fluid_lines(run.case.get("fluids") or (), summary)]
    errors = {k: v for k, v in (summary.get("errors") or {}).items() if k != "main"}
    if summary.get("not_compared"):
        lines.append(("reference", f"not compared: {summary['not_compared']}"))
    return lines + [(f"error {name}", shown_error(name, value, None)) for name, value in errors.items()]


def cost_lines(run: Run) -> list[tuple[str, str]]:
    """The costs of a run, and the machine and versions of its libraries."""
    summary = run.summary
    counts, memory = summary.get("particles") or {}, summary.get("peak_memory_bytes")
    lines = [("particles", f"{counts['fluid']:,} in the fluid")] if "fluid" in counts else []
    lines += time_lines(summary)
    if memory is not None:
        lines.append(("memory", f"{memory / 2**30:.2f} GB at most"))
    lines.append(("threads", str(summary.get("threads", "not told"))))
    versions = summary.get("versions") or {}
    return [*lines, ("versions", ", ".join(f"{name} {number}" for name, number in versions.items())),
            ("system", f"{platform.system()} {platform.machine()} (of this report)"),
            ("folder", str(run.directory.absolute()))]


def _permeabilities(run: Run) -> list[tuple[str, float]]:
    return [(axis.strip(), k) for axis, k in per_axis(run.summary.get("permeability"))]


def _warnings(run: Run) -> list[str]:
    found = [str(text) for text in run.summary.get("warnings") or ()]
    message = run.summary.get("message")
    return [*found, str(message)] if message else found


def _of_one(run: Run) -> str:
    warnings = "".join(f'<p class="warning">{escape(text)}</p>\n' for text in _warnings(run))
    pictures, numerics = ("".join(_figure(name, data) for name, data in run.pictures if name in kind)
                          for kind in (PHYSICAL, NUMERICAL))
    return (f"<h2>Question</h2>\n<p>{escape(question(run))}</p>\n{_table(scene_lines(run.summary))}"
            f'<h2>Answer</h2>\n<p>Status: {escape(str(run.summary.get("status")))}.</p>\n'
            f'<div class="answer">\n{_table(answer_lines(run))}</div>\n'
            f"<h2>Warnings and notes</h2>\n{warnings or '<p>None.</p>' + chr(10)}"
            f"<h2>Pictures</h2>\n{pictures or '<p>None were drawn.</p>' + chr(10)}"
            f"{'<h2>Numerics</h2>' + chr(10) + numerics if numerics else ''}"
            f"<h2>To repeat it</h2>\n{_table(cost_lines(run))}"
            f"<p>The case, with all defaults; <code>isph run case.yaml</code> repeats the run:</p>\n"
            f"<pre>{escape(run.text)}</pre>\n")


def _side_by_side(runs: Sequence[Run]) -> str:
    """A column per run: differences between the cases, results, then scene and costs; values that are the same in all
    runs come last, once."""
    cells: list[dict[str, str]] = [dict([("status", str(run.summary.get("status"))), *answer_lines(run),
                                         ("warnings", "\n".join(_warnings(run)) or "none"), *scene_lines(run.summary),
                                         *cost_lines(run)]) for run in runs]
    settings = [_flat(run.case) for run in runs]
    differing = [name for name in _merged(settings) if len({known.get(name) for known in settings}) > 1]
    head = "".join(f"<th>{escape(run.title)}<br>{escape(run.directory.name)}</th>" for run in runs)
    rows = [_row(name, [known.get(name, "") for known in settings]) for name in differing]
    asked = f"<h2>What differs between the cases</h2>\n<table>\n<tr><th></th>{head}</tr>\n{''.join(rows)}</table>\n"
    names = _merged(cells)
    alike = [name for name in names if len({known.get(name) for known in cells}) == 1]
    rows = [_row(name, [known.get(name, "") for known in cells]) for name in names if name not in alike]
    found = f"<h2>What came out</h2>\n<table>\n<tr><th></th>{head}</tr>\n{''.join(rows)}</table>\n"
    same = f"<h2>Alike in all of them</h2>\n{_table([(name, cells[0][name]) for name in alike])}" if alike else ""
    drawn = []
    for name in PICTURES:
        of_each = [dict(run.pictures).get(name) for run in runs]
        if any(of_each):
            parts = "".join(f"<td>{_image(name, data) if data else ''}</td>" for data in of_each)
            drawn.append(f"<tr><th>{PICTURES[name]}</th>{parts}</tr>\n")
    pictures = f"<h2>Pictures</h2>\n<table>\n<tr><th></th>{head}</tr>\n{''.join(drawn)}</table>\n"
    return (asked if differing else "") + found + (pictures if drawn else "") + same


def _merged(runs: Sequence[Mapping[str, str]]) -> list[str]:
    """Names of all runs, each behind the one that it follows in its own run."""
    names: list[str] = []
    for known in runs:
        place = 0
        for name in known:
            if name not in names:
                names.insert(place, name)
            place = names.index(name) + 1
    return names


def _flat(values: Mapping[str, Any], above: str = "") -> dict[str, str]:
    """{dotted path: text} of the values of a case, lists whole; where it writes is left out."""
    found: dict[str, str] = {}
    for name, value in values.items():
        path = f"{above}{name}"
        if isinstance(value, dict):
            found |= _flat(value, f"{path}.")
        elif path != "output.directory":
            found[path] = str(value)
    return found


def _table(lines: Sequence[tuple[str, str]]) -> str:
    return f"<table>\n{''.join(_row(name, [value]) for name, value in lines)}</table>\n" if lines else ""


def _row(name: str, values: Sequence[str]) -> str:
    cells = "".join(f"<td>{escape(value).replace(chr(10), '<br>')}</td>" for value in values)
    return f"<tr><th>{escape(name.strip())}</th>{cells}</tr>\n"


def _figure(name: str, data: bytes) -> str:
    return f"<figure>{_image(name, data)}<figcaption>{PICTURES[name]}</figcaption></figure>\n"


def _image(name: str, data: bytes) -> str:
    return f'<img alt="{PICTURES[name]}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
