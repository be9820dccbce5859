"""CPU seconds of numba's compiler, function by function, from an empty cache.

usage: PYTHONPATH=. python benchmarks/compile_time.py CASE [KEY=VALUE ...]

Runs a case, best a short one, in this process with a cache of its own that is removed afterwards. To compare with
another version, put its directory in PYTHONPATH.
"""

import collections
import os
import sys
import tempfile
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

from numba.core import config, event

from isphcli import load_case, run

MOST = 20  # functions that are named


class Listener(event.Listener):
    """Seconds of each function without those of what it calls."""

    def __init__(self):
        self.seconds, self.count, self.open = collections.Counter(), collections.Counter(), []

    def on_start(self, event):
        self.open.append([time.process_time(), 0.0])

    def on_end(self, event):
        begin, inner = self.open.pop()
        spent, function = time.process_time() - begin, event.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__name__}"
        self.seconds[name] += spent - inner
        self.count[name] += 1
        if self.open:
            self.open[-1][1] += spent


def main(case, *overrides):
    listener = Listener()
    event.register("numba:compile", listener)
    with tempfile.TemporaryDirectory() as folder:
        config.CACHE_DIR = folder
        run(load_case(case, overrides), quiet=True, check=False)
    print(f"{case}: {sum(listener.seconds.values()):.1f} CPU s for {sum(listener.count.values())} functions")
    for name, seconds in listener.seconds.most_common(MOST):
        print(f"{seconds:7.2f} s  {listener.count[name]:3d} x {name}")


if __name__ == "__main__":
    main(*sys.argv[1:])
