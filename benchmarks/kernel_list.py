"""Makes isphcli/data/kernels.txt, the list of kernels that `runs/second_compiler.py` compiles beside a run.

usage: PYTHONPATH=. python benchmarks/kernel_list.py
       PYTHONPATH=. python benchmarks/kernel_list.py missing "CASE KEY=VALUE ..." ...

Runs a small case of each scene, in a process with an empty cache (some minutes), and lists the kernels in the order in
which their compilation began. The second form prints what runs call and the list has not.
"""

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

CROP = "geometry.voxels.crop=[[0,32],[0,32],[0,32]]"
RUNS = {  # scene: a case that compiles what such scenes need, small
    "stokes one stairs": ("cases/berea.yaml", CROP),
    "stokes one smooth": ("cases/berea.yaml", CROP, "geometry.wall_distance=smooth"),
    "stokes one exact": ("cases/sphere_array.yaml",),
    "navier_stokes one free": ("cases/taylor_green_2d.yaml",),
    "navier_stokes one exact": ("cases/oscillating_pipe.yaml", "time.max_steps=2"),
    "navier_stokes two free": ("cases/square_drop_1.yaml", "time.max_steps=2"),
    "navier_stokes two exact": ("cases/slit_drainage.yaml", "time.max_steps=2"),
    "navier_stokes two smooth": ("cases/berea_drainage.yaml", CROP, "time.max_steps=2"),
}


def text_of(kind, named):
    """A numba type as `runs/second_compiler.py` reads it; named: {type: (name, line)} of namedtuples, which grows."""
    from numba import types

    if isinstance(kind, (types.NamedTuple, types.NamedUniTuple)):
        if kind not in named:
            inner, cls = texts_of(kind.types, named), kind.instance_class
            module = cls.__module__.partition(".")[2]
            named[kind] = f"T{len(named)}", f"{module} {cls.__name__} {inner}"
        return named[kind][0]
    if isinstance(kind, types.BaseTuple):
        return texts_of(kind.types, named)
    if isinstance(kind, types.Array) and kind.aligned:
        return f"{kind.dtype}[{kind.ndim}, {kind.layout}{'' if kind.mutable else ', R'}]"
    if isinstance(kind, (types.Integer, types.Float, types.Boolean)):
        return str(kind)
    raise TypeError(f"no text for {kind}")


def texts_of(kinds, named):
    return f"({''.join(text_of(kind, named) + ', ' for kind in kinds).removesuffix(' ')})"


def record(case, overrides, named):
    """[(module, name, types)] of the kernels that a run of a case compiles, in the order in which it begins."""
    from numba.core import event

    from isphcli import load_case, run

    begun = []

    class Listener(event.Listener):
        def on_start(self, found):
            kernel = found.data["dispatcher"].py_func
            package, _, module = kernel.__module__.partition(".")
            if package == "isphcli":
                with contextlib.suppress(TypeError):  # a part of another kernel, which compiles it
                    begun.append(f"{module} {kernel.__name__} {texts_of(found.data['args'], named)}")

        def on_end(self, found):
            pass

    with event.install_listener("numba:compile", Listener()):
        run(load_case(case, (*overrides, "output.plots=false")), quiet=True)
    return begun


def merged(orders):
    """One order of what stands in several; what only a later one has follows what it follows there."""
    found = []
    for order in orders:
        place = 0
        for line in order:
            if line not in found:
                found.insert(place, line)
            place = max(place, found.index(line) + 1)
    return found


def main():
    outputs = []
    for case in RUNS.values():
        with tempfile.TemporaryDirectory() as folder:
            settings = {**os.environ, "NUMBA_CACHE_DIR": folder, "NUMBA_NUM_THREADS": "1"}
            command = [sys.executable, __file__, "record", *case]
            outputs.append(json.loads(subprocess.run(command, env=settings, check=True, stdout=subprocess.PIPE).stdout))
        print(case, len(outputs[-1]["kernels"]), "kernels", file=sys.stderr)
    Path("isphcli/data/kernels.txt").write_text(text_of_list(outputs), encoding="utf-8")


def renamed(line, names):
    return re.sub(r"\bT\d+\b", lambda found: names[found[0]], line)


def text_of_list(outputs):
    """The file: names of namedtuples of each run become those of all."""
    tuples, orders = {}, []
    for output in outputs:
        names = {}
        for name, line in output["tuples"]:
            names[name] = tuples.setdefault(renamed(line, names), f"T{len(tuples)}")
        orders.append([renamed(line, names) for line in output["kernels"]])
    letters = "abcdefghijklmnopqrstuvwxyz"[: len(orders)]
    lines = [f"scene {letter} {scene}" for letter, scene in zip(letters, RUNS)]
    lines += [f"tuple {name} {line}" for line, name in tuples.items()]
    for kernel in merged(orders):
        of = "".join(letter for letter, order in zip(letters, orders) if kernel in order)
        lines.append(f"kernel {of} {kernel}")
    return "\n".join(lines) + "\n"


def print_missing(*runs):
    """Kernels that runs in this process call and the list has not; a run: CASE KEY=VALUE ... in one word."""
    from numba.core.dispatcher import Dispatcher

    from isphcli import load_case, run
    from isphcli.runs.second_compiler import listed, scene_of

    known = set()
    for words in runs:
        case, *overrides = words.split()
        found = load_case(case, (*overrides, "output.plots=false"))
        run(found, quiet=True, check=False)
        known |= {(kernel, kinds) for kernel, kinds in listed(scene_of(found))}
    modules = [module for name, module in sys.modules.items() if name.startswith("isphcli.")]
    kernels = {kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}
    for called, kinds in {(kernel, kinds) for kernel in kernels for kinds in kernel.overloads} - known:
        with contextlib.suppress(TypeError):  # a part of another kernel
            print(f"{called.py_func.__module__} {called.py_func.__name__} {texts_of(kinds, {})}")


def print_record(case, *overrides):
    if hasattr(os, "sched_setaffinity"):  # on one core no second process compiles
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    named = {}
    kernels = record(case, overrides, named)
    print(json.dumps({"kernels": kernels, "tuples": list(named.values())}))


if __name__ == "__main__":
    what, *rest = sys.argv[1:] or ["all"]
    {"all": main, "record": print_record, "missing": print_missing}[what](*rest)
