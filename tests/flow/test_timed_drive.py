"""Forces and walls that change with time: the largest so far, steps that follow them, and flows that are known."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.flow.state import Handover
from isphcli.flow.step_limits import StepError
from isphcli.flow.timed_drive import DEVIATION, SHORTEST, TimedDrive
from isphcli.references.plates import oscillating_wall
from tests.flow.runs import run
from tests.flow.steps import scene

FALL = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.2}
fluids: {water: {density: 4, viscosity: 1}}
drive: {DRIVE}
time: {end: 2}
"""


def drive(force, walls=None):
    """Of a force along x and, of one wall, a velocity along x, functions of times (m,)."""
    along = lambda f, t: np.stack([f(t), 0.0 * t], axis=-1)  # noqa: E731
    return TimedDrive(lambda t: (along(force, t), np.zeros((len(t), 2))), lambda t: np.abs(force(t)),
                      None if walls is None else lambda t: along(walls, t)[:, None])


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("omega", [0.01, 3.0, 1e5])
def test_a_sine_is_followed_in_steps_of_a_part_of_a_radian(omega, scale):
    """The chord of a step h is h^2 / 8 off at a crest: sqrt(8 DEVIATION) is allowed there. Over a zero it is
    h^3 / (18 sqrt 3) off: three times as much. By 0.95 a trial less."""
    wave = drive(lambda t: scale * np.sin(omega * t))
    steps = np.array([omega * wave.limit(t / omega, 100 / omega) for t in np.linspace(7, 7 + 2 * np.pi, 40)])
    assert 0.8 * np.sqrt(8 * DEVIATION) < steps.min() < 1.05 * np.sqrt(8 * DEVIATION)
    assert steps.max() < 1.05 * (18 * np.sqrt(3) * DEVIATION) ** (1 / 3)


def test_what_is_linear_bounds_no_step():
    assert drive(lambda t: 3.0 * t).limit(0.0, 7.0) == 7.0
    assert drive(lambda t: 0 * t, lambda t: 1 - t).limit(5.0, 7.0) == 7.0
    assert drive(lambda t: 0 * t).limit(0.0, 7.0) == 7.0  # rest


def test_a_step_does_not_know_when_the_run_ends():
    """But for the shortest one: without viscosity and motion other limits say nothing, 1e9 s here."""
    wave = drive(lambda t: np.sin(t))
    assert wave.limit(1.0, 10.0, 0.3) == wave.limit(1.0, 10.0, 1e6) == wave.limit(1.0, 10.0)
    assert wave.limit(0.0, 1e9, 2.0) < 0.2


def test_no_step_goes_where_a_force_has_no_value():
    def force(t):
        if (t > 1.0).any():
            raise ValueError("no value")
        return 3.0 * t

    assert 0.0 < drive(force).limit(0.7, 100.0, 0.3) <= 0.3


def test_a_wall_bounds_the_step_as_a_force_does():
    force, wall = drive(lambda t: np.sin(t)), drive(lambda t: 0 * t, lambda t: 1e-3 * np.sin(t))
    assert wall.limit(1.0, 10.0) == pytest.approx(force.limit(1.0, 10.0), rel=1e-12)


def test_a_jump_is_met_with_the_shortest_steps_and_no_shorter():
    jump = drive(lambda t: np.where(t < 1.0, 0.0, 1.0))
    assert SHORTEST * 10.0 < jump.limit(0.9, 10.0) <= 0.1  # up to the jump, not over it
    assert jump.limit(1.0 - 1e-9, 10.0) == SHORTEST * 10.0
    assert jump.limit(1.0, 10.0) == 10.0


def test_small_waves_on_a_large_force_are_judged_by_the_largest_so_far():
    """After a burst of 1000 a wave of 0.1 is a part of 1e-4 of it, less than DEVIATION: it bounds no step."""
    burst = drive(lambda t: np.where(t < 1.0, 1000.0, 0.1 * np.sin(50 * t)))
    assert burst.limit(2.0, 10.0) == 10.0
    assert drive(lambda t: 0.1 * np.sin(50 * t)).limit(2.0, 10.0) < 0.01


def test_the_largest_force_is_that_so_far():
    """Within 1000 looks over the time that has passed: a crest of a sine is met within (pi / 1000)^2 of it."""
    wave = drive(lambda t: np.sin(t))
    assert wave.largest_force(0.0) == 0 and wave.largest_force(0.5) == pytest.approx(np.sin(0.5))
    assert wave.largest_force(3.0) == pytest.approx(1.0, rel=1e-5) == wave.largest_force(100.0)


@pytest.mark.parametrize("given", ['body_force: ["sin(5*t)", 0]', 'pressure_drop: {x: "4*sin(5*t)"}'])
def test_fluid_that_falls_to_and_fro(given):
    """u = (1 - cos 5t) / 5 of free fall; a drop over the density times a box of 1 is the same. The force is zero at
    the start: the energy guard of a step has to know what it has become. BDF2, steps of 0.05 to 0.16 of a radian: 1e-3.
    """
    state, _, stepper, rows = run(FALL.replace("DRIVE", given))
    assert np.abs(state.u[:, 0] - (1 - np.cos(10.0)) / 5).max() < 2e-3 * 0.4
    assert np.abs(state.u[:, 1]).max() < 1e-12
    mean = np.array([[row["time"], row["mean_velocity_x"]] for row in rows]).T
    assert np.abs(mean[1] - (1 - np.cos(5 * mean[0])) / 5).max() < 2e-3 * 0.4
    assert stepper.bounds.force == 0 and stepper.bounds.largest_force(2.0) == pytest.approx(1, rel=1e-4)
    assert {"drive", "start"} <= {row["limit"] for row in rows}


def test_without_the_largest_force_so_far_the_guard_would_stop_it():
    """By the force of the start, zero, fluid at rest may not move at all."""
    stepper, state, config = scene(FALL.replace("DRIVE", 'body_force: ["sin(5*t)", 0]'))
    found = stepper.advance(state, Handover(config), 0.01)
    stepper.bounds.check(state, found)
    with pytest.raises(StepError, match="mean speed"):
        replace(stepper.bounds, largest_force=None).check(state, found)


WALL = """
geometry: {box: [0.25, HEIGHT], periodic: [x], GEOMETRY}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}}
time: {end: 0.7539822}
"""
FACE = 'walls: {y_max: {velocity: ["2*cos(25*t)", 0]}}'
SHAPE = 'shapes: [{half_space: {point: [0, 1], normal: [0, -1]}, is: solid, velocity: ["2*cos(25*t)", 0]}]'


@pytest.mark.slow
@pytest.mark.parametrize(("geometry", "height"), [(FACE, "1"), (SHAPE, "1.25")])
def test_fluid_under_a_wall_that_moves_to_and_fro(geometry, height):
    """Stokes' layer in a channel of 16 across, Womersley number 5, after three periods: what is left of the start is
    exp(-pi^2 t) = 6e-4. Within 1 % of the speed of the wall, in the profile at the end and in its mean over the
    last third."""
    state, _, stepper, rows = run(WALL.replace("GEOMETRY", geometry).replace("HEIGHT", height))
    exact = oscillating_wall(state.x[:, 1], state.time, 1.0, 1.0, 2.0, 25.0)
    assert np.abs(state.u[:, 0] - exact).max() < 0.01 * 2 and np.abs(state.u[:, 1]).max() < 1e-4
    assert stepper.bounds.other == pytest.approx(2.0, rel=1e-5)
    late = [row for row in rows if row["time"] > 0.5]
    y = (np.arange(16) + 0.5) / 16
    expected = [oscillating_wall(y, row["time"], 1.0, 1.0, 2.0, 25.0).mean() for row in late]
    assert len(late) > 50 and np.abs(np.array([row["mean_velocity_x"] for row in late]) - expected).max() < 0.01 * 2


@pytest.mark.parametrize(("drop", "expected"), [("0.5*sin(t)", 0.1 * (1 - np.cos(0.4))), ("0.5", 0.04)])
def test_two_fluids_take_a_pressure_drop_by_their_densities(drop, expected):
    """Layers without walls between them and no viscosity to speak of: the light one is pushed ten times as fast, which
    the energy guard knows (by the force on the first fluid it stopped this flow, of a constant drop too)."""
    text = """
geometry: {box: [0.5, 1], periodic: [x, y], shapes: [{box: {lower: [-1, 0.5], upper: [2, 1]}, is: oil}]}
particles: {spacing: 0.125}
fluids: {water: {density: 10, viscosity: 1e-9}, oil: {density: 1, viscosity: 1e-9}}
drive: {pressure_drop: {x: "DROP"}}
time: {end: 0.4}
"""
    state, _, _, _ = run(text.replace("DROP", drop))
    middle = np.abs(state.x[:, 1] - 0.25) < 0.1
    assert np.allclose(state.u[middle, 0], expected, rtol=5e-3)
    assert np.allclose(state.u[np.abs(state.x[:, 1] - 0.75) < 0.1, 0], 10 * expected, rtol=5e-3)
