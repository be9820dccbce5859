"""The sphere array by lbmpy: lattice-Boltzmann, D3Q19, two relaxation times, C that is generated and compiled.

    python -m venv peers && peers/bin/pip install lbmpy==1.3.7
    OMP_NUM_THREADS=1 peers/bin/python benchmarks/peers/lbmpy_spheres.py 16 32

Creeping flow along x through a simple cubic array of spheres; walls by bounce-back, half way between nodes; magic
number 3/16, viscosity 1/6 in lattice units. A run ends where the mean velocity changes by less than 1e-5 of itself in a
hundredth of the time of diffusion across the cell. Prints rows as those of isphcli/data/peers.csv: error of the
permeability against Zick and Homsy (1982), table 2, and CPU seconds of the steps, compilation left out.
"""

import time

import numpy as np
from lbmpy import LBMConfig, LBStencil, Method, Stencil
from lbmpy.boundaries import NoSlip
from lbmpy.lbstep import LatticeBoltzmannStep
from lbmpy.relaxationrates import relaxation_rate_from_lattice_viscosity
from sphere_array import print_rows, radius_of

VISCOSITY = 1 / 6  # lattice units
FORCE = 1e-6  # lattice units; Reynolds numbers below 0.1 with 64 nodes


def permeability(fraction: float, nodes: int) -> tuple[float, float]:
    """k over the square of the cell, and the CPU seconds that its steps took."""
    even = relaxation_rate_from_lattice_viscosity(VISCOSITY)
    odd = 1 / (3 / 16 / (1 / even - 0.5) + 0.5)  # magic number 3/16
    config = LBMConfig(stencil=LBStencil(Stencil.D3Q19), method=Method.TRT, relaxation_rates=[even, odd],
                       force=(FORCE, 0, 0), compressible=False)  # fmt: skip
    scene = LatticeBoltzmannStep(domain_size=(nodes,) * 3, periodicity=(True,) * 3, lbm_config=config)
    radius = radius_of(fraction) * nodes

    def solid(*x: np.ndarray) -> np.ndarray:
        return sum((axis - nodes / 2) ** 2 for axis in x) < radius**2

    scene.boundary_handling.set_boundary(NoSlip(), mask_callback=solid)
    fluid = ~solid(*np.meshgrid(*[np.arange(nodes) + 0.5] * 3, indexing="ij"))
    block = max(int(0.01 * nodes**2 / VISCOSITY), 10)  # k needs about a tenth of the time of diffusion
    scene.run(1)  # compiles
    began, before = time.process_time(), 0.0
    while True:
        scene.run(block)
        mean = float(np.asarray(scene.velocity[:, :, :, 0])[fluid].sum()) / nodes**3
        if abs(mean - before) < 1e-5 * abs(mean):
            return VISCOSITY * mean / FORCE / nodes**2, time.process_time() - began
        before = mean


if __name__ == "__main__":
    print_rows("lbmpy", permeability)
