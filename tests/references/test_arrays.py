"""Arrays of spheres and cylinders a second way: another formula, the equation it solves, a table, or a limit."""

import math

import numpy as np
import pytest

from isphcli.references import arrays


def hasimoto(c):
    """Sangani and Acrivos (1982), eq. 57: Hasimoto's (1959) dilute expansion, carried on."""
    s = c ** (1 / 3)
    return 1 / (1 - 1.7601 * s + c - 1.5593 * c**2 + 3.9799 * s**8 - 3.0734 * s**10)


@pytest.mark.parametrize("fraction, expected", arrays.ZICK_HOMSY)
def test_sphere_array_is_the_table(fraction, expected):
    rounding = 0.0005 if expected < 10 else 0.05
    drag = arrays.sphere_array_drag(fraction)
    assert abs(drag - expected) < rounding + (2e-4 if fraction < 0.216 else 0)


@pytest.mark.parametrize("fraction", [1e-4, 1e-3, 8e-3, 0.027, 0.064])
def test_sphere_array_when_dilute(fraction):
    assert math.isclose(arrays.sphere_array_drag(fraction), hasimoto(fraction), rel_tol=5e-5)


def test_sphere_array_between_the_entries():
    """The series is still good to about 0.3 % at 0.28; the drag rises; nothing jumps where they meet."""
    chi = (0.28 / (math.pi / 6)) ** (1 / 3)
    assert math.isclose(arrays.sphere_array_drag(0.28), np.polyval(arrays.SANGANI_ACRIVOS[::-1], chi), rel_tol=0.01)
    drag = [arrays.sphere_array_drag(c) for c in np.linspace(0.01, 0.5236, 300)]
    assert (np.diff(drag) > 0).all()
    assert math.isclose(arrays.sphere_array_drag(0.2158), arrays.sphere_array_drag(0.2161), rel_tol=4e-3)
    assert math.isclose(
        arrays.sphere_array_permeability(0.216, 2.0), 4 / (6 * math.pi * 7.442 * 0.37221), rel_tol=1e-4
    )
    for bad in (0.0, 0.6):
        with pytest.raises(ValueError, match="simple cubic"):
            arrays.sphere_array_drag(bad)


@pytest.mark.parametrize(
    "fraction, expected",
    [(0.05, 15.56), (0.1, 24.83), (0.2, 51.53), (0.3, 102.90), (0.4, 217.89), (0.5, 532.55)],
)
def test_cylinder_array_is_the_published_table(fraction, expected):
    """Sangani and Acrivos (1982), table 1; its 102.90 is 0.02 % off its neighbours' pattern."""
    assert math.isclose(arrays.cylinder_array_drag(fraction), expected, rel_tol=4e-4)


def test_cylinder_array_elsewhere():
    assert math.isclose(arrays.cylinder_array_drag(0.2), 51.5269, abs_tol=1e-4)
    assert math.isclose(arrays.cylinder_array_drag(math.pi * 0.2**2), 30.3506, abs_tol=1e-4)
    assert math.isclose(arrays.cylinder_array_permeability(0.2, 3.0), 9 / 51.5269, rel_tol=1e-6)
    for c in (1e-4, 1e-3, 1e-2):  # the dilute expansion of the same paper, eq. 17
        dilute = 4 * math.pi / (-0.5 * math.log(c) - 0.738 + c - 0.887 * c**2 + 2.038 * c**3)
        assert math.isclose(arrays.cylinder_array_drag(c), dilute, rel_tol=2e-4)
    with pytest.raises(ValueError, match=r"up to 0\.5"):
        arrays.cylinder_array_drag(0.6)
