"""What a permeability from so many particles a voxel is worth: every known body, against its true permeability.

usage: PYTHONPATH=. python benchmarks/calibration.py measure FILE.csv WALL[,WALL...] [NAME ...]
       PYTHONPATH=. python benchmarks/calibration.py report FILE.csv

measure: solves the bodies of `isphcli.validation.known_bodies` at 1, 2 and 3 particles a voxel edge, as far as they
have MOST particles, and appends a row a body and wall to FILE.csv; rows that it has are kept. WALL: exact (the surface
itself), labels, grey, stairs. report: prints the table of bodies, and what `isphcli/run/expected_error.py` takes from it.

Truth of stairs is another body, that of the cubes: finite volumes on 3 and 4 cells a voxel, extrapolated.
"""

import csv
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from finite_volumes import permeability

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.preflight.look import look
from isphcli.run.permeability import EDGE, extrapolate
from isphcli.run.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.validation.known_bodies import GREY_LEVEL, LevelGeometry, bodies

LEVELS = (1, 2, 3)
MOST = 40_000  # particles of the third level: 3 to 8 CPU seconds
NAMES = ("body", "family", "wall", "truth", "uncertainty", "narrow", "median", "k", "cpu", "balanced")


def case_of(body, wall, folder):
    image = {"grey": body.grey}.get(wall, body.labels)()
    np.save(folder / "image.npy", image)
    what = f"grey: {{threshold: {GREY_LEVEL}, solid: above}}" if wall == "grey" else "labels: {solid: 0, water: 1}"
    stairs = ", wall_distance: stairs" if wall == "stairs" else ""
    text = (f"geometry: {{voxels: {{file: {folder / 'image.npy'}, {what}, voxel_size: 1, axes: xyz}}"
            f", periodic: [x, y, z]{stairs}}}\nparticles: {{spacing: 1}}\n"
            f"fluids: {{water: {{density: 1, viscosity: 1}}}}\ndrive: {{axes: [{'xyz'[body.axis]}]}}\nflow: stokes\n")
    return read_case(text.encode(), f"{body.name}.yaml")


def stairs_truth(body):
    """(k, relative uncertainty): between the exponents of edges along and across the flow, see `permeability.EDGE`."""
    k = [permeability(body.labels(), body.axis, finer)[0] for finer in (3, 4)]
    limit, bar, *_ = extrapolate([1 / 3, 1 / 4], k, EDGE)
    return limit, bar / limit


def truth_of(body):
    try:
        return body.truth()[:2]
    except KeyError:  # its k can be measured before its truth is computed
        return float("nan"), float("nan")


def row_of(body, wall):
    truth, uncertainty = stairs_truth(body) if wall == "stairs" else truth_of(body)
    with tempfile.TemporaryDirectory() as folder:
        case = case_of(body, "labels" if wall == "exact" else wall, Path(folder))
        geometry = build_geometry(case)
    throats = look(case, geometry, Clock(), True).throats
    if wall == "exact":
        geometry = LevelGeometry(body)
    values, seconds, balanced = [], [], []
    for level in LEVELS:
        if level > 2 and body.labels().sum() * level**3 > MOST:
            break
        begin = time.process_time()
        scene = build_scene(case, geometry, 1 / level, Clock(), [body.axis])
        flow = solve_axis(case, scene, body.axis, np.eye(3)[body.axis], Clock())
        values.append(float(flow.permeability[body.axis]))
        seconds.append(time.process_time() - begin)
        balanced.append(flow.balanced)
    return {"body": body.name, "family": body.family, "wall": wall, "truth": f"{truth:.6g}",
            "uncertainty": f"{uncertainty:.2g}", "narrow": f"{throats['narrow']:.3g}",
            "median": f"{throats['median']:.3g}", "k": " ".join(f"{k:.6g}" for k in values),
            "cpu": " ".join(f"{s:.2f}" for s in seconds), "balanced": " ".join(str(int(b)) for b in balanced)}


def rows_of(path):
    if not Path(path).exists():
        return []
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def measure(path, walls, *names):
    done = {(row["body"], row["wall"]) for row in rows_of(path)}
    for wall in walls.split(","):
        for body in bodies():
            if (body.name, wall) in done or (names and body.name not in names):
                continue
            row = row_of(body, wall)
            new = not Path(path).exists()
            with open(path, "a", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, NAMES, lineterminator="\n")
                if new:
                    writer.writeheader()
                writer.writerow(row)
            off = ", ".join(f"{100 * (float(k) / float(row['truth']) - 1):+.2f}" for k in row["k"].split())
            print(f"{wall} {body.name}: {off} % of {row['truth']}, CPU s {row['cpu']}", flush=True)


if __name__ == "__main__":
    {"measure": measure}[sys.argv[1]](*sys.argv[2:])
