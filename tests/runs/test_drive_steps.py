"""A drive in steps: when one is done, what drives the next, and that a restart goes on within one."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.blocks import DriveSteps
from isphcli.case.load import read_case
from isphcli.flow.held_velocity import Beyond, HeldVelocity
from isphcli.flow.state import State
from isphcli.output.files import read_history
from isphcli.runs.drive_steps import DriveProgram, begun
from isphcli.runs.run import run_case


class Stepper:
    held_velocity = None


def program(steps, saturation=lambda state: 0.5, stepper=None):
    seen = []
    found = DriveProgram(steps, 0, stepper or Stepper(), 4.0, saturation, lambda *end: seen.append(end[:3]))
    return found, seen


def rest():
    one = np.zeros((1, 2))
    return State(one, one, one, np.zeros(1), pressure_gradient=0.0, drive_step=begun(0, 0.0))


def at(state, time):
    return replace(state, time=time)


def test_steps_of_pressure_take_their_duration():
    """The pressure gradient over the density of the first fluid is the drop over its mass per area."""
    steps, seen = program(DriveSteps(pressure_drop=(2.0, -6.0), duration=1.0, window=0.4))
    state = steps.begin(rest())
    assert state.pressure_gradient == 0.5 and steps.drop(state) == 2.0 and steps.due(state) == 0.4
    state = steps.after(at(state, 0.3), None)
    assert steps.due(state) == 0.4
    state = steps.after(at(state, 0.4), None)
    assert steps.due(state) == pytest.approx(0.8) and not seen
    state = steps.after(at(state, 0.8), None)
    assert steps.due(state) == 1.0  # the step ends before the next look
    state = steps.after(at(state, 1.0), None)
    assert seen == [(0, 2.0, False)] and steps.drop(state) == -6.0 and not steps.done(state)
    state = steps.after(at(steps.after(at(state, 1.5), None), 2.0), None)
    assert seen[1:] == [(1, -6.0, False)] and steps.done(state) and steps.drop(state) == -6.0


def test_a_step_ends_when_the_saturation_has_settled_and_not_before_it_was_looked_at_twice():
    levels = iter([0.2, 0.4, 0.405, 0.9])
    steps, seen = program(DriveSteps(pressure_drop=(1.0, 2.0), duration=9.0, window=1.0, settled=0.01),
                          lambda state: next(levels))
    state = steps.begin(rest())
    for time in (1.0, 2.0):
        state = steps.after(at(state, time), None)
        assert not seen
    state = steps.after(at(state, 3.0), None)
    assert seen == [(0, 1.0, True)]
    steps.after(at(state, 4.0), None)
    assert len(seen) == 1  # of the new step nothing was seen before


def test_steps_of_flux_hold_their_velocity():
    stepper = Stepper()
    stepper.held_velocity = HeldVelocity(7.0, Beyond(0, -1.0, 1.0, 0.1, 1.0), 0.5, 4.0)
    steps, _ = program(DriveSteps(superficial_velocity=(0.5, 0.0), duration=1.0), stepper=stepper)
    state = steps.begin(rest())
    assert stepper.held_velocity.wanted == 0.5 and steps.window == pytest.approx(0.1)
    state = steps.after(at(state, 1.0), None)
    assert stepper.held_velocity.wanted == 0.0 and state.pressure_gradient == 0.0


PISTON = """
title: a piston to and fro
geometry: {box: [2, 0.5], periodic: [x, y]}
particles: {spacing: 0.125, shifting: 0}
fluids: {water: {density: 2, viscosity: 0.3}, gas: {density: 1, viscosity: 0.3}}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 0.5}
drive: {steps: {superficial_velocity: [0.25, -0.25, 0], duration: 2}}
time: {step: 0.05}
output: {every: 1, plots: PLOTS, snapshots: false}
"""


def run(directory, *sets, plots=False, **more):
    text = PISTON.replace("PLOTS", str(plots).lower())
    return run_case(read_case(text.encode(), "case.yaml", (f"output.directory={directory}", *sets)), quiet=True, **more)


@pytest.mark.slow
def test_a_piston_goes_to_and_fro_and_leaves_its_curve(tmp_path):
    """Half of the sample is displaced and comes back; a row of the lattice, 1/8, is what a saturation is known to."""
    summary = run(tmp_path, plots=True)
    curve = read_history(tmp_path / "curve.csv")
    assert summary["status"] == "finished" and summary["time"] == pytest.approx(6.0)
    assert [row["time"] for row in curve] == pytest.approx([2, 4, 6], rel=1e-9)
    assert [row["superficial_velocity"] for row in curve] == [0.25, -0.25, 0]
    assert [row["saturation_gas"] for row in curve] == pytest.approx([0.5, 0, 0], abs=0.13)
    assert [row["trapped_water"] for row in curve] == [0, 0, 0] and [row["settled"] for row in curve] == [0, 0, 0]
    assert {"reservoirs", "drive in steps"} <= set(summary["terms"])
    assert (tmp_path / "curve.png").stat().st_size > 0 and (tmp_path / "profiles.png").stat().st_size > 0
    late = [row for row in read_history(tmp_path / "profiles.csv") if row["time"] == pytest.approx(2.0)]
    assert [row["saturation_gas"] for row in late] == pytest.approx([1, 1, 1, 1, 0, 0, 0, 0], abs=0.55)
    assert len(late) == 8 and len(read_history(tmp_path / "profiles.csv")) == 8 * 7  # from 0 to 6 s, each once
    assert late[0]["saturation_gas"] == 1 and late[-1]["saturation_water"] == 1


@pytest.mark.slow
def test_a_restart_goes_on_within_a_step_with_the_same_bits(tmp_path):
    run(tmp_path / "whole")
    run(tmp_path / "parts", "time.max_steps=53")
    run(tmp_path / "parts", resume=tmp_path / "parts")
    for name in ("history.csv", "curve.csv"):  # profiles, like snapshots, have the state of the stop too
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "parts" / name).read_bytes()


@pytest.mark.slow
def test_a_restart_takes_further_steps(tmp_path):
    first = "drive.steps.superficial_velocity=[0.25]"
    run(tmp_path / "whole")
    run(tmp_path / "parts", first)
    assert len(read_history(tmp_path / "parts" / "curve.csv")) == 1
    run(tmp_path / "parts", resume=tmp_path / "parts")
    one, other = (read_history(tmp_path / name / "curve.csv") for name in ("whole", "parts"))
    assert one == other and len(one) == 3


@pytest.mark.slow
def test_the_mean_drop_is_that_under_the_last_drive_of_the_history_that_is_there(tmp_path):
    """Of five steps of a second the last quarter of the last one: from 4.75 s on. A restart at 4.78 s in another folder
    has a history from there on; one at 4.2 s with another flux takes the last quarter of what is left."""
    flux, sets = "drive.steps.superficial_velocity=[-0.25, -0.2, -0.3, -0.4, {}]", ("drive.steps.duration=1",
                                                                                 "time.step=0.025")
    run(tmp_path / "begun", *sets, flux.format(0.5), "time.end=4.2")
    run(tmp_path / "whole", *sets, flux.format(0.5), "time.end=4.78", resume=tmp_path / "begun")
    for folder, before, last, since in (("part", "whole", 0.5, 4.78), ("whole", "whole", 0.5, 4.75),
                                        ("begun", "begun", 0.6, 4.8)):
        summary = run(tmp_path / folder, *sets, flux.format(last), resume=tmp_path / before)
        rows = [row for row in read_history(tmp_path / folder / "history.csv") if row["time"] > since * (1.0 + 1e-9)]
        drops, length = (np.array([row[name] for row in rows]) for name in ("pressure_drop_x", "dt"))
        assert summary["pressure_drop_mean"] == pytest.approx(drops @ length / length.sum(), rel=1e-6)
