"""Loops over rows on all threads: a kernel takes a range of rows, and Python threads share the ranges out.

Compiled code with `nogil=True` does not hold other threads up. numba's own parallel loops do the same, but took
two to four times as long to compile as the serial loops in them (numba 0.68).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

from numba import get_num_threads

FEWEST = 512  # rows of a range: a call costs about 20 us, a row 0.05 us and more
RANGES = 4  # for each thread, so that none waits long for one with long rows


def over_rows(kernel: Callable[..., Any], n: int, *arguments: Any, work: Callable[[], Any] | None = None) -> list[Any]:
    """Calls kernel((begin, end), *arguments) for ranges that make up the rows 0 to n; returns what the calls return.

    A row must not depend on what another one writes: then results are the same for any number of threads. The kernel
    is compiled with nogil=True; without that the threads wait for each other. work: makes the scratch arrays of one
    call, which are handed to it behind the range; made in the kernel, they cost half a second to compile.
    """

    def call(rows: tuple[int, int]) -> Any:
        return kernel(rows, *arguments) if work is None else kernel(rows, work(), *arguments)

    threads = get_num_threads()
    ranges = min(RANGES * threads, n // FEWEST) if threads > 1 else 1
    if ranges < 2:
        return [call((0, n))]
    bounds = [(k * n // ranges, (k + 1) * n // ranges) for k in range(ranges)]
    return list(_pool(threads).map(call, bounds))


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="rows")
