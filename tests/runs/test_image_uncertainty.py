"""What the uncertainty of a threshold does to k."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.case.yaml import CaseError
from isphcli.runs.run import run_case

CASE = """
geometry:
  voxels: {{file: {file}, grey: {{threshold: {threshold}, solid: above, uncertainty: 25}}, voxel_size: 1.0e-6}}
  periodic: [x, z]
particles: {{spacing: 1.0e-6}}
fluids: {{water: {{density: 1000, viscosity: 1.0e-3}}}}
flow: stokes
drive: {{axes: [{axis}]}}
output: {{directory: {folder}, plots: false, snapshots: false}}
"""


def slit(folder):
    """Grey values of 100 a voxel across a slit of 8 voxels; the wall is where they are 0."""
    np.save(folder / "slit.npy", np.tile((np.abs(np.arange(16) - 7.5) * 100 - 400)[None, :, None], (4, 1, 4)))
    return folder / "slit.npy"


def solved(tmp_path, threshold="0", axis="x", *sets):
    text = CASE.format(file=slit(tmp_path), folder=tmp_path / "out", threshold=threshold, axis=axis)
    return run_case(read_case(text.encode(), "case.yaml", sets), quiet=True)


def test_a_threshold_moves_the_walls_of_a_slit(tmp_path):
    """k is h^3 / 12 over the height of the box: h of 8 voxels, of 7.5 and 8.5 with walls a quarter of a voxel off."""
    found = solved(tmp_path)["permeability_by_threshold"]
    assert found["thresholds"] == [-25, 0, 25]
    low, own, high = found["permeability"]["x"]
    assert own == pytest.approx(8**3 / 12 / 16 * 1e-12, rel=2e-3)  # float32 of the field
    assert (low / own, high / own) == pytest.approx(((7.5 / 8) ** 3, (8.5 / 8) ** 3), rel=5e-3)


def test_axes_of_an_image_that_repeats_share_their_matrices(tmp_path):
    """Along x and z a slit is the same; the tolerance is that of the solver, 1e-6."""
    found = solved(tmp_path, "0", "x, z", "geometry.periodic=[x, y, z]")["permeability_by_threshold"]["permeability"]
    low, own, high = found["x"]
    assert found["z"] == pytest.approx(found["x"], rel=1e-5)
    assert (low / own, high / own) == pytest.approx(((7.5 / 8) ** 3, (8.5 / 8) ** 3), rel=5e-3)


def test_without_an_uncertainty_nothing_is_solved_beside(tmp_path):
    assert solved(tmp_path, "0", "x", "geometry.voxels.grey.uncertainty=null")["permeability_by_threshold"] is None


def test_of_several_thresholds_all_have_to_part_the_image(tmp_path):
    with pytest.raises(ValueError, match=r"380 \+- 25"):
        solved(tmp_path, "380")


def test_moving_particles_have_no_such_bar(tmp_path):
    with pytest.raises(CaseError, match=r"geometry\.voxels\.grey\.uncertainty"):
        solved(tmp_path, "0", "x", "flow=navier_stokes", "time={end: 1}")
