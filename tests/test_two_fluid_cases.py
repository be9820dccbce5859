"""The cases with two fluids, small and short: each finds a physical number."""

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid

from isphcli.case.load import load_case
from isphcli.output.files import read_history
from isphcli.references.drops import laplace_jump
from isphcli.runs.run import run_case
from tests.paths import CASES


def run(name, directory, *overrides):
    options = (*overrides, "output.snapshots=false", "output.plots=false", f"output.directory={directory}")
    summary = run_case(load_case(CASES / f"{name}.yaml", options), quiet=True, overwrite=True)
    return summary, read_history(directory / "history.csv")


@pytest.mark.slow
@pytest.mark.parametrize("name, side", [("square_drop_1", 0.1), ("square_drop_4", 0.4)])
def test_a_square_drop_relaxes_to_its_pressure(name, side, tmp_path):
    """24 x 24 in place of 36 x 36, not yet at rest: the jump is known to 5 %, the centre cannot have moved."""
    time = 0.6 * side**1.5 / 0.1**1.5 * 0.1
    summary, _ = run(name, tmp_path, f"particles.spacing={side / 12}", f"time.end={time}")
    found = summary["two_fluids"]
    assert found["pressure_jump"] == pytest.approx(laplace_jump(1.0, side / math.sqrt(math.pi), 2), rel=0.05)
    assert found["volume_drop"] == pytest.approx(side**2, rel=0.01)
    assert (found["centre_x_drop"], found["centre_y_drop"]) == pytest.approx((side, side), abs=1e-3 * side)
    assert found["ganglia_drop"] == 1
    assert "surface tension (jump)" in summary["terms"]


@pytest.mark.slow
def test_a_cube_of_fluid_contracts_to_a_ball(tmp_path):
    """At 0.03 s the corners are gone. Nothing else has: volume, centre, one drop. A cube of 6 spacings is measured
    with rounded edges at the start: 0.19 for the 6 x 0.04 of its faces, which energies are compared with."""
    summary, rows = run("drop_3d", tmp_path, "particles.spacing=0.033333333", "time.end=0.03")
    found = summary["two_fluids"]
    assert found["volume_drop"] == pytest.approx(0.008, rel=0.05)
    assert [found[f"centre_{a}_drop"] for a in "xyz"] == pytest.approx([0.2] * 3, abs=1e-3)
    assert found["surface_energy"] < rows[0]["surface_energy"]  # what it loses moves the fluid, and heats it
    assert 0.24 - found["surface_energy"] > rows[-1]["kinetic_energy"]


@pytest.mark.parametrize("name, bound", [("two_layer_couette", 0.02), ("two_layer_poiseuille", 0.15)])
def test_layers_share_the_stress(name, bound, tmp_path):
    """16 across in place of 32; the slowest mode has decayed by more than e^-6 at 0.3. Couette flow is linear in each
    layer; of the parabolas, 16 across have measured 10 % with support 2.3. With one viscosity for both it is 300 %."""
    summary, _ = run(name, tmp_path, "particles.spacing=0.0625", "time.end=0.3")
    assert abs(summary["errors"][summary["errors"]["main"]]) < bound
    assert {"two fluids", "viscosity jump"} <= set(summary["terms"])
    assert "density jump" not in summary["terms"] and "interface_area" not in summary["two_fluids"]


@pytest.mark.slow
def test_a_light_layer_rests_on_a_heavy_one(tmp_path):
    """The pressure at the floor is the weight of both: nothing moves."""
    summary, _ = run("layered_hydrostatics", tmp_path, "particles.spacing=0.0625", "time.end=0.1")
    assert summary["errors"]["pressure_relative_l2"] < 1e-5
    assert summary["errors"]["speed_relative"] < 1e-7  # the solves stop at 1e-6 of what they start from


@pytest.mark.slow
def test_a_bubble_rises_and_the_liquid_sinks(tmp_path):
    """The box is closed: as much liquid goes down as bubble goes up, and its centre moves with its velocity. A disk in
    a wide box starts with g (rho_l - rho_b) / (rho_l + rho_b); walls two radii off hold it back."""
    summary, rows = run("rising_bubble", tmp_path, "particles.spacing=0.0625", "time.end=0.2", "reference=null")
    found = summary["two_fluids"]
    up = found["volume_bubble"] * found["velocity_y_bubble"]
    assert found["volume_liquid"] * found["velocity_y_liquid"] == pytest.approx(-up, rel=0.03)  # 1.2 %
    times, speeds = ([row[key] for row in rows] for key in ("time", "velocity_y_bubble"))
    risen = trapezoid([0.0, *speeds], [0.0, *times])
    assert found["centre_y_bubble"] - 0.5 == pytest.approx(risen, rel=0.08)
    assert 0.3 * 0.8 * 0.2 < found["velocity_y_bubble"] < 0.8 * 0.2
    assert found["spurious_capillary_number"] is None and "slip walls" in summary["terms"]


@pytest.mark.slow
def test_a_bubble_of_a_thousandth_of_the_density_rises(tmp_path):
    """Case 2 of Hysing et al. (2009) at 1/20: largest rise velocity within 4 % of the published 0.2502 to 0.2517
    (0.2525 measured; 0.254 at 1/40), and no gas faster than that flow makes it: a capillary number of 2.8. With the
    pressure of liquid that has become gas as it was, steps threw the gas about at 13."""
    case_2 = ("fluids.bubble.density=1", "fluids.bubble.viscosity=0.1", "interface.tension=1.96")
    _, rows = run("rising_bubble", tmp_path, "particles.spacing=0.05", "time.end=0.7", "reference=null", *case_2)
    assert max(row["velocity_y_bubble"] for row in rows) == pytest.approx(0.251, rel=0.04)
    assert max(row["peak_capillary_number"] for row in rows) < 4.0


@pytest.mark.slow
def test_drops_on_a_wall_feel_their_angle(tmp_path):
    """11 particles across and on the way: the centre of the one that wets the wall sinks, the other is higher."""
    low, high = (run(f"drop_wall_{angle}", tmp_path / str(angle), "particles.spacing=0.018181818", "time.end=0.05")[0]
                 for angle in (60, 150))  # fmt: skip
    assert low["two_fluids"]["centre_y_drop"] < 0.095
    assert high["two_fluids"]["centre_y_drop"] > low["two_fluids"]["centre_y_drop"] + 0.002
    assert low["two_fluids"]["circularity"] is None and "contact angle" in low["terms"]


@pytest.mark.slow
def test_a_drop_on_a_tilted_wall_meets_its_angle(tmp_path):
    """11 particles across, from half a disk: it swings, and at 0.45 s is within 5 degrees of 60; its volume stays."""
    summary, _ = run("drop_tilted_wall_60", tmp_path, "particles.spacing=0.018181818", "time.end=0.45")
    assert summary["two_fluids"]["contact_angle"] == pytest.approx(60, abs=5)
    assert abs(summary["errors"]["volume_relative"]) < 0.03


@pytest.mark.slow
def test_a_capillary_wave_swings(tmp_path):
    """24 a wavelength: the height is off by 5.3 % (root mean square) and passes through zero 1.1 % late."""
    summary, _ = run("capillary_wave", tmp_path, "particles.spacing=0.04166667", "time.end=0.4")
    assert abs(summary["errors"]["first_zero_relative"]) < 0.02
    assert summary["errors"]["amplitude_relative_l2"] < 0.07


@pytest.mark.slow
def test_water_fills_a_slit(tmp_path):
    """8 across in place of 16, and a quarter of the time: what has gone in and how fast, -2.2 and -1.9 % measured."""
    summary, _ = run("slit_imbibition", tmp_path, "particles.spacing=1.25e-5", "time.end=4e-4")
    assert abs(summary["errors"]["gone_relative"]) < 0.04
    assert abs(summary["errors"]["velocity_relative"]) < 0.04


@pytest.mark.slow
def test_a_drop_oscillates(tmp_path):
    """6.4 spacings in its radius; frequency and damping to 20 % of the frequency."""
    summary, _ = run("oscillating_drop", tmp_path, "particles.spacing=0.0625", "time.end=1.2")
    assert summary["errors"]["rate_relative"] < 0.2


@pytest.mark.slow
def test_co2_bubbles_start_to_fall_with_the_body_force(tmp_path):
    """In 0.05 ms the wall has slowed down a layer of 7 um of 2.2 mm: 0.7 % of the momentum g t."""
    summary, _ = run("co2_bubbles", tmp_path, "time.end=5e-5")
    found = summary["two_fluids"]
    share = found["volume_co2"] / (found["volume_co2"] + found["volume_water"])
    column = math.pi * 2.2e-3**2 * 1.28e-3
    # bubbles of two spacings in radius
    assert share == pytest.approx(60 * 4 / 3 * math.pi * 2.5e-4**3 / column, rel=0.1)
    masses = np.array([1000 * (1 - share), 500 * share])
    speed = masses @ [found["velocity_z_water"], found["velocity_z_co2"]] / masses.sum()
    assert speed == pytest.approx(4.9 * 5e-5, rel=0.05)
    assert {"density jump", "viscosity jump", "body force", "walls"} <= set(summary["terms"])


@pytest.mark.slow
def test_a_bubble_that_rises_keeps_its_volume(tmp_path):
    """15 across, between walls, until its edge is sharp: 0.21 % at most is what one step makes, 0.01 % is left over
    many. Without the shares that particles hold of it, it had gained 0.3 % and went on."""
    _, rows = run("rising_bubble", tmp_path, "particles.spacing=0.033333333", "time.end=1.5", "reference=null")
    volumes = np.array([row["volume_bubble"] for row in rows])
    assert volumes[0] == pytest.approx(math.pi / 16, rel=1e-3) and np.abs(volumes / volumes[0] - 1).max() < 4e-3
    assert volumes[-len(rows) // 3 :].mean() == pytest.approx(volumes[0], rel=1e-3)


@pytest.mark.slow
def test_co2_goes_into_the_rock(tmp_path):
    """A piece of 16^3 voxels at a flux held in its clear layers. CO2 is neither made nor lost: its volume is kept to
    0.3 % of the pores (0.13 measured over 300 steps).
    Once the flat front of the start has its menisci, which pull brine out of the rock at first, the saturation rises
    as the flux says: 2 to 3 % less measured, to step 300 1.6 % less."""
    summary, rows = run("berea_drainage", tmp_path, "geometry.voxels.crop=[[40, 56], [40, 56], [40, 56]]",
                        "initial.flood.saturation=0.2", "time.max_steps=80")  # fmt: skip
    found = summary["two_fluids"]
    assert [row["superficial_velocity_x"] for row in rows] == pytest.approx([0.026] * len(rows), rel=1e-6)
    assert summary["superficial_velocity"][0] == pytest.approx(0.026, rel=1e-6)
    assert summary["mean_velocity"][0] * summary["porosity"] == pytest.approx(0.026, rel=1e-6)
    pores = summary["porosity"] * (16 * 3e-6) ** 3
    volumes = np.array([row["volume_co2"] for row in rows]) / pores
    assert np.abs(volumes - volumes[0]).max() < 3e-3
    first = rows[len(rows) // 4]
    volume = 0.026 * (rows[-1]["time"] - first["time"]) * (16 * 3e-6) ** 2
    assert rows[-1]["saturation_co2"] - first["saturation_co2"] == pytest.approx(volume / pores, rel=0.08)
    assert summary["pressure_drop"] > 0 and found["centre_x_co2"] is not None
    assert found["volume_co2"] + found["volume_brine"] == pytest.approx(summary["particles"]["fluid"] * 3e-6**3)
    parts = [found["kinetic_energy_co2"], found["kinetic_energy_brine"]]
    assert sum(parts) == pytest.approx(rows[-1]["kinetic_energy"], rel=1e-8) and min(parts) > 0
    assert {"held velocity", "contact angle"} <= set(summary["terms"]) and "body force" not in summary["terms"]


@pytest.mark.slow
def test_co2_is_injected_into_the_rock(tmp_path):
    """A piece of 16^3 voxels. All that comes over the seam is CO2: in the rock is what the flux brought, and none of it
    is cut off from the inlet. The pressure drop begins with the layers at the walls, not with what one solve leaves of
    the divergence of an impulse, which the first step made up for by twenty times as much."""
    summary, rows = run("berea_injection", tmp_path, "geometry.voxels.crop=[[40, 56], [40, 56], [40, 56]]",
                        "time.max_steps=50")  # fmt: skip
    pores = summary["porosity"] * (16 * 3e-6) ** 3
    injected = 0.05 * rows[-1]["time"] * (16 * 3e-6) ** 2 / pores
    assert rows[0]["saturation_co2"] < 0.01 and injected > 0.02
    assert rows[-1]["saturation_co2"] == pytest.approx(injected, rel=0.1)  # as in berea_drainage
    drops = [row["pressure_drop_x"] for row in rows]
    assert max(map(abs, drops[:3])) < 3 * np.median(drops)
    grown = (rows[-1]["volume_co2"] - rows[0]["volume_co2"]) / pores  # 1.06 with the seam among what gives volume back
    assert grown == pytest.approx(injected, rel=0.04)
    assert summary["two_fluids"]["trapped_co2"] == 0 and "reservoirs" in summary["terms"]
    last = [row for row in read_history(tmp_path / "profiles.csv") if row["step"] == rows[-1]["step"]]
    assert last[0]["saturation_co2"] == 1 and last[-1]["saturation_brine"] == 1
    assert last[0]["pressure"] > last[-1]["pressure"]


@pytest.mark.slow
def test_a_slit_is_drained_above_its_entry_pressure(tmp_path):
    """346 Pa. Below it each fluid comes to rest with the drop between their pressures, at 8 across within 25 Pa. At 450
    Pa CO2 goes through. One of the 64 particles of the slit may go to and fro between the fluids: 0.016."""
    steps = "drive.steps={pressure_drop: [200, 300, 450], duration: 3e-3, settled: 0.02, window: 5e-4}"
    run("slit_drainage", tmp_path, "particles.spacing=1.25e-5", steps)
    low, high, through = read_history(tmp_path / "curve.csv")
    assert [row["settled"] for row in (low, high)] == [1, 1] and high["saturation_co2"] < 0.5
    assert low["saturation_co2"] < high["saturation_co2"]
    assert [row["capillary_pressure"] for row in (low, high)] == pytest.approx([200, 300], abs=25)
    assert through["saturation_co2"] > 0.8
