"""Grey images: thresholds, classes, what sharpening does."""

import numpy as np
import pytest

from isphcli.geometry.grey import (
    UNBLURRED,
    field_of_grey,
    grey_classes,
    labels_of_grey,
    otsu_threshold,
    sharpen,
)
from isphcli.geometry.images.image import VoxelError
from isphcli.geometry.spline import average
from tests.geometry.fields import waves

ROUND = np.ones(3, bool)


def test_otsu_finds_the_valley_between_two_classes():
    """Classes of equal width and share: the threshold lies in the valley, which is flat over a third of it."""
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(100, 10, 50000), rng.normal(200, 10, 50000)])
    assert otsu_threshold(values) == pytest.approx(150, abs=15)
    assert otsu_threshold(np.array([[0, 0, 255], [255, 0, 255]], np.uint8)) == pytest.approx(127.5, abs=1)


def test_otsu_parts_values_that_differ_in_their_last_digits():
    """Refractive indices in single precision: between 1 and 1.0001 there are fewer of these than bins."""
    assert otsu_threshold(np.array([1.0, 1.0001], np.float32)) == pytest.approx(1.00005, abs=1e-6)


def test_an_image_of_one_value_has_no_threshold():
    with pytest.raises(VoxelError, match="all grey values are 7"):
        otsu_threshold(np.full((3, 3), 7))


def test_classes_and_the_field_of_grey_values():
    values = np.array([[10, 10, 30, 30]])
    assert grey_classes(values, 20) == (10.0, 30.0, pytest.approx(1.0))
    assert field_of_grey(values, 20, "above").tolist() == [[1, 1, -1, -1]]
    assert field_of_grey(values, 25, "below").tolist() == [[-1.5, -1.5, 0.5, 0.5]]


def test_fluids_by_ranges_of_grey_values():
    values = np.array([[5, 15, 40, 15]])
    found = labels_of_grey(values, 30, "above", {"gas": (0, 10), "water": (10, 30)}, ("water", "gas"))
    assert found.tolist() == [[1, 0, -1, 0]]
    with pytest.raises(VoxelError, match="belong to no fluid"):
        labels_of_grey(values, 30, "above", {"gas": (0, 10)}, ("water", "gas"))
    with pytest.raises(VoxelError, match="no voxel of the pores has a grey value of 'gas'"):
        labels_of_grey(values, 30, "above", {"gas": (0, 2), "water": (2, 30)}, ("water", "gas"))


@pytest.mark.parametrize("around", [ROUND, np.array([True, False, False])])
@pytest.mark.parametrize("blur", [0.5, 0.8])
def test_sharpening_brings_back_most_of_what_the_blur_took(blur, around):
    """Of a field without steps, a third of its change is left: the shortest waves are six voxels long."""
    sharp = waves(24, 24, 6, 1, 0.45).astype(np.float32)
    blurred = average(sharp, np.hypot(blur, np.sqrt(UNBLURRED)), around)
    found = sharpen(blurred, blur, around)
    assert np.sqrt(np.mean((found - sharp) ** 2)) < np.sqrt(np.mean((blurred - sharp) ** 2)) / 3


def test_sharpening_does_not_make_much_of_noise():
    """White noise of a blur of 0.8 voxel: each mode grows by at most 1 / (2 k^2 sqrt(ROUGHNESS)) or 1 / H."""
    noise = np.random.default_rng(0).standard_normal((16, 16, 16)).astype(np.float32)
    assert np.std(sharpen(noise, 0.8, ROUND)) < 3.0


def test_sharpening_leaves_a_constant():
    field = np.full((6, 6, 6), 0.3, np.float32)
    assert np.allclose(sharpen(field, 0.8, ROUND), field, atol=1e-6)
