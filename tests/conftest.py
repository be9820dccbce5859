"""Threads as the command line sets them, before numpy and numba are imported."""

import gc

import pytest

from isphcli.cli import set_threads

set_threads(None)


@pytest.fixture(scope="module", autouse=True)
def what_is_there_stays():
    """Python's search for cycles of references passes over what was there before a file of tests: over all kernels and
    syntax trees it took a twelfth of the time of all tests."""
    gc.collect(1)
    gc.freeze()
