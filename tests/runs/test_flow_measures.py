"""What is measured of a flow, against formulas."""

import numpy as np
import pytest

from isphcli import api
from isphcli.case.load import read_case
from isphcli.domain.lattice import make_lattice
from isphcli.runs.flow_measures import (
    effective_diffusivity,
    profile_rows,
    speed_distribution,
    tortuosity,
    wall_stress,
)
from isphcli.scene.build_geometry import build_geometry

SLIT = {
    "geometry": {"box": [0.25, 1.0], "periodic": ["x"]},
    "particles": {"spacing": 1 / 32},
    "fluids": {"water": {"density": 2.0, "viscosity": 3.0}},
    "flow": "stokes",
    "drive": {"axes": ["x"], "body_force": [0.5, 0.0]},
}


@pytest.fixture(scope="module")
def slit():
    case = {**SLIT, "drive": {"body_force": [0.5, 0.0]}}
    return api.run({**case, "measure": ["formation_factor"]}, quiet=True).summary


def test_wall_shear_of_a_slit_is_half_of_what_drives_it(slit):
    """rho g h / 2; the profile is a parabola, which the slope at the wall is exact for: what is left is the tolerance
    of the solve, 1e-6, over the smallest wall distance of the layer, 0.5 spacings of 32."""
    for key in ("mean", "median", "q95"):
        assert slit["wall_shear"][key] == pytest.approx(2.0 * 0.5 * 1.0 / 2, rel=1e-4)


def test_speeds_of_a_slit_are_those_of_a_parabola(slit):
    """The share 1 - sqrt(1 - u/u_max) is slower than u: u_q = u_max (1 - (1 - q)^2). Quantiles of 32 layers of
    particles, in pairs of the same speed, are off by half of 1/16 of the share at most, times the slope 2 u_max."""
    most = 2.0 * 0.5 / (8 * 3.0)
    assert slit["speed"]["mean"] == pytest.approx(2 / 3 * most, rel=1e-3)
    for q in (5, 25, 50, 75, 95):
        share = q / 100
        assert abs(slit["speed"][f"q{q:02d}"] - most * (1 - (1 - share) ** 2)) < most * 2 / 32 * (1 - share + 1 / 32)


def test_a_straight_slit_is_straight(slit):
    """Diffusion along straight walls is undisturbed: what conducts is the fluid, all of the box."""
    assert slit["tortuosity"] == pytest.approx(1.0, abs=1e-9)
    assert slit["formation_factor"] == pytest.approx(1.0, abs=1e-9)


def test_tortuosity_of_helices():
    """A flow that turns round the axis with the slope 1: every way is sqrt(2) times the length."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    velocity = np.stack([np.ones(12), np.cos(angle), np.sin(angle)], axis=1)
    assert tortuosity(velocity, 0) == pytest.approx(np.sqrt(2))
    assert tortuosity(velocity, 1) is None and tortuosity(velocity[:0], 0) is None
    assert speed_distribution(velocity[:0], np.ones(0)) is None


def test_clear_layers_are_taken_off_the_resistance():
    """A sample of half the length whose diffusivity is 1/4: resistances 2 and 1/2 in series, q = 1 / (0.5 + 2)."""
    text = b"geometry: {box: [1.0, 1.0], periodic: [x]}\nparticles: {spacing: 0.25}\nflow: stokes\n" \
           b"drive: {axes: [x]}\nfluids: {water: {density: 1, viscosity: 1}}\n"
    geometry = build_geometry(read_case(text, "case.yaml"))
    geometry.sample_lower, geometry.sample_upper = np.array([0.25, 0.0]), np.array([0.75, 1.0])
    lattice = make_lattice("square", [0.0, 0.0], [1.0, 1.0], [True, False], 0.25, 0.0)
    x = np.array([[0.125, 0.5], [0.375, 0.5], [0.625, 0.5], [0.875, 0.5]])
    flux = np.zeros((4, 2))
    flux[:, 0] = [0.4, 0.8, 0.8, 0.4]  # half of the sample is fluid
    assert effective_diffusivity(geometry, x, flux, 4.0, lattice, 0) == pytest.approx(0.25)


def test_no_shear_of_walls_that_slip():
    text = b"geometry: {box: [1.0, 1.0], periodic: [x], slip_length: 0.1}\nparticles: {spacing: 0.25}\nflow: stokes\n" \
           b"drive: {axes: [x]}\nfluids: {water: {density: 1, viscosity: 1}}\n"
    geometry = build_geometry(read_case(text, "case.yaml"))
    x = np.array([[0.5, 0.125]])
    assert wall_stress(geometry, x, np.ones((1, 2)), np.zeros((1, 2)), (0.25, 1.0)) is None


def test_the_bar_of_the_formation_factor_holds_the_truth():
    """Insulating spheres on a simple cubic array, by the formula of Rayleigh as McPhedran and McKenzie (1978, Proc. R.
    Soc. Lond. A 359, 45) have it, good to 1e-4 at this solid fraction. Errors are of first order in the spacing."""
    c = 0.216
    truth = 1.0 / (1.0 - 3.0 * c / (2.0 + c + 0.9785 * c ** (10.0 / 3.0)))
    radius = (3.0 * c / (4.0 * np.pi)) ** (1.0 / 3.0)
    case = {"geometry": {"box": [1.0] * 3, "periodic": ["x", "y", "z"],
                         "shapes": [{"sphere": {"centre": [0.5] * 3, "radius": radius}, "is": "solid"}]},
            "particles": {"spacing": 1 / 10}, "fluids": {"water": {"density": 1.0, "viscosity": 1.0}},
            "flow": "stokes", "drive": {"axes": ["x"]}, "measure": ["formation_factor"], "refine": [1 / 14]}
    found = api.run(case, quiet=True).summary
    assert abs(found["formation_factor"] - truth) < found["formation_factor_error"] < 0.1
    assert found["effective_diffusivity"] == pytest.approx(1.0 / found["formation_factor"])
    share = found["formation_factor_error"] / found["formation_factor"]
    assert found["effective_diffusivity_error"] == pytest.approx(share * found["effective_diffusivity"])


def test_the_profile_of_a_slit_falls_by_what_drives_it():
    """All layers have the same flux, and the pressure falls by rho g along the axis."""
    case = {**SLIT, "drive": {"body_force": [0.5, 0.0]}}
    found = api.run(case, quiet=True)
    x, geometry = found.x, found.flow.geometry
    rows = profile_rows(geometry, x, (found.velocity, found.pressure), 0, 2.0 * 0.5 * 0.25, (1 / 32, 1 / 32**2, 1 / 32))
    assert len(rows) == 8
    assert np.allclose([row["superficial_velocity"] for row in rows], 2.0 * 0.5 / 36.0, rtol=2e-3)  # h^2 / 12 g / nu
    slope = np.diff([row["pressure"] for row in rows]) / np.diff([row["x"] for row in rows])
    assert np.allclose(slope, -2.0 * 0.5, rtol=1e-3)
