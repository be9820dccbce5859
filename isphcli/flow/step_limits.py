"""The limits that a step must keep, and the errors of steps and runs that do not; `attempt` says what is tried then.

benchmarks/limits.py measures what good runs reach of each limit, and what runs that blow up do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..domain.row_threads import edges_of, over_blocks, over_slices

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
        return _root_mean_square([reduce.largest(np.abs(u))], [(u, density)])[0]

    def check(self, old: State, found: StepResult, old_density: np.ndarray | float = 1.0) -> None:
        """Raises StepError where the step from the State `old` to the StepResult `found` broke a limit. old_density:
        `Terms.density` of the old state, whose particles other processes may own by now."""
        new, dt = found.state, found.dt
        self._refuse_what_is_no_number(new)
        density, change = found.config.terms.density, np.abs(found.divergence) * dt
        volume, walls = found.config.ops.volume[: len(new.x)] / self.site_volume, found.config.ops.walls
        if walls is not None and walls.dead_ends:  # isolated particles have too few neighbours for a number density
            volume = np.where(walls.isolated, 1.0, volume)
        inside = self.geometry.phase(new.x) < 0 if self.geometry.has_solid else np.zeros(len(new.x), np.bool_)
        *largest, growth, small, large, wall = _largest_of_each(
            new.u, old.u, change, -volume, volume, inside.astype(float))
        speed, before = _root_mean_square(largest, [(new.u, density), (old.u, old_density)])
        force = self.force if self.largest_force is None else self.largest_force(new.time)
        for since, begin, time in (("of the step before", before, dt), ("of the start", self.start, new.time)):
            bound = GROWTH * (begin + force * time + self.other)
            if speed > bound:
                raise StepError(f"the mean speed is {speed:.3g}, but that {since}, the force and the walls allow "
                                f"{bound:.3g}", np.sqrt((new.u**2).sum(axis=1)))
        if growth > DIVERGENCE:
            raise StepError(f"a particle would change its volume by {growth:.2g} of it (limit {DIVERGENCE})", change)
        if -small < VOLUME[0] or large > VOLUME[1]:
            raise StepError(f"the volumes of particles range from {-small:.2g} to {large:.2g} of that at "
                            f"the start (limits {VOLUME[0]} and {VOLUME[1]}): they clump or part",
                            np.maximum(VOLUME[0] / volume, volume / VOLUME[1]))
        if wall > 0.0:
            raise StepError(f"{reduce.count(inside)} particles are in a wall", inside.astype(float))

    @staticmethod
    def _refuse_what_is_no_number(new: State) -> None:
        fields = {"position": new.x, "velocity": new.u, "pressure": new.p}
        counts = [float(sum(over_slices(partial(_without_number, values), len(values)))) for values in fields.values()]
        for (name, values), count in zip(fields.items(), reduce.totals(*counts)):
            if count:
                raise StepError(f"the {name} of {int(count)} particles is no longer a number",
                                _no_numbers(values).astype(float))


def _without_number(values: np.ndarray, rows: slice) -> int:
    """Of how many rows of values (n,) or (n, k) some entry is no number."""
    part = values[rows]
    return 0 if np.isfinite(part).all() else int(np.count_nonzero(_no_numbers(part)))


def _no_numbers(values: np.ndarray) -> np.ndarray:
    bad = ~np.isfinite(values)
    return bad.any(axis=1) if bad.ndim > 1 else bad


def _largest_of_each(*values: np.ndarray) -> list[float]:
    """`reduce.largest_of_each` of values (n,), and of the sizes of vectors' components (n, dim), on all threads."""

    def largest(some: np.ndarray, rows: slice) -> float:
        part = some[rows]
        return float((np.abs(part) if part.ndim > 1 else part).max(initial=-np.inf))

    return reduce.largest_of_each(*(np.array(over_slices(partial(largest, some), len(some))) for some in values))


def _root_mean_square(largest: Sequence[float], given: Sequence[tuple[np.ndarray, np.ndarray | float]]) -> list[float]:
    """Root mean square speeds of (velocities (n, dim), density (n,) or number) whose largest components are known."""
    # squares of very small and very large speeds leave the range of numbers
    scale = [most if 0.0 < most < np.inf else 1.0 for most in largest]
    found = [_squares(u, most, density) for (u, density), most in zip(given, scale)]
    sums = reduce.totals(*(squares for squares, _ in found), *(weights for _, weights in found))
    means = [whole / weight for whole, weight in zip(sums, sums[len(given):])]
    return [float(most * np.sqrt(mean)) if 0.0 < most < np.inf else float(most) for most, mean in zip(largest, means)]


def _squares(u: np.ndarray, scale: float, density: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Sums by blocks of rows of density (u / scale)^2, and of the density; see `_root_mean_square`."""
    edges, weight = edges_of(len(u)), np.broadcast_to(density, len(u))
    sums = np.zeros((2, len(edges) - 1))

    def some(blocks: tuple[int, int], edges: np.ndarray) -> None:
        for k in range(*blocks):
            rows = slice(edges[k], edges[k + 1])
            scaled = u[rows] / scale
            sums[:, k] = weight[rows] @ np.einsum("nk,nk->n", scaled, scaled), weight[rows].sum()

    over_blocks(some, edges)
    return sums[0], sums[1]
