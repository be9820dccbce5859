"""What the terms of an interface cost: their share of the CPU seconds of a run, function by function.

usage: python benchmarks/interface_cost.py [CASE] [STEPS]        (cases/rising_bubble.yaml, 150 steps)

The section `terms` of a run holds the shifting too; here the functions that only a scene with two fluids calls are
timed one by one. Run it twice: the first time compiles.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from isphcli import contact_angle, surface_tension, two_fluids
from isphcli.case import load_case
from isphcli.run import run_case

TIMED = (
    (two_fluids, ("crossings", "_weights", "_thickened", "_turn_tensors", "near_interface")),
    (two_fluids.Turn, ("add",)),
    (surface_tension, ("find_band", "_curvature", "average", "_jump")),
    (contact_angle.ContactAngle, ("ghosts",)),
)


def main(case=Path(__file__).parents[1] / "cases/rising_bubble.yaml", steps="150"):
    spent, running = {}, []

    def timed(name, function):
        def call(*args, **kwargs):
            running.append(name)
            start = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                running.pop()
                if not running:  # what is called by another of them counts there
                    spent[name] = spent.get(name, 0.0) + time.process_time() - start

        return call

    for owner, names in TIMED:
        for name in names:
            setattr(owner, name, timed(name, getattr(owner, name)))
    with tempfile.TemporaryDirectory() as folder:
        options = ("output.snapshots=false", "output.plots=false", "reference=null", f"time.max_steps={steps}",
                   f"output.directory={folder}")  # fmt: skip
        cpu = run_case(load_case(case, options), quiet=True)["cpu_seconds"]
    total = cpu["total"] - cpu.get("compile", 0.0)
    for name, seconds in sorted(spent.items(), key=lambda item: -item[1]):
        print(f"  {name:14s} {seconds:6.2f} CPU s  {100 * seconds / total:5.1f} %")
    print(f"{Path(case).stem}, {steps} steps: {100 * sum(spent.values()) / total:.1f} % of {total:.1f} CPU s")


if __name__ == "__main__":
    main(*sys.argv[1:])
