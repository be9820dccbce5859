"""Python's door: what is imported, what is read, what runs return."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import isphcli
from isphcli.case.yaml import CaseError
from isphcli.output.files import read_pvd, read_vtu

SLIT = {
    "title": "slit",
    "geometry": {"box": [0.5, 1.0], "periodic": ["x"]},
    "particles": {"spacing": 0.125},
    "fluids": {"water": {"density": 1.0, "viscosity": 1.0}},
    "flow": "stokes",
    "drive": {"axes": ["x"]},
}


def test_importing_the_package_imports_nothing_heavy():
    code = ("import sys, isphcli\nisphcli.run, isphcli.permeability, isphcli.load_case, isphcli.RunResult\n"
            "print([name for name in ('numpy', 'numba', 'scipy', 'yaml', 'matplotlib') if name in sys.modules])")
    env = {**os.environ, "PYTHONPATH": str(Path(isphcli.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout.strip() == "[]", done.stderr


def test_one_blas_thread_while_it_runs_where_numpy_came_first():
    code = ("import numpy, isphcli\nfrom threadpoolctl import threadpool_info\n"
            "from isphcli.output.environment import one_blas_thread\n"
            "def threads(): return {p['num_threads'] for p in threadpool_info() if p['user_api'] == 'blas'}\n"
            "before = threads()\nwith one_blas_thread(): inside = threads()\nprint(before, inside, threads())")
    env = {**os.environ, "PYTHONPATH": str(Path(isphcli.__file__).parents[1]), "OPENBLAS_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    if "{2}" not in done.stdout:
        pytest.skip("a BLAS whose threads cannot be asked for, or one core")
    assert done.stdout.split() == ["{2}", "{1}", "{2}"], done.stderr


def test_a_case_of_dicts_is_read_as_one_of_a_file(tmp_path):
    numbers = {**SLIT, "geometry": {"box": np.array([0.5, 1.0]), "periodic": ("x",)},
               "particles": {"spacing": np.float64(0.125)}}
    (tmp_path / "slit.yaml").write_text(
        "title: slit\ngeometry: {box: [0.5, 1.0], periodic: [x]}\nparticles: {spacing: 0.125}\n"
        "fluids: {water: {density: 1.0, viscosity: 1.0}}\nflow: stokes\ndrive: {axes: [x]}\n"
        f"output: {{directory: {tmp_path}}}\n")
    of_dicts = isphcli.load_case({**numbers, "output": {"directory": tmp_path}})
    assert of_dicts == isphcli.load_case(tmp_path / "slit.yaml")
    assert isphcli.load_case(of_dicts) is of_dicts
    assert isphcli.load_case(SLIT, ["particles.spacing=0.25"]).particles.spacing == 0.25
    with pytest.raises(ValueError, match="overrides"):
        isphcli.load_case(of_dicts, ["particles.spacing=0.25"])


def test_problems_of_a_case_of_dicts_name_keys_and_no_lines():
    with pytest.raises(CaseError) as caught:
        isphcli.load_case({**SLIT, "particles": {"spacin": 0.1}})
    assert "case: particles.spacin: unknown key; did you mean 'spacing'?" in str(caught.value).splitlines()


@pytest.mark.slow
def test_a_run_returns_numbers_fields_and_pictures_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = isphcli.run(SLIT, quiet=True)
    assert found.complete and found.directory is None and list(tmp_path.iterdir()) == []
    # h^2 / 12 over the box; the quadrature of the walls is exact for a slit on the lattice (docs/method.md 8)
    assert found.permeability == pytest.approx(1 / 12, rel=0.02) and found.porosity == pytest.approx(1.0)
    y = found.x[:, 1]
    assert np.abs(found.velocity[:, 0] / (0.5 * y * (1 - y)) - 1).max() < 0.02
    grid = found.grid()
    assert grid.counts == (4, 8) and grid.arrays["velocity"].shape == (8, 4, 2)
    assert np.array_equal(np.sort(grid.arrays["velocity"][..., 0], axis=None), np.sort(found.velocity[:, 0]))
    assert found.grid(0.0625).counts == (8, 16)
    found.plot().save("slice.png")
    assert Path("slice.png").read_bytes() == found.plot()._repr_png_() and found.plot().png.startswith(b"\x89PNG")
    assert "permeability" in str(found) and "results" not in str(found)


def test_the_package_of_runs_can_be_called():
    """Also after modules of the package were imported that are called run."""
    import isphcli.runs.run

    assert isphcli.runs.run.solve_case is not None
    assert isphcli.run(SLIT, quiet=True).permeability > 0


@pytest.mark.slow
def test_a_run_with_a_folder_leaves_what_the_command_leaves(tmp_path):
    found = isphcli.run({**SLIT, "output": {"grid": "auto"}}, out=tmp_path / "out", quiet=True)
    assert found.directory == tmp_path / "out"
    names = {str(path.relative_to(found.directory)) for path in found.directory.rglob("*") if path.is_file()}
    assert {"summary.json", "case.yaml", "slice.png", "report.html", "grid.pvd", "snapshots/grid_000000.vti",
            "snapshots/particles_000000.vtu"} <= names
    _, fields = read_vtu(found.directory / "snapshots/particles_000000.vtu")
    assert np.array_equal(fields["velocity"][:, :2], found.velocity)
    with pytest.raises(ValueError, match="holds results"):
        isphcli.run(SLIT, out=tmp_path / "out", quiet=True)
    again = isphcli.run(SLIT, out=tmp_path / "out", quiet=True, overwrite=True)
    assert again.permeability == found.permeability and not (tmp_path / "out/grid.pvd").exists()


@pytest.mark.slow
def test_moving_particles_go_on_from_a_restart(tmp_path):
    case = {**SLIT, "flow": "navier_stokes", "drive": {"body_force": [1.0, 0.0]}, "time": {"end": 1.0, "max_steps": 2},
            "output": {"grid": "auto"}}
    first = isphcli.run(case, out=tmp_path / "out", quiet=True)
    assert not first.complete and any("max_steps" in text for text in first.warnings)
    longer = isphcli.run(case, overrides=["time.max_steps=4"], out=tmp_path / "out", restart=tmp_path / "out",
                         quiet=True)
    assert len(longer.history) == 4 and longer.summary["steps"] == 4
    # grids of the same times as the particles, also after the restart
    grids, particles = (read_pvd(tmp_path / "out" / f"{name}.pvd") for name in ("grid", "particles"))
    assert [(t, f.replace("grid", "particles").replace("vti", "vtu")) for t, f in grids] == particles
    assert len(grids) == 3 and all((tmp_path / "out" / file).is_file() for _, file in grids)
    # what was drawn of the shorter run does not stay beside the numbers of a longer one
    assert (tmp_path / "out/report.html").exists()
    isphcli.run(case, overrides=["time.max_steps=5", "output.plots=false"], out=tmp_path / "out",
                restart=tmp_path / "out", quiet=True)
    assert not list((tmp_path / "out").glob("*.png")) and not (tmp_path / "out/report.html").exists()


def slit_image(axis):
    image = np.zeros((4, 8, 6), np.uint8)  # z, y, x
    image[:, :2] = 1
    return np.moveaxis(image, 2, axis)


def test_permeability_of_an_image():
    """Of a slit of six voxels h^3 / 12 over the height of the image: walls lie on faces of voxels."""
    options = {"geometry": {"wall_distance": "stairs", "periodic": ["x", "y", "z"]}}
    exact = (6e-6) ** 3 / 12 / 8e-6
    found = isphcli.permeability(slit_image(2), voxel_size="1 um", refine=5e-7, options=options, quiet=True)
    assert found.permeability == pytest.approx(exact, rel=0.01) and found.porosity == pytest.approx(0.75)
    # limits of spacings, with the orders of edges: the bar holds what the formula says
    assert abs(found.permeability - exact) <= max(found.permeability_error, 1e-3 * exact)
    low, high = found.permeability_range
    assert low <= found.permeability <= high
    grid = found.grid()
    assert np.array_equal(grid.arrays["solid"], slit_image(2)) and not grid.arrays["velocity"][:, :2].any()
    other = isphcli.permeability(slit_image(2).T == 0, solid=False, voxel_size=1e-6, order="xyz", options=options,
                                 quiet=True)
    assert other.permeability == pytest.approx(found.summary["permeability_by_spacing"]["x"]["1e-06"], rel=1e-6)


@pytest.mark.parametrize("image, options, words", [
    (np.zeros((4, 4, 4), bool), {}, "solid=True or solid=False"),
    (np.zeros((4, 4, 4)), {}, "has no labels"),
    (np.full((4, 4, 4), 255), {}, "say which with solid"),
    (np.ones((4, 4, 4), int), {}, "every voxel is solid"),
    (slit_image(2), {"voxel_size": -1.0}, "voxel_size"),
    (slit_image(2), {"axis": "w"}, "drive.axes"),
])
def test_images_that_cannot_be_used(image, options, words):
    with pytest.raises(ValueError, match=words):
        isphcli.permeability(image, **{"voxel_size": 1e-6, **options}, quiet=True)
