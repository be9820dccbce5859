"""The seam between two reservoirs: which fluid particles become there."""

import numpy as np
import pytest

from isphcli.flow.held_velocity import Beyond
from isphcli.flow.seam import Seam
from isphcli.flow.state import phase_of
from tests.flow.runs import run
from tests.two_phase.scenes import run_loop, scene

BEHIND = np.array([[-0.9, 0.5], [-1.0, 0.5], [2.75, 0.5], [1.0, 0.1], [-0.2, 0.9]])  # of a box from -1 to 3


@pytest.mark.parametrize("inlet, outlet", [(0, 1), (1, 0)])
def test_near_the_seam_all_are_of_the_fluid_of_their_reservoir(inlet, outlet):
    """At their distance from the seam; on the seam itself they have a side too."""
    side, far = (1.0, -1.0), np.array([0.4, -0.4, 0.4, 0.3, -0.3])
    for phi in (far, -far):
        found = Seam(0, -1.0, 3.0, 0.5, (inlet, outlet), Beyond(0, 0.0, 2.0, 0.25, 1.0), 1.0).entered(BEHIND, phi)
        assert found[[0, 2]] == pytest.approx([0.1 * side[inlet], 0.25 * side[outlet]])
        assert phase_of(found[:3]).tolist() == [inlet, inlet, outlet] and found[3:].tolist() == phi[3:].tolist()


def test_the_seam_lies_across_its_axis():
    found = Seam(1, 0.0, 1.0, 0.2, (1, 0), Beyond(1, 0.3, 0.7, 0.1, 1.0), 1.0).entered(BEHIND, np.full(5, 0.7))
    assert found.tolist() == pytest.approx([0.7, 0.7, 0.7, -0.1, 0.1])


PISTON = """
geometry: {box: [2, 0.5], periodic: [x, y]}
particles: {spacing: 0.125, shifting: 0}
fluids: {water: {density: 2, viscosity: 0.3}, gas: {density: 1, viscosity: 0.3}}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 0.5}
drive: {superficial_velocity: {x: HELD}}
initial: {velocity: ["HELD", "0"]}
time: {end: 3.0, step: 0.05}
"""


@pytest.mark.slow
@pytest.mark.parametrize("held, gas", [(0.25, 1.25), (-0.25, 0.25)])
def test_a_piston_fills_the_sample_with_the_fluid_of_the_end_that_it_comes_from(held, gas):
    """0.75 of a sample of length 1 by gas from the inlet, a reservoir of 0.5 that is filled up over the seam; pushed
    back, water comes into the outlet, and of the gas only what lies at the seam is left."""
    state, config, *_ = run(PISTON.replace("HELD", str(held)))
    along = state.x[:, 0]
    sure = np.abs(along - gas) > 0.125  # a row of particles
    assert (phase_of(state.phi)[sure] == (along < gas)[sure]).all()
    assert np.unique(config.terms.density).tolist() == [0.5, 1.0]
    assert state.u[:, 0] == pytest.approx(held, rel=1e-3)


@pytest.mark.slow
def test_what_comes_over_the_seam_is_what_flows():
    """Not what rows of particles bring, half of a row more or less here: the volume of the gas is that of a quarter of
    the box and of what has flowed, to 1 % of that (0.7 measured, how exactly rows of particles sum up to a flux), and
    phi follows within a tenth of a row."""
    state, config, *_ = run(PISTON.replace("HELD", "0.25").replace("end: 3.0", "end: 1.25"))
    gas, flowed = config.terms.interface.phase == 1, 0.5 * 0.25 * 1.25
    assert state.volume[gas].sum() == pytest.approx(0.25 + flowed, abs=0.01 * flowed)
    cut = config.terms.interface.cut
    assert (cut.cells.fluid - cut.volume).sum() == pytest.approx(0.25 + flowed, abs=0.1 * 0.125 * 0.5)


def test_what_is_asked_of_a_pump_is_what_enters():
    """Past a grain, with particles in disorder and shifted: the shares of the gas grow by the flux that is held, but in
    the first step, which moves particles by the velocity that they have before it (2e-3 of the time)."""
    grain = "shapes: [{sphere: {centre: [1.0, 0.25], radius: 0.17}, is: solid}]"
    text = PISTON.replace("HELD", "0.25").replace("periodic: [x, y]", f"periodic: [x, y], {grain}")
    text = text.replace("shifting: 0", "jitter: 0.2").replace("end: 3.0", "end: 0.5")
    text = text.replace('["0.25", "0"]', '["0", "0"]')
    case, geometry, state, stepper, particles = scene(text)
    end = run_loop(case, geometry, state, stepper, particles)
    first, last = (now.volume[phase_of(now.phi) == 1].sum() for now in (state, end))
    assert stepper.seam.area == pytest.approx(0.5)
    assert last - first == pytest.approx(0.5 * 0.25 * end.time, rel=3e-3)


def test_fluids_that_differ_in_name_only_change_their_names():
    """One fluid for the equations; which name a particle has is told all the same."""
    state, config, *_ = run(PISTON.replace("HELD", "0.25").replace("gas: {density: 1", "gas: {density: 2"))
    along = state.x[:, 0]
    sure = np.abs(along - 1.25) > 0.125
    assert config.terms.density == 1.0 and (phase_of(state.phi)[sure] == (along < 1.25)[sure]).all()


PLATES = """
geometry:
  {box: [3.0e-4, 1.0e-4], periodic: [x], fluid: water, shapes: [{box: {lower: [0, 0], upper: [1.5e-4, 1]}, is: gas}]}
particles: {spacing: 1.0e-5}
fluids: {water: {density: 1000, viscosity: 0.01}, gas: {density: 1000, viscosity: 0.01}}
interface: {tension: 0.02, contact_angle: 30}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 8.0e-5}
drive: {pressure_drop: {x: 346.4}}
time: {end: 1.0e-3, capillary: 4}
"""


@pytest.mark.slow
def test_no_capillary_pressure_falls_off_where_reservoirs_meet():
    """A meniscus between plates, 2 sigma cos(theta) / W = 346 Pa, rests under a drop of just that, though both
    reservoirs lie between the plates: their walls are neutral and the seam is a plane. What is left over, 12 mu U L /
    W^2, is a twentieth at most, as of a meniscus of 10 spacings; with the angle at the seam too 250 Pa fell off there.
    """
    *_, rows = run(PLATES)
    drift = np.mean([row["superficial_velocity_x"] for row in rows[-60:]])
    assert abs(12 * 0.01 * drift * 3e-4 / 1e-8) < 0.05 * 346
