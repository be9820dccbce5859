"""The range of a permeability by the uncertainty of the threshold of a grey image."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.reader import Table
from ..domain.lattice import ParticleError
from ..output import progress
from ..scene.build_geometry import build_geometry
from ..scene.image_geometry import settled
from ..solvers.krylov import SolveError
from . import steady

if TYPE_CHECKING:
    from ..case.blocks import Case, Grey
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
    # one threshold, and one blur: with one of their own the two ends would be of images that are sharpened differently
    grey = replace(settled(case), uncertainty=None, fluids=Table())  # a steady solve has one fluid
    own = grey.threshold
    assert not isinstance(own, str)
    driven = [(axis, force) for axis, force in axes if axis is not None and axis in known]
    beside: list[dict[int, float]] = []  # {axis: m2} at the lower and the upper threshold
    for threshold in (own - off, own + off):
        found, failed = _permeabilities(case, replace(grey, threshold=threshold), driven, clock, quiet)
        for axis, error in failed.items():
            warnings.append("geometry.voxels.grey.uncertainty: no permeability along "
                            f"{'xyz'[axis]} with it: {error}")
        driven = [(axis, force) for axis, force in driven if axis in found]
        beside.append(found)
    low, high = beside
    return {"thresholds": [own - off, own, own + off],
            "permeability": {"xyz"[axis]: [low[axis], known[axis], high[axis]] for axis, _ in driven}}


def _permeabilities(case: Case, grey: Grey, axes: Iterable[tuple[int, np.ndarray]], clock: Clock,
                    quiet: bool) -> tuple[dict[int, float], dict[int, Exception]]:
    """({axis: m2, 0 where nothing flows}, {axis: why its solve failed}) of an image understood otherwise.

    An image that repeats along all axes has one geometry and one set of matrices for all of them.
    """
    voxels = case.geometry.voxels
    assert voxels is not None
    other = replace(case, geometry=replace(case.geometry, voxels=replace(voxels, grey=grey)))
    found: dict[int, float] = {}
    failed: dict[int, Exception] = {}
    scene: steady.SteadyScene | None = None
    for axis, force in axes:
        with progress.stage(f"flow along {'xyz'[axis]} at threshold {grey.threshold:g}", quiet):
            try:
                if scene is None or not all(a in case.geometry.repeats for a in "xyz"[: scene.geometry.dim]):
                    scene = None  # frees the matrices of the axis before
                    with clock("geometry"):
                        geometry = build_geometry(other, axis)
                    scene = steady.build_scene(other, geometry, case.particles.spacing, clock, (axis,))
                elif not scene.percolates[:, axis].any():
                    raise steady.NoPathError
                flow = steady.solve_axis(other, scene, axis, force, clock)
            except steady.NoPathError:
                found[axis] = 0.0
                continue
            except (SolveError, ParticleError) as error:
                failed[axis] = error
                continue
        assert flow.permeability is not None
        found[axis] = max(float(flow.permeability[axis]), 0.0)
    return found, failed
