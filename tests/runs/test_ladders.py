"""Ladders of runs: the law of Forchheimer, slip along walls, growing parts of an image."""

import csv

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.references.arrays import cylinder_array_permeability
from isphcli.runs.ladders import (
    LadderError,
    fit_forchheimer,
    fit_klinkenberg,
    fitted,
    forchheimer,
    klinkenberg,
    parts_of,
    representative_volume,
)

FLUID = "fluids: {water: {density: 1, viscosity: 1}}\noutput: {snapshots: false, plots: false}\n"
CYLINDER = """
geometry:
  box: [1.0, 1.0]
  periodic: [x, y]
  shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.25}, is: solid}]
particles: {spacing: 0.1}
drive: {body_force: [1, 0]}
time: {steady: 0.01}
""" + FLUID
SLIT = """
geometry: {box: [0.25, 1.0], periodic: [x]}
particles: {spacing: 0.03125}
flow: stokes
drive: {axes: [x]}
""" + FLUID


def test_the_law_that_made_the_runs_is_found():
    """k = 2e-3 m2 and beta = 50 /m, exactly; with 1 % of scatter within three of the errors that are told."""
    u = np.array([1e-3, 1e-2, 0.05, 0.1, 0.2])
    force = 0.1 * u / 2e-3 + 50.0 * u**2
    rows = [{"force": g, "superficial_velocity": v} for g, v in zip(force, u)]
    exact = fit_forchheimer(rows, 0.1)
    assert exact.permeability == pytest.approx(2e-3, rel=1e-12) and exact.beta == pytest.approx(50.0, rel=1e-12)
    assert exact.rows[0]["reynolds"] == pytest.approx(1e-3 * np.sqrt(2e-3) / 0.1)
    for row, off in zip(rows, np.random.default_rng(3).normal(1.0, 0.01, len(u))):
        row["force"] *= off
    found = fit_forchheimer(rows, 0.1)
    assert abs(found.permeability - 2e-3) < 3.0 * found.errors[0] < 2e-4
    assert abs(found.beta - 50.0) < 3.0 * found.errors[1] < 30.0
    assert fit_forchheimer(rows[:2], 0.1).errors is None


def test_a_polynomial_is_found():
    x = np.linspace(0.0, 2.0, 5)
    assert np.allclose(fitted(x, 1.0 + 2.0 * x + 3.0 * x**2, 2).values, [1.0, 2.0, 3.0])


@pytest.mark.slow
def test_inertia_of_a_cylinder_array(tmp_path):
    """k of a small force is that of creeping flow (8 % are what ten particles a cell are off), and inertia resists: the
    apparent permeability of a thousandfold force is smaller."""
    case = read_case(CYLINDER.encode(), "case.yaml")
    found = forchheimer(case, [1.0, 1000.0], tmp_path / "out")
    apparent = [row["apparent_permeability"] for row in found.rows]
    assert apparent[0] == pytest.approx(cylinder_array_permeability(np.pi / 16), rel=0.08)
    assert apparent[1] < 0.97 * apparent[0] and found.beta > 0.0
    assert found.rows[1]["reynolds"] > 1.0
    with open(tmp_path / "out" / "forchheimer.csv", encoding="utf-8", newline="") as file:
        assert [float(row["factor"]) for row in csv.DictReader(file)] == [1.0, 1000.0]


def test_slip_of_a_slit(tmp_path):
    """k(s) = h^2 / 12 (1 + 6 s / h): 2 % are what slip walls are off at 32 particles across (docs/method.md 13)."""
    found = klinkenberg(read_case(SLIT.encode(), "case.yaml"), [0.0, 0.02, 0.04], tmp_path / "out")
    assert found.permeability == pytest.approx(1.0 / 12.0, rel=1e-3)
    assert found.slope == pytest.approx(6.0, rel=0.02)


def test_slip_that_is_known_is_found():
    rows = [{"slip_length": s, "permeability": 3.0 * (1.0 + 5.0 * s)} for s in (0.0, 0.1)]
    found = fit_klinkenberg(rows)
    assert found.permeability == pytest.approx(3.0) and found.slope == pytest.approx(5.0)


def test_parts_grow_and_lie_within():
    parts = parts_of([40, 32, 64], [10, 0, 0], 4)
    assert sorted({part.voxels for part in parts}) == [8, 12, 16, 24, 32]
    for part in parts:
        assert all(b - a == part.voxels for a, b in part.ranges)
        assert all(low <= a and b <= low + n for (a, b), low, n in zip(part.ranges, (10, 0, 0), (40, 32, 64)))
    assert parts[0].ranges == ((26, 34), (12, 20), (28, 36))  # the first one of an edge in the middle
    assert len({part.ranges for part in parts}) == len(parts)
    assert len(parts_of([16, 16])) == 3 + 3 + 1  # edges 8 (of 4, 6 and 8), 12 and 16


@pytest.mark.slow
def test_parts_of_slits_have_their_permeability(tmp_path):
    """Slits 4 voxels wide between walls of 4: a whole number of periods has the porosity 1/2 and k = 4^2 / 24."""
    image = np.zeros((32, 32), np.uint8)
    image[np.arange(32) % 8 < 4] = 1
    np.save(tmp_path / "slits.npy", image)
    text = f"""
geometry:
  voxels: {{file: {tmp_path / "slits.npy"}, labels: {{solid: 1, water: 0}}, voxel_size: 1.0}}
  periodic: [x, y]
particles: {{spacing: 0.5}}
flow: stokes
drive: {{axes: [x]}}
""" + FLUID
    rows = representative_volume(read_case(text.encode(), "case.yaml"), tmp_path / "out", each=2)
    whole = [row for row in rows if row["voxels"] % 8 == 0]
    assert {row["voxels"] for row in whole} == {8, 16, 24, 32}
    for row in whole:
        assert row["edge"] == row["voxels"] and row["porosity"] == pytest.approx(0.5, rel=1e-6)
        assert row["permeability"] == pytest.approx(16.0 / 24.0, rel=0.02)  # 8 particles across
    with open(tmp_path / "out" / "rev.csv", encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == len(rows)


@pytest.mark.parametrize("run", [
    lambda case, out: forchheimer(case, [1.0, 2.0], out),
    lambda case, out: klinkenberg(case, [0.1], out),
    lambda case, out: representative_volume(case, out),
])
def test_cases_that_a_ladder_cannot_be_made_of(tmp_path, run):
    with pytest.raises(LadderError):
        run(read_case(SLIT.encode(), "case.yaml"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
