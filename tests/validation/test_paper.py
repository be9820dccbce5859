"""`isph validate --paper`: counts, measures, the report; runs are replaced by what they would return."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from isphcli.case.yaml import CaseError
from isphcli.cli import BAD_INPUT, OUTSIDE, main
from isphcli.references import drops
from isphcli.scene.build_geometry import build_geometry
from isphcli.validation import paper
from isphcli.validation.paper import Figure, Finding, NotRun, count_table_1, radial_profile, reproduce, spacing_for


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("n, sites", [(128, 6_083_687), (192, 19_701_287), (256, 45_803_537), (384, 151_438_991)])
def test_sites_of_table_1(n, sites):
    """As printed in the paper."""
    assert count_table_1(n) == sites


def test_sites_of_table_1_fill_the_cylinder():
    """Two a cube of dx, up to the sites on the surface, which are of order dx / R."""
    for n in (128, 384):
        dx = 8.8e-3 / n
        cubes = math.pi * (4.4e-3 + 4 * dx) ** 2 * 14.38e-3 / dx**3
        assert count_table_1(n) == pytest.approx(2 * cubes, rel=0.005)


def column(spacing):
    """Sites of a cubic lattice in the column without beads."""
    g = np.arange(-4.4e-3, 4.4e-3, spacing) + spacing / 2
    y = np.arange(-7e-3, 7e-3, spacing) + spacing / 2
    x = np.stack(np.meshgrid(g, y, g, indexing="ij"), -1).reshape(-1, 3)
    return x[np.hypot(x[:, 0], x[:, 2]) < 4.4e-3]


def test_radial_profile_of_flow_in_a_pipe():
    x = column(1e-4)
    v = 1 - (x[:, 0] ** 2 + x[:, 2] ** 2) / 4.4e-3**2
    radius, porosity, speed = radial_profile(x, v, 1e-4, bins=8)
    assert porosity == pytest.approx(1.0, abs=0.09)  # 8 rings of 5 sites
    assert speed == pytest.approx(1 - (radius / 4.4e-3) ** 2, abs=0.09)


def test_porosity_of_the_beads_that_a_coarse_lattice_sees():
    """The table of porosities over the radius against the beads of the case, on a lattice of 4 sites a bead."""
    centres = np.loadtxt(Path(paper.__file__).parents[2] / "cases/data/bead_centres.csv", delimiter=",", skiprows=1)
    from scipy.spatial import cKDTree

    x = column(1.25e-4)
    free = cKDTree(centres).query(x)[0] > 2.5e-4
    radius, porosity, _ = radial_profile(x[free], np.ones(free.sum()), 1.25e-4)
    assert np.sqrt(np.mean((porosity - paper.known_porosity(radius)) ** 2)) < 0.03


def test_spacing_for_so_many_particles():
    h = spacing_for(1e5)
    assert paper.PORES / h**3 == pytest.approx(1e5, rel=0.15) and h == float(f"{h:.2g}")
    assert paper.PORES / spacing_for(1e9) ** 3 < 1.2 * paper.MOST  # memory


def summaries(monkeypatch, errors):
    """Runs that return these errors; cases of the names that are asked for, of unit surface tension."""
    asked = []

    def run(name, folder, *overrides):
        asked.append(name)
        return {"errors": errors, "cpu_seconds": {"total": 1.0}, "particles": {"fluid": 9}, "steps": 3}

    class Tension:
        tension = 1.0

    class Case:
        interface = Tension

    monkeypatch.setattr(paper, "run", run)
    monkeypatch.setattr(paper, "case_of", lambda *words: Case)
    return asked


@pytest.mark.parametrize("error, holds", [(0.03, True), (-0.06, False)])
def test_square_drops_are_judged_by_the_slope(monkeypatch, folder, error, holds):
    asked = summaries(monkeypatch, {"laplace_relative": error, "spurious_capillary_number": 1e-4, "circularity": -0.01})
    finding = paper.square_drops(1.0, folder)
    assert asked == [f"square_drop_{k}" for k in (1, 2, 3, 4)] and finding.passed is holds
    assert f"{1 + error:.4f}" in finding.notes[0] and finding.pictures[0].stat().st_size > 5000
    # sigma / R of the square of 0.1: R = 0.1 / sqrt(pi)
    assert finding.rows[0][2] == f"{drops.laplace_jump(1.0, drops.drop_radius(0.01, 2), 2):.3f}"


@pytest.mark.parametrize("error, holds", [(0.03, True), (-0.05, False)])
def test_drops_on_walls_are_judged_by_degrees(monkeypatch, folder, error, holds):
    summaries(monkeypatch, {"angle_relative": error, "angle_of_cap_relative": 0, "height_relative": 0,
                            "spurious_capillary_number": 1e-4})  # fmt: skip
    finding = paper.drops_on_walls(1.0, folder)
    assert finding.passed is holds and finding.rows[1][1] == f"{150 * (1 + error):.1f}"


@pytest.mark.slow
def test_what_cannot_run_says_why(folder):
    with pytest.raises(NotRun, match="no_such_case"):
        paper.run("no_such_case", folder)
    with pytest.raises(NotRun, match="NoPathError"):  # spheres that overlap leave closed pockets
        paper.run("sphere_array", folder, "geometry.shapes.0.sphere.radius=7.2e-4", "particles.spacing=5e-5")
    with pytest.raises(CaseError):
        paper.run("slit", folder, "particles.spacing=much")


@pytest.mark.slow
@pytest.mark.parametrize("growth, holds", [(1.0, True), (2.5, False)])
def test_the_ladder_of_sizes(monkeypatch, folder, growth, holds):
    """Runs of 3 us (assembling) and 5 us (solving) a particle and step, the iterations growing with the size."""
    sizes = []

    def run(name, folder, *overrides):
        h = next(float(o.removeprefix("particles.spacing=")) for o in overrides if o.startswith("particles.spacing="))
        sizes.append(n := round(paper.PORES / h**3))
        steps = paper.LADDER_STEPS
        cpu = {"neighbours": 1e-6 * n * steps, "operators": 2e-6 * n * steps, "krylov": 5e-6 * n * steps, "total": 9.0}
        iterations = {"velocity": {"mean": 4.0}, "pressure": {"mean": 12.0 * (growth if len(sizes) > 2 else 1.0)}}
        return {"particles": {"fluid": n}, "cpu_seconds": cpu, "iterations": iterations}

    monkeypatch.setattr(paper, "run", run)
    finding = paper.scaling("bead_pack", paper.PORES, paper.PUSH)(1000.0, folder)
    assert len(finding.rows) == 4 and sizes[3] > 3 * sizes[0]
    assert all(row[1:4] == ["3.0", "5.0", "4.0"] for row in finding.rows) and finding.passed is holds
    assert "6 steps from rest" in finding.notes[0] and finding.pictures[0].stat().st_size > 5000
    # beside the paper's processes, from the last row: 16 iterations on 85,000 particles, more where they grow
    heads, rows = finding.modelled
    assert [row[:3] for row in rows] == [[128, "432", "14,083"], [192, "1,440", "13,682"], [256, "3,432", "13,347"],
                                         [384, "11,376", "13,313"]]
    known = [dict(zip(heads, row)) for row in rows]
    assert [float(row["iterations"]) > 16.0 for row in known] == [growth > 1.0] * 4
    assert float(known[0]["ms: assembling"]) == pytest.approx(3e-3 * 6075 * (1 + 4374 / 6075), rel=0.01)
    assert float(known[3]["over that of 432"]) > 1.0
    assert "nobody ran this" in finding.notes[1]


def test_what_moves_is_not_always_there(monkeypatch, folder):
    """Without moving particles figure 8 is of the steady flow and says so; figure 11 has no such way out."""

    def run(name, folder, *overrides):
        if "flow=navier_stokes" in overrides:
            raise NotRun("it stalls")
        return {"particles": {"fluid": 9}, "cpu_seconds": {"krylov": 1.0}, "iterations": {"stokes": {"mean": 30.0}}}

    monkeypatch.setattr(paper, "run", run)
    finding = paper.scaling("bead_pack", paper.PORES, paper.PUSH)(1.0, folder)
    assert "one steady solve" in finding.notes[0] and "it stalls" in finding.notes[0] and finding.rows[0][-1] == "30.0"
    assert finding.passed is None  # it is not what the paper claims
    with pytest.raises(NotRun, match="it stalls"):
        paper.scaling("co2_bubbles", paper.BUBBLES)(1.0, folder)


def missing(seconds, folder):
    raise NotRun("cases/none.yaml is not there")


FIGURES = (
    Figure("a", "Figure A", "it flows", 0.5, lambda s, f: Finding(("s",), [[s]], ["a note"], passed=True)),
    Figure("b", "Figure B", "it bubbles", 0.3, missing),
)


def test_the_report():
    text, passed = reproduce(Path("out"), 100.0, lambda line: None, FIGURES)
    assert passed and "1 of 2 figures and tables run, 0 of their claims missed" in text
    page = Path("out/report.md").read_text(encoding="utf-8")
    assert "The paper: it flows." in page and "| 50.0 |" in page and "not run: cases/none.yaml is not there" in page
    record = json.loads(Path("out/report.json").read_text(encoding="utf-8"))["figures"]
    assert [r["not_run"] for r in record] == [None, "cases/none.yaml is not there"] and record[0]["passed"]
    miss = Figure("c", "Figure C", "no", 0.1, lambda s, f: Finding(passed=False))
    assert reproduce(Path("out"), 100.0, lambda line: None, (miss,))[1] is False
    text, passed = reproduce(Path("out"), 0.0, lambda line: None, FIGURES)
    assert "0 of 2" in text and "the budget of 0 s is spent" in Path("out/report.md").read_text(encoding="utf-8")


def test_the_command(monkeypatch):
    monkeypatch.setattr(paper, "reproduce", lambda out, budget, say: (f"{out} {budget}", budget > 1))
    call = CliRunner().invoke
    done = call(main, ["validate", "--paper", "--budget", "7", "--out", "there"])
    assert done.exit_code == 0 and "there 7.0" in done.output
    assert call(main, ["validate", "--paper", "--budget", "1"]).exit_code == OUTSIDE
    assert call(main, ["validate", "--paper", "case.yaml"]).exit_code == BAD_INPUT


def test_part_of_the_pack_of_figure_7_is_a_periodic_cube_of_its_middle(folder):
    """Beads whose centres lie in the cube, cut beads made whole on the other side. Porosity 0.44, without overlaps
    0.41; that of the column within 3 mm of the axis is 0.42, and 140 beads have a few per cent more or less."""
    scene, beads = paper.part_of_the_pack(folder)
    geometry = build_geometry(paper.case_of("bead_pack", folder, *scene))
    points = geometry.lower + np.random.default_rng(0).random((20_000, 3)) * (geometry.upper - geometry.lower)
    assert all(geometry.periodic) and np.allclose(geometry.upper - geometry.lower, paper.PART)
    radius = np.linspace(0.0, 3e-3, 31)
    middle = np.average(paper.known_porosity(radius), weights=radius)
    assert (geometry.phase(points) >= 0).mean() == pytest.approx(middle, abs=0.04)
    assert 1 - beads * 4 / 3 * np.pi * 2.5e-4**3 / paper.PART**3 == pytest.approx(middle, abs=0.04)
