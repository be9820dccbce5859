"""The processes that share a scene: their number, and sums, extremes and lists over them.

`mpiexec -n 4 isph run case.yaml` starts four of them, ranks 0 to 3; without mpiexec there is one. All execute the same
statements, and a function that combines values of different particles uses `current()`. A function that only some ranks
call must not use it: these ranks would wait for the others for ever.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

INSTALL = """\
  a cluster with PETSc:  its modules of MPI and petsc4py, then pip install isphcli
  Debian, Ubuntu:        apt-get install python3-petsc4py-real python3-mpi4py, then isphcli in a venv with
                         --system-site-packages
  Linux, Python >= 3.12: pip install "isphcli[mpi]"
(docs/clusters.md)"""


class RanksError(ValueError):
    """Several processes that cannot work on one scene: what is missing or wrong, and what to do."""


@dataclass
class Traffic:
    """What this process has sent since its start; messages of PETSc are not counted.

    messages: to other processes, one by one; sent: bytes of these; collectives: sums and the like over all processes;
    waited: CPU s spent in messages and collectives, most of it in waiting for other processes.
    """

    messages: int = 0
    sent: int = 0
    collectives: int = 0
    waited: float = 0.0

    @contextmanager
    def counted(self, messages: int = 0, sent: int = 0, collectives: int = 0) -> Iterator[None]:
        """Counts what the block sends, sent: bytes."""
        self.messages, self.sent = self.messages + messages, self.sent + sent
        self.collectives += collectives
        begin = time.process_time()
        try:
            yield
        finally:
            self.waited += time.process_time() - begin


TRAFFIC = Traffic()


class Communicator(Protocol):
    """Operations of all processes. rank: number of this one, from 0; size: number of all; here: number on this machine.

    All ranks call these in the same order.
    """

    rank: int
    size: int
    here: int

    def sum(self, value: Any) -> Any:
        """Sum over the ranks of a number, or entry by entry of arrays of one shape."""
        ...

    def max(self, value: Any) -> Any:
        """Largest over the ranks of a number or of the entries of arrays."""
        ...

    def collect(self, value: Any) -> list[Any]:
        """The values of all ranks, on all of them."""
        ...

    def first(self, value: Any) -> Any:
        """The value of rank 0, on all of them."""
        ...

    def gather(self, value: Any) -> list[Any] | None:
        """The values of all ranks, on rank 0; None on the others."""
        ...


class Alone:
    """One process, which owns all particles."""

    rank, size, here = 0, 1, 1

    def sum(self, value: Any) -> Any:
        """The value."""
        return value

    max = first = sum

    def collect(self, value: Any) -> list[Any]:
        """A list of the value."""
        return [value]

    gather = collect


class Ranks:
    """Several processes, over an intracommunicator `raw` of mpi4py."""

    def __init__(self, raw: Any):
        from mpi4py import MPI

        self.raw, self.rank, self.size = raw, raw.rank, raw.size
        self.here = int(raw.Split_type(MPI.COMM_TYPE_SHARED).size)
        self._failing = raw.Dup()  # for `agree_to_fail`: nothing else is sent there
        self._sum, self._max = MPI.SUM, MPI.MAX

    def sum(self, value: Any) -> Any:
        """See `Communicator`."""
        return self._all_reduce(value, self._sum)

    def max(self, value: Any) -> Any:
        """See `Communicator`."""
        return self._all_reduce(value, self._max)

    def _all_reduce(self, value: Any, how: Any) -> Any:
        array = np.ascontiguousarray(value)
        out = np.empty_like(array)
        with TRAFFIC.counted(collectives=1):
            self.raw.Allreduce(array, out, op=how)
        return out if np.ndim(value) else out.reshape(())[()]

    def collect(self, value: Any) -> list[Any]:
        """See `Communicator`."""
        with TRAFFIC.counted(collectives=1):
            return self.raw.allgather(value)

    def first(self, value: Any) -> Any:
        """See `Communicator`."""
        with TRAFFIC.counted(collectives=1):
            return self.raw.bcast(value)

    def gather(self, value: Any) -> list[Any] | None:
        """See `Communicator`."""
        with TRAFFIC.counted(collectives=1):
            return self.raw.gather(value)

    def agree_to_fail(self, text: str, patience: float) -> list[str] | None:
        """The error messages of all ranks, where all of them fail within `patience` seconds; else None."""
        from time import monotonic, sleep

        everyone, until = self._failing.Ibarrier(), monotonic() + patience
        while not everyone.Test():
            if monotonic() > until:
                return None
            sleep(0.01)
        return self._failing.allgather(text)

    def abort(self, code: int) -> None:
        """Ends all ranks at once."""
        self.raw.Abort(code)


_current: list[Communicator] = [Alone()]


def current() -> Communicator:
    """The processes that share the scene of this one."""
    return _current[-1]


def join(wanted: int) -> Communicator:
    """Makes the processes that mpiexec has started the current ones, and returns them. wanted: how many it has started.

    Raises RanksError where mpi4py or petsc4py is missing, or where mpiexec belongs to another MPI than mpi4py: every
    process would take itself for the only one, and all would do the whole scene.
    """
    if wanted == 1 or current().size > 1:
        return current()
    try:
        import dolfinx_solver  # noqa: F401 - the wheel with PETSc needs its own MPI to be loaded first
    except ImportError:
        pass
    try:
        from mpi4py import MPI
    except ImportError as error:
        raise RanksError(f"{wanted} processes were started, and mpi4py is not there ({error}); to install it and "
                         f"PETSc:\n{INSTALL}") from None
    refuse_other_launcher(wanted, MPI.COMM_WORLD.size)
    _current.append(Ranks(MPI.COMM_WORLD))
    try:
        import petsc4py  # noqa: F401
    except ImportError as error:
        raise RanksError(f"the solves of {wanted} processes need PETSc, and petsc4py is not there ({error}); to "
                         f"install it:\n{INSTALL}") from None
    return current()


def refuse_other_launcher(wanted: int, size: int) -> None:
    """Raises RanksError where a launcher started another number of processes than MPI sees."""
    if wanted != size:
        raise RanksError(f"{wanted} processes were started, but mpi4py sees {size}: this mpiexec or srun belongs to "
                         "another MPI than mpi4py; take the mpiexec of that MPI (python -m mpi4py --version and "
                         "mpiexec --version say which they are), with Slurm srun --mpi=pmix or --mpi=pmi2")


def on_first(function: Callable[[], Any]) -> Any:
    """Calls a function on rank 0 alone; all ranks return its result or raise its error."""
    ranks = current()
    if ranks.size == 1:
        return function()
    found, error = None, None
    if ranks.rank == 0:
        try:
            found = function()
        except Exception as caught:  # it is raised below, on all ranks
            error = caught
    told = ranks.first(None if error is None else _for_others(error))
    if told is not None:
        raise error or told
    return ranks.first(found)


def on_any(function: Callable[[], Any]) -> Any:
    """Calls a function on all ranks, each of which returns its own result; where some fail, all raise the error of
    theirs or of the first of them. The function must not use `current()`."""
    found, error = None, None
    try:
        found = function()
    except Exception as caught:  # it is raised below, on all ranks
        error = caught
    told = [one for one in current().collect(None if error is None else _for_others(error)) if one is not None]
    if told:
        raise error or told[0]
    return found


def _for_others(error: Exception) -> Exception:
    """An error that can be sent to other ranks: a copy, or a RanksError of its text where pickle cannot copy it."""
    try:
        copy = pickle.loads(pickle.dumps(error))
        if str(copy) == str(error):
            return copy
    except Exception:  # whatever the constructor of another class makes of it
        pass
    return RanksError(str(error))


def as_first(values: Iterator[Any]) -> Iterator[Any]:
    """An iterator on all ranks over the values that rank 0 has."""
    nothing = None
    while (value := current().first(next(values, nothing) if current().rank == 0 else nothing)) is not nothing:
        yield value
