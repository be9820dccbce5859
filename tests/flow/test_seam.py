"""The seam between two reservoirs: who crosses it, and which fluid they become."""

import numpy as np
import pytest

from isphcli.domain.halo import wrap
from isphcli.flow.seam import Seam, phase_of
from tests.flow.runs import run

LOWER, UPPER = np.array([-1.0, 0.0]), np.array([3.0, 1.0])


def seam(inlet=1, outlet=0):
    return Seam(0, -1.0, 3.0, (inlet, outlet))


def brought_back(ahead):
    return wrap(ahead, LOWER, UPPER, (True, True))


def test_each_way_over_the_seam_is_told_from_none_and_from_other_axes():
    ahead = np.array([[3.1, 0.5], [-1.2, 0.5], [2.9, 1.2], [-1.0, -0.1], [3.0, 0.5]])
    assert seam().crossings(ahead, brought_back(ahead)).tolist() == [1, -1, 0, 0, 1]


def test_who_was_put_back_in_front_of_a_wall_has_not_crossed():
    ahead, stays = np.array([[3.1, 0.5]]), np.array([[2.95, 0.5]])
    assert seam().crossings(ahead, stays).tolist() == [0]


@pytest.mark.parametrize("inlet, outlet", [(0, 1), (1, 0)])
def test_particles_become_the_fluid_of_the_reservoir_that_they_enter(inlet, outlet):
    """At their distance from the seam; on the seam itself they have a side too."""
    side = [1.0, -1.0]
    phi = np.array([side[outlet], side[inlet], 0.3, side[outlet]]) * 0.2
    ahead = np.array([[3.1, 0.5], [-1.25, 0.5], [1.0, 1.2], [3.0, 0.5]])
    found = seam(inlet, outlet).entered(ahead, brought_back(ahead), phi)
    assert found[:2] == pytest.approx([0.1 * side[inlet], 0.25 * side[outlet]]) and found[2] == phi[2]
    assert phase_of(found[[0, 1, 3]]).tolist() == [inlet, outlet, inlet]


def test_who_is_of_that_fluid_already_keeps_its_distance():
    ahead = np.array([[3.1, 0.5]])
    assert seam(1, 0).entered(ahead, brought_back(ahead), np.array([-0.7])).tolist() == [-0.7]


PISTON = """
geometry: {box: [2, 0.5], periodic: [x, y]}
particles: {spacing: 0.125, shifting: 0}
fluids: {water: {density: 2, viscosity: 0.3}, gas: {density: 1, viscosity: 0.3}}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 0.5}
drive: {superficial_velocity: {x: HELD}}
initial: {velocity: ["HELD", "0"]}
time: {end: 3.0, step: 0.05}
"""


@pytest.mark.parametrize("held, inside", [(0.25, "gas"), (-0.25, "water")])
def test_a_piston_fills_the_sample_with_the_fluid_of_the_end_that_it_comes_from(held, inside):
    """0.75 of a sample of length 1 by gas from the inlet; pushed back, water comes over the seam into the outlet and
    all becomes water. The reservoir that is emptied is filled up by what comes over the seam."""
    state, config, *_ = run(PISTON.replace("HELD", str(held)))
    phase, along = phase_of(state.phi), state.x[:, 0]
    gas = (along < 1.25) if inside == "gas" else (along < 0.5 - 0.75) & (along > 0)
    near = np.abs(along - 1.25) < 0.125  # a row of particles
    assert (phase[~near] == gas[~near].astype(int)).all()
    assert np.unique(config.terms.density).tolist() == ([0.5, 1.0] if inside == "gas" else [1.0])
    assert state.u[:, 0] == pytest.approx(held, rel=1e-3)
