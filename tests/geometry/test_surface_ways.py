"""Ways that the surface of an image has and the faces of its voxels have not, and the other way round."""

import numpy as np
import pytest

from isphcli.geometry.connectivity import connectivity_of
from isphcli.geometry.spline import spline_coefficients
from isphcli.geometry.surface_ways import surface_ways
from tests.geometry.fields import phases, waves

ROUND = (True, True, True)


def ways(field, labels=None, periodic=ROUND, around=None):
    field = np.asarray(field, np.float32)
    around = np.array([*periodic, True][:3] if around is None else around)
    c = spline_coefficients(field.copy(), around)
    return surface_ways(c, around, field, phases(field) if labels is None else labels, all_of(field), periodic)


def all_of(field):
    """The whole of a field as a part of it."""
    return tuple(slice(0, n) for n in field.shape)


@pytest.mark.parametrize("periodic", [ROUND, (False, True, False)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_of_a_body_that_is_resolved_both_agree(seed, periodic):
    field = waves(24, 24, 12, seed, 0.5)
    found, labels = ways(field, periodic=periodic), connectivity_of(field > 0, periodic)
    assert found.percolates == found.label_percolates == labels.percolates
    assert found.parts == found.label_parts == labels.components
    assert found.moved == 0 and not found.warnings()


@pytest.mark.parametrize("axes", [(0, 1), (0, 2), (1, 2)])
@pytest.mark.parametrize("fluid", [0.9, 0.1])
@pytest.mark.parametrize("step", [1, -1])
def test_two_voxels_at_an_edge(axes, fluid, step):
    """Middle of the edge between them and two of -0.5: near the mean of the four, the spline is a little above."""
    field = np.full((8, 8, 8), -0.5)
    other = [4, 4, 4]
    other[axes[0]] += 1
    other[axes[1]] += step
    field[4, 4, 4] = field[tuple(other)] = fluid
    found = ways(field)
    is_open = fluid == 0.9
    assert found.label_parts == 2 and found.parts == (1 if is_open else 2) and found.opened == int(is_open)


def diagonal():
    """Fluid on a diagonal of 8 x 8; its voxels touch at edges, also across the periodic faces but in the corner."""
    row, column = np.arange(8), np.array([0, 1, 2, 3, 4, 3, 2, 1])
    field = np.full((8, 8), -0.5)
    field[row, column] = 1.0
    return field


def test_a_diagonal_of_voxels_leads_through_along_the_edges():
    """From y = 7, x = 1 to y = 0, x = 0 across the periodic face; by their faces the voxels do not lead along y."""
    field = np.repeat(diagonal()[None], 4, axis=0)
    found = ways(field)
    assert found.percolates == (False, True, True) and found.label_percolates == (False, False, True)
    assert "along y" in found.warnings()[0] and len(found.warnings()) == 1
    sealed = ways(field, periodic=(False, False, False))
    assert sealed.percolates == (False, True, True)


def test_a_way_that_winds_back_does_not_percolate():
    """A ring through the periodic face and back has two crossings of opposite sense."""
    field = np.full((6, 12, 12), -1.0)
    field[2:4, 2:10, 10:] = field[2:4, 2:10, :2] = 1.0
    assert ways(field).percolates == (False, False, False)


def test_voxels_on_the_other_side_than_their_label_are_counted():
    field = waves(12, 12, 6, 5, 0.5)
    labels = phases(field)
    labels.ravel()[:7] = -1 - labels.ravel()[:7]
    assert ways(field, labels).moved == 7


def test_a_face_between_two_fluid_voxels_may_be_closed():
    """A spline through 0.1 and 0.1 between two of -0.5 along x and eight of -2 beside each dips below zero half-way;
    between two layers of them it does not."""
    layers = np.full((8, 8, 8), -2.0)
    layers[:, :, 3:5] = 0.1
    found = ways(layers)
    assert found.closed == 0 and found.parts == 1 and found.percolates == (False, True, True)
    apart = np.full((8, 8, 8), -2.0)
    apart[4, 4, 3], apart[4, 4, 4] = 0.02, 0.02
    apart[4, 4, 2] = apart[4, 4, 5] = 2.0
    found = ways(apart)
    assert found.closed == 1 and found.parts == 2 and found.label_parts == 1


def test_one_layer_has_no_ways_out_of_it():
    field = diagonal()[None]
    c = spline_coefficients(field.astype(np.float32), np.ones(3, bool))
    found = surface_ways(c, np.ones(3, bool), field, phases(field), all_of(field), (True, True))
    assert found.percolates == (False, True) and found.label_percolates == (False, False)
