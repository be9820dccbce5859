"""Connectivity of labelled lattices, checked on small scenes and against brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.geometry.connectivity import SlabConnectivity, components, connectivity_of, percolating


def two_tubes():
    """Two square tubes along z, 4 x 4 and 12 x 12 - 3 voxels of a 16^3 image."""
    fluid = np.zeros((16, 16, 16), dtype=bool)
    fluid[:, 1:5, 1:5] = True
    fluid[:, 6:15, 6:15] = True
    return fluid


def duct_and_pockets():
    fluid = np.zeros((16, 16, 16), dtype=bool)
    fluid[:, 4:12, 4:12] = True
    fluid[5, 1, 1] = True
    fluid[8:10, 14, 14] = True
    return fluid


def test_a_box_of_walls_is_no_closed_pocket():
    fluid = np.ones((4, 4, 4), dtype=bool)
    found = connectivity_of(fluid, (False,) * 3, open_axes=[])
    assert found.percolates == (False,) * 3 and found.isolated_pockets == 0 and found.isolated_share == 0.0
    assert connectivity_of(fluid, (False,) * 3, open_axes=[], through=[0]).isolated_pockets == 1  # between reservoirs


def test_tubes_percolate_along_their_axis_only():
    found = connectivity_of(two_tubes(), (False, False, False))
    assert found.components == 2 and found.isolated_pockets == 0
    assert found.percolates == (False, False, True)
    assert found.porosity == (16 + 81) / 256
    assert found.largest_share == pytest.approx(81 / 97)


def test_pockets_are_counted_with_their_volume():
    found = connectivity_of(duct_and_pockets(), (False,) * 3, cell_volume=2.0)
    assert found.isolated_pockets == 2 and found.isolated_volume == 6.0
    assert found.percolating_porosity == (0.0, 0.0, 0.25)
    mask = percolating(duct_and_pockets(), (False,) * 3, 2)
    assert mask.sum() == 16 * 64 and not mask[5, 1, 1]


def test_all_solid_and_all_fluid():
    none = connectivity_of(np.zeros((4, 4, 4), dtype=bool), (True,) * 3)
    assert none.components == 0 and none.largest_share == 0 and none.percolates == (False,) * 3
    every = connectivity_of(np.ones((4, 4, 4), dtype=bool), (True, False, True))
    assert every.components == 1 and every.percolates == (True,) * 3


def test_a_closed_box_percolates_nowhere():
    fluid = np.zeros((12, 12, 12), dtype=bool)
    fluid[3:9, 3:9, 3:9] = True
    assert connectivity_of(fluid, (True,) * 3).percolates == (False,) * 3


def test_touching_both_faces_is_not_percolating_in_a_periodic_axis():
    """A bar from face to face whose ends do not meet across the face: walls, yes; periodic, no."""
    fluid = np.zeros((6, 6), dtype=bool)
    fluid[1, :3], fluid[1:5, 2], fluid[4, 2:] = True, True, True
    assert connectivity_of(fluid, (False, False)).percolates == (True, False)
    assert connectivity_of(fluid, (True, True)).percolates == (False, False)
    fluid[1:5, 5] = True  # now it closes
    assert connectivity_of(fluid, (True, False)).percolates == (True, False)


def test_a_staircase_winds_round_both_axes():
    fluid = np.zeros((4, 4), dtype=bool)
    for k in range(4):
        fluid[k, k] = fluid[k, (k + 1) % 4] = True
    found = connectivity_of(fluid, (True, True))
    assert found.components == 1 and found.percolates == (True, True)
    assert connectivity_of(fluid, (True, False)).percolates == (False, True)


def test_a_path_may_wrap_in_another_axis():
    """Along x the way leads through the periodic face of y."""
    fluid = np.zeros((5, 6), dtype=bool)
    fluid[0, :3], fluid[4, 2:] = True, True
    assert connectivity_of(fluid, (False, True)).percolates == (True, False)
    assert connectivity_of(fluid, (False, False)).percolates == (False, False)


def test_wrong_number_of_axes():
    with pytest.raises(ValueError, match="periodic"):
        connectivity_of(np.ones((3, 3)), (True,) * 3)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=2, max_size=2), st.floats(0.4, 0.8))
def test_percolation_agrees_with_a_walk_on_the_unrolled_lattice(seed, periodic, porosity):
    """A component winds round a periodic axis if a walk from a cell reaches one of its own images."""
    fluid = np.random.default_rng(seed).random((5, 6)) < porosity
    labels, _, percolates = components(fluid, tuple(periodic))
    for start in np.argwhere(fluid):
        reached = walk(fluid, tuple(start), periodic)
        images = {(dx, dy) for (y, x, dy, dx) in reached if (y, x) == tuple(start)}
        for axis in range(2):
            if periodic[axis]:
                assert percolates[labels[tuple(start)], axis] == any(image[axis] for image in images)
        cells = {(y, x) for y, x, _, _ in reached}
        assert cells == {tuple(c) for c in np.argwhere(labels == labels[tuple(start)])}
        for axis in range(2):
            if not periodic[axis]:
                faces = {c[1 - axis] for c in cells}
                assert percolates[labels[tuple(start)], axis] == ({0, fluid.shape[1 - axis] - 1} <= faces)


def walk(fluid, start, periodic, rounds=3):
    """Cells (y, x, round y, round x) that can be reached, at most a few times round the box."""
    ny, nx = fluid.shape
    seen, todo = {(*start, 0, 0)}, [(*start, 0, 0)]
    while todo:
        y, x, ry, rx = todo.pop()
        for dy, dx in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            qy, qx = y + dy, x + dx
            sy, sx = ry + qy // ny, rx + qx // nx
            outside = (qy // ny and not periodic[1]) or (qx // nx and not periodic[0])
            cell = (qy % ny, qx % nx, sy, sx)
            if not outside and max(abs(sy), abs(sx)) <= rounds and fluid[cell[:2]] and cell not in seen:
                seen.add(cell)
                todo.append(cell)
    return seen


@pytest.mark.parametrize("thick", [1, 3, 7])
def test_slabs_have_the_connectivity_of_the_whole(thick):
    fluid = np.random.default_rng(4).random((20, 9, 11)) < 0.35
    fluid[:, 4, 5] = True  # one that leads through along z
    found = SlabConnectivity()
    for first in range(0, 20, thick):
        found.add(fluid[first : first + thick])
    assert found.connectivity(0.5) == connectivity_of(fluid, (False,) * 3, 0.5)
    empty = SlabConnectivity()
    empty.add(np.zeros((2, 3, 4), bool))
    assert empty.connectivity() == connectivity_of(np.zeros((2, 3, 4), bool), (False,) * 3)
