"""Whether the range beside a permeability holds at edges of solid, and fibres thinner than a particle.

usage: PYTHONPATH=. python benchmarks/range_of_edges.py

A plane channel with a step, against the limit of 1/80 and 1/160, and an annulus round a wire of 0.6 spacings at 0.1,
against its formula: error of k and half the width of the range, in per cent.
"""

import tempfile

import numpy as np

from isphcli import run

STEP = {"box": [2.0, 1.0], "periodic": ["x"]}
# Of the error of k: twice the exponent with which the velocity grows from a right angle of solid (Moffatt 1964)
ORDER = 2 * 0.5445
OUTER, WIRE = 0.5, 0.03
PIPE = {"box": [1.2, 1.2, 0.4], "periodic": ["x", "y", "z"], "shapes": [
    {"cylinder": {"axis": "z", "centre": [0.61, 0.57, 0], "radius": OUTER}, "is": "solid", "outside": True},
    {"cylinder": {"axis": "z", "centre": [0.61, 0.57, 0], "radius": WIRE}, "is": "solid"}]}


def permeability(geometry, spacing, axis, lattice):
    """(k, relative half width of the range)."""
    case = {"geometry": geometry, "particles": {"spacing": spacing, "lattice": lattice},
            "fluids": {"water": {"density": 1, "viscosity": 1}}, "flow": "stokes", "drive": {"axes": [axis]},
            "solver": {"tolerance": 1e-7}, "output": {"plots": False}}
    with tempfile.TemporaryDirectory() as folder:
        found = run(case, out=f"{folder}/out", quiet=True, check=False)
    return found.permeability, found.permeability_range[1] / found.permeability - 1.0


def main():
    for top in (0.4, 0.43, 0.47, 0.5):
        geometry = {**STEP, "shapes": [{"box": {"lower": [0.53, -1], "upper": [1.11, top]}, "is": "solid"}]}
        coarse, fine = (permeability(geometry, spacing, "x", "square")[0] for spacing in (1 / 80, 1 / 160))
        truth = fine + (fine - coarse) / (2**ORDER - 1.0)
        for lattice in ("square", "hexagonal"):
            for spacing in (0.1, 0.05, 0.025):
                k, width = permeability(geometry, spacing, "x", lattice)
                print(f"step {top:.2f} {lattice:9s} {spacing:<5}: {100 * (k / truth - 1):+.2f} +-{100 * width:.2f}")
    square = OUTER**2 - WIRE**2
    truth = np.pi / 8 * (OUTER**4 - WIRE**4 - square**2 / np.log(OUTER / WIRE)) / 1.44
    for lattice in ("cubic", "bcc"):
        for spacing in (0.1, 0.05, 0.025):
            k, width = permeability(PIPE, spacing, "z", lattice)
            print(f"wire {lattice:9s} {spacing:<5}: {100 * (k / truth - 1):+.2f} +-{100 * width:.2f}")


if __name__ == "__main__":
    main()
