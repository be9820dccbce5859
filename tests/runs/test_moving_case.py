"""A case of moving particles from its text to its files: what it leaves, and that it goes on where it was."""

import json
import sys

import numpy as np
import pytest

from isphcli.case import expressions
from isphcli.case.load import read_case
from isphcli.domain.lattice import ParticleError
from isphcli.output import progress
from isphcli.output.files import read_history, read_pvd, read_vtu
from isphcli.runs.run import run_case

CHANNEL = """
title: a channel
geometry: {box: [0.5, 1], periodic: [x]}
particles: {spacing: 0.125}
fluids: {water: {density: 1000, viscosity: 1000}}
drive: {body_force: [2, 0]}
time: {end: 0.1, step: 0.01}
output: {every: 0.05, plots: false, restart_every: 5}
"""


def run(text, directory, *sets, **more):
    case = read_case(text.encode(), "case.yaml", (f"output.directory={directory}", *sets))
    return run_case(case, quiet=True, **more)


def test_the_summary_and_the_files_tell_of_one_flow(tmp_path):
    summary = run(CHANNEL, tmp_path / "out")
    written = json.loads((tmp_path / "out" / "summary.json").read_text())
    history = read_history(tmp_path / "out" / "history.csv")
    assert written["status"] == "finished" and written["steps"] == len(history) == history[-1]["step"]
    assert written["time"] == pytest.approx(0.1) and written["terms"][:3] == ["viscosity", "pressure", "body force"]
    assert written["permeability"] is None  # not asked to be steady
    assert written["open_axes"] is None  # without a check, as on several processes, none are known
    entries = read_pvd(tmp_path / "out" / "particles.pvd")
    assert [time for time, _ in entries] == pytest.approx([0, 0.05, 0.1])
    x, fields = read_vtu(tmp_path / "out" / entries[-1][1])
    assert fields["velocity"][:, 0].mean() == pytest.approx(summary["mean_velocity"][0], rel=1e-12)
    assert history[-1]["mean_velocity_x"] == pytest.approx(written["mean_velocity"][0], rel=1e-8)  # nine digits
    assert np.abs(fields["pressure"]).max() < 1e-5 * 1000 * 2 * 1 and len(x) == 32  # of rho g H: shear has none


@pytest.mark.parametrize("sets", [
    ("drive={superficial_velocity: {x: 0.1}}",),
    ("time={steady: 0.1, max_steps: 5}",),
])
def test_a_flow_that_finds_no_way_is_refused_before_anything_is_written(tmp_path, sets):
    """A slab across the channel: a velocity that is held, and a steady flow, need a way through."""
    slab = "geometry.shapes=[{box: {lower: [0.1, -1], upper: [0.4, 2]}, is: solid}]"
    with pytest.raises(ParticleError, match="no fluid path leads through the scene along x"):
        run(CHANNEL, tmp_path / "out", slab, *sets)
    assert not list((tmp_path / "out").glob("*"))


def test_a_run_goes_on_in_its_own_folder_as_if_it_had_not_stopped(tmp_path):
    run(CHANNEL, tmp_path / "whole")
    run(CHANNEL, tmp_path / "parts", "time.end=0.05")
    run(CHANNEL, tmp_path / "parts", resume=tmp_path / "parts")
    one, other = ((tmp_path / name / "history.csv").read_bytes() for name in ("whole", "parts"))
    assert one == other
    assert [t for t, _ in read_pvd(tmp_path / "parts" / "particles.pvd")] == pytest.approx([0, 0.05, 0.1])


@pytest.mark.slow
@pytest.mark.parametrize("drive", [
    'drive.body_force=["2*cos(30*t)", 0]',
    'geometry.walls={y_max: {velocity: ["sin(30*t)", 0]}}',
])
def test_a_drive_that_changes_with_time_goes_on_with_the_same_bits(tmp_path, drive):
    """Steps chosen by the drive itself, and another end in the first part: nothing depends on when the run will end."""
    sets = ("time={end: 0.1}", "time.cfl=1", drive)
    run(CHANNEL, tmp_path / "whole", *sets)
    run(CHANNEL, tmp_path / "parts", *sets, "time.end=0.05")
    run(CHANNEL, tmp_path / "parts", *sets, resume=tmp_path / "parts")
    whole, parts = (read_history(tmp_path / name / "history.csv") for name in ("whole", "parts"))
    assert whole == parts and "drive" in {row["limit"] for row in whole}
    summary = json.loads((tmp_path / "parts" / "summary.json").read_text())
    assert "drive that changes with time" in summary["terms"]


def test_without_formulas_nothing_of_a_drive_in_time_is_there(tmp_path, monkeypatch):
    """No formula is evaluated and its file is not imported."""
    monkeypatch.setattr(expressions, "evaluate", None)  # it could not be called
    monkeypatch.delitem(sys.modules, "isphcli.flow.timed_drive", raising=False)
    run(CHANNEL, tmp_path / "out", "time.end=0.02", "geometry.walls={y_max: {velocity: [1, 0]}}")
    assert "isphcli.flow.timed_drive" not in sys.modules


def test_a_run_that_goes_on_elsewhere_begins_its_files_anew(tmp_path):
    run(CHANNEL, tmp_path / "one", "time.end=0.05")
    summary = run(CHANNEL, tmp_path / "two", resume=tmp_path / "one")
    rows = read_history(tmp_path / "two" / "history.csv")
    assert rows[0]["time"] > 0.05 and rows[-1]["step"] == summary["steps"]
    assert any("time.end" in str(change) for change in summary["restarts"])


def test_a_held_velocity_has_a_pressure_drop_and_no_force(tmp_path):
    """The flux is what was asked at the end of every step, and Darcy's law of a flow that is not steady is not told."""
    held = run(CHANNEL, tmp_path / "held", "time.end=0.03", "drive={superficial_velocity: {x: 0.1}}")
    assert held["superficial_velocity"][0] == pytest.approx(0.1, rel=1e-6)
    rows = read_history(tmp_path / "held" / "history.csv")
    assert held["pressure_drop"] == pytest.approx(rows[-1]["pressure_drop_x"], rel=1e-8) and held["pressure_drop"] > 0
    assert "held velocity" in held["terms"] and "body force" not in held["terms"]
    assert held["permeability"] is None


def test_a_run_to_a_steady_state_tells_no_time_left(tmp_path, monkeypatch):
    """Its end is not known: `max_steps` and `end` only bound it. What is said is how far from steady it is."""
    shown = []
    update = progress.Progress.update

    def watched(self, *args, **kwargs):
        update(self, *args, **kwargs)
        shown.append((self.total_time, self.total_steps, self._line))

    monkeypatch.setattr(progress.Progress, "update", watched)
    case = read_case(CHANNEL.encode(), "case.yaml", (
        f"output.directory={tmp_path / 'out'}", "time={steady: 0.5, end: 9, step: 0.01, max_steps: 30}"))
    run_case(case, quiet=False)
    assert {(total, steps) for total, steps, _ in shown} == {(None, None)}
    assert not any("%" in line or "left" in line for *_, line in shown)
