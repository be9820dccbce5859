"""What steps beyond the capillary limit cost in accuracy: error and CPU seconds of the drops and waves of cases/.

usage: python benchmarks/capillary_steps.py [CASE ...]        (seven of cases/; a case is run with three limits)
"""

import sys
import tempfile
from pathlib import Path

from measuring import QUIET  # sets the number of threads before numba is there

from isphcli.case.load import load_case
from isphcli.runs.run import run_case

FOLDER = Path(__file__).parents[1] / "cases"
NAMES = ("square_drop_1", "square_drop_4", "oscillating_drop", "capillary_wave", "drop_wall_60", "rising_bubble",
         "drop_3d")
FACTORS = (1, 2, 4)


def main(*cases):
    print("case               time.capillary  steps   CPU s   error of the reference   largest speed, mu u / sigma")
    for path in map(Path, cases or [FOLDER / f"{name}.yaml" for name in NAMES]):
        for factor in FACTORS:
            with tempfile.TemporaryDirectory() as folder:
                found = run_case(load_case(path, (*QUIET, f"time.capillary={factor}", f"output.directory={folder}")),
                                 quiet=True)
            errors, cpu = found["errors"], found["cpu_seconds"]
            print(f"{path.stem:18s} {factor:14d} {found['steps']:6d} {cpu['total'] - cpu.get('compile', 0.0):7.1f}   "
                  f"{errors[errors['main']]:+.4f} {errors['main']:25s} "
                  f"{found['two_fluids']['peak_capillary_number']:.1e}",
                  flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
