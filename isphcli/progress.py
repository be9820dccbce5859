"""What one sees while a run goes: a live display on a terminal, a line now and then elsewhere.

Everything goes to stderr, so that stdout stays free for results. rich is imported only for a terminal.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any, TextIO

INTERVAL = 5.0  # s between two plain lines

_active: list[Progress | stage] = []  # open displays, the outermost first: there is one terminal


class Progress:
    """Display of a time march: `with Progress(total_time=1.0) as p: p.update(step=1, time=0.01, dt=0.01)`."""

    def __init__(
        self,
        total_time: float | None = None,
        total_steps: int | None = None,
        title: str = "",
        quiet: bool = False,
        stream: TextIO | None = None,
        interval: float = INTERVAL,
    ):
        """The run ends at `total_time` (s) or after `total_steps`; with neither no share done is shown.

        `interval`: seconds between two plain lines where `stream` (stderr) is not a terminal.
        """
        self.total_time, self.total_steps, self.title = total_time, total_steps, title
        self.quiet, self.interval = quiet, interval
        self.stream = stream if stream is not None else sys.stderr
        self.start = self._first = time.perf_counter()
        self._done_at_first: float | None = None
        self._printed = float("-inf")
        self._line = self._shown = ""
        self._display: Any = None

    def __enter__(self) -> Progress:
        self.start = time.perf_counter()
        self._printed = self.start
        if not self.quiet and is_terminal(self.stream) and not _active:
            self._display = _Bar(self.stream, self.title or "running")
        _active.append(self)
        return self

    def __exit__(self, *exception: object) -> None:
        _active.remove(self)
        if self._display is not None:
            self._display.close()
        elif not self.quiet and self._line != self._shown:
            self._print(self._line)

    def update(
        self,
        step: int,
        time: float | None = None,
        dt: float | None = None,
        limit: str | None = None,
        iterations: Mapping[str, float] | None = None,
        residuals: Mapping[str, float] | None = None,
    ) -> None:
        """A step is done.

        time, dt: s. limit: what binds the step ("cfl", "viscous", "capillary", "end"). iterations: of each
        linear system by name. residuals: by name, also "divergence" or "change" of a run to a steady state.
        """
        if self.quiet:
            return
        done = self._share(step, time)
        detail = _detail(dt, limit, iterations, residuals)
        where = f"step {step}" + (f"  t {time:.4g}" if time is not None else "")
        left = self._left(done)
        if self._display is not None:
            self._display.show(done, where, left, detail)
            return
        share = f"{100 * done:3.0f} %  " if done is not None else ""
        self._line = "  ".join(part for part in (share + where, detail, left) if part)
        if _now() - self._printed >= self.interval:
            self._print(self._line)

    def note(self, text: str) -> None:
        """A line that stays (a warning, a snapshot's name), above the display."""
        if self._display is not None:
            self._display.note(text)
        elif not self.quiet:
            print(text, file=self.stream, flush=True)

    def _substage(self, text: str) -> None:
        """What a stage inside this display is doing."""
        if self._display is not None:
            self._display.substage(text)

    def _share(self, step: int, t: float | None) -> float | None:
        if self.total_time and t is not None:
            return min(max(t / self.total_time, 0.0), 1.0)
        return min(step / self.total_steps, 1.0) if self.total_steps else None

    def _left(self, done: float | None) -> str:
        """Time left at the pace since the first step (which compiles and builds hierarchies)."""
        if done is None:
            return ""
        if self._done_at_first is None:
            self._done_at_first, self._first = done, _now()
            return ""
        gained = done - self._done_at_first
        return f"{duration((1 - done) / gained * (_now() - self._first))} left" if gained > 0 else ""

    def _print(self, line: str) -> None:
        print(line, file=self.stream, flush=True)
        self._printed, self._shown = _now(), line


class stage:
    """Display of one long piece of work: `with stage("solving") as s: s.update("iteration 12")`.

    On a terminal a spinner with the time that has passed; inside a `Progress` its second line; elsewhere a
    line at the end, and one every `interval` seconds on the way.
    """

    def __init__(
        self, text: str, quiet: bool = False, stream: TextIO | None = None, interval: float = INTERVAL
    ):
        self.text, self.quiet, self.interval = text, quiet, interval
        self.stream = stream if stream is not None else sys.stderr
        self.start = self._printed = time.perf_counter()
        self._detail = ""
        self._display: Any = None
        self._outer: Progress | stage | None = None

    def __enter__(self) -> stage:
        self.start = self._printed = _now()
        self._outer = _active[-1] if _active else None
        if self._outer is not None:
            self._outer._substage(self.text)
        elif not self.quiet and is_terminal(self.stream):
            self._display = _Spinner(self.stream, self.text)
        _active.append(self)
        return self

    def __exit__(self, kind: type | None, *exception: object) -> None:
        _active.remove(self)
        took = duration(_now() - self.start)
        end = f"{'done in' if kind is None else 'stopped after'} {took}"
        line = f"{self.text}: " + "; ".join(part for part in (self._detail, end) if part)
        if self._outer is not None:
            self._outer._substage("")
        elif self._display is not None:
            self._display.close(line, kind is None)
        elif not self.quiet:
            print(line, file=self.stream, flush=True)

    def update(self, detail: str) -> None:
        """How far it is."""
        self._detail = detail
        if self._outer is not None:
            self._outer._substage(f"{self.text}: {detail}")
        elif self._display is not None:
            self._display.show(detail)
        elif not self.quiet and _now() - self._printed >= self.interval:
            print(f"{self.text}: {detail}", file=self.stream, flush=True)
            self._printed = _now()

    def _substage(self, text: str) -> None:
        if text:
            self.update(text)


def is_terminal(stream: TextIO) -> bool:
    """Whether `stream` is a terminal that can redraw a line."""
    import os

    return bool(getattr(stream, "isatty", lambda: False)()) and os.environ.get("TERM") != "dumb"


def duration(seconds: float) -> str:
    """Seconds as one reads them: 0.3 s, 42 s, 3 min 05 s, 2 h 10 min."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    if seconds < 3600:
        return f"{int(seconds // 60)} min {int(seconds % 60):02d} s"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60):02d} min"


def _detail(
    dt: float | None, limit: str | None, iterations: Mapping | None, residuals: Mapping | None
) -> str:
    parts = []
    if dt is not None:
        parts.append(f"dt {dt:.2g}" + (f" ({limit})" if limit else ""))
    if iterations:
        parts.append("iterations " + ", ".join(f"{name} {count:.0f}" for name, count in iterations.items()))
    if residuals:
        parts.append(
            ", ".join(f"{name} {value:.1e}" for name, value in residuals.items() if value is not None)
        )
    return "  ".join(part for part in parts if part)


def _now() -> float:
    return time.perf_counter()


class _Bar:
    """Two lines on a terminal: how far, and what the last step did."""

    def __init__(self, stream: TextIO, title: str):
        from rich.console import Console, Group
        from rich.live import Live
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
        from rich.text import Text

        self.bar = Progress(
            SpinnerColumn(),
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=32),
            TextColumn("{task.fields[share]}"),
            TextColumn("{task.fields[where]}"),
            TimeElapsedColumn(),
            TextColumn("[cyan]{task.fields[left]}"),
        )
        self.task = self.bar.add_task(title, total=None, share="", where="", left="")
        self.detail = Text("", style="dim", no_wrap=True, overflow="ellipsis")
        self.last = ""
        console = Console(file=stream)
        self.live = Live(Group(self.bar, self.detail), console=console, refresh_per_second=8)
        self.live.start()

    def show(self, done: float | None, where: str, left: str, detail: str) -> None:
        if done is None:
            self.bar.update(self.task, where=where)
        else:
            share = f"{100 * done:3.0f} %"
            self.bar.update(self.task, total=1.0, completed=done, share=share, where=where, left=left)
        self.last = detail
        self.detail.plain = f"  {detail}"

    def substage(self, text: str) -> None:
        self.detail.plain = f"  {text or self.last}"

    def note(self, text: str) -> None:
        self.live.console.print(text, markup=False, highlight=False)

    def close(self) -> None:
        self.live.stop()


class _Spinner:
    """One line on a terminal, replaced by what came of it."""

    def __init__(self, stream: TextIO, text: str):
        from rich.console import Console
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            TextColumn("[dim]{task.fields[detail]}"),
        )
        self.bar = Progress(*columns, TimeElapsedColumn(), console=Console(file=stream), transient=True)
        self.task = self.bar.add_task(text, total=None, detail="")
        self.bar.start()

    def show(self, detail: str) -> None:
        self.bar.update(self.task, detail=detail)

    def close(self, line: str, well: bool) -> None:
        self.bar.stop()
        mark = "[green]✓[/]" if well else "[red]✗[/]"
        self.bar.console.print(mark, end=" ")
        self.bar.console.print(line, markup=False, highlight=False)
