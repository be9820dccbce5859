"""A superficial velocity that is held, and the pressure gradient that each step needs for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..domain.components import pair_components
from ..domain.exchange import Exchange
from ..geometry.extents import part_between

if TYPE_CHECKING:
    from ..operators.pair_weights import Operators
    from .state import State

STUCK = 1e-6  # of what free fluid would gain from a pressure gradient: less is no flow


@dataclass(frozen=True)
class Beyond:
    """Where a flux is measured: beyond the ends of the sample along an axis, as at a pump, or in the whole box where
    nothing lies beyond. The flux is the same there as through every cross section, by conservation of mass.

    axis: 0, 1 or 2; lower, upper: m along the axis, the ends, inf and -inf for the whole box; thick: extent of the
    particles along it, m (`geometry.extents`): of one that an end cuts the part beyond counts; weight: volume of a
    particle over that of the place, rock in it included.
    """

    axis: int
    lower: float
    upper: float
    thick: float
    weight: float

    def parts(self, x: np.ndarray) -> np.ndarray:
        """(n,) parts, 0 to 1, of particles x (n, dim), m, that lie there."""
        return np.asarray(1.0 - part_between(x[:, self.axis], self.thick, self.lower, self.upper))

    def flux(self, x: np.ndarray, values: np.ndarray) -> float:
        """Of values (n,) of particles x (n, dim), m: their integral over the place, over its volume."""
        if self.lower > self.upper:
            return float(self.weight * reduce.total(values))
        part = self.parts(x)
        here = part > 0.0
        return float(self.weight * reduce.dot(values[here], part[here]))


@dataclass(frozen=True)
class HeldVelocity:
    """A superficial velocity that is held: each step finds the pressure gradient that it takes.

    A step is linear in the gradient G over the density of the first fluid: with v the velocity that a gradient of one
    makes (`Stepper._hold`), U(u + G v) = U(u) + G U(v) is what was asked. Shifts do not count: they move points, not
    fluid, and the interface of two fluids moves with the velocity.

    wanted: m/s; place: where U is taken; porosity: of the sample, or of the box; areal: density of the first fluid
    times the length of the box, kg/m2.
    """

    wanted: float
    place: Beyond
    porosity: float
    areal: float

    @property
    def axis(self) -> int:
        """Of the flow: 0, 1 or 2."""
        return self.place.axis

    @property
    def speed(self) -> float:
        """Mean speed of the fluid in the sample, m/s; beside the sample, where that holds no fluid."""
        return abs(self.wanted) / (self.porosity or 1.0)

    def gradient_for_flux(self, x: np.ndarray, u: np.ndarray, v: np.ndarray, rate: float) -> float | None:
        """G by which the velocities u (n, dim) at x (n, dim) miss what is wanted, m/s2. v: (n, dim) of a unit
        gradient, s; rate: 1/s, of the step. None where no gradient moves the fluid along the axis."""
        gain = self.place.flux(x, v[:, self.axis])
        if not gain * rate > STUCK:
            return None
        return (self.wanted - self.place.flux(x, u[:, self.axis])) / gain

    def flux(self, x: np.ndarray, u: np.ndarray) -> float:
        """The superficial velocity along the axis, m/s, of velocities u (n, dim) at x (n, dim), where it is held. The
        mean over n particles across a pore is larger, by 1 / (2 n^2) of a parabolic profile."""
        return self.place.flux(x, u[:, self.axis])

    def drop(self, state: State) -> float:
        """Pressure drop over the box in the step to `state` (`State`), Pa."""
        assert state.pressure_gradient is not None
        return state.pressure_gradient * self.areal


def leads_through(ops: Operators, axis: int, box: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether particles that see each other lead all the way round a periodic axis. ops: Operators; box: its corners,
    (dim,) each, m.

    The velocity that a gradient makes does not tell this: in front of a wall across the axis it is still a tenth of
    that of free fluid.
    """
    n, (x, row), column = ops.n, (ops.neighbours.x, ops.neighbours.row), ops.column
    # of two copies of the scene, own particles of both before the remote ones, a way over the seam leads to the other
    place = box[0][axis], box[1][axis]
    over = (x[row, axis] < place[0]) | (x[row, axis] >= place[1])
    first = np.where(column < n, column, column + n)
    other = np.where(column < n, n, ops.exchange.remote)
    start = np.concatenate([ops.start, ops.start[-1] + ops.start[1:]])
    both = np.concatenate([first + over * other, first + ~over * other]).astype(column.dtype)
    labels = pair_components(start, both, exchange=_Twice(ops.exchange))[1]
    return reduce.any_true(labels[:n] == labels[n : 2 * n])


class _Twice:
    """The exchange of two copies of a scene: the own particles of both, then the remote ones of both."""

    def __init__(self, exchange: Exchange):
        self.exchange, self.remote = exchange, 2 * exchange.remote

    def numbers(self, n: int) -> np.ndarray:
        """Not asked for."""
        raise NotImplementedError

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Not asked for."""
        raise NotImplementedError

    def forward_each(self, *values: np.ndarray) -> tuple[np.ndarray, ...]:
        """See `Exchange`."""
        return tuple(self.forward(part) for part in values)

    def forward(self, values: np.ndarray) -> np.ndarray:
        """See `Exchange`."""
        parts = np.split(values, 2)
        return np.concatenate([values, *(self.exchange.forward(part)[len(part):] for part in parts)])
