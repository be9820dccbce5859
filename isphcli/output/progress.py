"""The display of the progress of a run: lines that are redrawn on a terminal, a line every few seconds elsewhere.

Everything goes to stderr, so that stdout stays free for results. rich is imported only for a terminal.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

INTERVAL = 5.0  # s between two plain lines
FEWEST = 12  # steps before the time left is shown
AGREE = 1.5  # largest ratio of the paces of the last half and quarter of the steps for which the time left is shown
MOST = 1000  # steps whose times are kept
COMPILING = "compiling, once per machine"
_active: list[Progress | stage] = []  # open displays, the outermost first: there is one terminal
_told: list[tuple[TextIO, float, float]] = []  # lines on the compiler: stream, time of first and last


def compiling(going_on: bool) -> None:
    """To be called when the compiler begins with a kernel, or is done: displays show it, as it takes most of the time
    of a first run. Without a terminal a line is written at once, and then at most one per INTERVAL, for further
    kernels."""
    for shown in _active:
        if shown._display is not None:
            shown._display.compiling = going_on
        elif going_on and not shown.quiet and shown is _active[0]:
            _tell_of_compiler(shown.stream)


def _tell_of_compiler(stream: _Forgiving) -> None:
    now = _now()
    if not _told or _told[0][0] is not stream.stream:
        _told[:] = [(stream.stream, now, now)]
        print(f"{COMPILING}: the kernels of the run; later runs load them", file=stream, flush=True)
    elif now - _told[0][2] >= INTERVAL:
        _told[:] = [(stream.stream, _told[0][1], now)]
        print(f"{COMPILING}: for {duration(now - _told[0][1])} so far", file=stream, flush=True)


class Progress:
    """Display of a time loop: `with Progress(total_time=1.0) as p: p.update(step=1, time=0.01, dt=0.01)`."""

    def __init__(
        self,
        total_time: float | None = None,
        total_steps: int | None = None,
        title: str = "",
        quiet: bool = False,
        stream: TextIO | None = None,
        interval: float = INTERVAL,
    ):
        """The run ends at `total_time` (s) or after `total_steps`, whichever comes first; with neither no share done
        is shown.

        `interval`: seconds between two plain lines where `stream` (stderr) is not a terminal.
        """
        self.total_time, self.total_steps, self.title = total_time, total_steps, title
        self.quiet, self.interval = quiet, interval
        self.stream: Any = _Forgiving(stream if stream is not None else sys.stderr)
        self.start = time.perf_counter()
        self._paced: list[tuple[float, float]] = []  # (s, share done) after steps
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
        residuals: Mapping[str, float | None] | None = None,
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
        """Shows the text of a stage inside this display."""
        if self._display is not None:
            self._display.substage(text)

    def _share(self, step: int, t: float | None) -> float | None:
        by_time = [max(t / self.total_time, 0.0)] if self.total_time and t is not None else []
        by_steps = [step / self.total_steps] if self.total_steps else []
        return min(max(by_time + by_steps), 1.0) if by_time or by_steps else None

    def _left(self, done: float | None) -> str:
        """Time left at the pace of the last half of the steps: the first ones compile, and steps grow from rest.

        '' until that pace is known: after FEWEST steps, if the pace of their last quarter agrees within AGREE."""
        if done is None:
            return ""
        now, paced = _now(), self._paced
        paced.append((now, done))
        if len(paced) > MOST:
            del paced[::2]
        if len(paced) < FEWEST:
            return ""
        half, quarter = ((done - share) / max(now - then, 1e-9) for then, share in
                         (paced[len(paced) // 2], paced[3 * len(paced) // 4]))
        if min(half, quarter) <= 0.0 or not 1.0 / AGREE <= half / quarter <= AGREE:
            return ""
        return f"{duration((1 - done) / half)} left"

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
        self.stream: Any = _Forgiving(stream if stream is not None else sys.stderr)
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
            self._display.end(line, kind is None)
        elif not self.quiet:
            print(line, file=self.stream, flush=True)

    def update(self, detail: str) -> None:
        """Shows how far the work is."""
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


class _Display:
    """Lines on a terminal that are drawn again and again until `close`; what does not fit into a line is left out.

    At narrow widths too a line is never broken, so that it can be redrawn in place.
    """

    def __init__(self, stream: TextIO, title: str, transient: bool):
        from rich.console import Console
        from rich.live import Live
        from rich.spinner import Spinner

        self.title, self.start, self.compiling = title, _now(), False
        self._drawn: tuple[int, list[int]] = (0, [])  # the width of the terminal then, and of each line
        self.console = Console(file=stream)
        self.all_characters = self.console.encoding.lower().startswith("utf")
        self.spinner = Spinner("dots" if self.all_characters else "line")
        self.live = Live(
            get_renderable=self._lines, console=self.console, refresh_per_second=8, transient=transient
        )
        self.live.start()

    def note(self, text: str) -> None:
        """A line that stays, above."""
        self.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def close(self) -> None:
        self.live.stop()

    def _lines(self) -> Any:
        """The lines as a rich renderable."""
        from rich.text import Text

        width = max(min(self.console.width, 80) - 1, 10)
        self._take_back_broken_lines()
        mark = self.spinner.render(self.console.get_time())
        clock = f"  {duration(_now() - self.start)}"
        head = Text.assemble(mark, " ", (f"{COMPILING}: " if self.compiling else ""), *self._head())  # type: ignore[arg-type]
        head.truncate(width - len(clock), overflow="ellipsis" if self.all_characters else "crop")
        lines = [head.append(clock, "yellow"), *self._more(width)]
        for line in lines:
            line.truncate(width, overflow="ellipsis" if self.all_characters else "crop")
        self._drawn = self.console.width, [line.cell_len for line in lines]
        return Text("\n", no_wrap=True).join(lines)

    def _take_back_broken_lines(self) -> None:
        """After the terminal was made narrower: goes up by the rows that its breaking of lines added."""
        then, lengths = self._drawn
        now = self.console.width
        if now < then and (added := sum((length - 1) // now for length in lengths if length)):
            self.console.file.write("\r\x1b[2K" + "\x1b[1A\x1b[2K" * added)

    def _head(self) -> Sequence[tuple[str, str]]:
        """(text, style) of the first line."""
        return ((self.title, "bold"),)

    def _more(self, width: int) -> list[Any]:
        """Further lines, rich texts."""
        return []


class _Bar(_Display):
    """Three lines: the title, the progress, and the last step."""

    def __init__(self, stream: TextIO, title: str):
        self.done: float | None = None
        self.where = self.left = self.detail = self.below = ""
        super().__init__(stream, title, transient=False)

    def show(self, done: float | None, where: str, left: str, detail: str) -> None:
        self.done, self.where, self.left, self.detail = done, where, left, detail

    def substage(self, text: str) -> None:
        self.below = text

    def _more(self, width: int) -> list[Any]:
        from rich.text import Text

        share = "" if self.done is None else f"{100 * self.done:3.0f} %  "
        words = Text.assemble(share, self.where, (f"  {self.left}" if self.left else "", "cyan"))
        room = min(width - words.cell_len - 4, 32)
        bar = Text("  ")
        if self.done is not None and room >= 8:
            full, rest = ("━", "━") if self.all_characters else ("#", "-")
            filled = round(self.done * room)
            bar.append(full * filled, "green").append(rest * (room - filled), "bright_black").append("  ")
        return [bar.append_text(words), Text(f"  {self.below or self.detail}", "dim")]


class _Spinner(_Display):
    """One line, replaced by the outcome at the end."""

    def __init__(self, stream: TextIO, text: str):
        self.detail = ""
        super().__init__(stream, text, transient=True)

    def show(self, detail: str) -> None:
        self.detail = detail

    def end(self, line: str, well: bool) -> None:
        """Closes, and leaves the line."""
        from rich.text import Text

        self.close()
        good, bad = ("✓", "✗") if self.all_characters else ("ok:", "stopped:")
        self.console.print(Text.assemble((good, "green") if well else (bad, "red"), " ", line), soft_wrap=True)

    def _head(self) -> Sequence[tuple[str, str]]:
        return (self.title, ""), (f"  {self.detail}", "dim")


class _Forgiving:
    """A stream for the display: once it is full, or its reader has closed it, the run goes on without one."""

    def __init__(self, stream: TextIO):
        self.stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self.stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self.stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)
