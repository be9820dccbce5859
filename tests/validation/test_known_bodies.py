"""Bodies of known permeability: their images, their exact surfaces, what error bars and ranges are worth on them."""

import csv
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.references.published import DATA
from isphcli.runs.expected_error import Scan, expected, grain_chord, is_straight, mean_chord, scan_of, usual_error
from isphcli.runs.permeability import EDGE, extrapolate
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.validation.known_bodies import GREY_LEVEL, LevelGeometry, bodies, body, computed

SMALL = ("slit at 45 degrees", "duct 6.4", "duct 10.7", "annulus 2.2 6.7", "ellipse 6.3 3.6", "spheres 0.216, 8",
         "cylinders 0.2, 12")
VOXEL = ("pipe 3.7 at 45 degrees", "annulus 4.5 8.1", "ellipse 6.3 3.6", "spheres 0.216, 8", "cylinders 0.2, 12",
         "duct 8 at 30 degrees")


def measured(wall):
    """Rows of what `benchmarks/calibration.py measure` found of one kind of wall."""
    with open(DATA / "known_bodies_measured.csv", encoding="utf-8", newline="") as file:
        for row in csv.DictReader(line for line in file if not line.startswith("#")):
            if row["wall"] == wall:
                yield row, np.array(row["k"].split(), float)


AGREE = 1e-4  # of k: the table has six digits, solves have a tolerance of 1e-6 of their right-hand side


def table_of(name, wall):
    """k (levels,) of one body in that table, voxel^2."""
    return next(k for row, k in measured(wall) if row["body"] == name)


def solve(one, geometry, spacing, case):
    scene = build_scene(case, geometry, spacing, Clock(), [one.axis])
    flow = solve_axis(case, scene, one.axis, np.eye(3)[one.axis], Clock())
    porosity = scene.cells * scene.particles.site_volume / np.prod(one.size)
    return float(flow.permeability[one.axis]), porosity, flow.mass_error


def case_of(one, block):
    text = (f"geometry: {{{block}, periodic: [x, y, z]}}\nparticles: {{spacing: 1}}\nflow: stokes\n"
            f"fluids: {{water: {{density: 1, viscosity: 1}}}}\ndrive: {{axes: [{'xyz'[one.axis]}]}}\n")
    return read_case(text.encode(), "body.yaml")


@pytest.mark.slow
def test_the_bodies_are_those_whose_truth_was_computed():
    """Random places and fields come from generators of libraries: the porosity tells if they are other ones now."""
    assert len(bodies()) >= 40 and len({one.name for one in bodies()}) == len(bodies())
    for name, row in computed().items():
        assert body(name).labels(3).mean() == pytest.approx(float(row["porosity"]), abs=2e-4), name
    for one in bodies():
        truth, uncertainty, source = one.truth()
        assert truth > 0.0 and uncertainty < 0.03 and source, one.name


@pytest.mark.slow
def test_images_and_surface_are_the_same_body():
    for one in bodies():
        labels, grey = one.labels(), one.grey()
        assert labels.shape == grey.shape == one.size
        inside = np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in one.size], indexing="ij"), axis=-1).reshape(-1, 3)
        assert np.array_equal(LevelGeometry(one).phase(inside) >= 0, labels.ravel() == 1), one.name
        # a voxel whose middle is solid may be more than half fluid, where the wall passes by the middle
        assert np.mean((grey < GREY_LEVEL) == (labels == 1)) > (0.85 if one.name != "slit 3.4" else 0.0), one.name
        for axis in range(3):  # periodic
            shifted = inside.copy()
            shifted[:, axis] += one.size[axis]
            assert np.allclose(one.level(shifted), one.level(inside), atol=1e-9), one.name


def test_distance_and_crossing_of_a_level_function():
    one = body("pipe 7.5")
    geometry = LevelGeometry(one)
    centre = np.array([9.3, 9.1, 3.0])
    ways = np.stack([np.cos(np.arange(8)), np.sin(np.arange(8)), np.zeros(8)], axis=1)
    assert geometry.distance(centre + 6.5 * ways) == pytest.approx(np.ones(8), abs=1e-6)
    assert geometry.crossing(centre + 7.0 * ways, centre + 8.0 * ways) == pytest.approx(np.full(8, 0.5), abs=1e-5)
    assert np.all(geometry.crossing(centre + ways, centre + 2 * ways) == 1.0)


@cache
def grain_of(name):
    """Mean chord of the grains of a body, voxels."""
    return grain_chord(LevelGeometry(body(name)), 1.0)


@pytest.mark.slow
def test_the_bar_of_exact_surfaces_holds_the_truth():
    """At 1 and 2 particles per voxel, solved here: k is that of the table on which bars and ranges rest, and none
    misses its bar (of all 45 one does). The bars are narrow enough to be of use."""
    missed, widths = [], []
    for name in SMALL:
        one = body(name)
        case, geometry = case_of(one, f"box: {[float(n) for n in one.size]}"), LevelGeometry(one)
        (coarse, _, _), (fine, porosity, flux) = (solve(one, geometry, spacing, case) for spacing in (1.0, 0.5))
        assert [coarse, fine] == pytest.approx(table_of(name, "exact")[:2], rel=AGREE), name
        usual = usual_error(fine, porosity, 0.5, grain_chord(geometry, 1.0))
        value, bar, *_ = extrapolate((1.0, 0.5), (coarse, fine), usual=usual, flux=flux)
        truth, uncertainty, _ = one.truth()
        if abs(value - truth) > bar + uncertainty * truth:
            missed.append(name)
        widths.append(bar / truth)
    assert missed == []
    assert np.median(widths) < 0.0025


@pytest.mark.parametrize("grey", [False, True])
def test_the_range_of_images_holds_the_truth(grey, tmp_path):
    """At one particle per voxel, solved here: k is that of the table, and the range holds the truth of each body; of
    all it does so for nine in ten."""
    for name in VOXEL:
        one = body(name)
        np.save(tmp_path / "image.npy", one.grey() if grey else one.labels())
        kind = f"grey: {{threshold: {GREY_LEVEL}, solid: above}}" if grey else "labels: {solid: 0, water: 1}"
        case = case_of(one, f"voxels: {{file: {tmp_path / 'image.npy'}, {kind}, voxel_size: 1, axes: xyz}}")
        geometry = build_geometry(case)
        k, porosity, _ = solve(one, geometry, 1.0, case)
        wall = "grey" if grey else "labels"
        assert k == pytest.approx(table_of(name, wall)[0], rel=AGREE), name
        scan = scan_of(geometry, wall == "grey")
        low, high = expected(wall, k, porosity, 1.0, grain_chord(geometry, 1.0), scan).bounds(k)
        assert low <= one.truth()[0] <= high, name


@pytest.mark.parametrize("name", ["spheres 0.216, 8", "pipe 3.7 at 45 degrees"])
def test_noise_widens_the_range_of_a_scan(name, tmp_path):
    """Of a tenth of the contrast: k is 3 and 2 % off, within the range that knows of it, and not within that of scans
    without noise."""
    one = body(name)
    noise = 0.2 * GREY_LEVEL * np.random.default_rng(1).standard_normal(one.size)
    np.save(tmp_path / "image.npy", np.rint(0.5 * (one.grey(scanned=True) + noise) + 10000).astype(np.uint16))
    kind = f"grey: {{threshold: {0.5 * GREY_LEVEL + 10000}, solid: above}}"
    case = case_of(one, f"voxels: {{file: {tmp_path / 'image.npy'}, {kind}, voxel_size: 1, axes: xyz}}")
    geometry = build_geometry(case)
    k, porosity, _ = solve(one, geometry, 1.0, case)
    grain, scan = grain_chord(geometry, 1.0), scan_of(geometry, True)
    for known, holds in ((scan, True), (replace(scan, off=0.0), False)):
        low, high = expected("grey", k, porosity, 1.0, grain, known).bounds(k)
        assert (low <= one.truth()[0] <= high) is holds


@pytest.mark.parametrize("levels", [(1, 2), (2, 3), (1, 2, 3)])
@pytest.mark.parametrize("wall", ["exact", "stairs"])
@pytest.mark.slow
def test_bars_hold_nine_bodies_in_ten(wall, levels):
    """What was measured of all bodies, put through `extrapolate` as it is: 90 % hold the truth, and half of the bars
    are not wider than so many times the error: four and a half of exact surfaces (3.5, 4.4 and 3.9 measured), because
    slits, pipes and ducts have hardly any; errors of one size that are normally distributed would have 2.4. Of stairs
    the truth is that of the cubes. Of channels whose edges all run along the flow the value at three particles per
    voxel is within 0.05 %, less than their truth is known to, because the order of these edges is taken out: their bars
    are left out there, and four is the bound of the others."""
    errors, bars, ratios, fine = [], [], [], wall == "stairs" and 3 in levels
    for row, k in measured(wall):
        if len(k) >= max(levels):
            one = body(row["body"])
            truth, uncertainty = (float(row["truth"]), 0.0) if wall == "stairs" else one.truth()[:2]
            k = k[np.array(levels) - 1]
            usual = usual_error(k[-1], one.labels(3).mean(), 1 / max(levels), grain_of(one.name))
            edges, flux = (EDGE, 0.0) if wall == "stairs" else (None, float(row["flux"].split()[max(levels) - 1]))
            value, bar, *_ = extrapolate([1 / level for level in levels], k, edges, usual=usual, flux=flux)
            off = abs(value / truth - 1)
            errors.append(max(off - uncertainty, 0.0))
            bars.append(bar / truth)
            pores = one.labels()
            if fine and np.all(pores == pores.take([0], one.axis)):
                assert off < 6e-4
            else:
                ratios.append(bar / truth / max(off, 1e-6))
    assert np.mean(np.array(errors) <= bars) >= 0.9
    assert np.median(ratios) <= (4.0 if fine else 4.5 if wall == "exact" else 3.0)


@pytest.mark.parametrize("wall", ["labels", "grey"])
@pytest.mark.parametrize("level", [1, 2])
def test_ranges_hold_nine_bodies_in_ten(wall, level):
    """What was measured of all images, put through `expected` as it is."""
    held = []
    for row, k in measured(wall):
        one = body(row["body"])
        pores = one.labels() == 1
        scan = Scan(mean_chord(pores), is_straight(pores))
        found = expected(wall, k[level - 1], one.labels().mean(), 1 / level, grain_of(one.name), scan)
        low, high = found.bounds(k[level - 1])
        held.append(low <= one.truth()[0] <= high)
    assert len(held) >= 40 and np.mean(held) >= 0.88  # of 45 bodies 40


@pytest.mark.parametrize("turned", [0, 3])
def test_noise_leaves_a_slit_its_range(turned):
    """A slit 4.4 voxels wide is 4 wide in an image that was segmented, whether or not some voxels were turned: its k is
    33 % more than that of the image, far beyond the 4 % of pores as wide whose walls lie in all directions."""
    pores = np.zeros((10, 12, 40), bool)
    pores[3:7] = True
    pores[2, 5, [4, 20, 33][:turned]] = True
    scan = Scan(mean_chord(pores), is_straight(pores))
    low, high = expected("labels", 4.0**3 / 120, 0.4, 1.0, scan=scan).bounds(4.0**3 / 120)
    assert scan.straight and low <= 4.4**3 / 120 <= high
    assert not is_straight(np.random.default_rng(1).random((10, 12, 40)) < 0.5)


@pytest.mark.parametrize("level", [1, 2])
def test_ranges_of_shapes_hold_nine_bodies_in_ten(level):
    """What was measured of all shapes, put through `expected` as it is. Spheres four voxels across in pores twice as
    wide are among those that hold: by the width of their pores alone the range was 0.4 of their error."""
    held = {}
    for row, k in measured("exact"):
        one = body(row["body"])
        found = expected("exact", k[level - 1], one.labels(3).mean(), 1 / level, grain_of(one.name))
        low, high = found.bounds(k[level - 1])
        truth, uncertainty, _ = one.truth()
        held[one.name] = low * (1 - uncertainty) <= truth <= high * (1 + uncertainty)
    assert len(held) == 45 and sum(held.values()) >= 43 and held["spheres 0.064, 8"]
