"""Cases to begin with can be read and checked as they are, and say what was assumed."""

import numpy as np
import pytest

from isphcli.case.load import load_case
from isphcli.preflight.check import check_case_file
from isphcli.scene.new_case import (
    NewCaseError,
    case_for_drop,
    case_for_image,
    case_for_spheres,
    is_list_of_spheres,
)

RNG = np.random.default_rng(3)


def written(made, folder):
    path = folder / "case.yaml"
    path.write_text(made.text, encoding="utf-8")
    return path


def test_an_image_of_labels(tmp_path):
    image = np.zeros((6, 8, 10), np.uint8)
    image[:, :2] = 1
    (tmp_path / "data").mkdir()
    np.savez(tmp_path / "data/it's.npz", image=image, voxel_size=np.array([2e-6] * 3))
    made = case_for_image(tmp_path / "data/it's.npz", tmp_path)
    case = load_case(written(made, tmp_path))
    assert dict(case.geometry.voxels.labels) == {"solid": (1,), "water": (0,)}
    assert case.particles.spacing == case.geometry.voxels.voxel_size == 2e-6
    assert "25.0 %" in made.notes[0] and len(made.notes) == 1
    assert check_case_file(tmp_path / "case.yaml").can_run


def test_the_value_of_most_voxels_is_solid_where_none_is_one(tmp_path):
    image = np.where(RNG.random((6, 8, 10)) > 0.3, 255, 128).astype(np.uint8)
    image[:, 0] = 7
    np.save(tmp_path / "scan.npy", image)
    made = case_for_image(tmp_path / "scan.npy", tmp_path, (1e-6, 1e-6, 2e-6))
    case = load_case(written(made, tmp_path))
    assert dict(case.geometry.voxels.labels) == {"solid": (255,), "water": (7, 128)}
    assert case.geometry.voxels.voxel_size == (1e-6, 1e-6, 2e-6) and case.particles.spacing == 1e-6


@pytest.mark.parametrize("image", [(RNG.random((6, 8, 10)) * 60000).astype(np.uint16), RNG.random((6, 8, 10))])
def test_a_grey_image_without_a_voxel_size(image, tmp_path):
    np.save(tmp_path / "scan.npy", image)
    made = case_for_image(tmp_path / "scan.npy", tmp_path)
    case = load_case(written(made, tmp_path))
    assert case.geometry.voxels.grey.threshold == "otsu" and "NOT KNOWN" in made.text and len(made.notes) == 2


def test_an_image_of_one_value(tmp_path):
    np.save(tmp_path / "scan.npy", np.ones((4, 4, 4), np.uint8))
    with pytest.raises(NewCaseError, match="nothing can flow"):
        case_for_image(tmp_path / "scan.npy", tmp_path)


def test_spheres(tmp_path):
    (tmp_path / "pack.csv").write_text("x_mm,y_mm,z_mm\n0,0,0\n2,0,0\n0,2,0\n")
    case = load_case(written(case_for_spheres(tmp_path / "pack.csv", tmp_path, 1e-3), tmp_path))
    assert case.geometry.box == pytest.approx((4e-3, 4e-3, 2e-3))
    assert case.geometry.origin == pytest.approx((-1e-3,) * 3)
    found = check_case_file(tmp_path / "case.yaml")
    # three whole spheres in the box; cells cut by spheres are counted by their middles: 4 a radius
    assert found.can_run and found.connectivity.porosity == pytest.approx(1 - 4 * np.pi / 32, abs=0.02)


DUMP = """ITEM: TIMESTEP
7
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS {sides}
0 1
0 2
-1 1
ITEM: ATOMS id x y z radius
1 0.3 0.3 0.3 0.25
2 0.7 1.7 0 0.25
"""


@pytest.mark.parametrize(("sides", "box"), [
    ("pp pp pp", (1.0, 2.0, 2.0)), ("pp pp ff", (1.0, 2.0, 0.8)), ("ff ff ff", (0.9, 1.9, 0.8)),
])
def test_a_dump_has_its_box_where_that_repeats(tmp_path, sides, box):
    """Along the other axes it is what the spheres fill."""
    (tmp_path / "pack.dump").write_text(DUMP.format(sides=sides), encoding="utf-8")
    assert is_list_of_spheres(tmp_path / "pack.dump")
    case = load_case(written(case_for_spheres(tmp_path / "pack.dump", tmp_path), tmp_path))
    assert case.geometry.box == pytest.approx(box)


@pytest.mark.parametrize(("box", "radius", "spacing"), [
    ((2e-4, 2e-4, 2e-4), 5e-5, 1.25e-5),
    ((2e-4, 2e-4, 2e-4), 5.2e-5, 1.33333e-5),  # 15 cells; two digits would be 1.3e-5, 15.4 of them
    ((3e-4, 2e-4, 2.5e-4), 5.2e-5, 1.25e-5),  # 24, 16 and 20
    ((2e-4, 2.17e-4, 2.3e-4), 5.2e-5, 1.44e-5),  # none near divides these: stretched by 0.8 %, at 1.3e-5 by 2.6 %
])
def test_the_spacing_of_a_pack_divides_its_box(tmp_path, box, radius, spacing):
    bounds = "".join(f"0 {edge:g}\n" for edge in box)
    (tmp_path / "pack.dump").write_text(
        f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS pp pp pp\n{bounds}"
        f"ITEM: ATOMS id x y z radius\n1 1e-4 1e-4 1e-4 {radius:g}\n", encoding="utf-8")
    case = load_case(written(case_for_spheres(tmp_path / "pack.dump", tmp_path), tmp_path))
    assert case.particles.spacing == spacing


def test_what_is_no_text_is_no_list_of_spheres(tmp_path):
    (tmp_path / "scan.dcm").write_bytes(b"DICM\0\1\xff")
    (tmp_path / "scan").write_bytes(b"\xa2\xb1" * 3000)  # grey values without a zero or a line break
    assert not is_list_of_spheres(tmp_path / "scan")
    assert not is_list_of_spheres(tmp_path / "scan.dcm") and not is_list_of_spheres(tmp_path / "missing.npy")


def test_a_drop_in_a_throat(tmp_path):
    found = check_case_file(written(case_for_drop(), tmp_path))
    assert found.can_run and found.case.fluid_names == ("oil", "water")
