"""Published values: tables of other authors, numbers of benchmarks and of images, each with its source."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray


DATA = Path(__file__).parents[1] / "data"


def table(name: str) -> dict[str, Array]:
    """Columns of a table in `isphcli/data`, by name of file without `.csv`; see its README."""
    path = DATA / f"{name}.csv"
    with open(path, encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)))


GHIA_MISPRINTS = {400: (0.9063,)}  # x at which the printed v, -0.23827, lies 0.1 off any smooth curve


def cavity(reynolds: int) -> dict[str, Array]:
    """Lid-driven cavity of side 1, lid velocity 1 at y = 1: y and u at x = 1/2, x and v at y = 1/2.

    Ghia, Ghia and Shin (1982), J. Comput. Phys. 48, 387, tables I and II; Reynolds number 100, 400 or 1000.
    Left out is v at x = 0.9063 for 400, a misprint. Raises KeyError for another Reynolds number.
    """
    u, v = table("ghia_cavity_u"), table("ghia_cavity_v")
    kept = ~np.isin(v["x"], GHIA_MISPRINTS.get(reynolds, ()))
    return {"y": u["y"], "u": u[str(reynolds)], "x": v["x"][kept], "v": v[str(reynolds)][kept]}


# Rising bubble, case 1 of Hysing et al. (2009), Int. J. Numer. Meth. Fluids 60, 1259: densities 1000 and 100,
# viscosities 10 and 1, tension 24.5, gravity 0.98, diameter 0.5 in a box of 1 x 2 from y = 0.5.
RISING_BUBBLE: dict[str, Any] = {
    "rise_velocity_max": 0.2417,
    "time_of_rise_velocity_max": (0.921, 0.924),
    "circularity_min": 0.9013,
    "time_of_circularity_min": 1.90,
    "centre_height_at_3": 1.0817,
    "series": table("rising_bubble"),  # of the rise velocity and the height of the centre
}
# Berea sandstone, 128^3 voxels (LukasMosser/PorousMediaGan, MIT): permeability by finite volumes on this very
# cube, flow along each axis with the sides sealed, in voxel^2. (The published file took 2 um a voxel.)
BEREA_128 = {"porosity": 0.20692, "permeability_in_voxels": (0.0677227, 0.0552978, 0.0490182)}


def berea_permeability(axis: int, voxel_size: float) -> float:
    """Published permeability of the 128^3 Berea cube along `axis` (0, 1, 2 for x, y, z), in voxel_size^2."""
    return BEREA_128["permeability_in_voxels"][axis] * voxel_size**2  # type: ignore[index]
