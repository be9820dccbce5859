"""Walls of least bending between labels, against the walls of `label_field.most_probable_field`: error of k.

usage: PYTHONPATH=. python benchmarks/least_bending.py [PLACES]      (2 without it)

Of all fields whose sign at each voxel centre is that of its label, of size one and more, the one of least energy: the
integral of its Laplacian squared (`bending`) or of the gradient of that squared (`third`), by 400 steps of the
alternating direction method of multipliers. Bodies of `isphcli.validation.known_bodies`: OFF, whose k from labels is
far off, and others, each at its place and, moved by a random part of a voxel, at others. Errors in per cent at one
particle a voxel and, at its own place, at two.
"""

import sys
from dataclasses import replace

import numpy as np
from walls_from_labels import ROUND, permeability  # sets the number of threads before numba is there

from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.geometry.label_field import LEAST, most_probable_field
from isphcli.geometry.modes import Modes
from isphcli.validation.known_bodies import body

OFF = ("cylinders 0.2, 12", "cylinders 0.4, 16", "spheres 0.45, 14", "blobs 15", "blobs 18", "blobs 19")
OTHERS = ("spheres 0.216, 8", "spheres 0.216, 20", "spheres 0.5236, 20", "separate 6", "separate 8", "touching 9",
          "blobs20", "blobs 12", "blobs 14", "blobs 17")
STEPS = 400


def least_energy(fluid, order):
    """The field [z, y, x] of labels `fluid`, bool, with the energy of the modes (2 pi f)^(2 order)."""
    modes = Modes(fluid.shape, np.array(ROUND))
    share = 1.0 / ((4.0 * np.pi**2 * modes.square_frequencies()) ** order + 1.0)
    sign = np.where(fluid, 1.0, -1.0)
    held, more = sign.copy(), np.zeros(fluid.shape)
    for _ in range(STEPS):
        field = modes.filtered(held - more, share)
        held = sign * np.maximum(sign * (field + more), 1.0)
        more += field - held
    return (sign * np.maximum(sign * field, LEAST)).astype(np.float32)


WALLS = {"now": lambda fluid: most_probable_field(fluid, np.array(ROUND)),
         "bending": lambda fluid: least_energy(fluid, 2), "third": lambda fluid: least_energy(fluid, 3)}


def error(one, field, per_voxel):
    labels = np.where(field > 0, np.int8(0), np.int8(-1))
    geometry = IsoSurfaceGeometry(labels, ImageField(field), 1.0, ROUND)
    return 100.0 * (permeability(geometry, per_voxel, one.axis) / one.truth()[0] - 1.0)


def main(places="2"):
    random = np.random.default_rng(11)
    shifts = [np.zeros(3), *(random.random(3) - 0.5 for _ in range(int(places) - 1))]
    found = {}
    print("| body | " + " | ".join(WALLS) + " |\n" + "|---" * (1 + len(WALLS)) + "|")
    for name in (*OFF, *OTHERS):
        one = body(name)
        for shift in shifts:
            own = not shift.any()
            moved = replace(one, level=lambda x, one=one, shift=shift: one.level(x + shift))
            fluid = (moved.levels() > 0.0).transpose(2, 1, 0)
            errors = [[error(one, make(fluid), n) for n in ((1, 2) if own else (1,))] for make in WALLS.values()]
            found.setdefault((name in OFF, own), []).append(errors)
            cells = " | ".join(", ".join(f"{e:+.1f}" for e in some) for some in errors)
            print(f"| {name} | {cells} |", flush=True)
    for (off, own), errors in found.items():
        rms = np.sqrt(np.mean(np.square(errors), axis=0))
        kind = f"{'far off' if off else 'others'}, {'own place' if own else 'other places'}: root mean square"
        print(f"| {kind} | " + " | ".join(", ".join(f"{e:.1f}" for e in some) for some in rms) + " |")


if __name__ == "__main__":
    main(*sys.argv[1:])
