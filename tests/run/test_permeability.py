"""Permeabilities: of the sample alone whatever its clear layers, of mirrored images, extrapolated over spacings."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.references.ducts import duct_permeability
from isphcli.run.permeability import clear_permeability, extrapolate
from isphcli.run.run import run_case
from tests.geometry.test_clear_layer import blobs

IMAGE = """
geometry: {voxels: {file: image.npy, labels: {solid: 1, water: 0}, voxel_size: 1}, wall_distance: stairs}
particles: {spacing: 1}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
solver: {tolerance: 1.0e-8}
output: {snapshots: false, plots: false}
"""


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
    sides = dict(flow_axis=1, clear=2, face_slip={(0, 0): 0.2, (0, 1): 0.9, (2, 0): 0.1, (2, 1): 0.4})
    layered = VoxelGeometry(np.zeros((8, 5, 3), np.int8), 0.5, (False,) * 3, **sides)
    assert clear_permeability(layered, 1) == duct_permeability([1.5, 4.0], [(0.2, 0.9), (0.1, 0.4)])
    around = VoxelGeometry(np.zeros((8, 5, 3), np.int8), 0.5, (True, False, True), **sides)
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


def test_extrapolation_recovers_a_power_law():
    h = np.array([1.0, 0.5, 0.25])
    limit, bar, order, sentence = extrapolate(h, 3.0 + 0.2 * h**1.7)
    assert limit == pytest.approx(3.0, rel=1e-8) and order == pytest.approx(1.7, rel=1e-6)
    assert bar == pytest.approx(0.2 * 0.25**1.7, rel=1e-6) and "observed" in sentence
    limit, bar, order, _ = extrapolate(h, [1.0, 2.0, 1.5])  # no trend: the finest value and the spread
    assert (limit, bar, order) == (1.5, 1.0, None)
