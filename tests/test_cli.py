"""The command line: imports, exit codes, messages, what is left behind."""

import functools
import json
import os
import re
import signal
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import isphcli
from isphcli import cli
from isphcli.cli import BAD_INPUT, FAILED, INTERNAL, INTERRUPTED, OUTSIDE, STOPPED_SHORT, main
from isphcli.output.files import NotFiniteError
from isphcli.solvers.krylov import SolveError

from .paths import CASES

CASE = """\
title: slit
geometry: {box: [1, 0.5], periodic: [x]}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0]}
flow: stokes
output: {plots: false}
"""
IMAGE = """\
geometry: {voxels: {file: rock.npy, labels: {solid: 1, water: 0}, voxel_size: 1e-5}, periodic: [x]}
particles: {spacing: 1e-5}
fluids: {water: {density: 1000, viscosity: 1e-3}}
drive: {body_force: [1, 0, 0]}
flow: stokes
"""
HEAVY = ("numpy", "scipy", "numba", "pyamg", "matplotlib", "yaml", "rich", "meshio")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.yaml").write_text(CASE)
    return tmp_path


def isph(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def fake_run(monkeypatch, outcome):
    """`isphcli.run` whose `solve_case` raises `outcome` or returns it; returns the list of its calls."""
    calls = []

    def solve_case(case, quiet=False, resume=None, overwrite=False, look=None):
        calls.append((case, quiet))
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome, None

    module = types.ModuleType("isphcli.runs.run")
    module.solve_case = solve_case
    monkeypatch.setitem(sys.modules, "isphcli.runs.run", module)
    return calls


# -- imports ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words", [["--help"], ["--version"], ["run", "--help"], ["convert-voxels", "--help"]]
)
def test_help_imports_nothing_heavy(words):
    script = (
        "import sys\nfrom isphcli.cli import main\n"
        f"try:\n    main({words!r})\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr.strip() == "[]" and done.stdout


def test_python_m_isphcli_is_isph():
    """Each in a process of its own: a build leaves metadata in the folder, which come before the installed ones."""
    done, said = (subprocess.run([sys.executable, *words], capture_output=True, text=True)
                  for words in (["-m", "isphcli", "--version"], ["-c", "import isphcli; print(isphcli.__version__)"]))
    assert done.stdout == f"isph, version {said.stdout}" and said.stdout.strip() not in ("", "unknown")


def test_every_help_has_an_example_and_the_exit_codes():
    for name in ("run", "validate", "convert-voxels"):
        text = isph(name, "--help").output
        assert f"isph {name} " in text and "interrupted" in text


def test_one_blas_thread_and_the_numba_threads_that_were_asked_for():
    script = (
        "import os\n"
        "for name in list(os.environ):\n    if name.endswith('_NUM_THREADS'): del os.environ[name]\n"
        "os.environ['MKL_NUM_THREADS'] = '5'\n"
        "from isphcli.cli import set_threads\nset_threads(1)\nimport numba\n"
        "print(*[os.environ[n] for n in ('OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'OMP_NUM_THREADS')], "
        "numba.get_num_threads())"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.split() == ["1", "5", "1", "1"], done.stderr


# -- run -------------------------------------------------------------------------------------------------


def test_run_prints_permeability_its_error_and_the_time(monkeypatch, folder):
    (folder / "case.yaml").write_text(
        CASE + "reference: {kind: permeability, value: 2e-12, axes: [x], tolerance: 0.1, source: somewhere}\n"
    )
    (folder / "there").mkdir()
    (folder / "there/slice.png").touch()
    times = {"krylov": 1.5, "output": 0.001, "total": 2.0}
    calls = fake_run(monkeypatch, {"permeability": 1.9e-12, "cpu_seconds": times, "wall_seconds": times})
    done = isph("run", "case.yaml", "--out", "there", "--quiet", "--set", "particles.spacing=0.0625")
    assert done.exit_code == 0, done.output
    for text in (
        "1.90e-12 m2 = 1930 mD",
        "2e-12 m2 = 2026 mD",
        "-5 % (bound 10 %)",
        "somewhere",
        "krylov 1.50",
        "there/slice.png",
    ):
        assert text in done.output
    case, quiet = calls[0]
    assert quiet and case.particles.spacing == 0.0625 and case.output.directory == folder / "there"


def test_run_prints_each_axis_and_the_tensor(monkeypatch):
    tensor = np.diag([1e-12, 2e-12]).tolist()
    summary = {"permeability": {"x": 1e-12, "y": 2e-12}, "permeability_error": {"x": 1e-14}}
    fake_run(monkeypatch, summary | {"permeability_tensor": tensor, "errors": None})
    out = isph("run", "case.yaml").output
    assert "permeability x" in out and "permeability y" in out and "+- x" in out
    assert "1.00e-12   0.00e+00" in out


def test_no_more_digits_than_the_error_is_known_to(monkeypatch):
    """k = 5.43210e-13 with an error bar of 0.4e-13 is 5.4e-13; without a bar it has three digits."""
    bars = {"permeability": {"x": 5.4321e-13, "y": 5.4321e-13, "z": 0.0}, "permeability_error": {"x": 0.4321e-13}}
    fake_run(monkeypatch, bars)
    lines = isph("run", "case.yaml").output.splitlines()
    shown = dict(line.split("  ", 1) for line in lines if line.startswith("permeability"))
    assert shown["permeability x"].strip() == "5.4e-13 m2 = 550 mD"
    assert shown["permeability y"].strip() == "5.43e-13 m2 = 550 mD"
    assert shown["permeability z"].strip() == "0 m2 = 0 mD"


def test_run_prints_what_the_threshold_does(monkeypatch):
    known = {"thresholds": [90.0, 100.0, 110.0], "permeability": {"x": [0.9e-12, 1e-12, 1.2e-12]}}
    fake_run(monkeypatch, {"permeability": 1e-12, "permeability_by_threshold": known})
    assert "-10 % and +20 % at 90, 110 in place of 100" in isph("run", "case.yaml").output


def test_run_prints_what_was_run_and_what_was_warned_of(monkeypatch):
    inputs = ["image: 8 x 12 x 20 voxels along x, y, z", "voxel size: 5e-06 m, as given"]
    known = {"inputs": inputs, "porosity": 0.20349, "open_axes": ["x", "z"], "mass_error": 0.0123, "warnings": ["thin"],
             "throats": {"median": 1.84, "narrow": 1.0, "thin": 0.9}}
    fake_run(monkeypatch, {"permeability": 1e-12, **known})
    out = isph("run", "case.yaml").output
    for text in ("8 x 12 x 20 voxels along x, y, z", "5e-06 m, as given", "20.3 %", "x, z", "thin",
                 "1.2e-02 between slices", "median 1.8 particles wide"):
        assert text in out


def test_a_permeability_has_its_range_under_it(monkeypatch):
    source = "x: spacing +-2 % (90 % of 45 known bodies), y: the same"
    fake_run(monkeypatch, {"permeability": {"x": 1e-12, "y": 2e-12}, "permeability_range_from": source,
                           "permeability_range": {"x": [9e-13, 1.111e-12], "y": [1.8e-12, 2.2e-12]}})
    lines = [line.split(maxsplit=2) for line in isph("run", "case.yaml").output.splitlines()]
    assert ["range", "x", "9.00e-13 to 1.11e-12 m2"] in lines and ["range", "y", "1.80e-12 to 2.20e-12 m2"] in lines
    assert ["range", "from", source] in lines
    fake_run(monkeypatch, {"permeability": 1e-12, "permeability_range": [9e-13, 1.111e-12]})
    assert "9.00e-13 to 1.11e-12 m2" in isph("run", "case.yaml").output


def test_a_run_without_a_permeability_prints_mean_velocities(monkeypatch):
    fake_run(monkeypatch, {"mean_velocity": [0.123456, 1e-9], "superficial_velocity": [0.05, 0.0]})
    out = isph("run", "case.yaml").output
    assert "x 0.123, y 0 m/s" in out and "x 0.05, y 0 m/s" in out and "permeability" not in out


def test_a_run_between_reservoirs_prints_what_is_trapped(monkeypatch):
    found = {"saturation_water": 0.25, "trapped_water": 0.125, "capillary_pressure": 301.23, "pressure_jump": None}
    fake_run(monkeypatch, {"two_fluids": found})
    lines = [line.split() for line in isph("run", "case.yaml").output.splitlines()]
    assert "trapped water 0.125 of the fluid in the sample".split() in lines
    assert ["capillary", "pressure", "301.2", "Pa"] in [line[:4] for line in lines]
    assert not any(line[:2] == ["pressure", "jump"] for line in lines)


@pytest.mark.parametrize("status, code", [("steady", 0), ("out of steps", STOPPED_SHORT),
                                          ("not steady at the end", STOPPED_SHORT)])
def test_a_run_that_stops_short_has_an_exit_code_of_its_own(monkeypatch, status, code):
    fake_run(monkeypatch, {"status": status, "message": "time.max_steps came first"})
    done = isph("run", "case.yaml")
    assert done.exit_code == code and ("stopped short: time.max_steps" in done.stderr) == bool(code)


@pytest.mark.parametrize("name", ["scan.npz", "scan.npy"])
@pytest.mark.parametrize("command", ["run", "validate"])
def test_an_image_in_place_of_a_case_is_told_what_to_type(folder, name, command):
    """Both commands that are printed work as they stand: the missing option, and the case that is kept."""
    image = np.ones((4, 5, 6), np.uint8)
    image[:, 1:4, 2:5] = 0
    np.save("scan.npy", image)
    np.savez("scan.npz", image=image)
    done = isph(command, name)
    assert done.exit_code == BAD_INPUT and "6 x 5 x 4 voxels along x, y, z" in done.stderr and not done.stdout
    option = re.search(r"--set geometry.voxels.voxel_size=\w+", done.stderr).group()
    assert isph(command, "--check-only", name, *option.split(), "--set", "drive.axes=[z]").exit_code == 0
    assert isph(*re.search(r"isph (init scan\S+ --voxel-size \S+)", done.stderr).group(1).split()).exit_code == 0
    assert isph("validate", "--check-only", "scan.yaml", "--set", "drive.axes=[z]").exit_code == 0


@pytest.mark.parametrize("name, words", [("slices", "without slices"), ("out", "name the case.yaml in it")])
def test_a_folder_that_holds_no_image_says_what_is_missing(folder, name, words):
    (folder / name).mkdir()
    if name == "out":
        (folder / name / "case.yaml").write_text(CASE)
    done = isph("run", name)
    assert done.exit_code == BAD_INPUT and words in done.stderr and "Is a directory" not in done.stderr


def test_errors_of_the_run_are_shown_and_the_bound_stands_beside_the_main_one(monkeypatch, folder):
    (folder / "case.yaml").write_text(CASE + "reference: {kind: slit, tolerance: 0.01}\n")
    fake_run(
        monkeypatch, {"errors": {"velocity_max": 0.02, "velocity_relative_l2": 0.003, "main": "velocity_max"}}
    )
    lines = isph("run", "case.yaml").output.splitlines()
    assert any("velocity_max" in line and "+2 % (bound 1 %, not met)" in line for line in lines)
    assert any("velocity_relative_l2" in line and line.endswith("+0.3 %") for line in lines)


@pytest.mark.parametrize(
    "error, code, text",
    [
        (ValueError("interface: not built yet"), BAD_INPUT, "error: interface: not built yet"),
        (NotFiniteError("velocity: 3 values are not finite"), FAILED, "error: velocity: 3"),
        (OSError(28, "No space left on device"), FAILED, "No space left"),
        (MemoryError(), FAILED, "out of memory"),
        (KeyError("x"), INTERNAL, "internal error: KeyError"),
        (KeyboardInterrupt(), INTERRUPTED, "interrupted"),
    ],
)
def test_errors_become_one_message_and_an_exit_code(monkeypatch, error, code, text):
    fake_run(monkeypatch, error)
    done = isph("run", "case.yaml")
    assert done.exit_code == code and text in done.stderr and not done.stdout
    assert "Traceback" not in done.output


def test_a_failed_solve_and_its_restart_file(monkeypatch):
    convergence = types.SimpleNamespace(residual=1e-2, iterations=400, tolerance=1e-6, reason="out of iterations")
    error = SolveError("Stokes", convergence)
    error.restart = "out/case/restart.npz"
    fake_run(monkeypatch, error)
    done = isph("run", "case.yaml")
    assert done.exit_code == FAILED and "did not converge" in done.stderr
    assert "restart file: out/case/restart.npz" in done.stderr


def test_an_interrupted_run_says_where_its_restart_file_is(monkeypatch, folder):
    """One that lies in the folder and was not written by the run, nor read by it, is of another run."""
    (folder / "out/case").mkdir(parents=True)
    (folder / "out/case/restart.npz").touch()
    moving = ("--set", "flow=navier_stokes", "--set", "drive={body_force: [1, 0]}", "--set", "time={end: 1}")
    fake_run(monkeypatch, KeyboardInterrupt())
    assert "restart" not in isph("run", "case.yaml", *moving).stderr
    (folder / "case.yaml").rename(folder / "out/case/case.yaml")
    fake_run(monkeypatch, KeyboardInterrupt())
    assert "out/case/restart.npz" in isph("run", "--restart", "out/case", *moving).stderr
    stop = KeyboardInterrupt()
    stop.restart = "out/other/restart.npz"
    fake_run(monkeypatch, stop)
    assert "out/other/restart.npz" in isph("run", "--restart", "out/case", "--out", "out/other", *moving).stderr


def test_debug_raises(monkeypatch):
    fake_run(monkeypatch, KeyError("x"))
    assert isinstance(isph("run", "case.yaml", "--debug").exception, KeyError)


def test_an_output_directory_that_cannot_be_made(monkeypatch, folder):
    calls = fake_run(monkeypatch, {})
    (folder / "file").touch()
    done = isph("run", "case.yaml", "--out", "file/below")
    assert done.exit_code == BAD_INPUT and "is a file" in done.stderr and not calls


@pytest.mark.parametrize(
    "words", [["--threads", 0], ["--threads", 10**6], ["--threads", "two"], ["--nosuch"], []]
)
def test_bad_options(words, folder):
    done = isph("run", *words, *(["case.yaml"] if words else []))
    assert done.exit_code == BAD_INPUT and "Usage" in done.stderr
    assert os.listdir(folder) == ["case.yaml"]


def test_a_real_run(folder):
    pytest.importorskip("isphcli.runs.run")
    done = isph("run", "case.yaml", "--quiet")
    assert done.exit_code == 0, done.output
    assert "permeability" in done.stdout and not done.stderr
    k = json.loads((folder / "out/case/summary.json").read_text())["permeability"]
    assert k == pytest.approx(0.5**2 / 12, rel=0.05)  # four particles across


# -- bad input: one message, exit code 2, nothing written ------------------------------------------------


def rock(shape=(6, 6, 6)):
    values = np.zeros(shape, np.uint8)
    values[:, 0] = 1
    return values


BLOCKED = rock()
BLOCKED[:, :, 2:4] = 1


BAD = {
    "missing case": (None, None, [], "cannot be read"),
    "not yaml": ("a: [1", None, [], "not YAML"),
    "typo in a key": (CASE.replace("viscosity", "viscosty"), None, [], "did you mean 'viscosity'"),
    "typo in --set": (CASE, None, ["--set", "particles.spacng=1"], "did you mean 'spacing'"),
    "zero": (CASE.replace("0.125", "0"), None, [], "particles.spacing"),
    "negative": (CASE.replace("viscosity: 1", "viscosity: -1"), None, [], "viscosity"),
    "not a number": (CASE.replace("0.125", ".nan"), None, [], "particles.spacing"),
    "text for a number": (CASE.replace("0.125", "fine"), None, [], "particles.spacing"),
    "spacing above the box": (CASE.replace("0.125", "2"), None, [], "not smaller than the box"),
    "missing image": (IMAGE, None, [], "rock.npy"),
    "wrong shape": (IMAGE, np.zeros((2, 2, 2, 2), np.uint8), [], "4 dimensions"),
    "NaN": (IMAGE, np.full((4, 4, 4), np.nan), [], "holds NaN"),
    "infinite": (IMAGE, np.full((4, 4, 4), np.inf), [], "holds infinite values"),
    "grey values": (IMAGE, np.full((4, 4, 4), 0.5), [], "threshold"),
    "empty image": (IMAGE, np.zeros((0, 4, 4), np.uint8), [], "empty"),
    "value without a label": (IMAGE, rock() + 1, [], "label"),
    "label without a voxel": (IMAGE, np.ones((4, 4, 4), np.uint8), [], "no voxel has the label of 'water'"),
    "all solid": (
        CASE.replace("periodic", "shapes: [{box: {lower: [-1, -1], upper: [2, 2]}, is: solid}], periodic"),
        None, [], "no fluid",
    ),
    "no percolation": (IMAGE, BLOCKED, [], "permeability is zero"),
    "closed at both ends": (CASE.replace("[1, 0]", "[0, 1]"), None, [], "along y"),
}  # fmt: skip


@pytest.mark.parametrize("command", ["validate", "run"])
@pytest.mark.parametrize("name", BAD)
def test_bad_input(name, command, folder):
    text, image, words, message = BAD[name]
    if command == "run":
        pytest.importorskip("isphcli.runs.run")
    (folder / "case.yaml").unlink()
    if text is not None:
        (folder / "case.yaml").write_text(text)
    if image is not None:
        np.save(folder / "rock.npy", image)
    before = sorted(os.listdir(folder))
    done = isph(command, "case.yaml", *words)
    assert done.exit_code == BAD_INPUT, done.output
    assert message in done.output
    assert "Traceback" not in done.output and "internal error" not in done.output
    if command == "run":
        assert not done.stdout
    assert sorted(os.listdir(folder)) == before


def test_bytes_that_are_no_case(folder):
    (folder / "case.yaml").write_bytes(bytes(range(256)))
    done = isph("run", "case.yaml")
    assert done.exit_code == BAD_INPUT and "case.yaml" in done.stderr


# -- validate --------------------------------------------------------------------------------------------


def test_validate_goes_on_after_a_bad_case(folder):
    (folder / "bad.yaml").write_text("nosuch: 1\n")
    done = isph("validate", "bad.yaml", "case.yaml", "--check-only")
    assert done.exit_code == BAD_INPUT
    assert "nosuch" in done.stderr and "can run" in done.stdout


def test_validate_takes_the_folder_of_cases(folder, monkeypatch):
    (folder / "cases").mkdir()
    (folder / "case.yaml").rename(folder / "cases/slit.yaml")
    done = isph("validate", "--check-only")
    assert done.exit_code == 0 and "slit.yaml: slit" in done.stdout


def test_run_checks_as_validate_does(folder):
    """And runs nothing; of several processes too."""
    checked = isph("run", "case.yaml", "--check-only", "--ranks", 1)
    assert checked.exit_code == 0 and "ranks       each of 1:" in checked.stdout
    assert checked.stdout.strip() == isph("validate", "case.yaml", "--check-only", "--ranks", 1).stdout.strip()
    assert not (folder / "out").exists() and isph("run", "case.yaml", "--ranks", 2).exit_code == BAD_INPUT
    assert isph("run", "case.yaml", "--check-only", "--set", "drive=null").exit_code == BAD_INPUT


@pytest.mark.parametrize("passed, code", [(True, 0), (False, OUTSIDE)])
def test_validate_runs_the_cases_that_name_a_reference(monkeypatch, folder, passed, code):
    (folder / "slit.yaml").write_text(CASE + "reference: {kind: slit}\n")
    module = types.ModuleType("isphcli.validation.ladder")
    module.validate_cases = lambda cases, **options: (
        f"{[c.title for c in cases]} {options['levels']}",
        passed,
    )
    monkeypatch.setitem(sys.modules, "isphcli.validation.ladder", module)
    done = isph("validate", "slit.yaml", "case.yaml", "--levels", 3)
    assert done.exit_code == code and "['slit'] 3" in done.stdout
    assert isph("validate", "slit.yaml", "--check-only").exit_code == 0


# -- convert-voxels --------------------------------------------------------------------------------------


def test_convert_voxels_says_what_it_wrote(folder):
    grey = np.zeros((4, 6, 8))
    grey[:, 1:3] = 100
    np.save("grey.npy", grey)
    words = [
        "--threshold",
        90,
        "--invert",
        "--voxel-size",
        "2e-6",
        "--crop",
        "0:8,0:4,0:4",
        "--downsample",
        2,
    ]
    done = isph("convert-voxels", "grey.npy", "rock.npz", *words)
    assert done.exit_code == 0, done.output
    for text in ("4 x 2 x 2 (x, y, z)", "4e-06", "grey < 90.0 is solid", "porosity"):
        assert text in done.stdout
    assert (folder / "rock.npz").exists()


def test_convert_voxels_of_a_raw_scan_says_what_was_done(folder):
    """Layout by options, a size with its unit, steps of the report, a picture beside it."""
    scan = np.full((4, 6, 8), 200, ">u2")
    scan[1:3, 2:4, :] = 50
    (folder / "scan.raw").write_bytes(b"head" + scan.tobytes())
    words = ["--shape", "8,6,4", "--dtype", "uint16", "--offset", 4, "--byte-order", "big", "--threshold", "otsu",
             "--trim", "--connected", "x", "--voxel-size", "2um"]
    done = isph("convert-voxels", "scan.raw", "rock.tif", *words)
    assert done.exit_code == 0, done.output
    for text in ("raw, array 4 x 6 x 8, its axes taken as z, y, x", "8 x 2 x 2 (x, y, z)", "2e-06", "(Otsu) is solid",
                 "1.6e-05 x 4e-06 x 4e-06 m", "0 x 4 x 2 voxels of solid border", "rock_slices.png", "100.00 %"):
        assert text in done.stdout
    assert (folder / "rock_slices.png").exists()
    assert isph("convert-voxels", "rock.tif", "again.npy", "--no-picture").exit_code == 0
    assert (np.load("again.npy") == 0).all() and not (folder / "again_slices.png").exists()


def test_an_image_whose_voxel_size_is_known_runs_by_itself(folder, monkeypatch):
    image = np.ones((4, 5, 6), np.uint8)
    image[1:3, 2:4] = 0
    np.savez("duct.npz", image=image)
    fake_run(monkeypatch, {"status": "finished"})
    done = isph("run", "duct.npz", "--set", "geometry.voxels.voxel_size=2um")
    assert done.exit_code == 0, done.output
    assert "assumed: voxels of value 1 are solid (80 %), those of 0 pore" in done.stderr
    assert "assumed: flow along x alone" in done.stderr
    checked = isph("validate", "--check-only", "duct.npz", "--set", "geometry.voxels.voxel_size=2um")
    assert checked.exit_code == 0 and "assumed: flow along x alone" in checked.stderr and "can run" in checked.stdout
    done = isph("run", "duct.npz")
    assert done.exit_code == BAD_INPUT and "give it, such as --set geometry.voxels.voxel_size=5um" in done.stderr


def test_convert_voxels_relabels(folder):
    np.save("seg.npy", np.array([[0, 255], [255, 255]], np.uint8))
    done = isph("convert-voxels", "seg.npy", "rock.npy", "--labels", "255=1")
    assert done.exit_code == 0 and "solid, 3 voxels, 75.00 %" in done.stdout
    assert np.load("rock.npy").max() == 1


@pytest.mark.parametrize(
    "words, message",
    [
        (["nosuch.npy", "rock.npy"], "no such file"),
        (["seg.npy", "rock.png"], "are not written"),
        (["seg.npy", "nowhere/rock.npy"], "cannot be written"),
        (["seg.npy", "rock.npy", "--crop", "0-3"], "not of the form"),
        (["seg.npy", "rock.npy", "--crop", "0:3,0:99"], "crop y"),
        (["seg.npy", "rock.npy", "--labels", "7=1"], "no voxel has the value"),
        (["seg.npy", "rock.npy", "--labels", "a=1"], "not of the form"),
        (["seg.npy", "rock.npy", "--threshold", "nan"], "not of the form"),
        (["seg.npy", "rock.npy", "--voxel-size", "-1"], "must be positive"),
        (["seg.npy", "rock.npy", "--downsample", "0"], "--downsample"),
        (["seg.npy", "rock.npy", "--downsample", "99"], "downsample 99"),
        (["seg.npy", "rock.npy", "--invert"], "--threshold"),
        (["seg.npy", "rock.npy", "--threshold", "9,3"], "two that ascend"),
        (["seg.npy", "rock.npy", "--threshold", "otso"], "not of the form"),
        (["seg.npy", "rock.npy", "--mirror", "w"], "not of the form"),
        (["seg.npy", "rock.npy", "--mirror", "z"], "no axis z"),
        (["seg.npy", "rock.npy", "--connected", "z"], "no pores along 'z'"),
        (["seg.npy", "rock.npy", "--solid", "0", "--trim"], "all voxels are solid"),
        (["seg.npy", "rock.npy", "--voxel-size", "5 s"], "not of the form"),
        (["seg.npy", "rock.npy", "--dtype", "uint9"], "uint9"),
    ],
)
def test_convert_voxels_refuses(words, message, folder):
    np.save("seg.npy", np.zeros((4, 4), np.uint8))
    done = isph("convert-voxels", *words)
    assert done.exit_code == BAD_INPUT and message in done.stderr
    assert sorted(os.listdir(folder)) == ["case.yaml", "seg.npy"]


# -- keys ------------------------------------------------------------------------------------------------


def test_keys():
    assert "particles.spacing  (number, m, > 0, required)" in isph("keys", "particles.spacing").output
    assert "fluids.<name>.density" in isph("keys", "fluids.water.density").output
    assert "geometry.shapes[].is" in isph("keys", "geometry.shapes.0").output
    assert isph("keys").output.count("\n") > 150
    assert isph("keys", "nosuch").exit_code == BAD_INPUT


def test_keys_finds_what_the_texts_speak_of():
    done = isph("keys", "Gravity")
    assert done.exit_code == 0 and done.stdout.startswith("drive.body_force  (")
    assert done.stderr == f"1 of {isph('keys').stdout.count(chr(10)) // 2} keys speak of 'Gravity':\n"
    done = isph("keys", "contact", "angle")  # all of the words, in whatever order
    assert "interface.contact_angle" in done.stdout and done.stdout == isph("keys", "angle", "contact").stdout
    assert "drive.body_force" not in done.stdout


@pytest.mark.parametrize(
    "word, near",
    [
        ("gravty", "'gravity'"),
        ("particels", "'particles'"),
        ("particles.spcing", "'particles.spacing'"),
        ("fluids.water.viscositi", "'fluids.<name>.viscosity'"),
        ("xyzzy", None),
    ],
)
def test_keys_suggests_what_is_written_almost_alike(word, near):
    done = isph("keys", word)
    assert done.exit_code == BAD_INPUT and not done.stdout
    assert done.stderr.strip().endswith(f"did you mean {near}?" if near else "`isph keys` lists all")


# -- streams and folders that will not do ----------------------------------------------------------------


def program(*words, code="from isphcli.cli import main; main()", **options):
    environment = {**os.environ, "PYTHONPATH": str(Path(isphcli.__file__).parents[1]), **options.pop("env", {})}
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, env=environment, **options)


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1", "ascii", "utf-8", "utf-16"])
def test_output_of_any_encoding(encoding, folder):
    """What cp1252 and latin-1 do not have is written plainly; for ascii click takes UTF-8."""
    done = program("keys", "time.end", env={"PYTHONIOENCODING": encoding})
    assert done.returncode == 0 and not done.stderr
    text = done.stdout.decode("utf-8" if encoding == "ascii" else encoding)
    assert "time.end  (number, s, > 0)" in text
    done = program("keys", "particles.jitter", env={"PYTHONIOENCODING": encoding})
    sign = "≥" if encoding in ("ascii", "utf-8", "utf-16") else ">="
    assert f"{sign} 0" in done.stdout.decode("utf-8" if encoding == "ascii" else encoding)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["岩石.yaml", os.fsdecode(b"caf\xe9.yaml")])
@pytest.mark.parametrize(
    "env",
    [
        {"PYTHONIOENCODING": "cp1252"},
        {"LC_ALL": "C"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
)
def test_names_of_files_in_any_alphabet(name, env, folder):
    (folder / name).write_text(CASE)
    code = "from isphcli.cli import main; main(['run', '--quiet', *__import__('glob').glob('*.yaml')])"
    (folder / "case.yaml").unlink()
    done = program(code=code, env=env)
    assert done.returncode == 0 and b"permeability" in done.stdout and not done.stderr
    assert (folder / "out" / name.removesuffix(".yaml") / "summary.json").exists()


@pytest.mark.slow
def test_a_reader_that_left_is_no_error_and_closed_streams_take_no_file_of_the_run(folder):
    shell = f"{sys.executable} -m isphcli %s"
    env = {**os.environ, "PYTHONPATH": str(Path(isphcli.__file__).parents[1])}
    done = subprocess.run(["bash", "-c", shell % "keys | true; echo ${PIPESTATUS[0]}"], capture_output=True, env=env)
    assert done.stdout in (b"0\n", b"141\n") and not done.stderr  # 0 where all was written before it left
    for streams, said in (("2>&-", b"permeability"), (">&- 2>&-", b""), ("<&- >&-", b"")):
        command = shell % f"run case.yaml {streams}"
        done = subprocess.run(["bash", "-c", command], capture_output=True, env=env)
        assert done.returncode == 0 and said in done.stdout
        assert json.loads((folder / "out/case/summary.json").read_text())["permeability"] > 0
        for path in (folder / "out/case").rglob("*.*"):
            assert b"done in" not in path.read_bytes()  # the progress goes into no result
        (folder / "out").rename(folder / f"out{len(os.listdir(folder))}")


@pytest.mark.slow
def test_progress_that_nobody_reads_ends_no_run(folder):
    """stderr is a pipe whose reader has left, or full."""
    command = f"{sys.executable} -m isphcli run case.yaml 2> >(true); sleep 0.1; exec true"
    env = {**os.environ, "PYTHONPATH": str(Path(isphcli.__file__).parents[1])}
    assert b"permeability" in subprocess.run(["bash", "-c", command], capture_output=True, env=env).stdout
    command = f"{sys.executable} -m isphcli run case.yaml --out out/full 2> /dev/full"
    done = subprocess.run(["bash", "-c", command], capture_output=True, env=env)
    assert done.returncode == 0 and b"permeability" in done.stdout
    command = f"{sys.executable} -m isphcli run nosuch.yaml 2> /dev/full"
    assert subprocess.run(["bash", "-c", command], env=env).returncode == BAD_INPUT


@pytest.mark.slow
def test_an_interrupted_run_is_one_line(folder):
    """As the compiler works, in a cache that is new: no traceback, and the exit code of an interruption."""
    (folder / "case.yaml").write_text(CASE.replace("stokes", "navier_stokes\ntime: {end: 1}"))
    env = {**os.environ, "PYTHONPATH": str(Path(isphcli.__file__).parents[1]), "NUMBA_CACHE_DIR": str(folder / "new")}
    words = [sys.executable, "-m", "isphcli", "run", "case.yaml"]
    listening = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # not so below a shell's `&`
    pipes = {"stderr": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    running = subprocess.Popen(words, preexec_fn=listening, env=env, **pipes)
    for line in running.stderr:
        if line.startswith("compiling, once per machine"):
            break
    running.send_signal(signal.SIGINT)
    stdout, stderr = running.communicate(timeout=120)
    # Python ends itself with the signal where it met code that was compiled from a string: 130 for a shell
    assert running.returncode in (INTERRUPTED, -signal.SIGINT) and not stdout
    assert stderr.splitlines()[-1] == "interrupted" and "Traceback" not in stderr


# -- init, examples, report ------------------------------------------------------------------------------


def test_init_writes_a_case_that_can_be_checked(folder):
    image = np.zeros((4, 6, 8), np.uint8)
    image[:, :2] = 1
    np.save("scan.npy", image)
    done = isph("init", "scan.npy", "--voxel-size", "2e-6")
    assert done.exit_code == 0 and "isph validate --check-only scan.yaml" in done.output, done.output
    assert "1 is taken as solid" in done.stderr
    assert isph("validate", "--check-only", "scan.yaml").exit_code == 0
    before = (folder / "scan.yaml").read_text()
    done = isph("init", "scan.npy")
    assert done.exit_code == BAD_INPUT and "is there already" in done.output
    assert (folder / "scan.yaml").read_text() == before


def test_init_of_spheres_and_of_a_drop(folder):
    (folder / "pack.csv").write_text("x,y,z\n0,0,0\n1,1,1\n")
    assert isph("init", "pack.csv", "mine.yaml", "--radius", "0.5").exit_code == 0 and (folder / "mine.yaml").exists()
    assert isph("init", "pack.csv").exit_code == BAD_INPUT  # no radius anywhere
    assert isph("init", "--drop").exit_code == 0 and (folder / "drop.yaml").exists()
    assert isph("init").exit_code == BAD_INPUT and isph("init", "--drop", "a.yaml", "b.yaml").exit_code == BAD_INPUT
    assert isph("init", "missing.npy").exit_code == BAD_INPUT


def test_init_takes_lengths_with_their_units(folder):
    (folder / "pack.csv").write_text("0,0,0\n1e-3,0,0\n0,1e-3,0\n")
    assert isph("init", "pack.csv", "--radius", "0.5mm").exit_code == 0
    assert "radius: 0.0005}" in (folder / "pack.yaml").read_text()
    for wrong in ("-0.5mm", "0", "5 kg", "1mm,2mm", "inf"):
        assert isph("init", "pack.csv", "other.yaml", "--radius", wrong).exit_code == BAD_INPUT


def test_init_that_fills_the_disk_leaves_no_case(folder, monkeypatch):
    """What is left half-written would be refused the next time as there already."""
    (folder / "pack.csv").write_text("0,0,0,1\n1,0,0,1\n0,1,0,1\n")

    def full(path, text, **_):
        path.touch()
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_text", full)
        done = isph("init", "pack.csv", "my case.yaml")
    assert done.exit_code == BAD_INPUT and "No space left" in done.output
    again = isph("init", "pack.csv", "my case.yaml")
    assert again.exit_code == 0 and "--check-only 'my case.yaml'" in again.output


def test_examples_are_listed_printed_and_copied(folder):
    listed = isph("examples").output
    assert "berea " in listed and "Berea sandstone" in listed
    assert isph("examples", "slit").output == (CASES / "slit.yaml").read_text()
    done = isph("examples", "grey_blobs", "--copy", "new")
    assert done.exit_code == 0 and f"isph run {Path('new/grey_blobs.yaml')}" in done.output
    assert isph("validate", "--check-only", "new/grey_blobs.yaml").exit_code == 0
    assert isph("examples", "slitt").exit_code == BAD_INPUT and isph("examples", "--copy", "x").exit_code == BAD_INPUT


def test_validate_without_cases_here_takes_those_of_the_package(folder):
    assert [path.stem for path in cli.default_cases()] == sorted(path.stem for path in CASES.glob("*.yaml"))
    (folder / "cases").mkdir()
    (folder / "cases/mine.yaml").write_text(CASE)
    assert cli.default_cases() == (Path("cases/mine.yaml"),)


def test_report_of_runs(folder):
    for name in ("a", "b"):
        (folder / name).mkdir()
        (folder / name / "summary.json").write_text('{"title": "Run ' + name + '", "status": "finished"}')
        (folder / name / "case.yaml").write_text(CASE)
    done = isph("report", "a")
    assert done.exit_code == 0 and "Run a" in (folder / "report.html").read_text()
    assert str(folder / "report.html") in done.output
    assert isph("report", "a", "b").exit_code == BAD_INPUT and "Run b" not in (folder / "report.html").read_text()
    assert isph("report", "a", "b", "--force").exit_code == 0 and "Run b" in (folder / "report.html").read_text()
    for page in ("other.html", "report.html"):  # a folder that is missing is said before a page that is there
        done = isph("report", "nowhere", "--to", page)
        assert done.exit_code == BAD_INPUT and "nowhere: no such folder; name the folder of a run" in done.output
    assert not Path("other.html").exists()


def test_the_schema_is_that_of_the_documents():
    assert isph("keys", "--schema").output == (CASES.parent / "docs/case.schema.json").read_text()


def test_completion_knows_the_commands():
    env = {"_ISPH_COMPLETE": "bash_complete", "COMP_WORDS": "isph re", "COMP_CWORD": "1"}
    done = program(code="from isphcli.cli import main; main(prog_name='isph')", env=env)
    assert done.stdout.split() == [b"plain,relperm", b"plain,report", b"plain,rev"]
