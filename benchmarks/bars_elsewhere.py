"""Error bars of bodies that no bar was calibrated on: arrays of disks and spheres and pairs of pipes at random.

usage: PYTHONPATH=. python benchmarks/bars_elsewhere.py [SCENES [SEED [FILE.csv]]]      (30 of each family, seed 1)

Solid fraction, size, place on the lattice and number of spacings a cell are random, pores 2 to 15 particles wide at
the coarsest spacing. The truth is a series (`isphcli.references.arrays`) or a formula. Each scene is solved at three
spacings, h, h / 1.5 and h / 2, those of `refine: auto`. Printed by family, for the bar of all three and of pairs of
them: the share of scenes that the bar holds in per cent, and the factor on it by which nine in ten would hold; before
them the same of the range of the coarsest spacing alone, and behind them the median of bar over error of all three. To
choose FLUX and USUAL of `runs/permeability.py` the last lines have the largest such factor over families for other
values of them, and the median of bars over errors so.
"""

import csv
import itertools
import math
import sys

import numpy as np

import isphcli
from isphcli.references.arrays import cylinder_array_permeability, sphere_array_permeability
from isphcli.runs import permeability
from isphcli.runs.expected_error import pore_width, usual_error

SUBSETS = {"three": (0, 1, 2), "h, h/2": (0, 2), "h/1.5, h/2": (1, 2)}
LATTICES = {"disks": None, "disks, hexagonal": "hexagonal", "spheres": None, "spheres, bcc": "bcc", "pipes": None}


def disks(random):
    """(geometry, spacing, axis, true k, mean chord of grains) of a square array in a cell of edge 1."""
    fraction, n = random.uniform(0.08, 0.5), int(random.integers(8, 26))
    radius = math.sqrt(fraction / math.pi)
    shape = {"sphere": {"centre": random.random(2).tolist(), "radius": radius}, "is": "solid"}
    return ({"box": [1.0, 1.0], "periodic": ["x", "y"], "shapes": [shape]}, 1.0 / n, "x",
            cylinder_array_permeability(fraction), math.pi * radius / 2)


def spheres(random, finest=13):
    """As `disks`, of a simple cubic array."""
    fraction, n = random.uniform(0.1, 0.5), int(random.integers(6, finest))
    radius = (3 * fraction / (4 * math.pi)) ** (1 / 3)
    shape = {"sphere": {"centre": random.random(3).tolist(), "radius": radius}, "is": "solid"}
    return ({"box": [1.0] * 3, "periodic": ["x", "y", "z"], "shapes": [shape]}, 1.0 / n, "x",
            sphere_array_permeability(fraction), 4 * radius / 3)


def pipes(random):
    """As `disks`, of two pipes of unlike radii along z."""
    radii = random.uniform(1.3, 3.2, 2)
    shapes = [{"box": {"lower": [-20.0] * 3, "upper": [20.0] * 3}, "is": "solid"}]
    for middle, radius in zip((4.0, 12.0), radii):
        centre = [middle + random.uniform(-0.5, 0.5), 4.0 + random.uniform(-0.5, 0.5), 0.0]
        shapes.append({"cylinder": {"centre": centre, "axis": "z", "radius": float(radius)}, "is": "water"})
    return ({"box": [16.0, 8.0, 4.0], "periodic": ["x", "y", "z"], "fluid": "water", "shapes": shapes}, 1.0, "z",
            float(np.sum(math.pi * radii**4 / 8) / 128), math.inf)


def scene_of(family, random):
    if family.startswith("disks"):
        return disks(random)
    return pipes(random) if family == "pipes" else spheres(random, 11 if "bcc" in family else 13)


def solved(family, random):
    """(spacings, values over the truth, usual errors, widths in particles), (3,) each, coarsest first, and the spread
    of the flux at the finest spacing, of a random scene."""
    geometry, h, axis, truth, grain = scene_of(family, random)
    spacings = [h, h / 1.5, h / 2]
    case = {"geometry": geometry, "particles": {"spacing": h}, "fluids": {"water": {"density": 1, "viscosity": 1}},
            "flow": "stokes", "drive": {"axes": [axis]}, "refine": spacings[1:],
            "output": {"plots": False, "snapshots": False}}
    if LATTICES[family]:
        case["particles"]["lattice"] = LATTICES[family]
    found = isphcli.run(case, quiet=True, threads=1)
    by = found.summary["permeability_by_spacing"][axis]
    values = np.array([by[key] for key in sorted(by, key=float, reverse=True)])
    usual = [usual_error(k, found.porosity, spacing, grain) for k, spacing in zip(values, spacings)]
    width = min(pore_width(truth, found.porosity), grain)
    flux = found.summary["mass_error"]
    return np.array(spacings), values / truth, np.array(usual), width / np.array(spacings), flux


def bar_of(scene, levels):
    """(relative error, bar) of a scene."""
    spacings, values, usual, _, flux = scene
    value, bar, *_ = permeability.extrapolate(spacings[list(levels)], values[list(levels)], usual=usual[2], flux=flux)
    return abs(value - 1.0), bar


def needed(scene, levels):
    """The error of a scene over its bar."""
    error, bar = bar_of(scene, levels)
    return error / bar


def factors(found, levels):
    return {family: np.quantile([needed(scene, levels) for scene in scenes], 0.9) for family, scenes in found.items()}


def main(scenes="30", seed="1", path=None):
    random, found = np.random.default_rng(int(seed)), {}
    for family in LATTICES:
        found[family] = [solved(family, random) for _ in range(int(scenes))]
    if path:
        with open(path, "w", encoding="utf-8", newline="") as file:
            file.write(f"# PYTHONPATH=. python benchmarks/bars_elsewhere.py {scenes} {seed} FILE.csv\n")
            out = csv.writer(file, lineterminator="\n")
            out.writerow(("family", "width", "error"))
            out.writerows((family, f"{width:.4g}", f"{abs(value - 1.0):.3g}") for family, each in found.items()
                          for _, values, _, widths, _ in each for value, width in zip(values, widths))
    print("| family | scenes | held by the range of h, %; factor | "
          + " | ".join(f"held by {name}, %; factor" for name in SUBSETS) + " | bar over error |")
    print("|" + "---|" * (len(SUBSETS) + 4))
    for family, each in found.items():
        cells = [[abs(values[0] - 1) / usual[0] for _, values, usual, *_ in each],
                 *([needed(scene, levels) for scene in each] for levels in SUBSETS.values())]
        print(f"| {family} | {len(each)} | "
              + " | ".join(f"{100 * np.mean(np.array(r) <= 1):.0f}; {np.quantile(r, 0.9):.2f}" for r in cells)
              + f" | {np.median(1.0 / np.maximum(cells[1], 1e-6)):.1f} |")
    now = permeability.FLUX, permeability.USUAL
    for both in itertools.product((1.0, 1.5, 2.0), (0.05, 0.1, 0.2)):
        permeability.FLUX, permeability.USUAL = both
        tops = [max(factors(found, levels).values()) for levels in SUBSETS.values()]
        over = [np.median([bar / max(error, 1e-6) for each in found.values() for error, bar in
                           (bar_of(scene, levels) for scene in each)]) for levels in SUBSETS.values()]
        print("FLUX {:g}, USUAL {:g}".format(*both) + " (now)" * (both == now) + ": "
              + ", ".join(f"{name} x {top:.2f}, bar over error so {top * ratio:.2f}"
                          for name, top, ratio in zip(SUBSETS, tops, over)))


if __name__ == "__main__":
    main(*sys.argv[1:])
