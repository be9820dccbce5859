"""The distance transform of an image against brute force."""

import itertools

import numpy as np
import pytest

from isphcli.geometry.wall_distance import nearest_centre
from tests.geometry.images.files import rock


@pytest.mark.parametrize("voxel", [(1, 1, 1), (1, 1.5, 0.7)])
@pytest.mark.parametrize("around", list(itertools.product([True, False], repeat=3)))
def test_distance_transform_against_brute_force(voxel, around):
    target = rock(porosity=0.85) < 0
    found = nearest_centre(target, np.array(voxel, float), np.array(around))
    centres = np.argwhere(np.ones_like(target))
    shifts = [(-1, 0, 1) if a else (0,) for a in around]  # x, y, z
    sources = np.concatenate(
        [np.argwhere(target) + np.array(s[::-1]) * target.shape for s in itertools.product(*shifts)]
    )
    offset = centres[:, None] - sources[None]
    squares = ((offset * np.array(voxel)[::-1]) ** 2).sum(2)
    exact = np.sqrt(squares.min(1))
    if len(set(voxel)) == 1:
        assert np.abs(found.ravel() - np.maximum(exact - 0.5, 0)).max() < 1e-6
    else:  # half a voxel in the direction of the nearest centre, one of them where several are as near
        half = np.where(squares == squares.min(1)[:, None], np.sqrt((offset**2).sum(2)), np.nan)
        low, high = (exact * (1 - 0.5 / np.maximum(f(half, 1), 0.5)) for f in (np.nanmin, np.nanmax))
        assert ((found.ravel() > low - 1e-6) & (found.ravel() < high + 1e-6)).all()
