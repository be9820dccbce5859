"""When a flow has reached its steady value: the test of `time.steady`.

The test has one number per step (`time_loop.TimeLoop` chooses it). That number approaches its steady value as exp(-t /
T), and moving particles add a noise to it that does not decay. Both are judged by means over windows of time that grow
with the run, so that neither the small steps of the start nor slow modes of the flow look steady: the last three
quarters of the time since the start are cut into three windows of equal length. The error of the mean of the last one
is the sum of

- its noise: from the scatter of the means of equal parts of a window about a straight line (the method of batch means:
  noise that is correlated over less than a part is taken in full), at a confidence of 95 %;
- the change still to come: with d1 and d2 the steps from window to window, an exponential has d2^2 / (d1 - d2) left
  after the last; the same from the last halves of windows, which detects a slow mode that begins where a fast one ends.
  It is at least d2, so that a turning point does not pass for an end, and is unknown while d2 is not less than d1,
  unless the differences between windows are within the noise.
"""

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

WINDOWS, PARTS = 3, 8  # windows, and parts of a window
START = 0.25  # of the elapsed time, where the first window begins
# Steps in a window: the noise of moving particles is correlated over some ten steps, and parts of a window that are
# shorter do not see it; particles leave the lattice that they start from over some hundred steps, and the flow with
# them. A duct of 8 particles across is off by 1.8, 0.35 and 0.10 % with 5, 25 and 100 for a tolerance of 2 %, and by
# more than was said with 5 and 25 (docs/design_notes.md, steady states).
LEAST = 100
FEWEST = round(WINDOWS * LEAST / (1.0 - START))  # steps of a run before which nothing can be told
# Student's t for 95 % and the 12 degrees of freedom that 16 parts leave after two straight lines
CONFIDENCE = 2.179


class Steady:
    """The record of one number f over a run.

    kept: [(time, integral of f since the first of them)], one entry a step and one before, as far back as the windows
    go. mean: of f over the last window; error: by how much its steady value may differ from that, in units of f. Both
    are None while the record does not tell.
    """

    def __init__(self, kept: Sequence[tuple[float, float]] = ((0.0, 0.0),)):
        self.kept = list(kept)
        self.mean: float | None = None
        self.error: float | None = None
        self._judge()

    @property
    def distance(self) -> float | None:
        """`error` over the mean, or None."""
        return self.error / abs(self.mean) if self.error is not None and self.mean else None

    def add(self, time: float, value: float) -> None:
        """A step that ends at `time` (s, after all before) and has the value f."""
        last, total = self.kept[-1]
        self.kept.append((time, total + value * (time - last)))
        # the last entry before the windows stays: the integral is interpolated from there
        del self.kept[: max(bisect_left(self.kept, (START * time,)) - 1, 0)]
        self._judge()

    def _judge(self) -> None:
        self.mean = self.error = None
        time = self.kept[-1][0]
        edges = np.linspace(START * time, time, WINDOWS * PARTS + 1)
        if self.kept[0][0] > edges[0]:  # of a run that went on without the record of its first part
            return
        steps = np.diff([bisect_left(self.kept, (edge,)) for edge in edges[::PARTS]])
        if steps.min() < LEAST:
            return
        times, integrals = np.array(self.kept).T
        parts = means_between(edges, times, integrals).reshape(WINDOWS, PARTS)
        windows, halves = parts.mean(axis=1), parts.reshape(2 * WINDOWS, -1).mean(axis=1)
        scatter = off_a_line(parts[1:])  # the first window may still bend
        noise = CONFIDENCE * np.sqrt((scatter * scatter).sum() / (len(scatter) * (PARTS - 2)) / PARTS)
        left = max(
            _left(windows, noise),
            _left(halves[-3:], np.sqrt(2.0) * noise) + 0.5 * abs(halves[-1] - halves[-2]),
        )
        self.mean = float(windows[-1])
        self.error = float(left + noise) if np.isfinite(left) else None


def means_between(edges: np.ndarray, times: np.ndarray, integrals: np.ndarray) -> np.ndarray:
    """Means (m,) of a number between edges (m + 1,), s, from its integrals (n,) up to some times (n,), s."""
    return np.asarray(np.diff(np.interp(edges, times, integrals)) / np.diff(edges))


def off_a_line(parts: np.ndarray) -> np.ndarray:
    """Means (..., m) of equal parts of a time less the straight line through them, by least squares."""
    count = parts.shape[-1]
    line, about = np.arange(count) - 0.5 * (count - 1), parts - parts.mean(axis=-1, keepdims=True)
    return np.asarray(about - (about @ line / (line @ line))[..., None] * line)


def _left(means: np.ndarray, noise: float) -> float:
    """Bound on the difference between the last of three means, (3,), each with that noise, and their limit; inf where
    it is unknown."""
    first, middle, last = means
    before, now = middle - first, last - middle
    if before * now <= 0.0 or abs(last - first) <= np.sqrt(2.0) * noise:
        return abs(now)
    if abs(now) >= abs(before):
        return np.inf
    return abs(now) * max(1.0, now / (before - now))
