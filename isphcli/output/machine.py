"""Peak memory of the process, and versions of the libraries."""

from __future__ import annotations

import contextlib
import sys

LIBRARIES = ("isphcli", "numpy", "scipy", "numba", "pyamg", "meshio", "matplotlib", "pyyaml", "click", "rich",
             "threadpoolctl", "pillow", "tifffile", "pynrrd", "pint", "pyvista", "psutil")


def peak_memory() -> int:
    """Largest resident size of this process so far, bytes."""
    try:
        # Linux hands ru_maxrss on to a program that is started: it would be that of a notebook behind the run
        with open("/proc/self/status", encoding="utf-8") as status:
            return next(1024 * int(line.split()[1]) for line in status if line.startswith("VmHWM:"))
    except (OSError, StopIteration):
        pass  # not Linux
    try:
        import resource
    except ImportError:  # Windows
        import psutil

        return int(psutil.Process().memory_info().peak_wset)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def versions() -> dict[str, str]:
    """Versions of Python and of the libraries that are installed, read without importing them."""
    from importlib import metadata

    found = {"python": sys.version.split()[0]}
    for name in LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
