"""CPU seconds of numba's compiler, function by function and pass by pass, from an empty cache.

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
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler_machinery import PassManager

from isphcli import load_case, run

MOST = 20  # functions, and passes, that are named
# what LLVM does, in numba's own methods
LLVM = {"_optimize_functions": "LLVM, functions", "_optimize_final_module": "LLVM, modules",
        "_finalize_final_module": "LLVM, machine code", "add_ir_module": "text of LLVM, written and read"}


class Stopwatch:
    """Seconds of each name without those of what begins in it."""

    def __init__(self):
        self.seconds, self.count, self.open = collections.Counter(), collections.Counter(), []

    def begin(self):
        self.open.append([time.process_time(), 0.0])

    def end(self, name):
        begin, inner = self.open.pop()
        spent = time.process_time() - begin
        self.seconds[name] += spent - inner
        self.count[name] += 1
        if self.open:
            self.open[-1][1] += spent

    def name_of_pass(self, cls, method, name):
        """Times a method of a class; name: of what it does, a function of its arguments."""
        held = getattr(cls, method)

        def timed(*arguments, **options):
            self.begin()
            try:
                return held(*arguments, **options)
            finally:
                self.end(name(*arguments))

        setattr(cls, method, timed)


class Listener(event.Listener):
    def __init__(self):
        self.functions = Stopwatch()

    def on_start(self, event):
        self.functions.begin()

    def on_end(self, event):
        function = event.data["dispatcher"].py_func
        self.functions.end(f"{function.__module__}.{function.__name__}")


def main(case, *overrides):
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # no second process compiles on one core
    listener, passes = Listener(), Stopwatch()
    event.register("numba:compile", listener)
    passes.name_of_pass(PassManager, "_runPass", lambda manager, index, which, *_: which.name())
    for method, words in LLVM.items():
        passes.name_of_pass(CPUCodeLibrary, method, lambda *_, words=words: words)
    with tempfile.TemporaryDirectory() as folder:
        config.CACHE_DIR = folder
        run(load_case(case, overrides), quiet=True, check=False)
    functions = listener.functions
    print(f"{case}: {sum(functions.seconds.values()):.1f} CPU s for {sum(functions.count.values())} functions")
    for found in (functions, passes):
        for name, seconds in found.seconds.most_common(MOST):
            print(f"{seconds:7.2f} s  {found.count[name]:3d} x {name}")


if __name__ == "__main__":
    main(*sys.argv[1:])
