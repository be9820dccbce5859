"""Loops over rows on all threads: a kernel takes a range of rows, and Python threads share the ranges out.

Compiled code with `nogil=True` does not hold other threads up. numba's own parallel loops do the same, but took
two to four times as long to compile as the serial loops in them (numba 0.68).

The calling thread computes ranges too, and waits only for those that others have begun: where these come late, because
they sleep or because other programs have the cores, it computes all of them.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable
from itertools import accumulate
from operator import itemgetter
from queue import SimpleQueue
from threading import Thread, local
from typing import Any
from weakref import ReferenceType, ref

import numpy as np
from numba import get_num_threads

# LLVM vectorises a sum only if it may reorder it. NaN and infinity keep their meaning (no nnan, no ninf).
REDUCE = {"reassoc", "contract", "nsz"}
APART = 64  # entries between scratch arrays: more than a vectorised loop takes at once
# rows of a range: a row takes 0.03 us and more, and ranges that another thread shares 15 to 20 us
# (`benchmarks/serial_share.py machine`, 2026-12-01)
FEWEST = 2048
# of a block, at least: several layers of a lattice of 48^3, whose rows then hardly leave their block
ROWS = 8192
BLOCKS = 64  # at most: enough for the threads of a machine. What is found by blocks does not depend on these
RANGES = 2  # ranges per thread, so that no thread waits long for one with long rows


def threads_here() -> int:
    """Threads that a loop begun by this thread is shared between: of a helper its own alone. numba tells the number
    under a lock of the process, which stays locked for good where an interrupt comes while it is taken: helpers, which
    get no interrupts, would wait for it and the loop for them."""
    return 1 if getattr(_THIS, "helps", False) else get_num_threads()


def over_rows(kernel: Callable[..., Any], n: int, *arguments: Any, work: Callable[[], Any] | None = None) -> list[Any]:
    """Calls kernel((begin, end), *arguments) for ranges that make up the rows 0 to n; returns what the calls return.

    A row must not depend on values that another one writes: then results are the same for any number of threads. The
    kernel is compiled with nogil=True; without that the threads wait for each other. work: makes the scratch arrays of
    one call, which are its arguments behind the range; arrays made in a kernel take half a second to compile.
    """

    def call(rows: tuple[int, int]) -> Any:
        return kernel(rows, *arguments) if work is None else kernel(rows, work(), *arguments)

    if n < 2 * FEWEST:  # one range on any number of threads, and to ask numba for that takes 2 us
        return [call((0, n))]
    threads = threads_here()
    return _share_out(call, cut(n, min(RANGES * threads, n // FEWEST) if threads > 1 else 1), threads)


def over_slices(function: Callable[[slice], Any], n: int) -> list[Any]:
    """As `over_rows`, of a function of numpy that takes the rows as a slice."""
    return over_rows(lambda rows: function(slice(*rows)), n)


def counted_rows(n: int, find: Callable[..., Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(data, index, first) of a sparse matrix of n rows whose lengths are not known: find(False, first, index, data)
    puts the numbers of their entries into first[1:], (n,), find(True, first, index, data) these at their places."""
    first, index, data = np.zeros(n + 1, np.int32), np.empty(0, np.int32), np.empty(0)
    find(False, first, index, data)
    np.cumsum(first, out=first)
    index, data = np.empty(first[-1], np.int32), np.empty(first[-1])
    find(True, first, index, data)
    return data, index, first


def in_one_piece(*shapes: tuple[int, ...]) -> list[np.ndarray]:
    """Scratch arrays of these shapes, one behind the other in memory. A vectorised loop over several arrays checks
    whether they overlap before it takes several entries at once, and so chooses the order of its sums: the last digits
    of these would depend on the addresses of arrays that are allocated one by one."""
    sizes = [math.prod(shape) for shape in shapes]
    places = [0, *accumulate(-(-size // APART) * APART + APART for size in sizes)]
    piece = np.empty(places[-1])
    return [piece[at : at + size].reshape(shape) for at, size, shape in zip(places, sizes, shapes)]


def edges_of(n: int, least: int = ROWS) -> np.ndarray:
    """Where blocks of n rows begin, and n: for `over_blocks`; least: rows of a block."""
    return np.linspace(0, n, 1 + min(max(n // least, 1), BLOCKS)).astype(np.int64)


def over_blocks(kernel: Callable[..., Any], edges: np.ndarray, *arguments: Any) -> None:
    """Calls kernel((first, last), edges, *arguments) for ranges of blocks of rows.

    edges: (blocks + 1,) int64, block k has the rows from edges[k] to edges[k + 1].

    A row may depend on the rows of its own block: results depend on the blocks, not on the threads that share them out.
    """
    blocks = len(edges) - 1
    if blocks < 2:
        kernel((0, blocks), edges, *arguments)
        return
    threads = threads_here()
    ranges = min(RANGES * threads, blocks) if threads > 1 else 1
    _share_out(lambda rows: kernel(rows, edges, *arguments), cut(blocks, ranges), threads)


def over_parts(function: Callable[[tuple[int, int]], Any], parts: list[tuple[int, int]]) -> list[Any]:
    """function((begin, end)) of each part, in their order. It is no kernel, but most of its time is in functions that
    do not hold up other threads, such as SciPy's products of sparse matrices."""
    return _share_out(function, parts, threads_here()) if len(parts) > 1 else [function(part) for part in parts]


def cut(n: int, parts: int) -> list[tuple[int, int]]:
    """The rows 0 to n in so many ranges (begin, end)."""
    return [(k * n // parts, (k + 1) * n // parts) for k in range(parts)]


def _share_out(call: Callable[[tuple[int, int]], Any], ranges: list[tuple[int, int]], threads: int) -> list[Any]:
    if threads == 1 or len(ranges) == 1:
        return [call(rows) for rows in ranges]
    job = _Job(call, ranges)
    for _ in range(_helpers(min(threads, len(ranges)) - 1)):
        _JOBS.put(ref(job))  # a helper that comes late finds none, and the arrays of a loop are free when it has ended
    try:
        job.work()
        return job.results()
    finally:
        job.left.clear()  # of an interrupt: nobody begins another range, nor is waited for


class _Job:
    """A call of each of some ranges, by whichever threads `work` on it. Deques and queues are safe between threads."""

    def __init__(self, call: Callable[[tuple[int, int]], Any], ranges: list[tuple[int, int]]):
        self.call, self.ranges = call, ranges
        self.left = deque(range(len(ranges)))
        self.done: SimpleQueue[tuple[int, Any, Exception | None]] = SimpleQueue()

    def work(self) -> None:
        """Computes ranges until none is left that no thread has begun."""
        while True:
            try:
                k = self.left.popleft()
            except IndexError:
                return
            found, error = None, None
            try:
                found = self.call(self.ranges[k])
            except Exception as raised:  # the thread that asked raises it; interrupts come to no other
                error = raised
            self.done.put((k, found, error))

    def results(self) -> list[Any]:
        """What the calls return, in the order of the ranges, once all are done; raises what one of them raised."""
        found = sorted((self.done.get() for _ in self.ranges), key=itemgetter(0))
        for _, _, error in found:
            if error is not None:
                raise error
        return [value for _, value, _ in found]


_JOBS: SimpleQueue[ReferenceType[_Job]] = SimpleQueue()
_HELPERS: list[Thread] = []
_THIS = local()  # helps: whether this thread is a helper


def _helpers(wanted: int) -> int:
    """So many; starts the threads that are missing, which end with the process."""
    while len(_HELPERS) < wanted:
        thread = Thread(target=_help, name="rows", daemon=True)
        thread.start()
        _HELPERS.append(thread)
    return wanted


def _help() -> None:
    _THIS.helps = True
    while True:
        job = _JOBS.get()()
        if job is not None:
            job.work()
        del job


def _begin_without_helpers() -> None:
    """In a process that was forked: its helpers are threads of the other one."""
    global _JOBS
    _JOBS = SimpleQueue()
    _HELPERS.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_without_helpers)
