"""Restart: a run in pieces leaves what a run in one piece leaves, bit for bit; damaged files are named and refused."""

import errno
import json
import os
import re
import resource
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.load import load_case
from isphcli.flow.state import State
from isphcli.output import files, restart
from isphcli.output.clock import Clock
from isphcli.output.files import read_history, read_pvd, write_vtu
from isphcli.output.restart import RestartError, Saved
from isphcli.runs.run import run_case
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare
from tests.threads import one_thread

VORTEX = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.0625, jitter: 0.1}
fluids: {water: {density: 1, viscosity: 0.1}}
initial: {velocity: ["sin(2*pi*x)*cos(2*pi*y)", "-cos(2*pi*x)*sin(2*pi*y)"]}
time: {end: 0.1, cfl: 0.4}
output: {every: 0.03, plots: false}
"""
CAVITY = """
geometry: {box: [1, 1], walls: {y_max: {velocity: [1, 0]}}}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 0.1}}
time: {end: 0.5, cfl: 0.4}
output: {every: 0.2, plots: false}
"""
POROUS = """
geometry: {box: [1, 1], periodic: [x, y], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.25}, is: solid}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0]}
time: {steady: 2.0e-2, end: 1000}
output: {plots: false}
"""
# half a drop on a wall under gravity: tension, contact angle, jumps of density and viscosity, ganglia that are counted
CAP = """
geometry:
  box: [1, 0.5]
  periodic: [x]
  fluid: water
  shapes: [{sphere: {centre: [0.5, 0], radius: 0.25}, is: oil}]
particles: {spacing: 0.0625, jitter: 0.1}
fluids: {oil: {density: 2, viscosity: 0.2}, water: {density: 1, viscosity: 0.05}}
interface: {tension: 1, contact_angle: 60}
drive: {body_force: [0.5, -1]}
time: {end: 0.15, capillary: 0.7}
output: {every: 0.04, plots: false}
"""
DROP = """
geometry: {box: [1, 1], periodic: [x], shapes: [{box: {lower: [0.3, 0.3], upper: [0.7, 0.7]}, is: oil}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 0.1}, oil: {density: 3, viscosity: 1}}
interface: {tension: 1}
time: {end: 0.05}
"""


@pytest.fixture(autouse=True)
def on_one_thread():
    with one_thread():
        yield


def load(tmp_path, text, out, *sets):
    (tmp_path / "case.yaml").write_text(text)
    return load_case(tmp_path / "case.yaml", [f"output.directory={tmp_path / out}", *sets])


def stop_at(monkeypatch, step):
    """Ctrl-C in the middle of a step."""
    real = TimeLoop._row

    def row(self, found, limit):
        if found.state.step == step:
            raise KeyboardInterrupt
        return real(self, found, limit)

    monkeypatch.setattr(TimeLoop, "_row", row)


def left_by(directory):
    """{file: bytes} of history, snapshots and series, and the arrays of the restart file."""
    files = [directory / "history.csv", *directory.glob("*.pvd"), *directory.glob("snapshots/*")]
    found = {str(path.relative_to(directory)): path.read_bytes() for path in files}
    with np.load(directory / restart.NAME) as file:
        return found | {name: file[name].tobytes() for name in file.files}


@pytest.mark.slow
@pytest.mark.parametrize("text, steps", [
    (VORTEX, (1, 5)), (CAVITY, (9, 14)), (POROUS, (30, 31)), (CAP, (6, 21)),
    (CAP.replace("jitter: 0.1", "shifting: 0"), (1, 14)),
    (CAP.replace("body_force: [0.5, -1]", "superficial_velocity: {x: 0.1}"), (7,)),
], ids=["shifted", "walls", "to a steady state", "two fluids on a wall, shifted", "two fluids on a wall",
        "held velocity"])
def test_a_run_in_pieces_is_the_run_in_one_piece(tmp_path, text, steps, monkeypatch):
    """Interrupted at any step, not only where files are written: the same history, snapshots and state, bit for bit.
    The hierarchies in use were built long before the step of the interrupt."""
    run_case(load(tmp_path, text, "a"), quiet=True)
    resume = None
    for step in steps:
        with monkeypatch.context() as patch:
            stop_at(patch, step)
            with pytest.raises(KeyboardInterrupt):
                run_case(load(tmp_path, text, "b"), quiet=True, resume=resume)
        resume = tmp_path / "b"
    run_case(load(tmp_path, text, "b"), quiet=True, resume=resume)
    one, two = left_by(tmp_path / "a"), left_by(tmp_path / "b")
    assert one.keys() == two.keys()
    assert [name for name in one if one[name] != two[name]] == []
    with np.load(tmp_path / "a" / restart.NAME) as file:
        assert int(file["state0.step"]) >= steps[-1] + 2


def test_two_fluids_go_on_with_the_same_bits(tmp_path):
    """A drop between walls, of another density and viscosity: stopped and taken up by a new stepper, twice."""
    case = load(tmp_path, DROP, "a")
    geometry = build_geometry(case)

    def loop(saved, steps):
        state, stepper, particles = prepare(case, geometry, Clock())
        if saved is not None:
            restart.save(tmp_path / "r.npz", saved)
            saved = restart.load(tmp_path / "r.npz", state)
            state = saved.state
            stepper.rebuild_hierarchies(saved.origins)
        limited = replace(case, time=replace(case.time, max_steps=steps))
        found = TimeLoop(limited, stepper, particles.site_volume, 1.0)
        nothing = lambda *_: None  # noqa: E731
        found.run(state, stepper.ready(state), nothing, nothing, nothing)
        return found.last

    whole, parts = loop(None, 14), loop(loop(loop(None, 3), 8), 14)
    assert whole.state.step == parts.state.step == 14 and whole.origins.keys() == parts.origins.keys() != set()
    for name in ("x", "u", "u_old", "p", "time", "dt_old"):
        assert np.array_equal(getattr(whole.state, name), getattr(parts.state, name)), name


def test_a_finished_run_goes_on_with_more_time(tmp_path):
    run_case(load(tmp_path, VORTEX, "a"), quiet=True)
    summary = run_case(load(tmp_path, VORTEX, "a", "time.end=0.13"), quiet=True, resume=tmp_path / "a")
    rows = read_history(tmp_path / "a" / "history.csv")
    assert [r["step"] for r in rows] == list(range(1, summary["steps"] + 1))
    assert [t for t, _ in read_pvd(tmp_path / "a" / "particles.pvd")] == pytest.approx(
        [0, 0.03, 0.06, 0.09, 0.1, 0.12, 0.13])


@pytest.mark.slow
def test_a_finished_steady_run_is_finished(tmp_path):
    first = run_case(load(tmp_path, POROUS, "a"), quiet=True)
    again = run_case(load(tmp_path, POROUS, "a"), quiet=True, resume=tmp_path / "a")
    assert first["status"] == again["status"] == "steady"
    assert again["steps"] == first["steps"] and again["permeability"] == first["permeability"]


def test_a_run_goes_on_in_another_directory(tmp_path):
    run_case(load(tmp_path, VORTEX, "a"), quiet=True)
    before = left_by(tmp_path / "a")
    run_case(load(tmp_path, VORTEX, "b", "time.end=0.13"), quiet=True, resume=tmp_path / "a")
    assert left_by(tmp_path / "a") == before
    assert read_history(tmp_path / "b" / "history.csv")[0]["time"] > 0.1


def refuses_to_go_on(case, resume, *words):
    """Exit code 2's error with these words, and not a byte of the folder is another."""
    before = {path: path.read_bytes() for path in resume.rglob("*") if path.is_file()}
    with pytest.raises(RestartError) as caught:
        run_case(case, quiet=True, resume=resume)
    assert [word for word in words if word not in str(caught.value)] == []
    assert {path: path.read_bytes() for path in resume.rglob("*") if path.is_file()} == before


SHAPES = "shapes: [{spheres: {file: beads.csv, radius: 0.2}, is: solid}], "


@pytest.mark.parametrize("change, said", [
    ("geometry.box=[1, 2]", "geometry.box [1.0, 1.0] -> [1.0, 2.0]"),
    ("geometry.shapes.0.spheres.radius=0.21", "geometry.shapes[0].spheres.radius 0.2 -> 0.21"),
    ("geometry.periodic=[x]", 'geometry.periodic ["x", "y"] -> ["x"]'),
    ("particles.spacing=0.0626", "particles.spacing 0.0625 -> 0.0626"),
    ("particles.jitter=0.2", "particles.jitter 0.1 -> 0.2"),
    ("initial.velocity=['0', '1']", "initial.velocity"),
    ("fluids={oil: {density: 1, viscosity: 0.1}}", 'fluids ["water"] -> ["oil"]'),
])
def test_another_scene_is_refused(tmp_path, change, said):
    """A scene of as many particles too: what differs is named."""
    (tmp_path / "beads.csv").write_text("x,y\n0.5,0.5\n")
    text = VORTEX.replace("{box", "{" + SHAPES + "box").replace("end: 0.1", "end: 0.001")
    run_case(load(tmp_path, text, "a"), quiet=True)
    refuses_to_go_on(load(tmp_path, text, "a", "time.end=0.002", change), tmp_path / "a", "another scene", said)


def test_spheres_that_moved_in_their_file_are_refused(tmp_path):
    """Nothing in the case is another: the content of the file counts."""
    (tmp_path / "beads.csv").write_text("x,y\n0.5,0.5\n")
    text = VORTEX.replace("{box", "{" + SHAPES + "box").replace("end: 0.1", "end: 0.001")
    run_case(load(tmp_path, text, "a"), quiet=True)
    (tmp_path / "beads.csv").write_text("x,y\n0.5,0.500001\n")
    refuses_to_go_on(load_case(tmp_path / "a" / "case.yaml", ["time.end=0.002"]), tmp_path / "a",
                     "geometry.shapes[0].spheres.file holds something else")


ROCK = """
geometry: {voxels: {file: rock.npy, labels: {solid: 1, water: 0}, voxel_size: 1}, periodic: [x, y, z]}
particles: {spacing: 1}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0, 0]}
time: {end: 0.1}
output: {plots: false}
"""


def test_another_image_of_equal_pore_count_is_refused(tmp_path):
    """The same voxels in a file of another name and format are the same scene."""
    image = np.zeros((6, 6, 6), np.uint8)
    image[:2, :2] = 1
    np.save(tmp_path / "rock.npy", image)
    run_case(load(tmp_path, ROCK, "a"), quiet=True)
    np.savez_compressed(tmp_path / "same.npz", image=image)
    longer = f"geometry.voxels.file={tmp_path / 'same.npz'}", "time.end=0.11"
    assert run_case(load_case(tmp_path / "a" / "case.yaml", longer), quiet=True,
                    resume=tmp_path / "a")["time"] == pytest.approx(0.11)
    np.savez_compressed(tmp_path / "same.npz", image=image[::-1])
    refuses_to_go_on(load_case(tmp_path / "a" / "case.yaml", ["time.end=0.12"]), tmp_path / "a", "another scene",
                     "geometry.voxels.file holds something else")


def test_what_a_restart_changes_is_said_and_stays(tmp_path, capsys):
    """On the terminal, in the summary and at the head of case.yaml, over several restarts; the run is then that of the
    new values, and case.yaml can be read."""
    run_case(load(tmp_path, CAVITY, "a"), quiet=True)
    assert json.loads((tmp_path / "a" / "summary.json").read_text())["restarts"] == []
    first = ("fluids.water.viscosity=0.2", "geometry.walls.y_max.velocity=[2, 0]", "time.end=0.6")
    summary = run_case(load(tmp_path, CAVITY, "a", *first), resume=tmp_path / "a")
    step = summary["restarts"][0]["step"]
    line = (f"step {step}, time 0.5: geometry.walls.y_max.velocity [1.0, 0.0] -> [2.0, 0.0], "
            "fluids.water.viscosity 0.1 -> 0.2, time.end 0.5 -> 0.6")
    assert f"restart: changed from {line}" in capsys.readouterr().err
    assert summary["message"] == f"changed by a restart from {line.removesuffix(', time.end 0.5 -> 0.6')}"
    case = load_case(tmp_path / "a" / "case.yaml", ["time.end=0.7"])
    assert case.fluids["water"].viscosity == 0.2
    summary = run_case(case, resume=tmp_path / "a")
    said = capsys.readouterr().err
    assert "time.end 0.6 -> 0.7" in said and "viscosity" not in said
    head = (tmp_path / "a" / "case.yaml").read_text().splitlines()[:3]
    assert head[1:] == [f"# {line}", f"# step {summary['restarts'][1]['step']}, time 0.6: time.end 0.6 -> 0.7"]
    written = json.loads((tmp_path / "a" / "summary.json").read_text())["restarts"]
    assert written == summary["restarts"] and [entry["changes"] for entry in written] == [
        {"geometry.walls.y_max.velocity": [[1, 0], [2, 0]], "fluids.water.viscosity": [0.1, 0.2],
         "time.end": [0.5, 0.6]}, {"time.end": [0.6, 0.7]}]


def test_a_change_is_not_lost_with_a_run_that_is_killed(tmp_path, monkeypatch):
    """Stopped before its first restart file: the next restart finds the change again, once."""
    run_case(load(tmp_path, CAVITY, "a"), quiet=True)
    with monkeypatch.context() as patch:
        patch.setattr(restart, "save", lambda *_: None)
        stop_at(patch, read_history(tmp_path / "a" / "history.csv")[-1]["step"] + 2)
        with pytest.raises(KeyboardInterrupt):
            run_case(load(tmp_path, CAVITY, "a", "fluids.water.viscosity=0.2", "time.end=0.6"), quiet=True,
                     resume=tmp_path / "a")
    assert "viscosity 0.1 -> 0.2" in (tmp_path / "a" / "case.yaml").read_text()
    summary = run_case(load_case(tmp_path / "a" / "case.yaml"), quiet=True, resume=tmp_path / "a")
    assert [entry["changes"]["fluids.water.viscosity"] for entry in summary["restarts"]] == [[0.1, 0.2]]
    assert (tmp_path / "a" / "case.yaml").read_text().count("viscosity 0.1 -> 0.2") == 1


def test_an_end_that_has_passed_is_refused(tmp_path, capsys):
    """The end that was reached is none of them: a run that was killed before its summary is finished so."""
    summary = run_case(load(tmp_path, VORTEX, "a"), quiet=True)
    for change in ("time.end=0.05", f"time.max_steps={summary['steps'] - 1}"):
        key = change.partition("=")[0]
        refuses_to_go_on(load(tmp_path, VORTEX, "a", change), tmp_path / "a", f"step {summary['steps']}, time 0.1",
                         key, f"--set {key}=...")
    (tmp_path / "a" / "summary.json").unlink()
    before = left_by(tmp_path / "a")
    again = run_case(load(tmp_path, VORTEX, "a"), resume=tmp_path / "a")
    assert "has reached its end, time 0.1: no step is left" in capsys.readouterr().err
    assert again["steps"] == summary["steps"] and np.array_equal(again["mean_velocity"], summary["mean_velocity"])
    assert left_by(tmp_path / "a") == before and (tmp_path / "a" / "summary.json").exists()


def test_a_file_of_another_version_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(restart, "VERSION", 2)
    restart.save(tmp_path / "r.npz", saved())
    monkeypatch.undo()
    with pytest.raises(RestartError, match="was written by another version of isph"):
        restart.load(tmp_path / "r.npz", saved().state)


def saved(n=20):
    rng = np.random.default_rng(1)
    a = State(rng.random((n, 2)), rng.random((n, 2)), rng.random((n, 2)), rng.random(n), 1 / 3, 7, 0.1)
    b = State(a.x + 1, a.u, a.u_old, a.p, 0.1, 3, 0.2)
    return Saved(a, {"pressure": (b, 0.1, 12), "velocity": (b, 0.1, 3)}, ((0.1, 1 / 3), (0.2, 1e-30)))


def test_a_file_holds_all_of_a_run(tmp_path):
    was = saved()
    restart.save(tmp_path / "r.npz", was)
    found = restart.load(tmp_path / "r.npz", was.state)
    assert found.steady == was.steady
    assert found.state.time == 1 / 3 and found.state.step == 7 and isinstance(found.state.step, int)
    for name in ("x", "u", "u_old", "p"):
        assert np.array_equal(getattr(found.state, name), getattr(was.state, name))
    state, dt, first = found.origins["pressure"]
    assert np.array_equal(state.x, was.state.x + 1) and (dt, first) == (0.1, 12)
    assert found.origins["velocity"][0] is state


@pytest.mark.slow
def test_every_damaged_bit_is_found(tmp_path):
    """A bit turned over anywhere: refused, or in a byte that means nothing (the zip's own times and attributes)."""
    was, path = saved(4), tmp_path / "r.npz"
    restart.save(path, was)
    whole = path.read_bytes()
    refused = 0
    for k in range(0, len(whole), 7):
        path.write_bytes(whole[:k] + bytes([whole[k] ^ 16]) + whole[k + 1 :])
        try:
            found = restart.load(path, was.state)
        except RestartError as error:
            assert str(path) in str(error)
            refused += 1
        else:
            assert np.array_equal(found.state.x, was.state.x) and found.steady == was.steady
    assert refused > 0.5 * len(range(0, len(whole), 7))


@pytest.mark.parametrize("length", [0, 1, 100, 0.5, 0.99])
def test_a_truncated_file_is_refused(tmp_path, length):
    path = tmp_path / "r.npz"
    restart.save(path, saved())
    whole = path.read_bytes()
    path.write_bytes(whole[: length if length >= 1 else int(length * len(whole))])
    with pytest.raises(RestartError, match=re.escape(f"{path}: is no restart file of ours, or damaged")):
        restart.load(path, saved().state)


def test_a_file_of_another_case_is_refused(tmp_path):
    restart.save(tmp_path / "r.npz", saved())
    with pytest.raises(RestartError, match=r"has the shape \(20,.*needs \(10,"):
        restart.load(tmp_path / "r.npz", saved(10).state)
    held = replace(saved().state, pressure_gradient=0.0)
    with pytest.raises(RestartError, match="one of the file and the case holds a superficial velocity"):
        restart.load(tmp_path / "r.npz", held)
    with pytest.raises(RestartError, match="no restart file"):
        restart.load(tmp_path / "other.npz", saved().state)


def test_nan_is_not_saved(tmp_path):
    was = saved()
    was.state.p[3] = np.nan
    with pytest.raises(RestartError, match="p is not finite"):
        restart.save(tmp_path / "r.npz", was)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_loses_nothing(tmp_path, monkeypatch):
    """ENOSPC in the second snapshot: the first stays, the run ends with the error, and the restart makes it whole."""
    run_case(load(tmp_path, VORTEX, "a"), quiet=True)
    real = write_vtu

    def full(path, *rest):
        if "000000" not in str(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(path, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(files, "write_vtu", full)
        with pytest.raises(OSError) as caught:
            run_case(load(tmp_path, VORTEX, "b"), quiet=True)
    assert caught.value.errno == errno.ENOSPC
    assert caught.value.restart == tmp_path / "b" / restart.NAME
    run_case(load(tmp_path, VORTEX, "b"), quiet=True, resume=tmp_path / "b")
    assert left_by(tmp_path / "a") == left_by(tmp_path / "b")


@pytest.mark.slow
def test_files_that_may_not_grow(tmp_path):
    """Any write past 20 kB fails, in whatever file: exit code 3, no traceback, no unfinished file."""
    (tmp_path / "case.yaml").write_text(VORTEX.replace("every: 0.03", "every: 0.01, restart_every: 3"))
    limit = lambda: (signal.signal(signal.SIGXFSZ, signal.SIG_IGN),  # noqa: E731
                     resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)))
    done = subprocess.run([sys.executable, "-m", "isphcli", "run", str(tmp_path / "case.yaml"), "--quiet",
                           "--out", str(tmp_path / "out")], capture_output=True, text=True, preexec_fn=limit)
    assert done.returncode == 3 and os.strerror(errno.EFBIG) in done.stderr and "Traceback" not in done.stderr
    assert not list((tmp_path / "out").rglob(".isph-*"))
