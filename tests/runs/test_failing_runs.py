"""What a run that fails or is interrupted leaves behind."""

import os
import signal

import numpy as np
import pytest
from click.testing import CliRunner

from isphcli.case.load import load_case
from isphcli.cli import main
from isphcli.flow.step_limits import RunError
from isphcli.output import folder, restart
from isphcli.output.clock import Clock
from isphcli.output.files import read_history, read_vtu
from isphcli.output.folder import TEMPORARY
from isphcli.output.worst import NAME, WORST
from isphcli.runs import steady
from isphcli.runs.run import run_case
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

# at high Reynolds numbers without shifting: particles line up and clump, and the flow blows up
BLOW_UP = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.05, shifting: 0}
fluids: {water: {density: 1, viscosity: 1.0e-3}}
initial: {velocity: ["sin(2*pi*x)*cos(2*pi*y)", "-cos(2*pi*x)*sin(2*pi*y)"]}
time: {end: 5, cfl: 0.5}
output: {every: 0.05, plots: false}
"""


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_run_that_blows_up_ends_with_all_it_has(tmp_path):
    """Exit code 3; the step, the limit and what to try; the worst particles; a restart file of the last good state; no
    file with NaN or a speed that energy does not allow."""
    (tmp_path / "case.yaml").write_text(BLOW_UP)
    out = tmp_path / "out"
    done = CliRunner().invoke(main, ["run", str(tmp_path / "case.yaml"), "--out", str(out), "--quiet"])
    assert done.exit_code == 3, done.output
    assert "error: step " in done.stderr and "try particles.support=3" in done.stderr
    assert str(out / restart.NAME) in done.stderr and str(out / NAME) in done.stderr
    rows = read_history(out / "history.csv")
    energy = np.array([row["kinetic_energy"] for row in rows])
    assert energy.max() <= 1.5**2 * 0.25
    case = load_case(tmp_path / "case.yaml")
    state, *_ = prepare(case, build_geometry(case), Clock())
    saved = restart.load(out / restart.NAME, state)
    assert saved.state.step == rows[-1]["step"]
    x, worst = read_vtu(out / NAME)
    assert len(x) == WORST and np.all(np.diff(worst["violation"]) <= 0)
    assert np.array_equal(x[:, :2], saved.state.x[worst["particle"]])
    for file in out.glob("snapshots/*.vtu"):
        assert np.abs(read_vtu(file)[1]["velocity"]).max() < 3
    with pytest.raises(RunError, match=f"step {saved.state.step + 1} "):  # and ends in the same step again
        run_case(load_case(out / "case.yaml"), quiet=True, resume=out)


DISK = """
geometry: {box: [1, 1], periodic: [x, y], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.25}, is: solid}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {body_force: [1, 0]}
"""


def test_a_steady_solve_that_does_not_converge(tmp_path):
    """Exit code 3; the system and its residual; the particles of the largest residuals; nothing that looks done."""
    (tmp_path / "case.yaml").write_text(DISK)
    out = tmp_path / "out"
    done = CliRunner().invoke(main, ["run", str(tmp_path / "case.yaml"), "--out", str(out), "--quiet",
                                     "--set", "solver={max_iterations: 2, tolerance: 1.0e-10}"])
    assert done.exit_code == 3 and "the Stokes system did not converge: residual" in done.stderr
    assert f"worst particles: {out / NAME}" in done.stderr and "restart" not in done.stderr
    x, worst = read_vtu(out / NAME)
    assert len(x) == WORST and np.all(np.diff(worst["violation"]) <= 0) and 0 < worst["violation"][0] < 1
    assert np.all(np.hypot(*(x[:, :2] - 0.5).T) > 0.25)
    assert sorted(path.name for path in out.rglob("*") if path.is_file()) == [folder.MANIFEST, NAME]


@pytest.mark.parametrize("at", ["solve_axis", "build_scene"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_steady_solve_that_is_interrupted(tmp_path, monkeypatch, at, number):
    """Exit code 130, one line, no file; a restart file of another run that lies there is not taken for one of this."""
    (tmp_path / "case.yaml").write_text(DISK)
    out = tmp_path / "out"
    out.mkdir()
    (out / restart.NAME).touch()
    real = getattr(steady, at)
    monkeypatch.setattr(steady, at, lambda *a, **b: (os.kill(os.getpid(), number), real(*a, **b))[1])
    before = {which: signal.getsignal(which) for which in (signal.SIGINT, signal.SIGTERM)}
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts jobs in the background without it
        done = CliRunner().invoke(main, ["run", str(tmp_path / "case.yaml"), "--out", str(out), "--quiet"])
    finally:
        for which, handler in before.items():
            signal.signal(which, handler)
    assert done.exit_code == 130 and done.stderr == "interrupted\n" and not done.stdout
    assert [path.name for path in out.rglob("*")] == [restart.NAME]


def test_a_steady_run_that_is_interrupted_as_it_writes(tmp_path, monkeypatch):
    """Files are whole or not there; the run counts as unfinished without its summary."""
    (tmp_path / "case.yaml").write_text(DISK + "output: {plots: false}\n")
    out = tmp_path / "out"
    real, replace_ = os.replace, []

    def stop(*arguments):
        replace_.append(arguments)
        if len(replace_) == 2:
            raise KeyboardInterrupt
        real(*arguments)

    monkeypatch.setattr(os, "replace", stop)
    done = CliRunner().invoke(main, ["run", str(tmp_path / "case.yaml"), "--out", str(out), "--quiet"])
    assert done.exit_code == 130 and done.stderr == "interrupted\n"
    assert not list(out.rglob(f"{TEMPORARY}*")) and not (out / "summary.json").exists()
    for path in out.glob("snapshots/*.vtu"):
        assert np.isfinite(read_vtu(path)[1]["velocity"]).all()
