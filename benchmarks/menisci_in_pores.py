"""How far menisci in narrow pores are from rest: speeds that should be zero, against the radius of a pore in spacings.

usage: python benchmarks/menisci_in_pores.py [ACROSS ...]     (spacings across a pore; 2 3 4 6 8 without them)

A slug of CO2 in a periodic pore of brine, as in cases/berea_drainage.yaml: 3 um a spacing, contact angle 30 degrees,
nothing drives it. Pores: a tube as a shape (smooth), the same tube as an image of one voxel a spacing (stairs), and a
square one, whose walls lie along the lattice. After STEPS steps of four capillary limits, over the last fifth of them:
root mean square and largest capillary number, speed times the viscosity of the brine over the tension, largest speed of
all and root mean square speed of the CO2; how far the slug has drifted, spacings; the pressure jump over 2 cos(30) / R
(a square tube of side 2 R has nearly the same); parts; CPU seconds without compilation.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml
from measuring import ran  # sets the number of threads before numba is there

SPACING, TENSION, VISCOSITY = 3.0e-6, 0.026, 1.0e-3  # m, N/m, Pa s
LENGTH, STEPS = 24, 300  # spacings; of the time step


def case_of(across, pore, folder):
    """The text of a case of a pore of so many spacings across."""
    h, size = SPACING, across + (0 if pore == "square" else 4)
    box = [LENGTH * h, size * h, size * h]
    slug = {"box": {"lower": [LENGTH / 4 * h, -h, -h], "upper": [3 * LENGTH / 4 * h, box[1] + h, box[2] + h]}}
    geometry = {"box": box, "periodic": ["x"], "fluid": "brine", "shapes": [{**slug, "is": "co2"}]}
    if pore == "smooth":
        wall = {"cylinder": {"axis": "x", "centre": [0.0, box[1] / 2, box[2] / 2], "radius": across * h / 2}}
        geometry["shapes"].append({**wall, "outside": True, "is": "solid"})
    if pore == "stairs":
        place = np.arange(size) + 0.5 - size / 2
        image = np.where(np.hypot(place[:, None], place) < across / 2, 0, 2)[:, :, None].repeat(LENGTH, axis=2)
        middle = image[:, :, LENGTH // 4 : 3 * LENGTH // 4]
        middle[middle == 0] = 1
        path = Path(folder) / f"tube_{across}.npy"
        np.save(path, image.astype(np.uint8))
        geometry = {"voxels": {"file": str(path), "labels": {"solid": 2, "brine": 0, "co2": 1}, "voxel_size": h},
                    "periodic": ["x"]}
    return yaml.safe_dump({
        "geometry": geometry, "particles": {"spacing": h},
        "fluids": {"brine": {"density": 1000, "viscosity": VISCOSITY}, "co2": {"density": 500, "viscosity": 1e-4}},
        "interface": {"tension": TENSION, "contact_angle": 30},
        "time": {"end": 1.0, "max_steps": STEPS, "capillary": 4}})


def main(*across):
    print("| pore | across | Ca of the CO2 | largest | drift | jump | parts | CPU s |\n" + "|---" * 8 + "|")
    with tempfile.TemporaryDirectory() as folder:
        for pore in ("smooth", "stairs", "square"):
            for width in map(int, across or (2, 3, 4, 6, 8)):
                _, rows, seconds = ran(case_of(width, pore, folder))
                last = rows[-STEPS // 5 :]
                mass = 500 * rows[-1]["volume_co2"]
                square = np.mean([2 * row["kinetic_energy_co2"] / mass for row in last])
                large = max(row["peak_capillary_number"] for row in last)
                drift = (rows[-1]["centre_x_co2"] - rows[0]["centre_x_co2"]) / SPACING
                jump = np.mean([row["pressure_jump"] for row in last]) * width * SPACING / (4 * TENSION * 3**0.5 / 2)
                parts = [row["ganglia_co2"] for row in rows if row["ganglia_co2"] is not None][-1]
                print(f"| {pore} | {width} | {square**0.5 * VISCOSITY / TENSION:.1e} | {large:.1e} | {drift:.2f} "
                      f"| {jump:.3f} | {parts} | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
