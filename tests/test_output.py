"""Files of a run: what is written can be read back, is whole, and is finite."""

import io
import json
import math
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from isphcli.output.clock import Clock
from isphcli.output.files import (
    FLUSH_EVERY,
    SUMMARY_KEYS,
    History,
    NotFiniteError,
    Series,
    read_history,
    read_pvd,
    read_vtu,
    replacing,
    write_summary,
    write_text,
)
from isphcli.output.machine import peak_memory, versions
from isphcli.output.progress import Progress, compiling, duration, stage

rng = np.random.default_rng(1)


def fields(n, dim):
    return {
        "velocity": rng.normal(size=(n, dim)),
        "pressure": rng.normal(size=n),
        "phase": np.zeros(n, dtype=np.int8),
        "distance": rng.random(n),
    }


@pytest.mark.parametrize("dim", [2, 3])
def test_snapshot_reads_back_bit_for_bit(tmp_path, dim):
    x = rng.random((50, dim)) * 1e-4
    f = fields(50, dim)
    path = Series(tmp_path, "rock").write(12, 0.5, x, f)
    assert path == tmp_path / "snapshots" / "rock_000012.vtu"
    points, data = read_vtu(path)
    assert np.array_equal(points[:, :dim], x) and not points[:, dim:].any()
    assert data["velocity"].shape == (50, 3) and np.array_equal(data["velocity"][:, :dim], f["velocity"])
    assert np.array_equal(data["pressure"], f["pressure"]) and data["phase"].dtype == np.int32


def test_a_snapshot_without_particles_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no particles"):
        Series(tmp_path).write(0, 0.0, np.zeros((0, 3)), fields(0, 3))


def test_vtk_opens_the_series(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOXML")
    series = Series(tmp_path, "rock")
    x = rng.random((20, 3))
    for step in (0, 10):
        path = series.write(step, 0.1 * step, x, fields(20, 3))
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    assert grid.GetNumberOfPoints() == grid.GetNumberOfCells() == 20
    assert grid.GetPointData().GetArray("velocity").GetNumberOfComponents() == 3
    assert read_pvd(series.path) == [
        (0.0, "snapshots/rock_000000.vtu"),
        (1.0, "snapshots/rock_000010.vtu"),
    ]


def test_series_goes_on_after_a_restart(tmp_path):
    series, x = Series(tmp_path), np.zeros((1, 2))
    for step in range(4):
        series.write(step, float(step), x, {})
    again = Series(tmp_path, resume_time=1.0)
    assert [t for t, _ in read_pvd(again.path)] == [0.0, 1.0]
    again.write(2, 1.5, x, {})
    assert [t for t, _ in read_pvd(again.path)] == [0.0, 1.0, 1.5]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_snapshot_with_nan(tmp_path, bad):
    f = fields(10, 2)
    f["pressure"][3:5] = bad
    series = Series(tmp_path)
    with pytest.raises(NotFiniteError, match="pressure: 2 of 10"):
        series.write(0, 0.0, np.zeros((10, 2)), f)
    assert not list((tmp_path / "snapshots").iterdir()) and not series.path.exists()


def test_distance_without_walls_is_left_out(tmp_path):
    x = np.zeros((3, 2))
    path = Series(tmp_path).write(0, 0.0, x, {"distance": np.full(3, np.inf)})
    assert "distance" not in read_vtu(path)[1]
    with pytest.raises(NotFiniteError, match="distance: 1 of 3"):
        Series(tmp_path).write(1, 0.0, x, {"distance": np.array([1.0, 2.0, np.inf])})


def test_wrong_length_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"pressure: shape \(4,\) does not fit 3"):
        Series(tmp_path).write(0, 0.0, np.zeros((3, 2)), {"pressure": np.zeros(4)})


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_history_reads_back(tmp_path):
    path = tmp_path / "history.csv"
    with History(path) as history:
        history.append({"step": 1, "time": 0.1, "limit": "cfl", "iterations_p": np.int64(3), "p": None})
        history.append({"step": 2, "time": np.float64(0.2), "limit": "end", "p": 1e-7})
    assert read_history(path) == [
        {"step": 1, "time": 0.1, "limit": "cfl", "iterations_p": 3, "p": None},
        {"step": 2, "time": 0.2, "limit": "end", "iterations_p": None, "p": 1e-7},
    ]
    with open(path, "a") as file:
        file.write("3,0.2")  # a run that was killed as it wrote
    with History(path, resume_step=1) as history:
        history.append({"step": 2, "time": 0.19, "change": 0.5})
    assert [(row["step"], row["time"], row["change"]) for row in read_history(path)] == [
        (1, 0.1, None), (2, 0.19, 0.5)]


def test_history_can_be_read_while_it_grows(tmp_path):
    history = History(tmp_path / "h.csv")
    for step in range(20):
        history.append({"step": step})
    assert len(read_history(history.path)) >= 20 - FLUSH_EVERY
    history.close()


def test_history_refuses_nan_and_new_columns(tmp_path):
    history = History(tmp_path / "h.csv")
    history.append({"dt": 1.0})
    with pytest.raises(NotFiniteError, match="dt in row 2"):
        history.append({"dt": math.nan})
    with pytest.raises(KeyError, match="residual"):
        history.append({"dt": 1.0, "residual": 1.0})
    history.close()


def test_summary(tmp_path):
    path = tmp_path / "summary.json"
    write_summary(
        path,
        {"extra": None, "time": np.float64(1.5), "title": "µ", "particles": {"fluid": np.int64(3)},
         "permeability_tensor": np.eye(2), "terms": {"viscosity", "pressure"}, "ok": np.bool_(True)},
    )  # fmt: skip
    read = json.loads(path.read_text(encoding="utf-8"))
    assert list(read) == ["title", "particles", "terms", "time", "permeability_tensor", "extra", "ok"]
    assert read["permeability_tensor"] == [[1, 0], [0, 1]] and read["ok"] is True
    assert read["terms"] == ["pressure", "viscosity"]
    with pytest.raises(NotFiniteError, match=r"errors\.velocity\[1\]"):
        write_summary(path, {"errors": {"velocity": [1.0, math.nan]}})
    assert json.loads(path.read_text(encoding="utf-8")) == read


def test_every_key_of_the_summary_is_documented():
    page = (Path(__file__).parents[1] / "docs" / "output.md").read_text(encoding="utf-8")
    assert [key for key in SUMMARY_KEYS if f"`{key}`" not in page] == []


def test_clock_counts_nothing_twice():
    clock = Clock()
    with clock("outer"):
        time.sleep(0.02)
        for _ in range(2):
            with clock("inner"):
                time.sleep(0.02)
    wall, cpu = clock.wall(), clock.cpu()
    assert list(wall) == ["outer", "inner", "other", "total"]
    assert 0.02 <= wall["outer"] < 0.04 <= wall["inner"]
    assert math.isclose(sum(wall.values()) - wall["total"], wall["total"], rel_tol=1e-9)
    assert cpu["total"] < 0.5 * wall["total"]  # sleeping costs no CPU
    clock.add("compile", 0.01, 0.0, taken_from="inner")
    assert math.isclose(clock.wall()["inner"], wall["inner"] - 0.01)


def test_peak_memory_and_versions():
    before = peak_memory()
    block = np.ones(int(2e7))  # 160 MB
    assert block.nbytes <= peak_memory() and before <= peak_memory()
    found = versions()
    assert found["numpy"] == np.__version__ and "isphcli" in found


# -- progress --------------------------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self):
        return True


def march(stream, **options):
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
    march(stream)
    (line,) = stream.getvalue().splitlines()
    assert line.startswith("100 %  step 4  t 1  dt 0.25 (cfl)  iterations poisson 13  divergence 1.0e-07")
    march(stream := io.StringIO(), interval=0.0)
    assert len(stream.getvalue().splitlines()) == 4
    march(stream := io.StringIO(), quiet=True)
    assert stream.getvalue() == ""


def test_terminal_shows_bar_and_detail(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    march(stream := Terminal())
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
            assert head[2:].startswith("compiling (once): " * going_on + "particles and operators  level 2  0.")
    # elsewhere one line, and none where nothing is to be said
    for options, lines in (({}, 1), ({"quiet": True}, 0)):
        with stage("operators", stream=(stream := io.StringIO()), **options):
            compiling(True)
            compiling(False)
            compiling(True)
            assert stream.getvalue().count("compiling (once)") == lines == len(stream.getvalue().splitlines())


def test_a_kernel_that_is_not_in_the_cache_is_told(monkeypatch):
    """What numba compiles, not what it loads: seen by the display that is open."""
    import numba

    from isphcli.output import progress
    from isphcli.output.clock import Clock
    from isphcli.run import run

    told = []
    monkeypatch.setattr(progress, "compiling", told.append)
    kernel = numba.njit(lambda a: a + 1)
    with run._compile_listener(Clock()):
        assert kernel(1) == 2
        assert told[0] is True and told[-1] is False
        told.clear()
        assert kernel(2) == 3 and not told


@pytest.mark.parametrize(
    "seconds, text", [(0.34, "0.3 s"), (42, "42 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")]
)
def test_duration(seconds, text):
    assert duration(seconds) == text


def test_output_and_progress_import_nothing_heavy():
    import subprocess

    code = (
        "import sys, isphcli.output.files, isphcli.output.progress; "
        "assert not {'meshio', 'rich', 'matplotlib', 'scipy', 'numba'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
