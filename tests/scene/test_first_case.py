"""A case from an image alone: what is taken for solid, and what has to be said."""

import re

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.case.yaml import CaseError
from isphcli.geometry.images.image import VoxelError
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.first_case import first_case

DUCT = np.ones((6, 6, 8), np.uint8)
DUCT[1:5, 1:5] = 0
SIZE = ("geometry.voxels.voxel_size=2um",)


def saved(tmp_path, values, **more):
    np.savez(tmp_path / "duct.npz", image=values, **more)
    return tmp_path / "duct.npz"


@pytest.mark.parametrize("solid", [1, 255, 7])
def test_of_two_values_the_higher_one_is_solid(tmp_path, solid):
    found = first_case(saved(tmp_path, DUCT * np.uint8(solid)), SIZE)
    geometry = build_geometry(found.case)
    inside = geometry.labels[:, :, geometry.labels.shape[2] // 2]
    assert np.array_equal(inside < 0, DUCT[:, :, 0] == 1) and geometry.voxel_size.tolist() == [2e-6] * 3
    assert f"voxels of value {solid} are solid (55.6 %)" in found.assumed[0]
    assert f"labels={{solid: 0, water: {solid}}}" in found.assumed[0]


def test_grey_values_are_parted_by_otsu(tmp_path):
    grey = np.where(DUCT == 1, 20000, 9000) + np.random.default_rng(0).integers(-900, 900, DUCT.shape)
    case = first_case(saved(tmp_path, grey.astype(np.uint16)), SIZE).case
    assert case.geometry.voxels.grey.threshold == "otsu" and case.geometry.voxels.grey.solid == "above"
    assert np.array_equal(build_geometry(case).labels[:, :, 8] < 0, DUCT[:, :, 0] == 1)


@pytest.mark.parametrize("said, solid, threshold, blur, assumed", [
    ("grey.solid=below", "below", "otsu", None, False),  # the command that the run proposes
    ("grey.blur=0", "above", "otsu", 0, True),
    ("grey.threshold=15000", "above", 15000, None, True),
    ("grey={threshold: 15000, solid: below}", "below", 15000, None, False),
])
def test_one_key_of_a_grey_image_leaves_the_others(tmp_path, said, solid, threshold, blur, assumed):
    grey = np.where(DUCT == 1, 20000, 9000) + np.arange(DUCT.size).reshape(DUCT.shape)
    found = first_case(saved(tmp_path, grey.astype(np.uint16)), (*SIZE, f"geometry.voxels.{said}"))
    values = found.case.geometry.voxels.grey
    assert (values.solid, values.threshold, values.blur) == (solid, threshold, blur)
    assert any("bright ones are solid" in sentence for sentence in found.assumed) == assumed


def test_the_voxel_size_of_the_file_is_that_of_the_particles(tmp_path):
    found = first_case(saved(tmp_path, DUCT, voxel_size=np.array([3e-6, 3e-6, 6e-6])))
    assert found.case.geometry.voxels.voxel_size == (3e-6, 3e-6, 6e-6) and found.case.particles.spacing == 3e-6
    assert read_case(found.text.encode(), tmp_path / "duct.yaml") == found.case
    assert found.case.path == tmp_path / "duct.npz"  # which messages name: there is no duct.yaml


def test_what_is_said_is_kept(tmp_path):
    sets = (*SIZE, "geometry.voxels.axes=zyx", "geometry.voxels.labels={solid: 0, water: 1}", "drive.axes=[z]",
            "particles.spacing=1um", "geometry.voxels.crop=[[0, 4], [0, 6], [0, 6]]")
    found = first_case(saved(tmp_path, DUCT), sets)
    assert dict(found.case.geometry.voxels.labels) == {"solid": (0,), "water": (1,)} and found.assumed == ()
    assert found.case.drive.axes == ("z",) and found.case.particles.spacing == 1e-6
    assert found.case.geometry.voxels.crop == ((0, 4), (0, 6), (0, 6))


def test_the_axes_of_an_array_are_said(tmp_path):
    """Of a format that does not hold them; a TIFF stack has its slices along z."""
    import tifffile

    assert "the array, 6 x 6 x 8, are z, y, x; " in " ".join(first_case(saved(tmp_path, DUCT), SIZE).assumed)
    np.save(tmp_path / "slice.npy", DUCT[2])
    assert "the array, 6 x 8, are y, x; " in " ".join(first_case(tmp_path / "slice.npy", SIZE).assumed)
    tifffile.imwrite(tmp_path / "duct.tif", DUCT)
    assert "axes of the array" not in " ".join(first_case(tmp_path / "duct.tif", SIZE).assumed)


@pytest.mark.parametrize(
    ("values", "sets", "error", "message"),
    [
        (DUCT, (), VoxelError, "holds no voxel size; give it, such as --set geometry.voxels.voxel_size=5um"),
        (DUCT * 0, SIZE, VoxelError, r"holds 0 \(288 voxels\); say which are solid"),
        (DUCT + (np.arange(8) > 3), SIZE, VoxelError, r"holds 0 .*, 1 .*, 2 .*; say which are solid"),
        (DUCT, ("geometry.voxels.voxel_sise=2um",), CaseError, "did you mean 'voxel_size'"),
        (DUCT, ("geometry.voxels.voxel_size=2s",), CaseError, "'s' is a unit of time, and not of length"),
    ],
)
def test_what_an_image_does_not_tell(tmp_path, values, sets, error, message):
    with pytest.raises(error, match=message):
        first_case(saved(tmp_path, values), sets)


def test_labels_that_are_proposed_are_those_of_the_image(tmp_path):
    """Of several values the most frequent one as solid: what is proposed works as it stands."""
    path = saved(tmp_path, np.where(DUCT == 0, 5, 2) + (np.arange(8) > 5))
    with pytest.raises(VoxelError) as refused:
        first_case(path, SIZE)
    option = re.search(r"--set '(.*)'", str(refused.value)).group(1)
    labels = first_case(path, (*SIZE, option)).case.geometry.voxels.labels
    assert dict(labels) == {"solid": (2,), "water": (3, 5, 6)}


def test_a_size_without_a_unit_is_not_taken_for_metres(tmp_path):
    import nrrd

    nrrd.write(str(tmp_path / "rock.nrrd"), DUCT, {"spacings": [5.3] * 3}, index_order="C")
    with pytest.raises(VoxelError, match=r"its spacings, 5\.3 5\.3 5\.3, has no unit; .*voxel_size=5\.3um"):
        first_case(tmp_path / "rock.nrrd")
