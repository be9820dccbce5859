"""Relative permeability: layers between plates against their formula, fluids that no path leads through."""

import numpy as np
import pytest
from click.testing import CliRunner

from isphcli.case.load import read_case
from isphcli.cli import main
from isphcli.output.clock import Clock
from isphcli.runs.relative_permeability import Relative, Sample, SnapshotError, relative_permeabilities
from isphcli.runs.run import run_case
from isphcli.scene.build_geometry import build_geometry

LAYERS = """
geometry: {box: [0.375, 1], periodic: [x], fluid: water, shapes: [{box: BOX, is: oil}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 2, viscosity: 0.5}, oil: {density: 2, viscosity: 0.1}}
drive: {body_force: [1, 0]}
time: {end: 0.001, max_steps: 1}
output: {plots: false}
"""


def left(directory, box, *sets):
    text = LAYERS.replace("BOX", box)
    run_case(read_case(text.encode(), "case.yaml", (f"output.directory={directory}", *sets)), quiet=True)
    return directory


@pytest.mark.slow
def test_layers_between_plates_carry_the_cubes_of_their_shares(tmp_path):
    """Plane Poiseuille flow is exact on a lattice (tests of the operators); sums over 6 and 10 rows in place of
    integrals are corrected beside walls along it. What is left is the wall, a zero of a spline."""
    out = left(tmp_path / "out", "{lower: [-1, 0.375], upper: [2, 2]}")
    (found,) = relative_permeabilities(out, Clock())
    assert found.axis == "x" and found.saturation == pytest.approx((0.375, 0.625))
    assert found.permeability == pytest.approx(1 / 12, rel=2e-3)
    assert found.relative == pytest.approx((0.375**3, 0.625**3), rel=5e-3)
    printed = CliRunner().invoke(main, ["relperm", str(out), "--all"]).stdout.splitlines()
    assert printed[0] == ("time,saturation_water,saturation_oil,k_r_water,k_r_oil,"
                          "leads_through_water,leads_through_oil")
    assert len(printed) == 3 and printed[-1].endswith(",1,1")
    assert float(printed[-1].split(",")[4]) == pytest.approx(found.relative[1], rel=1e-4)


@pytest.mark.slow
def test_a_slug_across_the_channel_stops_both(tmp_path):
    """And it is said why they do not flow."""
    out = left(tmp_path / "out", "{lower: [0.125, 0], upper: [0.25, 1]}")
    (found,) = relative_permeabilities(out, Clock())
    assert found.relative == (0.0, 0.0) and found.saturation == pytest.approx((2 / 3, 1 / 3))
    assert found.leads_through == (False, False)
    printed = CliRunner().invoke(main, ["relperm", str(out)]).stdout
    assert found.at_ends == pytest.approx((1.0, 1.0)) and found.warnings == []  # what stops it is said beside the 0
    assert "it holds 0 of the pores in the first layer along x" in found.why_zero(1)
    for name in ("water", "oil"):
        assert f"0 (no path through {name} alone leads through the sample along x" in printed


def test_saturations_are_of_volume_and_ends_are_told(tmp_path):
    """Cells count, not particles: with every second particle of the oil left out it still holds what it held, but for
    what its interface moves (half a spacing of 16). Where it holds a tenth of the first layer and half of all, its k_r
    is said to be that of the layer."""
    case = read_case(LAYERS.replace("BOX", "{lower: [-1, 0.5], upper: [2, 2]}").encode(), "case.yaml")
    sample = Sample(case, build_geometry(case, 0), 0, Clock())
    oil = sample.x[:, 1] > 0.5
    kept = ~oil | (np.arange(len(oil)) % 2 == 0)
    phase = oil.astype(np.int8)
    assert phase[kept].mean() < 0.35
    for chosen in (np.ones(len(oil), bool), kept):
        assert sample.shares(*sample.nearest(sample.x[chosen], phase[chosen])) == pytest.approx((0.5,) * 3, abs=0.032)
    found = Relative(0.0, "x", ("water", "oil"), (0.5, 0.5), (0.2, 0.1), (True, True), 1.0, (0.9, 0.5))
    (said,) = found.warnings
    assert "of oil" in said and "it holds 0.1 of the pores in the first layer along x" in said
    assert "--part 0.25:1" in said


@pytest.mark.slow
def test_a_part_of_the_sample_is_that_between_its_shares(tmp_path):
    """Beside the slug there is water only: it flows as if it were alone, and the slug's half has what is left of it."""
    out = left(tmp_path / "out", "{lower: [0, 0], upper: [0.1875, 1]}")
    (found,) = relative_permeabilities(out, Clock(), part=(0.5, 1.0))
    assert found.relative == pytest.approx((1.0, 0.0)) and found.saturation == (1.0, 0.0)
    assert found.why_zero(0) is None and found.why_zero(1) == "there is none of it in the sample"
    printed = CliRunner().invoke(main, ["relperm", str(out), "--part", "1:0.5"])
    assert printed.exit_code == 2 and "is not of the form" in printed.output


def test_a_folder_without_snapshots_of_two_fluids_is_refused(tmp_path):
    with pytest.raises(SnapshotError, match=r"has no case.yaml and particles.pvd"):
        relative_permeabilities(tmp_path, Clock())
    bare = left(tmp_path / "bare", "{lower: [-1, 0.375], upper: [2, 2]}", "output.fields=[velocity]")
    with pytest.raises(SnapshotError, match=r"no snapshot of two fluids"):
        relative_permeabilities(bare, Clock())
    assert CliRunner().invoke(main, ["relperm", str(bare)]).exit_code == 2
