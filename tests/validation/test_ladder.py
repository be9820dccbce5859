"""`isph validate`: ladders, budget, settings, verdicts, files."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from isphcli.cli import BAD_INPUT, OUTSIDE, main, settings
from isphcli.validation import ladder as validate
from isphcli.validation.ladder import Ladder, Level, ladder_spacings, predicted_seconds, slope, validate_cases, verdict
from tests.paths import CASES, ROOT
from tests.validation.ladders import case

PARTS = {"out": Path("runs"), "quiet": True}
START_UP = ("particles.spacing=6.25e-5", "time.step=9e-3")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def isph(*words):
    return CliRunner().invoke(main, ["validate", *(str(word) for word in words), "--quiet"])


def results(name):
    return json.loads(Path("runs", name, "validation.json").read_text(encoding="utf-8"))


def ladder(*levels, name="slit"):
    return Ladder(case(name, "reference.tolerance=0.001"), {}, "main", list(levels))


def level(spacing, seconds=None, error=1e-3, steps=None, own=False):
    return Level(1, spacing, own, error=error, wall_seconds=seconds, steps=steps, dimension=2)


def test_seconds_of_a_row_are_of_the_spacing_that_its_verdict_names():
    """The best error is of a finer one, which took longer."""
    own, finer = level(0.1, error=2e-4, own=True), level(0.05, error=1e-4)
    own.cpu_seconds, finer.cpu_seconds = 0.25, 7.0
    row = dict(zip(validate.VERDICTS, validate._verdict_cells(ladder(level(0.2), own, finer))))
    assert "at spacing 0.1" in row["why"] and row["CPU s"] == "0.25"
    assert (row["best error"], row["its spacing"], row["its CPU s"]) == ("1.000e-04", "0.05", "7.00")


# -- spacings, order, prediction -------------------------------------------------------------------------


@pytest.mark.parametrize("levels, parts", [(1, [1]), (2, [2, 1]), (3, [2, 1, 0.5]), (4, [2, 1, 0.5, 0.25])])
def test_the_own_spacing_is_the_second_one(levels, parts):
    assert ladder_spacings(case("slit"), levels) == pytest.approx([6.25e-6 * part for part in parts])


@pytest.mark.parametrize(
    "parts, levels, expected",
    [
        (1, 3, [1, 2, 4]),
        (2, 3, [1, 2, 4]),
        (3, 3, [1, 3, 6]),
        (4, 3, [1, 2, 4]),
        (4, 2, [2, 4]),
        (6, 4, [1, 3, 6, 12]),
    ],
)
def test_spacings_of_an_image_divide_the_voxel(parts, levels, expected):
    rock = case("two_tubes")
    voxel = rock.geometry.voxels.voxel_size
    rock = case("two_tubes", f"particles.spacing={voxel / parts!r}")
    assert [voxel / spacing for spacing in ladder_spacings(rock, levels)] == pytest.approx(expected)


def test_a_spacing_beside_the_voxels_has_no_coarser_one():
    rock = case("two_tubes", "particles.spacing=3.1e-6")
    assert ladder_spacings(rock, 2) == pytest.approx([3.1e-6, 1.55e-6])


def test_order_is_the_least_squares_slope():
    h = [0.4, 0.2, 0.1]
    assert slope(h, [-3 * x**1.7 for x in h]) == pytest.approx(1.7)
    assert slope(h, [4.0, 2.0, 0.5]) == pytest.approx(1.5)  # of the slopes 1 and 2 between them
    assert slope(h[:1], [1.0]) is None and slope(h[:2], [1.0, 0.0]) is None


def test_the_next_level_is_predicted_from_particles_and_steps():
    assert predicted_seconds(ladder(level(0.2, 1.0)), 0.1) == pytest.approx(2**2.2)  # stokes
    moving = ladder(level(0.4, 1.0, steps=10), level(0.2, 8.0, steps=40), name="taylor_green_2d")
    assert predicted_seconds(moving, 0.1) == pytest.approx(8 * 2**2.2 * 4)
    assert predicted_seconds(ladder(level(0.2, 1.0, steps=9), name="startup_couette"), 0.1) == pytest.approx(
        2**2.2
    )
    assert predicted_seconds(ladder(), 2 * 6.25e-6, estimate=1.0) == pytest.approx(2**-2.2)
    assert predicted_seconds(ladder(), 1.0) is None


# -- verdicts --------------------------------------------------------------------------------------------


def test_the_own_spacing_decides():
    good, bad = level(6.25e-6, error=-9e-4, own=True), level(6.25e-6, error=-2e-3, own=True)
    fine, broken = level(3e-6, error=1e-5), Level(1, 6.25e-6, True, "SolveError: no")
    assert verdict(ladder(good)).passed and "<= 0.001" in verdict(ladder(good)).why
    assert not verdict(ladder(bad, fine)).passed
    assert not verdict(ladder(broken, fine)).passed and "SolveError" in verdict(ladder(broken)).why
    short = Level(1, 6.25e-6, True, "out of steps", error=1e-5)
    assert not verdict(ladder(short)).passed and "out of steps" in verdict(ladder(short)).why
    assert verdict(ladder(fine)).word == "NOT RUN" and not verdict(ladder(fine)).passed


# -- runs ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_ladder_and_its_files():
    lines = []
    text, passed = validate_cases([case("taylor_couette")], say=lines.append, **PARTS)
    assert passed and text.startswith("pass      taylor_couette: |0.0002")
    assert "why this bound: measured 2.8e-4" in text
    assert [line.split()[0] for line in lines if line and "warning" not in line][1:5] == ["level", "1", "2*", "3"]
    (record,) = results("taylor_couette")["settings"]
    assert record["order"] > 1.5 and record["verdict"]["passed"]
    rows = list(csv.DictReader(Path("runs/taylor_couette/validation.csv").open(encoding="utf-8")))
    assert [int(row["particles"]) for row in rows] == [224, 948, 3760]
    first, second = (abs(float(row["error"])) for row in rows[:2])
    assert float(rows[1]["order"]) == pytest.approx(np.log2(first / second), abs=0.01)
    assert float(rows[1]["error_velocity_max"]) < 1e-3 and float(rows[1]["iterations_stokes"]) >= 1
    page = Path("runs/taylor_couette/validation.md").read_text(encoding="utf-8")
    assert "| 2* | 0.1 | 948 |" in page and "work_precision.png" in page
    assert Path("runs/taylor_couette/work_precision.png").stat().st_size > 5000
    assert not list(Path("runs").rglob("*.vtu")) and not list(Path("runs").rglob("slice.png"))


@pytest.mark.slow
def test_twice_the_same_errors():
    coarse = case("cylinder_array", "particles.spacing=6.25e-3")
    moving = case("startup_couette", *START_UP)
    found = []
    for out in ("a", "b"):
        validate_cases([coarse, moving], levels=1, out=Path(out), quiet=True, say=lambda line: None)
        pages = [Path(out, name, "validation.json") for name in ("cylinder_array", "startup_couette")]
        (first, second) = (json.loads(page.read_text())["settings"][0]["levels"][0] for page in pages)
        assert first["repeated_to"] <= 1e-10 and second["repeated_to"] <= 1e-10
        found.append([*first["errors"].values(), *second["errors"].values()])
    assert found[0] == pytest.approx(found[1], rel=0, abs=1e-10)


@pytest.mark.slow
def test_cpu_seconds_are_those_of_the_operating_system():
    """A run of some seconds in a process of its own, which asks getrusage before and after."""
    options = ("output.plots=false", "output.snapshots=false", "output.directory=run")
    script, file = ROOT / "benchmarks" / "measured_run.py", CASES / "taylor_green_2d_re100.yaml"
    words = [sys.executable, str(script), str(file), *options]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    seconds, reported = json.loads(done.stdout.splitlines()[-1])
    assert seconds > 0.5 and reported["total"] == pytest.approx(seconds, rel=0.05)
    assert sum(s for name, s in reported.items() if name != "total") == pytest.approx(reported["total"], rel=1e-6)


def test_what_is_not_the_method_is_not_counted():
    """Neither the compiler nor the reference solution, which in 3D takes longer than the run."""
    one = validate._run(case("taylor_green_3d", "particles.spacing=0.125"), 1, 0.125, Path("runs"), True)
    summary = json.loads(Path("runs/summary.json").read_text(encoding="utf-8"))
    for mine, seconds in ((one.cpu_seconds, summary["cpu_seconds"]), (one.wall_seconds, summary["wall_seconds"])):
        rest = sum(s for name, s in seconds.items() if name not in ("total", "compile", "reference"))
        assert mine == pytest.approx(rest) and seconds["reference"] > 0
    assert one.cpu_seconds <= one.cpu_process_seconds


@pytest.mark.slow
def test_vary_is_a_ladder_a_setting():
    lines = []
    vary = [("particles.support", ["2.1", "2.5"]), ("solver.tolerance", ["1e-8"])]
    small = case("cylinder_array", "particles.spacing=6.25e-3")
    text, passed = validate_cases(
        [small], levels=1, vary=vary, overrides=["particles.spacing=6.25e-3"], say=lines.append, **PARTS
    )
    assert passed and "2 of 2 passed" in text
    first, second = results("cylinder_array")["settings"]
    assert first["setting"] == {"particles.support": "2.1", "solver.tolerance": "1e-8"}
    assert first["levels"][0]["spacing"] == second["levels"][0]["spacing"] == 6.25e-3
    assert first["levels"][0]["error"] != second["levels"][0]["error"]
    assert "-- particles.support=2.5, solver.tolerance=1e-8" in lines
    assert len(list(Path("runs/cylinder_array").glob("*/level_1/summary.json"))) == 2


def test_a_budget_stops_the_ladder():
    lines = []
    options = {"budget": 1e-3, "say": lines.append, **PARTS}
    text, passed = validate_cases([case("slit")], **options)
    assert not passed and "NOT RUN" in text
    (record,) = results("slit")["settings"]
    assert len(record["levels"]) == 1 and record["stopped"].startswith("stopped before level 2")
    validate_cases([case("slit")], estimates={case("slit").path: 100.0}, **options)
    assert results("slit")["settings"][0]["levels"] == []
    assert not Path("runs/slit/work_precision.png").exists()


@pytest.mark.slow
def test_without_a_budget_the_own_spacing_is_run(monkeypatch):
    monkeypatch.setattr(validate, "BUDGET", 1e-6)
    text, passed = validate_cases([case("slit")], say=lambda line: None, **PARTS)
    (record,) = results("slit")["settings"]
    assert passed and len(record["levels"]) == 2 and "stopped before level 3" in text


def test_a_run_that_fails_is_a_row(monkeypatch):
    def run_case(case, quiet, overwrite, look):
        raise RuntimeError("did not converge")

    monkeypatch.setattr("isphcli.runs.run.run_case", run_case)
    text, passed = validate_cases([case("slit")], say=lambda line: None, **PARTS)
    assert not passed and "FAIL" in text and "RuntimeError: did not converge" in text
    assert "did not converge" in Path("runs/slit/validation.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_several_cases_end_with_one_page():
    cases = [case("slit"), case("cylinder_array", "particles.spacing=6.25e-3", "reference.tolerance=1e-5")]
    text, passed = validate_cases(cases, levels=1, say=lambda line: None, **PARTS)
    assert not passed and "1 of 2 passed" in text
    page = Path("runs/validation.md").read_text(encoding="utf-8")
    assert "| slit | pass |" in page and "| cylinder_array | FAIL |" in page and "1 of 2 passed" in page
    assert [r["name"] for r in json.loads(Path("runs/validation.json").read_text(encoding="utf-8"))["results"]] == [
        "slit",
        "cylinder_array",
    ]


# -- the command -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_exit_codes_of_a_bound():
    words = [CASES / "slit.yaml", "--levels", 1, "--out", "runs"]
    # off the lattice sums are taken at the particles, and no velocity is exact
    done = isph(*words, "--vary", "particles.jitter=0,0.3")
    assert done.exit_code == OUTSIDE and "1 of 2 passed" in done.stdout, done.output
    assert [setting["verdict"]["passed"] for setting in results("slit")["settings"]] == [True, False]
    assert isph(*words).exit_code == 0
    missed = isph(*words, "--set", "reference.tolerance=1e-12")
    assert missed.exit_code == OUTSIDE == 1 and "FAIL" in missed.stdout


@pytest.mark.parametrize(
    "vary, said",
    [
        ("particles.spacing=1", "the ladder itself"),
        ("particles.suport=2", "support"),
        ("refine", "key=a,b,c"),
    ],
)
def test_a_setting_that_cannot_be(vary, said):
    done = isph(CASES / "slit.yaml", "--vary", vary, "--out", "runs")
    assert done.exit_code == BAD_INPUT and said in done.output
    assert not Path("runs").exists()


def test_values_of_a_setting():
    assert settings(["a.b=1,2", "c=[1, 2],[3]"]) == (("a.b", ("1", "2")), ("c", ("[1, 2]", "[3]")))


def test_other_codes_in_the_picture():
    own = level(0.03125, 1.0, error=2e-3, own=True)
    own.cpu_seconds = 0.1
    vortex = ladder(own, name="taylor_green_2d")
    vortex.main = "velocity_relative_l2"
    validate.write_results(Path("."), [vortex])
    page = Path("validation.md").read_text(encoding="utf-8")
    assert "| PySPH ISPH | not recorded | 32 | 0.0042 | 0.95 | yes |" in page
    assert "no: time 0.028125 against 0.0316" in page and Path("work_precision.png").stat().st_size > 5000
