"""Edges of a voxel: from the case, from the file, in units that agree."""

from unittest import mock

import numpy as np
import pytest

from isphcli.domain.lattice import ParticleError
from isphcli.geometry.images.image import VoxelError
from isphcli.output.convert_images import write_image
from isphcli.scene import memory
from isphcli.scene.build_geometry import build_geometry
from tests.geometry.images.files import read

SPACING = "voxels: {file: FILE, labels: {solid: 1, brine: 0}SIZE}, periodic: [z]"


def scene_of(tmp_path, file, size=None, **values):
    """Geometry of an image that is solid in 3 of 4 layers along x."""
    image = np.ones((8, 8, 8), np.uint8)
    image[..., :2] = 0
    path = tmp_path / file
    if path.suffix in (".mhd", ".mha"):
        write_image(path, image, values.get("voxel_size"))
    elif path.suffix == ".npy":
        np.save(path, image)
    else:
        np.savez(path, image=image, **values)
    scene = SPACING.replace("FILE", file).replace("SIZE", "" if size is None else f", voxel_size: {size}")
    # voxels of metres are not to be refused by their number
    with mock.patch.object(memory, "available", lambda: float("inf")):
        return build_geometry(read(tmp_path, "{" + scene + "}"))


def test_a_size_in_another_unit_is_named_where_it_is_refused(tmp_path):
    """voxel_size: 5, micrometres meant, beside a spacing that fits micrometres no better."""
    np.save(tmp_path / "a.npy", np.zeros((10, 10, 10), np.uint8))
    scene = SPACING.replace("FILE", "a.npy").replace("SIZE", ", voxel_size: 5")
    said = r"fluid particles need .* if micrometres are meant, the voxel size is 5e-06 m"
    with pytest.raises(ParticleError, match=said):
        build_geometry(read(tmp_path, "{" + scene + "}"))


@pytest.mark.parametrize(
    "file, of_file, given, size, source, warning",
    [
        ("a.npz", 5e-6, None, 5e-6, "from a.npz", None),
        ("a.npz", [1e-6, 2e-6, 3e-6], None, [1e-6, 2e-6, 3e-6], "from a.npz", None),
        ("a.npz", np.array([3]), 3, 3, "as given, as in a.npz", "voxels of 3 m"),
        ("a.npz", 3e-6, 5e-6, 5e-6, "as given; a.npz has 3e-06 m", "given, 5e-06 m, is not that of a.npz, 3e-06 m"),
        ("a.npz", 5e-3, 5e-6, 5e-6, "as given; a.npz has 0.005 m", "given, 5e-06 m, is not that of a.npz, 0.005 m"),
        ("a.npz", 5.0001e-6, 5e-6, 5e-6, "as given, as in a.npz", None),
        ("a.mha", [5e-6] * 3, None, 5e-6, "from a.mha, whose ElementSpacing has no unit: taken as metres", None),
        ("a.mhd", [5e-3] * 3, None, 5e-3, "from a.mhd, whose", "give the voxel size, 5e-06 m if it is in milli"),
        ("a.mhd", [5e-3] * 3, 5e-6, 5e-6, "as given, as in a.mhd if that is in millimetres", None),
        ("a.mhd", [5.0] * 3, 5e-6, 5e-6, "as given, as in a.mhd if that is in micrometres", None),
        ("a.mhd", [5.0] * 3, 4e-6, 4e-6, "as given; a.mhd has 5 (without", "is not that of a.mhd, 5 (without a unit)"),
        ("a.mhd", [1.0] * 3, 4e-6, 4e-6, "as given", None),
        ("a.npy", None, 4e-6, 4e-6, "as given", None),
    ],
)
def test_voxel_size_of_the_case_and_of_the_file(tmp_path, file, of_file, given, size, source, warning):
    held = {} if of_file is None else {"voxel_size": of_file}
    g = scene_of(tmp_path, file, given, **held)
    assert g.voxel_size.tolist() == np.broadcast_to(size, 3).tolist()
    assert source in dict(g.described)["voxel size"]
    about = [w for w in g.warnings if "voxel" in w]
    assert (warning is None and not about) or any(warning in w for w in about)


@pytest.mark.parametrize("file, held", [("a.npz", {}), ("a.mhd", {"voxel_size": [1.0] * 3}), ("a.mha", {})])
def test_no_voxel_size_anywhere(tmp_path, file, held):
    with pytest.raises(VoxelError, match=f"{file}: holds no voxel size; give geometry.voxels.voxel_size"):
        scene_of(tmp_path, file, None, **held)
