"""Where compiled kernels are kept: a folder of one's own, or none."""

import os
import platform
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from isphcli.output import environment


@pytest.fixture
def no_places(monkeypatch, tmp_path):
    """A machine without a folder for kernels but the temporary one. Below a file even root makes no folder."""
    (tmp_path / "file").touch()
    monkeypatch.setattr(environment, "_user_cache", lambda: tmp_path / "file")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("MPLCONFIGDIR", "")  # and so put back afterwards
    monkeypatch.delenv("MPLCONFIGDIR")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    return tmp_path / "file"


def test_kernels_go_to_a_private_temporary_folder_where_no_other_will_do(no_places):
    said = environment.find_kernel_cache(no_places)
    (place,) = (no_places.parent / "tmp").iterdir()
    assert str(place) in said and str(no_places / "__pycache__") in said and str(no_places / "numba") in said
    assert os.environ["NUMBA_CACHE_DIR"] == str(place / "numba")
    assert stat.S_IMODE(place.stat().st_mode) == 0o700
    os.environ["NUMBA_CACHE_DIR"] = ""
    environment.find_kernel_cache(no_places)  # the same one again: what is compiled stays
    assert os.environ["NUMBA_CACHE_DIR"] == str(place / "numba")


@pytest.mark.parametrize("prepared", ["open to others", "a link", "of another user"])
def test_a_folder_that_others_may_write_to_is_not_taken(no_places, monkeypatch, prepared):
    """Who writes there has his code run."""
    place = no_places.parent / "tmp" / f"isph-{os.getuid()}"
    if prepared == "a link":
        (no_places.parent / "elsewhere").mkdir(mode=0o700)
        place.symlink_to(no_places.parent / "elsewhere")
    else:
        place.mkdir(mode=0o700)
    if prepared == "open to others":
        place.chmod(0o770)
    if prepared == "of another user":
        other = os.getuid() + 1
        monkeypatch.setattr(os, "getuid", lambda: other)
        place = place.rename(place.with_name(f"isph-{other}"))
    environment.find_kernel_cache(no_places)
    used = Path(os.environ["NUMBA_CACHE_DIR"]).parent
    assert used != place and used.parent == place.parent and not used.is_symlink()
    assert stat.S_IMODE(used.stat().st_mode) == 0o700 and not list(place.iterdir() if place.exists() else ())


def test_nothing_is_changed_where_numba_finds_a_folder(no_places, monkeypatch):
    good = no_places.parent / "good"
    assert environment.find_kernel_cache(good) is None and os.environ["NUMBA_CACHE_DIR"] == ""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(good))
    assert environment.find_kernel_cache(no_places) is None and os.environ["NUMBA_CACHE_DIR"] == str(good)


HELD = """
import sys
import numpy as np
from isphcli.output.environment import keep_freed_memory

def resident():
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmRSS"))

if sys.argv[1] == "keep":
    keep_freed_memory()
before = resident()
array = np.ones(6_000_000)
del array
print(resident() - before)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists() or platform.libc_ver()[0] != "glibc", reason="of glibc")
@pytest.mark.parametrize("keep", [True, False])
def test_freed_memory_stays_with_the_process(keep):
    """48 MB, kB of it that are still there."""
    found = subprocess.run([sys.executable, "-c", HELD, "keep" if keep else "-"], capture_output=True, text=True)
    assert (int(found.stdout) > 40_000) == keep, found.stderr
