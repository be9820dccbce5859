"""Error of k from labels alone, over bodies whose truth is known: the product's field, Gaussian averages, voxel faces.

usage: PYTHONPATH=. python benchmarks/walls_from_labels.py

Signed errors in per cent at 1 and 2 particles a voxel: `field` of `label_field.most_probable_field`, which is
`wall_distance: smooth` of labels; averages of the labels (+1, -1) with Gaussians of 0.5, 0.55 and 0.6 voxel, wall at 0;
`stairs`, the faces of the voxels. `exact` is the body's own field on the voxel centres, what a grey image would show.
"""

import sys

import numpy as np
from known_bodies import ROUND, RandomBody, Spheres, labels_of, permeability

from isphcli.geometry.iso_surface import IsoSurfaceGeometry
from isphcli.geometry.voxel_geometry import VoxelGeometry

BODIES = (
    RandomBody(1.5, 0.45, 1), RandomBody(1.5, 0.6, 2), RandomBody(2.0, 0.35, 3), RandomBody(2.0, 0.45, 4),
    RandomBody(2.0, 0.6, 5), RandomBody(3.0, 0.35, 6), RandomBody(3.0, 0.5, 7),
    Spheres(0.216, 8), Spheres(0.216, 12), Spheres(0.45, 12), Spheres(0.216, 20),
)  # fmt: skip
GAUSSIANS = (0.5, 0.55, 0.6)
WALLS = ("exact", "field", *(f"{w:g}" for w in GAUSSIANS), "stairs")


def geometry_of(wall, field):
    labels = labels_of(field)
    if wall == "stairs":
        return VoxelGeometry(labels, 1.0, ROUND)
    if wall in ("exact", "field"):
        return IsoSurfaceGeometry(labels, field if wall == "exact" else None, 1.0, ROUND)
    return IsoSurfaceGeometry(labels, 2.0 * labels + 1.0, 1.0, ROUND, gaussian=float(wall))


def main():
    print(f"{'body':48s} {'k':>8s} " + " ".join(f"{wall:>13s}" for wall in WALLS))
    found = []
    for body in BODIES:
        field, truth = body.field(), body.truth()
        errors = [[100.0 * (permeability(geometry_of(wall, field), n) / truth - 1.0) for n in (1, 2)] for wall in WALLS]
        found.append(errors)
        print(f"{body.name:48s} {truth:8.4f} " + " ".join(f"{a:+6.1f} {b:+6.1f}" for a, b in errors), flush=True)
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    print(f"{'root mean square':57s} " + " ".join(f"{a:6.1f} {b:6.1f}" for a, b in rms))
    drift = np.mean([[b - a for a, b in errors] for errors in found], axis=0)
    print(f"{'from 1 to 2 particles a voxel, mean':57s} " + " ".join(f"{d:+13.1f}" for d in drift))


if __name__ == "__main__":
    main(*sys.argv[1:])
