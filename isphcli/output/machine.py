"""Files that a run leaves: snapshots and their time series, the history, the summary; and the stopwatch.

Plain arrays and dictionaries in, files out. Two rules hold for every writer here: a file appears whole
or not at all (it is written beside itself and renamed), and NaN or infinity never reaches a file.
`docs/output.md` describes every file, column and key.
"""

from __future__ import annotations

import contextlib
import sys

LIBRARIES = ("isphcli", "numpy", "scipy", "numba", "pyamg", "meshio", "matplotlib", "pyyaml", "click", "rich")


def peak_memory() -> int | None:
    """Largest resident size of this process so far, bytes; None where the system does not tell (Windows)."""
    try:
        import resource
    except ImportError:
        return None
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
