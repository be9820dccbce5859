"""Files of others stay: the manifest of a folder, its lock, what is refused and when."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from isphcli.cli import BAD_INPUT, main
from isphcli.output import folder
from isphcli.output.files import History, Series, read_history, write_summary, write_text
from isphcli.output.folder import Folder, FolderError
from isphcli.validation import paper

STEADY = """\
# mine
geometry: {box: [1, 0.5], periodic: [x]}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0]}
flow: stokes
"""
MOVING = """\
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 0.1}}
initial: {velocity: ["sin(2*pi*x)*cos(2*pi*y)", "-cos(2*pi*x)*sin(2*pi*y)"]}
time: {end: 0.05}
output: {every: 0.02, plots: false}
"""


def isph(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def contents(path):
    """{relative path: bytes} of all files below a folder."""
    return {p.relative_to(path).as_posix(): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}


def listed(path):
    return json.loads((path / folder.MANIFEST).read_text(encoding="utf-8"))["files"]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(done, *words):
    """Exit code 2 and one line on stderr that holds the words."""
    assert done.exit_code == BAD_INPUT and not done.stdout, done.output
    assert len(done.stderr.splitlines()) == 1, done.stderr
    for word in words:
        assert str(word) in done.stderr


# -- runs ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("text", [STEADY, MOVING], ids=["steady", "moving"])
def test_results_are_refused_unless_they_shall_be_overwritten(here, text):
    """And then the files of others stay: those of the names that isph had taken for its own, too."""
    (here / "case.yaml").write_text(text)
    assert isph("run", "case.yaml", "--quiet").exit_code == 0
    out = here / "out/case"
    assert sorted(listed(out)) == sorted({*contents(out)} - {folder.MANIFEST})
    for name in ("run.log", "restart.md", "slices.png", "snapshots/probe_000003.vtu", "probe.pvd", ".isph-mine.a.txt"):
        (out / name).write_text("of another program")
    before = contents(out)
    refused(isph("run", "case.yaml", "--quiet"), out, "--restart", "--overwrite", "--out")
    assert contents(out) == before
    refused(isph("run", "case.yaml", "--quiet", "--overwrite", "--set", "fluids.water.viscosity=-1"), "viscosity")
    assert contents(out) == before
    assert isph("run", "case.yaml", "--quiet", "--overwrite").exit_code == 0
    after = contents(out)
    assert after.keys() == before.keys()
    assert [name for name, data in before.items() if data == b"of another program" != after[name]] == []
    assert sorted(listed(out)) == sorted(k for k in after if after[k] != b"of another program" and k != folder.MANIFEST)


def test_two_cases_of_one_name(here):
    """The message says whose results the folder holds."""
    for name in ("a", "b"):
        (here / name).mkdir()
        (here / name / "case.yaml").write_text(STEADY + "output: {plots: false}\n")
    assert isph("run", "a/case.yaml", "--quiet").exit_code == 0
    refused(isph("run", "b/case.yaml", "--quiet"), f"holds results of {here / 'a/case.yaml'}, not of "
                                                   f"{here / 'b/case.yaml'}")


@pytest.mark.slow
def test_a_run_into_the_folder_of_its_case(here):
    """The case of the user is not replaced by the copy that a run leaves; a case of another name is no hindrance."""
    (here / "case.yaml").write_text(STEADY)
    refused(isph("run", "case.yaml", "--quiet", "--out", "."), here / "case.yaml", "is the case itself", "--out")
    refused(isph("run", "case.yaml", "--quiet", "--out", ".", "--overwrite"), "is the case itself")
    assert contents(here) == {"case.yaml": STEADY.encode()}
    (here / "case.yaml").rename("slit.yaml")
    assert isph("run", "slit.yaml", "--quiet", "--out", ".").exit_code == 0
    assert (here / "slit.yaml").read_text() == STEADY and "slit.yaml" not in listed(here)


@pytest.mark.parametrize("name", ["summary.json", "slice.png", "particles.pvd", "snapshots/particles_000000.vtu",
                                  folder.MANIFEST, folder.LOCK])
def test_a_file_of_others_in_the_way(here, name, monkeypatch):
    """Found before anything is computed, and named. Even one with the name of the manifest is not believed."""
    (here / "case.yaml").write_text(STEADY)
    path = here / "out/case" / name
    path.parent.mkdir(parents=True)
    path.write_text('{"files": ["../../case.yaml"]}')
    monkeypatch.setattr("isphcli.runs.steady_case.build_geometry", None)  # it would be called first
    for more in ([], ["--overwrite"]):
        refused(isph("run", "case.yaml", "--quiet", *more), path, "--out")
    assert contents(here) == {"case.yaml": STEADY.encode(), f"out/case/{name}": path.read_bytes()}


@pytest.mark.slow
def test_all_files_of_a_run_are_announced(here):
    """`run._files` names all that a run writes: what is not there is found only when the run has been computed."""
    from isphcli.case.load import load_case
    from isphcli.runs.results import files_of

    for name, text in (("steady", STEADY), ("moving", MOVING.replace(", plots: false", ""))):
        (here / f"{name}.yaml").write_text(text)
        assert isph("run", f"{name}.yaml", "--quiet").exit_code == 0
        out = here / "out" / name
        known = {p.relative_to(out).as_posix() for pattern in files_of(load_case(f"{name}.yaml"))
                 for p in out.glob(pattern)}
        assert set(listed(out)) == known


def test_a_manifest_that_names_files_elsewhere(here):
    """Nothing outside of the folder is removed, whatever a manifest says."""
    (here / "case.yaml").write_text(STEADY)
    out = here / "out/case"
    out.mkdir(parents=True)
    (here / "elsewhere").mkdir()
    (here / "elsewhere/a.txt").write_text("kept")
    (out / "link").symlink_to(here / "elsewhere")
    for name in ("../../case.yaml", str(here / "case.yaml"), "link/a.txt"):
        (out / folder.MANIFEST).write_text(json.dumps({"program": "isphcli", "files": [name], "folders": []}))
        refused(isph("run", "case.yaml", "--quiet", "--overwrite"), name, "not in the folder")
    assert (here / "case.yaml").exists() and (here / "elsewhere/a.txt").exists()


def test_a_link_of_ours_is_replaced_and_not_what_it_leads_to(here):
    (here / "data.csv").write_text("mine")
    (here / "out").mkdir()
    with Folder("out") as held:
        write_text("out/history.csv", "a")
    (here / "out/history.csv").unlink()
    (here / "out/history.csv").symlink_to(here / "data.csv")
    with Folder("out", overwrite=True) as held:
        held.prepare()
        write_text("out/history.csv", "b")
    assert (here / "data.csv").read_text() == "mine" and (here / "out/history.csv").read_text() == "b"


def test_options_that_contradict_each_other(here):
    (here / "case.yaml").write_text(MOVING)
    assert isph("run", "case.yaml", "--quiet").exit_code == 0
    before = contents(here)
    done = isph("run", "--restart", "out/case", "--overwrite", "--out", "./out/case")
    assert done.exit_code == BAD_INPUT and "--overwrite" in done.stderr and contents(here) == before
    assert isph("run", "case.yaml", "--quiet", "--out", "out/other").exit_code == 0
    words = ["run", "--restart", "out/case", "--out", "out/other", "--quiet", "--set", "time.end=0.06"]
    refused(isph(*words), "holds results")
    assert isph(*words, "--overwrite").exit_code == 0
    assert read_history(here / "out/other/history.csv")[0]["time"] > 0.05


def test_a_folder_that_was_copied_without_its_manifest(here):
    """Its restart file is read, and not written over: the run goes on in another folder."""
    (here / "case.yaml").write_text(MOVING)
    assert isph("run", "case.yaml", "--quiet").exit_code == 0
    (here / "copy").mkdir()
    for name in ("case.yaml", "restart.npz"):
        (here / "copy" / name).write_bytes((here / "out/case" / name).read_bytes())
    before = contents(here / "copy")
    words = ["run", "--restart", "copy", "--quiet", "--set", "time.end=0.06"]
    refused(isph(*words), "copy/case.yaml", "--out")
    assert contents(here / "copy") == before
    assert isph(*words, "--out", "longer").exit_code == 0


@pytest.mark.slow
def test_the_copy_of_a_case_that_is_run_is_never_away(here, monkeypatch):
    """`isph run out/case/case.yaml --overwrite`: the run is killed as soon as the old results are removed."""
    (here / "case.yaml").write_text(STEADY)
    assert isph("run", "case.yaml", "--quiet").exit_code == 0
    copy = here / "out/case/case.yaml"
    before = copy.read_bytes()
    real = Folder.prepare

    def stop(self):
        real(self)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Folder, "prepare", stop)
        assert isph("run", copy, "--quiet", "--overwrite").exit_code == 130
    assert contents(here / "out/case").keys() == {"case.yaml", folder.MANIFEST} and copy.read_bytes() == before
    assert isph("run", copy, "--quiet", "--overwrite").exit_code == 0
    assert sorted(listed(here / "out/case")) == sorted({*contents(here / "out/case")} - {folder.MANIFEST})


def test_a_run_that_is_refused_leaves_no_folder(here):
    (here / "case.yaml").write_text(STEADY.replace("[1, 0]", "[0, 1]"))
    assert isph("run", "case.yaml", "--quiet", "--out", "a/b/c").exit_code == BAD_INPUT
    assert os.listdir(here) == ["case.yaml"]


# -- the lock --------------------------------------------------------------------------------------------

HOLD = """
import sys, time
from isphcli.output.folder import Folder
with Folder("out/case"):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder():
    """A process that holds out/case."""
    process = subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_a_second_run_in_a_folder_is_refused(here, holder):
    """With process and host of the first; also one that would go on from a restart file. After its end, however that
    came, the folder is free."""
    (here / "case.yaml").write_text(MOVING)
    for more in ([], ["--overwrite"]):
        refused(isph("run", "case.yaml", "--quiet", *more), "another run is under way", f"process {holder.pid} on ",
                os.uname().nodename)
    (here / "out/case/case.yaml").write_text(MOVING)
    (here / "out/case/restart.npz").write_text("")
    refused(isph("run", "--restart", "out/case"), "another run is under way", holder.pid)
    (here / "out/case/case.yaml").unlink()
    (here / "out/case/restart.npz").unlink()
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (here / "out/case" / folder.LOCK).exists()
    assert isph("run", "case.yaml", "--quiet").exit_code == 0
    assert not (here / "out/case" / folder.LOCK).exists()


@pytest.mark.slow
def test_one_of_many_gets_the_lock(here):
    """Eight processes at once, again and again: never two in the folder at a time, and none is refused for good."""
    code = ("import os, time\nfrom isphcli.output.folder import Folder, FolderError\nwon = 0\n"
            "while won < 5:\n"
            "    try:\n"
            "        with Folder('out'):\n"
            "            os.close(os.open('alone', os.O_CREAT | os.O_EXCL))\n"
            "            time.sleep(1e-3)\n"
            "            os.unlink('alone')\n"
            "            won += 1\n"
            "    except FolderError:\n"
            "        time.sleep(1e-3)\n")
    (here / "out").mkdir()
    many = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(8)]
    assert [one.wait(timeout=120) for one in many] == [0] * 8


# -- kills -----------------------------------------------------------------------------------------------


def test_what_a_kill_leaves_is_ours(here):
    """Killed between the name in the manifest and the file, and amid the file: both are the next run's to remove."""
    code = ("import os, signal\nfrom isphcli.output import files, folder\nfolder.Folder('out').__enter__()\n"
            "files.write_text('out/a.txt', 'a')\n"
            "with files.replacing('out/b.txt') as temporary:\n"
            "    temporary.write_text('half')\n    os.kill(os.getpid(), signal.SIGKILL)\n")
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    (here / "out/.isph-c.12345678.txt").write_text("of another")
    assert listed(here / "out") == ["a.txt", "b.txt"] and len(contents(here / "out")) == 5
    with pytest.raises(FolderError, match="holds results"), Folder("out"):
        pass
    with Folder("out", overwrite=True) as held:
        held.prepare()
    assert contents(here / "out").keys() == {folder.MANIFEST, ".isph-c.12345678.txt"}
    with Folder("out"):  # names without files are no results
        write_text("out/b.txt", "b")
    assert listed(here / "out") == ["b.txt"]


def test_every_writer_names_its_file(here):
    with Folder("out") as held:
        Series("out").write(0, 0.0, np.zeros((1, 2)), {})
        with History("out/history.csv") as history:
            history.append({"step": 1})
        write_summary("out/summary.json", {})
        assert list(held.files) == ["snapshots/particles_000000.vtu", "particles.pvd", "history.csv", "summary.json"]
        for name in ("b.csv", "b.txt"):
            (here / "out" / name).write_text("mine")
        with pytest.raises(FolderError, match=r"b\.txt: is there already"):
            write_text("out/b.txt", "x")
        with pytest.raises(FolderError, match=r"b\.csv: is there already"), History("out/b.csv") as history:
            history.append({"step": 1})
        folder.remove("out/b.txt")
        folder.remove("out/summary.json")
    assert (here / "out/b.txt").read_text() == "mine" and (here / "out/b.csv").read_text() == "mine"
    assert not (here / "out/summary.json").exists()
    write_text("free.txt", "a")  # outside of any folder that is held nothing is written down
    write_text("free.txt", "b")


# -- folders within --------------------------------------------------------------------------------------


def test_the_report_of_the_paper_goes_on_in_its_own_folder(here):
    """Its report, and what its figures write; those of others are in the way and stay."""
    def run(seconds, place):
        write_text(place / "a.txt", "ours")
        return paper.Finding((), [])

    figures = [paper.Figure("fig", "a figure", "a claim", 1.0, run)]
    for _ in range(2):
        paper.reproduce(here / "paper", 10.0, lambda line: None, figures)
    assert listed(here / "paper") == ["fig/a.txt", "report.md", "report.json"]
    for name in ("report.md", "fig/a.txt"):
        path = here / name[-5:] / name
        path.parent.mkdir(parents=True)
        path.write_text("mine")
        with pytest.raises(FolderError, match="is there already"):
            paper.reproduce(here / name[-5:], 10.0, lambda line: None, figures)
        assert contents(here / name[-5:])[name] == b"mine"


def test_the_runs_of_a_command_are_its_own(here):
    """Folders that the command has filled before it may fill again; one that another run has filled it may not."""
    with Folder("all", keep=True):
        assert not folder.ours("all/1")
        with Folder("all/1"):
            write_text("all/1/a.txt", "1")
        assert folder.ours("all/1")
    with Folder("all/2"):
        write_text("all/2/a.txt", "of another")
    with Folder("all", keep=True):
        assert folder.ours("all/1") and not folder.ours("all/2") and not folder.ours("all/2")
    assert not folder.ours("all/1")  # nobody holds a folder around it


@pytest.mark.slow
def test_validate_goes_on_in_its_own_folders(here):
    """And stays out of those of others: a report or a run of the same name is refused, and all that is there stays."""
    (here / "slit.yaml").write_text(STEADY + "reference: {kind: slit, tolerance: 0.5}\n")
    words = ["validate", "slit.yaml", "--levels", "2", "--quiet"]
    for _ in range(2):
        assert isph(*words).exit_code == 0
    out = here / "out/validate/slit"
    for name in ("notes.txt", "level_1/run.log", "level_2/snapshots/mine_000001.vtu"):
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).write_text("mine")
    before = contents(out)
    assert isph(*words).exit_code == 0
    after = contents(out)
    assert after.keys() == before.keys() and [k for k in before if before[k] == b"mine" != after[k]] == []
    assert isph("run", "slit.yaml", "--quiet", "--out", out / "level_3").exit_code == 0
    before = contents(out / "level_3")
    done = isph(*words[:3], "3", *words[4:])
    assert done.exit_code == BAD_INPUT and "level_3: holds results" in done.stderr
    assert contents(out / "level_3") == before
    other = here / "other/slit"
    other.mkdir(parents=True)
    (other / "validation.csv").write_text("mine")
    done = isph(*words, "--out", "other")
    assert done.exit_code == BAD_INPUT and "validation.csv: is there already" in done.stderr
    assert contents(other) == {"validation.csv": b"mine"}


def test_a_conversion_says_how_it_would_replace(here):
    np.save("a.npy", np.eye(4, dtype=np.uint8))
    (here / "b.raw").write_text("mine")
    refused(isph("convert-voxels", "a.npy", "b.mhd"), "b.raw: exists", "--force")
    refused(isph("convert-voxels", "a.npy", "a.npy", "--force"), "a.npy: is read from")
    assert contents(here).keys() == {"a.npy", "b.raw"} and (here / "b.raw").read_text() == "mine"
    assert isph("convert-voxels", "a.npy", "b.mhd", "--force").exit_code == 0
    assert (here / "b.raw").read_bytes() == np.eye(4, dtype=np.uint8).tobytes()
