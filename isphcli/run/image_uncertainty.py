"""What the uncertainty of the threshold of a grey image does to its permeability."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.reader import Table
from ..domain.lattice import ParticleError
from ..output import progress
from ..scene.build_geometry import build_geometry
from ..scene.image_geometry import threshold_of
from ..solvers.krylov import SolveError
from . import steady

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..output.clock import Clock


def by_threshold(case: Case, axes: Iterable[tuple[int | None, np.ndarray]], known: Mapping[int, float], clock: Clock,
                 quiet: bool, warnings: list[str]) -> dict[str, Any] | None:
    """Permeability at the threshold of a steady case and `geometry.voxels.grey.uncertainty` below and above it.

    axes: of `forcing.drives`; known: {axis: m2} at the spacing of the case; warnings: gets a sentence where a solve
    fails. Returns {'thresholds': [lower, own, upper], 'permeability': {axis name: [m2, m2, m2]}}, 0 where nothing
    flows, without the axes whose solves failed; None without an uncertainty.
    """
    assert case.geometry.voxels is not None and case.geometry.voxels.grey is not None
    off = case.geometry.voxels.grey.uncertainty
    if off is None:
        return None
    own = threshold_of(case.geometry.voxels)
    thresholds = [own - off, own, own + off]
    found: dict[str, list[float]] = {}
    for axis, force in axes:
        if axis is None or axis not in known:
            continue
        name = "xyz"[axis]
        try:
            low, high = (_permeability(case, at, axis, force, clock, quiet) for at in (thresholds[0], thresholds[2]))
        except (SolveError, ParticleError) as error:
            warnings.append(f"geometry.voxels.grey.uncertainty: no permeability along {name} with it: {error}")
            continue
        found[name] = [low, known[axis], high]
    return {"thresholds": thresholds, "permeability": found}


def _permeability(case: Case, threshold: float, axis: int, force: np.ndarray, clock: Clock, quiet: bool) -> float:
    """m2 along an axis at another threshold; 0 where nothing flows."""
    voxels = case.geometry.voxels
    assert voxels is not None and voxels.grey is not None
    grey = replace(voxels.grey, threshold=threshold, uncertainty=None, fluids=Table())  # a steady solve has one fluid
    other = replace(case, geometry=replace(case.geometry, voxels=replace(voxels, grey=grey)))
    with progress.stage(f"flow along {'xyz'[axis]} at threshold {threshold:g}", quiet):
        with clock("geometry"):
            geometry = build_geometry(other, axis)
        try:
            scene = steady.build_scene(other, geometry, case.particles.spacing, clock, (axis,))
        except steady.NoPathError:
            return 0.0
        flow = steady.solve_axis(other, scene, axis, force, clock)
    assert flow.permeability is not None
    return max(float(flow.permeability[axis]), 0.0)
