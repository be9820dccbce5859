"""What a permeability is worth by bodies whose permeability is known."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import isphcli
from isphcli.geometry.bodies import Box, Cylinder, Shape, Sphere
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.runs.expected_error import (
    WALLS,
    Expected,
    Scan,
    calibrations,
    expected,
    grain_chord,
    has_edges,
    is_straight,
    mean_chord,
    pore_width,
    slip_error,
    slip_of,
)
from isphcli.runs.permeability import ORDER
from isphcli.validation.known_bodies import LevelGeometry, body
from tests.paths import ROOT


def test_the_width_that_the_flow_sees():
    """Of slits their own; of round pipes sqrt(3/2) radii, by k = porosity radius^2 / 8."""
    assert pore_width(0.3 * 7.0**2 / 12, 0.3) == pytest.approx(7.0, rel=1e-12)
    assert pore_width(0.5 * 4.0**2 / 8, 0.5) == pytest.approx(4.0 * math.sqrt(1.5), rel=1e-12)


def test_mean_chords():
    """Of plates 2 of 6 voxels thick: lines across them have chords of 2 and 4, those along them none that ends; with as
    many walls in a third of the directions a mean is three times as long. Of cubes half the box wide all lines through
    them have chords of half the box, an eighth of the volume lies on them."""
    plates = np.zeros((6, 6, 6), bool)
    plates[:, :4] = True
    assert [mean_chord(plates), mean_chord(~plates)] == pytest.approx([3 * 2.0] * 2)
    cubes = np.zeros((8, 8, 8), bool)
    cubes[:4, :4, :4] = True
    assert mean_chord(cubes) == pytest.approx(4.0)
    assert mean_chord(np.ones((4, 4), bool)) == math.inf
    assert is_straight(plates) and is_straight(plates[0]) and not is_straight(cubes)


class BetweenFaces(LevelGeometry):
    """The box does not repeat along y."""

    periodic = (True, False, True)


def test_chords_of_grains():
    """Of a sphere 4/3 of its radius (the mean over lines through it), of a plate its volume over
    its faces; what fills the box up to a face that does not repeat is no grain."""
    sphere = body("spheres 0.064, 8")
    radius = 8.0 * (0.064 * 3 / (4 * math.pi)) ** (1 / 3)
    assert grain_chord(LevelGeometry(sphere), 0.125) == pytest.approx(4 / 3 * radius, rel=0.02)
    slit = body("slit 5.3")  # in a box of 10, walls across one of three axes
    # lines lie 1/32 of the box apart
    assert grain_chord(LevelGeometry(slit), 0.1) == pytest.approx(3 * (10.0 - 5.3), abs=3 * 10.0 / 32)
    assert grain_chord(BetweenFaces(slit), 0.1) == math.inf


def test_thin_grains_widen_the_range():
    """Pores 8 spacings wide between grains of 2 are worth what pores of 2 are."""
    k, porosity = 0.5 * 8.0**2 / 12, 0.5
    wide, thin = (expected("exact", k, porosity, 1.0, grain) for grain in (math.inf, 2.0))
    assert thin.spacing == pytest.approx(4.0**ORDER * wide.spacing) and "grains 2 particles wide" in thin.sentence


def test_edges_of_solid_widen_the_range():
    """Over a step in a plane channel, 10 particles high, k is some per cent off, where round bodies as wide have 0.7 %;
    at 40 particles it is 1 % off. Corners of a duct are no edges: the solid bends towards the fluid there."""
    case = {"geometry": {"box": [2.0, 1.0], "periodic": ["x"]}, "particles": {"spacing": 0.1},
            "fluids": {"water": {"density": 1, "viscosity": 1}}, "flow": "stokes", "drive": {"axes": ["x"]},
            "output": {"plots": False, "snapshots": False}}
    step = {**case["geometry"], "shapes": [{"box": {"lower": [0.53, -1], "upper": [1.11, 0.43]}, "is": "solid"}]}
    coarse, fine = (isphcli.run(case | {"geometry": step, "particles": {"spacing": h}}, quiet=True)
                    for h in (0.1, 0.025))
    low, high = coarse.permeability_range
    assert low < fine.permeability < high and abs(coarse.permeability / fine.permeability - 1) > 0.02
    said = coarse.summary["permeability_range_from"]
    assert "34 known bodies" in said and said.startswith("x: spacing +-")
    plain = isphcli.run(case, quiet=True)
    assert "34 known bodies" not in plain.summary["permeability_range_from"]


def test_edges_are_told_from_round_walls():
    """Pipes and spheres of two spacings and more are round; a wire of 0.3 spacings in a pipe is an edge."""
    ways = np.stack(np.meshgrid(*[np.arange(-6.0, 6.5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.21

    def edges(*shapes):
        walls = ShapeGeometry([-7.0] * 3, [7.0] * 3, [True] * 3, 0, shapes)
        return has_edges(walls, ways[walls.phase(ways) >= 0], 1.0)

    pipe = Shape(Cylinder(2, (0.0, 0.0, 0.0), 5.5), -1, outside=True)
    assert not edges(pipe) and not edges(Shape(Sphere((0.0, 0.0, 0.0), 2.0), -1))
    assert edges(pipe, Shape(Cylinder(2, (0.0, 0.0, 0.0), 0.3), -1))
    assert edges(Shape(Box((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0)), -1))


@pytest.mark.parametrize("refine", [None, [1 / 16]])
def test_ranges_and_bars_hold_a_slit_whose_walls_slip(refine):
    """k = h^2 / 12 + b h / 2. The walls' own error is of first order, 5 % at 8 particles across and 3 % at 16, far more
    than that of walls that do not slip; a slip length beyond the box makes a plane of symmetry and tells nothing."""
    case = {"geometry": {"box": [0.5, 1.0], "periodic": ["x"], "slip_length": 0.4}, "particles": {"spacing": 1 / 8},
            "fluids": {"water": {"density": 1, "viscosity": 1}}, "flow": "stokes", "drive": {"axes": ["x"]},
            "output": {"plots": False, "snapshots": False}}
    found = isphcli.run(case if refine is None else case | {"refine": refine}, quiet=True)
    truth, k = 1 / 12 + 0.4 / 2, found.permeability
    low, high = found.permeability_range
    assert low < k < truth < high and truth / k - 1 > 4 * expected("exact", k, 1.0, 1 / (16 if refine else 8)).spacing
    if refine:
        assert k + found.permeability_error > truth
    else:
        assert "slip walls 6.1 %" in found.summary["permeability_range_from"]


def test_the_error_of_slip_is_of_first_order_and_of_real_slip():
    assert slip_error(2.0, 0.5, 0.1, 0.4) == pytest.approx(2 * slip_error(2.0, 0.5, 0.05, 0.4), rel=1e-12)
    for lengths, told in (([0.1, 1e9], 0.1), ([0.0, 0.0], 0.0), ([], 0.0)):
        box = SimpleNamespace(lower=np.zeros(2), upper=np.array([1.0, 2.0]), slip_length=np.array(lengths))
        assert slip_of(box) == told


def test_every_wall_is_calibrated():
    found = calibrations()
    for wall in WALLS:
        parts = ["spacing"] if wall == "exact" else ["spacing", "image", "straight"]
        for part in parts:
            assert 0.0 < found[wall, part].factor < 10.0 and found[wall, part].bodies >= 9


def test_the_page_on_resolution_has_these_errors():
    """Its table by width and its sentence by chord, to the last digit that is written (56 % stands for 56.5 % too)."""
    page = " ".join((ROOT / "docs/resolution.md").read_text(encoding="utf-8").split())
    rows = re.findall(r"\| (\d+) \| ([\d.]+) % \| ([\d.]+) % \| ([\d.]+) % \|", page)
    assert [row[0] for row in rows] == ["2", "4", "8"]
    told = [(wall, "spacing", row[0], shown) for row in rows
            for wall, shown in zip(("exact", "labels", "stairs"), row[1:])]
    chords = re.search(r"labels (\d+) % where .* is 2 voxels, (\d+) % at 4 and (\d+) % at 8", page)
    told += [("labels", "image", chord, shown) for chord, shown in zip("248", chords.groups())]
    for wall, part, width, shown in told:
        unit = 10.0 ** -len(shown.partition(".")[2])
        assert 100 * calibrations()[wall, part].within(float(width)) == pytest.approx(float(shown), abs=0.501 * unit)


@pytest.mark.parametrize("wall", WALLS)
def test_wider_pores_and_finer_images_are_worth_more(wall):
    scans = [None] * 2 if wall == "exact" else [Scan(3.0, False), Scan(6.0, False)]
    coarse = expected(wall, 1.0, 0.3, 1.0, scan=scans[0])
    fine = expected(wall, 1.0, 0.3, 0.5, scan=scans[1])
    assert fine.spacing < coarse.spacing and (wall == "exact" or fine.image < coarse.image)
    assert expected(wall, 1.0, 0.3, 1.0, scan=scans[0], bar=0.01).spacing == 0.01  # several spacings tell by themselves


def test_a_range_is_as_wide_up_as_down():
    low, high = Expected(0.3, 0.4, "").bounds(2.0)  # 3, 4, 5
    assert low == pytest.approx(2.0 / 1.5) and high == pytest.approx(2.0 * 1.5)
