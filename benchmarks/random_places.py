"""Error of k from labels, over bodies at random places among the voxels.

usage: PYTHONPATH=. python benchmarks/random_places.py [PLACES]      (4 without it)

Bodies of `isphcli.validation.known_bodies` with smooth walls, moved by a random part of a voxel along every axis before
they are voxelised: where a body lies decides what its labels say. One particle per voxel. Printed by family, in per
cent: mean and root mean square of the error of k with the walls of `label_field.most_probable_field`, by its rule for
the prior and by a share of 0.45 of the correlation length for all bodies (the rule before 2026-11-29).
"""

import sys
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from walls_from_labels import ROUND, permeability  # sets the number of threads before numba is there

from isphcli.geometry import label_field
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.validation.known_bodies import bodies

FAMILIES = ("pipe", "ellipse", "annulus", "sphere array", "cylinder array", "blobs")
BEFORE = {"FINE": 0.03, "MOST": 60}  # of `label_field`


def former_length(*given):
    """The correlation length of the prior by the rule before, voxels."""
    with patch.multiple(label_field, RESOLVED=1e-9, SHORTEST=0.0, LONGEST=np.inf):
        return min(max(0.45 * by_rule(*given), 1.4), 4.0)


by_rule = label_field.correlation_length


def error(body):
    """Of k from the labels of a body, relative."""
    fluid = (body.levels() > 0.0).transpose(2, 1, 0)
    field = label_field.most_probable_field(fluid, np.array(ROUND))
    geometry = IsoSurfaceGeometry(np.where(fluid, np.int8(0), np.int8(-1)), ImageField(field), 1.0, ROUND)
    return permeability(geometry, 1, body.axis) / body.truth()[0] - 1.0


def errors(body, shift):
    """(now, before) of a body moved by `shift`, (3,) voxels."""
    moved = replace(body, level=lambda points: body.level(points + shift))
    with patch.multiple(label_field, correlation_length=former_length, **BEFORE):
        before = error(moved)
    return error(moved), before


def main(places="4"):
    random, found = np.random.default_rng(7), {}
    for body in bodies():
        if body.family in FAMILIES:
            for _ in range(int(places)):
                found.setdefault(body.family, []).append(errors(body, random.random(3) - 0.5))
            now = 100.0 * np.array(found[body.family][-int(places):])
            print(f"{body.name:24s} {np.round(now[:, 0], 1)} {np.round(now[:, 1], 1)}", file=sys.stderr, flush=True)
    found["all"] = [pair for pairs in found.values() for pair in pairs]
    print("| family | bodies and places | mean, rms now | mean, rms before |\n|---|---|---|---|")
    for family, pairs in found.items():
        e = 100.0 * np.array(pairs)
        cells = [f"{e[:, k].mean():+.2f}, {np.sqrt((e[:, k] ** 2).mean()):.2f}" for k in (0, 1)]
        print(f"| {family} | {len(e)} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main(*sys.argv[1:])
