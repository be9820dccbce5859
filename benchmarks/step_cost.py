"""CPU time a particle and step of moving particles in 3D, with its split.

usage: python benchmarks/step_cost.py [POINTS] [STEPS] [SCENE]        (48 points across, 12 steps, vortex)

vortex: Taylor-Green at Re 100; walls: past spheres that nearly touch; drop: ten times as dense as what it sinks in;
pack: the beads of cases/bead_pack.yaml, with a spacing of 1 cm over POINTS (62: 100,000 particles). The default
support, solver tolerance of the case language. Compilation, the first
configuration, files and the first two steps (which find the pressure and the hierarchy) are left out; the steps after
that hold their share of hierarchy rebuilds. For comparison: implicit-sph (LAMMPS + Trilinos 13.2), Taylor-Green 3D
32^3, took 166 us per particle and step with 107 neighbours (built and run once for this project, before 2026-11-22).
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from isphcli.case.load import read_case
from isphcli.flow.state import Handover
from isphcli.output.clock import Clock
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

CASE = """
geometry: {{box: [1, 1, 1], periodic: [x, y, z]}}
particles: {{spacing: {spacing}}}
fluids: {{water: {{density: 1, kinematic_viscosity: 0.01}}}}
initial: {{velocity: ["sin(2*pi*x)*cos(2*pi*y)*cos(2*pi*z)", "-cos(2*pi*x)*sin(2*pi*y)*cos(2*pi*z)", "0"]}}
time: {{end: 10}}
"""
WALLS = """
geometry:
  box: [1, 1, 1]
  periodic: [x, y, z]
  shapes: [{{sphere: {{centre: [0.5, 0.5, 0.5], radius: 0.48}}, is: solid}}]
particles: {{spacing: {spacing}}}
fluids: {{water: {{density: 1, kinematic_viscosity: 0.01}}}}
drive: {{body_force: [1, 0, 0]}}
time: {{end: 10}}
"""
DROP = """
geometry:
  box: [1, 1, 1]
  periodic: [x, y, z]
  fluid: oil
  shapes: [{{sphere: {{centre: [0.5, 0.5, 0.5], radius: 0.3}}, is: water}}]
particles: {{spacing: {spacing}}}
fluids: {{oil: {{density: 1, viscosity: 0.01}}, water: {{density: 10, viscosity: 0.1}}}}
interface: {{tension: 1}}
drive: {{body_force: [0, 0, -1]}}
time: {{end: 10}}
"""
BEADS = Path(__file__).parents[1] / "cases/data/bead_centres.csv"
PACK = f"""
geometry:
  box: [8.9e-3, 14.38e-3, 8.9e-3]
  origin: [-4.45e-3, -7.19e-3, -4.45e-3]
  periodic: [y]
  shapes:
    - {{{{spheres: {{{{file: {BEADS}, radius: 2.5e-4}}}}, is: solid}}}}
    - {{{{cylinder: {{{{axis: y, radius: 4.4e-3, centre: [0, 0, 0]}}}}, outside: true, is: solid}}}}
particles: {{{{spacing: {{spacing}}e-2}}}}
fluids: {{{{water: {{{{density: 1000, viscosity: 1.0e-3}}}}}}}}
drive: {{{{body_force: [0, 0.1, 0]}}}}
time: {{{{end: 10}}}}
"""
# Text of each scene, and the length of a step over the spacing: CFL 0.2 from the start, no growing first steps
SCENES = {"vortex": (CASE, 0.2), "walls": (WALLS, 0.1), "drop": (DROP, 0.05), "pack": (PACK, 0.006)}
PEER = 166.0


def measured(points, steps, scene):
    """(particles, CPU seconds by section, iterations of the last step by solve, neighbours a particle)."""
    text, step = scene
    case = read_case(text.format(spacing=1.0 / points).encode(), "step_cost.yaml")
    geometry = build_geometry(case)
    state, stepper, particles = prepare(case, geometry, Clock())
    ready = stepper.ready(state)
    clock, iterations = None, []
    for k in range(steps + 2):
        if k == 2:
            clock = stepper.solvers.clock = Clock()
        dt = step / points
        found = stepper.advance(state, ready, dt)
        state, ready = found.state, Handover(found.config)
        if k >= 2:
            iterations.append({name: r.iterations for name, r in found.solves.items()})
    return (particles.n_fluid, clock.cpu(), iterations[-1],
            len(ready.look().ops.column) / particles.n_fluid)


def main(points=48, steps=12, scene="vortex"):
    n, spent, iterations, neighbours = measured(points, steps, SCENES[scene])
    scale = 1e6 / (n * steps)
    print(f"{n} particles, {steps} steps, {neighbours:.0f} neighbours, iterations {iterations}")
    for name, seconds in spent.items():
        print(f"  {name:15s} {seconds * scale:7.2f} us per particle and step")
    if scene == "vortex":
        print(f"ratio to implicit-sph's {PEER:.0f} us: 1 / {PEER / (spent['total'] * scale):.1f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *sys.argv[3:])
