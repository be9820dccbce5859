"""What a run shows as it goes: bars on a terminal, a few lines elsewhere."""

import io
import re

import pytest

from isphcli.output.progress import Progress, compiling, duration, stage


class Terminal(io.StringIO):
    def isatty(self):
        return True


def run_shown(stream, **options):
    with Progress(total_time=1.0, stream=stream, **options) as progress:
        for step in range(1, 5):
            progress.update(
                step,
                time=step / 4,
                dt=0.25,
                limit="cfl",
                iterations={"poisson": 13},
                residuals={"divergence": 1e-7},
            )
            with stage("AMG set-up") as s:
                s.update("level 2")


def test_plain_lines_are_few():
    stream = io.StringIO()
    run_shown(stream)
    (line,) = stream.getvalue().splitlines()
    assert line.startswith("100 %  step 4  t 1  dt 0.25 (cfl)  iterations poisson 13  divergence 1.0e-07")
    run_shown(stream := io.StringIO(), interval=0.0)
    assert len(stream.getvalue().splitlines()) == 4
    run_shown(stream := io.StringIO(), quiet=True)
    assert stream.getvalue() == ""


def test_what_is_done_is_the_larger_part_of_time_and_steps():
    """A run ends at the first of both: of 40 steps that reach 0.4 s of 1 s, 20 are half."""
    for steps, wanted in ((40, " 50 %"), (1000, " 20 %"), (None, " 20 %")):
        with Progress(1.0, steps, stream=(stream := io.StringIO()), interval=0.0) as shown:
            shown.update(20, time=0.2)
        assert stream.getvalue().startswith(wanted)


def test_terminal_shows_bar_and_detail(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    run_shown(stream := Terminal())
    assert "step 4" in stream.getvalue() and "poisson 13" in stream.getvalue()


def test_stage_tells_how_it_ended():
    with stage("building operators", stream=(stream := io.StringIO())) as s:
        s.update("iteration 12")
    assert stream.getvalue().startswith("building operators: iteration 12; done in 0.0 s")
    with pytest.raises(RuntimeError), stage("solving", stream=(stream := io.StringIO())):
        raise RuntimeError
    assert "stopped after" in stream.getvalue()
    with stage("solving", quiet=True, stream=(stream := io.StringIO())):
        pass
    assert stream.getvalue() == ""


def test_stage_on_a_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    with stage("solving", stream=(stream := Terminal())) as s:
        s.update("iteration 12")
    assert "solving: iteration 12; done in" in stream.getvalue()


class Screen:
    """What a terminal of some columns shows after what was written to it: carriage return, line feed, up, erase."""

    def __init__(self, columns):
        self.columns, self.rows, self.row, self.column = columns, [""], 0, 0

    def feed(self, text):
        for code, character in re.findall(r"\x1b\[([?0-9;]*[A-Za-z])|([^\x1b])", text):
            if code.endswith("A"):
                self.row -= int(code[:-1] or 1)
            elif code.endswith("K"):
                assert code == "2K"
                self.rows[self.row] = ""
            elif character == "\r":
                self.column = 0
            elif character == "\n":
                self.down()
            elif character:
                if self.column == self.columns:  # the line breaks
                    self.down()
                line = self.rows[self.row].ljust(self.column)
                self.rows[self.row] = line[: self.column] + character + line[self.column + 1 :]
                self.column += 1

    def down(self):
        self.row, self.column = self.row + 1, 0
        self.rows += [""] * (self.row == len(self.rows))

    def shown(self):
        return [row.rstrip() for row in self.rows if row.strip()]


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("columns", [120, 80, 60, 40])
def test_bars_do_not_pile_up(monkeypatch, columns, encoding):
    """However often it is drawn, in a terminal of any width: three lines, and the notes above."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding=encoding, write_through=True)
    stream.isatty = lambda: True
    title = "Berea sandstone, drainage of brine by CO2 at a held capillary number of 1e-3"
    with Progress(total_time=1.0, stream=stream, title=title) as shown:
        for step in range(1, 9):
            iterations = {"velocity": 12, "pressure": 31}
            residuals = {"velocity": 1e-9, "pressure": 3e-8, "divergence": 2e-7}
            shown.update(step, step / 8, 1.5e-5, "capillary", iterations, residuals)
            if step == 4:
                shown.note("snapshot 4")
            with stage("pressure hierarchy") as inner:
                inner.update("level 2")
            shown._display.live.refresh()
    screen = Screen(columns)
    screen.feed(raw.getvalue().decode(encoding))
    note, head, bar, detail = screen.shown()
    assert note == "snapshot 4" and "Berea sandstone" in head and " 100 %  step 8  t 1" in bar
    assert detail.startswith("  dt 1.5e-05 (capillary)  iterations") and max(map(len, screen.shown())) < columns


def test_a_terminal_that_is_made_narrower_keeps_no_broken_lines(monkeypatch):
    """The rows that breaking adds are taken back before the next drawing."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with Progress(total_time=1.0, stream=(stream := Terminal()), title="x" * 100) as shown:
        shown.update(1, 0.5, 1.5e-5, "capillary", {"velocity": 12}, {"divergence": 2e-7})
        shown._display.live.refresh()
        shown._display.live.stop()
        lengths = shown._display._drawn[1]
        assert max(lengths) == 79
        added = sum(-(-length // 30) - 1 for length in lengths)
        shown._display.console.width = 30
        before = len(stream.getvalue())
        shown._display._lines()
        assert stream.getvalue()[before:].count("\x1b[1A\x1b[2K") == added > 0
        shown._display._lines()  # only once
        assert stream.getvalue()[before:].count("\x1b[1A") == added


def test_the_display_says_when_the_compiler_works(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with stage("particles and operators", stream=Terminal()) as s:
        s.update("level 2")
        for going_on in (True, False):
            compiling(going_on)
            head = s._display._lines().plain
            said = "compiling, once per machine: " * going_on
            assert head[2:].startswith(f"{said}particles and operators  level 2  0.")


def test_lines_say_how_long_the_compiler_has_worked(monkeypatch):
    """Kernels that take 2 s each: one line at once, another every 5 s; none where nothing is to be said."""
    from isphcli.output import progress

    clock = [0.0]
    monkeypatch.setattr(progress, "_now", lambda: clock[0])
    said = ["the kernels of the run; later runs load them", "for 6.0 s so far", "for 12 s so far"]
    for options, lines in (({}, said), ({"quiet": True}, [])):
        with stage("operators", stream=(stream := io.StringIO()), interval=1e9, **options):
            for _ in range(7):
                compiling(True)
                compiling(False)
                clock[0] += 2.0
            assert stream.getvalue().splitlines() == [f"compiling, once per machine: {line}" for line in lines]


def test_a_kernel_that_is_not_in_the_cache_is_told(monkeypatch):
    """What numba compiles, not what it loads: seen by the display that is open."""
    import numba

    from isphcli.output import progress
    from isphcli.output.clock import Clock
    from isphcli.runs import run

    told = []
    monkeypatch.setattr(progress, "compiling", told.append)
    kernel = numba.njit(lambda a: a + 1)
    with run._compile_listener(Clock(), lambda: None):
        assert kernel(1) == 2
        assert told[0] is True and told[-1] is False
        told.clear()
        assert kernel(2) == 3 and not told


def left_after(monkeypatch, seconds, shares):
    """What is said of the time left after each step; seconds that the steps take, and the share done after them."""
    from isphcli.output import progress

    clock = [0.0]
    monkeypatch.setattr(progress, "_now", lambda: clock[0])
    said = []
    with Progress(total_time=1.0, stream=io.StringIO()) as shown:
        for step, (took, share) in enumerate(zip(seconds, shares), 1):
            clock[0] += took
            shown.update(step, time=share)
            said.append(shown._line.partition("  t ")[2].partition("  ")[2])
    return said


def test_the_time_left_is_that_of_an_even_pace(monkeypatch):
    """100 steps of 2 s: nothing in the first ones, then what the rest takes."""
    said = left_after(monkeypatch, [2.0] * 100, [k / 100 for k in range(1, 101)])
    assert said[:11] == [""] * 11 and said[11] == "2 min 56 s left" and said[49] == "1 min 40 s left"


def test_no_time_left_before_the_pace_is_known(monkeypatch):
    """Steps that begin a thousand times as small as they become, the third of which compiles for a minute: at the pace
    of the first ones it would be hours."""
    steps = [min(1e-5 * 2.0**k, 1e-2) for k in range(60)]
    shares = [sum(steps[: k + 1]) for k in range(60)]
    said = left_after(monkeypatch, [60.0 if k == 2 else 1.0 for k in range(60)], shares)
    assert said[:12] == [""] * 12 and not any(" h " in text for text in said)
    assert said[-1] == f"{duration((1 - shares[-1]) / 1e-2)} left"


@pytest.mark.parametrize(
    "seconds, text", [(0.34, "0.3 s"), (42, "42 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")]
)
def test_duration(seconds, text):
    assert duration(seconds) == text
