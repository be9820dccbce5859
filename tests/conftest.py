"""Threads as the command line sets them, before numpy and numba are imported."""

from isphcli.cli import set_threads

set_threads(None)
