"""Several processes in one: threads that exchange arrays as those of mpiexec do, for what knows its communicator."""

import threading

import numpy as np

from isphcli.domain import communicator
from tests.domain.wires import wires


class Threads:
    """A `Communicator` of threads; raw: the wire of this one."""

    def __init__(self, raw, shared):
        self.rank, self.size, self.here, self.raw = raw.rank, raw.size, raw.size, raw
        self._values, self._barrier = shared

    def collect(self, value):
        self._values[self.rank] = value
        self._barrier.wait(20)
        found = list(self._values)
        self._barrier.wait(20)
        return found

    def first(self, value):
        return self.collect(value)[0]

    def gather(self, value):
        found = self.collect(value)
        return found if self.rank == 0 else None

    def sum(self, value):
        return sum(self.collect(value))

    def max(self, value):
        return np.max(self.collect(value), axis=0)


def on_ranks(size, function):
    """What function(communicator) returns on each of `size` threads."""
    shared, found, errors = ([None] * size, threading.Barrier(size)), [None] * size, []

    def call(raw):
        try:
            found[raw.rank] = function(Threads(raw, shared))
        except BaseException as error:
            errors.append(error)
            shared[1].abort()

    threads = [threading.Thread(target=call, args=(raw,)) for raw in wires(size)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise next((error for error in errors if not isinstance(error, threading.BrokenBarrierError)), errors[0])
    return found


class _Here:
    """The communicators of this thread, the last of which is the current one."""

    def __init__(self):
        self.of_thread = threading.local()

    def __getitem__(self, place):
        return self.of_thread.ranks


def on_threads(size, function):
    """The same where functions ask for `communicator.current`."""
    known, here = communicator._current, _Here()

    def call(ranks):
        here.of_thread.ranks = ranks
        return function(ranks)

    communicator._current = here
    try:
        return on_ranks(size, call)
    finally:
        communicator._current = known
