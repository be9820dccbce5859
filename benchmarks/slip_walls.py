"""Error of k beside walls that slip, of slits and pipes with a formula.

usage: PYTHONPATH=. python benchmarks/slip_walls.py

Printed: slip length b over the spacing dx, error of k in per cent, and the velocity that is missing over b dx g / nu,
the constant SLIP of `isphcli/runs/expected_error.py`.
"""

import math

import isphcli


def show(name, geometry, spacing, axis, truth):
    water = {"water": {"density": 1, "viscosity": 1}}
    case = {"geometry": geometry, "particles": {"spacing": spacing}, "fluids": water,
            "flow": "stokes", "drive": {"axes": [axis]}, "output": {"plots": False, "snapshots": False}}
    found = isphcli.run(case, quiet=True, threads=1)
    slip = geometry["slip_length"]
    missing = (truth - found.permeability) / (found.porosity * slip * spacing)
    print(f"{name:20s} b/dx {slip / spacing:5.2f}  error {100 * (found.permeability / truth - 1):+7.3f} %  "
          f"missing {missing:.3f}", flush=True)


def main():
    for across in (4.3, 8.3, 16.3):
        for slip in (0.03, 0.1, 0.4, 2.0):
            geometry = {"box": [4 / across, 1.0], "periodic": ["x"], "slip_length": slip}
            show(f"slit {across}", geometry, 1 / across, "x", 1 / 12 + slip / 2)
    for across in (5, 10):
        for slip in (0.05, 0.2, 1.0):
            h, radius = 1 / across, 0.5
            box = (across + 4) * h
            shapes = [{"box": {"lower": [-9.0] * 3, "upper": [9.0] * 3}, "is": "solid"},
                      {"cylinder": {"centre": [0.513 * box, 0.487 * box, 0.0], "axis": "z", "radius": radius},
                       "is": "water"}]
            geometry = {"box": [box, box, 4 * h], "periodic": ["x", "y", "z"], "fluid": "water", "slip_length": slip,
                        "shapes": shapes}
            show(f"pipe {across}", geometry, h, "z", math.pi * radius**4 / 8 * (1 + 4 * slip / radius) / box**2)


if __name__ == "__main__":
    main()
