"""Adapts the program to its environment: streams that are closed or cannot take every character, folders that cannot
be written, threads and memory.

Used first of all, so it imports nothing that takes long.
"""

from __future__ import annotations

import codecs
import contextlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

# replacements of characters that the encoding of an output does not have; all others become escapes, \u5ca9
_PLAIN = {"≥": ">=", "≤": "<=", "→": "->", "←": "<-", "…": "...", "²": "2", "³": "3", "µ": "u", "μ": "u"}
_ERRORS = "isph-plain"
# How many processes a launcher says that it started: Open MPI, then those that speak PMI (MPICH, Intel), then srun
LAUNCHERS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS")
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def launched() -> int:
    """Processes that mpiexec or srun says it has started, of which this is one; 1 without them."""
    return next((int(os.environ[name]) for name in LAUNCHERS if os.environ.get(name, "").isdigit()), 1)


def settle_threads(threads: int | None) -> str | None:
    """Sets the threads of the numba kernels, one of BLAS unless the environment sets them, and a folder for compiled
    kernels; returns a sentence on that folder, or None.

    BLAS threads spin while they wait and were measured to triple the time of a solve. To be called before numpy is
    imported; `one_blas_thread` is for a BLAS that is there already. A number given where numba runs already changes
    that instead.
    """
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    # threads that spin between kernels take the cores from all other programs
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    note = find_kernel_cache() if "numba" not in sys.modules else None
    if threads is None and launched() > 1 and "NUMBA_NUM_THREADS" not in os.environ:
        threads = 1  # the other cores are those of the other processes
    if threads is None:
        return note
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
    else:
        os.environ["NUMBA_NUM_THREADS"] = str(threads)
    return note


def keep_freed_memory() -> None:
    """Lets the C library (glibc) reuse the memory of the arrays of a step for the next one, instead of returning it to
    the system, which clears every page again: this saves 0.15 to 0.2 of the CPU time of a step of 110,000 particles,
    for a peak 5 % higher (benchmarks/step_cost.py, 2026-11-29)."""
    import ctypes

    with contextlib.suppress(OSError, AttributeError, TypeError):  # other systems, other C libraries
        library = ctypes.CDLL(None)
        # M_MMAP_THRESHOLD: arrays below it come from what was freed, bytes; older versions take 32 MB at most
        _ = library.mallopt(-3, 1 << 30) or library.mallopt(-3, 1 << 25)
        library.mallopt(-1, (1 << 31) - 1)  # M_TRIM_THRESHOLD: what may be kept at the end of the heap, bytes


def give_back_freed_memory() -> None:
    """Lets the C library (glibc) return the memory of freed arrays to the system: it keeps that of arrays below 32 MB
    for later ones, and the arrays that follow have other sizes."""
    import ctypes

    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread of BLAS in the block, also where numpy was imported before this package, as notebooks do."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


def settle_streams() -> None:
    """Makes stdout and stderr take any text, whatever their encoding, and be there even if they were closed.

    A number of a closed stream would be given to the next file that is opened, and what a library prints would go
    into a result.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free, which is this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))
    codecs.register_error(_ERRORS, _plain)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=_ERRORS)


def _plain(error: UnicodeError) -> tuple[str | bytes, int]:
    """Error handler of `codecs`: the replacement of one character, and where to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character = error.object[error.start]
    if "\udc80" <= character <= "\udcff":  # a byte of a file name that is no text: as it was
        return bytes([ord(character) - 0xDC00]), error.start + 1
    return _PLAIN.get(character, character.encode("ascii", "backslashreplace").decode()), error.start + 1


def stop_printing() -> None:
    """Discards the rest of the buffer of stdout, without an error message, after its reader has closed the pipe."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def find_kernel_cache(package: Path = Path(__file__).parents[1]) -> str | None:
    """Makes sure that numba has a folder for compiled kernels; returns a sentence where none of the usual ones can be
    written.

    numba takes NUMBA_CACHE_DIR, the folder of the package or the cache of the user, whichever can be written first,
    and refuses all work where none can. Then a folder in the temporary one is used, for pictures' fonts too. To be
    called before numba is imported. Raises OSError where nothing at all can be written.
    """
    asked = os.environ.get("NUMBA_CACHE_DIR")
    places = [*([Path(asked)] if asked else []), package / "__pycache__", _user_cache() / "numba"]
    if any(_is_writable(place) for place in places):
        return None
    folder = private_folder()
    os.environ["NUMBA_CACHE_DIR"] = str(folder / "numba")
    os.environ.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))
    return (
        f"note: compiled kernels are kept in {folder}, as {' and '.join(str(p) for p in places)} cannot be written; "
        "the environment variable NUMBA_CACHE_DIR names another folder"
    )


def _user_cache() -> Path:
    """The folder in which programs of this user keep caches."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or "~/AppData/Local").expanduser()
    if sys.platform == "darwin":
        return Path(os.path.expanduser("~/Library/Caches"))
    return Path(os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache"))


def _is_writable(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made where it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def private_folder() -> Path:
    """A folder that no other user can write to, the same one every time if possible: the kernels in it are executed."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    folder = Path(tempfile.gettempdir(), f"isph-{user}")
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        ours = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not stat.S_IMODE(found.st_mode) & 0o077)
        if stat.S_ISDIR(found.st_mode) and ours and _is_writable(folder):
            return folder
    import atexit

    once = Path(tempfile.mkdtemp(prefix="isph-"))
    atexit.register(shutil.rmtree, once, ignore_errors=True)
    return once
