"""The bar of the formation factor, held against bodies whose formation factor is known.

usage: python benchmarks/formation_factor.py        (10 CPU seconds once the kernels are compiled)

Insulating bodies on a periodic lattice: square arrays of cylinders (Perrins, McKenzie and McPhedran 1979, Proc. R. Soc.
A 369, 207, eq. 14) and simple cubic arrays of spheres (McPhedran and McKenzie 1978, Proc. R. Soc. A 359, 45, Rayleigh's
method with the term of order 10/3). Each is solved at several spacings, with the body in the middle of the cell and off
it. Then all pairs and triples of spacings within a factor of two are taken as `refine` would take them. Prints the
error of every body, and how many bars hold the truth.
"""

import itertools
import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

from isphcli import api
from isphcli.runs.permeability import extrapolate
from isphcli.runs.steady_case import DIFFUSION, DIFFUSION_BAR

PLACES = (0.5, 0.4371)  # of the body along each axis, cells: in the middle, and as no lattice is


def cylinders(fraction):
    """Formation factor of a square array of insulating cylinders, fraction <= 0.5."""
    f = fraction
    return 1.0 / (1 - 2 * f / (1 + f - 0.305827 * f**4 / (1 - 1.402958 * f**8) - 0.013362 * f**8))


def spheres(fraction):
    """Of a simple cubic array of insulating spheres; the next term is 1e-4 at 0.216."""
    f = fraction
    return 1.0 / (1.0 - 3.0 * f / (2.0 + f + 0.9785 * f ** (10.0 / 3.0)))


def array(dim, fraction):
    """(radius of the body, cells)."""
    return math.sqrt(fraction / math.pi) if dim == 2 else (3.0 * fraction / (4.0 * math.pi)) ** (1.0 / 3.0)


BODIES = [  # name, dimension, solid fraction, truth, spacings a cell
    *((f"cylinders {f:g}", 2, f, cylinders(f), (8, 11, 16, 22, 32, 45)) for f in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)),
    *((f"spheres {f:g}", 3, f, spheres(f), (8, 10, 14, 20)) for f in (0.05, 0.1, 0.216)),
]


def factor(dim, fraction, cells, place):
    """The formation factor that a run finds."""
    case = {
        "geometry": {"box": [1.0] * dim, "periodic": list("xyz"[:dim]),
                     "shapes": [{"sphere": {"centre": [place] * dim, "radius": array(dim, fraction)}, "is": "solid"}]},
        "particles": {"spacing": 1.0 / cells},
        "fluids": {"water": {"density": 1.0, "viscosity": 1.0}},
        "flow": "stokes", "drive": {"axes": ["x"]}, "measure": ["formation_factor"],
    }
    return api.run(case, quiet=True, check=False).summary["formation_factor"]


def main():
    bars = {2: [], 3: []}
    for name, dim, fraction, truth, ladder in BODIES:
        for place in PLACES:
            found = {1.0 / cells: factor(dim, fraction, cells, place) for cells in ladder}
            errors = " ".join(f"{100 * (value / truth - 1):+6.2f}" for value in found.values())
            print(f"{name:15} at {place:6g}: {truth:.5f}, error in % at {ladder} a cell: {errors}", flush=True)
            for count in bars:
                for spacings in itertools.combinations(found, count):
                    if max(spacings) > 2.05 * min(spacings):
                        continue
                    value, bar, *_ = extrapolate(spacings, [found[h] for h in spacings],
                                                  given=(DIFFUSION, DIFFUSION_BAR))
                    bars[count].append((abs(value - truth), bar))
    for count, known in bars.items():
        held = sum(error <= bar for error, bar in known)
        ratios = sorted(error / bar for error, bar in known)
        print(f"{count} spacings: {held} of {len(known)} bars hold the truth; error over bar: median "
              f"{ratios[len(ratios) // 2]:.2f}, 90 % within {ratios[math.ceil(0.9 * len(ratios)) - 1]:.2f}, largest "
              f"{ratios[-1]:.2f}")


if __name__ == "__main__":
    main()
