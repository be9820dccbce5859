"""Steady flow on several processes: the same operators, permeability and measures however many there are.

They run where mpi4py, petsc4py and mpiexec are; .ci/mpi makes such an environment and sets ISPH_REQUIRE_MPI, with which
a missing one fails here instead of being skipped.
"""

import csv
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from isphcli.output.snapshots import read_snapshot
from tests.paths import CASES, ROOT
from tests.ranks import FILES, MIXED, TEXTS

HAVE = shutil.which("mpiexec") and all(importlib.util.find_spec(name) for name in ("mpi4py", "petsc4py"))
pytestmark = [pytest.mark.slow, pytest.mark.skipif(
    not HAVE and "ISPH_REQUIRE_MPI" not in os.environ, reason="mpiexec, mpi4py or petsc4py is not here: .ci/mpi")]
ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if not name.startswith(("PMI_", "OMPI_COMM", "SLURM_"))},
    "PYTHONPATH": str(ROOT), "NUMBA_NUM_THREADS": "1",
    # Open MPI, where there are fewer cores than processes, and in a container
    "OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1",
    "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
}
OF_ONE = os.environ.get("ISPH_OF_ONE")  # folder with what all scenes leave on one process, where .ci/mpi has run them
NAMES = [*TEXTS, *FILES]
APPLIED = [*TEXTS, "berea", "throats"]


def start(*arguments, ranks=1, **environment):
    """A Python program on so many processes."""
    launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
    return subprocess.run([*launcher, sys.executable, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True,
                          env={**ENVIRONMENT, **environment}, timeout=900)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """found(ranks, engine): the folder that `tests.ranks` filled, once."""
    known = {}

    def of(ranks, engine="auto"):
        if (ranks, engine) == (1, "auto") and OF_ONE is not None:
            return Path(OF_ONE) / "steady"
        if (ranks, engine) not in known:
            folder = tmp_path_factory.mktemp(f"{engine}{ranks}")
            done = start("-m", "tests.ranks", folder, engine, ranks=ranks)
            assert done.returncode == 0, done.stdout + done.stderr
            known[ranks, engine] = folder
        return known[ranks, engine]

    return of


def summary(folder, name):
    return json.loads((folder / f"{name}.json").read_text())


def in_order(folder, name):
    """Arrays in the order of the positions."""
    with np.load(folder / f"{name}.npz") as file:
        arrays = dict(file)
    order = np.lexsort(np.round(arrays["x"] / np.ptp(arrays["x"], axis=0).max() * 1e6).T)
    return {key: value[order] for key, value in arrays.items()}


@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.parametrize("name", APPLIED)
def test_the_operator_is_that_of_one_process(found, name, ranks):
    """Round-off of sums in another order: 2e-15 of the largest entry seen, 5e-14 where two spacings meet, whose weights
    of third order are the solutions of small systems. Places are the same."""
    one, several = in_order(found(1), name), in_order(found(ranks), name)
    assert one["x"].shape == several["x"].shape
    for key in one:
        assert np.abs(one[key] - several[key]).max() <= (0.0 if key == "x" else 1e-13 * np.abs(one[key]).max())


@pytest.mark.parametrize("engine, ranks", [("petsc", 1), ("auto", 2), ("auto", 3)])
@pytest.mark.parametrize("name", NAMES)
def test_the_flow_is_that_of_one_process(found, name, engine, ranks):
    """At the tolerance of 1e-6; what is counted is counted exactly."""
    one, several = summary(found(1), name), summary(found(ranks, engine), name)
    k, other = (np.array([*v.values()] if isinstance(v, dict) else v) for v in (
        one["permeability"], several["permeability"]))
    assert other == pytest.approx(k, rel=1e-5)
    for key in ("components", "isolated_pockets", "open_axes", "image", "inputs"):
        assert several[key] == one[key]
    for key in ("fluid", "dummy", "left_out"):
        assert several["particles"][key] == one["particles"][key]
    # places in a part of an image are rounded otherwise, and zeros of a smooth wall are found to 1e-7 of the way
    # (`iso_crossings.CLOSE_T`): 1.2e-11 of Berea 32^3
    assert several["porosity"] == pytest.approx(
        one["porosity"], rel=1e-10 if name in ("smooth", "grey", "scan") else 1e-12)
    for key in ("permeability_by_threshold", "tortuosity", "formation_factor", "speed", "wall_shear", "errors",
                "permeability_range"):
        measured, wanted = flat(several.get(key)), flat(one.get(key))
        assert measured.keys() == wanted.keys()
        # slow fluid has few digits: errors of a velocity are of the tolerance of the fastest
        most = max(map(abs, wanted.values()), default=0.0)
        # an error is a ratio less one: it has the digits of the ratio
        assert measured == pytest.approx(wanted, rel=1e-4, abs=1e-5 if key == "errors" else 1e-4 * most)
    if ranks > 1:
        low, high = several["ranks"]["fluid"]
        assert several["ranks"]["count"] == ranks and low <= one["particles"]["fluid"] / ranks <= high


@pytest.mark.parametrize("engine, ranks", [("petsc", 1), ("auto", 2), ("auto", 3)])
@pytest.mark.parametrize("name", sorted(MIXED))
def test_two_spacings_are_those_of_one_process(found, name, engine, ranks):
    """The same cells lose most, and k of both solves is the same at their tolerance, 1e-8: by 5e-8 at most."""
    one, several = summary(found(1), name), summary(found(ranks, engine), name)
    assert re.search(r"half the spacing where 90% of the energy is lost \([\d,]+ particles", one["message"])
    assert several["message"] == one["message"]  # it has the particles of the second solve
    assert flat(several["permeability_by_spacing"]) == pytest.approx(flat(one["permeability_by_spacing"]), rel=1e-6)


@pytest.mark.parametrize("name", ["long", "tube", "berea"])
def test_profiles_are_those_of_one_process(found, name):
    """Of every layer the particles of all processes, at the tolerance of the solves; its middle, and whether there is
    fluid, exactly."""
    one, several = (list(csv.DictReader((found(ranks) / name / "profiles.csv").open())) for ranks in (1, 3))
    assert len(one) == len(several) > 2
    for key in one[0]:
        assert [row[key] == "" for row in several] == [row[key] == "" for row in one]
        wanted, measured = ([float(row[key]) for row in rows if row[key]] for rows in (one, several))
        assert measured == pytest.approx(wanted, rel=0.0, abs=1e-4 * max(map(abs, wanted)))


def flat(entry, name=""):
    """Numbers of a nested entry by their keys and places."""
    if isinstance(entry, dict):
        return {k: v for key, value in entry.items() for k, v in flat(value, f"{name}.{key}").items()}
    if isinstance(entry, list):
        return {k: v for number, value in enumerate(entry) for k, v in flat(value, f"{name}.{number}").items()}
    return {name: entry} if isinstance(entry, (int, float)) and not isinstance(entry, bool) else {}


@pytest.mark.parametrize("name", ["berea", "spheres", "tubes", "smooth"])
def test_iterations_do_not_grow_with_processes(found, name):
    """With hypre within 2 on one, two and three processes: 26 on all of them of Berea 32^3. The aggregates of GAMG
    follow the cuts: 26 to 29 there with PETSc 3.25."""
    from isphcli.solvers import petsc

    counts = [summary(found(ranks, engine), name)["iterations"]["stokes"]["max"]
              for ranks, engine in ((1, "petsc"), (2, "auto"), (3, "auto"))]
    assert max(counts) - min(counts) <= (2 if petsc.Petsc().settings is petsc.HYPRE else 4)


@pytest.mark.parametrize("ranks", [2, 3])
def test_sums_and_quantiles_over_processes(found, ranks):
    """All values on one process and none on the others: exact quantiles, sums to round-off."""
    numbers = summary(found(ranks), "reduced")
    assert numbers["quantiles"] == pytest.approx(numbers["wanted"], rel=1e-14)
    assert numbers["least"] == summary(found(1), "reduced")["fewest"]
    assert numbers["sums"] == pytest.approx([0.0] * 11, abs=1e-9)


@pytest.mark.parametrize("ranks", [2, 3])
def test_hierarchies_that_nothing_refers_to_are_freed(found, ranks):
    """PETSc keeps what several processes have together until all of them let go of it together: spacing after spacing
    of `refine`, axis after axis of a sealed image."""
    assert summary(found(ranks), "reduced")["kept"] == 0


def test_snapshots_of_processes_are_one(found):
    """The pieces that the PVTU names hold every particle once."""
    from isphcli.output.files import read_pvd, read_vtu

    folder, one = found(3) / "spheres", found(1) / "spheres"
    (_, joined), = read_pvd(folder / "particles.pvd")
    pieces = re.findall(r'Source="([^"]+)"', (folder / joined).read_text())
    parts = [read_vtu(folder / "snapshots" / piece) for piece in pieces]
    x, alone = np.concatenate([x for x, _ in parts]), read_vtu(one / read_pvd(one / "particles.pvd")[0][1])[0]
    assert len(pieces) == 3 and sorted(map(tuple, x.round(9))) == sorted(map(tuple, alone.round(9)))
    listed = json.loads((folder / "manifest.json").read_text())["files"]
    assert {f"snapshots/{piece}" for piece in pieces} | {joined, "particles.pvd"} <= set(listed)


@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.parametrize("name, file", [("tube", "grid_000000.vti"), ("scattered", "grid_000000.h5")])
def test_fields_on_a_grid_are_those_of_one_process(found, name, file, ranks):
    """In every cell, at the tolerance of the solves; what is solid exactly."""
    one, several = (fields_on_grid(found(count) / name / "snapshots" / file) for count in (1, ranks))
    assert one.keys() == several.keys() >= {"velocity", "pressure", "phase", "solid"}
    for field, values in one.items():
        assert several[field].shape == values.shape and several[field].dtype == values.dtype
        # the tube has no pressure but the drop that drives it, 2 Pa
        largest = max(np.abs(values).max(), 0.01 if field == "pressure" else 0.0)
        close = 1e-4 * largest if values.dtype.kind == "f" else 0
        assert np.abs(several[field].astype(float) - values).max() <= close


def fields_on_grid(path):
    if path.suffix == ".h5":
        return read_snapshot(path)[1]
    pyvista = pytest.importorskip("pyvista")
    return {name: np.asarray(values) for name, values in pyvista.read(path).point_data.items()}


@pytest.mark.parametrize("ranks", [2, 3])
def test_particles_in_one_hdf5_file(found, ranks):
    """Every particle once, with its own velocity."""
    (x, fields), (y, others) = (read_snapshot(found(count) / "scattered/snapshots/particles_000000.h5")
                                for count in (1, ranks))
    first, second = np.lexsort(x.T.round(9)), np.lexsort(y.T.round(9))
    assert np.abs(x[first] - y[second]).max() < 1e-12
    speed = np.abs(fields["velocity"]).max()
    assert np.abs(fields["velocity"][first] - others["velocity"][second]).max() < 1e-4 * speed


def test_errors_of_rank_0_are_those_of_all(tmp_path):
    """It alone looks into the folder, which holds a file of somebody else."""
    (tmp_path / "summary.json").write_text("mine")
    done = start("-m", "isphcli", "run", CASES / "two_tubes.yaml", "--out", tmp_path, "--quiet", ranks=2)
    assert done.returncode != 0 and done.stderr.count("is there already") == 1
    assert (tmp_path / "summary.json").read_text() == "mine"


def test_a_launcher_of_another_mpi_is_refused(tmp_path):
    done = start("-m", "isphcli", "run", CASES / "two_tubes.yaml", "--out", tmp_path / "out", PMI_SIZE="3",
                 OMPI_COMM_WORLD_SIZE="3")
    assert done.returncode == 2 and "another MPI than mpi4py" in done.stderr and not (tmp_path / "out").exists()


def test_one_process_that_fails_ends_all(tmp_path):
    """Rank 1 fails within the solve, where the others wait for it."""
    program = tmp_path / "fails.py"
    program.write_text(f"""
import os, sys
sys.argv = ["isph", "run", {str(CASES / "two_tubes.yaml")!r}, "--out", {str(tmp_path / "out")!r}, "--quiet"]
from isphcli.cli import main
from isphcli.flow import stokes
apply = stokes.StokesSystem.precondition
def fails(self, v):
    from isphcli.domain.communicator import current
    if current().rank == 1:
        raise OSError("the disk of this rank is full")
    return apply(self, v)
stokes.StokesSystem.precondition = fails
main()
""")
    done = start(program, ranks=2)
    assert done.returncode != 0 and "rank 1 of 2: error: the disk of this rank is full" in done.stderr
    assert "finished" not in done.stdout
