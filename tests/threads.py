"""Compiled kernels on another number of threads."""

from contextlib import contextmanager

import numba

from isphcli.domain import row_threads


def on_threads(monkeypatch, compute):
    """What compute() returns on 1, 2, 3 and 8 threads, in ranges of 16 rows and more (blocks of rows keep their size):
    a test has too few rows for FEWEST, and the machine may have one core."""
    monkeypatch.setattr(row_threads, "FEWEST", 16)
    found = []
    for threads in (1, 2, 3, 8):
        monkeypatch.setattr(row_threads, "get_num_threads", lambda threads=threads: threads)
        found.append(compute())
    return found


@contextmanager
def one_thread():
    """The block runs on one thread; afterwards the number is what it was."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)
