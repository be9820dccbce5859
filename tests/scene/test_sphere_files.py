"""Spheres from tables and dumps: separators, headers, units, what is refused."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.case.yaml import CaseError
from isphcli.geometry.bodies import ShapeError
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.sphere_files import read_spheres, spheres_of_file


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
        ("x,y,radius\n1,2,3\n", ":1: no column z among x,y,radius; name x,y,z"),
        ("x,y,x,z\n1,2,3,4\n", ":1: 2 columns x among"),
        ("x,y,z_px,radius\n1,2,3,1\n", r":1: no column z among .*z_px has a unit that is not known"),
        ("x_mm,y_mm,z_mm,radius_px\n1,2,3,1\n", ":1: radius_px has a unit that is not known; name a unit"),
        ("x_mm,y_mm,z_mm,radius\n1,2,3,1\n", ":1: only some columns have a unit; name that of radius"),
        ("x,y,z,radius\n1,2,3\n", ":2: 3 columns where the header has 4"),
        ("# z,y,x\n1,2,3,1\n", ":2: 4 columns where the header has 3"),
        ("0,5;1\n", ":1: 2 columns where 3 or 4 are expected"),
        ("1.234,5;1;1\n", ":1: .* is not a row of numbers"),
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


def test_missing_and_binary_sphere_files(tmp_path):
    with pytest.raises(ShapeError, match="cannot be read"):
        read_spheres(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ShapeError):
        read_spheres(tmp_path / "b.csv")


BALLS = np.array([[0.25, 0.5, 1.5, 0.125], [2.0, 1.75, 0.75, 0.25], [1e-3, 3.0, 2.0, 0.5]])


@pytest.mark.parametrize(
    ("header", "separator", "comma"),
    [
        ("x,y,z,radius", ",", False),
        ("x;y;z;radius", ";", False),
        ("x;y;z;radius", ";", True),
        ("x y z radius", " ", False),
        ("x\ty\tz\tradius", "\t", False),
        ("x\ty\tz\tradius", "\t", True),
        ("x y z radius", "   ", True),
        ("# x y z radius", " ", False),
        ("x,y,z,radius", " ", False),
        ("", ",", False),
        ("", ";", True),
        ("", " ", False),
        ("", "\t", False),
        ("", ", ", False),
    ],
)
def test_columns_are_parted_by_whatever_people_use(tmp_path, header, separator, comma):
    rows = [separator.join(f"{v:.6f}" for v in row) for row in BALLS]
    text = "\n".join([header] * bool(header) + [row.replace(".", ",") if comma else row for row in rows])
    (tmp_path / "b.txt").write_text(text + "\n")
    centres, radii = read_spheres(tmp_path / "b.txt")
    assert np.array_equal(centres, BALLS[:, :3]) and np.array_equal(radii, BALLS[:, 3])


def test_a_header_names_columns_in_any_order_and_what_is_left_out_is_said(tmp_path):
    rows = "\n".join(f"{k} {2 * r} {z} {y} {x} 7.8" for k, (x, y, z, r) in enumerate(BALLS))
    (tmp_path / "b.txt").write_text(f"id diameter_mm z_mm y_mm x_mm density\n{rows}\n")
    found = spheres_of_file(tmp_path / "b.txt")
    assert found.centres == pytest.approx(BALLS[:, :3] * 1e-3) and found.radii == pytest.approx(BALLS[:, 3] * 1e-3)
    assert found.columns == "lengths in mm converted to m, diameters halved, columns left out: id,density"


def test_lengths_are_scaled_where_no_header_names_their_unit(tmp_path):
    (tmp_path / "b.csv").write_text("x,y,z,diameter\n1,2,3,4\n")
    found = spheres_of_file(tmp_path / "b.csv", scale=1e-3)
    assert found.centres.tolist() == [[1e-3, 2e-3, 3e-3]] and found.radii.tolist() == [2e-3]
    (tmp_path / "b.csv").write_text("x_mm,y_mm,z_mm,radius_mm\n1,2,3,4\n")
    with pytest.raises(ShapeError, match="its header names the unit of its lengths; remove the key 'scale'"):
        spheres_of_file(tmp_path / "b.csv", scale=1e-3)


DUMP = """ITEM: TIMESTEP
{step}
ITEM: NUMBER OF ATOMS
{count}
ITEM: BOX BOUNDS pp pp ff
0 2
-1 3
0 4
ITEM: ATOMS id type {names} vx radius
{rows}
"""


def dump(step, balls, names="x y z", count=None):
    rows = "\n".join(f"{k} 1 {x:.17g} {y:.17g} {z:.17g} 0.5 {r:.17g}" for k, (x, y, z, r) in enumerate(balls))
    return DUMP.format(step=step, count=len(balls) if count is None else count, names=names, rows=rows)


def test_the_last_step_of_a_dump(tmp_path):
    (tmp_path / "pack.dump").write_text(dump(0, BALLS * 9) + dump(500, BALLS))
    found = spheres_of_file(tmp_path / "pack.dump")
    assert np.array_equal(found.centres, BALLS[:, :3]) and np.array_equal(found.radii, BALLS[:, 3])
    assert found.columns == "dump, step 500, its box 0 to 2 x -1 to 3 x 0 to 4"


def test_scaled_and_unwrapped_coordinates_of_a_dump(tmp_path):
    """xs counts in edges of the box, from its lower corner."""
    scaled = BALLS.copy()
    scaled[:, :3] = (BALLS[:, :3] - [0, -1, 0]) / [2, 4, 4]
    for names, balls in (("xs ys zs", scaled), ("xu yu zu", BALLS)):
        (tmp_path / "pack.dump").write_text(dump(1, balls, names))
        assert spheres_of_file(tmp_path / "pack.dump").centres == pytest.approx(BALLS[:, :3], rel=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (dump(1, BALLS, count=4), "holds 3 of 4 atoms"),
        (dump(1, BALLS)[:-20], "columns where ITEM: ATOMS names|holds"),
        (dump(1, BALLS, names="x y vz"), "no column z among"),
        (dump(1, BALLS).replace("0 2\n-1 3", "0 2 0.5\n-1 3 0"), "tilted"),
        (dump(1, BALLS).replace("ITEM: BOX", "BOX"), "without ITEM: BOX BOUNDS"),
        (dump(1, BALLS).replace("-1 3\n", "-1 b\n"), "bounds of the box are no numbers"),
        (dump(1, BALLS).split("ITEM: ATOMS")[0], "without ITEM: ATOMS"),
        (dump(1, BALLS).replace("0.125", "wide"), ":10: .* is not a row of numbers"),
        (dump(1, BALLS).replace("0.125", "nan"), ":10: a value is not finite"),
        (dump(1, BALLS * [1, 1, 1, 0]), "is not positive"),
    ],
)
def test_damaged_dumps(tmp_path, text, message):
    (tmp_path / "pack.dump").write_text(text)
    with pytest.raises(ShapeError, match=message) as error:
        spheres_of_file(tmp_path / "pack.dump")
    assert "pack.dump" in str(error.value)


PACK = """
geometry:
  box: [{length}, 1, 1]
  periodic: [y, z]
  clear_layer: 0.9
  shapes:
    - spheres: {{file: pack.csv, radius: 0.35}}
      is: solid
particles: {{spacing: 0.125}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
output: {{plots: false, snapshots: false}}
"""


def pack(tmp_path, length, overrides=()):
    """Balls on a cubic lattice: `length` of them inside the box along x, one beyond each end."""
    rows = "\n".join(f"{k + 0.5},0.5,0.5" for k in range(-1, length + 1))
    (tmp_path / "pack.csv").write_text(f"x,y,z\n{rows}\n")
    return read_case(
        PACK.format(length=length).encode(),
        tmp_path / "case.yaml",
        (f"output.directory={tmp_path / 'out'}", *overrides),
    )


def test_a_pack_gets_clear_layers_and_keeps_its_box(tmp_path):
    geometry = build_geometry(pack(tmp_path, 2))
    assert geometry.lower.tolist() == [-1, 0, 0] and geometry.upper.tolist() == [3, 1, 1]  # 0.9 is 8 spacings
    assert geometry.sample_lower.tolist() == [0, 0, 0] and geometry.sample_upper.tolist() == [2, 1, 1]
    assert geometry.periodic == (True, True, True)
    assert geometry.phase(np.array([[-0.5, 0.5, 0.5], [0.5, 0.5, 0.5], [2.5, 0.5, 0.5]])).tolist() == [0, -1, 0]
    said = [f"{name}: {text}" for name, text in geometry.described]
    assert "pack.csv: 2 of 4 spheres have their centre beyond the ends of x and are left out" in said
    assert "clear layers: 1 m at each end of x" in said


def test_layers_thinner_than_the_support_are_warned_of(tmp_path):
    """The support is 2.1 spacings: a layer of one lets the two ends of the pack see each other, not one of three."""
    from isphcli.preflight.check import check

    said = "two ends of the pack see each other; make geometry.clear_layer larger"
    assert said in check(pack(tmp_path, 2, ("geometry.clear_layer=0.125",))).text()
    assert said not in check(pack(tmp_path, 2, ("geometry.clear_layer=0.375",))).text()


@pytest.mark.slow
def test_the_permeability_of_a_pack_alone(tmp_path):
    """The layers are not in it: of two, then four cells of a lattice it nears that of the lattice without end. What is
    left is the flow that spreads at the two ends, as much for a pack of any length: it halves with twice the length."""
    from isphcli.runs.run import run_case

    k = [
        run_case(pack(tmp_path, n, sets), quiet=True, overwrite=True)["permeability"]
        for n, sets in ((2, ()), (4, ()), (4, ("geometry.periodic=[x, y, z]", "geometry.clear_layer=null")))
    ]
    two, four, endless = (found["x"] if isinstance(found, dict) else found for found in k)
    ends = endless / two - 1.0, endless / four - 1.0
    assert 0.0 < ends[1] < ends[0] < 0.1
    assert ends[0] / ends[1] == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("geometry.clear_layer=null",),
            "drive.axes: x ends at walls; add x to geometry.periodic, or give geometry.clear_",
        ),
        (("geometry.clear_layer=0",), "geometry.clear_layer: must be above 0"),
    ],
)
def test_a_pack_that_nothing_can_flow_through(tmp_path, change, message):
    with pytest.raises(CaseError, match=message):
        pack(tmp_path, 2, change)
