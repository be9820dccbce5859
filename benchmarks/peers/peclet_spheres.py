"""The sphere array by peclet-flow: cut cells on a staggered grid, C++, geometric multigrid.

    python -m venv peers && peers/bin/pip install peclet-flow==1.4.0
    OMP_NUM_THREADS=1 OMP_PROC_BIND=false peers/bin/python benchmarks/peers/peclet_spheres.py 16 32 48

Creeping flow along x through a simple cubic array of spheres. A march in time is stopped where what it still has to
change is within 0.1 % of the mean velocity, by that code's own test. Prints rows as those of isphcli/data/peers.csv:
error of the permeability against Zick and Homsy (1982), table 2, and CPU seconds of set-up and march.
"""

import time

import numpy as np
from peclet import flow
from sphere_array import print_rows, radius_of


def permeability(fraction: float, cells: int) -> tuple[float, float]:
    """k of a cell of side 1, and the CPU seconds that it took."""
    began = time.process_time()
    solver = flow.Solver((cells,) * 3, extent=(1.0, 1.0, 1.0))
    solver.set_rho(1.0)
    solver.set_mu(1.0)
    solver.set_dt(1 / cells**2)  # a cell's time of diffusion; of 0.8 to 2600 of it at 16 cells, the longer the slower
    solver.set_advection(False)
    solver.set_body_force([1.0, 0.0, 0.0])
    x = np.meshgrid(*solver.cell_centers(), indexing="ij")
    distance = np.sqrt(sum((axis - 0.5) ** 2 for axis in x)) - radius_of(fraction)
    solver.set_solid(np.asfortranarray(distance), cutcell_pressure=True)
    found = flow.march_to_steady(solver, lambda: float(solver.get_u().mean()), rtol=1e-3)
    if not found.converged:
        raise SystemExit(f"{fraction} with {cells} cells: {found.reason} after {found.steps} steps")
    return found.monitor, time.process_time() - began


if __name__ == "__main__":
    print_rows("peclet-flow", permeability)
