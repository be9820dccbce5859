"""A run from its case to its files."""

import gc
import json
import subprocess
import sys
from threading import Thread

import numpy as np
import pytest
from numba.core import event

from isphcli.case.load import load_case
from isphcli.case.yaml import CaseError
from isphcli.output.clock import Clock
from isphcli.output.files import read_history, read_pvd, read_vtu
from isphcli.preflight.look import look
from isphcli.runs import steady
from isphcli.runs.run import _compile_listener, run_case
from isphcli.runs.time_loop import TimeLoop

DISK = """
title: a disk
geometry: {box: [1, 1], periodic: [x, y], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.25}, is: solid}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1000, viscosity: 0.01}}
"""
VORTEX = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 0.1}}
initial: {velocity: ["sin(2*pi*x)*cos(2*pi*y)", "-cos(2*pi*x)*sin(2*pi*y)"]}
time: {end: 0.02}
output: {every: 0.01, fields: [velocity, pressure, phase, divergence]}
"""


def write(tmp_path, text):
    path = tmp_path / "case.yaml"
    path.write_text(text)
    return path


def run(tmp_path, text, *sets):
    return run_case(load_case(write(tmp_path, text), [f"output.directory={tmp_path / 'out'}", *sets]), quiet=True,
                    overwrite=True, look=look)


@pytest.mark.slow
def test_a_steady_run_leaves_its_files(tmp_path):
    summary = run(tmp_path, DISK + "flow: stokes\ndrive: {axes: [x, y]}\n"
                  "output: {dummies: true, fields: [velocity, pressure, phase, distance]}\n")
    out = tmp_path / "out"
    written = json.loads((out / "summary.json").read_text())
    tensor = np.array(written["permeability_tensor"])
    assert tensor[0, 0] == pytest.approx(tensor[1, 1], rel=1e-5)  # the scene looks the same along x and y
    assert abs(tensor[0, 1]) < 1e-5 * tensor[0, 0]
    assert written["permeability"]["x"] == pytest.approx(tensor[0, 0])
    assert {"walls", "body force", "viscosity", "pressure", "periodic halo"} <= set(written["terms"])
    assert written["porosity"] == pytest.approx(1 - np.pi / 16, abs=0.03)
    assert written["particles"]["fluid"] + written["particles"]["dummy"] + written["particles"]["left_out"] == 256
    x, fields = read_vtu(out / read_pvd(out / "particles.pvd")[0][1])
    assert len(x) == written["particles"]["fluid"] + written["particles"]["dummy"]
    assert np.all(fields["distance"][fields["kind"] == 0] > 0) and np.all(fields["phase"][fields["kind"] == 1] == -1)
    assert len(read_history(out / "history.csv")) == 2 and (out / "slice.png").stat().st_size > 1000
    again = load_case(out / "case.yaml")  # the effective case runs again
    assert again.particles.support == 2.1
    assert summary["directory"] == str(out)


@pytest.mark.slow
def test_a_moving_run_leaves_its_files(tmp_path):
    summary = run(tmp_path, VORTEX)
    out = tmp_path / "out"
    rows = read_history(out / "history.csv")
    assert [r["step"] for r in rows] == list(range(1, summary["steps"] + 1))
    assert rows[-1]["time"] == pytest.approx(0.02) and rows[-1]["limit"] == "end"
    energy = [r["kinetic_energy"] for r in rows]
    assert bool(np.all(np.diff(energy) < 0))  # viscosity only takes
    times = [t for t, _ in read_pvd(out / "particles.pvd")]
    assert times == pytest.approx([0.0, 0.01, 0.02])
    assert "walls" not in summary["terms"] and "shifting" in summary["terms"]
    assert sum(v for k, v in summary["cpu_seconds"].items() if k != "total") == pytest.approx(
        summary["cpu_seconds"]["total"], rel=0.05)


@pytest.mark.slow
def test_fluid_without_walls_has_no_permeability(tmp_path):
    summary = run(tmp_path, VORTEX + "drive: {body_force: [1, 0]}\n")
    assert summary["permeability"] is None and "no wall resists" in summary["message"]


@pytest.mark.slow
def test_refine_gives_an_extrapolation(tmp_path):
    """The error bar covers what two more levels find (Sangani and Acrivos' fraction is another one: no value here). The
    mass error is that of the finest level, whose fields are written."""
    fine = run(tmp_path, DISK + "flow: stokes\ndrive: {axes: [x]}\n", "particles.spacing=0.015625")
    coarse = run(tmp_path, DISK + "flow: stokes\ndrive: {axes: [x]}\n", "refine=[0.04166666,0.03125]")
    assert coarse["permeability"] == pytest.approx(fine["permeability"], rel=0.02)
    assert coarse["permeability_error"] is None or coarse["permeability_error"] > 0
    assert len(coarse["permeability_by_spacing"]["x"]) == 3
    finest = run(tmp_path, DISK + "flow: stokes\ndrive: {axes: [x]}\n", "particles.spacing=0.03125")
    assert coarse["mass_error"] == pytest.approx(finest["mass_error"], rel=1e-3)


@pytest.mark.slow
def test_a_periodic_scene_imports_nothing_of_walls(tmp_path):
    """In a process of its own: neither the wall modules nor those of steady flow through solids are loaded."""
    path = write(tmp_path, VORTEX)
    code = (
        "import sys; from isphcli.case.load import load_case; from isphcli.runs.run import run_case;"
        f"run_case(load_case({str(path)!r}, ['output.directory={tmp_path / 'o'}']), quiet=True);"
        "rooms = ('two_phase', 'geometry.images', 'geometry.voxel', 'operators.wall', 'operators.narrow',"
        " 'operators.lattice', 'run.steady');"
        "bad = [m for m in sys.modules if m.startswith(tuple('isphcli.' + room for room in rooms))];"
        "assert not bad, bad"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_interrupt_leaves_a_restart_file(tmp_path, monkeypatch):
    real = TimeLoop._row

    def stop(self, found, limit):
        if found.state.step == 3:
            raise KeyboardInterrupt
        return real(self, found, limit)

    monkeypatch.setattr(TimeLoop, "_row", stop)
    with pytest.raises(KeyboardInterrupt) as caught:
        run(tmp_path, VORTEX)
    with np.load(caught.value.restart) as file:  # of the third step the history has no row: it is taken again
        assert int(file["state0.step"]) == 2 and np.isfinite(file["state0.u"]).all()


TWO = DISK.replace("fluids: {", "fluids: {oil: {density: 1, viscosity: 1}, ")
TWO = TWO.replace("[x, y], shapes", "[x, y], fluid: water, shapes")


def test_a_steady_solve_has_one_fluid(tmp_path):
    with pytest.raises(CaseError, match="a steady solve has one fluid, and water is another than oil"):
        run(tmp_path, TWO + "flow: stokes\ndrive: {axes: [x]}\n")
    assert not (tmp_path / "out").exists()


def test_an_absent_fluid_is_said_and_costs_nothing(tmp_path):
    """The run is that of the other fluid alone, bit for bit, with the same support."""
    moving, same = "drive: {body_force: [1, 0]}\ntime: {end: 1.0e-3}\n", ("output.plots=false", "particles.support=2.5")
    one = run(tmp_path, DISK + moving, *same)
    two = run(tmp_path, TWO + moving + "interface: {tension: 1}\n", *same)
    assert one["message"] is None and "no particle is of the fluid oil" in two["message"]
    assert "two_fluids" not in two and np.array_equal(one["mean_velocity"], two["mean_velocity"])


ROCK = """
geometry: {voxels: {file: rock.npy, labels: {solid: 1, water: 0}, voxel_size: 1.0e-6}}
particles: {spacing: 1.0e-6}
fluids: {water: {density: 1000, viscosity: 1.0e-3}}
flow: stokes
output: {plots: false}
"""


def duct(tmp_path):
    """An image with one duct of 4 x 4 voxels along z, which leads through no other face."""
    image = np.ones((8, 8, 8), np.uint8)
    image[:, 2:6, 2:6] = 0
    np.save(tmp_path / "rock.npy", image)


def test_axes_without_a_path_have_a_permeability_of_zero_and_leave_the_others(tmp_path, capfd):
    duct(tmp_path)
    alone = run(tmp_path, ROCK, "drive={axes: [z]}")["permeability"]
    found = run(tmp_path, ROCK, "drive={axes: [x, y, z]}")
    assert found["permeability"] == {"x": 0.0, "y": 0.0, "z": alone} and alone > 0.0
    assert found["open_axes"] == ["z"] and found["permeability_tensor"] is None
    for axis in "xy":
        assert any(f"no fluid path leads through the scene along {axis}" in text for text in found["warnings"])
    with pytest.raises(ValueError, match=r"along x and y: the permeability is zero; check geometry\.voxels\.labels"):
        run(tmp_path, ROCK, "drive={axes: [x, y]}")
    assert not capfd.readouterr().err  # quiet


@pytest.mark.slow
def test_a_run_in_three_dimensions_leaves_its_pictures_and_a_report_with_them(tmp_path, monkeypatch):
    """And where they cannot be drawn in 3D a warning, and those of a plane."""
    pytest.importorskip("pyvista")
    duct(tmp_path)
    summary = run(tmp_path, ROCK, "drive={axes: [z]}", "output.plots=true")
    physical = {"flow_3d.png", "wall_shear_3d.png", "slice.png", "profiles.png", "distributions.png"}
    assert {path.name for path in (tmp_path / "out").glob("*.png")} == {*physical, "numerics.png"}
    assert not any("3D" in text for text in summary["warnings"])
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    order = [page.index(text) for text in ("Sizes of the pores", "<h2>Numerics", "Solver,")]
    assert page.count("<img") == 6 and order == sorted(order)
    rows = read_history(tmp_path / "out/profiles.csv")
    assert rows[-1]["pressure"] < rows[0]["pressure"]
    flux = [row["superficial_velocity"] for row in rows]
    assert np.std(flux) / np.mean(flux) == pytest.approx(summary["mass_error"], rel=1e-6)
    from isphcli.output import render

    def fails(*words, **more):
        raise render.RenderError("no screen")

    monkeypatch.setattr(render, "_answer", fails)
    summary = run(tmp_path, ROCK, "drive={axes: [z]}", "output.plots=true")
    assert any("no pictures in 3D: no screen" in text for text in summary["warnings"])
    assert {path.name for path in (tmp_path / "out").glob("*.png")} == {
        *physical - {"flow_3d.png", "wall_shear_3d.png"}, "numerics.png"}


def test_an_image_without_clear_layers_is_not_told_to_check_its_labels(tmp_path):
    duct(tmp_path)
    with pytest.raises(ValueError, match=r"along z: both faces are walls; geometry\.voxels\.clear_layer is") as caught:
        run(tmp_path, ROCK, "drive={axes: [z]}", "geometry.voxels.clear_layer=0")
    assert "labels" not in str(caught.value)


def test_only_periodic_scenes_have_a_tensor(tmp_path):
    np.save(tmp_path / "rock.npy", np.pad(np.ones((2, 2), np.uint8), ((1, 1), (1, 1))))
    sealed = run(tmp_path, ROCK, "drive={axes: [x, y]}")
    assert sealed["permeability_tensor"] is None and set(sealed["permeability"]) == {"x", "y"}
    around = run(tmp_path, ROCK, "drive={axes: [x, y]}", "geometry.periodic=[x, y]")
    assert np.shape(around["permeability_tensor"]) == (2, 2)


@pytest.mark.slow
def test_an_image_with_a_pressure_drop_is_read_once(tmp_path, monkeypatch):
    from isphcli.scene import image_file

    duct(tmp_path)
    read, real = [], image_file.read_image
    monkeypatch.setattr(image_file, "read_image", lambda *words, **more: read.append(words) or real(*words, **more))
    by_drop = run(tmp_path, ROCK, "drive={pressure_drop: {z: 2.0}}", "refine=[0.5e-6]")
    assert len(read) == 1
    # the drop is over the sample and its clear layers, 16 voxels: k is that of any other drive
    by_force = run(tmp_path, ROCK, "drive={body_force: [0, 0, 125]}", "refine=[0.5e-6]")
    assert by_drop["permeability"] == pytest.approx(by_force["permeability"], rel=1e-4)  # tolerance of the solver
    assert by_drop["superficial_velocity"][2] == pytest.approx(by_force["superficial_velocity"][2], rel=1e-4)


def test_warnings_come_before_the_solve_and_stay_in_the_summary(tmp_path, monkeypatch, capfd):

    duct(tmp_path)
    coarse = ["particles.spacing=2.0e-6", "drive={axes: [z]}", "geometry.wall_distance=stairs"]  # two particles across
    warned = run(tmp_path, ROCK, *coarse)["warnings"]
    assert any(text.startswith("the median throat is") for text in warned)
    assert json.loads((tmp_path / "out/summary.json").read_text())["warnings"] == warned
    assert not capfd.readouterr().err

    def told(*_):
        err = capfd.readouterr().err
        assert all(f"warning: {text}" in err for text in warned)
        raise KeyboardInterrupt

    monkeypatch.setattr(steady, "build_scene", told)
    with pytest.raises(KeyboardInterrupt):
        run_case(load_case(write(tmp_path, ROCK), [f"output.directory={tmp_path / 'o'}", *coarse]), look=look)


@pytest.mark.parametrize("flow", ["flow: stokes\ndrive: {axes: [x]}\n",
                                  "drive: {body_force: [1, 0]}\ntime: {end: 1, max_steps: 1}\n"])
def test_who_stops_the_pictures_has_the_numbers(tmp_path, monkeypatch, flow):
    """Ctrl-C and SIGTERM while they are drawn."""
    from isphcli.output import plots

    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(plots, "plot_slice", stopped)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, DISK + flow)
    written = json.loads((tmp_path / "out/summary.json").read_text())
    assert max(map(abs, written["superficial_velocity"])) > 0 and (tmp_path / "out/case.yaml").exists()


@pytest.mark.parametrize("time, status, key", [("{end: 1, max_steps: 2}", "out of steps", "time.max_steps"),
                                               ("{steady: 1e-9, max_steps: 2}", "not steady", "time.max_steps"),
                                               ("{steady: 1e-9, end: 1e-6}", "not steady", "time.end")])
def test_a_run_that_stops_short_says_what_came_first(tmp_path, time, status, key):
    found = run(tmp_path, DISK + f"drive: {{body_force: [1, 0]}}\ntime: {time}\n", "output.plots=false")
    assert status in found["message"] and f"--set {key}=" in found["message"] and found["permeability"] is None


def test_the_collector_rests_while_the_compiler_works():
    """A compiler that is interrupted has no end: the collector is at work again after the run."""
    with _compile_listener(Clock(), lambda: None):
        with event.trigger_event("numba:compile"):
            assert not gc.isenabled()
        assert gc.isenabled()
        event.start_event("numba:compile")
    assert gc.isenabled()


def test_only_the_compiler_of_the_thread_that_runs_is_counted():
    """Threads that share the first loop of a kernel wait for numba's lock at the same time: their sections of the clock
    would end in each other's."""
    def elsewhere(happens):
        thread = Thread(target=happens, args=("numba:compiler_lock",))
        thread.start()
        thread.join()

    clock = Clock()
    with _compile_listener(clock, lambda: None):
        elsewhere(event.start_event)
        with clock("step"):
            elsewhere(event.end_event)
        assert set(clock.wall()) == {"step", "other", "total"}
        with event.trigger_event("numba:compiler_lock"):
            pass
        assert "compile" in clock.wall()
