"""Error of k from labels alone, over bodies whose truth is known: the product's field, Gaussian averages, voxel faces.

usage: PYTHONPATH=. python benchmarks/walls_from_labels.py [NAME ...]

Random fields and sphere arrays of `isphcli.validation.known_bodies`. Signed errors in per cent at 1 and 2 particles a
voxel: `smooth` is `label_field.most_probable_field`, which is `wall_distance: smooth` of labels; averages of the labels
(+1, -1) with Gaussians of 0.5, 0.55 and 0.6 voxel, wall at 0; `stairs`, the faces of the voxels. `exact` is the body's
own level function on the voxel centres, what a grey image of a random field shows.
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

from isphcli.case.forcing import drives
from isphcli.case.load import load_case
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.output.clock import Clock
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.validation.known_bodies import bodies

CASE = load_case(Path(__file__).parents[1] / "cases" / "grey_blobs.yaml")
ROUND = (True, True, True)
FAMILIES = ("blobs", "sphere array")
GAUSSIANS = (0.5, 0.55, 0.6)
WALLS = ("exact", "smooth", *(f"{w:g}" for w in GAUSSIANS), "stairs")


def labels_of(field):
    return np.where(field > 0, np.int8(0), np.int8(-1))


def permeability(geometry, per_voxel, axis=0):
    """k along an axis, in square voxels, with `per_voxel` particles per voxel of 1 m."""
    (along, force), *_ = drives(CASE, geometry)
    clock = Clock()
    scene = build_scene(CASE, geometry, 1.0 / per_voxel, clock, (axis,))
    return solve_axis(CASE, scene, axis, np.roll(force, axis - along), clock).permeability[axis]


def geometry_of(wall, field):
    labels = labels_of(field)
    if wall == "stairs":
        return VoxelGeometry(labels, 1.0, ROUND)
    if wall in ("exact", "smooth"):
        return IsoSurfaceGeometry(labels, ImageField(field) if wall == "exact" else None, 1.0, ROUND)
    return IsoSurfaceGeometry(labels, ImageField(2.0 * labels + 1.0, float(wall)), 1.0, ROUND)


def main(*names):
    print("| body | k, voxel^2 | " + " | ".join(WALLS) + " |\n" + "|---" * (2 + len(WALLS)) + "|")
    found = []
    for body in bodies():
        if body.name not in names if names else body.family not in FAMILIES:
            continue
        field, truth = body.levels().transpose(2, 1, 0).astype(np.float32), body.truth()[0]
        errors = [[100.0 * (permeability(geometry_of(wall, field), n) / truth - 1.0) for n in (1, 2)] for wall in WALLS]
        found.append(errors)
        cells = " | ".join(f"{a:+.1f}, {b:+.1f}" for a, b in errors)
        print(f"| {body.name} | {truth:.4f} | {cells} |", flush=True)
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    print("| root mean square | | " + " | ".join(f"{a:.1f}, {b:.1f}" for a, b in rms) + " |")
    drift = np.mean([[b - a for a, b in errors] for errors in found], axis=0)
    print("| from 1 to 2 particles per voxel, mean | | " + " | ".join(f"{d:+.1f}" for d in drift) + " |")


if __name__ == "__main__":
    main(*sys.argv[1:])
