"""Wall and CPU seconds of named sections."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator


class Clock:
    """Wall and CPU seconds of named sections: `with clock("neighbours"): ...`

    CPU seconds are those of the process, all threads together. While an inner section runs the outer one is not
    counted, so that the sections add up to the total.
    """

    def __init__(self) -> None:
        self._names: list[str] = []
        self._spent: dict[str, tuple[float, float]] = {}
        self._start = self._mark = _now()

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Count the block under `name`."""
        self._lap()
        self._names.append(name)
        try:
            yield
        finally:
            self._lap()
            self._names.pop()

    def add(self, name: str, wall: float, cpu: float, taken_from: str | None = None) -> None:
        """Count seconds measured elsewhere (of a compiler, say), and subtract them from section `taken_from`."""
        for section, sign in ((name, 1), (taken_from, -1)):
            if section is not None:
                w, c = self._spent.get(section, (0.0, 0.0))
                self._spent[section] = (w + sign * wall, c + sign * cpu)

    def cpu(self) -> dict[str, float]:
        """CPU seconds by section, by first use; `other` is what no section holds; then `total`."""
        return self._split(1)

    def wall(self) -> dict[str, float]:
        """Wall seconds by section, as `cpu`."""
        return self._split(0)

    def _lap(self) -> None:
        now = _now()
        if self._names:
            w, c = self._spent.get(self._names[-1], (0.0, 0.0))
            self._spent[self._names[-1]] = (w + now[0] - self._mark[0], c + now[1] - self._mark[1])
        self._mark = now

    def _split(self, which: int) -> dict[str, float]:
        self._lap()
        split = {name: spent[which] for name, spent in self._spent.items()}
        total = self._mark[which] - self._start[which]
        return {**split, "other": max(total - sum(split.values()), 0.0), "total": total}


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()
