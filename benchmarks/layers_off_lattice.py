"""Two layers whose interface lies between rows of the lattice: errors of the velocity beside CPU seconds.

usage: python benchmarks/layers_off_lattice.py [FLOW ...]     (of FLOWS; all of them without one)

A channel of height 1, the lower layer 100 and 1e4 times as viscous as the upper one, whose viscosity and density are 1;
16, 32 and 64 spacings across; t = 1, when all of them are steady. Printed: the largest error of the velocity in each
layer over the largest exact velocity there, for the three spacings; of all three the largest error of the volume of the
lower layer at the start, and the largest change of it; CPU seconds of the finest one without compilation.
"""

import sys

import measuring  # noqa: F401  sets the number of threads before numba is there
import numpy as np

import isphcli
from isphcli.references.plates import two_layer_couette, two_layer_poiseuille

# name: speed of the lid, pressure drop a length, force per mass, density of the lower layer over that of the upper one
FLOWS = {
    "lid": (1.0, 0.0, 0.0, 2.0),
    "force per mass": (0.0, 0.0, 1.0, 1.0),
    "force per mass, density 2 : 1": (0.0, 0.0, 1.0, 2.0),
    "pressure drop, density 2 : 1": (0.0, 1.0, 0.0, 2.0),
}
RATIOS, HEIGHTS, ACROSS = (100.0, 1e4), (0.4, 0.55), (16, 32, 64)


def case_of(flow, ratio, height, across):
    """Nested dicts of a case."""
    lid, drop, force, heavy = FLOWS[flow]
    width = 6 / across
    drive = {"pressure_drop": {"x": drop * width}} if drop else {"body_force": [force, 0]}
    return {
        "geometry": {"box": [width, 1], "periodic": ["x"], "fluid": "thin",
                     "shapes": [{"half_space": {"point": [0, height], "normal": [0, 1]}, "is": "thick"}],
                     "walls": {"y_max": {"velocity": [lid, 0]}}},
        "particles": {"spacing": 1 / across},
        "fluids": {"thick": {"density": heavy, "viscosity": ratio}, "thin": {"density": 1, "viscosity": 1}},
        "time": {"end": 1}} | ({} if lid else {"drive": drive})


def exact_velocity(flow, ratio, height, y):
    """(n,) at heights y (n,)."""
    lid, drop, force, heavy = FLOWS[flow]
    if lid:
        return two_layer_couette(y, 1.0, height, (ratio, 1.0), lid)
    return two_layer_poiseuille(y, 1.0, height, (ratio, 1.0), (drop + force * heavy, drop + force))


def measured(flow, ratio, height, across):
    """(errors of both layers, error of the volume, its change, CPU seconds) of one run."""
    found = isphcli.run(case_of(flow, ratio, height, across), quiet=True, check=False)
    y = found.x[:, 1]
    exact = exact_velocity(flow, ratio, height, y)
    error = np.hypot(found.velocity[:, 0] - exact, found.velocity[:, 1])
    parts = [np.abs(error[side]).max() / np.abs(exact[side]).max() for side in (y < height, y > height)]
    cpu = found.summary["cpu_seconds"]
    width = 6 / across
    volume = np.array([row["volume_thick"] for row in found.history]) / (height * width)
    return *parts, abs(volume[0] - 1), np.abs(volume - volume[0]).max(), cpu["total"] - cpu.get("compile", 0.0)


def main(*flows):
    across = " | ".join(str(count) for count in ACROSS)
    print(f"| flow | viscosity | interface at | lower layer, {across} | upper layer, {across} | volume | changed by | "
          "CPU s |\n" + "|---" * (6 + 2 * len(ACROSS)) + "|")
    for flow in flows or FLOWS:
        for ratio in RATIOS:
            for height in HEIGHTS:
                runs = [measured(flow, ratio, height, count) for count in ACROSS]
                lower, upper, volume, changed, seconds = zip(*runs)
                errors = " | ".join(f"{100 * error:.2g} %" for error in (*lower, *upper))
                print(f"| {flow} | {ratio:g} : 1 | {height:g} | {errors} | {max(volume):.0e} | {max(changed):.0e} | "
                      f"{seconds[-1]:.1f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
