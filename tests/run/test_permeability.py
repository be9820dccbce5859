"""Permeabilities of several spacings, extrapolated; mean velocities."""

import math

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.run.permeability import extrapolate, fluid_cells
from isphcli.run.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import place_case

FLUID = "fluids: {water: {density: 1, viscosity: 1}}\nflow: stokes\n"


def test_extrapolation_recovers_a_power_law():
    h = np.array([1.0, 0.5, 0.25])
    limit, bar, order, sentence = extrapolate(h, 3.0 + 0.2 * h**1.7)
    assert limit == pytest.approx(3.0, rel=1e-8) and order == pytest.approx(1.7, rel=1e-6)
    assert bar == pytest.approx(0.2 * 0.25**1.7, rel=1e-6) and "observed" in sentence
    limit, bar, order, _ = extrapolate(h, [1.0, 2.0, 1.5])  # no trend: the finest value and the spread
    assert (limit, bar, order) == (1.5, 1.0, None)


@pytest.mark.parametrize("width", [3.2, 4.5, 5.9])
def test_cells_that_walls_cut_count_with_their_part(width):
    """A slit of any width between walls along the lattice: exact, to the digits of the distance."""
    text = (f"geometry: {{box: [4, 10, 4], periodic: [x, y, z], shapes: [{{box: {{lower: [-1, 1.3, -1], "
            f"upper: [5, {1.3 + width}, 5]}}, is: solid, outside: true}}]}}\nparticles: {{spacing: 1}}\n" + FLUID)
    case = read_case(text.encode(), "slit.yaml")
    geometry = build_geometry(case)
    particles = place_case(case, geometry, 1.0)
    assert fluid_cells(geometry, particles) == pytest.approx(16 * width, rel=1e-9)
    assert abs(particles.n_fluid - 16 * width) > 1.0  # which the middles of cells cannot tell


@pytest.mark.parametrize("across", [4, 5, 6, 7])
def test_the_mean_velocity_of_a_coarse_pipe(across):
    """Within 4 %: curved walls, and a flux that is up to 3.5 % off. Over the particles it is 8 to 20 % off at 4 to 7."""
    text = (f"geometry: {{box: [2, 2, 1], periodic: [x, y, z], shapes: [{{cylinder: {{axis: z, radius: 0.5}}, is: "
            f"solid, outside: true}}]}}\nparticles: {{spacing: {1 / across}}}\ndrive: {{body_force: [0, 0, 1]}}\n" + FLUID)
    case = read_case(text.encode(), "pipe.yaml")
    scene = build_scene(case, build_geometry(case), 1 / across, Clock())
    flow = solve_axis(case, scene, 2, np.array([0.0, 0.0, 1.0]), Clock())
    assert flow.mean[2] == pytest.approx(1 / 32, rel=0.04)
    porosity = scene.cells * scene.particles.site_volume / 4
    assert porosity == pytest.approx(math.pi / 16, rel=0.03)
    assert flow.mean[2] * porosity == pytest.approx(flow.superficial[2], rel=1e-12)
