"""The Taylor-Green vortex in 2D by PySPH's implicit incompressible scheme.

    python -m venv peers && peers/bin/pip install pysph==1.0b2
    OMP_NUM_THREADS=1 peers/bin/python benchmarks/peers/pysph_taylor_green.py 25 50

Reynolds number 100, to t = 0.5 U / L, from particles moved by up to a fifth of a spacing, as in
cases/taylor_green_2d_re100.yaml: the example that PySPH comes with and its own steps. It needs a C++ compiler. Prints
rows as those of isphcli/data/peers.csv: relative L2 error of the velocity at the end, and CPU seconds of the run after
the first one, which compiles.
"""

import sys
import tempfile
import time
from importlib.metadata import version

import numpy as np
from pysph.examples.taylor_green import TaylorGreen, exact_solution
from pysph.solver.utils import load

REYNOLDS, END, JITTER = 100, 0.5, 0.2


def run(points: int, end: float, folder: str) -> str:
    """The last file that a run writes."""
    app = TaylorGreen(fname="taylor_green")
    app.run(["--scheme=isph", f"--nx={points}", f"--re={REYNOLDS}", f"--tf={end}", f"--perturb={JITTER}",
             "--no-openmp", "--disable-output", "-d", folder])  # fmt: skip
    return app.output_files[-1]


def main(sizes: list[int]) -> None:
    """Prints a row for each number of points along a side."""
    for points in sizes:
        with tempfile.TemporaryDirectory() as folder:
            run(points, 1e-6, folder)  # compiles
        with tempfile.TemporaryDirectory() as folder:
            began = time.process_time()
            found = load(run(points, END, folder))
            seconds = time.process_time() - began
            fluid, t = found["arrays"]["fluid"], found["solver_data"]["t"]
            exact = np.array(exact_solution(1.0, -8 * np.pi**2 / REYNOLDS, t, fluid.x, fluid.y)[:2])
            error = np.linalg.norm([fluid.u, fluid.v] - exact) / np.linalg.norm(exact)
            print(f"PySPH ISPH,{version('pysph')},taylor_green,reynolds={REYNOLDS};time={END};jitter={JITTER},{points},"
                  f"velocity_relative_l2,{error:.4g},{seconds:.3g}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main([int(size) for size in sys.argv[1:]] or [25, 50])
