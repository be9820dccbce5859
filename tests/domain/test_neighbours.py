"""The cell list against brute force."""

import numpy as np
import pytest

from isphcli.domain.halo import build_halo
from isphcli.domain.neighbours import find_pairs
from tests.threads import on_threads


def brute(x, n, support):
    d2 = ((x[:n, None] - x[None]) ** 2).sum(axis=2)
    near = d2 < support * support
    near[np.arange(n), np.arange(n)] = False
    return [np.flatnonzero(row) for row in near]


def check(x, n, support):
    pairs = find_pairs(x, n, support)
    assert pairs.start.dtype == np.int64 and pairs.index.dtype == np.int32
    assert len(pairs.start) == n + 1 and pairs.start[0] == 0 and pairs.start[-1] == len(pairs.index)
    for i, expected in enumerate(brute(x, n, support)):
        assert np.array_equal(np.sort(pairs.index[pairs.start[i] : pairs.start[i + 1]]), expected)
    assert np.array_equal(pairs.count, np.diff(pairs.start))
    return pairs


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("n", [1, 2, 7, 300])
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e5])
@pytest.mark.parametrize("support", [0.05, 0.21, 0.5, 3.0])
def test_random_points(dim, n, scale, support):
    x = np.random.default_rng(n).random((n, dim)) * scale
    check(x, n, support * scale)


@pytest.mark.parametrize("dim", [2, 3])
def test_only_the_first_rows_get_neighbours(dim):
    x = np.random.default_rng(1).random((200, dim))
    check(x, 50, 0.3)
    check(x, 0, 0.3)


@pytest.mark.parametrize(
    "length", [[1.0, 1.0], [1.0, 0.02], [0.3, 0.3, 0.3], [1.0, 0.05, 0.03], [0.1, 0.1, 0.1]]
)
def test_with_images_of_tiny_boxes(length):
    dim, support = len(length), 0.2
    x = np.random.default_rng(2).random((40, dim)) * length
    halo = build_halo(x, np.zeros(dim), np.array(length), np.ones(dim, bool), support)
    check(halo.positions(x), 40, support)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_points_in_a_plane_and_on_a_line(axis):
    x = np.random.default_rng(3).random((150, 3))
    x[:, axis] = 0.37
    check(x, 150, 0.2)
    x[:, (axis + 1) % 3] = -2.0
    check(x, 150, 0.2)


def test_coincident_and_far_apart_points():
    x = np.zeros((4, 3))
    assert check(x, 4, 1e-3).count.tolist() == [3, 3, 3, 3]
    # a sparse scene in a huge box must not allocate the box
    far = np.concatenate([x, np.full((3, 3), 1e6), [[1e6, 0.0, -1e6]]])
    check(far, 8, 1e-3)
    # all points but one in a corner
    check(np.concatenate([np.random.default_rng(4).random((200, 3)), [[500.0, 0.0, 0.0]]]), 201, 0.3)


@pytest.mark.parametrize("dim", [2, 3])
def test_lattice_and_far_from_the_origin(dim):
    """A lattice puts many points on the faces of cells; an offset costs digits."""
    ax = np.arange(9 if dim == 2 else 6) * 0.125
    x = np.stack(np.meshgrid(*[ax] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    for support in (0.125 * 2.1, 0.25, 0.125, 0.375):
        pairs = check(x + 1e3, len(x), support)
        assert len(pairs.index) == len(find_pairs(x, len(x), support).index)


def test_pairs_are_mutual():
    x = np.random.default_rng(5).random((400, 3))
    pairs = find_pairs(x, 400, 0.25)
    i = np.repeat(np.arange(400), pairs.count)
    forth = set(zip(i.tolist(), pairs.index.tolist()))
    assert forth == {(j, i) for i, j in forth}


def test_crowded_neighbourhoods():
    """Many more neighbours than a lattice has: nothing is cut off."""
    x = np.random.default_rng(6).normal(size=(1500, 2)) * 0.01
    x[0] = 1.0
    assert check(x, 1500, 0.05).count.max() > 1000


def test_bits_do_not_depend_on_the_threads(monkeypatch):
    x = np.random.default_rng(7).random((3000, 3))
    first, *others = on_threads(monkeypatch, lambda: find_pairs(x, 3000, 0.15))
    for other in others:
        assert np.array_equal(first.start, other.start) and np.array_equal(first.index, other.index)
