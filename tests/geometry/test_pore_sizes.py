"""Sizes of pores: bodies whose size is known."""

import numpy as np
import pytest

from isphcli.geometry.pore_sizes import STEPS, pore_sizes


def median(found):
    edges, share = found
    assert share.sum() == pytest.approx(1.0) and len(edges) == len(share) + 1
    return 0.5 * (edges[:-1] + edges[1:])[np.searchsorted(np.cumsum(share), 0.5)]


def test_a_slit_has_one_size():
    """Nine cells of 2 um wide: all of its volume is in the last bin, which ends at its width."""
    fluid = np.zeros((30, 20), bool)
    fluid[5:14] = True
    edges, share = pore_sizes(fluid, [2e-6, 2e-6], [True, False])
    assert edges[-1] == pytest.approx(18e-6) and share[-1] == 1.0 and len(share) == STEPS


def test_a_ball_has_its_diameter():
    """Of 21 cells across; corners of cells at its wall count to smaller ones: a fifth of the volume here."""
    z, y, x = np.mgrid[:31, :31, :31] - 15
    fluid = x**2 + y**2 + z**2 <= 10.5**2
    edges, share = pore_sizes(fluid, [1.0] * 3, [False] * 3)
    assert edges[-1] == pytest.approx(21.0, abs=1.5) and share[-2:].sum() > 0.75


def test_two_slits_share_the_volume():
    fluid = np.zeros((40, 12), bool)
    fluid[2:7] = True  # 5 cells
    fluid[15:30] = True  # 15 cells
    edges, share = pore_sizes(fluid, [1.0, 1.0], [True, True])
    small = 0.5 * (edges[1:] + edges[:-1]) < 8.0
    assert share[small].sum() == pytest.approx(0.25)
    assert median((edges, share)) == pytest.approx(15.0, abs=15.0 / STEPS)


def test_a_pore_goes_on_behind_a_periodic_face():
    fluid = np.zeros((20, 10), bool)
    fluid[:4] = fluid[-5:] = True  # 9 cells across the face
    assert pore_sizes(fluid, [1.0, 1.0], [True, True])[0][-1] == pytest.approx(9.0)


def test_there_is_none_without_fluid_or_solid():
    assert pore_sizes(np.ones((4, 4), bool), [1.0, 1.0], [True, True]) is None
    assert pore_sizes(np.zeros((4, 4), bool), [1.0, 1.0], [True, True]) is None
