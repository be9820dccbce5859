"""A drive between reservoirs in steps of pressure or flux: the step of a state, and the end of each step.

`State.drive_step` (4,) holds all of it, so that a restart goes on within a step: the number of the step; its begin, s;
the time at which the saturation was last measured, s (first the begin); the saturation then (UNSEEN before the first
time).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..case.blocks import DriveSteps
    from ..flow.state import Configuration, State
    from ..flow.step import Stepper

UNSEEN = -1.0  # stands for a saturation where none has been measured yet
WINDOWS = 10  # windows in the duration of a step, where the case gives no window


@dataclass
class DriveProgram:
    """The steps of a drive in a run.

    steps: of the case; axis: of the reservoirs; stepper: whose held velocity is that of the step; areal: density of the
    first fluid times the length of the box, kg/m2: a pressure drop over it is `State.pressure_gradient`;
    saturation(state): of the fluid of the inlet in the sample; finished(number, value, settled, state, config): called
    at the end of each step, settled saying whether it ended because the saturation no longer changed.
    """

    steps: DriveSteps
    axis: int
    stepper: Stepper
    areal: float
    saturation: Callable[[State], float]
    finished: Callable[[int, float, bool, State, Configuration], None] = lambda *_: None
    _last: float = 0.0  # begin of the step that ended last, s

    @property
    def values(self) -> tuple[float, ...]:
        """Pressure drops, Pa, or superficial velocities, m/s, of the steps."""
        return self.steps.pressure_drop or self.steps.superficial_velocity or ()

    @property
    def window(self) -> float:
        """Time between two looks at the saturation, s."""
        return window_of(self.steps)

    def begin(self, state: State) -> State:
        """The state under the drive of its step: the first step, or that of the restart of a run that goes on."""
        return self._driven(state)

    def done(self, state: State) -> bool:
        """Whether all steps have been taken."""
        return _number(state) >= len(self.values)

    def last_began(self, state: State) -> float:
        """When the step of a state began, s; after the last one when that began."""
        assert state.drive_step is not None
        return self._last if self.done(state) else float(state.drive_step[1])

    def due(self, state: State) -> float:
        """When the saturation is looked at next, or the step ends, s."""
        assert state.drive_step is not None
        _, began, looked, _ = state.drive_step
        return min(looked + self.window, began + self.steps.duration)

    def after(self, state: State, config: Configuration) -> State:
        """The state with its step of the drive updated: the saturation measured again, or the next step begun."""
        if state.time < self.due(state) * (1.0 - 1e-9):
            return state
        assert state.drive_step is not None
        number, (_, began, _, before) = _number(state), state.drive_step
        saturation = self.saturation(state)
        settled = self.steps.settled is not None and abs(saturation - before) < self.steps.settled
        if not settled and state.time < (began + self.steps.duration) * (1.0 - 1e-9):
            return replace(state, drive_step=np.array([number, began, state.time, saturation]))
        self.finished(number, self.values[number], settled, state, config)
        self._last = float(began)
        return self._driven(replace(state, drive_step=begun(number + 1, state.time)))

    def drop(self, state: State) -> float:
        """Pressure of the inlet less that of the outlet, Pa."""
        return (state.pressure_gradient or 0.0) * self.areal

    def _driven(self, state: State) -> State:
        """The state under the drive of its step; after the last one the drive stays."""
        if self.done(state):
            return state
        value, held = self.values[_number(state)], self.stepper.held_velocity
        if held is None:
            return replace(state, pressure_gradient=value / self.areal)
        self.stepper.held_velocity = replace(held, wanted=value)
        return state


def window_of(steps: DriveSteps) -> float:
    """Time between two looks at the saturation, s."""
    return steps.window or steps.duration / WINDOWS


def _number(state: State) -> int:
    assert state.drive_step is not None
    return int(state.drive_step[0])


def begun(number: int, time: float) -> np.ndarray:
    """`State.drive_step` of a step that begins at a time, s."""
    return np.array([number, time, time, UNSEEN])
