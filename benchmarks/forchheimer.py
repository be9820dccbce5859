"""k and beta of the law of Forchheimer in random arrays of spheres, beside the published ones.

usage: python benchmarks/forchheimer.py [FOLDER] [CELLS] [SEED ...]       (out/forchheimer 20 1; 5 CPU minutes a seed)

Hill, Koch and Ladd (2001, J. Fluid Mech. 448, 243) computed the drag of random arrays of spheres with
lattice-Boltzmann. Above a Reynolds number U a / nu of a few they have F = F2 + F3 U a / nu, with F the drag over
6 pi mu a U of a sphere of radius a at the superficial velocity U (the formulas as MFiX has them). A mean pressure
gradient of 4.5 c mu U F / a^2 at the solid fraction c makes that k = a^2 / (4.5 c F2) and beta = 4.5 c F3 / a. The law
of Beetstra, van der Hoef and Kuipers (2007, AIChE J. 53, 489), of lattice-Boltzmann too, is no straight line: it is
fitted over the same Reynolds numbers. How far both are apart is what is known of beta.

Here 16 spheres without overlap in a periodic box, c = 0.3, CELLS spacings along its edge: `isph forchheimer` over
forces that make Reynolds numbers of 5 to 20. Other places of the spheres are other numbers: one row a seed.
"""

import math
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

from isphcli.case.load import read_case
from isphcli.runs.ladders import forchheimer

SPHERES, FRACTION = 16, 0.3
RADIUS = (3.0 * FRACTION / (4.0 * math.pi * SPHERES)) ** (1.0 / 3.0)
REYNOLDS = (5.0, 10.0, 20.0)  # U a / nu, by the published law
CASE = """
geometry:
  box: [1, 1, 1]
  periodic: [x, y, z]
  shapes: [{{spheres: {{random: {count}, radius: {radius!r}, seed: {seed}}}, is: solid}}]
particles: {{spacing: {spacing!r}}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: navier_stokes
drive: {{body_force: [{force!r}, 0, 0]}}
time: {{steady: 0.01, cfl: 0.5}}
output: {{plots: false, snapshots: false}}
"""


def published(c):
    """(F2, F3) at a solid fraction between 0.1 and 0.4."""
    w = math.exp(-10.0 * (0.4 - c) / c)
    sparse = (1.0 + 3.0 * math.sqrt(c / 2.0) + 135.0 / 64.0 * c * math.log(c) + 17.89 * c) / (
        1.0 + 0.681 * c - 11.03 * c**2 + 15.41 * c**3)
    return (1.0 - w) * sparse + w * 10.0 * c / (1.0 - c) ** 3, 0.0673 + 0.212 * c + 0.0232 / (1.0 - c) ** 5


def published_too(c, reynolds):
    """Drag by Beetstra, van der Hoef and Kuipers at U a / nu, as F of the other law: with what the mean pressure
    gradient does to the spheres."""
    by_diameter, pores = 2.0 * reynolds, 1.0 - c
    inertia = (0.413 * by_diameter / (24.0 * pores**2) * (1.0 / pores + 3.0 * c * pores + 8.4 * by_diameter**-0.343)
               / (1.0 + 10.0 ** (3.0 * c) * by_diameter ** (-0.5 - 2.0 * c)))
    return (10.0 * c / pores**2 + pores**2 * (1.0 + 1.5 * math.sqrt(c)) + inertia) / pores


def main():
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/forchheimer")
    cells = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    f2, f3 = published(FRACTION)
    scale = 4.5 * FRACTION / RADIUS**2
    forces = [scale * (re / RADIUS) * (f2 + f3 * re) for re in REYNOLDS]  # nu = 1
    print(f"published: k {1.0 / (scale * f2):.4g}, beta {scale * RADIUS * f3:.4g} (F2 {f2:.4g}, F3 {f3:.4g})")
    slope, drag = np.polyfit(REYNOLDS, [published_too(FRACTION, re) for re in REYNOLDS], 1)
    print(f"Beetstra and others, fitted: k {1.0 / (scale * drag):.4g}, beta {scale * RADIUS * slope:.4g} "
          f"(F2 {drag:.4g}, F3 {slope:.4g})", flush=True)
    for seed in [int(word) for word in sys.argv[3:]] or [1]:
        text = CASE.format(count=SPHERES, radius=RADIUS, seed=seed, spacing=1.0 / cells, force=forces[0])
        case = read_case(text.encode(), folder / "case.yaml")
        found = forchheimer(case, [force / forces[0] for force in forces], folder / f"{cells}_{seed}", overwrite=True)
        reached = ", ".join(f"{row['superficial_velocity'] * RADIUS:.3g}" for row in found.rows)
        print(f"seed {seed}, {2.0 * RADIUS * cells:.1f} spacings a sphere, Reynolds numbers {reached}: "
              f"k {found.permeability:.4g} (F2 {1.0 / (scale * found.permeability):.4g}), "
              f"beta {found.beta:.4g} (F3 {found.beta / (scale * RADIUS):.4g})", flush=True)


if __name__ == "__main__":
    main()
