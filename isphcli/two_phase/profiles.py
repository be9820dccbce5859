"""Profiles along an axis: saturation and pressure of slices across it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..domain import reduce
from ..geometry.extents import sections
from ..geometry.protocol import Geometry

if TYPE_CHECKING:
    from ..flow.state import State

SPACINGS = 2.0  # thickness of a slice


@dataclass(frozen=True)
class Profiles:
    """axis: 0, 1 or 2; names: of both fluids; spacing: of the particles, m; thick: their extent along the axis, m, of
    which each slice has the part that lies within; pressure(state): (n,) Pa."""

    axis: int
    names: Sequence[str]
    geometry: Geometry
    spacing: float
    thick: float
    pressure: Callable[[State], np.ndarray]

    @property
    def thickness(self) -> float:
        """Of a slice, m; a whole number of slices fits the box."""
        return SPACINGS * self.spacing

    def rows(self, state: State, phase: np.ndarray) -> Iterator[dict[str, Any]]:
        """A dict a slice, from the lower end of the box on: step, time, its middle along the axis, m; share of each
        fluid and mean pressure of both and of each, Pa, None where there is none. phase: (n,) of the particles."""
        name, lower = "xyz"[self.axis], self.geometry.lower[self.axis]
        length = float(self.geometry.upper[self.axis] - lower)
        count = max(round(length / self.thickness), 1)
        # over a seam of reservoirs neither fluid nor pressure is periodic
        slices, who, part = sections(state.x[:, self.axis], self.thick, (lower, lower + length), count, False)
        p, held = part * self.pressure(state)[who], phase[who]
        masks = [np.ones(len(p), np.bool_), *(held == k for k in (0, 1))]
        numbers = [reduce.total_by(slices[mask], part[mask], count) for mask in masks]
        sums = [reduce.total_by(slices[mask], p[mask], count) for mask in masks]
        for k in range(count):
            row: dict[str, Any] = {"step": state.step, "time": state.time, name: lower + (k + 0.5) * length / count}
            for fluid, number in zip(self.names, numbers[1:]):
                row[f"saturation_{fluid}"] = float(number[k] / numbers[0][k]) if numbers[0][k] else None
            for key, number, total in zip(("", *(f"_{fluid}" for fluid in self.names)), numbers, sums):
                row[f"pressure{key}"] = float(total[k] / number[k]) if number[k] else None
            yield row
