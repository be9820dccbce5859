"""The volume of the fluid in blocks, kept over long runs."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.flow.state import Handover
from isphcli.output.clock import Clock
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

BOX = """
geometry: {{box: [{box}], periodic: [{periodic}]{solid}}}
particles: {{spacing: 0.03125, keep_volume: {steps}}}
fluids: {{water: {{density: 1, viscosity: 0.01}}}}
time: {{end: 1}}
"""
BALL = ", shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.25}, is: solid}]"


def scene(periodic="x, y", steps=20, solid="", box="1, 1"):
    case = read_case(BOX.format(periodic=periodic, steps=steps, solid=solid, box=box).encode(), "case.yaml")
    geometry = build_geometry(case)
    state, stepper, _ = prepare(case, geometry, Clock())
    return state, stepper


def squeezed(x, by):
    """Positions with by cos(2 pi x) more particles than x, to first order in `by`."""
    moved = x.copy()
    moved[:, 0] -= by / (2 * np.pi) * np.sin(2 * np.pi * x[:, 0])
    return moved


@pytest.mark.parametrize("periodic, solid, box", [("x, y", "", "1, 1"), ("x", BALL, "1, 1"), ("", BALL, "1, 0.9"),
                                                  ("z", "", "0.5, 0.4, 0.3")])  # fmt: skip
def test_a_lattice_stays_as_it_is(periodic, solid, box):
    """And so it does half a spacing farther along a periodic axis: blocks hold whole numbers of layers, here 8."""
    state, stepper = scene(periodic, solid=solid, box=box)
    volume = stepper.volume
    shares = volume._shares(state.x)
    assert volume.wanted.sum() == pytest.approx(len(state.x)) and min(share.min() for share, _ in shares) >= 0.0
    expansion, drift = volume.expansion(state.x, 1.0)
    assert not expansion.any() and drift == 0.0
    if periodic and not solid:
        axis = "xyz".index(periodic[0])
        moved, far = state.x.copy(), state.x[:, axis].max()
        moved[:, axis] = (moved[:, axis] + 0.015625) % stepper.geometry.upper[axis]
        assert far > moved[:, axis].min() and np.abs(volume.expansion(moved, 1.0)[0]).max() < 1e-12


@pytest.mark.parametrize("periodic", ["x, y", "y"])
def test_what_is_squeezed_is_to_expand(periodic):
    """A surplus of 3 % cos(2 pi x) in 20 steps of 0.1 s. Sums over blocks of a quarter of the wave see 0.81 of it (the
    transform of a bilinear share, squared sinc of 1/4), and the way back another 0.81."""
    state, stepper = scene(periodic)
    expansion, drift = stepper.volume.expansion(squeezed(state.x, 0.03), 0.1)
    found = expansion * 20 * 0.1
    wave = np.cos(2 * np.pi * state.x[:, 0])
    assert 2 * (found * wave).mean() == pytest.approx(0.03 * np.sinc(0.25) ** 4, rel=0.1)
    assert found.mean() == pytest.approx(0.0, abs=1e-3) and drift > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("periodic, solid", [("x, y", ""), ("", ""), ("x, y", BALL)])
def test_fluid_returns_to_its_volume(periodic, solid):
    """exp(-30 / 20) = 0.22 of 3 % after 30 steps, and what blocks do not see of it (half of it at most); without, all
    of it stays. No particle in a solid."""
    left = {}
    for steps in (0, 20):
        state, stepper = scene(periodic, steps, solid)
        judge = scene(periodic, 20, solid)[1].volume
        inside = stepper.geometry.phase(squeezed(state.x, 0.03)) >= 0
        state = replace(state, x=np.where(inside[:, None], squeezed(state.x, 0.03), state.x))
        ready = stepper.ready(state)
        before = judge.expansion(state.x, 1.0)[1]
        for _ in range(30):
            found = stepper.advance(state, ready, 1e-3)
            state, ready = found.state, Handover(found.config)
        left[steps] = judge.expansion(state.x, 1.0)[1] / before
        assert (stepper.geometry.phase(state.x) >= 0).all()
    assert left[0] == pytest.approx(1.0, abs=0.1) and 0.15 < left[20] < 0.5


def test_scenes_that_do_not_ask_do_not_pay():
    _, stepper = scene(steps=0)
    assert stepper.volume is None
