"""What a permeability is worth by bodies whose permeability is known."""

import math

import numpy as np
import pytest

from isphcli.runs.expected_error import (
    WALLS,
    Expected,
    Scan,
    calibrations,
    expected,
    is_straight,
    mean_chord,
    pore_width,
)


def test_the_width_that_the_flow_sees():
    """Of slits their own; of round pipes sqrt(3/2) radii, by k = porosity radius^2 / 8."""
    assert pore_width(0.3 * 7.0**2 / 12, 0.3) == pytest.approx(7.0, rel=1e-12)
    assert pore_width(0.5 * 4.0**2 / 8, 0.5) == pytest.approx(4.0 * math.sqrt(1.5), rel=1e-12)


def test_mean_chords():
    """Of plates 2 of 6 voxels thick: lines across them have chords of 2 and 4, those along them none that ends; with as
    many walls in a third of the directions a mean is three times as long. Of cubes half the box wide all lines through
    them have chords of half the box, an eighth of the volume lies on them."""
    plates = np.zeros((6, 6, 6), bool)
    plates[:, :4] = True
    assert [mean_chord(plates), mean_chord(~plates)] == pytest.approx([3 * 2.0] * 2)
    cubes = np.zeros((8, 8, 8), bool)
    cubes[:4, :4, :4] = True
    assert mean_chord(cubes) == pytest.approx(4.0)
    assert mean_chord(np.ones((4, 4), bool)) == math.inf
    assert is_straight(plates) and is_straight(plates[0]) and not is_straight(cubes)


def test_every_wall_is_calibrated():
    found = calibrations()
    for wall in WALLS:
        parts = ["spacing"] if wall == "exact" else ["spacing", "image", "straight"]
        for part in parts:
            assert 0.0 < found[wall, part].factor < 10.0 and found[wall, part].bodies >= 9


@pytest.mark.parametrize("wall", WALLS)
def test_wider_pores_and_finer_images_are_worth_more(wall):
    scans = [None] * 2 if wall == "exact" else [Scan(3.0, False), Scan(6.0, False)]
    coarse = expected(wall, 1.0, 0.3, 1.0, scans[0])
    fine = expected(wall, 1.0, 0.3, 0.5, scans[1])
    assert fine.spacing < coarse.spacing and (wall == "exact" or fine.image < coarse.image)
    assert expected(wall, 1.0, 0.3, 1.0, scans[0], bar=0.01).spacing == 0.01  # several spacings tell by themselves


def test_a_range_is_as_wide_up_as_down():
    low, high = Expected(0.3, 0.4, "").bounds(2.0)  # 3, 4, 5
    assert low == pytest.approx(2.0 / 1.5) and high == pytest.approx(2.0 * 1.5)
