"""What is measured of two fluids between two reservoirs: capillary pressure, and what is cut off from its reservoir."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..domain import reduce
from ..domain.components import parts_of
from ..flow.state import phase_of
from ..geometry.extents import fluid_part_of_sample
from ..geometry.protocol import Geometry, inside_sample, sample_box
from .measures import SELDOM, linked

if TYPE_CHECKING:
    from ..flow.state import Configuration, State


@dataclass(frozen=True)
class ReservoirMeasures:
    """What is joined to a reservoir, and the pressure of that; what is not is trapped, or lies in a closed pocket: in
    pores that do not lead from one reservoir to the other.

    axis: of the reservoirs; ends: fluid of the inlet and of the outlet, 0 or 1; names: of both fluids; site_volume:
    m^dim; thick: (dim,) m, extents of the particles (`geometry.extents`); pressure(state): (n,) Pa of the particles,
    with what falls along the axis."""

    axis: int
    ends: tuple[int, int]
    names: Sequence[str]
    geometry: Geometry
    site_volume: float
    thick: np.ndarray
    pressure: Callable[[State], np.ndarray]

    def __call__(self, state: State, config: Configuration, everything: bool = False) -> dict[str, Any]:
        """Entries of a row of the history; what takes longer only every `SELDOM` steps, unless everything is asked
        for, and otherwise None."""
        if not (everything or state.step % SELDOM == 0):
            return dict.fromkeys(("capillary_pressure", "closed_pockets", *(f"trapped_{name}" for name in self.names)))
        inside, phase = inside_sample(self.geometry, state.x), _phase(state)
        joined, part = [self.joined(state, config, k) for k in (0, 1)], self._parts(state)
        closed = inside & ~self._lead_through(state, config, inside)
        cut_off = [~closed & (phase == k) & ~joined[k] for k in (0, 1)]
        all_of_it, *parts = reduce.totals(part, part[closed], *(part[some] for some in cut_off))
        shares = [float(some / (all_of_it or 1.0)) for some in parts]
        return {"capillary_pressure": self._capillary_pressure(state, [part * mine for mine in joined]),
                "closed_pockets": shares[0],
                **{f"trapped_{name}": share for name, share in zip(self.names, shares[1:])}}

    def _parts(self, state: State) -> np.ndarray:
        """(n,) parts, 0 to 1, of the particles that lie in the sample."""
        return fluid_part_of_sample(self.geometry, state.x, self.thick)

    def saturation(self, state: State) -> float:
        """Of the fluid of the inlet, by particles in the sample."""
        part = self._parts(state)
        mine, all_of_it = reduce.totals(part[_phase(state) == self.ends[0]], part)
        return float(mine / (all_of_it or 1.0))

    def _capillary_pressure(self, state: State, joined: Sequence[np.ndarray]) -> float | None:
        """Mean pressure of the fluid of the inlet in the sample less that of the fluid of the outlet, Pa, of the parts
        (n,) that are joined to its reservoir, what viscous flow takes included; None where there is none of one of
        them."""
        first, last = (joined[k] for k in self.ends)
        if not (reduce.any_true(first > 0.0) and reduce.any_true(last > 0.0)):
            return None
        p = self.pressure(state)
        return float(reduce.mean(p, first) - reduce.mean(p, last))

    def joined(self, state: State, config: Configuration, k: int) -> np.ndarray:
        """Which particles (n,) are of fluid k and joined to a reservoir of it: by particles of it within JOINED mean
        distances of each other, but not over the seam."""
        mine = _phase(state) == k
        near = linked(config.ops, mine, self.site_volume ** (1.0 / self.geometry.dim))
        along, home = state.x[:, self.axis], np.zeros(len(mine), np.bool_)
        lower, upper = (corner[self.axis] for corner in sample_box(self.geometry))
        if self.ends[0] == k:
            home |= along < lower
        if self.ends[1] == k:
            home |= along > upper
        return self._joined_to([home], config, mine, near & ~self._over_the_seam(config))

    def _lead_through(self, state: State, config: Configuration, inside: np.ndarray) -> np.ndarray:
        """Which particles (n,) of the sample, `inside` (n,), are in pores that lead through it from the one reservoir
        to the other, whatever fluid is in them: parts of the sample alone that see both."""
        ops = config.ops
        place, over = ops.neighbours.x[ops.neighbours.row, self.axis], self._over_the_seam(config)
        owner, ends = np.repeat(np.arange(ops.n), np.diff(ops.start)), []
        lower, upper = (corner[self.axis] for corner in sample_box(self.geometry))
        for beyond in (place < lower, place > upper):
            sees = np.zeros(ops.n, np.bool_)
            sees[owner[beyond & ~over]] = True
            ends.append(sees)
        return self._joined_to(ends, config, inside, ~over & (place >= lower) & (place <= upper))

    def _over_the_seam(self, config: Configuration) -> np.ndarray:
        """Which pairs (n_pairs,) see each other where the end of the one reservoir meets that of the other."""
        place = config.ops.neighbours.x[config.ops.neighbours.row, self.axis]
        return np.asarray((place < self.geometry.lower[self.axis]) | (place >= self.geometry.upper[self.axis]))

    @staticmethod
    def _joined_to(homes: Sequence[np.ndarray], config: Configuration, mine: np.ndarray,
                   near: np.ndarray) -> np.ndarray:
        """Which particles (n,) of `mine` (n,) are in parts, joined by pairs `near` (n_pairs,), that have particles of
        each of the `homes` (n,)."""
        ops, joined = config.ops, mine
        count, part = parts_of(ops.start, ops.column, ops.exchange.forward(mine), near, ops.exchange)
        for home in homes:
            free = reduce.total_by(part[home & mine], labels=count) > 0
            joined = joined & np.append(free, False)[part]
        return joined


def _phase(state: State) -> np.ndarray:
    assert state.phi is not None  # of a scene with reservoirs
    return phase_of(state.phi)
