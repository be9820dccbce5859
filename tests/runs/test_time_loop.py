"""Step sizes of the time loop, and when snapshots are due."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.flow.step_lengths import FIRST, FIRST_AT_WALLS, GROWTH_AT_WALLS, STEP_GROWTH
from isphcli.output.clock import Clock
from isphcli.references.plates import startup_poiseuille
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

FALL = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1e-3}}
drive: {body_force: [3, 4]}
time: {end: 0.25, cfl: 0.2}
output: {every: 0.1}
"""


def loop_of(text, *sets):
    case = read_case(text.encode(), "case.yaml", sets)
    state, stepper, particles = prepare(case, build_geometry(case), Clock())
    return TimeLoop(case, stepper, particles.site_volume, 1.0), state


def test_no_particle_moves_farther_than_it_may():
    """u dt + a dt^2 / 2 = cfl dx, of the force at rest and of the last step later; the growth of steps is bounded."""
    loop, state = loop_of(FALL)
    first = loop.limits(state)
    assert first == {"start": pytest.approx(FIRST * np.sqrt(2 * 0.2 * 0.1 / 5))}
    moved = replace(state, u=state.u + [1.2, 1.6], u_old=state.u, dt_old=0.4)
    found = loop.limits(moved)
    dt = found["cfl"]
    assert 2 * dt + 5 * dt**2 / 2 == pytest.approx(0.2 * 0.1)
    assert found["start"] == STEP_GROWTH * 0.4 and found["viscous"] == pytest.approx(8 * 0.1**2 / 1e-3)


def test_steps_beside_walls_begin_shorter_and_grow_slower():
    loop, state = loop_of(FALL, "geometry.periodic=[x]", "drive.body_force=[5, 0]")
    assert loop.limits(state)["start"] == pytest.approx(FIRST_AT_WALLS * np.sqrt(2 * 0.2 * 0.1 / 5))
    assert loop.limits(replace(state, dt_old=0.4))["start"] == GROWTH_AT_WALLS * 0.4


def test_a_fixed_step_is_taken_after_a_first_shorter_one():
    loop, state = loop_of(FALL, "time.step=0.01")
    assert loop.limits(state) == {"start": FIRST * 0.01}
    assert loop.limits(replace(state, dt_old=0.01)) == {"step": 0.01, "start": STEP_GROWTH * 0.01}


def test_snapshots_are_written_at_their_times_and_the_run_ends_at_its_own():
    loop, state = loop_of(FALL)
    times, rows = [], []
    end, _ = loop.run(state, loop.stepper.ready(state), lambda s, _: times.append(s.time), rows.append,
                      lambda *_: None)
    assert times == pytest.approx([0.1, 0.2], rel=1e-12) and end.time == pytest.approx(0.25, rel=1e-12)
    assert [row["step"] for row in rows] == list(range(1, end.step + 1))
    assert np.allclose(end.u, [0.75, 1.0], rtol=1e-9)  # free fall
    assert loop.outcome == "finished" and loop.last.state is end


def test_a_run_out_of_steps_says_so():
    loop, state = loop_of(FALL, "time.max_steps=2")
    end, _ = loop.run(state, loop.stepper.ready(state), *[lambda *_: None] * 3)
    assert end.step == 2 and loop.outcome == "out of steps"


@pytest.mark.slow
def test_fluids_one_behind_the_other_start_up_as_one_of_their_mean_density():
    """50 : 1 in density, of one viscosity, in a channel 6 across, at twice the time in which the slowest mode decays by
    e: 1 to 3 % is that of a channel of so few particles. With steps of the viscous limit the flux is 10 % larger: the
    pressure lags behind."""
    text = """
geometry: {box: [12, 6], periodic: [x], fluid: water, shapes: [{box: {lower: [0, 0], upper: [6, 6]}, is: gas}]}
particles: {spacing: 1}
fluids: {water: {density: 1, viscosity: 1}, gas: {density: 0.02, viscosity: 1}}
drive: {pressure_drop: {x: 1.2e-5}}
time: {end: 3.7}
"""
    loop, state = loop_of(text)
    rows = []
    loop.run(state, loop.stepper.ready(state), lambda *_: None, rows.append, lambda *_: None)
    y = (np.arange(600) + 0.5) / 100
    exact = startup_poiseuille(y, rows[-1]["time"], 6.0, 1.0 / 0.51, 1e-6 / 0.51).mean()
    assert rows[-1]["mean_velocity_x"] == pytest.approx(exact, rel=0.05)
    assert "pressure" in {row["limit"] for row in rows}
