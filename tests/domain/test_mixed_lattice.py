"""Lattices some of whose cells are cut: their sites fill the box, and pairs see as far as their spacings say."""

import numpy as np
import pytest

from isphcli.domain.lattice import make_lattice
from isphcli.domain.mixed_lattice import MixedLattice, cells_of, grown, pairs_of_two


def mixed(dim, support=2.1, cells=7):
    """A lattice of unit cells, of which some are cut, and its sites (x, half, beside)."""
    lattice = make_lattice("cubic" if dim == 3 else "square", np.zeros(dim), np.full(dim, float(cells)), [True] * dim,
                           1.0, 0.0)
    cut = np.zeros(lattice.counts, bool)
    cut[tuple(np.random.default_rng(dim).integers(0, cells, (dim, 2)))] = True
    found = MixedLattice(lattice, np.argwhere(cut), support, 1).within(np.zeros(dim, int), lattice.counts)
    x = np.concatenate(list(found.slabs()))
    return found, grown(cut, 1), (x, found.half(x), found.beside(x))


@pytest.mark.parametrize(("dim", "support"), [(2, 2.1), (3, 2.1), (2, 3.0)])
def test_pairs_are_those_within_the_mean_of_both_supports(dim, support):
    """By brute force, and each from either side."""
    _, cut, (x, half, beside) = mixed(dim, support)
    assert 0.0 < cut.mean() < 1.0
    spacing = np.where(half, 0.5, 1.0)
    assert (spacing**dim).sum() == 7**dim  # the cells are filled once
    pairs = pairs_of_two(x, len(x), half, beside, support)
    r = np.linalg.norm(x[:, None] - x[None, :], axis=2)
    near = (r < support * 0.5 * (spacing[:, None] + spacing[None, :])) & ~np.eye(len(x), dtype=bool)
    found = np.zeros_like(near)
    found[np.repeat(np.arange(len(x)), pairs.count), pairs.index] = True
    assert np.array_equal(found, near) and pairs.count.sum() == near.sum()


def test_cells_of_sites():
    """Each site lies in the cell that it is of, one beyond the end of a periodic axis in the first."""
    found, cut, (x, half, _) = mixed(2)
    assert np.array_equal(cut[tuple(cells_of(found.lattice, x).T)], half)
    assert cells_of(found.lattice, np.array([[7.5, -0.5]])).tolist() == [[0, 6]]


@pytest.mark.parametrize("first", [(0, 0), (-2, 3), (9, 9)])
def test_a_part_of_a_lattice_knows_what_the_whole_does(first):
    """Beyond the ends too, and each site has one number."""
    whole, _, (x, *_) = mixed(2, cells=11)
    first = np.array(first)
    part = whole.within(first, first + [4, 3])
    index, = part.cells(first, first + [4, 3])
    at = part.at(index)
    assert np.array_equal(part.half(at), whole.half(at)) and np.array_equal(part.beside(at), whole.beside(at))
    assert 0 < part.beside(at).sum() < len(at)
    every, = whole.cells(np.zeros(2, int), whole.counts)
    place = {int(number): tuple(point) for number, point in zip(whole.numbers(every), x)}
    assert len(place) == len(x)
    wrapped = at - 11.0 * np.floor(at / 11.0)
    known = np.array([place[int(number)] for number in part.numbers(np.mod(index, whole.counts))])
    assert np.allclose(known, wrapped)


def test_growing_goes_round_the_ends():
    cut = np.zeros((5, 5), bool)
    cut[0, 2] = True
    assert np.array_equal(np.argwhere(grown(cut, 1)), [(i, j) for i in (0, 1, 4) for j in (1, 2, 3)])
