"""Permeabilities: of several spacings, of the sample alone whatever its clear layers, of mirrored images; mean
velocities."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from isphcli.case.load import load_case, read_case
from isphcli.domain.lattice import BASES, make_lattice
from isphcli.geometry.faces import Walls
from isphcli.geometry.labels import ClearLayers
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.output.clock import Clock
from isphcli.references.ducts import duct_permeability
from isphcli.runs.permeability import (
    EDGE,
    EDGE_USUAL,
    FLUX,
    USUAL,
    clear_permeability,
    extrapolate,
    fluid_cells,
    mean_velocities,
    spread_of_flux,
)
from isphcli.runs.run import run_case
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import place_case
from isphcli.validation.known_bodies import body
from tests.geometry.test_clear_layer import blobs

FLUID = "fluids: {water: {density: 1, viscosity: 1}}\nflow: stokes\n"
IMAGE = """
geometry: {voxels: {file: image.npy, labels: {solid: 1, water: 0}, voxel_size: 1}, wall_distance: stairs}
particles: {spacing: 1}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
solver: {tolerance: 1.0e-8}
output: {snapshots: false, plots: false}
"""


def test_errors_of_the_usual_order_are_told_by_two_spacings():
    """Beside smooth walls: the value is the finest one, and of errors of second order two spacings tell the error
    itself."""
    h = np.array([1.0, 0.5, 0.25])
    k = 3.0 + 0.2 * h**2
    for spacings, values in ((h[1:], k[1:]), (h[::-1], k[::-1])):
        value, bar, order, _ = extrapolate(spacings, values)
        assert value == k[2] and order is None
        assert bar == pytest.approx(0.2 * 0.25**2, rel=1e-9)
    value, bar, *_ = extrapolate(h, [1.0, 2.0, 1.5])  # no trend: both pairs tell of errors, 0.5 / 3 and 0.5 / 15
    assert value == 1.5 and bar == pytest.approx(0.5 * (1 / 3 + 1 / 15) / 2, rel=1e-12)


def test_two_spacings_that_agree_by_chance_do_not_make_a_bar_of_nothing():
    """A part of the usual error, and what the flux of the finest spacing differs by between layers, are in every bar,
    added as squares."""
    _, alone, *_ = extrapolate([1.0, 0.5], [2.0, 2.0])
    _, bar, *_ = extrapolate([1.0, 0.5], [2.0, 2.0], usual=0.03)
    assert alone == 0.0 and bar == pytest.approx(2.0 * 0.03 * USUAL, rel=1e-12)
    told = extrapolate([1.0, 0.5], [2.1, 2.0])[1]
    assert extrapolate([1.0, 0.5], [2.1, 2.0], usual=0.03)[1] == pytest.approx(math.hypot(told, bar), rel=1e-12)
    both = extrapolate([1.0, 0.5], [2.0, 2.0], usual=0.03, flux=0.01)[1]
    assert both == pytest.approx(math.hypot(2.0 * 0.01 * FLUX, bar), rel=1e-12)


@pytest.mark.parametrize("kind", BASES)
@pytest.mark.parametrize("offset", [None, 0.5, 0.3, -0.75])
def test_the_flux_of_a_plug_is_the_same_through_all_layers(kind, offset):
    """Of every lattice along every axis, wherever it lies in the box; of a plug that is faster in half of the box along
    the axis the spread is that of its two speeds."""
    dim = BASES[kind].shape[1]
    lower, length = np.full(dim, 0.7), np.array([1.0, 1.7, 1.3][:dim])
    lattice = make_lattice(kind, lower, lower + length, [True] * dim, 0.1, 0.3, offset and [offset] * dim)
    x = lower + np.mod(np.concatenate([*lattice.slabs()]) - lower, length)
    for axis in range(dim):
        assert spread_of_flux(lattice, x, np.ones(len(x)), axis) < 1e-12
    if offset is None:
        assert spread_of_flux(lattice, x, np.where(x[:, 0] < 1.2, 1.0, 3.0), 0) == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("kind", BASES)
@pytest.mark.parametrize("offset", [0.0, 0.5, 0.3])
@pytest.mark.parametrize("spacing", [0.1, 0.125, 0.17])
def test_the_superficial_velocity_of_a_plug_is_its_own_wherever_the_ends_of_the_sample_lie(kind, offset, spacing):
    """Between clear layers, at every spacing: on layers of the lattice, between them and anywhere. Layers that an end
    cuts count by what lies within."""
    dim = BASES[kind].shape[1]
    lower, upper = np.array([-0.5, 0.0, 0.0])[:dim], np.array([1.5, 1.0, 1.0])[:dim]
    sample = lower.copy(), upper.copy()
    sample[0][0], sample[1][0] = 0.0, 1.0
    scene = SimpleNamespace(lower=lower, upper=upper, sample_lower=sample[0], sample_upper=sample[1], dim=dim)
    lattice = make_lattice(kind, lower, upper, [True] * dim, spacing, 0.3, [offset, *[0.0] * (dim - 1)])
    x = lower + np.mod(np.concatenate([*lattice.slabs()]) - lower, upper - lower)
    superficial, _ = mean_velocities(scene, x, np.ones((len(x), dim)), lattice.site_volume, thick=lattice.thick)
    assert np.abs(superficial - 1.0).max() < 1e-8


def test_an_order_that_is_given_is_taken():
    """Errors of first order: the difference of two spacings of which one is half the other is the error, 1.25 of it
    the bar, whatever is usual."""
    assert extrapolate([1.0, 0.5], [2.2, 2.1], given=(1.0, 1.25), usual=0.5)[1] == pytest.approx(1.25 * 0.1, rel=1e-9)


def test_edges_are_extrapolated_with_their_own_orders():
    """An error of the order along edges vanishes, the bar is three quarters of one of the order across them, and holds
    mixtures of both of which at least 0.3 is along edges."""
    across, along = EDGE
    h = np.array([1.0, 0.5])
    limit, bar, order, _ = extrapolate(h, 3.0 + 0.2 * h**along, EDGE)
    assert limit == pytest.approx(3.0, rel=1e-12) and order == along
    limit, bar, *_ = extrapolate(h, 3.0 + 0.2 * h**across, EDGE)
    assert limit - bar / 0.75 == pytest.approx(3.0, rel=1e-12)
    for share in (0.2, 0.5, 0.7):
        limit, bar, *_ = extrapolate(h, 3.0 + 0.2 * (share * h**across + (1 - share) * h**along), EDGE)
        assert abs(limit - 3.0) < bar
    three = np.array([1.0, 0.5, 1 / 3])
    _, wider, *_ = extrapolate(three, 3.0 + 0.2 * three**2, EDGE)  # an error that is not of edges shows in the bar
    _, bar, *_ = extrapolate(three[1:], 3.0 + 0.2 * three[1:] ** 2, EDGE)
    assert wider > bar
    _, alone, *_ = extrapolate(h, [2.0, 2.0], EDGE, usual=0.03)  # two spacings that agree by chance
    assert alone == pytest.approx(EDGE_USUAL * 2.0 * 0.03, rel=1e-12)


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


@pytest.mark.parametrize("lattice", ["cubic", "bcc"])
def test_grains_three_spacings_across_have_their_volume(lattice):
    """14 spheres at random: to 1 % of what they hold. By whole cells, whose walls are taken for planes, a tenth more
    (bcc, whose particles are nearer, 6 %)."""
    text = (f"geometry: {{box: [10, 10, 10], periodic: [x, y, z], shapes: [{{spheres: {{random: 14, radius: 1.5, "
            f"seed: 1}}, is: solid}}]}}\nparticles: {{spacing: 1, lattice: {lattice}}}\n" + FLUID)
    case = read_case(text.encode(), "pack.yaml")
    geometry = build_geometry(case)
    particles = place_case(case, geometry, 1.0)
    solid = 14 * 4 / 3 * math.pi * 1.5**3
    assert 1000 - fluid_cells(geometry, particles) * particles.site_volume == pytest.approx(solid, rel=0.01)


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
    assert porosity == pytest.approx(math.pi / 16, rel=0.005)
    assert flow.mean[2] * porosity == pytest.approx(flow.superficial[2], rel=1e-12)


def image_run(tmp_path, solid, *sets):
    """Summary of a run of an image; solid: bool [z, y, x] or [y, x]."""
    np.save(tmp_path / "image.npy", solid.astype(np.uint8))
    return run_case(read_case(IMAGE.encode(), tmp_path / "case.yaml", (*sets, f"output.directory={tmp_path}/out")),
                    quiet=True, overwrite=True)


@pytest.mark.parametrize("layer", [1, 4, 16])
def test_a_slit_has_its_own_permeability_behind_any_clear_layer(tmp_path, layer):
    """Image of a slit 8 voxels wide, 5 long: h^2 / 12 to what the tolerance of the solver leaves. What its layers
    resist, up to six times as much as itself, is not the slit's."""
    found = image_run(tmp_path, np.zeros((8, 5)), f"geometry.voxels.clear_layer={layer}")
    assert found["permeability"] == pytest.approx(64 / 12, rel=1e-5)


def test_clear_layers_slip_as_the_sides_of_the_image_do():
    """Between sides that slip unequally, flow along y of a box 3 x 8 voxels of 0.5 wide; none resists where both
    directions across repeat."""
    sides = ClearLayers(1, 2), Walls(face_slip={(0, 0): 0.2, (0, 1): 0.9, (2, 0): 0.1, (2, 1): 0.4})
    layered = VoxelGeometry(np.zeros((8, 5, 3), np.int8), 0.5, (False,) * 3, *sides)
    assert clear_permeability(layered, 1) == duct_permeability([1.5, 4.0], [(0.2, 0.9), (0.1, 0.4)])
    around = VoxelGeometry(np.zeros((8, 5, 3), np.int8), 0.5, (True, False, True), *sides)
    assert clear_permeability(around, 1) == np.inf


def test_a_rectangular_duct_has_its_own_permeability_behind_any_clear_layer(tmp_path):
    """8 x 6 voxels: that of the lattice, 0.06 % too much; no error of the layers is counted as the sample's."""
    known = [image_run(tmp_path, np.zeros((8, 6, 10)), f"geometry.voxels.clear_layer={layer}")["permeability"]
             for layer in (3, 10)]
    assert known[0] == pytest.approx(known[1], rel=1e-5)
    assert known[0] == pytest.approx(duct_permeability([8, 6], [(0, 0)] * 2), rel=0.002)


@pytest.mark.slow
def test_a_clear_layer_of_its_own_thickness_is_thick_enough(tmp_path):
    """Twice as thick, it changes k by less than 1 %; a third as thick, by more."""
    solid = ~blobs(20, 2.0, 0.4)
    own = image_run(tmp_path, solid)
    (said,) = [text for text in own["inputs"] if text.startswith("clear layers")]
    thick = int(said.split()[2])
    twice, third = (image_run(tmp_path, solid, f"geometry.voxels.clear_layer={c}")["permeability"]
                    for c in (2 * thick, thick // 3))
    assert own["permeability"] == pytest.approx(twice, rel=0.01)
    assert third < 0.98 * twice


def round_cell(n):
    """A disk in a square of n voxels, off the middle along x: it has one mirror line, along x."""
    y, x = np.mgrid[:n, :n] + 0.5 - n / 2
    return (x - 2) ** 2 + y**2 < (0.35 * n) ** 2


@pytest.mark.parametrize("wall", ["stairs", "smooth"])
def test_half_of_a_symmetric_cell_with_its_mirror_image_is_the_cell(tmp_path, wall):
    """Along and across the mirror; to what the tolerance of the solver leaves. The same particles, the same k."""
    solid, both = round_cell(16), ("drive.axes=[x, y]", f"geometry.wall_distance={wall}")
    whole = image_run(tmp_path, solid, "geometry.periodic=[x, y]", *both)
    half = image_run(tmp_path, solid[:8], "geometry.mirror=[y]", "geometry.periodic=[x]", *both)
    assert half["particles"] == whole["particles"] and half["porosity"] == whole["porosity"]
    assert half["permeability"] == pytest.approx(whole["permeability"], rel=1e-5)


def test_a_symmetric_image_is_the_same_mirrored_and_periodic(tmp_path):
    """Twice the cell along y, and four times where it is mirrored along x too, beside an unsymmetric neighbour."""
    solid = round_cell(16)
    sets = ("geometry.periodic=[x, y]",), ("geometry.periodic=[x]", "geometry.mirror=[y]")
    periodic, mirrored = (image_run(tmp_path, solid, *how) for how in sets)
    assert mirrored["particles"]["fluid"] == 2 * periodic["particles"]["fluid"]
    assert mirrored["permeability"] == pytest.approx(periodic["permeability"], rel=1e-5)
    there, back = (image_run(tmp_path, image, "geometry.mirror=[x, y]", "drive.axes=[x, y]")
                   for image in (solid, solid[:, ::-1]))
    assert there["permeability"] == pytest.approx(back["permeability"], rel=1e-5)
    tensor = np.array(there["permeability_tensor"])
    assert abs(tensor[0, 1]) < 1e-6 * tensor[0, 0] and abs(tensor[1, 0]) < 1e-6 * tensor[0, 0]
