"""What a permeability at one spacing is worth, and what an image leaves open of it: by bodies whose k is known.

`isphcli/data/calibration.csv` holds what `benchmarks/calibration.py` found on the bodies of
`isphcli/validation/known_bodies.py`: the relative error that 90 % of them keep within is FACTOR / width^POWER, with the
width of the pores in particles for what the spacing does, and in voxels for what the image does.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.protocol import sample_box
from ..references.solutions import DATA

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry

WALLS = {"exact": "shapes", "grey": "grey images", "labels": "segmented images", "stairs": "images with stairs"}


@dataclass(frozen=True)
class Calibration:
    """factor, power: 90 % of the bodies keep within factor / width^power; bodies: how many; widest: of them, in
    particles or voxels."""

    factor: float
    power: float
    bodies: int
    widest: float

    def within(self, width: float) -> float:
        """Relative error that 90 % keep within; no less for wider pores than any body has."""
        return self.factor / min(width, self.widest) ** self.power


@dataclass(frozen=True)
class Expected:
    """Relative errors of a permeability, which 90 % of the known bodies keep within.

    spacing: of its discretisation; image: of what the image leaves open, 0 of shapes; sentence: where they are from.
    """

    spacing: float
    image: float
    sentence: str

    def bounds(self, k: float) -> tuple[float, float]:
        """Smallest and largest permeability that a value k stands for, m2."""
        both = 1.0 + math.hypot(self.spacing, self.image)
        return k / both, k * both


@cache
def calibrations() -> dict[tuple[str, str], Calibration]:
    """By (wall, part): walls of `WALLS`; part spacing, image or straight (images of straight pores)."""
    with open(DATA / "calibration.csv", encoding="utf-8", newline="") as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        return {(row["wall"], row["part"]): Calibration(float(row["factor"]), float(row["power"]), int(row["bodies"]),
                                                        float(row["widest"])) for row in rows}


def wall_of(case: Case) -> str:
    """Which of `WALLS` a case has."""
    if case.geometry.voxels is None:
        return "exact"
    if case.wall_distance == "stairs":
        return "stairs"
    return "grey" if case.geometry.voxels.grey is not None else "labels"


def straight(geometry: Geometry) -> bool:
    """Whether all slices of an image across one of its axes are the same, as those of a 2D image are.

    One cross section then decides how walls lie to the voxels, and an image says less of k: in other pores walls lie in
    all ways, and their errors cancel in part.
    """
    labels = geometry.labels
    if labels is None:
        return False
    if labels.ndim == 2:
        return True
    assert geometry.voxel_size is not None
    lower, upper = sample_box(geometry)
    first = np.rint((lower - geometry.lower) / geometry.voxel_size).astype(int)
    end = np.rint((upper - geometry.lower) / geometry.voxel_size).astype(int)
    sample = labels[tuple(slice(a, b) for a, b in zip(first[::-1], end[::-1]))]
    return any(bool(np.all(sample == np.take(sample, [0], axis))) for axis in range(3))


def pore_width(k: float, porosity: float) -> float:
    """Width of the slits, m, that have the same permeability (m2) and porosity: k = porosity width^2 / 12.

    It is the width that the flow itself sees: of a slit its own, of a pipe 1.22 radii.
    """
    return math.sqrt(12.0 * k / porosity)


def expected(wall: str, k: float, porosity: float, spacing: float, voxel: float | None = None,
             is_straight: bool = False, bar: float | None = None) -> Expected:
    """Errors to expect of a permeability k, m2, at a spacing, m.

    voxel: edge of a voxel of an image, m; is_straight: see `straight`; bar: error bar of several spacings, m2, which
    takes the place of the calibrated one.
    """
    width = pore_width(k, porosity)
    known = calibrations()
    lattice = known[wall, "spacing"]
    numerical = lattice.within(width / spacing) if bar is None else bar / k
    parts = [f"spacing +-{100 * numerical:.2g} %" + (
        f" (90 % of {lattice.bodies} known bodies, pores {width / spacing:.2g} particles wide)" if bar is None
        else " (several spacings)")]
    image = 0.0
    if voxel is not None:
        scanned = known[wall, "straight" if is_straight else "image"]
        image = scanned.within(width / voxel)
        parts.append(f"image +-{100 * image:.2g} % (90 % of {scanned.bodies} known bodies as {WALLS[wall]}, "
                     f"{'straight ' if is_straight else ''}pores {width / voxel:.2g} voxels wide)")
    return Expected(numerical, image, ", ".join(parts))
