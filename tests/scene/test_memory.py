"""Scenes that do not fit are refused before they are allocated."""

import numpy as np
import pytest
from click.testing import CliRunner

from isphcli.case.load import read_case
from isphcli.cli import main
from isphcli.domain.lattice import ParticleError
from isphcli.geometry import iso_surface
from isphcli.geometry.images import read
from isphcli.geometry.images.image import machine_memory
from isphcli.output.clock import Clock
from isphcli.preflight.check import check
from isphcli.runs import steady
from isphcli.runs.run import run_case
from isphcli.runs.steady import build_scene
from isphcli.scene import memory, place
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

DISK = b"""
geometry: {box: [1, 1, 1], periodic: [x, y, z], shapes: [{sphere: {centre: [0.5, 0.5, 0.5], radius: 0.3}, is: solid}]}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
"""
MOVING = b"""
geometry: {box: [1, 1], periodic: [x], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.3}, is: oil}]}
particles: {spacing: 0.05}
fluids: {water: {density: 1, viscosity: 1}, oil: {density: 1, viscosity: 2}}
time: {end: 1}
"""


LONG = """
geometry:
  voxels: {{file: {folder}/image.npy, labels: {{solid: 1, water: 0}}, voxel_size: 1.0e-6, clear_layer: {layer}}}
particles: {{spacing: 1.0e-6}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
"""


def test_a_clear_layer_of_a_million_kilometres_is_refused(tmp_path):
    np.save(tmp_path / "image.npy", np.pad(np.zeros((2, 2, 2), np.uint8), 1, constant_values=1))
    with pytest.raises(ParticleError, match=r"clear layers of \d+ voxels need about .* GB"):
        build_geometry(read_case(LONG.format(folder=tmp_path, layer="1e9").encode(), "case.yaml"))


def test_particles_that_do_not_fit_for_the_clear_layers_are_no_matter_of_the_spacing(tmp_path, monkeypatch):
    """Layers of ten centimetres on an image of four micrometres: their distances to walls fit, not their particles."""
    np.save(tmp_path / "image.npy", np.pad(np.zeros((2, 2, 2), np.uint8), 1, constant_values=1))
    monkeypatch.setattr(memory, "available", lambda: 1e9)
    with pytest.raises(ParticleError, match=r"in the clear layers of 100000 voxels: take a smaller geometry"):
        build_geometry(read_case(LONG.format(folder=tmp_path, layer="0.1").encode(), "case.yaml"))


def test_a_scene_is_refused_where_the_machine_is_full(monkeypatch):
    case = read_case(DISK, "case.yaml")
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    with pytest.raises(ParticleError, match=r"fluid particles need about .* GB of memory, 0.001 GB are free"):
        build_scene(case, build_geometry(case), 0.125, Clock())
    monkeypatch.setattr(memory, "available", lambda: 1e12)
    assert build_scene(case, build_geometry(case), 0.125, Clock()).particles.n_fluid > 100


def test_a_steady_flow_that_fits_with_fewer_krylov_vectors_is_told_so(monkeypatch):
    """And how many: with these it fits, with one more it does not. The free memory does not choose them by itself."""
    case = read_case(DISK, "case.yaml")
    need = memory.estimate(case, 3, True, 1e6, 0)
    monkeypatch.setattr(memory, "available", lambda: sum(need.values()) - 0.3 * need["Krylov vectors"])
    with pytest.raises(ParticleError, match=r"take solver.restart 28 \(fewer Krylov vectors, .*\), or a larger"):
        memory.refuse_flow(case, need, "they")
    for restart in (28, 29):
        fewer = memory.estimate(read_case(DISK, "case.yaml", [f"solver.restart={restart}"]), 3, True, 1e6, 0)
        assert (sum(fewer.values()) <= memory.available()) == (restart == 28)
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    with pytest.raises(ParticleError, match=r"GB are free; take a larger particles\.spacing"):
        memory.refuse_flow(case, need, "they")


def test_a_process_without_particles_is_refused_where_the_others_fill_the_machine(monkeypatch):
    """And only there: it holds no Krylov vectors of which it could do with fewer."""
    case = read_case(DISK, "case.yaml")
    need = memory.estimate(case, 3, True, 0, 0)
    monkeypatch.setattr(memory, "available", lambda: 1.1 * sum(need.values()))
    memory.refuse_flow(case, need, "they")
    monkeypatch.setattr(memory, "available", lambda: 0.9 * sum(need.values()))
    with pytest.raises(ParticleError, match=r"GB are free; take a larger particles\.spacing"):
        memory.refuse_flow(case, need, "they")


def test_the_estimate_grows_with_the_scene():
    case = read_case(DISK, "case.yaml")
    small, large = (sum(memory.estimate(case, 3, True, n, 0).values()) - memory.BYTES_PROGRAM for n in (1e5, 1e6))
    assert large == pytest.approx(10 * small)
    assert 1600e6 < large < 2200e6  # measured: 1.7 kB a particle with 18 iterations; 240 bytes more with 40 of them


PLATE = b"""
geometry: {box: [1, 1, 1], periodic: [x, y, z], shapes: [{box: {lower: [-1, -1, 0.5], upper: [2, 2, 0.55]}, is: solid}]}
particles: {spacing: 0.1, support: 2}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
"""


@pytest.mark.parametrize("flow", ["stokes", "navier_stokes"])
def test_what_is_held_of_the_neighbours_beside_a_plate(flow):
    """A ball of radius 0.2 whose middle lies 0.1 before a plate 0.05 thick, of which steady flow counts what lies in
    the plate, and moving particles the fluid behind it too. The tolerance is three standard errors of the sample."""
    case = read_case(PLATE, "case.yaml", (f"flow={flow}", *(("time={end: 1}",) if flow == "navier_stokes" else ())))
    x, geometry = np.full((500, 3), [0.5, 0.5, 0.4]), build_geometry(case)
    near, far = ((1.0 - h / 0.2) ** 2 * (2.0 + h / 0.2) / 4.0 for h in (0.1, 0.15))  # caps, of the ball
    part = 1.0 - (near - far if flow == "stokes" else near)
    found = memory.neighbours_held(case, geometry, x, 0.1)
    assert found == pytest.approx(part, abs=3 * (0.25 / memory.SAMPLE) ** 0.5)
    assert memory.neighbours_held(case, geometry, x, 0.045) == 1.0


def test_moving_particles_of_a_pack_need_what_was_measured():
    """4.8 kB above the process of each of 79,468 particles of which 25 of 64 neighbours are in sight
    (benchmarks/moving_memory.py "pack 40", 2026-12-01), within a factor of 1.3."""
    case = read_case(DISK, "case.yaml", ("flow=navier_stokes", "time={end: 1}", "particles.lattice=bcc"))
    need = sum(memory.estimate(case, 3, True, 1e6, 1e6, share=0.39).values()) - memory.BYTES_PROGRAM
    assert 1.0 / 1.3 < need / 4756e6 < 1.3


@pytest.mark.parametrize("sets, who", [((), "400 fluid particles of two fluids"),
                                       (("geometry.shapes=[]",), "400 fluid particles need")])
def test_moving_particles_are_refused_where_the_machine_is_full(monkeypatch, sets, who):
    case = read_case(MOVING, "case.yaml", sets)
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    with pytest.raises(ParticleError, match=f"{who}.* about .* GB of memory, 0.001 GB are free; take a larger"):
        prepare(case, build_geometry(case), Clock())
    monkeypatch.setattr(memory, "available", lambda: 1e12)
    assert prepare(case, build_geometry(case), Clock())[2].n_fluid == 400


def test_a_second_fluid_costs_memory():
    """Measured on 2026-12-01: 2.4 and 7.6 kB per particle of a periodic cube, 4.4 and 11.4 kB beside walls."""
    case = read_case(DISK, "case.yaml", ("flow=navier_stokes", "time={end: 1}"))
    for walls, one, two in ((False, 2445, 7605), (True, 4420, 11392)):
        found = [(sum(memory.estimate(case, 3, walls, 1e6, 0, two=k).values()) - memory.BYTES_PROGRAM) / 1e6
                 for k in (False, True)]
        assert one < found[0] < 1.3 * one and two / 1.3 < found[1] < 1.3 * two


@pytest.mark.parametrize("flow", ["stokes", "navier_stokes"])
def test_a_lattice_too_large_is_refused_before_it_is_placed(tmp_path, monkeypatch, flow):
    """Exit code 2 and numbers: 6e8 sites of which seven tenths are fluid."""
    monkeypatch.setattr(memory, "available", lambda: 2e10)
    monkeypatch.setattr(place, "place", lambda *_: pytest.fail("placed"))
    text = MOVING.decode().replace("is: oil", "is: solid")
    if flow == "stokes":
        text = text.replace("time: {end: 1}", "flow: stokes")
    (tmp_path / "case.yaml").write_text(text)
    done = CliRunner().invoke(main, ["run", str(tmp_path / "case.yaml"), "--quiet", "--set", "particles.spacing=4e-5",
                                     "--set", "drive.body_force=[1, 0]", "--out", str(tmp_path / "out")])
    assert done.exit_code == 2 and not (tmp_path / "out").exists()
    assert "about 4.47e+08 fluid particles need about" in done.stderr and "20 GB are free" in done.stderr
    done = CliRunner().invoke(main, ["validate", "--check-only", str(tmp_path / "case.yaml"), "--set",
                                     "particles.spacing=3.5e-5"])
    assert done.exit_code == 2 and "lattice sites are too many to look at each" in done.output
    assert "of memory, 20 GB are free; take a larger" in done.output


def test_an_image_too_large_for_its_wall_distances_is_refused(tmp_path, monkeypatch):
    np.save(tmp_path / "image.npy", np.zeros((20, 20, 20), np.uint8))
    text = DISK.decode().splitlines()
    voxels = f"{{file: {tmp_path}/image.npy, labels: {{water: 0}}, voxel_size: 1}}"
    text[1] = f"geometry: {{voxels: {voxels}, periodic: [x]}}"
    case = read_case("\n".join(text).encode(), "case.yaml")
    monkeypatch.setattr(memory, "available", lambda: 1e5)
    with pytest.raises(ParticleError, match=r"the wall distances of 8,000 voxels need about 0.00032 GB"):
        build_geometry(case)


ROCK = """
geometry: {{voxels: {{file: {file}, labels: {{water: 0, solid: 1}}, voxel_size: 1.0e-6}}}}
particles: {{spacing: {spacing}}}
fluids: {{water: {{density: 1000, viscosity: 1.0e-3}}}}
flow: stokes
drive: {{axes: [x]}}
"""


def rock(tmp_path, spacing):
    """A case of an image of 20 voxels a side, half of it pores."""
    image = np.zeros((20, 20, 20), np.uint8)
    image[:, ::2] = 1
    np.save(tmp_path / "rock.npy", image)
    return read_case(ROCK.format(file=tmp_path / "rock.npy", spacing=spacing).encode(), "case.yaml")


def test_an_image_that_does_not_fit_is_refused_by_its_header(tmp_path, monkeypatch):
    case = rock(tmp_path, 1e-6)
    monkeypatch.setattr(read, "read_image", lambda *_: pytest.fail("read"))
    monkeypatch.setattr(memory, "available", lambda: 1e5)
    with pytest.raises(ParticleError, match=r"the wall distances of 8,000 voxels .* geometry.voxels.crop"):
        build_geometry(case)


def test_pores_that_do_not_fit_are_refused_before_wall_distances(tmp_path, monkeypatch):
    """Of 20 + 2 layers of 400 voxels, half of the sample and the clear layers are fluid: 4,800 voxels of 1,000
    particles. (Its slits lead straight on: a voxel of clear layer is enough.) The check says the same number, and that
    the case cannot run."""
    case = rock(tmp_path, 1e-7)
    monkeypatch.setattr(iso_surface, "most_probable_field", lambda *_: pytest.fail("walls"))
    monkeypatch.setattr(memory, "available", lambda: 5e9)
    with pytest.raises(ParticleError, match=r"about 4.8e\+06 fluid particles need about .* GB"):
        build_geometry(case)
    found = check(case)
    assert not found.can_run and "4.8e+06 fluid particles" in found.text()


def test_a_finer_spacing_that_does_not_fit_is_refused_before_the_first_is_solved(tmp_path, monkeypatch):
    case = read_case(DISK, "case.yaml", ("refine=[0.002]", "drive={axes: [x]}", f"output.directory={tmp_path}/out"))
    monkeypatch.setattr(memory, "available", lambda: 2e10)
    monkeypatch.setattr(steady, "solve_axis", lambda *_: pytest.fail("solved"))
    with pytest.raises(ParticleError, match=r"larger particles\.spacing and refine"):
        run_case(case, quiet=True)


def test_what_is_free_is_a_part_of_what_there_is():
    assert 1e6 < memory.available() < machine_memory()
