"""Permeability of the known bodies that have no formula, on their exact surfaces: writes isphcli/data/known_bodies.csv.

usage: PYTHONPATH=. python benchmarks/true_permeabilities.py FILE.csv [NAME ...]

Rows of bodies that FILE.csv has already are kept. Each body is solved by `build_scene` and `solve_axis` at three
spacings, the finest with about PARTICLES fluid particles: packs of spheres as shapes, random fields by
`known_bodies.LevelGeometry`. The truth is the value at the finest spacing. Beside it are finite
volumes (benchmarks/finite_volumes.py) on images of the body with up to CELLS cells along an edge. Its error is the
largest of the changes to the spacings next to it and a third of the distance to the finite volumes, whose staircases of
both signs make them err by 1 to 2 % themselves. Column own: at the three spacings; particles: at the finest of them.
Values with a b are of an earlier scheme, a balance of fluxes, and are not used.
"""

import csv
import sys
import time
from pathlib import Path

import numpy as np
from finite_volumes import permeability

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.validation.known_bodies import LevelGeometry, bodies

PARTICLES = 1e5  # 15 to 60 CPU seconds
RATIOS = (0.5, 0.72, 1.0)  # of the finest resolution
CELLS = 64  # 1 to 10 CPU seconds
COMMAND = "PYTHONPATH=. python benchmarks/true_permeabilities.py isphcli/data/known_bodies.csv"
NAMES = ("name", "porosity", "permeability", "uncertainty", "particles", "own", "finite_volumes", "cpu_seconds",
         "source")


def case_of(body, spacing):
    spheres = ""
    if body.spheres is not None:
        spheres = ", ".join(f"{{sphere: {{centre: {centre.tolist()}, radius: {float(radius)!r}}}, is: solid}}"
                            for centre, radius in zip(*body.spheres))
    text = (f"geometry: {{box: {list(map(float, body.size))}, periodic: [x, y, z], shapes: [{spheres}]}}\n"
            f"particles: {{spacing: {spacing!r}}}\nfluids: {{water: {{density: 1, viscosity: 1}}}}\n"
            f"drive: {{axes: [{'xyz'[body.axis]}]}}\nflow: stokes\n")
    return read_case(text.encode(), f"{body.name}.yaml")


def solve(body, spacing):
    """(k in voxel^2, particles, iterations) of the exact surface."""
    case = case_of(body, spacing)
    geometry = LevelGeometry(body) if body.spheres is None else build_geometry(case)
    scene = build_scene(case, geometry, spacing, Clock(), [body.axis])
    flow = solve_axis(case, scene, body.axis, np.eye(3)[body.axis], Clock())
    return float(flow.permeability[body.axis]), scene.particles.n_fluid, flow.convergence.iterations


def row_of(body):
    begin, edge = time.process_time(), max(body.size)
    porosity = float(body.labels(3).mean())
    finest = round((PARTICLES / porosity / np.prod(body.size)) ** (1 / 3) * edge)
    own = []
    for ratio in RATIOS:
        cells = round(ratio * finest)
        k, particles, iterations = solve(body, edge / cells)
        own.append(k)
        print(f"{body.name}: {cells} cells an edge, {particles:,} particles, k {k:.6g}, {iterations} iterations, "
              f"{time.process_time() - begin:.0f} CPU s", flush=True)
    most = max(CELLS // edge, 2)
    volumes = [permeability(body.labels(finer), body.axis)[0] / finer**2 for finer in (most - 1, most)]
    print(f"{body.name}: finite volumes {volumes}, {time.process_time() - begin:.0f} CPU s", flush=True)
    k = own[-1]
    off = max(abs(own[-2] / k - 1), abs(np.mean(volumes) / k - 1) / 3)
    return {"name": body.name, "porosity": f"{porosity:.5f}", "permeability": f"{k:.6g}", "uncertainty": f"{off:.2g}",
            "particles": particles, "own": " ".join(f"{v:.6g}" for v in own),
            "finite_volumes": " ".join(f"{v:.6g}" for v in volumes),
            "cpu_seconds": f"{time.process_time() - begin:.0f}",
            "source": "own operators on the exact surface"}


def main(file, *names):
    path = Path(file)
    known = {}
    if path.exists():
        with open(path, encoding="utf-8", newline="") as old:
            known = {row["name"]: row for row in csv.DictReader(line for line in old if not line.startswith("#"))}
    for body in bodies():
        if body.known is None and body.name not in known and (not names or body.name in names):
            known[body.name] = row_of(body)
            order = [one.name for one in bodies() if one.name in known]
            with open(path, "w", encoding="utf-8", newline="") as new:
                new.write(f"# {COMMAND}\n")
                writer = csv.DictWriter(new, NAMES, lineterminator="\n")
                writer.writeheader()
                writer.writerows(known[name] for name in order)


if __name__ == "__main__":
    main(*sys.argv[1:])
