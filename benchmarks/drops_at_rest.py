"""Do drops at rest hold, and come to rest: a table of scenes to t = 20 sqrt(rho D^3 / sigma).

usage: python benchmarks/drops_at_rest.py [NAME ...]     (rows of SCENES; all of them without one)

A drop of diameter D = 1, density and tension 1, the Laplace number rho sigma D / mu^2 that of the thicker fluid, in
a periodic box of 1.6 D. Printed: parts at the end, capillary number of the largest speed at t = 1 (the largest from 0.9
to 1.1) and at the end (the largest of the last twentieth), pressure jump and volume over the exact ones, CPU seconds
without compilation.
"""

import math
import sys

import yaml
from measuring import ran  # sets the number of threads before numba is there

# name: Laplace number, spacings across, density and viscosity outside over those of the drop, and what else
SCENES = {
    **{f"La {la:g}, {c:g} x": dict(laplace=la, capillary=c)
       for la in (12, 120, 300, 1250, 3000, 12000, 1e6) for c in (1, 4)},
    "12 across": dict(across=12, capillary=4), "24 across": dict(across=24, capillary=4),
    "32 across": dict(across=32, capillary=4), "square": dict(square=True, capillary=4),
    "jitter 10 %": dict(jitter=0.1, capillary=4),
    "water in CO2": dict(laplace=1250, density=0.5, viscosity=0.1, capillary=4),
    "CO2 in water": dict(laplace=1250, density=2.0, viscosity=10.0, capillary=4),
    "light outside": dict(laplace=1250, density=1e-3, viscosity=1e-2, capillary=4),
    "heavy outside": dict(laplace=1250, density=1e3, viscosity=1e2, capillary=4),
    "3D, 12 across": dict(laplace=1250, across=12, dim=3, capillary=4),
    "3D, water in CO2": dict(laplace=1250, across=12, dim=3, density=0.5, viscosity=0.1, capillary=4),
    "3D, 16 across": dict(laplace=1250, dim=3, capillary=4),
}


def case_of(laplace=3000.0, across=16, density=1.0, viscosity=1.0, dim=2, square=False, jitter=0.0, capillary=1.0,
            end=20.0):
    """The text of a case."""
    mu, dx = 1.0 / math.sqrt(laplace), 1.0 / across
    length = round(1.6 * across) * dx
    middle, half = [length / 2] * dim, math.sqrt(math.pi) / 4
    body = {"sphere": {"centre": middle, "radius": 0.5}}
    if square:
        body = {"box": {"lower": [m - half for m in middle], "upper": [m + half for m in middle]}}
    heavier, thicker = max(density, 1.0), max(viscosity, 1.0)
    fluids = {"drop": {"density": 1.0 / heavier, "viscosity": mu / thicker},
              "outside": {"density": density / heavier, "viscosity": mu * viscosity / thicker}}
    return yaml.safe_dump({
        "geometry": {"box": [length] * dim, "periodic": list("xyz"[:dim]), "fluid": "outside",
                     "shapes": [{**body, "is": "drop"}]},
        "particles": {"spacing": dx, "jitter": jitter}, "fluids": fluids, "interface": {"tension": 1},
        "time": {"end": end, "capillary": capillary}})


def main(*names):
    print("| scene | parts | Ca at t = 1 | at t = 20 | jump | volume | CPU s |\n|---|---|---|---|---|---|---|")
    for name in names or SCENES:
        asked = SCENES[name]
        summary, rows, seconds = ran(case_of(**asked))
        dim, end = asked.get("dim", 2), rows[-1]["time"]
        early = max(r["peak_capillary_number"] for r in rows if 0.9 < r["time"] < 1.1)
        late = max(r["peak_capillary_number"] for r in rows if r["time"] > 0.95 * end)
        found = summary["two_fluids"]
        exact = math.pi / 4 if dim == 2 else math.pi / 6
        jump = found["pressure_jump"] / (2 * (dim - 1))
        volume = found["volume_drop"] / exact
        print(f"| {name} | {found['ganglia_drop']} | {early:.1e} | {late:.1e} | {jump:.4f} | {volume:.4f} | "
              f"{seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
