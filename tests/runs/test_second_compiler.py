"""Kernels that a second process compiles beside a run."""

import errno
import inspect
import os
import subprocess
import sys

import pytest
from numba.core.caching import IndexDataCacheFile

from isphcli.case.load import load_case
from isphcli.runs import second_compiler as module
from isphcli.runs.second_compiler import LIST, listed, save, scene_of, second_compiler
from tests.paths import CASES, ROOT

TOOL = ROOT / "benchmarks/kernel_list.py"
ENDS = 60  # s that a process may take to end on a busy machine


def scenes():
    lines = [line.split(" ", 2) for line in LIST.read_text().splitlines()]
    return [words for what, _, words in lines if what == "scene"]


@pytest.mark.parametrize("case, scene", [
    ("berea", "stokes one stairs"), ("sphere_array", "stokes one exact"), ("taylor_green_2d", "navier_stokes one free"),
    ("lid_driven_cavity", "navier_stokes one exact"), ("square_drop_1", "navier_stokes two free"),
    ("drop_wall_60", "navier_stokes two exact")])
def test_the_scene_of_a_case(case, scene):
    assert scene_of(load_case(CASES / f"{case}.yaml")) == scene
    assert scene in scenes()


def test_an_unknown_scene_has_no_kernels():
    assert list(listed("a scene of none")) == []


@pytest.mark.slow  # a process that runs two cases
def test_the_list_holds_what_runs_call():
    """All kernels that two runs call, with their types. If it does not, `benchmarks/kernel_list.py` makes it anew."""
    runs = ["cases/sphere_array.yaml particles.spacing=1.25e-4", "cases/square_drop_1.yaml time.max_steps=1"]
    found = subprocess.run([sys.executable, TOOL, "missing", *runs], capture_output=True, text=True, cwd=ROOT)
    assert (found.stdout, found.returncode) == ("", 0), found.stdout + found.stderr


def test_types_are_read_as_they_were_written():
    kernels = [found for scene in scenes() for found in listed(scene)]
    named = {}
    sys.path.insert(0, str(TOOL.parent))
    from kernel_list import texts_of

    for _, arguments in kernels:
        text = texts_of(arguments, named)
        assert module._types(text, {name: line.split(" ", 2) for name, line in named.values()}) == arguments
    assert {kernel.py_func.__module__.partition(".")[0] for kernel, _ in kernels} == {"isphcli"}


@pytest.mark.parametrize("scene", scenes())
def test_kernels_take_what_is_listed(scene):
    """As many arguments, and of namedtuples as many fields: where a kernel has changed since, the list is to be made
    anew."""
    for kernel, arguments in listed(scene):
        assert len(arguments) == len(inspect.signature(kernel.py_func).parameters), kernel
        for kind in arguments:
            if (cls := getattr(kind, "instance_class", None)) is not None:
                assert len(kind.types) == len(cls._fields), (kernel, cls)


@pytest.mark.parametrize("text", ["(open('x'),)", "(int64.real,)", "(float64[2],)", "(1,)"])
def test_other_text_is_refused(text):
    with pytest.raises(ValueError):
        module._types(text, {})


@pytest.fixture
def processes(monkeypatch):
    """Those that were started."""
    begun, popen = [], subprocess.Popen

    def started(*words, **more):
        begun.append(popen(*words, **more))
        return begun[-1]

    monkeypatch.setattr(module, "_begun", set())
    monkeypatch.setattr(IndexDataCacheFile, "save", IndexDataCacheFile.save)  # what it was comes back
    monkeypatch.setattr(module.subprocess, "Popen", started)
    return begun


def test_the_process_ends_with_the_run(processes, monkeypatch):
    monkeypatch.setattr(module, "_cores", lambda: 2)
    with pytest.raises(KeyboardInterrupt), second_compiler("stokes one exact") as start:
        assert processes == []  # nothing is missing yet
        start()
        start()
        raise KeyboardInterrupt
    assert [process.returncode is not None for process in processes] == [True]


def test_one_core_has_no_second_process(processes, monkeypatch):
    monkeypatch.setattr(module, "_cores", lambda: 1)
    with second_compiler("stokes one exact") as start:
        start()
    assert processes == []


def test_an_unknown_numba_has_no_second_process(processes, monkeypatch):
    """`save` is made of names that are no part of numba's interface."""
    monkeypatch.setattr(module, "_cores", lambda: 2)
    monkeypatch.delattr(IndexDataCacheFile, "_save_index")
    with second_compiler("stokes one exact") as start:
        start()
    assert processes == []


def test_the_process_ends_with_the_one_that_started_it():
    """Whose end closes the pipe, also where a signal took it."""
    code = ("import time\nfrom isphcli.runs import second_compiler as second\n"
            "class Kernel:\n def compile(self, _):\n  print('begun', flush=True)\n  time.sleep(1000)\n"
            "second.listed = lambda _: [(Kernel(), ())]\nsecond.main('any')\n")
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline().strip() == b"begun" and process.poll() is None
    process.stdin.close()
    assert process.wait(ENDS) == 0
    process.stdout.close()


def test_the_process_ends_with_its_list():
    """By itself, while the pipe is open: not by SIGABRT, and not at a kernel that does not compile for types of old."""
    code = ("from isphcli.runs import second_compiler as second\n"
            "class Kernel:\n def compile(self, types):\n  print(*types, flush=True)\n  assert types[0]\n"
            "second.listed = lambda _: [(Kernel(), (0,)), (Kernel(), (1,))]\nsecond.main('any')\n")
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.wait(ENDS) == 0
        assert process.stdout.read().split() == [b"0", b"1"]


def test_the_process_finds_the_modules_of_the_run(monkeypatch, tmp_path):
    """Also those of a path that a notebook has put together; with -P not those of the folder in which it was begun."""
    (tmp_path / "only_here.py").touch()
    monkeypatch.setattr(sys, "path", ["", tmp_path, *sys.path])
    found = subprocess.run([sys.executable, "-P", "-c", "import only_here, sys; print(sys.path[0])"],
                           env=module._environment(), capture_output=True, text=True)
    assert found.stdout.strip() == os.getcwd(), found.stderr


def test_a_full_cache_stops_no_run(tmp_path, monkeypatch):
    """It holds what it held before."""
    cache = IndexDataCacheFile(str(tmp_path), "kernel", "stamp")
    save(cache, ("float64",), "of floats")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    for part in ("_save_data", "_save_index"):
        with monkeypatch.context() as patch:
            patch.setattr(cache, part, full)
            save(cache, ("int64",), "of integers")
        assert cache.load(("int64",)) is None and cache.load(("float64",)) == "of floats"


def test_kernels_of_two_processes_are_not_mixed_up(tmp_path, monkeypatch):
    """One lists its kernel as the other does: one may miss in the list, neither is found under the other's key."""
    one, other = (IndexDataCacheFile(str(tmp_path), "kernel", "stamp") for _ in range(2))
    save(one, ("float64",), "of floats")
    monkeypatch.setattr(other, "_load_index", dict)  # read before the first was listed
    save(other, ("int64",), "of integers")
    monkeypatch.undo()
    assert other.load(("int64",)) == "of integers" and other.load(("float64",)) is None
    save(one, ("float64",), "of floats")
    assert one.load(("float64",)) == "of floats" and one.load(("int64",)) == "of integers"
