"""What a pressure gradient along layers of unequal density gives them of momentum, by where their interface lies.

usage: python benchmarks/gradient_over_layers.py [ACROSS ...]     (spacings across the box; 32 64 without them)

Two layers in a periodic box, each a half of it, under a unit pressure gradient along them. Printed: the sum of mass
times acceleration over the particles, over the gradient times the volume, which should be 1, where the interfaces lie
by a part of a spacing off the middle between two rows. Nothing moves: it is that of the first step.
"""

import sys

import numpy as np
import yaml
from measuring import load_case  # noqa: F401  sets the number of threads before numba is there

from isphcli.case.load import read_case
from isphcli.flow.state import phase_of
from isphcli.output.clock import Clock
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

OFFSETS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.45)  # spacings


def case_of(across, density, jitter):
    """The text of a case."""
    layer = {"box": {"lower": [-1.0, 0.25], "upper": [2.0, 0.75]}, "is": "light"}
    return yaml.safe_dump({
        "geometry": {"box": [1.0, 1.0], "periodic": ["x", "y"], "fluid": "heavy", "shapes": [layer]},
        "particles": {"spacing": 1.0 / across, "jitter": jitter},
        "fluids": {"heavy": {"density": 1.0, "viscosity": 0.01}, "light": {"density": density, "viscosity": 0.01}},
        "drive": {"pressure_drop": {"x": 1.0}}, "time": {"end": 1.0}}, sort_keys=False)


def momentum(across, density, jitter):
    """Of each of OFFSETS."""
    case = read_case(case_of(across, density, jitter).encode(), "case.yaml")
    state, stepper, particles = prepare(case, build_geometry(case), Clock())
    fluids, reach = stepper.fluids, np.abs(state.phi).max()
    for offset in OFFSETS:
        phi = np.clip(np.abs(state.x[:, 1] - 0.5 - offset / across) - 0.25, -reach, reach)
        pushed = stepper.configure(state.x, phi=phi).terms.ops.potential_gradient(fluids.drop_force)[:, 0]
        yield particles.site_volume * float(fluids.density[phase_of(phi)] @ pushed)


def main(*across):
    print("| across | jitter | density | " + " | ".join(f"off by {o:g}" for o in OFFSETS) + " |")
    print("|---" * (3 + len(OFFSETS)) + "|")
    for width in map(int, across or (32, 64)):
        for jitter in (0.0, 0.1):
            for density in (0.5, 0.001):
                found = " | ".join(f"{m:.4f}" for m in momentum(width, density, jitter))
                print(f"| {width} | {jitter:g} | {density:g} | {found} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
