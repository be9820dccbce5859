"""What errors are, by hand, and the numbers that a reference takes of its case."""

import numpy as np
import pytest

from isphcli.references import errors
from isphcli.references.errors import CompareError
from tests.references.results import lattice, result_of, the_case


def test_errors_of_a_velocity():
    """One particle of two is off by (3, 4) / 10 where the largest speed is 1 and the norm sqrt 2."""
    expected = np.array([[1.0, 0.0], [0.0, 1.0]])
    found = errors.velocity_errors(expected + [[0.3, 0.4], [0, 0]], expected)
    assert found == {"velocity_relative_l2": pytest.approx(0.5 / 2**0.5), "velocity_max": pytest.approx(0.5)}
    with pytest.raises(CompareError, match="at rest"):
        errors.velocity_errors(expected, 0 * expected)


def test_a_pressure_is_known_up_to_a_constant():
    p = np.array([1.0, 2.0, 4.0])
    assert errors.pressure_error(p + 9, p)["pressure_relative_l2"] < 1e-15
    assert errors.pressure_error(3 * p, p)["pressure_relative_l2"] == pytest.approx(2)


def test_values_between_particles_are_exact_for_quadratic_functions():
    case = the_case("taylor_green_2d")
    x, h = lattice(case)
    x = x + np.random.default_rng(0).uniform(-0.2, 0.2, x.shape) * h
    f = lambda x: 1 + x[:, 0] - 2 * x[:, 1] + 3 * x[:, 0] * x[:, 1] - 4 * x[:, 1] ** 2  # noqa: E731
    points = np.array([[0.5, 0.5], [0.31, 0.77], [0.2, 0.8]])
    assert errors.at_points(result_of(case, x), points, f(x)) == pytest.approx(f(points), abs=1e-9)


def test_the_force_of_a_case():
    """A drop of 5e-4 Pa over 1e-3 m of water is 5e-4 m/s2; where a velocity is asked for, the run finds it."""
    case = the_case("startup_poiseuille", "drive={pressure_drop: {x: 5.0e-4}}")
    lower, upper = errors.box_of(case)
    assert errors.given_force(case, upper - lower)[0] == pytest.approx(5e-4 / 1000 / (upper - lower)[0])
    assert errors.flow_axis(case) == "x"
    held = the_case("slit", "drive={axes: [x]}")
    assert errors.given_force(held, upper - lower) is None
    with pytest.raises(CompareError, match=r"needs reference\.parameters\.acceleration"):
        errors.acceleration_along_x(held)
    with pytest.raises(CompareError, match="no axis of flow"):
        errors.flow_axis(the_case("taylor_green_2d"))
