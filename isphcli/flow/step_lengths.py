"""How long the next step may be: a run asks with what it sees of its flow, the check of a case with what it expects."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

VISCOUS = 8.0  # nu dt / dx^2 that resolves the decay of the flow in time; no limit of stability
# nu dt / dx^2 of the viscosity that the rotational term of eq. 4 lacks (`lacking_viscosity`): over so many steps
# the pressure makes up for it. Creeping flow does not know density, but air behind water in a corner of Berea, without
# tension, flowed twice as fast as at one density with 120, 1.5 times for a while with 19, and 4 % more slowly with 4
# (docs/design_notes.md, pressure update)
LACKING = 4.0
# The first step, as a part of what the limits allow, and the growth of the steps after it (second order needs less
# than 2.41). A wall that sets fluid in motion at once makes a layer that grows with the square root of time: only steps
# that stay a fifth of the time since the start resolve it.
FIRST, STEP_GROWTH = 1.0 / 16.0, 2.0
FIRST_AT_WALLS, GROWTH_AT_WALLS = 1.0 / 64.0, 1.25


@dataclass(frozen=True)
class StepLengths:
    """What bounds the steps of a run.

    fixed: of `time.step`, s, or None; reach: how far a particle may move in a step, m; viscous: VISCOUS dx^2 / nu of
    the least viscous fluid, s; steady: the run is to a steady state, and the decay of what comes before it counts only
    where nothing else does; capillary: s, of the tension, or None; walls: whether there are any; pressure: LACKING
    dx^2 / nu of the viscosity that the rotational term lacks, s, or None.
    """

    fixed: float | None
    reach: float
    viscous: float
    steady: bool
    capillary: float | None
    walls: bool
    pressure: float | None = None

    def limits(self, speed: float, acceleration: float, dt_old: float,
               follow: Callable[[float], float] | None = None) -> dict[str, float]:
        """{name: step} of everything that bounds the next step, s.

        speed: of the fastest particle, m/s; acceleration: of the one that is accelerated most, m/s2; dt_old: of the
        step before, s, 0 at the start; follow(dt): the step of at most dt that follows a drive that changes with time.
        """
        found = {}
        if self.fixed is not None:
            found["step"] = self.fixed
        else:
            # u dt + a dt^2 / 2 = cfl dx
            root = speed + math.sqrt(speed * speed + 2.0 * acceleration * self.reach)
            if root > 0.0:
                found["cfl"] = 2.0 * self.reach / root
            if not self.steady or not found:
                found["viscous"] = self.viscous
            if self.pressure is not None:
                found["pressure"] = self.pressure
            if follow is not None:
                found["drive"] = follow(min(found.values()))
            if self.capillary is not None:
                found["capillary"] = self.capillary
        if dt_old:
            found["start"] = (GROWTH_AT_WALLS if self.walls else STEP_GROWTH) * dt_old
        else:
            found = {"start": (FIRST_AT_WALLS if self.walls else FIRST) * min(found.values())}
        return found


def shortest(limits: dict[str, float], target: float) -> tuple[float, str]:
    """(length, name of its limit) of the next step, s, where something is due in `target`, s."""
    limit = min(limits, key=limits.__getitem__)
    dt = limits[limit]
    if dt > target * (1.0 - 1e-9):
        dt, limit = target, "end"
    elif dt > 0.5 * target:
        dt = 0.5 * target  # two equal steps instead of a long and a very short one
    return dt, limit


def next_due(time: float, every: float | None) -> float:
    """When what is done `every` so many seconds is due next after `time`, s, from the time alone: a run that goes on
    from a restart file finds the same number."""
    return math.inf if every is None else (math.floor(time / every * (1.0 + 1e-9)) + 1.0) * every
