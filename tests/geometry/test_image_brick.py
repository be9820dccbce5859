"""A part of an image that processes share answers as the whole does, for all points within reach of its brick."""

import numpy as np
import pytest

from isphcli.domain.slabs import Shared, Slabs
from isphcli.geometry.clear_layer import clear_voxels
from isphcli.geometry.image_brick import ImageBrick, SmoothBrick, whole_image
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.geometry.labels import ClearLayers, faces_that_differ, unlike_next
from isphcli.geometry.voxel_geometry import VoxelGeometry
from tests.domain.several import on_ranks

SIZE = np.array([2.0, 1.0, 1.5])  # m, of a voxel: not the same along all axes


def body(shape, seed=0):
    """Lumps of random voxels, two fluids, as labels [z, y, x]."""
    rng = np.random.default_rng(seed)
    coarse = rng.random([n // 3 + 1 for n in shape])
    lumps = np.kron(coarse, np.ones((3, 3, 3)))[tuple(slice(0, n) for n in shape)]
    return np.where(lumps < 0.45, np.int8(-1), np.where(rng.random(shape) < 0.1, np.int8(1), np.int8(0)))


def own(values, slabs):
    return values[slice(*slabs.own)]


def agree(part, whole, x, reach):
    """Phases, rocks, distances up to the reach and numbers of walls of a part at points are those of the whole."""
    fluid = whole.phase(x) >= 0
    assert (part.phase(x) == whole.phase(x)).all()
    assert (part.microporous(x)[fluid] == whole.microporous(x)[fluid]).all()
    d, wanted = (np.clip(g.distance(x), -reach, reach) for g in (part, whole))
    assert np.abs(d - wanted).max() <= 1e-6  # distances of centres are kept in single precision
    near = np.abs(wanted) < reach
    assert (part.wall(x)[near] == whole.wall(x)[near]).all()


def compare(part, whole, brick, reach, periodic):
    """At points in the brick, near it and at their images."""
    lower, upper = brick
    length, rng = whole.upper - whole.lower, np.random.default_rng(1)
    x = lower - reach + rng.random((3000, whole.dim)) * (upper - lower + 2 * reach)
    for points in (x, x + length * np.where(periodic, [1.0, -1.0, 2.0][: whole.dim], 0.0)):
        agree(part, whole, points, reach)
    fluid = x[whole.phase(x) >= 0]
    to = fluid + rng.uniform(-1.0, 1.0, fluid.shape)
    kept = ((to > lower - reach) & (to < upper + reach)).all(axis=1)
    # zeros of a spline are found to 1e-7 of the way (`iso_crossings.CLOSE_T`)
    assert np.abs(part.crossing(fluid[kept], to[kept]) - whole.crossing(fluid[kept], to[kept])).max() <= 1e-6


def bricks(length, periodic):
    """At a face, in the middle and as long as the box along one axis, at the other face."""
    for low, high in ([0.0, 0.2], [0.4, 0.6], [0.85, 1.0]):
        lower, upper = low * length, high * length
        lower[2], upper[2] = 0.0, length[2] if low == 0.4 else 0.3 * length[2]
        yield lower, upper


@pytest.mark.parametrize("periodic", [(True, True, True), (True, False, True), (False, False, False)])
@pytest.mark.parametrize("layers", [None, ClearLayers(1, 4), ClearLayers(2, 3)])
def test_a_brick_is_the_whole_within_reach(periodic, layers):
    """Of three processes, the walls faces of voxels; rock in a part of the fluid."""
    labels = body((44, 52, 60))
    rock = np.where((labels >= 0) & (np.arange(60) % 7 < 3), np.int8(0), np.int8(-1))
    whole = VoxelGeometry(labels, SIZE, periodic, layers)
    whole.fill_with(rock, layers)

    def compared(ranks):
        slabs = Slabs(labels.shape, ranks=ranks)
        shared = ImageBrick(Shared(own(labels, slabs), slabs), SIZE, periodic, layers)
        shared.fill_with(own(rock, slabs), layers)
        assert (whole.upper == shared.upper).all() and whole.periodic == shared.periodic
        assert (whole.sample_lower == shared.sample_lower).all() and whole.has_solid == shared.has_solid
        for number, brick in enumerate(bricks(whole.upper - whole.lower, whole.periodic)):
            part = shared.within(*brick, 4.0)
            assert part is shared.within(*brick, 4.0) is part.within(*brick, 4.0)
            if number % 3 == ranks.rank:
                compare(part, whole, brick, 4.0, whole.periodic)

    on_ranks(3, compared)


@pytest.mark.parametrize("periodic, layers", [((True, True, True), None), ((False, False, False), ClearLayers(0, 4)),
                                              ((True, True, False), ClearLayers(2, 3))])
@pytest.mark.parametrize("field", [None, ImageField])
def test_a_brick_of_a_smooth_wall(periodic, layers, field):
    """Coefficients of the spline are those of one process to the last bit, and so is what the surface opens and closes.
    Of labels, and of grey values that are averaged."""
    labels = body((20, 25, 23), seed=2)
    values = None
    if field is not None:
        grey = np.where(labels < 0, -1.0, 1.0) + 0.2 * np.random.default_rng(3).standard_normal(labels.shape)
        values = np.where(grey > 0, 1.0, grey).astype(np.float32)  # one value in fluid: the clear layers have it too

    def given(part):
        return None if field is None else ImageField(part, 0.7)

    whole = IsoSurfaceGeometry(labels, given(values), SIZE, periodic, layers)
    ways = whole.ways()

    def compared(ranks):
        slabs = Slabs(labels.shape, ranks=ranks)
        shared = SmoothBrick(Shared(own(labels, slabs), slabs), given(None if field is None else own(values, slabs)),
                             SIZE, periodic, layers)
        assert shared.ways() == ways
        for number, brick in enumerate(bricks(whole.upper - whole.lower, whole.periodic)):
            part = shared.within(*brick, 4.0)
            if number % ranks.size == ranks.rank:
                compare(part, whole, brick, 4.0, whole.periodic)
        return shared._spline

    found = np.concatenate(on_ranks(3, compared))
    assert (found == whole._spline).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("periodic", [(False, False, False), (True, True, True)])
def test_what_is_known_of_the_whole(axis, periodic):
    """The thickness of clear layers, walls and straightness, and whether opposite faces differ, of four processes."""
    pores = body((17, 22, 20), seed=4) >= 0
    wanted, differ = clear_voxels(pores, axis, SIZE, periodic), faces_that_differ(~pores, (True, True, True))
    walls = np.mean([np.mean(unlike_next(pores, a, True)) for a in range(3)])

    def compared(ranks):
        slabs = Slabs(pores.shape, ranks=ranks)
        image = whole_image(own(pores, slabs), slabs)
        assert (image.shape, image.fluid, image.straight) == ((20, 22, 17), pores.sum(), False)
        assert image.walls == pytest.approx(walls) and len(differ) > 0
        assert faces_that_differ(own(~pores, slabs), (True, True, True), slabs) == differ
        shared = ImageBrick(Shared(own(np.where(pores, np.int8(0), np.int8(-1)), slabs), slabs), SIZE, periodic,
                            ClearLayers(2, 3))
        places = [np.array([0, 2, 9, 16]), np.arange(22), np.array([3, 4])]
        assert (shared.solid_at(places) == ~pores[np.ix_(*places)]).all()
        prism = np.repeat(pores[:, :1], 22, axis=1)
        assert whole_image(own(prism, slabs), slabs).straight
        return clear_voxels(own(pores, slabs), axis, SIZE, periodic, slabs)

    assert wanted > 0 and on_ranks(4, compared) == [wanted] * 4


def test_bricks_of_one_kind():
    """In a part that is all fluid, or all solid, the nearest wall is farther off than anything that is asked."""
    labels = np.full((40, 40, 40), -1, np.int8)
    labels[:, :, :20] = 0
    whole = VoxelGeometry(labels, SIZE, (True, True, True))
    shared = ImageBrick(Shared(labels, Slabs(labels.shape)), SIZE, (True, True, True))
    for along, kind in ((20.0, 0), (60.0, -1)):
        x = np.full((1, 3), along / 2) * [2.0, 1.0, 1.5] / 2.0
        x[0, 0] = along
        brick = shared.within(x[0] - 0.5, x[0] + 0.5, 1.0)
        assert brick.phase(x)[0] == whole.phase(x)[0] == kind
        assert brick.has_solid and np.sign(brick.distance(x)[0]) == np.sign(whole.distance(x)[0])
        assert abs(brick.distance(x)[0]) >= 1.0


@pytest.mark.parametrize("kind", [VoxelGeometry, IsoSurfaceGeometry])
def test_two_dimensions(kind):
    """One process has the only layer."""
    labels = body((3, 60, 70))[1]
    more = () if kind is VoxelGeometry else (None,)
    whole = kind(labels, *more, SIZE[:2], (True, True))

    def compared(ranks):
        slabs = Slabs((1, 60, 70), ranks=ranks)
        shared = (ImageBrick if kind is VoxelGeometry else SmoothBrick)(
            Shared(own(labels[None], slabs), slabs), *more, SIZE[:2], (True, True))
        lower, upper = np.array([0.0, 20.0]), np.array([30.0, 40.0])
        compare(shared.within(lower, upper, 2.0), whole, (lower, upper), 2.0, (True, True))
        assert kind is VoxelGeometry or shared.ways() == whole.ways()

    on_ranks(2, compared)
