"""Bricks of equal numbers of particles: all on one process, which takes itself for one of several."""

import numpy as np
import pytest

from isphcli.domain import communicator
from isphcli.domain.cut import Cut, even_bricks


class Pretended(communicator.Alone):
    """One that holds all particles, so that sums over processes are its own."""

    def __init__(self, size):
        self.size = size


@pytest.fixture
def processes(monkeypatch):
    return lambda size: monkeypatch.setattr(communicator, "_current", [Pretended(size)])


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("box", [[1.0, 1.0, 1.0], [40.0, 1.0, 0.01], [1e-6, 3e-6]])
def test_bricks_tile_the_box_and_share_the_particles(processes, size, box):
    """Elongated and thin boxes too; clouds that are denser on one side. Places of cuts are good to 1e-9 of an edge."""
    processes(size)
    box = np.array(box)
    x = np.random.default_rng(size).random((3000, len(box))) ** 3 * box
    cut = Cut(x, np.zeros(len(box)), box)
    assert cut.bricks.shape == (size, 2, len(box))
    volumes = np.prod(cut.bricks[:, 1] - cut.bricks[:, 0], axis=1)
    assert volumes.min() > 0.0 and volumes.sum() == pytest.approx(np.prod(box), rel=1e-12)
    owner = cut.owner(x)
    inside = (x >= cut.bricks[owner, 0]) & (x <= cut.bricks[owner, 1])
    assert inside.all()
    counts = np.bincount(owner, minlength=size)
    # a half more or less at each level of the tree, where numbers are odd
    assert counts.sum() == 3000 and np.abs(counts - 3000 / size).max() <= 4


def test_a_place_on_a_cut_has_one_owner(processes):
    """The upper brick, and beyond the box the brick next to it: dummies lie there."""
    processes(2)
    x = np.linspace(0.005, 0.995, 100)[:, None] * [1.0, 0.1]
    cut = Cut(x, np.zeros(2), np.array([1.0, 0.1]))
    place = cut.bricks[1, 0, 0]
    assert cut.owner(np.array([[place, 0.0], [np.nextafter(place, 0.0), 0.0], [-1.0, 5.0], [2.0, -5.0]])).tolist() == [
        1, 0, 0, 1]


def test_more_processes_than_particles(processes):
    """Some have none."""
    processes(7)
    x = np.full((2, 3), 0.5) + [[0.0, 0, 0], [0.1, 0, 0]]
    cut = Cut(x, np.zeros(3), np.ones(3))
    assert len(cut.bricks) == 7 and np.bincount(cut.owner(x), minlength=7).max() == 1


@pytest.mark.parametrize("size", [2, 3, 7, 8])
def test_bricks_of_an_even_fluid_are_those_of_the_cut(processes, size):
    """To a spacing of the lattice: planes are not cut, and the first cut moves the ones after it."""
    processes(size)
    lower, upper, spacing = np.array([-1.0, 0.0, 0.0]), np.array([2.1, 2.0, 1.0]), 0.02
    axes = [np.arange(a + 0.5 * spacing, b, spacing) for a, b in zip(lower, upper)]
    x = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    bricks = even_bricks(lower, upper, size)
    assert np.abs(bricks - Cut(x, lower, upper).bricks).max() <= spacing
    assert np.prod(bricks[:, 1] - bricks[:, 0], axis=1) == pytest.approx(6.2 / size)


@pytest.mark.parametrize("planes", [10, 11])
def test_a_cut_passes_between_planes_of_a_lattice(processes, planes):
    """A cut on a plane gave it to the upper brick whatever that had: of ten planes four to the lower one."""
    processes(2)
    x = np.repeat((np.arange(planes) + 0.5) / planes, 7)[:, None]
    counts = np.bincount(Cut(x, np.zeros(1), np.ones(1)).owner(x)) // 7
    assert sorted(counts) == [planes // 2, planes - planes // 2]
