"""Permeabilities of several spacings, extrapolated; mean velocities."""

import math

import numpy as np
import pytest

from isphcli.case.load import load_case, read_case
from isphcli.output.clock import Clock
from isphcli.run.permeability import EDGE, extrapolate, fluid_cells
from isphcli.run.run import run_case
from isphcli.run.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import place_case
from isphcli.validation.known_bodies import body

FLUID = "fluids: {water: {density: 1, viscosity: 1}}\nflow: stokes\n"


def test_errors_of_second_order_are_told_by_two_spacings():
    """Beside smooth walls: the value is the finest one, and of errors of order 2 two spacings tell the error itself."""
    h = np.array([1.0, 0.5, 0.25])
    k = 3.0 + 0.2 * h**2
    for spacings, values in ((h[1:], k[1:]), (h[::-1], k[::-1])):
        value, bar, order, _ = extrapolate(spacings, values)
        error = 0.2 * 0.25**2
        assert value == k[2] and order is None
        assert bar == pytest.approx(1.25 * error, rel=1e-9)  # a safety factor of 1.25
    value, bar, *_ = extrapolate(h, [1.0, 2.0, 1.5])  # no trend: both pairs tell of errors, 0.5 / 3 and 0.5 / 15
    assert value == 1.5 and bar == pytest.approx(1.25 * (0.5 / 3 + 0.5 / 15) / 2, rel=1e-12)


def test_edges_are_extrapolated_with_their_own_orders():
    """An error of the order along edges vanishes, one of the order across them ends at the bar, mixtures between."""
    across, along = EDGE
    h = np.array([1.0, 0.5])
    limit, bar, order, _ = extrapolate(h, 3.0 + 0.2 * h**along, EDGE)
    assert limit == pytest.approx(3.0, rel=1e-12) and order == along
    limit, bar, *_ = extrapolate(h, 3.0 + 0.2 * h**across, EDGE)
    assert limit - bar == pytest.approx(3.0, rel=1e-12)
    for share in (0.2, 0.5, 0.8):
        limit, bar, *_ = extrapolate(h, 3.0 + 0.2 * (share * h**across + (1 - share) * h**along), EDGE)
        assert abs(limit - 3.0) < bar
    three = np.array([1.0, 0.5, 1 / 3])
    _, wider, *_ = extrapolate(three, 3.0 + 0.2 * three**2, EDGE)  # an error that is not of edges shows in the bar
    _, bar, *_ = extrapolate(three[1:], 3.0 + 0.2 * three[1:] ** 2, EDGE)
    assert wider > bar


@pytest.mark.slow
def test_two_spacings_give_the_body_of_cubes(tmp_path):
    """blobs20 as cubes: 0.0705 voxel^2 by four spacings of our own, 0.0701 by finite volumes, 0.0702 by a lattice
    Boltzmann method, all extrapolated; the two spacings alone are 42 and 16 % above."""
    np.save(tmp_path / "blobs20.npy", body("blobs20").labels())
    text = ("geometry: {voxels: {file: blobs20.npy, labels: {solid: 0, water: 1}, voxel_size: 1, axes: xyz}, "
            "periodic: [x, y, z], wall_distance: stairs}\nparticles: {spacing: 1}\nrefine: [0.5]\n"
            "drive: {axes: [x]}\noutput: {plots: false, snapshots: false}\n" + FLUID)
    (tmp_path / "stairs.yaml").write_text(text)
    summary = run_case(load_case(tmp_path / "stairs.yaml", (f"output.directory={tmp_path / 'out'}",)), quiet=True)
    assert summary["permeability"] == pytest.approx(0.0705, rel=0.03)
    assert abs(summary["permeability"] - 0.0705) < summary["permeability_error"]


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
    """Within 4 %: curved walls, and a flux that is up to 3.5 % off. Over the particles it is 8 to 20 % off."""
    text = (f"geometry: {{box: [2, 2, 1], periodic: [x, y, z], shapes: [{{cylinder: {{axis: z, radius: 0.5}}, is: "
            f"solid, outside: true}}]}}\nparticles: {{spacing: {1 / across}}}\n"
            f"drive: {{body_force: [0, 0, 1]}}\n{FLUID}")
    case = read_case(text.encode(), "pipe.yaml")
    scene = build_scene(case, build_geometry(case), 1 / across, Clock())
    flow = solve_axis(case, scene, 2, np.array([0.0, 0.0, 1.0]), Clock())
    assert flow.mean[2] == pytest.approx(1 / 32, rel=0.04)
    porosity = scene.cells * scene.particles.site_volume / 4
    assert porosity == pytest.approx(math.pi / 16, rel=0.03)
    assert flow.mean[2] * porosity == pytest.approx(flow.superficial[2], rel=1e-12)
