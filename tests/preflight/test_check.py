"""The check: counts that a run would find, widths and limits that are known exactly, findings and errors."""

import dataclasses

import numpy as np
import pytest

from isphcli.case.blocks import Case
from isphcli.case.load import read_case
from isphcli.preflight import check as module
from isphcli.preflight.check import check, lattice_of
from isphcli.scene import memory
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import place

SLIT = """\
geometry: {box: [1, 0.5], periodic: [x]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0]}
flow: stokes
"""
SPHERE = """\
geometry:
  box: [1, 1, 1]
  shapes: [{sphere: {centre: [0.5, 0.5, 0.5], radius: 0.4}, is: solid}]
  periodic: [x, y, z]
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
drive: {axes: [x, y, z]}
flow: stokes
"""
IMAGE = """\
geometry: {voxels: {file: rock.npy, labels: {solid: 1, water: 0}, voxel_size: 1e-5}}
particles: {spacing: 1e-5}
fluids: {water: {density: 1000, viscosity: 1e-3}}
drive: {body_force: [1, 0, 0]}
flow: stokes
"""
DROP = """\
geometry: {box: [1, 1], periodic: [x], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.2}, is: oil}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}, oil: {density: 3, viscosity: 2}}
interface: {tension: 2, contact_angle: 60}
time: {end: 1}
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = np.zeros((8, 8, 20), np.uint8)
    values[:, 6:] = 1
    np.save("rock.npy", values)
    return tmp_path


def read(text: str, *overrides: str) -> Case:
    return read_case(text.encode(), "case.yaml", overrides)


def used(text: str, *overrides: str) -> set[str]:
    return {term.name for term in check(read(text, *overrides)).terms if term.used}


# -- particles -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [SLIT, SPHERE, IMAGE, DROP])
@pytest.mark.parametrize("lattice", ["first", "second"])
def test_particles_are_those_of_a_run(text, lattice):
    names = {"first": ("square", "cubic"), "second": ("hexagonal", "bcc")}[lattice]
    case = read(text, f"particles.lattice={names[text in (SPHERE, IMAGE)]}")
    geometry = build_geometry(case)
    particles = place(geometry, lattice_of(case, geometry), case.support * case.particles.spacing)
    found = check(case, geometry).particles
    assert found["fluid"] == particles.n_fluid
    assert found["dummy"] == particles.n_dummy
    assert found["left_out"] == particles.left_out


def test_neighbours_of_a_lattice():
    assert check(read(SPHERE)).neighbours == pytest.approx(32, abs=0.5)
    assert check(read(SLIT)).neighbours == pytest.approx(12, abs=0.5)
    bcc = check(read(SPHERE, "particles.lattice=bcc", "particles.support=3"))
    assert bcc.neighbours == pytest.approx(2 * 32 * (3 / 2.1) ** 3, rel=0.02)


# -- terms -----------------------------------------------------------------------------------------------


def test_terms_in_use():
    assert used(SLIT) == {"walls", "periodic halo", "viscosity", "drive"}
    assert used(SLIT, "geometry.slip_length=0.1") == {"walls", "slip", "periodic halo", "viscosity", "drive"}
    walls = used(SLIT, "geometry.walls={y_max: {velocity: [1, 0]}}")
    assert "moving walls" in walls
    assert {"surface tension", "contact angle", "fluid contrasts", "inertia", "shifting"} <= used(DROP)
    assert "shifting" not in used(DROP, "particles.shifting=0")
    open_box = used(DROP, "geometry.periodic=[x, y]")
    assert not {"walls", "contact angle"} & open_box


def test_every_term_says_why():
    assert all(term.why for text in (SLIT, SPHERE, IMAGE, DROP) for term in check(read(text)).terms)


# -- pores -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("across", [2, 3, 4, 7, 8])
def test_the_width_of_a_slit(across):
    spacing = 0.5 / across
    throats = check(read(SLIT, f"particles.spacing={spacing}")).throats
    assert throats.narrow == pytest.approx(across)
    assert throats.median == pytest.approx(across)
    assert throats.critical == {0: pytest.approx(across, abs=0.61)}
    assert throats.thin == (1 if across < 4 else 0)


def test_the_throat_of_two_chambers():
    block = "{{box: {{lower: [0.8, {}], upper: [1.2, {}]}}, is: solid}}"
    shapes = ", ".join([block.format(-1, 0.375), block.format(0.625, 2)])
    case = read(SLIT, "geometry.box=[2, 1]", "particles.spacing=0.03125", f"geometry.shapes=[{shapes}]")
    throats = check(case).throats
    assert throats.critical[0] == pytest.approx(8, abs=0.61)
    assert throats.narrow == pytest.approx(8, abs=0.1)
    assert 20 < throats.median <= 32


def test_percolation_and_pockets_of_an_image(folder):
    values = np.ones((8, 8, 20), np.uint8)
    values[1:6, 1:6] = 0
    values[7, 7, 3] = 0
    np.save("rock.npy", values)
    report = check(read(IMAGE))
    assert report.can_run
    assert report.connectivity.percolates == (True, False, False)
    assert report.connectivity.isolated_pockets == 1
    assert report.connectivity.porosity == pytest.approx((values == 0).mean())  # without the clear layers
    assert report.throats.median == pytest.approx(5, abs=0.5)


def test_a_porous_scene_of_spheres():
    report = check(read(SPHERE, "particles.spacing=0.05"))
    assert report.connectivity.porosity == pytest.approx(1 - 4 / 3 * np.pi * 0.4**3, abs=0.01)
    assert report.connectivity.percolates == (True, True, True)
    # a ball passes between four spheres: sqrt(2) cells less their diameter
    assert report.throats.critical[0] * 0.05 == pytest.approx(np.sqrt(2) - 0.8, abs=0.05)


# -- flow, steps, costs ----------------------------------------------------------------------------------


def test_flow_and_steps_of_a_slit():
    report = check(read(SLIT, "flow=navier_stokes", "time={end: 1}"))
    assert report.flow.velocity == pytest.approx(0.5**2 / 8, rel=0.2)
    assert report.flow.reynolds == pytest.approx(report.flow.velocity * 0.5, rel=0.2)
    assert report.steps.limits["viscous accuracy"] == pytest.approx(0.0625**2)
    assert report.steps.limits["cfl"] == pytest.approx(0.2 * 0.0625 / report.flow.velocity)
    assert report.steps.count == pytest.approx(1 / report.steps.limits["cfl"])
    fixed = check(read(SLIT, "flow=navier_stokes", "time={end: 1, step: 0.01}"))
    assert fixed.steps.count == pytest.approx(100)


def test_capillary_limit_and_number():
    report = check(read(DROP))
    assert report.steps.limits["capillary"] == pytest.approx(np.sqrt(2 * 0.0625**3 / (2 * np.pi * 2)))
    assert report.flow.capillary == pytest.approx(2 * report.flow.velocity / 2)


def test_initial_velocity():
    box = ("geometry.periodic=[x, y]", "drive=null", "flow=navier_stokes", "time={end: 1}")
    report = check(read(SLIT, *box, "initial={velocity: ['3*cos(0*x)', 0]}"))
    assert report.flow.velocity == pytest.approx(3) and report.flow.source == "initial velocity"
    assert report.throats is None


def test_costs_grow_with_the_particles():
    coarse, fine = (
        check(read(SPHERE, "particles.spacing=0.05")),
        check(read(SPHERE, "particles.spacing=0.025")),
    )
    grown = fine.particles["fluid"] / coarse.particles["fluid"]
    assert fine.seconds / coarse.seconds == pytest.approx(grown)
    assert fine.memory["operators"] / coarse.memory["operators"] == pytest.approx(grown)
    one = check(read(SPHERE, "particles.spacing=0.05", "drive={axes: [x]}"))
    assert coarse.seconds == pytest.approx(3 * one.seconds)
    refined = check(read(SPHERE, "particles.spacing=0.05", "refine=[0.025]"))
    assert refined.memory["operators"] == pytest.approx(8 * coarse.memory["operators"])
    assert refined.seconds == pytest.approx(9 * coarse.seconds)


# -- findings --------------------------------------------------------------------------------------------


def findings(text: str, *overrides: str) -> str:
    report = check(read(text, *overrides))
    assert report.can_run, report.text()
    return "\n".join(report.warnings)


def test_nothing_to_say_about_a_good_case():
    assert findings(SLIT) == findings(SPHERE, "particles.spacing=0.025") == ""
    porous = np.zeros((8, 8, 20), np.uint8)
    porous[:, 4:] = 1
    np.save("rock.npy", porous)
    assert findings(IMAGE) == ""


def test_what_the_geometry_finds_is_a_warning():
    """The image of the fixture is open at six of eight layers."""
    assert findings(IMAGE).startswith("porosity 75.0 %: more than rock has")
    assert "voxels of 10 m" in findings(IMAGE, "geometry.voxels.voxel_size=10", "particles.spacing=10")


def test_throats_that_are_too_narrow():
    assert "median throat is 2.0" in findings(SLIT, "particles.spacing=0.25")


def test_spacing_and_voxel_size():
    assert "does not divide the voxel size" in findings(IMAGE, "particles.spacing=0.7e-5")
    assert "does not divide" not in findings(IMAGE, "particles.spacing=0.5e-5")


def test_clear_layer_thinner_than_the_support():
    assert "clear layer" in findings(IMAGE, "geometry.voxels.clear_layer=2e-5")
    assert "clear layer" not in findings(IMAGE, "geometry.voxels.clear_layer=3e-5")


def test_stretched_lattice():
    assert "stretched by" in findings(SLIT, "geometry.box=[0.97, 0.5]")


def test_memory_of_the_machine(monkeypatch):
    monkeypatch.setattr(module, "machine_memory", lambda: 1e6)
    assert "this machine has 1 MB" in findings(SLIT)


def test_inertia_in_a_stokes_case():
    assert "Reynolds number" in findings(SLIT, "drive.body_force=[1000, 0]")


def test_a_fluid_without_particles():
    report = check(read(DROP, "geometry.shapes=[]"))
    assert any("fluids.oil has no particle" in text for text in report.warnings)


# -- errors ----------------------------------------------------------------------------------------------


def errors(text: str, *overrides: str) -> str:
    report = check(read(text, *overrides))
    assert not report.can_run and "cannot run" in report.text()
    return "\n".join(report.errors)


WALL = "geometry.shapes=[{box: {lower: [0.4, -1], upper: [0.7, 2]}, is: solid}]"


def test_all_solid():
    assert "no fluid" in errors(SLIT, "geometry.shapes=[{box: {lower: [-1, -1], upper: [2, 2]}, is: solid}]")


def test_no_percolation_along_the_drive():
    assert "along x: its permeability is zero" in errors(SLIT, WALL)
    steady = ("flow=navier_stokes", "time={steady: 1e-4}")
    assert "along x" in errors(SLIT, WALL, *steady)
    assert "along y: both faces are walls" in errors(SLIT, "drive.body_force=[0, 1]")


def test_no_percolation_matters_less_in_time_or_beside_another_axis():
    assert "along x" in findings(SLIT, WALL, "flow=navier_stokes", "time={end: 1}")
    assert "along y" in findings(SLIT, "drive.body_force=[1, 2]")


def test_a_velocity_can_only_be_held_where_fluid_flows():
    """The estimate of the speed is that of the pores; a velocity across a slab is an error at any time."""
    held = ("drive={superficial_velocity: {x: 0.25}}", "flow=navier_stokes", "time={end: 1}")
    report = check(read(SLIT, *held))
    assert report.can_run and "held" in report.text() and report.flow.velocity == pytest.approx(0.25)
    two_a_cell = check(read(SLIT, *held, "particles.lattice=hexagonal"))
    assert two_a_cell.flow.velocity == pytest.approx(0.25, rel=0.1)  # rows that the walls cut
    assert "along x" in errors(SLIT, WALL, *held)


def test_no_percolation_of_an_image(folder):
    values = np.zeros((8, 8, 20), np.uint8)
    values[:, :, 9] = 1
    np.save("rock.npy", values)
    assert "along x: its permeability is zero" in errors(IMAGE)


def test_a_throat_that_only_the_lattice_closes(folder):
    values = np.zeros((8, 8, 20), np.uint8)
    values[:, :, 6:14] = 1
    values[4, 4, 6:14] = 0
    np.save("rock.npy", values)
    assert "throat of about" in findings(IMAGE, "particles.spacing=1e-5")
    assert "closed on this lattice" in findings(IMAGE, "particles.spacing=2e-5")


def test_nothing_moves():
    assert "nothing moves the fluid" in errors(SLIT, "drive=null")


def test_the_text_has_all_of_it():
    report = check(read(DROP))
    text = report.text()
    for term in report.terms:
        assert term.name in text
    for word in ("particles", "porosity", "throats", "Re ", "Ca ", "capillary", "memory", "time", "verdict"):
        assert word in text
    assert dataclasses.asdict(report)["dim"] == 2


def test_a_lattice_too_large_to_look_at_is_estimated_from_random_points(folder, monkeypatch):
    """10,000 points: the lattice is not looked at, memory and time are told all the same."""
    values = np.zeros((12, 12, 20), np.uint8)
    values[:, :6] = 1
    np.save("rock.npy", values)
    whole = check(read(IMAGE, "geometry.voxels.clear_layer=0", "geometry.periodic=[x]"))
    monkeypatch.setattr(module, "MOST_SITES", 1000)
    found = check(read(IMAGE, "geometry.voxels.clear_layer=0", "geometry.periodic=[x]"))
    assert found.can_run and found.throats is None and whole.throats is not None
    assert any("too many to look at each" in text for text in found.warnings)
    assert found.seconds is not None and "dummies not counted" in found.text()
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    assert "are free" in "".join(check(read(IMAGE, "geometry.periodic=[x]")).errors)


def test_what_surprises_in_the_inputs_is_warned_of(monkeypatch):
    geometry = build_geometry(read(SLIT))
    geometry.warnings = ("12 spheres lie outside the box",)
    assert "12 spheres lie outside the box" in check(read(SLIT), geometry).warnings
