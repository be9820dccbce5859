"""CPU microseconds a particle and iterations over sizes of one scene: what is flat, and what is not.

usage: PYTHONPATH=. python benchmarks/cost_by_size.py steady [SPACINGS ...]       (32 64 96 128 spacings a cell)
       PYTHONPATH=. python benchmarks/cost_by_size.py moving [POINTS ...]         (32 48 64 96 points across)

steady: the sphere array of solid fraction 0.216, a solve to 1e-6 with its set-up. moving: a step of Taylor-Green 3D at
Re 100, of five after the first two (benchmarks/step_cost.py), with the iterations of the pressure of the last one. Each
size runs in a process of its own, one thread; size 16 comes first, which compiles and is not printed.
"""

import os
import subprocess
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

SIZES = {"steady": (32, 64, 96, 128), "moving": (32, 48, 64, 96)}
STEPS = 5  # of moving particles
PARTS = "geometry", "operators", "assembly", "preconditioner", "krylov"  # of a steady solve, as the run names them


def steady(points):
    from stokes import CASES, spheres

    from isphcli.case.forcing import drives
    from isphcli.case.load import load_case
    from isphcli.output.clock import Clock
    from isphcli.runs.steady import build_scene, solve_axis
    from isphcli.scene.build_geometry import build_geometry

    file, sets = spheres(points, 3.7221029454e-4)
    case, clock = load_case(CASES / file, sets), Clock()
    geometry = build_geometry(case)
    scene = build_scene(case, geometry, case.particles.spacing, clock)
    flow = solve_axis(case, scene, *drives(case, geometry)[0], clock)
    spent, n, its = clock.cpu(), scene.particles.n_fluid, flow.convergence.iterations
    whole = sum(spent[part] for part in PARTS)
    print(f"{points:4d} {n:10,} {its:5d} {1e6 * whole / n:8.2f} {1e6 * spent['krylov'] / n / its:14.3f}    "
          + " ".join(f"{1e6 * spent[part] / n:14.2f}" for part in PARTS), flush=True)


def moving(points):
    from step_cost import SCENES, measured

    n, spent, solves, _ = measured(points, STEPS, SCENES["vortex"])
    scale = 1e6 / (n * STEPS)
    print(f"{points:4d} {n:10,} {solves['pressure']:5d} {scale * spent['total']:8.2f} "
          + " ".join(f"{name} {scale * seconds:.2f}" for name, seconds in spent.items() if name != "total"), flush=True)


def main(kind, *sizes):
    print("size  particles   its  us each " + (f"{'an iteration':>14}    " + " ".join(f"{part:>14}" for part in PARTS)
                                               if kind == "steady" else "and step, of which"), flush=True)
    for size in (16, *(sizes or SIZES[kind])):
        done = subprocess.run([sys.executable, __file__, "--one", kind, str(size)], check=True, stdout=subprocess.PIPE,
                              text=True)
        if size != 16:
            print(done.stdout, end="", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        {"steady": steady, "moving": moving}[sys.argv[2]](int(sys.argv[3]))
    else:
        main(*sys.argv[1:])
