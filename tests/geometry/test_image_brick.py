"""A part of an image answers as the whole does, for all points within reach of its brick."""

import numpy as np
import pytest

from isphcli.geometry.image_brick import ImageBrick, LabelsInFile
from isphcli.geometry.labels import ClearLayers
from isphcli.geometry.voxel_geometry import VoxelGeometry

SIZE = np.array([2.0, 1.0, 1.5])  # m, of a voxel: not the same along all axes


def body(shape, seed=0):
    """Lumps of random voxels, two fluids, as labels [z, y, x]."""
    rng = np.random.default_rng(seed)
    coarse = rng.random([n // 3 + 1 for n in shape])
    lumps = np.kron(coarse, np.ones((3, 3, 3)))[tuple(slice(0, n) for n in shape)]
    return np.where(lumps < 0.45, np.int8(-1), np.where(rng.random(shape) < 0.1, np.int8(1), np.int8(0)))


def both(labels, periodic, layers):
    read = []

    def part(ranges):
        read.append(ranges)
        return labels[tuple(slice(low, high) for low, high in reversed(ranges))]

    whole = VoxelGeometry(labels, SIZE, periodic, layers)
    image = LabelsInFile(labels.shape[::-1], int((labels >= 0).sum()), part)
    return whole, ImageBrick(image, SIZE, periodic, layers), read


@pytest.mark.parametrize("periodic", [(True, True, True), (True, False, True), (False, False, False)])
@pytest.mark.parametrize("layers", [None, ClearLayers(1, 4)])
def test_a_brick_is_the_whole_within_reach(periodic, layers):
    """Phases, crossings and distances up to the reach, at points in the brick and at their images; bricks at faces, at
    a seam, and as long as the box along one axis."""
    whole, lazy, read = both(body((44, 52, 60)), periodic, layers)
    assert (whole.lower == lazy.lower).all() and (whole.upper == lazy.upper).all() and whole.periodic == lazy.periodic
    assert (whole.sample_lower == lazy.sample_lower).all() and whole.has_solid == lazy.has_solid
    length, reach = whole.upper - whole.lower, 4.0
    rng = np.random.default_rng(1)
    for low, high in ([0.0, 0.2], [0.4, 0.6], [0.85, 1.0]):
        lower, upper = low * length, high * length
        lower[2], upper[2] = 0.0, length[2] if low == 0.4 else 0.3 * length[2]
        brick = lazy.within(lower, upper, reach)
        assert brick is lazy.within(lower, upper, reach)
        x = lower - reach + rng.random((4000, 3)) * (upper - lower + 2 * reach)
        for points in (x, x + length * np.where(periodic, [1.0, -1.0, 2.0], 0.0)):
            assert (brick.phase(points) == whole.phase(points)).all()
            d, wanted = (np.clip(g.distance(points), -reach, reach) for g in (brick, whole))
            assert d == pytest.approx(wanted, abs=1e-6)  # distances of centres are kept in single precision
            near = np.abs(wanted) < reach
            assert (brick.wall(points)[near] == whole.wall(points)[near]).all()
        fluid = x[whole.phase(x) >= 0]
        to = fluid + rng.uniform(-1.0, 1.0, fluid.shape)
        kept = ((to > lower - reach) & (to < upper + reach)).all(axis=1)
        assert brick.crossing(fluid[kept], to[kept]) == pytest.approx(whole.crossing(fluid[kept], to[kept]), abs=1e-9)
    voxels = 44 * 52 * 60
    assert all(np.prod([high - low for low, high in ranges]) < voxels for ranges in read)


def test_bricks_of_one_kind():
    """In a part that is all fluid, or all solid, the nearest wall is farther off than anything that is asked."""
    labels = np.full((40, 40, 40), -1, np.int8)
    labels[:, :, :20] = 0
    whole, lazy, _ = both(labels, (True, True, True), None)
    for along, kind in ((20.0, 0), (60.0, -1)):
        x = np.full((1, 3), along / 2) * [2.0, 1.0, 1.5] / 2.0
        x[0, 0] = along
        brick = lazy.within(x[0] - 0.5, x[0] + 0.5, 1.0)
        assert brick.phase(x)[0] == whole.phase(x)[0] == kind
        assert brick.has_solid and np.sign(brick.distance(x)[0]) == np.sign(whole.distance(x)[0])
        assert abs(brick.distance(x)[0]) >= 1.0


def test_two_dimensions():
    labels = body((3, 60, 70))[1]
    whole = VoxelGeometry(labels, SIZE[:2], (True, True))
    image = LabelsInFile((70, 60), int((labels >= 0).sum()),
                         lambda ranges: labels[tuple(slice(low, high) for low, high in reversed(ranges))])
    brick = ImageBrick(image, SIZE[:2], (True, True)).within(np.array([0.0, 20.0]), np.array([30.0, 40.0]), 2.0)
    x = np.random.default_rng(2).random((2000, 2)) * [30.0, 20.0] + [0.0, 20.0]
    assert (brick.phase(x) == whole.phase(x)).all()
    d, wanted = (np.clip(g.distance(x), -2.0, 2.0) for g in (brick, whole))
    assert d == pytest.approx(wanted, abs=1e-6)
