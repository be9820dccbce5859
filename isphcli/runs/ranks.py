"""Runs on several processes: what is refused, and what rank 0 has to know of the others."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.yaml import CaseError, Problem
from ..domain.communicator import current
from ..domain.exchange import Exchange, NeighbourExchange
from ..output.files import History
from ..output.machine import peak_memory

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..references.result import Result

ONE = "run it in one process (isph run, without mpiexec; --threads takes the cores of one machine)"
BY_PERMEABILITY = ("permeability", "sphere_array", "cylinder_array")  # references that need no field of the flow


def refuse_what_is_not_distributed(case: Case) -> None:
    """Raises CaseError where several processes run a case that only one can."""
    problems = not_distributed(case, current().size) if current().size > 1 else []
    if problems:
        raise CaseError(tuple(problems))


def not_distributed(case: Case, count: int) -> list[Problem]:
    """What stands against a run of a case on so many processes, more than one."""
    problems = []

    def bad(key: str, what: str, fix: str = ONE) -> None:
        problems.append(Problem(str(case.path), None, key, f"{what} on {count} processes", fix))

    if case.flow == "stokes" and case.particles.jitter > 0.0:
        bad("particles.jitter", "no jitter in steady flow", "leave it out, or " + ONE)
    if case.output.snapshots and case.output.format == "xdmf":
        bad("output.format", "no snapshots as HDF5 with XDMF", "leave it out (particles.pvd has the flow), or " + ONE)
    if case.output.grid is not None:
        bad("output.grid", "no snapshots on a grid", "leave it out (particles.pvd has the flow), or " + ONE)
    if case.geometry.voxels is not None and case.geometry.voxels.grey is not None and (
            case.geometry.voxels.grey.uncertainty):
        bad("geometry.voxels.grey.uncertainty", "no other thresholds", "leave it out, or " + ONE)
    return problems


def entry(fluid: int, exchange: Exchange) -> dict[str, Any]:
    """Entry `ranks` of the summary: (least, most) of what the processes have. fluid: particles of this one."""
    ranks = current()
    sent = exchange.sent if isinstance(exchange, NeighbourExchange) else 0
    of_all = np.array(ranks.collect((fluid, exchange.remote, sent, peak_memory())))
    least, most = of_all.min(axis=0).tolist(), of_all.max(axis=0).tolist()
    names = ("fluid", "remote", "sent_bytes", "peak_memory_bytes")
    return {"count": ranks.size, **{name: [low, high] for name, low, high in zip(names, least, most)}}


def whole(case: Case, result: Result) -> Result:
    """The result that a reference is compared with: where it needs fields, those of all processes on rank 0, the one
    array of the length of the scene that a run has."""
    if current().size == 1 or case.reference is None or case.reference.kind in BY_PERMEABILITY:
        return result
    fields: dict[str, Any] = {}
    for name in ("x", "velocity", "cell_velocity", "pressure", "phase"):
        found = current().gather(getattr(result, name))
        fields[name] = getattr(result, name) if found is None else np.concatenate(found)
    return replace(result, **fields)


NO_PICTURES = "no pictures and no report.html: several processes draw none"


class NoTable(History):
    """A table on the processes that write none."""

    def __init__(self) -> None:
        self.rows = 0

    def append(self, row: Mapping[str, Any]) -> None:
        """Nothing."""

    def sync(self) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


def table(path: Path, resume_step: int | None) -> History:
    """A table that rank 0 writes: its `History`, on the other ranks one that writes nothing."""
    return History(path, resume_step) if current().rank == 0 else NoTable()


@contextmanager
def interrupts() -> Iterator[Callable[[], None]]:
    """A function that all processes call between two steps: it raises KeyboardInterrupt on all of them where one was
    told to stop (Ctrl-C, SIGTERM) since. The second time such a signal ends its process at once. Of one process, or
    outside of the main thread, signals are what they were."""
    if current().size == 1 or threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    told: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        if told:
            raise KeyboardInterrupt
        told.append(number)

    def look() -> None:
        if current().max(len(told)):
            raise AllInterrupted

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield look
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class AllInterrupted(KeyboardInterrupt):
    """Raised on all processes in the same place."""
