"""Thresholds, two labels exchanged, the border cut off, the pores that lead through."""

import numpy as np
import pytest

from isphcli.geometry.image_steps import connected_part, inverted, thresholded, trimmed
from isphcli.geometry.images.image import VoxelError


def test_one_threshold_and_two():
    grey = np.array([[10, 60, 90], [120, 119, 59]])
    labels, rule = thresholded(grey, (60,))
    assert labels.tolist() == [[0, 1, 1], [1, 1, 0]] and rule == "grey >= 60 is solid"
    labels, rule = thresholded(grey, (60, 120))
    assert labels.tolist() == [[0, 2, 2], [1, 2, 0]] and rule == "grey >= 120 is solid, from 60 to 120 2"
    labels, rule = thresholded(grey, (60, 120), invert=True)
    assert labels.tolist() == [[1, 2, 2], [0, 2, 1]] and rule.startswith("grey < 60 is solid")


def test_the_threshold_of_otsu_parts_two_humps():
    rng = np.random.default_rng(0)
    low, high = rng.normal(50, 5, (20, 20)), rng.normal(150, 5, (20, 20))
    labels, rule = thresholded(np.stack([low, high]), "otsu")
    assert (labels[0] == 0).all() and (labels[1] == 1).all() and "(Otsu) is solid" in rule


def test_a_threshold_that_parts_nothing_is_said():
    assert thresholded(np.array([[10, 20]]), (99,))[1].endswith("99 parts nothing: all grey values lie from 10 to 20")


@pytest.mark.parametrize("limits", [(), (1, 2, 3), (2, 1), (1, 1)])
def test_thresholds_that_cannot_be_meant(limits):
    with pytest.raises(VoxelError, match="one, or two that ascend"):
        thresholded(np.array([[0, 5]]), limits)


def test_two_labels_change_places():
    assert inverted(np.array([[0, 255], [255, 0]], np.uint8)).tolist() == [[255, 0], [0, 255]]
    for values in ([[1, 1]], [[0, 1, 2]]):
        with pytest.raises(VoxelError, match="two labels"):
            inverted(np.array(values))


def test_a_solid_border_is_cut_off():
    """Four voxels along x, two along y and one along z, in a block of solids of 9 x 7 x 6."""
    values = np.ones((6, 7, 9), np.uint8)
    values[2, 3:5, 1:5] = 0
    values[2, 3, 2] = 1  # solid inside stays
    part, cut = trimmed(values, [1])
    assert part.shape == (1, 2, 4) and cut == (5, 5, 5) and np.count_nonzero(part) == 1
    assert trimmed(part, [1])[1] == (0, 0, 0)
    with pytest.raises(VoxelError, match="all voxels are solid"):
        trimmed(np.ones((3, 3), np.uint8), [1])


PORES = np.array([[0, 1, 0, 1, 2], [0, 1, 0, 0, 2], [0, 1, 1, 1, 1], [0, 1, 0, 0, 0], [0, 1, 1, 1, 1]], np.uint8)


@pytest.mark.parametrize(
    ("which", "filled", "left"),
    [("y", 8, {0: 5}), ("any", 8, {0: 5}), ("largest", 8, {0: 5})],
)
def test_only_pores_that_lead_through_are_kept(which, filled, left):
    """A pore of five voxels along y; one of five, of two fluids, and one of three voxels end inside."""
    values, count = connected_part(PORES, [1], which)
    assert (
        count == filled
        and {int(v): int(n) for v, n in zip(*np.unique(values[values != 1], return_counts=True))} == left
    )
    assert np.array_equal(values[:, 0], PORES[:, 0]) and (values[:, 1:] == 1).all()


def test_no_pore_along_the_axis():
    with pytest.raises(VoxelError, match="no pore leads through along x"):
        connected_part(PORES, [1], "x")
    with pytest.raises(VoxelError, match="no pores along 'z'"):
        connected_part(PORES, [1], "z")
