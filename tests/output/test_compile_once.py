"""One process compiles what all need."""

import fcntl
import os
import subprocess
import sys
import time

from tests.paths import ROOT

PROGRAM = """
import pathlib, sys
sys.path.insert(0, {folder!r})
from isphcli.output.compile_once import compile_once
compile_once(pathlib.Path({folder!r}) / "lock")
from kernel import twice
print("ready", flush=True)
assert twice(3) == 6
print(sum(twice.stats.cache_misses.values()), flush=True)
"""


def test_one_compiles_and_others_load(tmp_path):
    """While a process holds the lock another one does not compile; once the kernel is in the cache it is loaded, and
    then nobody waits for the lock."""
    (tmp_path / "kernel.py").write_text("from numba import njit\n@njit(cache=True)\ndef twice(a):\n    return 2 * a\n")
    command = [sys.executable, "-c", PROGRAM.format(folder=str(tmp_path))]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def begun():
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        assert process.stdout.readline() == "ready\n"
        return process

    with open(tmp_path / "lock", "w", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        waiting = begun(), begun()
        time.sleep(1.0)  # more than it takes to compile
        assert [process.poll() for process in waiting] == [None, None]
        assert not list((tmp_path / "cache").rglob("*.nbc"))
        fcntl.flock(file, fcntl.LOCK_UN)
        assert sorted(process.communicate(timeout=60)[0] for process in waiting) == ["0\n", "1\n"]
        fcntl.flock(file, fcntl.LOCK_EX)
        assert begun().communicate(timeout=60)[0] == "0\n"
