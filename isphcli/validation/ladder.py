"""Error against run time: a case with a `reference` on a ladder of resolutions.

`validate_cases` runs every case, in every setting that `--vary` asks for, at twice its spacing, its own and
half of it (and so on), prints a row per level, and leaves validation.json, .csv, .md and work_precision.png.
The verdict is that of the case's own spacing, so that it does not depend on how fast the machine is.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import COMPLETE
from ..case.blocks import Case
from ..case.load import load_case
from ..output.files import csv_text, write_summary, write_text
from ..output.folder import Folder, FolderError, ours, prepare, remove
from ..references.compare import COMPARISONS
from ..scene.image_geometry import image_voxel_size
from .markdown import items, origin, table
from .peers import Peer, peers_of

REPORTS = ("validation.*", "work_precision.png")
LEVELS = 3  # of a ladder where none are asked for: of three the order can be observed
BUDGET = 60.0  # s, of a ladder where none is asked for; the case's own spacing is then run in any case
GROWTH = 1.1  # exponent of the particles in the time of a step, to predict that of the next level
WARM = 2.0  # s: a shorter level is run twice, so that the loading of kernels is not counted
NOT_COMPARED = "not compared"
KEPT = ("particles.spacing", "refine", "output", "reference")  # keys that the ladder itself sets or reads
HEADS = ("level", "spacing", "particles", "steps", "error", "order", "cpu s", "compile s", "wall s", "MB")
WIDTHS = (5, 10, 10, 6, 11, 6, 9, 9, 9, 7)
Vary = Sequence[tuple[str, Sequence[str]]]
Say = Callable[[str], None]


@dataclass
class Level:
    """One run of a ladder; seconds without compilation, which stands apart, and without those of the reference."""

    number: int
    spacing: float
    own: bool
    status: str = ""
    particles: int | None = None
    steps: int | None = None
    error: float | None = None
    errors: dict[str, float] = field(default_factory=dict)
    order: float | None = None
    cpu_seconds: float | None = None
    compile_seconds: float | None = None
    wall_seconds: float | None = None
    cpu_process_seconds: float | None = None  # of the operating system around the whole run, compilation too
    peak_memory_bytes: int | None = None
    iterations: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)  # of the check, at the spacing of this level
    repeated_to: float | None = None  # largest difference of an error where the level was run twice
    dimension: int = 3

    @property
    def stopped_short(self) -> bool:
        """Whether it ran, but ended before it had what the case asks for."""
        return self.ran and self.status not in (*COMPLETE, "")

    @property
    def ran(self) -> bool:
        """Whether it has an error."""
        return self.error is not None


@dataclass
class Ladder:
    """The levels of a case in one setting."""

    case: Case
    setting: dict[str, str]
    main: str = ""
    levels: list[Level] = field(default_factory=list)
    stopped: str = ""

    @property
    def done(self) -> list[Level]:
        """Levels that ran to their end."""
        return [level for level in self.levels if level.ran]

    @property
    def name(self) -> str:
        """Of the setting; empty without one."""
        return ", ".join(f"{key}={value}" for key, value in self.setting.items())

    @property
    def order(self) -> float | None:
        """Least squares slope of log error over log spacing."""
        return slope([level.spacing for level in self.done], [level.error for level in self.done])

    @property
    def own(self) -> Level | None:
        """The level of the spacing that stands in the case, which the verdict is about, where it ran."""
        return next((level for level in self.done if level.own), None)

    @property
    def best(self) -> Level | None:
        """The level with the smallest error."""
        return min(self.done, key=lambda level: abs(level.error or 0.0), default=None)


@dataclass(frozen=True)
class Verdict:
    """Whether a ladder keeps the bound of its reference, and why."""

    passed: bool
    word: str
    why: str


# -- the whole -------------------------------------------------------------------------------------------


def validate_cases(
    cases: Sequence[Case],
    *,
    levels: int | None = None,
    budget: float | None = None,
    out: Path | None = None,
    quiet: bool = False,
    vary: Vary = (),
    overrides: Sequence[str] = (),
    estimates: Mapping[Path | None, float | None] | None = None,
    say: Say | None = None,
) -> tuple[str, bool]:
    """Run the ladders of cases that name a reference: (closing page, whether all are within their bounds).

    levels: spacings of a ladder; budget: s of a ladder; out: directory, with a folder per case; vary: keys
    with the values that are overlaid, every combination a ladder; overrides: of `--set`, under those of vary;
    estimates: s of the own spacing of a case file, to decide on its first level; say: prints a line as it
    goes. Raises CaseError for a setting that cannot be, before anything is run.
    """
    say = say or _print
    out = Path("out", "validate") if out is None else out
    plans = [_ladders(case, vary, overrides) for case in cases]
    places = _folders(cases, out)
    with contextlib.ExitStack() as held:  # files of others are found before anything is run
        for folder in [*places, *[out] * (len(cases) > 1)]:
            held.enter_context(Folder(folder, REPORTS, keep=True))
        for ladders, folder in zip(plans, places):
            prepare(folder)
            estimate = (estimates or {}).get(ladders[0].case.path)
            say(f"{ladders[0].case.title or folder.name}: {_kind(ladders[0].case)}")
            for ladder in ladders:
                try:
                    _climb(ladder, folder, levels or LEVELS, budget, estimate, quiet, say)
                finally:  # an interrupted ladder writes the levels that have run
                    write_results(folder, ladders)
            say("")
        return _close(plans, places, out)


def _close(plans: Sequence[list[Ladder]], places: Sequence[Path], out: Path) -> tuple[str, bool]:
    """(closing page, whether all are within their bounds) of ladders that have been climbed."""
    everything = [ladder for ladders in plans for ladder in ladders]
    page = closing_page(everything)
    files = [str(folder / "validation.md") for folder in places]
    if len(plans) > 1:
        _write_page(out, everything, page)
        files.append(str(out / "validation.md"))
    return page + "\n" + "\n".join(files), all(verdict(ladder).passed for ladder in everything)


def _print(line: str) -> None:
    print(line, flush=True)


def _ladders(case: Case, vary: Vary, overrides: Sequence[str]) -> list[Ladder]:
    """A ladder for every combination of the values; raises CaseError, or ValueError for a key of `KEPT`."""
    for name, _ in vary:
        if any(name == kept or name.startswith(kept + ".") for kept in KEPT):
            raise ValueError(f"--vary {name}: the ladder itself sets it; choose another key")
    if not vary:
        return [Ladder(case, {})]
    if case.path is None:
        raise ValueError("--vary needs a case that was read from a file")
    ladders = []
    for values in itertools.product(*(values for _, values in vary)):
        setting = dict(zip((name for name, _ in vary), values))
        words = (*overrides, *(f"{name}={value}" for name, value in setting.items()))
        ladders.append(Ladder(load_case(case.path, words), setting))
    return ladders


def _folders(cases: Iterable[Case], out: Path) -> list[Path]:
    """A folder per case, named after its file; a number tells files of one name apart."""
    found: list[Path] = []
    for case in cases:
        stem = case.path.stem if case.path else "case"
        names = (stem if k == 1 else f"{stem}_{k}" for k in itertools.count(1))
        found.append(next(out / name for name in names if out / name not in found))
    return found


def _kind(case: Case) -> str:
    assert case.reference is not None
    source = f", {case.reference.source}" if case.reference.source else ""
    return f"reference {case.reference.kind}{source}"


# -- the ladder ------------------------------------------------------------------------------------------


def ladder_spacings(case: Case, levels: int) -> list[float]:
    """Spacings from coarse to fine, m: the own one is the second, the only one if levels is 1.

    Those of an image divide the voxel, which is the coarsest of them.
    """
    own = case.particles.spacing
    voxels = case.geometry.voxels
    coarser = [2.0 * own] if voxels is None else _voxel_parts(own, float(np.min(image_voxel_size(voxels))))
    coarser = coarser[max(0, len(coarser) - levels + 1) :] if levels > 1 else []
    finer = [own / 2.0**k for k in range(1, levels - len(coarser))]
    return [*coarser, own, *finer]


def _voxel_parts(own: float, voxel: float) -> list[float]:
    """Spacings above the own one that divide a voxel: halved parts, and the voxel itself."""
    parts = round(voxel / own)
    if parts < 1 or not math.isclose(parts * own, voxel, rel_tol=1e-6):
        return []
    found = []
    while parts % 2 == 0:
        parts //= 2
        found.append(voxel / parts)
    if parts > 1:
        found.append(voxel)
    return found[::-1]


def _climb(
    ladder: Ladder,
    folder: Path,
    levels: int,
    budget: float | None,
    estimate: float | None,
    quiet: bool,
    say: Say,
) -> None:
    """Run the levels of a ladder as far as the budget allows, a row per level."""
    case = ladder.case
    if ladder.name:
        say(f"-- {ladder.name}")
    assert case.reference is not None
    if case.reference.kind not in COMPARISONS:
        ladder.stopped = f"reference.kind {case.reference.kind} is not compared yet; no level was run"
        say(ladder.stopped)
        return
    say(_cells(HEADS))
    start = folder / _slug(ladder.name) if ladder.name else folder
    spent, before = 0.0, set()
    for number, spacing in enumerate(ladder_spacings(case, levels), 1):
        expected = predicted_seconds(ladder, spacing, estimate)
        ladder.stopped = _over(number, spacing, case, budget, spent, expected)
        if ladder.stopped:
            say(ladder.stopped)
            return
        level, seconds = run_level(case, number, spacing, start / f"level_{number}", quiet)
        if level.status.startswith(NOT_COMPARED):  # nor would a further one be
            ladder.levels.append(level)
            ladder.stopped = level.status
            say(ladder.stopped)
            return
        spent += seconds
        if level.ran and ladder.done:
            level.order = slope([ladder.done[-1].spacing, spacing], [ladder.done[-1].error, level.error])
        ladder.main = str(level.errors.pop("main", ladder.main))
        ladder.levels.append(level)
        say(row(level, ladder.main))
        for text in level.warnings:
            if text not in before:  # a coarser level has thinner throats
                say(f"       warning: {text}")
        before |= set(level.warnings)


def _over(
    number: int, spacing: float, case: Case, budget: float | None, spent: float, expected: float | None
) -> str:
    """Why a level is not run; empty where it is."""
    if budget is None and spacing >= case.particles.spacing * (1 - 1e-9):
        return ""
    bound = BUDGET if budget is None else budget
    if expected is None or spent + expected <= bound:
        return ""
    return (
        f"stopped before level {number}, spacing {spacing:g}: it would take about {expected:.2g} s, and "
        f"{spent:.2g} of {bound:g} s are spent"
    )


def predicted_seconds(ladder: Ladder, spacing: float, estimate: float | None = None) -> float | None:
    """Wall seconds of the next level, from the last one; of the first one from an estimate of the own level.

    Proportional to particles^1.1 and to steps; None where neither is known.
    """
    case, done = ladder.case, ladder.done
    dim = done[-1].dimension if done else case.dim or 3
    before = done[-1].spacing if done else case.particles.spacing
    seconds = done[-1].wall_seconds if done else estimate
    if seconds is None:
        return None
    return seconds * (before / spacing) ** (GROWTH * dim) * _step_growth(ladder, before / spacing)


def _step_growth(ladder: Ladder, refined: float) -> float:
    """Steps of the next level over those of the last: as seen between the last two, else as the spacing."""
    case, done = ladder.case, ladder.done
    if case.flow == "stokes" or (case.time is not None and case.time.step):
        return 1.0
    if len(done) > 1 and done[-1].steps and done[-2].steps:
        seen = math.log(done[-1].steps / done[-2].steps) / math.log(done[-2].spacing / done[-1].spacing)
        return refined ** max(seen, 0.0)
    return refined


def run_level(case: Case, number: int, spacing: float, directory: Path, quiet: bool) -> tuple[Level, float]:
    """One level, and the wall seconds that it took in all without compilation.

    A short level is run a second time, and that one counts: loading kernels takes time too.
    """
    level = _run(case, number, spacing, directory, quiet)
    seconds = level.wall_seconds or 0.0
    if not level.ran or seconds > WARM:
        return level, seconds
    again = _run(case, number, spacing, directory, quiet)
    if not again.ran:
        return again, seconds
    again.compile_seconds = level.compile_seconds
    again.repeated_to = max(
        abs(value - again.errors[name]) for name, value in level.errors.items() if name != "main"
    )
    return again, seconds + (again.wall_seconds or 0.0)


def _run(case: Case, number: int, spacing: float, directory: Path, quiet: bool) -> Level:
    """Run a case at a spacing; a run that fails becomes a level with the message as its status."""
    from ..preflight.look import look
    from ..runs.run import run_case

    files = replace(case.output, directory=directory.absolute(), snapshots=False, plots=False)
    particles = replace(case.particles, spacing=spacing)
    level = Level(number, spacing, math.isclose(spacing, case.particles.spacing, rel_tol=1e-9))
    _forget_peak()
    clock = time.process_time()
    try:
        asked = replace(case, particles=particles, refine=(), output=files)
        summary = run_case(asked, quiet=quiet, overwrite=ours(directory), look=look)
    except FolderError:  # ends the whole command, as one of its own files would
        raise
    except (ValueError, RuntimeError, ArithmeticError, MemoryError) as error:  # a full disk ends the command
        level.status = f"{type(error).__name__}: {error}"
        return level
    level.cpu_process_seconds = time.process_time() - clock
    return _filled(level, summary)


def _filled(level: Level, summary: Mapping[str, Any]) -> Level:
    """The level with the values of a summary."""
    cpu, wall = summary["cpu_seconds"], summary["wall_seconds"]
    level.status = summary["status"]
    level.warnings = list(summary.get("warnings") or ())
    level.dimension = summary["dimension"]
    level.particles = summary["particles"]["fluid"]
    level.steps = summary["steps"]
    if summary.get("not_compared"):
        level.status = f"{NOT_COMPARED}: {summary['not_compared']}"
        return level
    level.errors = dict(summary["errors"])
    level.error = level.errors[level.errors["main"]]  # type: ignore[index]
    level.compile_seconds = cpu.get("compile", 0.0)
    # neither the compiler nor the reference solution is a cost of the method
    level.cpu_seconds = cpu["total"] - level.compile_seconds - cpu.get("reference", 0.0)
    level.wall_seconds = wall["total"] - wall.get("compile", 0.0) - wall.get("reference", 0.0)
    level.peak_memory_bytes = summary["peak_memory_bytes"]
    level.iterations = {name: count["mean"] for name, count in summary["iterations"].items()}
    return level


def _forget_peak() -> None:
    """Let the peak memory start anew where the system can (Linux); elsewhere it is that of the process."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w", encoding="utf-8") as file:
        file.write("5")


def slope(x: Sequence[float | None], y: Sequence[float | None]) -> float | None:
    """Least squares slope of log |y| over log x; None of fewer than two points, or where a value is zero."""
    points = [(a, abs(b)) for a, b in zip(x, y) if a and b]
    if len(points) < 2 or len({a for a, _ in points}) < 2:
        return None
    x_log, y_log = np.log(np.array(points)).T
    return float(np.polyfit(x_log, y_log, 1)[0])


# -- the verdict -----------------------------------------------------------------------------------------


def verdict(ladder: Ladder) -> Verdict:
    """Whether the main error at the own spacing is within reference.tolerance; a spacing not run fails."""
    reference = ladder.case.reference
    assert reference is not None
    own = next((level for level in ladder.levels if level.own), None)
    if own is None:
        return Verdict(False, "NOT RUN", ladder.stopped or "the own spacing of the case was not reached")
    if own.error is None:
        return Verdict(False, "FAIL", own.status)
    if reference.tolerance is None:
        return Verdict(True, "no bound", "the case has no reference.tolerance")
    if own.stopped_short:
        return Verdict(False, "STOPPED SHORT", f"{own.status}: the error, {own.error:.3g}, is of a flow on its way")
    within = abs(own.error) <= reference.tolerance
    sign = "<=" if within else ">"
    why = f"|{own.error:.3g}| {sign} {reference.tolerance:g} at spacing {own.spacing:g}"
    return Verdict(within, "pass" if within else "FAIL", why)


# -- text ------------------------------------------------------------------------------------------------


def row(level: Level, main: str) -> str:
    """A level as a line of the printed table."""
    if not level.ran:
        return _cells([str(level.number), f"{level.spacing:.4g}"]) + f"  {level.status}"
    rest = [f"{name} {count:.3g}" for name, count in level.iterations.items()]
    rest += [f"{name} {value:.3g}" for name, value in level.errors.items() if name not in (main, "main")]
    if level.stopped_short:
        rest.insert(0, level.status.upper())
    return _cells(numbers(level)) + "  " + ", ".join(rest)


def numbers(level: Level) -> list[str]:
    """The columns `HEADS` of a level."""
    memory = level.peak_memory_bytes
    return [
        f"{level.number}{'*' if level.own else ''}",
        f"{level.spacing:.4g}",
        str(level.particles),
        str(level.steps or "-"),
        f"{level.error:.3e}",
        _or_dash(level.order),
        _or_dash(level.cpu_seconds),
        _or_dash(level.compile_seconds),
        _or_dash(level.wall_seconds),
        "-" if memory is None else f"{memory / 1e6:.0f}",
    ]


def _cells(texts: Sequence[str]) -> str:
    return "  ".join(f"{text:>{width}}" for text, width in zip(texts, WIDTHS))


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def closing_page(ladders: Sequence[Ladder]) -> str:
    """A block per ladder: best error, order, bound and verdict with its reasons."""
    lines = []
    for ladder in ladders:
        result, best = verdict(ladder), ladder.best
        lines.append(f"{result.word:8}  {_name(ladder)}: {result.why}")
        if best is not None:
            lines.append(
                f"{'':8}  best {ladder.main} {best.error:.3e} at spacing {best.spacing:g} for "
                f"{best.cpu_seconds:.2f} CPU s; order {_or_dash(ladder.order)}"
            )
        if ladder.case.reference and ladder.case.reference.reason:
            lines.append(f"{'':8}  why this bound: {ladder.case.reference.reason}")
        if ladder.stopped and result.word != "NOT RUN":
            lines.append(f"{'':8}  {ladder.stopped}")
    missed = sum(not verdict(ladder).passed for ladder in ladders)
    lines.append(f"{len(ladders) - missed} of {len(ladders)} passed")
    return "\n".join(lines)


def _name(ladder: Ladder) -> str:
    stem = ladder.case.path.stem if ladder.case.path else ladder.case.title
    return f"{stem} ({ladder.name})" if ladder.name else stem


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9.=+-]+", "_", text).strip("_.") or "setting"


# -- files -----------------------------------------------------------------------------------------------


def write_results(folder: Path, ladders: Sequence[Ladder]) -> None:
    """validation.json, .csv, .md and work_precision.png of one case; called after each ladder."""
    peers = _peers(ladders)
    head = origin()
    drawn = any(level.error and level.cpu_seconds for ladder in ladders for level in ladder.done)
    if drawn:
        draw(folder / "work_precision.png", ladders, [peer for peer, why in peers if not why])
    else:
        remove(folder / "work_precision.png")
    write_summary(folder / "validation.json", _record(ladders, peers, head))
    write_text(folder / "validation.csv", _csv(ladders))
    write_text(folder / "validation.md", _markdown(ladders, peers, head, drawn))


def _write_page(out: Path, ladders: Sequence[Ladder], page: str) -> None:
    """The closing page of several cases."""
    head = origin()
    rows = [_verdict_cells(ladder) for ladder in ladders]
    verdicts = table(VERDICTS, rows)
    lines = ["# Validation", "", *items(f"{k}: {v}" for k, v in head.items()), "", *verdicts]
    text = "\n".join([*lines, "", page.splitlines()[-1], ""])
    write_text(out / "validation.md", text)
    results = [{"name": _name(ladder), **_ladder_record(ladder)} for ladder in ladders]
    write_summary(out / "validation.json", {**head, "results": results})


# CPU s are of the spacing that the verdict names, those of the best error of its own
VERDICTS = ("case", "verdict", "why", "CPU s", "best error", "its spacing", "its CPU s", "order", "why this bound")


def _verdict_cells(ladder: Ladder) -> list[str]:
    result, own, best = verdict(ladder), ladder.own, ladder.best
    assert ladder.case.reference is not None
    return [
        _name(ladder), result.word, result.why, _or_dash(None if own is None else own.cpu_seconds),
        *(("-", "-", "-") if best is None else (f"{best.error:.3e}", f"{best.spacing:g}", _or_dash(best.cpu_seconds))),
        _or_dash(ladder.order), ladder.case.reference.reason or "-",
    ]  # fmt: skip


def _record(ladders: Sequence[Ladder], peers: Iterable[tuple[Peer, str]], head: dict[str, str]) -> dict:
    case = ladders[0].case
    assert case.reference is not None
    reference = {k: getattr(case.reference, k) for k in ("kind", "value", "tolerance", "source", "reason")}
    return {
        "title": case.title,
        "case": str(case.path) if case.path else None,
        **head,
        "reference": reference,
        "settings": [_ladder_record(ladder) for ladder in ladders],
        "peers": [asdict(peer) | {"comparable": not why, "difference": why} for peer, why in peers],
    }


def _ladder_record(ladder: Ladder) -> dict[str, Any]:
    return {
        "setting": ladder.setting,
        "main": ladder.main,
        "order": ladder.order,
        "stopped": ladder.stopped or None,
        "verdict": asdict(verdict(ladder)),
        "levels": [asdict(level) for level in ladder.levels],
    }


def _csv(ladders: Sequence[Ladder]) -> str:
    """A row per level: setting, the fields of `Level`, an iterations_ and an error_ column of each name."""
    rows = []
    for ladder in ladders:
        for level in ladder.levels:
            values = asdict(level) | {"main": ladder.main}
            values |= {f"iterations_{name}": v for name, v in values.pop("iterations").items()}
            values |= {f"error_{name}": v for name, v in values.pop("errors").items()}
            rows.append({"setting": ladder.name} | values)
    return csv_text(rows, ["setting"])


def _markdown(
    ladders: Sequence[Ladder], peers: list[tuple[Peer, str]], head: dict[str, str], drawn: bool
) -> str:
    case = ladders[0].case
    assert case.reference is not None
    lines = [f"# {case.title or 'Validation'}", "", *items(f"{k}: {v}" for k, v in head.items())]
    lines += items([f"case: {case.path}", _kind(case), f"bound: {case.reference.tolerance}"])
    lines += items([f"why this bound: {case.reference.reason}"] if case.reference.reason else [])
    for ladder in ladders:
        lines += ["", *_markdown_ladder(ladder)]
    lines += ["", "`*` is the case's own spacing. Seconds are without compilation."]
    if drawn:
        lines += ["", "![error against CPU seconds](work_precision.png)"]
    if peers:
        lines += ["", "## Other codes", "", *_peer_table(peers)]
    return "\n".join(lines) + "\n"


def _markdown_ladder(ladder: Ladder) -> list[str]:
    names = list(dict.fromkeys(n for lv in ladder.done for n in lv.errors if n not in (ladder.main, "main")))
    counts = list(dict.fromkeys(name for level in ladder.done for name in level.iterations))
    heads = [*HEADS, *(f"iterations {name}" for name in counts), *names]
    heads[4] = ladder.main or HEADS[4]
    rows = []
    for level in ladder.levels:
        if level.ran:
            more = [f"{level.iterations.get(name, 0.0):.1f}" for name in counts]
            rows.append([*numbers(level), *more, *(f"{level.errors.get(n, math.nan):.3e}" for n in names)])
        else:
            rows.append([str(level.number), f"{level.spacing:.4g}", level.status, *[""] * (len(heads) - 3)])
    result = verdict(ladder)
    lines = [f"## {ladder.name or 'As in the case'}", "", *table(heads, rows), ""]
    lines.append(f"**{result.word}**: {result.why}. Observed order {_or_dash(ladder.order)}.")
    if ladder.stopped:
        lines.append(f"Ladder {ladder.stopped}.")
    said = [f"level {level.number}: {level.status}" for level in ladder.done if level.stopped_short]
    said += [f"level {level.number}: {text}" for level in ladder.levels for text in level.warnings]
    return [*lines, *([""] if said else []), *items(said)]


def _peers(ladders: Sequence[Ladder]) -> list[tuple[Peer, str]]:
    """Peers of the case; comparable where they are so with one of its settings."""
    found: dict[int, tuple[Peer, str]] = {}
    for ladder in ladders:
        for k, (peer, why) in enumerate(peers_of(ladder.case)):
            if ladder.main and peer.error_name != ladder.main:
                why = why or f"it measured {peer.error_name}"
            if k not in found or not why:
                found[k] = (peer, why)
    return list(found.values())


def _peer_table(peers: Iterable[tuple[Peer, str]]) -> list[str]:
    heads = ("code", "version", "points", "error", "CPU s", "comparable", "source", "machine")
    rows = []
    for p, why in peers:
        cpu = "-" if p.cpu_seconds is None else f"{p.cpu_seconds:g}"
        comparable = f"no: {why}" if why else "yes"
        rows.append([p.code, p.version, str(p.points), f"{p.error:g}", cpu, comparable, p.source, p.machine])
    return table(heads, rows)


# -- the picture -----------------------------------------------------------------------------------------


def draw(path: Path, ladders: Sequence[Ladder], peers: Sequence[Peer] = ()) -> None:
    """Log |error| over log CPU seconds, a line per setting with its slope over the last three levels."""
    from ..output import plots

    figure, ((axes,),) = plots.new_figure(7.2, 4.8)
    for ladder, colour in zip(ladders, itertools.cycle(plots.COLOURS)):
        points = [(lv.cpu_seconds, abs(lv.error)) for lv in ladder.done if lv.error and lv.cpu_seconds]
        if points:
            label = f"{ladder.name or 'isphcli'}{_slopes(ladder, points)}"
            axes.plot(*zip(*points), "o-", color=colour, ms=5, lw=1.5, label=label, zorder=3)
    _draw_peers(axes, [peer for peer in peers if peer.cpu_seconds])
    case = ladders[0].case
    assert case.reference is not None
    if case.reference.tolerance:
        axes.axhline(case.reference.tolerance, color="#6b6b6b", lw=0.8, ls="--", label="bound")
    axes.set(xscale="log", yscale="log", xlabel="CPU seconds, without compilation")
    axes.set_ylabel(f"|{ladders[0].main.replace('_', ' ') or 'error'}|")
    axes.grid(which="both", color="#e6e6e6", lw=0.5)
    axes.legend(frameon=False, fontsize=8)
    plots.draw_headline(axes, case.title, "")
    plots.save_figure(figure, path)


def _draw_peers(axes: Any, peers: Sequence[Peer]) -> None:
    """A dotted line per code; labels say which seconds were not measured in that run."""
    for k, code in enumerate(dict.fromkeys(peer.code for peer in peers)):
        mine = [peer for peer in peers if peer.code == code]
        points = [(peer.cpu_seconds, abs(peer.error)) for peer in mine]
        label = code + (" (seconds derived)" if any("derived" in peer.source for peer in mine) else "")
        axes.plot(*zip(*points), marker="^sDvP"[k % 5], ls=":", color="#6b6b6b", ms=5, lw=1.0, label=label)


def _slopes(ladder: Ladder, points: Sequence[tuple[float, float]]) -> str:
    """' (slope -0.8, order 1.9)' for the legend."""
    found = {"slope": slope(*zip(*points[-3:])), "order": ladder.order}
    text = ", ".join(f"{name} {value:.2f}" for name, value in found.items() if value is not None)
    return f" ({text})" if text else ""
