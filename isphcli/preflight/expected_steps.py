"""The steps that a run would take: those that the time loop chooses, of a flow that is expected instead of solved."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..case import forcing
from ..flow.step_lengths import StepLengths, next_due, shortest
from ..runs.steadiness import Steady
from ..scene.choose_steps import step_lengths
from .check_result import Motion, Steps

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry

# Steps that are taken one by one, 2 us each (5 ms with a drive that changes with time); those after them
# take the length of the last. The record of a run to a steady state takes 60 us per step
MOST, MOST_FOLLOWED, MOST_TO_STEADY = 20_000, 400, 5_000


@dataclass
class _Taken:
    """Steps that have been taken, by the limit of each; time, s, and the length dt of the last, s."""

    taken: Counter[str]
    time: float = 0.0
    dt: float = 0.0

    @property
    def count(self) -> float:
        """Steps that have been taken."""
        return float(self.taken.total())

    def take(self, lengths: StepLengths, motion: Motion, target: float,
             follow: Callable[[float], float] | None) -> None:
        """The next step, where something is due in `target`, s."""
        speed = motion.speed(self.time)
        acceleration = (abs(speed - motion.speed(self.time - self.dt)) / self.dt if self.dt else motion.acceleration)
        dt, limit = shortest(lengths.limits(speed, acceleration, self.dt, follow), target)
        self.taken[limit] += 1
        self.time += dt
        self.dt = dt


def expected_steps(case: Case, geometry: Geometry, motion: Motion, fluids: list[str], decay: float | None) -> Steps:
    """Steps of a run in time. motion: the flow that is expected; fluids: names of those that are there; decay: time in
    which the flow comes nearer to its steady value by a factor e, s, or None."""
    time, there = case.time, [case.fluids[name] for name in fluids]
    assert time is not None
    lacking = 0.0
    if len(there) == 2:
        from ..two_phase.interface_rules import lacking_viscosity

        lacking = lacking_viscosity([f.density for f in there], [f.density * f.nu for f in there])
    lengths = step_lengths(case, min(f.nu for f in there), _capillary_step(case, fluids), geometry.has_solid, lacking)
    drive, end = None if time.step else _timed_drive(case, geometry), forcing.longest_time(case)
    end = math.inf if end is None else end
    run, most = _Taken(Counter()), MOST if drive is None else MOST_FOLLOWED
    record = None
    if time.steady is not None and decay is not None:
        record, most = Steady(), MOST_TO_STEADY
    while run.time < end * (1.0 - 1e-12) and run.count < min(most, time.max_steps):
        now = run.time
        target = min(end, next_due(now, case.output.every), next_due(now, _window(case))) - now
        run.take(lengths, motion, target, None if drive is None else _from(drive, now, end - now))
        if record is not None:
            record.add(run.time, -math.expm1(-run.time / decay))  # type: ignore[operator]  # both or none
            if record.distance is not None and record.distance < time.steady:  # type: ignore[operator]
                end = run.time
    count = run.count
    if run.time < end * (1.0 - 1e-12):  # as long as the last one
        count = min(count + (end - run.time) / run.dt, float(time.max_steps))
    limits = lengths.limits(motion.largest, 0.0, math.inf)
    del limits["start"]
    if drive is not None:
        limits["drive"] = run.dt
    steps = forcing.drive_steps(case)
    early = (steps is not None and steps.settled is not None) or (time.steady is not None and count > run.count)
    return Steps(limits, None if math.isinf(count) else count, run.taken["start"], early,
                 run.taken.most_common(1)[0][0])


def _from(drive: Callable[[float, float, float], float], time: float, left: float) -> Callable[[float], float]:
    """The step of at most dt from a time that follows a drive (`TimedDrive.limit`)."""
    return lambda dt: drive(time, dt, left)


def _window(case: Case) -> float | None:
    """Time between two looks at a drive in steps, s, or None."""
    steps = forcing.drive_steps(case)
    if steps is None:
        return None
    from ..runs.drive_steps import window_of

    return window_of(steps)


def _capillary_step(case: Case, fluids: list[str]) -> float | None:
    if case.interface is None or len(fluids) < 2:
        return None
    from ..two_phase.interface_rules import capillary_step

    return capillary_step([case.fluids[name].density for name in fluids], case.particles.spacing,
                          case.interface.tension)


def _timed_drive(case: Case, geometry: Geometry) -> Callable[[float, float, float], float] | None:
    if not forcing.changes(case):
        return None
    from ..scene.prepare import timed_drive

    return timed_drive(case, geometry).limit
