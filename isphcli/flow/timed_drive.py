"""Forces and walls that change with time: their values at a time, the largest so far, and steps that follow them.

Forces and velocities of walls are taken at the end of a step, as all terms of eq. 2 are. Everything follows from the
time alone, so that a run that goes on from a restart file finds the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# How far what drives the flow may be from linear over a step, of its largest value so far. A sine is then followed in
# steps of 0.05 to 0.16 of a radian (`isph run cases/oscillating_slit.yaml`), some 100 a period. With ten times as many
# its response changes by 8e-4 (--set time.step=5e-5)
DEVIATION = 3e-4
# Parts of a step at which its drive is compared with a straight line
INSIDE = np.array([0.0, 0.13, 0.29, 0.41, 0.5, 0.63, 0.77, 0.89, 1.0])
# Of the step that other limits allow, and of the time that is left: the shortest for the sake of the drive. A force
# that jumps is not linear over any step: it is met in some 14 steps, each half of the one before
SHORTEST = 2.0**-14
# Parts of the time that has passed at which the largest value so far is looked for; unequal, so that what repeats is
# not seen in the same phase every time
PASSED = np.append((np.arange(1000) + np.mod(np.arange(1000) * (np.sqrt(5.0) - 1.0) / 2.0, 1.0)) / 1000, 1.0)


@dataclass(frozen=True)
class TimedDrive:
    """What drives a flow, as functions of times (m,), s.

    forces(times): body force on every fluid and that of a pressure gradient on the first fluid, (m, dim) m/s2 each;
    strongest(times): size of the acceleration of the fluid that they accelerate most, (m,) m/s2;
    walls(times): velocities of all walls, (m, n_walls, dim) m/s, or None where they do not change.
    All raise ValueError where they have no value.
    """

    forces: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    strongest: Callable[[np.ndarray], np.ndarray]
    walls: Callable[[np.ndarray], np.ndarray] | None

    def forces_at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Body force and force of the pressure gradient at a time, (dim,) m/s2 each."""
        body, drop_force = self.forces(np.array([time]))
        return body[0], drop_force[0]

    def walls_at(self, time: float) -> np.ndarray | None:
        """Velocities of all walls at a time, (n_walls, dim) m/s, or None where they do not change."""
        return None if self.walls is None else self.walls(np.array([time]))[0]

    def largest_force(self, time: float) -> float:
        """Largest acceleration of any of the fluids from the start to a time, m/s2."""
        return float(self.strongest(time * PASSED).max())

    def limit(self, time: float, dt: float, left: float = np.inf) -> float:
        """The step of at most dt, s, over which forces and velocities of walls stay linear within DEVIATION. left: to
        the end of the run, s, which bounds the shortest step alone: the others are the same whenever it ends."""
        largest = {name: _largest(values) for name, values in self._values(time * PASSED).items()}
        shortest = SHORTEST * min(dt, left)
        while (deviation := self._deviation(time, dt, largest) / DEVIATION) > 1.0 and dt > shortest:
            # the deviation grows with the square of the step
            dt = max(dt * min(max(0.95 * deviation**-0.5, 0.1), 0.95), shortest)
        return dt

    def _deviation(self, time: float, dt: float, largest: dict[str, float]) -> float:
        """Largest deviation from linear over a step, of the largest value up to its end. largest: up to its begin."""
        try:
            found, worst = self._values(time + dt * INSIDE), 0.0
        except ValueError:  # a formula that has no value there, maybe beyond the end of the run
            return np.inf
        for name, values in found.items():
            chord = values[0] + INSIDE.reshape(-1, *[1] * (values.ndim - 1)) * (values[-1] - values[0])
            off = _largest(values - chord)
            if off > 0.0:
                worst = max(worst, off / max(largest[name], _largest(values)))
        return worst

    def _values(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """{"force": (m, dim), "walls": (m, n_walls, dim)}."""
        body, drop_force = self.forces(times)
        found = {"force": body + drop_force}
        return found if self.walls is None else found | {"walls": self.walls(times)}


def _largest(vectors: np.ndarray) -> float:
    """Size of the largest of vectors (..., dim)."""
    return float(np.linalg.norm(vectors, axis=-1).max())
