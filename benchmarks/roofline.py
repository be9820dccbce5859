"""Bytes per second of the kernels against the triad a = b + s c on the same machine, one thread.

usage: PYTHONPATH=. python benchmarks/roofline.py [SCENE ...]        (moving 48, spheres 0.216 64, berea c64)

A scene is one of benchmarks/stokes.py, set up and solved, or `moving POINTS`, five steps of benchmarks/step_cost.py.
The bytes of a call are those of the arrays that it is given, each once, as if nothing fell out of the cache between two
uses: a lower bound of what it moves. Left out are kernels with less
than 1 % of the time of all, and those of the Krylov basis, which is given whole and is rarely full.
"""

import collections
import inspect
import os
import subprocess
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
from numba import njit

SIZE = 8_000_000  # entries of the triad's arrays: 64 MB each, beyond every cache
LEAST = 0.01


@njit
def triad(a, b, c):
    for k in range(len(a)):
        a[k] = b[k] + 3.0 * c[k]


def bandwidth():
    """Bytes per second of the triad, the median of nine."""
    a, b, c = np.zeros(SIZE), np.ones(SIZE), np.ones(SIZE)
    seconds = []
    for _ in range(10):
        begin = time.process_time()
        triad(a, b, c)
        seconds.append(time.process_time() - begin)
    return 24 * SIZE / np.median(seconds[1:])


def arrays(arguments):
    """Arrays in nested tuples, by their places in memory."""
    found = {}
    for value in arguments:
        if isinstance(value, tuple):
            found |= arrays(value)
        elif isinstance(value, np.ndarray):
            found[value.__array_interface__["data"][0]] = value.nbytes
    return found


class Kernels:
    """CPU seconds and bytes of each kernel that loops over rows or blocks."""

    def __init__(self):
        from isphcli.domain import row_threads

        self.seconds, self.bytes, plain = collections.Counter(), collections.Counter(), row_threads._share_out

        def timed(call, ranges, threads):
            begin = time.process_time()
            found = plain(call, ranges, threads)
            spent, given = time.process_time() - begin, inspect.getclosurevars(call).nonlocals
            function = getattr(given["kernel"], "py_func", None)
            if function is not None:
                name = f"{function.__module__.split('.', 1)[1]}.{function.__name__}"
                self.seconds[name] += spent
                self.bytes[name] += sum(arrays((*given["arguments"], given.get("edges"))).values())
            return found

        row_threads._share_out = timed

    def clear(self):
        self.seconds.clear()
        self.bytes.clear()


def run(scene):
    """(Kernels, CPU seconds of everything) of a scene, the second time: the first compiles."""
    kernels = Kernels()
    for _ in range(2):
        kernels.clear()
        begin = time.process_time()
        if scene.startswith("moving"):
            import step_cost

            step_cost.main(int(scene.split()[1]), 5)
        else:
            import stokes

            stokes.measure(scene)
        total = time.process_time() - begin
    return kernels, total


def main(scene):
    most = bandwidth()
    kernels, total = run(scene)
    inside = sum(kernels.seconds.values())
    print(f"{scene}: triad {most / 1e9:.1f} GB/s, {100 * inside / total:.0f} % of {total:.1f} CPU s in kernels")
    for name, seconds in kernels.seconds.most_common():
        if seconds > LEAST * total and "krylov_basis" not in name:
            rate = kernels.bytes[name] / seconds
            print(f"  {name:52} {100 * seconds / total:5.1f} %  {rate / 1e9:6.2f} GB/s  {100 * rate / most:4.0f} %")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        main(sys.argv[2])
    else:
        for name in sys.argv[1:] or ["moving 48", "spheres 0.216 64", "berea c64"]:
            subprocess.run([sys.executable, __file__, "--one", name], check=True)
