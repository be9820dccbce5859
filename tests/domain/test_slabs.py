"""An array that processes share by layers is the array of one process, whatever is asked of it."""

import numpy as np
import pytest

from isphcli.domain.slabs import Slabs
from tests.domain.several import on_ranks

ARRAY = np.random.default_rng(0).random((5, 7, 6))
SIZES = [1, 2, 3, 6]  # more processes than layers too


def own(values, slabs):
    return values[slice(*slabs.own)]


def joined(size, function, axis=0):
    """The parts of an array that function(communicator) returns on each process, put together."""
    return np.concatenate(on_ranks(size, function), axis=axis)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_functions_of_whole_lines(size, axis):
    """Sums along a line need all of it."""

    def summed(ranks):
        slabs = Slabs(ARRAY.shape, ranks=ranks)
        return slabs.along(own(ARRAY, slabs), axis, lambda lines: np.cumsum(lines, axis=axis))

    assert (joined(size, summed) == np.cumsum(ARRAY, axis=axis)).all()


@pytest.mark.parametrize("size", SIZES)
def test_turned_layers_are_parts_of_lines(size):
    def turned(ranks):
        slabs = Slabs(ARRAY.shape, ranks=ranks)
        found = slabs.turned(own(ARRAY, slabs))
        assert found.shape == ARRAY[:, slabs.columns].shape and (slabs.back(found) == own(ARRAY, slabs)).all()
        return found

    assert (joined(size, turned, axis=1) == ARRAY).all()


@pytest.mark.parametrize("size", SIZES)
def test_boxes_of_all_processes(size):
    """Beyond the faces, more than once round, empty ones, and another one for each process."""

    def boxes(ranks):
        slabs = Slabs(ARRAY.shape, ranks=ranks)
        for first, end in (((-2, 1, -7), (8, 4, 14)), ((ranks.rank, 0, 0), (ranks.rank + 2, 7, 6)), ((3, 2, 1),) * 2):
            index = np.ix_(*(np.mod(np.arange(a, b), n) for a, b, n in zip(first, end, ARRAY.shape)))
            assert (slabs.box(own(ARRAY, slabs), first, end) == ARRAY[index]).all()

    on_ranks(size, boxes)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("repeats", [True, False])
def test_layers_of_others_beside_the_own_ones(size, repeats):
    def beside(ranks):
        slabs = Slabs(ARRAY.shape, ranks=ranks)
        found, first = slabs.beside(own(ARRAY, slabs), 2, 1, repeats)
        low, high = slabs.own
        at = np.arange(low - 2, high + 1) if low < high else np.arange(low, low)
        at = at if repeats else at[(at >= 0) & (at < len(ARRAY))]
        assert (found == ARRAY[np.mod(at, len(ARRAY))]).all() and (not len(at) or first == at[0])

    on_ranks(size, beside)


@pytest.mark.parametrize("size", SIZES)
def test_parts_and_margins(size):
    """Layers beside the ends belong to the first and the last process; a part belongs to who has its layers."""
    part, widths = (slice(1, 4), slice(0, 7), slice(2, 5)), [(3, 1), (0, 0), (2, 0)]

    def inner(ranks):
        slabs = Slabs(ARRAY.shape, ranks=ranks)
        found, of_part = slabs.part(own(ARRAY, slabs), part)
        assert of_part.shape == ARRAY[part].shape and len(found) == of_part.own[1] - of_part.own[0]
        return found

    def outer(ranks):
        slabs = Slabs(ARRAY.shape, ranks=ranks)
        found, grown = slabs.padded(own(ARRAY, slabs), widths, -1.0), slabs.grown(widths)
        assert found.shape == (grown.own[1] - grown.own[0], *grown.shape[1:])
        return found

    assert (joined(size, inner) == ARRAY[part]).all()
    assert (joined(size, outer) == np.pad(ARRAY, widths, constant_values=-1.0)).all()


def test_a_single_layer_has_no_layers_beside_it():
    flat = ARRAY[:1]
    for found, first in on_ranks(2, lambda ranks: Slabs(flat.shape, ranks=ranks).beside(
            own(flat, Slabs(flat.shape, ranks=ranks)), 2, 2, True)):
        assert len(found) in (0, 1) and first == 0
