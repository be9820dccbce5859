"""The limits of a step: a good one keeps them, each fault is found."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.flow.state import Handover
from isphcli.flow.step_limits import Bounds, StepError
from tests.flow.steps import VORTEX, scene


@pytest.fixture
def step():
    """A good step: (bounds, state before it, its result)."""
    stepper, state, config = scene(VORTEX)
    return stepper.bounds, state, stepper.advance(state, Handover(config), 0.01)


def test_a_good_step_keeps_all_limits(step):
    bounds, before, found = step
    bounds.check(before, found)


@pytest.mark.parametrize("name", ["x", "u", "p"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_found(step, name, value):
    bounds, before, found = step
    values = getattr(found.state, name).copy()
    values[7] = value
    found = replace(found, state=replace(found.state, **{name: values}))
    with pytest.raises(StepError, match="1 particles is no longer a number") as caught:
        bounds.check(before, found)
    assert np.flatnonzero(caught.value.violation).tolist() == [7]


def test_speed_from_nowhere_is_found(step):
    """Twice the speed without a force; the same speed where a force explains it."""
    bounds, before, found = step
    found = replace(found, state=replace(found.state, u=2 * found.state.u))
    with pytest.raises(StepError, match="the mean speed"):
        bounds.check(before, found)
    replace(bounds, force=1.0 / 0.01).check(before, found)


def test_speed_that_grows_slowly_is_found(step):
    """1 % a step passes from step to step, but not since the start."""
    bounds, _, found = step
    with pytest.raises(StepError, match="of the start"):
        for _ in range(100):
            before = found.state
            found = replace(found, state=replace(before, u=1.01 * before.u, time=before.time + 0.01))
            bounds.check(before, found)
    assert 1.3 < bounds.speed(found.state.u, 1.0) / bounds.start < 1.6


def test_a_mean_speed_does_not_leave_the_range_of_numbers():
    bounds = Bounds(None, 1.0, 0.0, 0.0, 0.0)
    for scale in (0.0, 1e-300, 1.0, 1e300):
        assert bounds.speed(np.full((5, 2), scale), 1.0) == pytest.approx(np.sqrt(2) * scale)


def test_divergence_and_volumes_are_bounded(step):
    bounds, before, found = step
    with pytest.raises(StepError, match=r"change its volume by 0\.6"):
        bounds.check(before, replace(found, divergence=np.full(100, 60.0)))
    volume = found.config.ops.volume.copy()
    volume[3] *= 0.2
    config = replace(found.config, ops=replace(found.config.ops, volume=volume))
    with pytest.raises(StepError, match="clump") as caught:
        bounds.check(before, replace(found, config=config))
    assert np.argmax(caught.value.violation) == 3


def test_particles_in_a_wall_are_found():
    stepper, state, config = scene(VORTEX.replace("periodic: [x, y]", "periodic: [x]"))
    found = stepper.advance(state, Handover(config), 1e-4)
    found.state.x[5, 1] = -0.01
    with pytest.raises(StepError, match="1 particles are in a wall"):
        stepper.bounds.check(state, found)
