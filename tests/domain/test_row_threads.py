import os
import weakref
from contextlib import suppress
from itertools import pairwise
from threading import Barrier, Event, current_thread

import numpy as np
import pytest
from numba import njit

from isphcli.domain import row_threads
from isphcli.domain.row_threads import FEWEST, over_parts, over_rows

from ..threads import on_threads, one_thread


@njit(nogil=True)
def mark(rows, work, out):
    """Counts how often a row was seen; work: one number, how many rows this call has seen before."""
    for i in range(rows[0], rows[1]):
        out[i] += 1
        work[0] += 1
    return work[0]


@pytest.mark.parametrize("n", [0, 1, FEWEST, 20 * FEWEST + 3])
def test_every_row_is_seen_once_with_scratch_of_its_own_call(n):
    out = np.zeros(n, np.int64)
    seen = over_rows(mark, n, out, work=lambda: np.zeros(1, np.int64))
    assert np.array_equal(out, np.ones(n)) and sum(seen) == n


def test_one_thread_makes_one_call():
    with one_thread():
        assert over_rows(mark, 20 * FEWEST, np.zeros(20 * FEWEST, np.int64), work=lambda: np.zeros(1, np.int64)) == [
            20 * FEWEST]


@pytest.mark.parametrize("threads", [1, 3])
def test_what_a_kernel_raises_comes_out(monkeypatch, threads):
    def fails(rows):
        raise ValueError("row")

    monkeypatch.setattr(row_threads, "get_num_threads", lambda: threads)
    with pytest.raises(ValueError, match="row"):
        over_rows(fails, 20 * FEWEST)
    assert sum(end - begin for begin, end in over_rows(lambda rows: rows, 20 * FEWEST)) == 20 * FEWEST


def test_an_interrupt_waits_for_no_range(monkeypatch):
    """Neither for those that are left, nor for one that a helper has begun."""
    monkeypatch.setattr(row_threads, "get_num_threads", lambda: 2)
    asked, begun, interrupted, calls = current_thread(), Event(), Event(), []

    def call(part):
        calls.append(part)
        if current_thread() is asked:
            begun.wait(10)
            raise KeyboardInterrupt
        begun.set()
        interrupted.wait(10)

    with pytest.raises(KeyboardInterrupt):
        over_parts(call, [(k, k + 1) for k in range(8)])
    assert len(calls) == 2
    interrupted.set()


def test_what_calls_return_is_in_the_order_of_their_ranges(monkeypatch):
    for found in on_threads(monkeypatch, lambda: over_rows(lambda rows: rows, 1000)):
        assert found[0][0] == 0 and found[-1][1] == 1000
        assert all(first[1] == second[0] for first, second in pairwise(found))


def test_a_loop_in_a_range_of_another_ends(monkeypatch):
    """All threads are in the outer loop: the inner ones have nobody but themselves."""
    def inner(rows):
        return sum(end - begin for begin, end in over_rows(lambda part: part, 640))

    for found in on_threads(monkeypatch, lambda: over_rows(inner, 640)):
        assert set(found) == {640}


def test_a_loop_that_has_ended_holds_no_arrays(monkeypatch):
    """Helpers that never come stand for those that come late."""
    monkeypatch.setattr(row_threads, "_helpers", lambda wanted: wanted)
    rows = np.zeros(20 * FEWEST, np.int64)
    known = weakref.ref(rows)
    on_threads(monkeypatch, lambda: over_rows(mark, len(known()), known(), work=lambda: np.zeros(1, np.int64)))
    del rows
    assert known() is None


def test_helpers_ask_numba_for_no_number_of_threads(monkeypatch):
    asked = []
    monkeypatch.setattr(row_threads, "get_num_threads", lambda: asked.append(current_thread()) or 2)
    both = Barrier(2)  # each of two ranges waits for the other to begin

    def outer(part):
        both.wait(10)
        return over_rows(lambda rows: rows, 20 * FEWEST)

    over_parts(outer, [(0, 1), (1, 2)])
    assert set(asked) == {current_thread()}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
@pytest.mark.filterwarnings("ignore:.*fork")
def test_a_forked_process_has_helpers_of_its_own(monkeypatch):
    """The threads of the process that it is a copy of are not there; a range of each of two threads waits for both."""
    monkeypatch.setattr(row_threads, "get_num_threads", lambda: 2)

    def share_out():
        both = Barrier(2)
        return over_parts(lambda part: both.wait(10) in (0, 1), [(0, 1), (1, 2)])

    share_out()
    child = os.fork()
    if child == 0:
        held = False
        with suppress(Exception):
            held = all(share_out())
        os._exit(0 if held else 1)
    assert os.waitpid(child, 0)[1] == 0
