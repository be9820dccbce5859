"""Iterations, CPU seconds and peak memory of steady solves, each in a process of its own.

usage: PYTHONPATH=. python benchmarks/stokes.py [NAME ...]

Solid fractions 0.216 and 0.45 of simple-cubic spheres, a square duct, corners of the Berea cube (c64: 64^3 voxels; h32:
32^3 at half the spacing), the whole cube, the coarse bead pack and an eighth of the first row of the paper's table 1.
Tolerance 1e-6. To compare with another version, put its directory in PYTHONPATH: only `build_scene` and `solve_axis`
are used.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

CASES = Path(__file__).parents[1] / "cases"


def spheres(points, radius):
    shape = f"[{{sphere: {{centre: [5.0e-4, 5.0e-4, 5.0e-4], radius: {radius}}}, is: solid}}]"
    return "sphere_array.yaml", [f"particles.spacing={1e-3 / points}", f"geometry.shapes={shape}"]


def corner(first, end, spacing):
    return "berea.yaml", [f"geometry.voxels.crop={[[first, end]] * 3}", f"particles.spacing={spacing}"]


SCENES = {
    **{f"spheres 0.216 {n}": spheres(n, 3.7221029454e-4) for n in (16, 32, 64)},
    **{f"spheres 0.45 {n}": spheres(n, 4.7540e-4) for n in (16, 32, 64)},
    **{f"duct {n}": ("square_duct.yaml", [f"particles.spacing={8e-5 / n}"]) for n in (16, 32, 64)},
    "berea c64": corner(0, 64, 3e-6),
    "berea h64": corner(0, 64, 1.5e-6),
    "bead pack": ("bead_pack.yaml", []),
    "table 1 64": ("bead_pack_table1.yaml", ["particles.spacing=1.375e-4"]),
    "berea": ("berea.yaml", []),
}


def measure(name):
    from isphcli.case.forcing import drives
    from isphcli.case.load import load_case
    from isphcli.output.clock import Clock
    from isphcli.output.machine import peak_memory
    from isphcli.runs.steady import build_scene, solve_axis
    from isphcli.scene.build_geometry import build_geometry

    file, sets = SCENES[name]
    case = load_case(CASES / file, sets)
    begin = time.process_time()
    geometry = build_geometry(case)
    scene = build_scene(case, geometry, case.particles.spacing, Clock())
    middle = time.process_time()
    axis, force = drives(case, geometry)[0]
    axis = 0 if axis is None else axis
    flow = solve_axis(case, scene, axis, force, Clock())
    end = time.process_time()
    print(f"{name:16} {scene.particles.n_fluid:9,} {flow.convergence.iterations:5d} {middle - begin:9.2f} "
          f"{end - middle:9.2f} {peak_memory() / 1e9:8.2f}  {flow.permeability[axis]:.6e}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        measure(sys.argv[2])
    else:
        print("scene            particles   its  set-up s   solve s  peak GB  permeability", flush=True)
        for scene in sys.argv[1:] or SCENES:
            subprocess.run([sys.executable, __file__, "--one", scene], check=True)
