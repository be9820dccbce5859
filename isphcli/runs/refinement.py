"""The spacings of `refine: auto`: three, finer ones where memory and time allow it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..domain.lattice import ParticleError
from ..scene import memory
from ..scene.place import lattice_at

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry

LEVELS = 3  # spacings in all: of three the order can be observed
SHAPES = (1.5, 2.0)  # finer spacings of shapes: the last one takes 8 times the particles in 3D
# Exponent of the particles in the time of a solve. blobs20 at 1, 2, 3 particles per voxel: 1.0 to 1.1
# (`benchmarks/calibration.py measure`, 2026-11-29)
GROWTH = 1.1


@dataclass(frozen=True)
class Solved:
    """A spacing that was solved: m, its fluid particles, wall seconds without compilation."""

    spacing: float
    particles: int
    seconds: float


def candidates(case: Case, geometry: Geometry) -> tuple[list[float], list[float]]:
    """(finer, coarser) spacings beside that of the case, m, the nearest first.

    In an image whole numbers of particles fit a voxel, so that they have the same places relative to walls in all
    voxels.
    """
    base, voxel = case.particles.spacing, geometry.voxel_size
    fit = None if voxel is None else float(np.min(voxel)) / base
    if fit is None or abs(fit - round(fit)) > 1e-3 or round(fit) < 1:
        return [base / ratio for ratio in SHAPES], [base * ratio for ratio in SHAPES]
    whole = round(fit)
    return ([base * whole / (whole + k) for k in range(1, LEVELS)],
            [base * whole / (whole - k) for k in range(1, LEVELS) if whole > k])


def further_spacings(case: Case, geometry: Geometry, solved: list[Solved]) -> Iterator[float]:
    """Spacings to be solved next, as long as they are fewer than `LEVELS`; `solved` grows as the caller goes on.

    A finer one is taken where it fits into the free memory and where it is expected to end within `case.refine_budget`,
    by the particles and seconds of the finest that was solved; otherwise coarser ones follow until there are `LEVELS`.
    """
    finer, coarser = candidates(case, geometry)
    for spacing in (*finer, *coarser):
        if solved and len(solved) < LEVELS and _fits(case, geometry, spacing, solved):
            yield spacing


def _fits(case: Case, geometry: Geometry, spacing: float, solved: list[Solved]) -> bool:
    try:
        lattice_at(case, geometry, spacing)
    except ParticleError:
        return False
    finest = min(solved, key=lambda level: level.spacing)
    ratio = (finest.spacing / spacing) ** geometry.dim
    if ratio <= 1.0:
        return True
    need = memory.estimate(case, geometry.dim, geometry.has_solid, finest.particles * ratio, 0)
    if sum(need.values()) > memory.available():
        return False
    expected = finest.seconds * ratio**GROWTH
    return sum(level.seconds for level in solved) + expected <= case.refine_budget
