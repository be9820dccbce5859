"""Spheres from files and at random: units, overlaps, what is refused."""

import numpy as np
import pytest

from isphcli.geometry.bodies import Cylinder, Shape, ShapeError, Spheres
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.scene import spheres as spheres_module
from isphcli.scene.spheres import random_spheres, read_spheres, sphere_findings, spheres_of_file


def test_reading_spheres(tmp_path):
    file = tmp_path / "beads.csv"
    file.write_text("# beads\nx_m,y_m,z_m\n1,2,3\n4,5,6\n")
    centres, radii = read_spheres(file, radius=0.5)
    assert centres.tolist() == [[1, 2, 3], [4, 5, 6]] and radii.tolist() == [0.5, 0.5]
    file.write_text("1,2,3,0.1\n4,5,6,0.2\n")
    assert read_spheres(file)[1].tolist() == [0.1, 0.2]
    file.write_text("1,2,0.1\n")
    assert read_spheres(file, dim=2)[0].tolist() == [[1, 2]]


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "no sphere"),
        ("x,y,z\n", "no sphere"),
        ("1,2,3\n", "radius"),
        ("1,2,3,1\n1,2,3\n", ":2: 3 columns"),
        ("1,2,3,1\n1,2,x,4\n", ":2:"),
        ("1,2,nan,1\n", "not finite"),
        ("1,2,3,-1\n", "not positive"),
        ("1;2\n", "columns"),
        ("radius,x,y,z\n0.1,1,2,3\n", ":1: the columns are radius,x,y,z; give x,y,z"),
        ("z,y,x\n1,2,3\n", ":1: the columns are z,y,x"),
        ("x,y,z,radius,phase\n1,2,3,1,0\n", ":1: no such column: phase"),
        ("x_mm,y_mm,z_mm,radius_px\n1,2,3,1\n", ":1: no such column: radius_px"),
        ("x_mm,y_mm,z_mm,radius\n1,2,3,1\n", ":1: only some columns have a unit; name that of radius"),
        ("x,y,z,radius\n1,2,3\n", ":2: 3 columns where the header has 4"),
        ("# z,y,x\n1,2,3,1\n", ":1: the columns are z,y,x"),
        ("0,5;1\n", ":1: holds ; and ,"),
    ],
)
def test_bad_sphere_files(tmp_path, text, message):
    file = tmp_path / "beads.csv"
    file.write_text(text)
    with pytest.raises(ShapeError, match=message):
        read_spheres(file)


@pytest.mark.parametrize(
    "header, length, radius",
    [
        ("x_mm,y_mm,z_mm,radius_mm", 1e-3, 1.0),
        ("x [mm];y [mm];z [mm];r [um]", 1e-3, 1e-3),
        ("X(\u00b5m),Y(\u03bcm),Z(um),Diameter (micron)", 1e-6, 0.5),
        ("x,y,z,diameter", 1.0, 0.5),
        ("centre_x_m,centre_y_m,centre_z_m,radius_m", 1.0, 1.0),
        ("# x_mm,y_mm,z_mm,radius_mm", 1e-3, 1.0),
        ("# x_mm y_mm z_mm radius_mm", 1e-3, 1.0),
        ("# beads of 2 mm", 1.0, 1.0),
    ],
)
def test_lengths_in_the_unit_that_the_header_names(tmp_path, header, length, radius):
    file = tmp_path / "beads.csv"
    separator = ";" if ";" in header else ","
    file.write_text(f"{header}\n{separator.join('1234')}\n", encoding="utf-8")
    found = spheres_of_file(file)
    assert found.centres == pytest.approx(np.array([[1, 2, 3]]) * length, rel=1e-15)
    assert found.radii == pytest.approx([4 * length * radius], rel=1e-15)
    assert ("converted to m" in found.columns) == (length != 1.0) and ("halved" in found.columns) == (radius == 0.5)


def test_spheres_outside_the_box_and_overlaps_are_counted():
    centres = [[0.5, 0.5], [0.65, 0.5], [1.5, 0.5], [-0.05, 0.3], [7.95, 0.8], [0.3, -0.5], [0.95, 0.31], [0.3, 0.05]]
    body, lower, upper = Spheres(np.array(centres), 0.1), np.zeros(2), np.ones(2)
    facts, odd = sphere_findings(body, lower, upper, np.array([1, np.inf]), "b.csv")
    assert facts == ["1 spheres repeat another one, or its periodic image; they count once"]
    assert odd[0].startswith("b.csv: 1 of 8 spheres lie outside the box and are left out")
    assert odd[1].startswith("b.csv: 3 of 8 spheres have their centre outside the box and are wrapped into it, 2 of")
    assert odd[2].startswith("b.csv: 2 pairs of spheres overlap, by up to 190 %")
    touching = Spheres(np.array([[0.3, 0.5], [0.4999, 0.5]]), 0.1)  # 0.1 % of the radius: how packings touch
    assert sphere_findings(touching, lower, upper, np.array([1, np.inf]), "b.csv") == ([], [])
    with pytest.raises(ShapeError, match=r"b\.csv: a radius of 400 m in a periodic box of 1 m; check the unit"):
        sphere_findings(Spheres(np.zeros((1, 2)), 400.0), lower, upper, np.ones(2), "b.csv")


def test_missing_and_binary_sphere_files(tmp_path):
    with pytest.raises(ShapeError, match="cannot be read"):
        read_spheres(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ShapeError):
        read_spheres(tmp_path / "b.csv")


def test_random_spheres_keep_apart():
    """From each other, over periodic faces too, and from the solids; the same seed gives the same places."""
    body = Cylinder(2, [0.5, 0.5, 0.0], 0.5)
    scene = ShapeGeometry([0, 0, 0], [1, 1, 1], [False, False, True], 0, [Shape(body, -1, outside=True)])
    spheres = random_spheres(scene, 30, 0.08, 0.01, seed=3)
    assert (scene.distance(spheres.centres) >= 0.09).all()
    offset = spheres.centres[:, None] - spheres.centres
    offset[..., 2] -= np.round(offset[..., 2])
    apart = np.linalg.norm(offset, axis=2)[np.triu_indices(30, 1)]
    assert apart.min() >= 0.17
    assert np.array_equal(spheres.centres, random_spheres(scene, 30, 0.08, 0.01, seed=3).centres)
    assert not np.array_equal(spheres.centres, random_spheres(scene, 30, 0.08, 0.01, seed=4).centres)


def test_random_spheres_that_find_no_room(monkeypatch):
    monkeypatch.setattr(spheres_module, "TRIES", 20)
    scene = ShapeGeometry([0, 0], [1, 1], [True, True])
    with pytest.raises(ShapeError, match=r"only \d of 7 spheres of radius 0.2 found room"):
        random_spheres(scene, 7, 0.2)
    with pytest.raises(ShapeError, match=r"9 spheres of radius 0\.2 would fill 113 %"):
        random_spheres(scene, 9, 0.2)
