"""What moving particles need of memory by the kinds of their pairs, and what the estimate says of it (Linux).

usage: PYTHONPATH=. python benchmarks/moving_memory.py [NAME ...]

Each scene takes three steps in a process of its own. Printed are fluid particles, the neighbours of one (dummies and
what lies behind walls among them), those in sight, the most Krylov vectors that a solve needed, and the peak of the
process above `scene.memory.BYTES_PROGRAM`, bytes a particle, measured and as the check and the run itself say. Run it
twice: compiling takes memory too.
"""

import os
import subprocess
import sys
from pathlib import Path

os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

CASES = Path(__file__).parents[1] / "cases"
STEPS = 3
PACK = ("flow=navier_stokes", "drive={body_force: [0, 1.06, 0]}", f"time={{end: 1, max_steps: {STEPS}}}",
        "solver.tolerance=1e-8")
PUSHED = ("flow=navier_stokes", "drive={body_force: [1.0e-2, 0, 0]}", f"time={{end: 1, max_steps: {STEPS}}}")
SHAPES = "geometry.shapes=[{{sphere: {{centre: [5.0e-4, 5.0e-4, 5.0e-4], radius: {}}}, is: solid}}]"


def corner(voxels):
    return f"geometry.voxels.crop={[[0, voxels]] * 3}"


SCENES = {
    "cube": ("taylor_green_3d.yaml", ("particles.spacing=0.02",)),
    "cube 0.016": ("taylor_green_3d.yaml", ("particles.spacing=0.016",)),
    "spheres 0.216": ("sphere_array.yaml", (*PUSHED, "particles.spacing=1.5625e-5")),
    "spheres 0.45": ("sphere_array.yaml", (*PUSHED, "particles.spacing=1.5625e-5", SHAPES.format(4.754e-4))),
    "berea": ("berea.yaml", (*PUSHED, corner(64))),
    "pack 40": ("bead_pack_table1.yaml", (*PACK, "particles.spacing=2.2e-4")),
    "pack 64": ("bead_pack_table1.yaml", (*PACK, "particles.spacing=1.375e-4")),
    "drop": ("drop_3d.yaml", ("particles.spacing=0.008",)),
    "bubbles": ("co2_bubbles.yaml", ("particles.spacing=1.0e-4",)),
    "drainage": ("berea_drainage.yaml", (corner(48),)),
    "plane": ("taylor_green_2d.yaml", ("particles.spacing=0.002",)),
    "cavity": ("lid_driven_cavity.yaml", ("particles.spacing=0.003",)),
}


def measure(name):
    from isphcli.case.load import load_case
    from isphcli.flow.state import Handover
    from isphcli.output.clock import Clock
    from isphcli.output.machine import peak_memory
    from isphcli.preflight.check import check
    from isphcli.runs.time_loop import TimeLoop
    from isphcli.scene import memory
    from isphcli.scene.build_geometry import build_geometry
    from isphcli.scene.prepare import prepare

    file, sets = SCENES[name]
    steps = () if "flow=navier_stokes" in sets else (f"time.max_steps={STEPS}",)
    case = load_case(CASES / file, ("output.plots=false", "reference=null", *sets, *steps))
    said = check(case).memory
    begin = peak_memory()
    geometry = build_geometry(case)
    told = []
    estimate = memory.estimate
    memory.estimate = lambda *given, **named: told.append(estimate(*given, **named)) or told[-1]
    state, stepper, particles = prepare(case, geometry, Clock())
    memory.estimate = estimate
    loop = TimeLoop(case, stepper, particles.site_volume, 1.0)
    rows = []
    state, config = loop.run(state, Handover(stepper.configure(state.x, state.time, state.phi, state.number)),
                             lambda *_: None, rows.append, lambda *_: None)
    vectors = max(row[f"iterations_{name}"] for row in rows for name in ("velocity", "pressure"))
    n = len(state.x)
    pairs, seen = len(config.neighbours.row) / n, len(config.ops.column) / n
    above = (peak_memory() - memory.BYTES_PROGRAM) / n
    image = said.get("image", 0.0)
    print(f"| {name} | {n:,} | {pairs:.1f} | {seen:.1f} | {seen / pairs:.2f} | {vectors} | {above:.0f} | "
          f"{(sum(said.values()) - memory.BYTES_PROGRAM) / n:.0f} | "
          f"{(sum(told[-1].values()) + image - memory.BYTES_PROGRAM) / n:.0f} | {begin / 1e6:.0f} |", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        measure(sys.argv[-1])
    else:
        print("| scene | particles | neighbours | in sight | share | Krylov vectors | B a particle | by the check | by "
              "the run | MB before |\n|---|---|---|---|---|---|---|---|---|---|", flush=True)
        for scene in sys.argv[1:] or SCENES:
            subprocess.run([sys.executable, __file__, "--one", scene], check=True)
