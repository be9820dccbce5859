"""Where pairs cross walls: thin walls part them."""

import numpy as np
import pytest

from isphcli.domain.components import pair_components
from isphcli.geometry.bodies import Box, Shape
from tests.operators.walls import SUPPORTS, Walled, along_x, channel


@pytest.mark.parametrize("ratio", SUPPORTS)
def test_thin_wall_blocks_pairs(ratio):
    """A plate a tenth of a spacing thick: no pair across it, parabolas on both sides exact."""
    dx = 1 / 16
    lower, upper = 0.5 + 0.1 * dx, 0.5 + 0.2 * dx
    s = Walled(channel(2, 1.0, shapes=[Shape(Box([0.0, lower], [1.0, upper]))]), dx, ratio)
    assert s.n == 256  # no lattice site inside the plate
    i = np.repeat(np.arange(s.n), np.diff(s.ops.start))
    y, above = s.x[:, 1], s.x[:, 1] > 0.5
    assert np.all(above[i] == above[s.ops.column])
    assert np.all(s.ops.walls.near_wall[np.abs(y - 0.5) < dx])
    u = np.where(above, (y - upper) * (1 - y), y * (lower - y))
    assert s.ops.deficient == 0
    assert np.abs(s.lap(along_x(u, 2))[:, 0] + 2).max() < 1e-10
    # each side is a component of its own for the pressure
    assert pair_components(s.ops.start, s.ops.column)[0] == 2
