"""Fields on a grid: values of particles, and what other programs read of the files."""

import base64
import struct
import zlib
from xml.etree import ElementTree

import numpy as np
import pytest

from isphcli import api
from isphcli.case.load import read_case
from isphcli.domain.lattice import make_lattice
from isphcli.output.files import read_pvd
from isphcli.output.grid import Grid, make_grid, write_vti
from isphcli.scene.build_geometry import build_geometry

BOX = """
geometry:
  box: [1.0, 0.5, 0.25]
  periodic: [x, y, z]
  shapes: [{box: {lower: [0, 0, 0], upper: [1.0, 0.125, 0.25]}, is: solid}]
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
"""
H = 0.0625


@pytest.fixture(scope="module")
def scene():
    geometry = build_geometry(read_case(BOX.encode(), "case.yaml"))
    lattice = make_lattice("cubic", geometry.lower, geometry.upper, geometry.periodic, H, 0.0)
    x = np.concatenate(list(lattice.slabs()))
    return geometry, x[geometry.phase(x) >= 0]


def test_a_grid_of_the_spacing_has_the_values_of_the_particles_and_zeros_in_solids(scene):
    geometry, x = scene
    value = np.random.default_rng(1).normal(size=len(x))
    phase = (x[:, 0] > 0.5).astype(np.int8)
    grid = make_grid(geometry, x, {"pressure": value, "velocity": np.stack([value] * 3, axis=1), "phase": phase}, H)
    assert grid.counts == (16, 8, 4)
    index = tuple(np.floor(x / H).astype(int).T[::-1])
    assert np.array_equal(grid.arrays["pressure"][index], value)
    assert np.array_equal(grid.arrays["velocity"][index][:, 2], value)
    assert np.array_equal(grid.arrays["phase"][index], phase)
    solid = grid.arrays["solid"] == 1
    assert np.array_equal(solid, np.broadcast_to((np.arange(8) < 2)[:, None], solid.shape))
    assert not grid.arrays["velocity"][solid].any() and (grid.arrays["phase"][solid] == -1).all()


def test_linear_fields_of_displaced_particles_are_exact_between_them(scene):
    """In the middles of cells that particles surround; beside walls the range of what is seen bounds a value."""
    geometry, x = scene
    x = x + np.random.default_rng(2).uniform(-0.2, 0.2, x.shape) * H
    x = x[geometry.phase(x) >= 0]
    away = 2.0 * x[:, 1] + 3.0
    grid = make_grid(geometry, x, {"pressure": away}, H, 0.5 * H)
    middle = (np.arange(16) + 0.5) * 0.5 * H
    inner = slice(6, 14)
    exact = np.broadcast_to((2.0 * middle + 3.0)[inner, None], grid.arrays["pressure"][:, inner].shape)
    assert np.abs(grid.arrays["pressure"][:, inner] - exact).max() < 1e-6  # of slopes that are held by 1e-9


def test_particles_behind_a_wall_do_not_count():
    text = BOX.replace("lower: [0, 0, 0], upper: [1.0, 0.125, 0.25]", "lower: [0, 0.24, 0], upper: [1.0, 0.26, 0.25]")
    geometry = build_geometry(read_case(text.encode(), "case.yaml"))
    lattice = make_lattice("cubic", geometry.lower, geometry.upper, geometry.periodic, H, 0.0)
    x = np.concatenate(list(lattice.slabs()))
    # the box is periodic along y, so a second wall keeps the halves apart
    below = x[:, 1] < 0.25
    grid = make_grid(geometry, x, {"pressure": below.astype(float)}, H, 0.5 * H)
    beside = grid.arrays["pressure"][:, 6:10]  # half a cell to two cells from the wall, on both of its sides
    assert np.array_equal(beside[:, :2], np.ones_like(beside[:, :2])) and not beside[:, 2:].any()


def decoded(path):
    """{name: (values, components, unit)} and the attributes of the image: the format, read by other code."""
    root = ElementTree.parse(path).getroot()
    kinds = {"Float64": "<f8", "Int32": "<i4", "UInt8": "|u1"}
    text = root.find("AppendedData").text.strip()[1:]
    found = {}
    for entry in root.iter("DataArray"):
        if entry.get("format") != "appended":
            continue
        rest = text[int(entry.get("offset")):]
        count, = struct.unpack("<Q", base64.b64decode(rest[:12])[:8])
        size = 8 * (3 + count)
        header = 4 * -(-size // 3)
        _, block, last, *sizes = struct.unpack(f"<{3 + count}Q", base64.b64decode(rest[:header])[:size])
        data = base64.b64decode(rest[header : header + 4 * -(-sum(sizes) // 3)])
        parts, at = [], 0
        for length in sizes:
            parts.append(zlib.decompress(data[at : at + length]))
            at += length
        assert all(len(part) == block for part in parts[:-1]) and len(parts[-1]) == (last or block)
        unit = entry.findtext("InformationKey")
        values = np.frombuffer(b"".join(parts), kinds[entry.get("type")])
        found[entry.get("Name")] = values, int(entry.get("NumberOfComponents")), unit
    return found, root.find("ImageData").attrib, root.findtext("ImageData/FieldData/DataArray")


def some_grid():
    z, y, x = np.meshgrid(np.arange(3.0), np.arange(4.0), np.arange(60000.0), indexing="ij")
    velocity = np.stack([np.ones_like(x), 0.25 * np.ones_like(x), 0.0 * x], axis=-1)
    return Grid(np.array([1.0, 2.0, 3.0]), np.array([0.5, 1.0, 2.0]),
                {"velocity": velocity, "pressure": x + 10 * y + 100 * z, "solid": np.zeros(x.shape, np.uint8)})


def test_a_file_holds_values_units_and_places(tmp_path):
    grid = some_grid()
    write_vti(tmp_path / "grid.vti", grid, 0.25)
    found, image, time = decoded(tmp_path / "grid.vti")
    assert image["WholeExtent"] == "0 59999 0 3 0 2" and float(time) == 0.25
    assert image["Origin"] == "1.25 2.5 4.0" and image["Spacing"] == "0.5 1.0 2.0"
    assert found["velocity"][1:] == (3, "m/s") and found["pressure"][1:] == (1, "Pa")
    assert found["solid"][1:] == (1, None)
    assert np.array_equal(found["pressure"][0].reshape(3, 4, 60000), grid.arrays["pressure"])
    assert np.array_equal(found["velocity"][0].reshape(3, 4, 60000, 3), grid.arrays["velocity"])


def test_streamlines_at_once(tmp_path):
    """ParaView's library reads the file and follows a uniform flow along its straight line."""
    pyvista = pytest.importorskip("pyvista")
    grid = some_grid()
    short = Grid(grid.lower, grid.cell, {name: v[:, :, :20] for name, v in grid.arrays.items()})
    write_vti(tmp_path / "grid.vti", short)
    image = pyvista.read(tmp_path / "grid.vti")
    assert image.dimensions == (20, 4, 3)
    line = image.streamlines(vectors="velocity", source_center=(1.5, 2.6, 5.0), source_radius=0.0, n_points=1,
                             integration_direction="forward")
    points = np.asarray(line.points)
    assert points[-1, 0] > 10.0 and np.abs(points[:, 1] - 2.6 - 0.25 * (points[:, 0] - 1.5)).max() < 1e-6


def test_streamlines_round_a_sphere(tmp_path):
    """Of the file as a run leaves it: lines that do not begin in front of the sphere come past it, and end less than a
    step of theirs before the box does; those that do may end at it, where the grid has zeros. Between middles that all
    lie in the solid the velocity is zero: no line is farther in than the diagonal of a cell."""
    pyvista = pytest.importorskip("pyvista")
    case = {
        "geometry": {"box": [1.0, 1.0, 1.0], "periodic": ["x", "y", "z"],
                     "shapes": [{"sphere": {"centre": [0.5, 0.5, 0.5], "radius": 0.3}, "is": "solid"}]},
        "particles": {"spacing": 1 / 16}, "fluids": {"water": {"density": 1.0, "viscosity": 1.0}}, "flow": "stokes",
        "drive": {"axes": ["x"]}, "output": {"grid": "auto", "plots": False, "snapshots": False},
    }
    api.run(case, out=tmp_path / "out", quiet=True, check=False)
    (_, file), = read_pvd(tmp_path / "out/grid.pvd")
    image = pyvista.read(tmp_path / "out" / file)
    y, z = np.meshgrid(np.linspace(0.1, 0.9, 7), np.linspace(0.1, 0.9, 7))
    seeds = pyvista.PolyData(np.stack([np.full(49, 0.05), y.ravel(), z.ravel()], axis=1))
    lines = image.streamlines_from_source(seeds, vectors="velocity", integration_direction="forward")
    points = np.asarray(lines.points)
    assert np.linalg.norm(points - 0.5, axis=1).min() > 0.3 - 3**0.5 / 16
    ends = [lines.get_cell(i).points[-1, 0] for i in range(lines.n_cells)]
    beside = np.hypot(y - 0.5, z - 0.5).ravel() > 0.3
    assert len(ends) == 49 and beside.sum() == 28 and (np.array(ends)[beside] > 0.8).all()
