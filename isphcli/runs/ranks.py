"""Runs on several processes: values and tables that rank 0 collects, and interrupts."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from ..domain.communicator import TRAFFIC, current
from ..domain.exchange import Exchange
from ..output.files import History
from ..output.machine import peak_memory

if TYPE_CHECKING:
    from ..output.clock import Clock


def entry(fluid: int, exchange: Exchange, clock: Clock) -> dict[str, Any]:
    """Entry `ranks` of the summary: (least, most) over the processes. fluid: particles of this one; clock: its seconds,
    without those of the compiler."""
    ranks, spent, sent = current(), clock.cpu(), TRAFFIC
    own = {"fluid": fluid, "remote": exchange.remote, "messages": sent.messages, "sent_bytes": sent.sent,
           "collectives": sent.collectives, "cpu_seconds": spent["total"] - spent.get("compile", 0.0),
           "waiting_seconds": sent.waited, "peak_memory_bytes": peak_memory()}
    of_all = ranks.collect(own)
    return {"count": ranks.size, **{name: [min(of[name] for of in of_all), max(of[name] for of in of_all)]
                                    for name in own}}


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
    """A table that rank 0 writes: a `History`; on the other ranks a `NoTable`."""
    return History(path, resume_step) if current().rank == 0 else NoTable()


@contextmanager
def interrupts() -> Iterator[Callable[[], None]]:
    """Yields a function that all processes call between two steps: it raises KeyboardInterrupt on all of them where one
    has received Ctrl-C or SIGTERM. A second such signal ends its process at once. With one process, or outside of the
    main thread, signals are handled as before."""
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
