"""Loops over rows on all threads: a kernel takes a range of rows, and Python threads share the ranges out.

Compiled code with `nogil=True` does not hold other threads up. numba's own parallel loops do the same, but took
two to four times as long to compile as the serial loops in them (numba 0.68).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import accumulate
from typing import Any

import numpy as np
from numba import get_num_threads

# LLVM vectorises a sum only if it may reorder it. NaN and infinity keep their meaning (no nnan, no ninf).
REDUCE = {"reassoc", "contract", "nsz"}
APART = 64  # entries between scratch arrays: more than a vectorised loop takes at once
FEWEST = 4096  # rows of a range: to hand it to a thread costs about 50 us, a row 0.03 us and more
RANGES = 2  # ranges per thread, so that no thread waits long for one with long rows


def over_rows(kernel: Callable[..., Any], n: int, *arguments: Any, work: Callable[[], Any] | None = None) -> list[Any]:
    """Calls kernel((begin, end), *arguments) for ranges that make up the rows 0 to n; returns what the calls return.

    A row must not depend on values that another one writes: then results are the same for any number of threads. The
    kernel is compiled with nogil=True; without that the threads wait for each other. work: makes the scratch arrays of
    one call, which are its arguments behind the range; arrays made in a kernel take half a second to compile.
    """

    def call(rows: tuple[int, int]) -> Any:
        return kernel(rows, *arguments) if work is None else kernel(rows, work(), *arguments)

    if n < 2 * FEWEST:  # one range on any number of threads, and to ask numba for that takes 10 us
        return [call((0, n))]
    threads = get_num_threads()
    return _share_out(call, cut(n, min(RANGES * threads, n // FEWEST) if threads > 1 else 1), threads)


def in_one_piece(*shapes: tuple[int, ...]) -> list[np.ndarray]:
    """Scratch arrays of these shapes, one behind the other in memory. A vectorised loop over several arrays checks
    whether they overlap before it takes several entries at once, and so chooses the order of its sums: the last digits
    of these would depend on the addresses of arrays that are allocated one by one."""
    sizes = [math.prod(shape) for shape in shapes]
    places = [0, *accumulate(-(-size // APART) * APART + APART for size in sizes)]
    piece = np.empty(places[-1])
    return [piece[at : at + size].reshape(shape) for at, size, shape in zip(places, sizes, shapes)]


def over_blocks(kernel: Callable[..., Any], edges: np.ndarray, *arguments: Any) -> None:
    """Calls kernel((first, last), edges, *arguments) for ranges of blocks of rows.

    edges: (blocks + 1,) int64, block k has the rows from edges[k] to edges[k + 1].

    A row may depend on the rows of its own block: results depend on the blocks, not on the threads that share them out.
    """
    blocks = len(edges) - 1
    if blocks < 2:
        kernel((0, blocks), edges, *arguments)
        return
    threads = get_num_threads()
    ranges = min(RANGES * threads, blocks) if threads > 1 else 1
    _share_out(lambda rows: kernel(rows, edges, *arguments), cut(blocks, ranges), threads)


def cut(n: int, parts: int) -> list[tuple[int, int]]:
    """The rows 0 to n in so many ranges (begin, end)."""
    return [(k * n // parts, (k + 1) * n // parts) for k in range(parts)]


def _share_out(call: Callable[[tuple[int, int]], Any], ranges: list[tuple[int, int]], threads: int) -> list[Any]:
    if threads == 1 or len(ranges) == 1:
        return [call(rows) for rows in ranges]
    return list(_pool(threads).map(call, ranges))


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="rows")
