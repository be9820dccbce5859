"""Where a steady solve needs its memory: resident bytes per particle during and after its parts (Linux).

usage: PYTHONPATH=. python benchmarks/memory.py [NAME ...]
       PYTHONPATH=. mpiexec -n 2 python benchmarks/memory.py NAME       on several processes: of rank 0, and the peaks

Scenes are those of benchmarks/stokes.py. Each part is a call of a function: the most that the process held in it, and
what it holds after it, both less what it held before particles were placed. Run it twice: compiling takes memory too.
"""

import os
import subprocess
import sys

from stokes import CASES, SCENES

from isphcli.output.environment import launched

PARTS = """runs.steady.place_case runs.steady.WallScene operators.wall_scene.build_halo
operators.wall_scene.neighbourhood operators.wall_scene.crossings runs.steady.build_lattice_weights
runs.steady._percolation
flow.stokes.pair_components flow.stokes.nearest_matrix flow.stokes.Conductances
solvers.engine.hierarchy solvers.engine.BlockCycle solvers.engine.PairCycle runs.steady.fluid_cells
runs.steady.means_over_cells solvers.engine.gmres_from_the_right runs.steady.wall_stress""".split()
PARTS_OF_PETSC = """solvers.petsc.Petsc._aij solvers.petsc._Cycle solvers.petsc.Petsc.gmres""".split()


def resident():
    """(most since the last call, now), bytes."""
    with open("/proc/self/status", encoding="utf-8") as file:
        found = {line.split()[0]: line.split()[1] for line in file if line.startswith("Vm")}
    with open("/proc/self/clear_refs", "w", encoding="utf-8") as file:
        file.write("5")
    return 1024 * int(found["VmHWM:"]), 1024 * int(found["VmRSS:"])


def watched(name, function, rows):
    def call(*arguments, **named):
        rows.append(("before", *resident()))
        result = function(*arguments, **named)
        rows.append((name, *resident()))
        return result

    return call


def measure(name):
    import importlib

    from isphcli.case.forcing import drives
    from isphcli.case.load import load_case
    from isphcli.domain.communicator import join
    from isphcli.output.clock import Clock
    from isphcli.runs import steady
    from isphcli.scene.build_geometry import build_geometry

    ranks, rows = join(launched()), []
    for part in PARTS + (PARTS_OF_PETSC if ranks.size > 1 else []):
        *module, function = part.split(".")
        holder = importlib.import_module(f"isphcli.{'.'.join(module[:2])}")
        for name_of_class in module[2:]:
            holder = getattr(holder, name_of_class)
        setattr(holder, function, watched(part, getattr(holder, function), rows))
    file, sets = SCENES[name]
    case = load_case(CASES / file, sets)
    geometry = build_geometry(case)
    begin = resident()[1]
    scene = steady.build_scene(case, geometry, case.particles.spacing, Clock())
    axis, force = drives(case, geometry)[0]
    flow = steady.solve_axis(case, scene, axis, force, Clock())
    rows.append(("the end", *resident()))
    n, most = scene.particles.n_fluid, max(most for _, most, _ in rows)
    peaks = ranks.collect((n, most))
    if ranks.rank:
        return
    print(f"{name}: {n:,} particles, {scene.particles.n_dummy / n:.2f} dummies and "
          f"{len(scene.system.ops.column) / n:.1f} pairs a particle, {flow.convergence.iterations} iterations, k "
          f"{flow.permeability[axis or 0]:.7e} m2, whole process {most / 1e9:.2f} GB, {begin / 1e9:.2f} of it before; "
          f"bytes per particle:\n{'':42}    most     after")
    for part, most, now in rows:
        if part != "before":
            print(f"{part:42} {(most - begin) / n:9.0f} {(now - begin) / n:9.0f}", flush=True)
    if ranks.size > 1:
        print("particles and GB of all:", ", ".join(f"{n:,} {peak / 1e9:.3f}" for n, peak in peaks))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"] or launched() > 1:
        measure(sys.argv[-1])
    else:
        os.environ.setdefault("NUMBA_NUM_THREADS", "1")
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        for scene in sys.argv[1:] or ["spheres 0.216 64", "berea c64"]:
            subprocess.run([sys.executable, __file__, "--one", scene], check=True)
