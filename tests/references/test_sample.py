"""References are compared with runs of the geometry that they name, published permeabilities with runs of the same part
of an image, the same voxels and axes only."""

from types import SimpleNamespace

import numpy as np
import pytest

from isphcli.case.load import dump_case, read_case
from isphcli.case.yaml import CaseError
from isphcli.references.compare import compare
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
        compare(case, SimpleNamespace(permeability=1e-12, tensor=None, geometry=of_voxels()))


def test_other_voxels():
    words = other_sample(the_case("berea", "geometry.voxels.voxel_size=2e-6"), of_voxels(2e-6))
    assert words == "the value is of voxels of 3e-06 m, this run has voxels of 2e-06 m"


def test_one_value_counts_for_its_axes_only():
    case = the_case("berea_three_axes", "reference.value=1e-12", "reference.axes=[x]")
    result = SimpleNamespace(permeability={"x": 1.1e-12, "y": 2e-12}, tensor=None, geometry=of_voxels())
    errors = published_permeability_errors(case, result)
    assert errors["permeability_relative"] == pytest.approx(0.1) and "permeability_relative_y" not in errors


@pytest.mark.parametrize(("name", "override", "words"), [
    ("grey_blobs", "geometry.voxels.grey.threshold=33000", "geometry.voxels.grey.threshold 32768, this run has 33000"),
    ("grey_blobs", "geometry.voxels.grey.threshold=otsu", "geometry.voxels.grey.threshold 32768, this run has otsu"),
    ("grey_blobs", "geometry.voxels.grey.solid=below", "geometry.voxels.grey.solid above, this run has below"),
    ("grey_blobs", "geometry.periodic=[x, y]", "geometry.periodic [x, y, z], this run has [x, y]"),
    ("berea", "geometry.voxels.labels={solid: 0, water: 1}", "geometry.voxels.labels.solid [1], this run has [0]"),
    ("berea", "geometry.voxels.labels={solid: [1, 2], water: 0}", "labels.solid [1], this run has [1, 2]"),
    ("berea", "geometry.mirror=[x]", "geometry.mirror [], this run has [x]"),
    ("berea", "geometry.wall_distance=smooth", "geometry.wall_distance stairs, this run has smooth"),
    ("two_tubes", "geometry.voxels.labels={solid: 1, water: 0}", "geometry.voxels.labels.solid [0], this run has [1]"),
    ("two_tubes", "geometry.voxels.crop=[[0,8],[0,8],[0,4]]", "geometry.voxels.crop none, this run has [[0, 8], [0,"),
])
def test_another_body(name, override, words):
    """What the reference names of the geometry is otherwise in the run: nothing is compared, whatever the kind."""
    case = the_case(name, override)
    assert words in other_sample(case, of_voxels())
    with pytest.raises(OtherSampleError):
        compare(case, SimpleNamespace(geometry=of_voxels()))


@pytest.mark.parametrize(("name", "overrides"), [
    ("grey_blobs", ("geometry.periodic=[z, y, x]", "geometry.voxels.grey.blur=0.3", "particles.spacing=1.5e-6")),
    ("two_tubes", ("geometry.voxels.clear_layer=1e-5",)),
])
def test_what_the_reference_does_not_name_is_free(name, overrides):
    assert other_sample(the_case(name, *overrides), of_voxels()) is None


def test_the_part_of_the_geometry_is_read_like_the_geometry():
    """Units, one value for a list of one, and errors; what a run leaves of it is read back."""
    case = the_case("berea", "reference.geometry={voxels: {voxel_size: 3 um, labels: {solid: 1}}, slip_length: null}")
    assert case.reference.geometry["voxels"]["voxel_size"] == pytest.approx(3e-6)
    assert other_sample(case, of_voxels()) == "it is of geometry.slip_length none, this run has 0"
    again = read_case(dump_case(case).encode(), "again.yaml")
    assert again.reference.geometry == case.reference.geometry
    with pytest.raises(CaseError, match=r"reference\.geometry\.voxels\.lables: unknown key; did you mean .labels."):
        the_case("berea", "reference.geometry={voxels: {lables: {solid: 1}}}")
    with pytest.raises(CaseError, match=r"reference\.geometry\.voxels\.voxel_size: must be above 0"):
        the_case("berea", "reference.geometry={voxels: {voxel_size: -1}}")
