"""One process, and several that cannot work together. Several that do: tests/test_ranks.py."""

import sys

import pytest

from isphcli.domain import communicator
from isphcli.domain.communicator import RanksError
from tests.domain.several import on_threads


def test_one_process_is_its_own_communicator():
    alone = communicator.current()
    assert (alone.rank, alone.size, alone.here) == (0, 1, 1)
    assert alone.sum(3.0) == 3.0 and alone.max(2) == 2 and alone.first("a") == "a"
    assert alone.collect("a") == alone.gather("a") == ["a"]
    assert communicator.join(1) is alone
    assert list(communicator.as_first(iter([1.5, 2.5]))) == [1.5, 2.5]


def test_errors_of_rank_0_are_raised():
    with pytest.raises(ZeroDivisionError):
        communicator.on_first(lambda: 1 / 0)
    assert communicator.on_first(lambda: 7) == 7


class Odd(ValueError):
    """One that is not built from its text."""

    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def test_an_error_of_one_is_raised_on_all():
    """The others get that of the first process that failed; without one each gets its own result."""
    assert on_threads(3, lambda ranks: communicator.on_any(lambda: ranks.rank)) == [0, 1, 2]

    def fails(ranks):
        def write():
            if ranks.rank > 0:
                raise OSError(28, f"full for rank {ranks.rank}")

        try:
            communicator.on_any(write)
        except OSError as error:
            return error.errno, error.strerror

    assert on_threads(3, fails) == [(28, "full for rank 1"), (28, "full for rank 1"), (28, "full for rank 2")]


def test_every_error_can_be_sent_to_other_processes():
    assert isinstance(communicator._for_others(OSError("full")), OSError)
    told = communicator._for_others(Odd("a", "b"))
    assert str(told) == "a and b" and isinstance(told, ValueError)


def test_several_processes_without_mpi4py_are_told_three_ways(monkeypatch):
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    with pytest.raises(RanksError, match="2 processes were started, and mpi4py is not there") as caught:
        communicator.join(2)
    assert all(way in str(caught.value) for way in ("apt-get install", "isphcli[mpi]", "modules of MPI"))
    assert communicator.current().size == 1


def test_a_launcher_of_another_mpi():
    """Four processes of one rank each would do the whole scene four times, into one folder."""
    communicator.refuse_other_launcher(4, 4)
    with pytest.raises(RanksError, match="4 processes were started, but mpi4py sees 1"):
        communicator.refuse_other_launcher(4, 1)
