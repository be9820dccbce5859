"""Labels of an image become phases; faces of a period that do not match are told."""

import numpy as np
import pytest

from isphcli.geometry.images.image import VoxelError
from isphcli.geometry.labels import FEW, apply_labels, faces_that_differ, guess_labels, unlike_next


def test_labels_become_phases():
    values = np.array([[0, 1, 2], [3, 1, 0]], np.uint8)
    labels = {"solid": (1, 3), "brine": (0,), "co2": 2}
    assert apply_labels(values, labels, ("co2", "brine")).tolist() == [[1, -1, 0], [-1, -1, 1]]
    with pytest.raises(VoxelError, match=r"\[3\] have no label"):
        apply_labels(values, {**labels, "solid": 1}, ("co2", "brine"))
    with pytest.raises(VoxelError, match="'co2' \\[7\\]"):
        apply_labels(values, {"solid": (1, 2, 3), "brine": 0, "co2": 7}, ("co2", "brine"))
    with pytest.raises(VoxelError, match="'oil'"):
        apply_labels(values, {**labels, "oil": 5}, ("co2", "brine"))


def test_faces_that_do_not_match_are_told():
    """Layers that drift along x, and the same beside their mirror image; noise, whose layers never match."""
    rng = np.random.default_rng(0)
    drift = np.sin(np.arange(58) / 6 + 2 * np.pi * rng.random((30, 30))[..., None]) > 0  # [z, y, x]
    (said,) = faces_that_differ(drift, (True, False, False))
    across = 100 * (drift[..., 0] != drift[..., -1]).mean()
    assert f"the two faces across x differ in {across:.0f} % of their voxels" in said and across > 30
    assert faces_that_differ(drift, (False, True, True)) == ()
    assert faces_that_differ(np.concatenate([drift, drift[..., ::-1]], axis=2), (True, False, False)) == ()
    assert faces_that_differ(rng.random((20, 20, 20)) < 0.5, (True,) * 3) == ()
    assert faces_that_differ(drift[:, 0].T, (False, True)) != ()  # 2D [y, x]


@pytest.mark.parametrize("repeats, expected", [(True, [0, 1, 0, 1, 0]), (False, [0, 1, 0, 1])])
def test_where_walls_have_faces(repeats, expected):
    """Of a row of voxels pore, pore, solid, solid, pore: at both ends of the solid, and not where the row repeats; nor
    anything beyond its end otherwise."""
    row = np.array([1, 1, 0, 0, 1], bool)
    for axis, shape in ((0, (5, 1)), (1, (1, 5))):
        assert unlike_next(row.reshape(shape), axis, repeats).ravel().tolist() == expected


def test_what_is_solid_is_guessed_once_for_all():
    """Of two values the higher one, of more the most frequent one; more than a few, and real numbers, are grey."""
    two = np.array([[0, 0, 0], [255, 0, 0]], np.uint8)
    assert guess_labels(two) == (255, [0], {0: 5, 255: 1})
    assert guess_labels(two > 0) == (1, [0], {0: 5, 1: 1})
    assert guess_labels(np.array([[3, 3], [7, 1]])) == (3, [1, 7], {1: 1, 3: 2, 7: 1})
    assert guess_labels(np.arange(FEW)[None]) is not None and guess_labels(np.arange(FEW + 1)[None]) is None
    assert guess_labels(two.astype(float)) is None
