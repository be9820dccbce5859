"""Means over the last part of a run with their standard errors: what a number that scatters from step to step is worth.

The pressure drop that holds a flux is that of each step, with the noise of moving particles in it: a flux that is off
by a thousandth is put right within the step, by a pressure that accelerates all of the fluid. A gauge would show its
mean over time. The error of that mean is found by the method of batch means, as in `steadiness`: from the scatter of
the means of equal parts of the time about a straight line. Noise that is correlated over less than a part is taken in
full, a drift is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .steadiness import means_between, off_a_line

LAST = 0.25  # of the time of a run: what its means are taken over
PARTS = 8  # of that time at most; each has two values at least
FEWEST_PARTS = 4  # two of which a straight line takes up
# Of the mean: a larger standard error leaves no digit of it, and values that scatter by more than all of it are noise
NO_DIGIT, NOISE = 0.2, 1.0


class LateMean(NamedTuple):
    """mean: over the time; error: its standard error; scatter: root mean square of the single values about it."""

    mean: float
    error: float
    scatter: float

    @property
    def is_noise(self) -> bool:
        """Whether a single value tells nothing of the mean, or the mean has no digit."""
        return self.scatter > NOISE * abs(self.mean) or self.error > NO_DIGIT * abs(self.mean)


def late_mean(rows: Sequence[Mapping[str, Any]], name: str, since: float) -> LateMean | None:
    """Of the values in column `name` of rows of the history after the time `since`, s; None where there are too few.
    Each value stands for the time since the one before."""
    known = [(row["time"], row[name]) for row in rows if row["time"] > since and row.get(name) is not None]
    count = min(PARTS, len(known) // 2)
    if count < FEWEST_PARTS:
        return None
    times, values = np.array(known, float).T
    length = np.diff(times, prepend=since)
    integral = np.append(0.0, np.cumsum(values * length))
    edges = np.linspace(since, times[-1], count + 1)
    parts = means_between(edges, np.append(since, times), integral)
    about, mean = off_a_line(parts), float(parts.mean())
    scatter = np.sqrt(((values - mean) ** 2 @ length) / length.sum())
    return LateMean(mean, float(np.sqrt(about @ about / (count - 2) / count)), float(scatter))


def noise_of_the_drop(found: LateMean | None, walls: bool = True) -> str | None:
    """A sentence on a pressure drop that holds a flux, Pa, and is noise; None of others. walls: whether any hold the
    flux back."""
    if found is None or not found.is_noise:
        return None
    value = f"{found.mean:.3g} Pa +- {found.error:.2g}"
    what = ("no capillary pressure of a single step means more. A smaller particles.spacing resolves throats; with "
            "drive.pressure_drop no drop is to be found" if walls else
            "nothing takes a pressure drop in a box without walls, once the flux is there")
    return (f"the pressure drop that holds the flux is noise: {value} in the mean over the last quarter of the time, "
            f"with single steps {found.scatter:.2g} Pa off it (root mean square); {what}")
