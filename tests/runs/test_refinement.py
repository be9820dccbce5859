"""Spacings that `refine: auto` chooses."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.load import load_case, read_case
from isphcli.runs.refinement import Solved, candidates, further_spacings
from isphcli.runs.run import run_case
from isphcli.scene import memory
from isphcli.scene.build_geometry import build_geometry

FLUID = "fluids: {water: {density: 1, viscosity: 1}}\ndrive: {axes: [x]}\nflow: stokes\nrefine: auto\n"
DISK = ("geometry: {box: [1, 1], periodic: [x, y], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.25}, is: solid}]}\n"
        "particles: {spacing: 0.05}\n" + FLUID)


@pytest.fixture
def image(tmp_path):
    """A case of an image with two particles per voxel edge, and its geometry."""
    pores = np.ones((6, 6, 6), np.uint8)
    pores[:, :2] = 0
    np.save(tmp_path / "slit.npy", pores)
    path = tmp_path / "slit.yaml"
    path.write_text("geometry: {voxels: {file: slit.npy, labels: {solid: 0, water: 1}, voxel_size: 1, axes: xyz}, "
                    f"periodic: [x, y, z]}}\nparticles: {{spacing: 0.5}}\n{FLUID}output: {{plots: false}}\n")
    case = load_case(path, (f"output.directory={tmp_path / 'out'}",))
    return case, build_geometry(case)


def chosen(case, geometry, seconds, particles=1000):
    """Spacings of a run whose first level takes so many seconds, and the others in the ratio of their particles."""
    base = case.particles.spacing
    solved = [Solved(base, particles, seconds)]
    for spacing in further_spacings(case, geometry, solved):
        ratio = (base / spacing) ** geometry.dim
        solved.append(Solved(spacing, round(particles * ratio), seconds * ratio))
    return [level.spacing for level in solved]


def test_whole_particles_fit_a_voxel(image):
    finer, coarser = candidates(*image)
    assert finer == pytest.approx([1 / 3, 1 / 4]) and coarser == pytest.approx([1.0])


def test_three_spacings_the_finer_the_more_time_there_is(image):
    case, geometry = image  # 3 and 4 particles per voxel take 3.4 and 8 times the seconds of two
    assert chosen(case, geometry, 1.0) == pytest.approx([0.5, 1 / 3, 1 / 4])
    assert chosen(case, geometry, 100.0) == pytest.approx([0.5, 1 / 3, 1.0])
    assert chosen(case, geometry, 1000.0) == pytest.approx([0.5, 1.0])
    disk = read_case(DISK.encode(), "disk.yaml")
    assert chosen(disk, build_geometry(disk), 1.0) == pytest.approx([0.05, 0.05 / 1.5, 0.025])
    assert chosen(disk, build_geometry(disk), 1000.0) == pytest.approx([0.05, 0.075, 0.1])


def test_no_spacing_that_memory_does_not_hold(image, monkeypatch):
    case, geometry = image
    need = sum(memory.estimate(case, 3, True, 1000 * (3 / 2) ** 3, 0).values())
    monkeypatch.setattr(memory, "available", lambda: 1.01 * need)
    assert chosen(case, geometry, 1e-3) == pytest.approx([0.5, 1 / 3, 1.0])


@pytest.mark.slow
def test_a_run_refines_itself_and_says_what_it_took(image):
    """The case that the run leaves names the spacings, so that it can be repeated on a busier machine."""
    case, _ = image
    summary = run_case(case, quiet=True)
    again = load_case(case.output.directory / "case.yaml")
    assert sorted(again.spacings) == pytest.approx([1 / 4, 1 / 3, 1 / 2])
    assert len(summary["permeability_by_spacing"]["x"]) == 3
    low, high = summary["permeability_range"]
    assert low < 4**3 / 12 / 6 < high < 4 * low  # a slit of 4 voxels in 6


def test_one_spacing_alone_is_said(image):
    """With one particle per voxel there is no coarser spacing of whole particles, and no time for a finer one."""
    case, _ = image
    case = replace(case, particles=replace(case.particles, spacing=1.0), refine_budget=1e-9)
    summary = run_case(case, quiet=True)
    assert summary["permeability_error"] is None and summary["permeability_by_spacing"] is None
    assert any("refine: auto" in text and "no error bar" in text for text in summary["warnings"])
    low, high = summary["permeability_range"]  # what known bodies let expect stands there all the same
    assert low < summary["permeability"] < high
