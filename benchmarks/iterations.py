"""GMRES iterations of the three systems from 16^3 to 64^3 particles: they ought not to grow.

usage: python benchmarks/iterations.py [POINTS ...]        (16 24 32 48 64)

Poisson and Helmholtz (nu dt / dx^2 = 25) on lattices jittered by 10 %, a smooth and a random right-hand side;
Stokes on the simple-cubic sphere array of solid fraction 0.216. Tolerance 1e-6, support 2.1.
"""

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import time

import numpy as np

from isphcli.case.load import read_case
from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.neighbours import neighbourhood
from isphcli.domain.null_space import ComponentMeans
from isphcli.operators.assemble import assemble
from isphcli.operators.moments import particle_volumes
from isphcli.operators.pair_weights import build_operators
from isphcli.output.clock import Clock
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.solvers.krylov import Limits, gmres
from isphcli.solvers.multigrid import cycle, hierarchy

RADIUS = (3 * 0.216 / (4 * np.pi)) ** (1 / 3)
SPHERES = f"""
geometry:
  box: [1, 1, 1]
  periodic: [x, y, z]
  shapes: [{{sphere: {{centre: [0.5, 0.5, 0.5], radius: {RADIUS}}}, is: solid}}]
particles: {{spacing: SPACING}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
"""


def elliptic(points):
    """{name: (iterations, CPU seconds of the solve)} of the Poisson and Helmholtz systems."""
    axis = (np.arange(points) + 0.5) / points
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    lower, upper, around = np.zeros(3), np.ones(3), np.ones(3, bool)
    x = wrap(x + rng.uniform(-0.1, 0.1, x.shape) / points, lower, upper, around)
    support = 2.1 / points
    images = build_halo(x, lower, upper, around, support)
    table = images.positions(x)
    neighbours = neighbourhood(table, images.owners(len(x)), len(x), 0, support)
    ops = build_operators(neighbours, particle_volumes(neighbours))
    means = ComponentMeans(np.zeros(len(x), np.int32))
    right = np.sin(2 * np.pi * x).prod(axis=1) + 0.1 * rng.standard_normal(len(x))
    found = {}
    for name, shift, project in (("poisson", 0.0, means.remove), ("helmholtz", points**2 / 25.0, lambda v: v)):
        matrix = assemble(ops.start, ops.column, ops.lap, shift, 1.0)
        once = cycle(hierarchy(matrix))
        begin = time.process_time()
        _, report = gmres(lambda v: project(matrix @ v), project(right), lambda v: project(once(v)),  # noqa: B023
                                 Limits(1e-6, 60, 400))
        found[name] = (report.iterations, time.process_time() - begin)
    return found


def stokes(points):
    """(iterations, CPU seconds of the solve, permeability error) of the sphere array."""
    case = read_case(SPHERES.replace("SPACING", str(1 / points)).encode(), "spheres.yaml")
    scene = build_scene(case, build_geometry(case), 1 / points, Clock())
    begin = time.process_time()
    flow = solve_axis(case, scene, 0, np.eye(3)[0], Clock())
    error = flow.permeability[0] * 6 * np.pi * RADIUS * 7.442 - 1
    return flow.convergence.iterations, time.process_time() - begin, error


def main(*points):
    print("points    poisson: its  CPU s   helmholtz: its  CPU s     stokes: its  CPU s  error of k")
    stokes(8)  # compiles
    for n in points or (16, 24, 32, 48, 64):
        found, (its, cpu, error) = elliptic(n), stokes(n)
        print(f"{n:6d} {found['poisson'][0]:15d} {found['poisson'][1]:6.2f} {found['helmholtz'][0]:16d} "
              f"{found['helmholtz'][1]:6.2f} {its:15d} {cpu:6.2f}  {error:+10.2%}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
