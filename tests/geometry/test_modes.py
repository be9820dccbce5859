"""Fields mode by mode."""

import itertools

import numpy as np
import pytest

from isphcli.domain.slabs import Slabs
from isphcli.geometry.modes import Modes
from tests.domain.several import on_ranks


@pytest.mark.parametrize("around", [(True, True, True), (False, True, False), (False, False, False)])
@pytest.mark.parametrize("shape", [(6, 8, 10), (5, 7, 9), (1, 8, 6)])
def test_all_of_every_mode_is_the_field(shape, around):
    field = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
    modes = Modes(shape, np.array(around))
    assert np.allclose(modes.filtered(field, np.ones_like(modes.square_frequencies(), np.float32)), field, atol=1e-5)
    assert modes.dim == 3 - shape.count(1)


@pytest.mark.parametrize("periodic", [True, False])
def test_frequencies_are_those_of_waves_and_cosines(periodic):
    """Minus the Laplacian of a wave is its square wave number times itself."""
    n, turns = 12, 2 if periodic else 1.5
    x = (np.arange(n) + 0.5) / n
    wave = np.cos(2 * np.pi * turns * x)[None, None] * np.ones((4, 5, 1))
    modes = Modes(wave.shape, np.array([periodic, True, True]))
    assert np.allclose(modes.filtered(wave, modes.square_frequencies()), (turns / n) ** 2 * wave, atol=1e-12)


@pytest.mark.parametrize("size", [2, 3, 6])
@pytest.mark.parametrize("around", list(itertools.product([True, False], repeat=3)))
def test_processes_filter_a_field_as_one_does(around, size):
    """Whichever axis has half of its waves, and where there are fewer lines than processes."""
    for shape in ((5, 7, 9), (6, 1, 4), (1, 8, 3)):
        field = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
        modes = Modes(shape, np.array(around))
        wanted = modes.filtered(field, (1.0 / (0.1 + modes.square_frequencies())).astype(np.float32))

        def part(ranks, shape=shape, field=field):
            slabs = Slabs(shape, ranks=ranks)
            own = Modes(shape, np.array(around), slabs)
            share = (1.0 / (0.1 + own.square_frequencies())).astype(np.float32)
            return own.filtered(field[slice(*slabs.own)].copy(), share)

        assert np.allclose(np.concatenate(on_ranks(size, part)), wanted, atol=1e-5)
