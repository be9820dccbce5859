"""Terms of eq. 1 beside pressure, viscosity, tension and the drive, as the solvers see them: sums over all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Force:
    """A term of eq. 1 that follows from where the fluid is: acceleration(x) - nu resistance(x) u.

    name: in `terms` of summary.json and of the check of a case; words: its numbers, for that check; acceleration: of
    points (n, dim), m, (dim,) or (n, dim) m/s2, or None; largest: size of the largest one, m/s2; resistance: of
    points (n, dim), (n,) 1/m2, 0 and more, the inverse of a permeability: nu resistance u is Darcy's drag. It is
    taken implicitly and bounds no step. None: no resistance. An acceleration is not balanced in dead ends as the
    drive is, and there is no permeability beside one (`runs.steady.solve_axis` raises). Raises ValueError where an
    acceleration has no `largest`: steps are bounded by it.
    """

    name: str
    words: str
    acceleration: Callable[[np.ndarray], np.ndarray] | None = None
    largest: float = 0.0
    resistance: Callable[[np.ndarray], np.ndarray] | None = None

    def __post_init__(self) -> None:
        if self.acceleration is not None and not self.largest > 0.0:
            raise ValueError(f"{self.name}: an acceleration needs the size of the largest one, m/s2")


def acceleration_of(forces: Sequence[Force], x: np.ndarray) -> np.ndarray | None:
    """Acceleration (n, dim) of all forces at points x (n, dim), m/s2; None where none accelerates."""
    found = [np.broadcast_to(force.acceleration(x), x.shape) for force in forces if force.acceleration is not None]
    return np.sum(found, axis=0) if found else None


def resistance_of(forces: Sequence[Force], x: np.ndarray) -> np.ndarray | None:
    """Resistance (n,) of all forces at points x (n, dim), 1/m2; None where none resists."""
    found = [force.resistance(x) for force in forces if force.resistance is not None]
    return np.sum(found, axis=0) if found else None


def largest_of(forces: Sequence[Force]) -> float:
    """What all forces together accelerate by at most, m/s2."""
    return float(sum(force.largest for force in forces))
