"""Moving particles on several processes: after 20 steps each is where it is on one, and restarts on any number.

Where and how they run: see `test_ranks.py`.
"""

import csv
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.moving_ranks import NAMES, NAMES_OF_TWO, STEPS
from tests.paths import CASES
from tests.test_ranks import ENVIRONMENT, OF_ONE, flat, pytestmark, start  # noqa: F401 - pytest reads pytestmark

SEVERAL = {("auto", 2): NAMES, ("auto", 3): ["vortices", "pack", "thin", "few"], ("auto", 4): ["cavity", "pack"],
           ("petsc", 1): ["vortices", "viscous", "cavity"]}
# Of two fluids, which the same programs run: an mpiexec and its imports cost more than most scenes
SEVERAL_OF_TWO = {("auto", 2): NAMES_OF_TWO, ("auto", 3): ["drop", "half_drop", "few_of_two", "bubbles", "drainage"],
                  ("auto", 4): ["csf", "slit", "thin_layers"]}
# Solves to 1e-11 leave differences of 1e-9 and less of the largest value after 20 steps; what the project asks for
CLOSE = 1e-8
# What a unit pressure gradient makes is found to 1e-3 of it, in each step: PETSc in one process differs by 6e-6 as well
CLOSE_OF = {"held": 3e-5}


_known: dict[tuple[str, int], Path] = {}  # of both files of tests
_gone: dict[tuple[str, int, int], Path] = {}


@pytest.fixture(scope="session")
def found(tmp_path_factory):
    """found(engine, ranks): the folder that `tests.moving_ranks` filled, once."""

    def of(engine="auto", ranks=1):
        key = engine, ranks
        if key == ("auto", 1) and OF_ONE is not None:
            return Path(OF_ONE) / "moving"
        if key not in _known:
            folder = tmp_path_factory.mktemp(f"{engine}{ranks}")
            names = ",".join([*SEVERAL[key], *SEVERAL_OF_TWO.get(key, [])]) if key in SEVERAL else "all"
            done = start("-m", "tests.moving_ranks", folder, engine, names, ranks=ranks)
            assert done.returncode == 0, done.stdout + done.stderr
            _known[key] = folder
        return _known[key]

    return of


@pytest.fixture(scope="session")
def gone_on(found, tmp_path_factory):
    """gone_on(name, before, after): the folder of a scene that made 20 steps on one number of processes and ten more on
    another."""

    def of(name, before, after):
        if (name, before, after) not in _gone:
            keys = [key for key in GONE_ON if key[2] == after]
            for key in keys:
                copy = tmp_path_factory.mktemp("from" + str(key[1])) / key[0]
                _gone[key] = shutil.copytree(found("auto", key[1]) / key[0], copy)
            done = start("-m", "tests.moving_ranks", "goes_on", *(_gone[key] for key in keys), ranks=after)
            assert done.returncode == 0, done.stdout + done.stderr
        return _gone[name, before, after]

    return of


def state(folder):
    with np.load(folder / "restart.npz") as file:
        return {key.removeprefix("state0."): file[key] for key in file.files if key.startswith("state0.")}


def rows(folder, name="history.csv"):
    return list(csv.DictReader((folder / name).open()))


def assert_same_state(one, other, close=CLOSE):
    """Positions over the spacing of particles that may have gone over a seam, here of the box of the scenes."""
    a, b = state(one), state(other)
    assert a["x"].shape == b["x"].shape and a["step"] == b["step"]
    box = np.ptp(a["x"], axis=0)
    apart = np.abs(a["x"] - b["x"])
    over_the_seam = apart > 0.5 * box
    spacing = box.max() / len(a["x"]) ** (1 / len(box))
    assert (apart[~over_the_seam] < close * spacing).all()
    speed = np.abs(a["u"]).max()
    assert np.abs(a["u"] - b["u"]).max() < close * speed
    # where no pressure drives the flow what there is of it is error: a part of what would stop the flow within a step
    assert np.abs(a["p"] - b["p"]).max() < close * max(np.abs(a["p"]).max(), speed * spacing / a["dt_old"])
    assert b["time"] == pytest.approx(a["time"], rel=close)
    assert a.keys() == b.keys()
    if "phi" in a:
        # three spacings off the interface it rests on few neighbours: fits with a ridge of 1e-7 amplify the last digits
        assert np.abs(a["phi"] - b["phi"]).max() < 100 * close * spacing


@pytest.mark.parametrize("engine, ranks, name", [(*key, name) for key, names in SEVERAL.items() for name in names])
def test_particles_are_where_they_are_on_one_process(found, engine, ranks, name):
    one, other = found() / name, found(engine, ranks) / name
    close = CLOSE_OF.get(name, CLOSE)
    assert_same_state(one, other, close)
    first, second = rows(one), rows(other)
    assert len(first) == len(second) and first[0].keys() == second[0].keys()
    for key, least in (("kinetic_energy", 0.0), ("dt", 0.0), ("divergence", 1e-9)):  # of the volume of a particle
        expected, measured = ([float(row[key]) for row in table] for table in (first, second))
        assert measured == pytest.approx(expected, rel=100 * close, abs=max(least, 0.1 * close * max(expected)))
    summary, wanted = (json.loads((folder / "summary.json").read_text()) for folder in (other, one))
    for key in ("fluid", "dummy", "left_out"):
        assert summary["particles"][key] == wanted["particles"][key]
    assert summary["steps"] == wanted["steps"] and summary["porosity"] == pytest.approx(wanted["porosity"], rel=1e-12)
    assert summary["speed"] == pytest.approx(wanted["speed"], rel=100 * close)
    # against a reference, of which each process compares its own particles (vortices) or rank 0 all (cavity)
    assert flat(summary["errors"]) == pytest.approx(flat(wanted["errors"]), rel=100 * close, abs=close)


def test_particles_change_their_process(found):
    """Otherwise the test above tests no migration: the lid carries particles over the cut, and each half stays that
    of one process."""
    from isphcli.output.files import read_vtu

    begin, end = ([read_vtu(found("auto", 2) / f"cavity/snapshots/particles_{step:06d}_{rank:05d}.vtu")[0]
                   for rank in (0, 1)] for step in (0, STEPS))
    axis = int(np.argmin(np.ptp(begin[0], axis=0)[:2]))
    for piece in (*begin, *end):
        assert np.ptp(piece[:, axis]) < 0.57  # half of the box, and a spacing: the cut is between two columns
    first, last = read_vtu(found() / "cavity/snapshots/particles_000000.vtu")[0], state(found() / "cavity")["x"]
    assert ((first[:, axis] < 0.5) != (last[:, axis] < 0.5)).sum() > 2


@pytest.mark.parametrize("ranks, name, reach", [(2, "vortices_3d", 0.21), (2, "vortices", 0.115),
                                                (3, "vortices", 0.115)])
def test_remote_particles_and_messages_are_those_of_the_model(found, ranks, name, reach):
    """Of boxes full of fluid: particles within a support of a brick, to a fifth, since a few layers are seen or not;
    and a message a neighbour for every exchange, of which there are as many on two and three processes but for the
    particles that change their process and for iterations."""
    from isphcli.validation.scaling import busiest

    counted = json.loads((found("auto", ranks) / name / "summary.json").read_text())["ranks"]
    dim = 3 if name == "vortices_3d" else 2
    near = busiest(np.zeros(dim), np.ones(dim), ranks, reach, (True,) * dim)
    assert counted["remote"][1] / counted["fluid"][0] == pytest.approx(near.remote, rel=0.2)
    two = json.loads((found("auto", 2) / name / "summary.json").read_text())["ranks"]
    assert near.neighbours == ranks - 1
    assert counted["messages"][1] / near.neighbours == pytest.approx(two["messages"][1], rel=0.2)


@pytest.mark.parametrize("engine, ranks", [("auto", 2), ("petsc", 1)])
def test_solves_leave_nothing_in_memory(found, engine, ranks):
    """PETSc keeps what was not destroyed until its end, with all that the functions of a solve hold: 70 kB per particle
    in 20 steps once."""
    assert (found(engine, ranks) / "left").read_text() == "0"


def test_snapshots_of_moving_particles(found):
    """The PVD lists a PVTU a snapshot, whose pieces hold every particle once."""
    from isphcli.output.files import read_pvd, read_vtu

    folder = found("auto", 3) / "vortices"
    for _, joined in read_pvd(folder / "particles.pvd"):
        pieces = re.findall(r'Source="([^"]+)"', (folder / joined).read_text())
        x = np.concatenate([read_vtu(folder / "snapshots" / piece)[0] for piece in pieces])
        assert len(pieces) == 3 and len(np.unique(x.round(9), axis=0)) == len(x) == 400


GONE_ON = [("vortices", 1, 1), ("vortices", 2, 3), ("vortices", 2, 1), ("vortices", 1, 2),
           ("half_drop", 1, 1), ("half_drop", 2, 3), ("half_drop", 3, 1)]  # scene, processes before and after


@pytest.mark.parametrize("name, before, after", [key for key in GONE_ON if key[1:] != (1, 1)])
def test_a_restart_goes_on_with_another_number_of_processes(gone_on, name, before, after):
    """The file of 20 steps on one number of processes gives, on another, the 30 steps of one."""
    longer, folder = gone_on(name, 1, 1), gone_on(name, before, after)
    assert_same_state(longer, folder)
    assert [row["step"] for row in rows(folder)] == [str(step) for step in range(1, 31)]


def test_a_damaged_restart_file_is_refused_by_all(found, tmp_path):
    folder = tmp_path / "damaged"
    shutil.copytree(found("auto", 2) / "vortices", folder)
    data = bytearray((folder / "restart.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "restart.npz").write_bytes(data)
    done = start("-m", "isphcli", "run", "--restart", folder, "--quiet", "--set", "time.max_steps=30", ranks=2)
    assert done.returncode != 0 and "damaged" in done.stderr
    assert len(rows(folder)) == STEPS


def test_a_signal_to_one_process_ends_all_with_a_restart_file(tmp_path):
    """SIGTERM, as a scheduler sends it; all stop behind the same step, of which the history tells."""
    launched = subprocess.Popen(
        ["mpiexec", "-n", "2", sys.executable, "-m", "isphcli", "run", CASES / "taylor_green_2d_re100.yaml", "--quiet",
         "--out", tmp_path / "out", "--set", "particles.spacing=0.05", "--set",
         "time={end: 1e9, max_steps: 1000000}"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)
    history = tmp_path / "out/history.csv"
    try:
        for _ in range(1200):
            if history.exists() and len(rows(tmp_path / "out")) > 2:
                break
            time.sleep(0.1)
        # a launcher may have a process of its own between
        ranks = [process for process in psutil.Process(launched.pid).children(recursive=True)
                 if "python" in process.name()]
        assert len(ranks) >= 2
        ranks[-1].send_signal(signal.SIGTERM)
        _, said = launched.communicate(timeout=120)
    finally:
        launched.kill()
    assert launched.returncode != 0 and said.count("interrupted") == 1 and "restart.npz" in said
    assert state(tmp_path / "out")["step"] == len(rows(tmp_path / "out"))


def test_one_process_that_fails_in_a_step_ends_all(tmp_path):
    program = tmp_path / "fails.py"
    program.write_text(f"""
import sys
sys.argv = ["isph", "run", {str(CASES / "taylor_green_2d.yaml")!r}, "--out", {str(tmp_path / "out")!r}, "--quiet"]
from isphcli.cli import main
from isphcli.flow import step
carry = step.carry
def fails(*given):
    from isphcli.domain.communicator import current
    if current().rank == 1:
        raise OSError("the disk of this rank is full")
    return carry(*given)
step.carry = fails
main()
""")
    done = start(program, ranks=2)
    assert done.returncode != 0 and "rank 1 of 2: error: the disk of this rank is full" in done.stderr
    assert "finished" not in done.stdout


@pytest.mark.parametrize("rank, file, reached, said", [
    (0, "restart.npz", 3, "error:"), (1, "restart.npz", 3, "error:"),  # which they write together
    (1, "particles_000008_00001.vtu", 6, "rank 1 of 2: error:")])
def test_a_full_disk_of_one_process_loses_nothing(rank, file, reached, said, tmp_path):
    """ENOSPC amid a file that it writes: all end with its message, what was listed before is whole, nothing unfinished
    is left, and a restart, once there is room, makes the snapshots and the history of a run that was not stopped."""
    out = tmp_path / "out"
    program = tmp_path / "full.py"
    program.write_text(f"""
import contextlib, errno, os, sys
sys.argv = ["isph", "run", {str(CASES / "taylor_green_2d_re100.yaml")!r}, "--out", {str(out)!r}, "--quiet", "--set",
            "particles.spacing=0.05", "--set", "time={{end: 0.04, step: 0.005}}", "--set",
            "output={{every: 0.01, restart_every: 3, plots: false}}"]
from isphcli.cli import main
from isphcli.domain.communicator import current
from isphcli.output import folder, shared_npz
whole, write_rows, written = folder.whole, shared_npz._write_rows, []
@contextlib.contextmanager
def full(path):
    with whole(path) as temporary:
        yield temporary
        if current().rank == {rank} and path.name == {file!r} != "restart.npz":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
def rows_of_a_full_disk(put, entry, *given):
    found = write_rows(put, entry, *given)
    written.append(entry.name)
    if current().rank == {rank} and {file!r} == "restart.npz" and written.count("state0.u") == 2:  # the second file
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return found
folder.whole, shared_npz._write_rows = full, rows_of_a_full_disk
main()
""")
    done = start(program, ranks=2)
    assert done.returncode != 0 and said in done.stderr and done.stderr.count("No space left") == 1
    assert "Traceback" not in done.stderr and not list(out.rglob(".isph-*"))
    assert whole_snapshots(out) == [0, 6] and state(out)["step"] == reached
    gone_on = start("-m", "isphcli", "run", "--restart", out, "--quiet", ranks=2)
    assert gone_on.returncode == 0, gone_on.stderr
    assert [row["step"] for row in rows(out)] == [str(step) for step in range(1, 13)]
    assert whole_snapshots(out) == [0, 6, 8, 10, 12] and state(out)["step"] == 12


def whole_snapshots(folder):
    """Steps of the snapshots that are listed, all 400 particles of which can be read."""
    from isphcli.output.files import read_pvd, read_vtu

    listed = read_pvd(folder / "particles.pvd")
    for _, joined in listed:
        pieces = re.findall(r'Source="([^"]+)"', (folder / joined).read_text())
        assert sum(len(read_vtu(folder / "snapshots" / piece)[0]) for piece in pieces) == 400
    return [int(re.findall(r"\d+", joined)[-1]) for _, joined in listed]
