"""Forces and walls that change with time: their values at a time, the largest so far, and steps that follow them.

Forces and velocities of walls are taken at the end of a step, as all terms of eq. 2 are: a run that goes on from a
restart file finds the same numbers from the time alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

# How far what drives the flow may be from linear over a step, of its largest value so far. A sine is then followed in
# steps of 0.05 to 0.17 of a radian, for which BDF2 is 0.3 % off (omega dt)^2 / 3: tests/flow/test_timed_drive.py
BEND = 3e-4
INSIDE = np.array([0.0, 0.13, 0.29, 0.41, 0.5, 0.63, 0.77, 0.89, 1.0])  # of a step, where its drive is looked at
# Of the step that other limits allow: the shortest for the sake of the drive. A force that sets in at once is nowhere
# linear; a run begins with 1/64 of that at walls.
SHORTEST = 2.0**-10


@dataclass(frozen=True)
class TimedDrive:
    """What drives a flow, as functions of times (m,), s.

    forces(times): body force on every fluid and that of a pressure gradient on the first fluid, (m, dim) m/s2 each;
    walls(times): velocities of all walls, (m, n_walls, dim) m/s, or None where they do not change; times: (k,) of a
    whole run, in order, at which the largest force so far is looked for.
    """

    forces: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    walls: Callable[[np.ndarray], np.ndarray] | None
    times: np.ndarray
    _largest: dict[str, np.ndarray] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        for name, sizes in self._sizes(self.times).items():
            self._largest[name] = np.maximum.accumulate(sizes)

    def forces_at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Body force and force of the pressure gradient at a time, (dim,) m/s2 each."""
        body, push = self.forces(np.array([time]))
        return body[0], push[0]

    def walls_at(self, time: float) -> np.ndarray | None:
        """Velocities of all walls at a time, (n_walls, dim) m/s, or None where they do not change."""
        return None if self.walls is None else self.walls(np.array([time]))[0]

    def largest_force(self, time: float) -> float:
        """Largest force from the start to a time, m/s2."""
        return self._so_far("force", time, self._sizes(np.array([time]))["force"])

    def limit(self, time: float, dt: float) -> float:
        """The step of at most dt, s, over which forces and velocities of walls stay linear within BEND."""
        shortest = SHORTEST * dt
        while (bend := self._bend(time, dt) / BEND) > 1.0 and dt > shortest:
            # what bends does so with the square of the step
            dt = max(dt * min(max(0.95 * bend**-0.5, 0.1), 0.95), shortest)
        return dt

    def _bend(self, time: float, dt: float) -> float:
        """Largest deviation from linear over a step, of the largest value so far."""
        times, worst = time + dt * INSIDE, 0.0
        sizes = self._sizes(times)
        for name, values in self._values(times).items():
            chord = values[0] + INSIDE.reshape(-1, *[1] * (values.ndim - 1)) * (values[-1] - values[0])
            off = np.linalg.norm(values - chord, axis=-1).max()
            if off > 0.0:
                worst = max(worst, off / self._so_far(name, time, sizes[name]))
        return worst

    def _so_far(self, name: str, time: float, sizes: np.ndarray) -> float:
        """Largest of `sizes` and of all before a time."""
        before = np.searchsorted(self.times, time, side="right")
        return max(float(sizes.max()), float(self._largest[name][before - 1]) if before else 0.0)

    def _values(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """{"force": (m, dim), "walls": (m, n_walls, dim)}."""
        body, push = self.forces(times)
        found = {"force": body + push}
        return found if self.walls is None else found | {"walls": self.walls(times)}

    def _sizes(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """{name: (m,) largest size of a vector at each time}."""
        sizes = {name: np.linalg.norm(values, axis=-1) for name, values in self._values(times).items()}
        return {name: size.reshape(len(times), -1).max(axis=1) for name, size in sizes.items()}
