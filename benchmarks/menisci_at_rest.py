"""Do menisci come to rest: a table of scenes from flat interfaces to t = 15 sqrt(rho D^3 / sigma).

usage: python benchmarks/menisci_at_rest.py [NAME ...]     (rows of SCENES; all of them without one)

A slug of fluid, D = 1 across, density and tension 1, viscosity 0.03, in a periodic channel of another fluid, which is
like it and meets the walls at 60 degrees, 10 spacings across unless said; a cap is half a ball at first.
Printed: capillary number of the largest speed from t = 4.8 to 5 and in the last twentieth, the pressure jump over
the exact one at t = 5 and at the end, volume of the slug at the end over that at the start, CPU seconds without
compilation. The jump of a cap is over that of the cap of its volume on a plane.
"""

import math
import sys

import yaml
from measuring import ran  # sets the number of threads before numba is there

ANGLE, MU = 60.0, 0.03
COS = math.cos(math.radians(ANGLE))
# name: what is solid beside the faces of the box, depth, jump, spacings across
SCENES = {
    "plates, 2D": dict(jump=-2 * COS),
    "plates": dict(depth=0.6, jump=-2 * COS),
    "round tube": dict(depth=1.0, tube=True, jump=-4 * COS),
    "square tube": dict(depth=1.0, square=True, jump=-4 * COS),
    "cap": dict(cap=True, end=5.0),
    **{f"plates, 2D, {across} across": dict(jump=-2 * COS, across=across) for across in (7, 14, 28)},
}


def case_of(depth=0.0, tube=False, square=False, cap=False, end=15.0, across=10, **_):
    """The text of a case."""
    dim, slug = 3 if depth or cap else 2, {"box": {"lower": [0.5, 0.0, 0.0], "upper": [2.0, 1.0, max(depth, 0.1)]}}
    box, periodic = [round(2.5 * across) / across, 1.0, depth], ["x"] if tube or square or dim == 2 else ["x", "z"]
    if cap:
        box, slug = [2.0, 1.0, 2.0], {"sphere": {"centre": [1.0, 0.0, 1.0], "radius": 0.5}}
    else:
        slug["box"] = {name: corner[:dim] for name, corner in slug["box"].items()}
    shapes = [{**slug, "is": "slug"}]
    if tube:
        wall = {"cylinder": {"axis": "x", "centre": [0.0, 0.5, 0.5], "radius": 0.5}}
        shapes.append({**wall, "outside": True, "is": "solid"})
    return yaml.safe_dump({
        "geometry": {"box": box[:dim], "periodic": periodic, "fluid": "around", "shapes": shapes},
        "particles": {"spacing": 1.0 / across},
        "fluids": {name: {"density": 1, "viscosity": MU} for name in ("slug", "around")},
        "interface": {"tension": 1, "contact_angle": ANGLE}, "time": {"end": end, "capillary": 4}})


def jump_of_cap(volume):
    """-2 / R of the cap of a volume that meets a plane at 180 degrees less ANGLE."""
    return -2.0 * (math.pi / 3.0 * (2.0 - COS) * (1.0 + COS) ** 2 / volume) ** (1.0 / 3.0)


def main(*names):
    print("| scene | Ca at t = 5 | jump | at the end | jump | volume | CPU s |\n|---|---|---|---|---|---|---|")
    for name in names or SCENES:
        asked = SCENES[name]
        _, rows, seconds = ran(case_of(**asked))
        first, last = rows[0], rows[-1]
        line = f"| {name} "
        for begin, stop in ((4.8, 5.0), (0.95 * last["time"], last["time"])):
            some = [row for row in rows if begin <= row["time"] <= stop]
            jump = some[-1]["pressure_jump"] / asked.get("jump", jump_of_cap(some[-1]["volume_slug"]))
            line += f"| {max(row['peak_capillary_number'] for row in some):.1e} | {jump:.4f} "
        print(line + f"| {last['volume_slug'] / first['volume_slug']:.4f} | "
              f"{seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
