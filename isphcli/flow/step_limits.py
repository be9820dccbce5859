"""The limits that a step must keep, and the errors of steps and runs that do not; `attempt` says what is tried then.

benchmarks/limits.py measures what good runs reach of each limit, and what runs that blow up do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry
    from .state import State, StepResult

# benchmarks/limits.py: what runs that ended well reached | runs that blew up, left alone, with an earlier scheme: at
# commit 511ac79 none of the scenes there does, with a shifting of 0.1 and of 0.3
GROWTH = 1.5  # of the root mean square speed over what energy allows; <= 1.01 | 5 to 1e14
DIVERGENCE = 0.5  # largest divergence times dt, the part of its volume that a particle gains; <= 0.34 | 0.3 to 1e27
VOLUME = (0.3, 1.8)  # of a particle, over that of a site: the inverse of the number density; 0.52 to 1.39 | 0.01, 2.3


class StepError(RuntimeError):
    """A step that broke a limit. Attribute `violation`: (n,) how far each particle is beyond it."""

    def __init__(self, message: str, violation: np.ndarray | None = None):
        super().__init__(message)
        self.violation = violation


class RunError(RuntimeError):
    """A run that had to stop. Attributes: `violation` of the particles, `restart` and `worst`, the files it left."""

    violation: np.ndarray | None = None
    restart: Path | None = None
    worst: Path | None = None


@dataclass(frozen=True)
class Bounds:
    """What no step may exceed.

    Incompressible flow gains kinetic energy only from what drives it: the root mean square speed is at most that of the
    start, plus force times time, plus the speed of the walls, plus the speed that surface tension gives fluid of the
    size of a spacing. The mean is weighted with the density.

    start: m/s; force: m/s2, of the fluid that is accelerated most; other: speed of walls and of surface tension, m/s;
    largest_force(time): of a force that changes, its largest value so far, m/s2, or None.
    """

    geometry: Geometry
    site_volume: float
    start: float
    force: float
    other: float
    largest_force: Callable[[float], float] | None = None

    @staticmethod
    def speed(u: np.ndarray, density: np.ndarray | float) -> float:
        """Root mean square speed of velocities (n, dim), weighted with the density, (n,) in any unit, or a number."""
        largest = reduce.largest(np.abs(u))
        if not 0.0 < largest < np.inf:  # squares of very small and very large speeds leave the range of numbers
            return largest
        square = ((u / largest) ** 2).sum(axis=1)
        return largest * np.sqrt(reduce.mean(square, np.broadcast_to(density, square.shape)))

    def check(self, old: State, found: StepResult, old_density: np.ndarray | float = 1.0) -> None:
        """Raises StepError where the step from the State `old` to the StepResult `found` broke a limit. old_density:
        `Terms.density` of the old state, whose particles other processes may own by now."""
        new, dt = found.state, found.dt
        for name, values in (("position", new.x), ("velocity", new.u), ("pressure", new.p)):
            bad = ~np.isfinite(values)
            bad = bad.any(axis=1) if values.ndim > 1 else bad
            if reduce.any_true(bad):
                raise StepError(f"the {name} of {reduce.count(bad)} particles is no longer a number", bad.astype(float))
        density = found.config.terms.density
        speed, size = self.speed(new.u, density), np.sqrt((new.u**2).sum(axis=1))
        force = self.force if self.largest_force is None else self.largest_force(new.time)
        before = (("of the step before", self.speed(old.u, old_density), dt), ("of the start", self.start, new.time))
        for since, begin, time in before:
            bound = GROWTH * (begin + force * time + self.other)
            if speed > bound:
                raise StepError(f"the mean speed is {speed:.3g}, but that {since}, the force and the walls allow "
                                f"{bound:.3g}", size)
        change = np.abs(found.divergence) * dt
        most = reduce.largest(change)
        if most > DIVERGENCE:
            raise StepError(f"a particle would change its volume by {most:.2g} of it (limit {DIVERGENCE})", change)
        volume, walls = found.config.ops.volume[: len(new.x)] / self.site_volume, found.config.ops.walls
        if walls is not None and walls.dead_ends:  # isolated particles have too few neighbours for a number density
            volume = np.where(walls.isolated, 1.0, volume)
        least, most = reduce.smallest(volume), reduce.largest(volume)
        if least < VOLUME[0] or most > VOLUME[1]:
            raise StepError(f"the volumes of particles range from {least:.2g} to {most:.2g} of that at "
                            f"the start (limits {VOLUME[0]} and {VOLUME[1]}): they clump or part",
                            np.maximum(VOLUME[0] / volume, volume / VOLUME[1]))
        if self.geometry.has_solid:
            inside = self.geometry.phase(new.x) < 0
            if reduce.any_true(inside):
                raise StepError(f"{reduce.count(inside)} particles are in a wall", inside.astype(float))
