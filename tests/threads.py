"""Compiled kernels on another number of threads."""

from contextlib import contextmanager

import numba


@contextmanager
def one_thread():
    """The block runs on one thread; afterwards the number is what it was."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)
