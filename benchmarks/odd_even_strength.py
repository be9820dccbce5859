"""Iterations and permeability of steady solves over the strength of the odd-even term, TAU of isphcli/flow/stokes.py.

usage: PYTHONPATH=. python benchmarks/odd_even_strength.py

Simple-cubic arrays of spheres of solid fraction 0.216 and 0.45, 16 spacings a cell, against Zick and Homsy (1982), and
a corner of 32^3 voxels of the Berea cube at one particle per voxel, against its own k at the TAU of the program. The
last column is the part of the pressure that alternates from particle to particle: the root mean square of
sum_j w_ij [p_j - p_i - (grad p_i + grad p_j) . x_ji / 2] times dx^2, over that of the pressure.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
from stokes import CASES, SCENES, corner

from isphcli.case.forcing import drives
from isphcli.case.load import load_case
from isphcli.flow import stokes
from isphcli.operators.lattice_weights import divergence_and_rhie_chow
from isphcli.output.clock import Clock
from isphcli.references.arrays import sphere_array_permeability
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry

STRENGTHS = (0.0125, 0.025, 0.05, 0.1, 0.2)


def rows(name, file, sets, truth):
    case = load_case(CASES / file, sets)
    geometry = build_geometry(case)
    scene = build_scene(case, geometry, case.particles.spacing, Clock())
    force, dx, found = drives(case, geometry)[0][1], case.particles.spacing, {}
    for tau in STRENGTHS:
        stokes.TAU = tau
        flow = solve_axis(case, scene, 0, force, Clock())
        ops, p = scene.system.ops, flow.pressure
        odd = divergence_and_rhie_chow(ops, np.zeros((len(p), 3)), (p, ops.gradient_p(p)), (0.0, dx * dx))
        found[tau] = flow.convergence.iterations, flow.permeability[0], np.sqrt(np.mean(odd**2) / np.mean(p**2))
    truth = truth or found[0.05][1]
    for tau, (iterations, k, odd) in found.items():
        print(f"| {name} | {tau} | {iterations} | {100 * (k / truth - 1):+.3f} % | {odd:.1e} |")


if __name__ == "__main__":
    print("| scene | TAU | iterations | k | odd-even |\n|---|---|---|---|---|")
    rows("spheres 0.216", *SCENES["spheres 0.216 16"], sphere_array_permeability(0.216, 1e-3))
    rows("spheres 0.45", *SCENES["spheres 0.45 16"], sphere_array_permeability(0.45, 1e-3))
    rows("Berea 32^3", *corner(0, 32, 3e-6), None)
