"""The drive of a case: its acceleration, axes and words, and why nothing flows."""

import numpy as np
import pytest

from isphcli.case import forcing
from isphcli.case.load import read_case
from isphcli.scene.build_geometry import build_geometry

BOX = """
geometry: {box: [2, 1, 4], periodic: [x, y, z]}
particles: {spacing: 0.25}
fluids: {water: {density: 8, viscosity: 1}, oil: {density: 2, viscosity: 1}}
flow: navier_stokes
time: {end: 1}
"""


def the_case(drive, *sets):
    return read_case((BOX + drive).encode(), "case.yaml", sets)


def test_a_pressure_drop_is_a_force_over_density_and_length():
    """16 Pa over 2 m are 8 Pa/m: 1 m/s2 of the first fluid, 4 of the second; the body force is that of both."""
    case = the_case("drive: {pressure_drop: {x: 16}, body_force: [0, 0, -3]}")
    lengths = np.array([2.0, 1.0, 4.0])
    assert forcing.acceleration(case, lengths).tolist() == [1, 0, -3]
    assert forcing.body_force(case, 3).tolist() == [0, 0, -3]
    assert forcing.pressure_gradient(case, lengths).tolist() == [8, 0, 0]
    ((axis, force),) = forcing.drives(case, build_geometry(case))
    assert axis == 2 and force.tolist() == [1, 0, -3]
    assert forcing.driven_axes(case, lengths) == [2, 0]


def test_the_strongest_acceleration_is_that_of_the_light_fluid():
    """8 Pa/m are 1 m/s2 of density 8 and 4 of density 2; beside a body force of 3 against it 2 and 1."""
    lengths = np.array([2.0, 1.0, 4.0])
    case = the_case("drive: {pressure_drop: {x: 16}}")
    assert forcing.strongest_acceleration(case, lengths) == 4
    case = the_case('drive: {pressure_drop: {x: "16*t"}, body_force: [-3, 0, 0]}')
    assert forcing.strongest_acceleration(case, lengths, np.array([0.0, 1.0, 2.0])).tolist() == [3, 2, 5]


def test_without_a_drive_nothing_pushes():
    case = the_case("")
    assert not forcing.is_driven(case) and forcing.force_is_given(case)
    assert not forcing.acceleration(case, np.ones(3)).any()
    assert forcing.flow_axis(case) is None and forcing.driven_axes(case, np.ones(3)) == []
    assert forcing.drives(case, build_geometry(case))[0][0] is None
    assert forcing.in_words(case) == "no drive"


def test_a_velocity_that_is_held_leaves_the_force_to_the_run():
    case = the_case("drive: {superficial_velocity: {y: -0.5}}")
    assert forcing.held_flux(case) == (1, -0.5) and forcing.held_axis(case) == 1
    assert not forcing.force_is_given(case) and forcing.flow_axis(case) == 1
    assert forcing.in_words(case) == "a velocity is held by a pressure drop"
    both = the_case("drive: {superficial_velocity: {y: -0.5}, body_force: [0, 0, -9.81]}")
    assert forcing.in_words(both) == "a velocity is held by a pressure drop and body force"
    assert forcing.body_force(both, 3)[2] == -9.81


def test_axes_are_a_flow_each_unless_walls_move():
    steady = ("flow=stokes", "time=null", "fluids={water: {density: 1, viscosity: 1}}")
    case = the_case("drive: {axes: [z, x]}", *steady)
    assert forcing.steady_axes(case) == [2, 0] == forcing.driven_axes(case, np.ones(3))
    found = forcing.drives(case, build_geometry(case))
    assert [axis for axis, _ in found] == [2, 0] and [f.tolist() for _, f in found] == [[0, 0, 1], [1, 0, 0]]
    moving = the_case("drive: {axes: [z, x]}", *steady, "geometry.periodic=[x, z]",
                      "geometry.walls={y_max: {velocity: [1, 0, 0]}}")
    assert forcing.walls_move(moving)
    ((axis, force),) = forcing.drives(moving, build_geometry(moving))
    assert axis is None and force.tolist() == [0, 0, 1]


TIMED = "drive: {pressure_drop: {x: \"16*cos(t)\"}, body_force: [0, \"t - 2\", -3]}"


def test_formulas_have_the_values_of_a_time():
    """One time or many; 16 Pa over 2 m of density 8 are 1 m/s2."""
    case, lengths = the_case(TIMED), np.array([2.0, 1.0, 4.0])
    assert forcing.changes(case) and not forcing.walls_change(case) and not forcing.force_is_given(case)
    assert forcing.acceleration(case, lengths).tolist() == [1, -2, -3]
    assert forcing.acceleration(case, lengths, np.pi) == pytest.approx([-1, np.pi - 2, -3])
    many = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])
    found = forcing.acceleration(case, lengths, many)
    assert found.shape == (2, 3, 3) and np.array_equal(found[1, 2], forcing.acceleration(case, lengths, 5.0))
    assert forcing.pressure_gradient(case, lengths, many)[..., 0] == pytest.approx(8 * np.cos(many))
    assert forcing.in_words(case) == "a pressure drop and body force that changes with time"


def test_the_largest_force_of_a_run_is_looked_for_up_to_its_end():
    """At t = 0 the formula is zero; the axis of the drive is that of its largest component."""
    case = the_case("drive: {body_force: [\"5*sin(pi*t)\", 2, 0]}", "time.end=0.5")
    assert forcing.largest_acceleration(case, np.ones(3)) == pytest.approx([5, 2, 0], rel=1e-5)
    assert forcing.flow_axis(case) == 0 and forcing.driven_axes(case, np.ones(3)) == [0, 1]
    early = the_case("drive: {body_force: [\"5*sin(pi*t)\", 2, 0]}", "time.end=0.1")
    assert forcing.flow_axis(early) == 1  # 5 sin(0.1 pi) is 1.5


def test_what_repeats_is_not_looked_at_in_one_phase():
    """A period of a run over the number of looks: equal intervals would see zeros alone."""
    case = the_case("", "time.end=7")
    times = forcing.sample_times(case)
    assert times[0] == 0 and times[-1] == 7 and (np.diff(times) > 0).all()
    assert np.abs(np.sin(np.pi * times / 7 * forcing.SAMPLES)).max() > 0.99


def test_walls_have_the_velocities_of_a_time():
    """Numbered as in a geometry: face y_max is 4, the first shape in 3D is 7."""
    body = "box: {lower: [0, 0, 0], upper: [1, 1, 1]}"
    case = the_case("", "geometry.periodic=[x, z]", 'geometry.walls={y_max: {velocity: ["3*sin(t)", 0, 1]}}',
                    f"geometry.shapes=[{{{body}, is: solid, velocity: [0, 0, 5]}}]")
    assert forcing.walls_change(case) and forcing.changes(case) and forcing.walls_move(case)
    found = forcing.wall_velocities(case, 3, np.pi / 2)
    assert found.keys() == {4, 7} and found[4] == pytest.approx([3, 0, 1]) and found[7].tolist() == [0, 0, 5]
    geometry = build_geometry(case)
    assert geometry.wall_velocity[4].tolist() == [0, 0, 1]  # of the start
    assert geometry.wall_speed[4] == pytest.approx(np.hypot(3 * np.sin(1), 1), rel=1e-6)  # up to the end, 1 s
    assert geometry.wall_speed[7] == 5


@pytest.mark.parametrize(("shape", "moves"), [("velocity: [0, 0, 0]", False), ("velocity: [1, 0, 0]", True),
                                              ("angular_velocity: -2", True), ("angular_velocity: 0", False)])
def test_walls_move_where_one_has_a_velocity_or_turns(shape, moves):
    body = "cylinder: {axis: z, radius: 0.2, centre: [1, 0.5, 0]}"
    assert forcing.walls_move(the_case("", f"geometry.shapes=[{{{body}, is: solid, {shape}}}]")) == moves


def test_why_nothing_flows_names_the_axes_and_what_to_do():
    case = the_case("drive: {body_force: [1, 0, 0]}", "geometry.periodic=[x]")
    assert forcing.opens(case, 0) and not forcing.opens(case, 2)
    assert "along y and z: both faces are walls; add y and z to geometry.periodic" in forcing.why_closed(case, 1, 2)
    assert "no fluid path leads through the scene along x" in forcing.why_closed(case, 0)


def test_steps_are_a_drive_along_the_axis_of_the_reservoirs():
    """Their force is up to the run, and the largest one, -16 Pa over 4 m and 8 or 2 kg/m3, bounds what it may do."""
    sets = ["reservoirs={axis: z, inlet: oil, outlet: water, length: 1}"]
    case = the_case("drive: {steps: {pressure_drop: [8, -16], duration: 3}}", *sets, "time={}")
    lengths = np.array([2.0, 1.0, 4.0])
    assert forcing.flow_axis(case) == forcing.gradient_axis(case) == 2 and forcing.driven_axes(case, lengths) == [2]
    assert forcing.longest_time(case) == 6.0 and forcing.held_flux(case) is None and not forcing.force_is_given(case)
    assert forcing.strongest_acceleration(case, lengths) == 2.0
    assert forcing.largest_acceleration(case, lengths).tolist() == [0, 0, -0.5]
    assert not forcing.acceleration(case, lengths).any() and forcing.in_words(case).startswith("a drive in steps")
    flux = the_case("drive: {steps: {superficial_velocity: [3, 4], duration: 3}}", *sets, "time={end: 5}")
    assert forcing.held_flux(flux) == (2, 3.0) and forcing.longest_time(flux) == 5.0
    still = the_case("", *sets)
    assert forcing.flow_axis(still) == 2 and forcing.gradient_axis(still) is None
