"""Steps that go wrong: the limits, the order of the tries, and what a run that ends leaves behind."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from isphcli.case.load import load_case, read_case
from isphcli.cli import main
from isphcli.flow import step as step_module
from isphcli.flow.attempt import attempt
from isphcli.flow.step_limits import Bounds, RunError, StepError
from isphcli.output import folder, restart
from isphcli.output.clock import Clock
from isphcli.output.files import read_history, read_vtu
from isphcli.output.folder import TEMPORARY
from isphcli.output.worst import NAME, WORST, write_worst
from isphcli.run import steady
from isphcli.run.run import run_case
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare
from isphcli.solvers import kept_hierarchies
from isphcli.solvers.krylov import SolveError

VORTEX = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.1, jitter: 0.1}
fluids: {water: {density: 1, viscosity: 0.1}}
initial: {velocity: ["sin(2*pi*x)*cos(2*pi*y)", "-cos(2*pi*x)*sin(2*pi*y)"]}
time: {end: 0.1}
"""
# at high Reynolds numbers without shifting: particles line up and clump, and the flow blows up
BLOW_UP = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.05, shifting: 0}
fluids: {water: {density: 1, viscosity: 1.0e-3}}
initial: {velocity: ["sin(2*pi*x)*cos(2*pi*y)", "-cos(2*pi*x)*sin(2*pi*y)"]}
time: {end: 5, cfl: 0.5}
output: {every: 0.05, plots: false}
"""


def scene(text):
    """(stepper, state, configuration) of a case at its start."""
    case = read_case(text.encode(), "case.yaml")
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    return stepper, state, stepper.configure(state.x)


@pytest.fixture
def step():
    """A good step: (bounds, state before it, its result)."""
    stepper, state, config = scene(VORTEX)
    return stepper.bounds, state, stepper.advance(state, config, 0.01)


def test_a_good_step_keeps_all_limits(step):
    bounds, before, found = step
    bounds.check(before, found)


@pytest.mark.parametrize("name", ["x", "u", "p"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_found(step, name, value):
    bounds, before, found = step
    values = getattr(found.state, name).copy()
    values[7] = value
    found = replace(found, state=replace(found.state, **{name: values}))
    with pytest.raises(StepError, match="1 particles is no longer a number") as caught:
        bounds.check(before, found)
    assert np.flatnonzero(caught.value.violation).tolist() == [7]


def test_speed_from_nowhere_is_found(step):
    """Twice the speed without a force; the same speed where a force explains it."""
    bounds, before, found = step
    found = replace(found, state=replace(found.state, u=2 * found.state.u))
    with pytest.raises(StepError, match="the mean speed"):
        bounds.check(before, found)
    replace(bounds, force=1.0 / 0.01).check(before, found)


def test_speed_that_grows_slowly_is_found(step):
    """1 % a step passes from step to step, but not since the start."""
    bounds, _, found = step
    with pytest.raises(StepError, match="of the start"):
        for _ in range(100):
            before = found.state
            found = replace(found, state=replace(before, u=1.01 * before.u, time=before.time + 0.01))
            bounds.check(before, found)
    assert 1.3 < bounds.speed(found.state.u) / bounds.start < 1.6


def test_a_mean_speed_does_not_leave_the_range_of_numbers():
    bounds = Bounds(None, 1.0, 1.0, 0.0, 0.0, 0.0)
    for scale in (0.0, 1e-300, 1.0, 1e300):
        assert bounds.speed(np.full((5, 2), scale)) == pytest.approx(np.sqrt(2) * scale)


def test_divergence_and_volumes_are_bounded(step):
    bounds, before, found = step
    with pytest.raises(StepError, match=r"change its volume by 0\.6"):
        bounds.check(before, replace(found, divergence=np.full(100, 60.0)))
    volume = found.config.ops.volume.copy()
    volume[3] *= 0.2
    config = replace(found.config, ops=replace(found.config.ops, volume=volume))
    with pytest.raises(StepError, match="clump") as caught:
        bounds.check(before, replace(found, config=config))
    assert np.argmax(caught.value.violation) == 3


def test_particles_in_a_wall_are_found():
    stepper, state, config = scene(VORTEX.replace("periodic: [x, y]", "periodic: [x]"))
    found = stepper.advance(state, config, 1e-4)
    found.state.x[5, 1] = -0.01
    with pytest.raises(StepError, match="1 particles are in a wall"):
        stepper.bounds.check(state, found)


def tries(monkeypatch, stepper, failing):
    """Lets the first `failing` solves miss their tolerance; a list of (restart, new hierarchies so far) a solve."""
    real, build, seen, built = kept_hierarchies.gmres, kept_hierarchies.hierarchy, [], []

    def gmres(apply, rhs, precondition, tolerance, restart, *rest, **more):
        seen.append((restart, len(built)))
        solution, report = real(apply, rhs, precondition, tolerance, restart, *rest, **more)
        return solution, replace(report, reason="out of iterations") if len(seen) <= failing else report

    monkeypatch.setattr(kept_hierarchies, "gmres", gmres)
    monkeypatch.setattr(kept_hierarchies, "hierarchy", lambda matrix: built.append(1) or build(matrix))
    return seen


def guessed(terms, nu_max, spacing, rate, right, guess, solvers):
    """In place of `viscous_solve`: the velocity of the step before."""
    return guess


def test_the_order_of_tries(monkeypatch):
    """A pressure solve that misses its tolerance: the kept hierarchy, a new one, more of a new one, half the step."""
    stepper, state, config = scene(VORTEX + "solver: {restart: 40}\n")
    found = attempt(stepper, state, config, 1e-3)
    state, config = found.state, found.config
    assert set(stepper.solvers._levels) == {"pressure"}
    monkeypatch.setattr(step_module, "viscous_solve", guessed)  # leave only the pressure solves
    seen = tries(monkeypatch, stepper, 0)
    attempt(stepper, state, config, 1e-3)
    assert seen == [(40, 0)]
    for failing, expected, length in ((1, [(40, 0), (40, 1)], 1e-3),
                                      (2, [(40, 0), (40, 1), (80, 2)], 1e-3),
                                      (3, [(40, 0), (40, 1), (80, 2), (40, 3)], 0.5e-3)):
        monkeypatch.undo()
        stepper.solvers.drop()
        stepper.advance(state, config, 1e-3)
        monkeypatch.setattr(step_module, "viscous_solve", guessed)
        seen = tries(monkeypatch, stepper, failing)
        assert attempt(stepper, state, config, 1e-3).dt == length
        assert seen == expected


def test_a_system_solved_with_its_diagonal_gets_a_hierarchy(monkeypatch):
    stepper, state, config = scene(VORTEX)
    seen = tries(monkeypatch, stepper, 1)
    stepper.advance(state, config, 1e-4)
    assert seen[:2] == [(100, 0), (100, 1)] and "velocity" in stepper.solvers


def test_a_solve_that_cannot_be_cured_names_its_system(monkeypatch):
    stepper, state, config = scene(VORTEX)
    tries(monkeypatch, stepper, 10**9)
    with pytest.raises(RunError, match=r"step 1 at time 0: the velocity system.*residual.*4 halvings.*") as caught:
        attempt(stepper, state, config, 1e-3)
    assert isinstance(caught.value.__cause__, SolveError) and caught.value.violation.shape == (100,)


def test_a_step_without_length_ends_the_run():
    stepper, state, config = scene(VORTEX)
    with pytest.raises(RunError, match="lost in the digits of the time"):
        attempt(stepper, replace(state, time=1.0), config, 1e-17)


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


def test_worst_particles_without_a_number_are_written(tmp_path):
    """A residual that is not finite is the worst of all."""
    path = write_worst(tmp_path / "worst.vtu", np.arange(6.0).reshape(3, 2), np.array([1, np.nan, -np.inf]))
    found = read_vtu(path)[1]
    assert found["particle"].tolist() == [1, 2, 0] and np.isfinite(found["violation"]).all()


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
