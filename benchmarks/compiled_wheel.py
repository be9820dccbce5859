"""Whether a wheel that holds compiled kernels spares those who install it the compiler, and what it weighs.

usage: PYTHONPATH=. NUMBA_CPU_NAME=x86-64-v3 python benchmarks/compiled_wheel.py CASE [KEY=VALUE ...]

Runs a case, best a short one, with a copy of the package whose folder takes the kernels; packs that copy as a wheel;
installs it with pip (without its dependencies, which this Python has) into an empty folder; and runs the case there.
NUMBA_CPU_NAME: the processor that is compiled for, which is a part of the key of each kernel; without it, this one.
"""

import base64
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from isphcli.output.environment import BLAS_THREADS

PACKAGE = Path(__file__).parents[1] / "isphcli"
TAG = f"cp{sys.version_info.major}{sys.version_info.minor}"
RUN = """
import os, sys
if hasattr(os, "sched_setaffinity"): os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # one compiler
from numba.core import event
from isphcli import load_case, run
import isphcli
count = []
class Listener(event.Listener):
    def on_start(self, event): count.append(1)
    def on_end(self, event): pass
event.register("numba:compile", Listener())
found = run(load_case(sys.argv[1], sys.argv[2:]), quiet=True, check=False)
print(f"{len(count)} functions compiled, {found.summary['cpu_seconds'].get('compile', 0.0):.1f} CPU s compile or load")
"""


def ran(folder, words):
    """The last line of a run of the package in a folder."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(folder), "NUMBA_NUM_THREADS": "1", **dict.fromkeys(BLAS_THREADS, "1")}
    done = subprocess.run([sys.executable, "-c", RUN, *words], env=environment, check=True, capture_output=True,
                          text=True, cwd=folder)
    return done.stdout.splitlines()[-1]


def packed(folder, name, kernels):
    """A wheel of the package in a folder, with or without its kernels."""
    path, rows = folder / f"isphcli-0.0-{name}.whl", []
    files = {str(p.relative_to(folder)): p.read_bytes() for p in sorted((folder / "isphcli").rglob("*"))
             if p.is_file() and p.suffix != ".pyc" and (kernels or p.suffix not in (".nbi", ".nbc"))}
    info = "isphcli-0.0.dist-info"
    files[f"{info}/METADATA"] = b"Metadata-Version: 2.1\nName: isphcli\nVersion: 0.0\n"
    files[f"{info}/WHEEL"] = f"Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: {name}\n".encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for inside, data in files.items():
            wheel.writestr(inside, data)
            hashed = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
            rows.append(f"{inside},sha256={hashed},{len(data)}")
        wheel.writestr(f"{info}/RECORD", "\n".join([*rows, f"{info}/RECORD,,"]) + "\n")
    return path


def main(case, *overrides):
    with tempfile.TemporaryDirectory() as place:
        folder, site = Path(place) / "source", Path(place) / "site"
        shutil.copytree(PACKAGE, folder / "isphcli", ignore=shutil.ignore_patterns("__pycache__"))
        words = [str(Path(case).resolve()), *overrides, "output.plots=false"]
        print(f"source:   {ran(folder, words)}")
        plain = packed(folder, "py3-none-any", False).stat().st_size
        wheel = packed(folder, f"{TAG}-{TAG}-linux_x86_64", True)
        weight = wheel.stat().st_size
        pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", str(site)]
        subprocess.run([*pip, str(wheel)], check=True)
        shutil.rmtree(folder)
        print(f"wheel:    {ran(site, words)}")
        kernels = [p.stat().st_size for p in site.rglob("*.nb[ci]")]
        print(f"wheel of {plain / 1e6:.1f} MB without and {weight / 1e6:.1f} MB with {len(kernels)} files of kernels, "
              f"{sum(kernels) / 1e6:.1f} MB")


if __name__ == "__main__":
    main(*sys.argv[1:])
