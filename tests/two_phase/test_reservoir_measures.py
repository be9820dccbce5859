"""Between two reservoirs: what is joined to its own, what is cut off, and their difference of pressure."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.preflight.check import check
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.choose_measures import choose_measures, choose_profiles, choose_reservoir_measures
from isphcli.scene.prepare import prepare

TUBE = """
geometry: {box: [4, 1], periodic: [x], fluid: water, shapes: SHAPES}
particles: {spacing: 0.125}
fluids: {water: {density: 2, viscosity: 0.3}, gas: {density: 1, viscosity: 0.3}}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 1}
drive: {pressure_drop: {x: 8}}
time: {end: 1}
"""


def scene(shapes="[]"):
    case = read_case(TUBE.replace("SHAPES", shapes).encode(), "case.yaml")
    geometry = build_geometry(case)
    state, stepper, particles = prepare(case, geometry, Clock())
    between = choose_reservoir_measures(case, geometry, particles, stepper.fluids)
    return case, geometry, state, stepper, particles, between


def row_of(shapes):
    *_, state, stepper, _, between = scene(shapes)
    return between(state, stepper.configure(state.x, 0.0, state.phi), everything=True)


def test_fluids_in_their_own_places_are_joined():
    row = row_of("[{box: {lower: [0, 0], upper: [2.5, 1]}, is: gas}]")
    assert row["trapped_gas"] == row["trapped_water"] == 0.0


@pytest.mark.parametrize("first", [1.0, 2.0, 3.0])
def test_a_saturation_is_where_the_front_is(first):
    """Rows of particles that pass the ends of the sample, as they do in a run: the saturation grows as the front moves,
    without steps of a row, and stands still where the front is not in the sample."""
    *_, state, _, _, between = scene()
    for way in np.linspace(-0.2, 0.2, 9):
        x = state.x.copy()
        x[:, 0] = np.mod(x[:, 0] + way, 4.0)
        phi = x[:, 0] - first - way
        moved = replace(state, x=x, phi=np.where((x[:, 0] > 3.6) & (first < 3.5), 1.0, phi))
        assert between.saturation(moved) == pytest.approx(np.clip((first + way - 1.0) / 2.0, 0.0, 1.0), abs=1e-8)


def test_a_drop_and_a_bubble_are_cut_off():
    """4 x 4 of 16 x 8 sites each; the gas of the sample hangs together with the inlet, not over the seam with the
    outlet."""
    drop, bubble = "{lower: [1.25, 0.25], upper: [1.75, 0.75]}", "{lower: [2.25, 0.25], upper: [2.75, 0.75]}"
    row = row_of(f"[{{box: {{lower: [0, 0], upper: [2, 1]}}, is: gas}}, {{box: {drop}, is: water}}, "
                 f"{{box: {bubble}, is: gas}}]")
    assert row["trapped_water"] == pytest.approx(16 / 128) and row["trapped_gas"] == pytest.approx(16 / 128)


def test_a_closed_pocket_of_the_rock_is_not_trapped():
    """Water in 2 x 2 sites of a block of 8 x 6: no flow can reach it. The gas round it is that of the inlet."""
    hole = "{lower: [1.625, 0.25], upper: [1.875, 0.5]}"
    shapes = (f"[{{box: {{lower: [0, 0], upper: [3, 1]}}, is: gas}}, "
              f"{{box: {{lower: [1.25, 0.0], upper: [2.25, 0.75]}}, is: solid}}, {{box: {hole}, is: water}}]")
    row = row_of(shapes)
    left = 128 - 8 * 6 + 4
    assert row["trapped_water"] == 0.0 and row["closed_pockets"] == pytest.approx(4 / left)


def test_a_pocket_that_only_touches_the_inlet_is_closed_in_the_check_and_in_the_run():
    """Water in 2 x 2 sites of a block of 8 x 6 that begins where the inlet's reservoir ends: fluid could come in, and
    none could pass. The check by sites and the run by particles count it alike."""
    hole = "{lower: [1.0, 0.25], upper: [1.25, 0.5]}"
    shapes = (f"[{{box: {{lower: [0, 0], upper: [3, 1]}}, is: gas}}, "
              f"{{box: {{lower: [1, 0.0], upper: [2, 0.75]}}, is: solid}}, {{box: {hole}, is: water}}]")
    row, left = row_of(shapes), 128 - 8 * 6 + 4
    assert row["trapped_water"] == 0.0 and row["closed_pockets"] == pytest.approx(4 / left)
    found = check(read_case(TUBE.replace("SHAPES", shapes).encode(), "case.yaml"))
    assert found.connectivity.isolated_pockets == 1 and found.connectivity.percolates == (True, False)
    assert found.connectivity.isolated_share == pytest.approx(4 / left)
    assert "1 closed pockets (4.76 % of the fluid); open along x (" in found.text()


def test_one_fluid_at_both_ends_goes_round():
    """There is no seam and nothing at an interface, in the run and in the check before it."""
    text = TUBE.replace("SHAPES", "[]").replace("inlet: gas", "inlet: water")
    case = read_case(text.replace("drive:", "interface: {tension: 1}\ndrive:").encode(), "case.yaml")
    _, stepper, particles = prepare(case, build_geometry(case), Clock())
    assert stepper.seam is None and not particles.two_fluids
    left_out = {term.name for term in check(case).physics if not term.used}
    assert {"surface tension", "contact angle", "fluid contrasts", "reservoirs"} <= left_out


def test_what_only_touches_the_other_reservoir_over_the_seam_is_cut_off():
    """Gas at the outlet, which has broken through from nowhere, lies beside the gas of the inlet only over the seam."""
    *_, state, stepper, _, between = scene()
    phi = np.where((state.x[:, 0] > 2.0) | (state.x[:, 0] < 1.0), -1.0, 1.0)  # gas where phi <= 0
    state = state.__class__(**{**vars(state), "phi": phi})
    row = between(state, stepper.configure(state.x, 0.0, phi), everything=True)
    assert row["trapped_gas"] == pytest.approx(0.5) and row["trapped_water"] == pytest.approx(0.5)
    assert row["capillary_pressure"] is None and between.saturation(state) == pytest.approx(0.5)


def test_a_rest_under_a_pressure_drop_has_it_as_capillary_pressure():
    """At rest each fluid has one pressure, the two differ by the drop; the state holds what repeats from box to box."""
    case, geometry, state, stepper, particles, between = scene("[{box: {lower: [0, 0], upper: [2, 1]}, is: gas}]")
    along = state.x[:, 0]
    level = np.where(along < 2.0, 8.0, 0.0)
    state = state.__class__(**{**vars(state), "p": (level + 8.0 * along / 4.0) / 2.0})
    config = stepper.configure(state.x, 0.0, state.phi)
    assert between(state, config, everything=True)["capillary_pressure"] == pytest.approx(8.0)
    assert between(state.__class__(**{**vars(state), "step": 7}), config)["capillary_pressure"] is None
    rows = list(choose_profiles(case, geometry, stepper.fluids).rows(state, particles.phase))
    assert [row["pressure"] for row in rows] == pytest.approx([8.0] * 8 + [0.0] * 8, abs=1e-12)
    assert [row["saturation_gas"] for row in rows] == [1.0] * 8 + [0.0] * 8
    assert rows[0]["pressure_water"] is None and rows[0]["x"] == pytest.approx(0.125)


def test_the_seam_is_no_interface():
    """Nothing jumps there, and its area is none: what is measured is the front in the sample. As at rest above."""
    text = TUBE.replace("SHAPES", "[{box: {lower: [0, 0], upper: [2, 1]}, is: gas}]")
    case = read_case(text.replace("drive:", "interface: {tension: 1}\ndrive:").encode(), "case.yaml")
    geometry = build_geometry(case)
    state, stepper, particles = prepare(case, geometry, Clock())
    along = state.x[:, 0]
    state = state.__class__(**{**vars(state), "p": (np.where(along < 2.0, 8.0, 0.0) + 8.0 * along / 4.0) / 2.0})
    measures = choose_measures(case, geometry, particles, stepper.fluids)
    row = measures(state, stepper.configure(state.x, 0.0, state.phi), everything=True)
    assert row["pressure_jump"] == pytest.approx(-8.0, abs=1e-6) and row["interface_area"] == pytest.approx(1.0)
