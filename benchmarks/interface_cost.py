"""What the terms of an interface cost: their share of the CPU seconds of a run, function by function.

usage: python benchmarks/interface_cost.py [CASE] [STEPS]        (cases/rising_bubble.yaml, 150 steps)

The section `terms` of a run holds the shifting too; here the functions that only a scene with two fluids calls are
timed one by one, in a second run: the first one, of a step, compiles or loads the kernels.
"""

import sys
import tempfile
from pathlib import Path

from measuring import QUIET, Timed  # sets the number of threads before numba is there

from isphcli.case.load import load_case
from isphcli.runs.run import run_case
from isphcli.two_phase import kinks, surface_tension, transposed_stress, two_fluids

TIMED = (
    (two_fluids, ("find_interface", "cut", "carried", "kept_volumes", "strain", "_weigh_viscous", "_weigh_pressure",
                  "_add_viscosity")),
    (transposed_stress, ("_tensors",)),
    (transposed_stress.TransposedStress, ("add",)),
    (surface_tension, ("_jump",)),
    (kinks, ("_slope_weights", "_put_slopes", "_sums_along", "_divergence")),
)


def main(case=Path(__file__).parents[1] / "cases/rising_bubble.yaml", steps="150"):
    timed = {}
    for owner, names in TIMED:
        for name in names:  # none of them calls another by the name that is replaced
            timed[name] = Timed(getattr(owner, name))
            setattr(owner, name, timed[name])
    for count in ("1", steps):
        for part in timed.values():
            part.seconds = 0.0
        with tempfile.TemporaryDirectory() as folder:
            options = (*QUIET, "reference=null", f"time.max_steps={count}", f"output.directory={folder}")
            cpu = run_case(load_case(case, options), quiet=True)["cpu_seconds"]
    total = cpu["total"] - cpu.get("compile", 0.0)
    for name, part in sorted(timed.items(), key=lambda item: -item[1].seconds):
        print(f"  {name:14s} {part.seconds:6.2f} CPU s  {100 * part.seconds / total:5.1f} %")
    whole = sum(part.seconds for part in timed.values())
    print(f"{Path(case).stem}, {steps} steps: {100 * whole / total:.1f} % of {total:.1f} CPU s")


if __name__ == "__main__":
    main(*sys.argv[1:])
