"""Widths of pores that are known exactly, and which pores lead through."""

import numpy as np
import pytest

from isphcli.preflight.check import check
from tests.preflight.cases import IMAGE, SLIT, SPHERE, read


@pytest.mark.parametrize("across", [2, 3, 4, 7, 8])
def test_the_width_of_a_slit(across):
    spacing = 0.5 / across
    throats = check(read(SLIT, f"particles.spacing={spacing}")).throats
    assert throats.narrow == pytest.approx(across)
    assert throats.median == pytest.approx(across)
    assert throats.critical == {0: pytest.approx(across, abs=0.02)}  # of the bisection
    assert throats.thin == (1 if across < 4 else 0)


def test_the_throat_of_two_chambers():
    block = "{{box: {{lower: [0.8, {}], upper: [1.2, {}]}}, is: solid}}"
    shapes = ", ".join([block.format(-1, 0.375), block.format(0.625, 2)])
    case = read(SLIT, "geometry.box=[2, 1]", "particles.spacing=0.03125", f"geometry.shapes=[{shapes}]")
    throats = check(case).throats
    assert throats.critical[0] == pytest.approx(8, abs=0.02)
    assert throats.narrow == pytest.approx(8, abs=0.1)
    assert 20 < throats.median <= 32


def test_ends_without_walls_are_no_pores():
    """A slit of 8 particles between ends that are three times as long as the box is wide, on both sides of the seam."""
    case = read(SLIT, "geometry.box=[8, 1]", "geometry.periodic=[x, y]", "particles.spacing=0.0625",
                "geometry.shapes=[{box: {lower: [3, 0], upper: [5, 0.5]}, is: solid}]")
    throats = check(case).throats
    assert throats.narrow == pytest.approx(8, abs=0.1) and throats.median == pytest.approx(8, abs=0.1)


def test_a_channel_that_is_wider_than_the_box_is_long_is_a_pore():
    """Between sides that are solid all along: it repeats along x, and there is no way on across it."""
    case = read(SLIT, "geometry.box=[0.2, 1.2]", "geometry.periodic=[x, y]", "particles.spacing=0.05",
                "geometry.shapes=[{box: {lower: [-1, 0], upper: [2, 0.2]}, is: solid}]")
    assert check(case).throats.median == pytest.approx(20, abs=0.1)


def test_nooks_of_rough_walls_are_no_throats(folder):
    """A duct of 8 x 8 voxels with a nook beside every second voxel of its walls: by neighbours alone 8 of 10 points of
    its centre lines are nooks a particle wide."""
    values = np.ones((12, 12, 24), np.uint8)
    values[2:10, 2:10] = 0
    for side in (1, 10):
        values[side, 2:10:2, ::2] = values[2:10:2, side, ::2] = 0
    np.save("rock.npy", values)
    throats = check(read(IMAGE, "geometry.wall_distance=stairs")).throats
    assert throats.median == pytest.approx(8, abs=1.0) and throats.narrow > 7 and throats.thin < 0.1  # within a voxel


def test_percolation_and_pockets_of_an_image(folder):
    values = np.ones((8, 8, 20), np.uint8)
    values[1:6, 1:6] = 0
    values[7, 7, 3] = 0
    np.save("rock.npy", values)
    found = check(read(IMAGE))
    assert found.can_run
    assert found.connectivity.percolates == (True, False, False)
    assert found.connectivity.isolated_pockets == 1
    assert found.connectivity.porosity == pytest.approx((values == 0).mean())  # without the clear layers
    assert found.throats.median == pytest.approx(5, abs=0.5)


def test_a_porous_scene_of_spheres():
    found = check(read(SPHERE, "particles.spacing=0.05"))
    assert found.connectivity.porosity == pytest.approx(1 - 4 / 3 * np.pi * 0.4**3, abs=0.01)
    assert found.connectivity.percolates == (True, True, True)


@pytest.mark.parametrize("cells, centre", [(8, 0.5), (8, 0.53), (10, 0.5), (11, 0.48)])
def test_the_throat_between_four_spheres(cells, centre):
    """sqrt(2) cells less their diameter, 3.3 to 4.6 particles: a warning hangs on it, so that it is not to come out
    larger; its middle lies beside the points that are looked at by up to a quarter of a spacing along each axis."""
    sphere = f"geometry.shapes=[{{sphere: {{centre: [{centre}, {centre}, 0.5], radius: 0.5}}, is: solid}}]"
    width = check(read(SPHERE, f"particles.spacing={1 / cells}", sphere, "drive.axes=[z]")).throats.critical[2]
    true = (np.sqrt(2) - 1) * cells
    assert true - 2 * np.hypot(0.25, 0.25) < width < 1.01 * true
