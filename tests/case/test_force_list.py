"""Forces of the list as cases ask for them: microporous rock against the exact flow of Brinkman's equation."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.case.yaml import CaseError
from isphcli.flow.state import Handover
from isphcli.output.clock import Clock
from isphcli.output.lines import scene_lines
from isphcli.preflight.check import check
from isphcli.runs.ladders import porosity_of
from isphcli.runs.run import run_case
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

SLIT = """
geometry: {{box: [{width}, 1], periodic: [x], walls: {{}}, shapes: [{shapes}]}}
particles: {{spacing: {dx}, lattice: square}}
fluids: {{water: {{density: 2, viscosity: 0.6}}}}
flow: stokes
{more}
"""
ROCK = "{{box: {{lower: [-1, -1], upper: [9, {upper}]}}, is: clay}}"


def velocities(n, shapes, more):
    """(y, velocity along x by that of a unit force over nu) of a slit of width 1 with n particles across."""
    text = SLIT.format(width=4 / n, dx=1 / n, shapes=shapes, more=more)
    case = read_case(text.encode(), "case.yaml")
    geometry = build_geometry(case)
    scene = build_scene(case, geometry, case.particles.spacing, Clock())
    flow = solve_axis(case, scene, 0, np.eye(2)[0], Clock())
    return scene.particles.x[: scene.particles.n_fluid, 1], flow.velocity[:, 0] * 0.3, flow


def microporous(k):
    return f"microporous: {{clay: {{permeability: {k}}}}}\n"


def brinkman(y, k):
    """k u = k u'' k + k, u = 0 at y = 0 and 1 (Brinkman 1949)."""
    s = 1.0 / np.sqrt(k)
    return k * (1.0 - np.cosh(s * (y - 0.5)) / np.cosh(0.5 * s))


def half_filled(y, k, h=0.5):
    """Rock below h, clear fluid above it; velocity and its slope are continuous at h."""
    s = 1.0 / np.sqrt(k)
    e = np.exp(-s * h)
    conditions = [[e, 1, 0, 0], [1, e, -h, -1], [s, -s * e, -1, 0], [0, 0, 1, 1]]
    a, b, c, d = np.linalg.solve(conditions, [-k, -0.5 * h * h - k, -h, 0.5])
    return np.where(y < h, k + a * np.exp(s * (y - h)) + b * np.exp(-s * y), -0.5 * y * y + c * y + d)


def error(n, k, exact, upper):
    y, u, _ = velocities(n, ROCK.format(upper=upper), microporous(k))
    return np.linalg.norm(u - exact(y, k)) / np.linalg.norm(exact(y, k))


@pytest.mark.parametrize(("exact", "upper"), [(brinkman, 2), (half_filled, 0.5)])
def test_a_slit_of_microporous_rock_is_that_of_brinkman(exact, upper):
    """Second order, where a seam lies between layers of the lattice; measured at k = 0.01: 4.2e-3 of the half filled
    slit with 32 across, 2.0 as the order."""
    errors = [error(n, 0.01, exact, upper) for n in (16, 32, 64)]
    assert errors[1] < 6e-3
    order = -np.polyfit(np.log([16, 32, 64]), np.log(errors), 1)[0]
    assert order > 1.7


def test_in_rock_far_from_walls_darcys_law_holds():
    """There the drag balances the force alone: u = k F / nu. The walls change it by exp(-0.4 / sqrt(k)), 3e-6."""
    y, u, _ = velocities(32, ROCK.format(upper=2), microporous(1e-3))
    middle = np.abs(y - 0.5) < 0.1
    assert np.count_nonzero(middle) and np.allclose(u[middle] / 1e-3, 1.0, rtol=0, atol=1e-4)


def test_drag_and_shear_at_the_walls_balance_the_force():
    """Over a slit of half rock, half clear fluid: 1 = mean(u in rock) / k / 2 + u'(0) - u'(1). Slopes are those of
    parabolas through the walls and the next two layers of particles, which are of second order: 0.2 % at 64 across."""
    n, k = 64, 0.01
    y, u, _ = velocities(n, ROCK.format(upper=0.5), microporous(k))
    layers = np.array([u[np.abs(y - (i + 0.5) / n) < 0.1 / n].mean() for i in range(n)])
    slopes = [n * (3 * a - b / 3) for a, b in (layers[:2], layers[:-3:-1])]
    assert layers[: n // 2].mean() / 2 / k + sum(slopes) == pytest.approx(1.0, abs=0.004)


def test_voxels_of_microporous_rock_are_where_their_labels_are(tmp_path):
    """The same slit as an image: labels by layers, one particle per voxel, the walls sealed sides."""
    n, k = 16, 0.01
    image = np.ones((n, 4), np.uint8)
    image[: n // 2] = 2
    np.save(tmp_path / "slit.npy", image)
    text = f"""
geometry:
  voxels: {{file: {tmp_path / 'slit.npy'}, labels: {{water: 1, clay: 2}}, voxel_size: {1 / n}}}
  periodic: [x]
particles: {{spacing: {1 / n}}}
fluids: {{water: {{density: 2, viscosity: 0.6}}}}
flow: stokes
drive: {{axes: [x]}}
{microporous(k)}
"""
    case = read_case(text.encode(), "case.yaml")
    geometry = build_geometry(case)
    points = np.array([[0.1, 0.2], [0.1, 0.8]])
    assert geometry.microporous(points).tolist() == [0, -1] and geometry.phase(points).tolist() == [0, 0]
    scene = build_scene(case, geometry, case.particles.spacing, Clock())
    flow = solve_axis(case, scene, 0, np.eye(2)[0], Clock())
    y = scene.particles.x[: scene.particles.n_fluid, 1]
    assert np.linalg.norm(flow.velocity[:, 0] * 0.3 - half_filled(y, k)) < 0.03 * np.linalg.norm(half_filled(y, k))


LAYERS = """
geometry:
  voxels: {{file: {file}, labels: {{water: 1, clay: 2, solid: 0}}, voxel_size: 1}}
  periodic: [x]
  wall_distance: stairs
particles: {{spacing: 1}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
microporous: {{clay: {{permeability: 0.5}}}}
flow: stokes
drive: {{axes: [x]}}
output: {{directory: {out}, plots: false, snapshots: false}}
"""


def test_pores_and_microporous_rock_are_told_apart(tmp_path):
    """Of 16 layers 4 are solid, 4 of clay and 8 of water: by voxels, by sites, by particles, and of a cube that
    nothing leads through."""
    np.save(tmp_path / "layers.npy", np.repeat(np.uint8([0, 2, 1, 1]), 4)[:, None] * np.ones((1, 4), np.uint8))
    case = read_case(LAYERS.format(file=tmp_path / "layers.npy", out=tmp_path / "out").encode(), "case.yaml")
    geometry = build_geometry(case)
    said = dict(geometry.described)
    assert said["porosity"].startswith("50.00 %") and said["microporous"] == "clay 25.00 % of the image's voxels"
    found = check(case, geometry)
    assert found.microporous == {"clay": 0.25}
    assert "porosity 50.00 %, microporous clay 25.00 %, 1 connected" in found.text()
    summary = run_case(case, quiet=True)
    assert summary["porosity"] == pytest.approx(0.5, rel=1e-12)
    assert summary["microporous"] == pytest.approx({"clay": 0.25}, rel=1e-12)
    assert summary["mean_velocity"][0] * 0.75 == pytest.approx(summary["superficial_velocity"][0], rel=1e-9)
    assert ("microporous", "clay 25 %") in scene_lines(summary)
    assert porosity_of(geometry) == 0.5


@pytest.mark.parametrize(("shapes", "more", "key", "word"), [
    (ROCK.format(upper=2), microporous(1e-7), "microporous", "too tight"),
    (ROCK.format(upper=2), microporous(1) + "measure: [formation_factor]\ndrive: {axes: [x]}", "measure", "diffusion"),
    ("", microporous(1).replace("clay", "water"), "microporous", "name of a fluid"),
    (ROCK.format(upper=2), "", "geometry.shapes.0.is", "clay"),
])
def test_what_cannot_be_is_refused(shapes, more, key, word):
    text = SLIT.format(width=0.25, dx=1 / 16, shapes=shapes, more=more)
    with pytest.raises(CaseError) as caught:
        read_case(text.encode(), "case.yaml")
    assert any(problem.key == key and word in problem.message for problem in caught.value.problems), str(caught.value)


@pytest.mark.parametrize("flow", ["flow: stokes", "flow: navier_stokes\ntime: {steady: 1.0e-5, end: 9}"])
def test_plates_resist_as_rock_does(flow):
    """Hele-Shaw: a slit between plates is that of a rock of permeability depth^2 / 12, of moving particles too; the
    error of 16 particles across is that of Brinkman's slit, 3.0e-3 at k = 0.01. Shifts leave 2e-3 more."""
    k = 0.01
    text = SLIT.format(width=0.25, dx=1 / 16, shapes="", more="").replace("flow: stokes", flow)
    text = text.replace("shapes: []", f"depth: {np.sqrt(12 * k)}") + "drive: {body_force: [0.3, 0]}\n"
    case = read_case(text.encode(), "case.yaml")
    geometry = build_geometry(case)
    if case.flow == "stokes":
        scene = build_scene(case, geometry, case.particles.spacing, Clock())
        found = solve_axis(case, scene, 0, np.array([0.3, 0.0]), Clock()).velocity[:, 0]
        y = scene.particles.x[: scene.particles.n_fluid, 1]
    else:
        state, stepper, _ = prepare(case, geometry, Clock())
        config = stepper.configure(state.x)
        for _ in range(40):  # its slowest mode decays by 0.3 (1 / k + pi^2), 1 / 33 s
            step = stepper.advance(state, Handover(config), 0.02)
            state, config = step.state, step.config
        found, y = state.u[:, 0], state.x[:, 1]
    assert np.linalg.norm(found - brinkman(y, k)) < 6e-3 * np.linalg.norm(brinkman(y, k))
