"""Of one process, and of two that are threads; tests/test_ranks.py has operators of real ones."""

from dataclasses import replace

import numpy as np

from isphcli.domain.communicator import TRAFFIC
from isphcli.domain.exchange import NO_EXCHANGE, NeighbourExchange
from tests.domain.wires import counts, on_all, wires


def test_one_process_has_no_remote_particles():
    values = np.arange(6.0).reshape(3, 2)
    assert NO_EXCHANGE.forward(values) is values and NO_EXCHANGE.summed(values) is values and NO_EXCHANGE.remote == 0
    assert NO_EXCHANGE.numbers(3).tolist() == [0, 1, 2]


def two():
    """Particles 0, 1, 2 of the first process, of which the second sees 2 and 0, and 10, 11 of the second, of which the
    first sees 11; the remote ones of the second stand the other way round than they arrive."""
    a, b = wires(2)
    return (NeighbourExchange(a, np.array([2, 0]), counts(0, 2), counts(0, 1)),
            NeighbourExchange(b, np.array([1]), counts(1, 0), counts(2, 0), np.array([1, 0])))


def test_values_of_remote_particles():
    a, b = two()
    before = replace(TRAFFIC)
    first, second = on_all([lambda: a.forward(np.array([0.0, 1.0, 2.0])), lambda: b.forward(np.array([10.0, 11.0]))])
    assert first.tolist() == [0.0, 1.0, 2.0, 11.0] and second.tolist() == [10.0, 11.0, 0.0, 2.0]
    sent = TRAFFIC.messages - before.messages, TRAFFIC.sent - before.sent
    assert sent == (2, 24)  # bytes, of both: here they are threads of one


def test_several_arrays_go_in_one_message():
    """Of one particle each process sends all that it has of it: 8 bytes of a number, 2 of flags, 4 of an integer."""
    a, b = two()
    flags, whole = np.array([[True, False], [False, True], [True, True]]), np.array([7, 8, 9], np.int32)
    before = replace(TRAFFIC)
    first, second = on_all([lambda: a.forward_each(np.array([0.0, 1.0, 2.0]), flags, whole),
                            lambda: b.forward_each(np.array([10.0, 11.0]), flags[:2], whole[:2])])
    assert [part.tolist() for part in first] == [[0.0, 1.0, 2.0, 11.0], [*flags.tolist(), [False, True]], [7, 8, 9, 8]]
    assert [part.tolist() for part in second] == [
        [10.0, 11.0, 0.0, 2.0], [*flags[:2].tolist(), [True, False], [True, True]], [7, 8, 7, 9]]
    assert [part.dtype for part in second] == [float, bool, np.int32]
    assert (TRAFFIC.messages - before.messages, TRAFFIC.sent - before.sent) == (2, 42)


def test_sums_of_what_processes_have_for_a_particle():
    """Every process that sees a particle gets the sum of all that have something for it."""
    a, b = two()
    first, second = on_all([lambda: a.summed(np.array([[1, 1], [2, 0], [3, 0], [100, 5]])),
                            lambda: b.summed(np.array([[10, 0], [20, 0], [1000, 1], [3000, 0]]))])
    assert first.tolist() == [[1001, 2], [2, 0], [3003, 0], [120, 5]]
    assert second.tolist() == [[10, 0], [120, 5], [1001, 2], [3003, 0]]
