"""What is said of a run, from its summary."""

from isphcli.output.lines import between, digits_within, measure_lines, permeability_lines, table, velocity_lines


def test_digits_go_as_far_as_the_error_bar_says():
    assert digits_within(1.2345e-12, 2e-14) == 3 and digits_within(1.2345e-12, 2e-13) == 2
    assert digits_within(1.0, None) == 3
    lines = permeability_lines({"permeability": {"x": 1.2345e-12}, "permeability_error": {"x": 2e-13}})
    assert lines[0] == ("permeability x", "1.2e-12 m2 = 1300 mD")


def test_measures_that_are_there():
    lines = dict(measure_lines({"tortuosity": {"x": 1.25, "y": None}, "formation_factor": 12.0,
                                "wall_shear": {"mean": 0.5, "median": 0.4, "q95": 1.5}}))
    assert list(lines) == ["tortuosity x", "formation factor", "wall shear"]
    assert lines["wall shear"] == "mean 0.5 Pa, 95 % below 1.5 Pa" and lines["formation factor"].startswith("12 ")
    assert measure_lines({}) == []


def test_velocities_of_a_part_of_the_box_say_so():
    """history.csv has those of the whole box under the same names."""
    summary = {"mean_velocity": [0.5, 0.0], "superficial_velocity": [0.25, 0.0]}
    assert velocity_lines(summary)[0] == ("mean pore velocity", "x 0.5, y 0 m/s")
    assert velocity_lines(summary, True)[1] == ("superficial velocity", "x 0.25, y 0 m/s in the sample")


def test_two_columns():
    assert table([("a", "1"), ("long", "2")]) == "a     1\nlong  2"


def test_the_ends_of_a_range_show_its_width():
    """Also where it is narrower than the digits of a permeability alone."""
    assert between(2.1e-12, 2.64e-12) == "2.10e-12 to 2.64e-12 m2"
    assert between(2.3012e-9, 2.3034e-9) == "2.3012e-09 to 2.3034e-09 m2"
    assert between(2.3e-9, 2.3e-9 * (1 + 1e-9)) == "2.30000e-09 m2, to 6 digits"
