"""Published permeabilities are compared with runs of the same part of an image, the same voxels and axes only."""

from types import SimpleNamespace

import numpy as np
import pytest

from isphcli.references.errors import OtherSampleError
from isphcli.references.sample import other_sample
from isphcli.references.single_phase import published_permeability_errors
from tests.references.results import the_case

LENGTH = 128 * 3e-6  # m, of the cube of Berea


def of_voxels(edge=3e-6):
    return SimpleNamespace(voxel_size=np.full(3, edge), lower=np.zeros(3), upper=np.full(3, LENGTH))


@pytest.mark.parametrize("overrides", [
    (),
    ("geometry.voxels.crop=[[0,128],[0,128],[0,128]]",),  # all of it
    ("reference.crop=null",),  # the whole image, where it names no part
    ("geometry.voxels.crop=[[0,64],[0,64],[64,128]]", "reference.crop=[[0,64],[0,64],[64,128]]"),
    ("particles.spacing=1.5e-6",),
    ("drive.axes=[y]",),
])
def test_the_same_sample(overrides):
    assert other_sample(the_case("berea", *overrides), of_voxels()) is None


@pytest.mark.parametrize(("overrides", "words"), [
    (("geometry.voxels.crop=[[0,64],[0,64],[0,64]]",), "voxels 0:128 x 0:128 x 0:128, this run of voxels 0:64"),
    (("geometry.voxels.crop=[[0,64],[0,64],[0,64]]", "reference.crop=null"), "this run of voxels 0:64"),
    (("geometry.voxels.crop=[[0,64],[0,64],[0,64]]", "reference.crop=[[64,128],[0,64],[0,64]]"), "voxels 64:128"),
    (("reference.crop=[[0,64],[0,64],[0,64]]",), "this run of voxels 0:128"),
    (("reference.value=1e-12", "reference.axes=[x]", "drive.axes=[y]"), "flow along x, this run of flow along y"),
])
def test_another_sample(overrides, words):
    case = the_case("berea", *overrides)
    assert words in other_sample(case, of_voxels())
    with pytest.raises(OtherSampleError):
        published_permeability_errors(case, SimpleNamespace(permeability=1e-12, tensor=None, geometry=of_voxels()))


def test_other_voxels():
    words = other_sample(the_case("berea", "geometry.voxels.voxel_size=2e-6"), of_voxels(2e-6))
    assert words == "the value is of voxels of 3e-06 m, this run has voxels of 2e-06 m"


def test_one_value_counts_for_its_axes_only():
    case = the_case("berea_three_axes", "reference.value=1e-12", "reference.axes=[x]")
    result = SimpleNamespace(permeability={"x": 1.1e-12, "y": 2e-12}, tensor=None, geometry=of_voxels())
    errors = published_permeability_errors(case, result)
    assert errors["permeability_relative"] == pytest.approx(0.1) and "permeability_relative_y" not in errors
