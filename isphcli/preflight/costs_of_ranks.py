"""Estimates of the memory and time of a case on several processes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..domain.cut import even_bricks
from ..scene import memory
from .check_result import CheckResult, ShareOfRank

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry

BYTES_PROGRAM = 2.5e8  # Python, its libraries, MPI and PETSc: 245 MB, 2026-11-29
FEWEST = 20_000  # fluid particles of a process: with fewer most particles that it sees belong to others
# Wall time of one process, over their number, times the own and remote particles over the own ones, that N processes
# take: 32.1 s of 50.3 s on two quiet cores, Berea 128^3 at 7469db6 (docs/clusters.md), 11 % remote
WAITS = 1.15
MARGIN = 7  # voxels of an image beside its brick that a process holds (geometry/image_brick.py), and a support


def of_ranks(result: CheckResult, geometry: Geometry, count: int, share: float = 1.0) -> None:
    """Adds to a CheckResult the largest memory and time of `count` processes, and errors that forbid so many; where
    they are more than the particles only that error. share: see `memory.neighbours_held`."""
    case, dim = result.case, result.dim
    finest = min(result.spacings or case.spacings) if case.flow == "stokes" else case.particles.spacing
    fluid = result.particles["fluid"] * (case.particles.spacing / finest) ** dim
    if count > fluid:
        result.errors.append(f"{count:,} processes for {fluid:,.0f} fluid particles: some would have none; take fewer")
        return
    size, reach = geometry.upper - geometry.lower, case.support * finest
    corners = even_bricks(geometry.lower, geometry.upper, count)
    edges = corners[:, 1] - corners[:, 0]
    volume, seen = edges.prod(axis=1), np.minimum(edges + 2.0 * reach, size).prod(axis=1)
    remote = float(((seen - volume) / np.prod(size)).max()) * fluid
    own = fluid / count
    dummies = result.particles.get("dummy", 0) * fluid / result.particles["fluid"] * float((seen / np.prod(size)).max())
    solved = case if count == 1 else replace(case, solver=replace(case.solver, engine="petsc"))
    need = memory.estimate(solved, dim, geometry.has_solid, own + remote, dummies, two=len(case.fluids) > 1,
                           share=share)
    need["program"] = BYTES_PROGRAM
    if result.second is not None:  # as evenly cut as the first one, and seen as far
        need["half the spacing in throats"] = result.second.memory / count * (1.0 + remote / own)
    if geometry.voxel_size is not None:
        near = np.minimum(edges + 2.0 * (reach + MARGIN * geometry.voxel_size), size) / geometry.voxel_size
        need["image"] = memory.BYTES_VOXEL * float(near.prod(axis=1).max())
    seconds = None
    if result.seconds is not None:
        seconds = result.seconds / count * (1.0 + remote / own) * WAITS if count > 1 else result.seconds
    result.ranks = ShareOfRank(count, own, remote, need, seconds)
    if count > 1 and own < FEWEST:
        most = int(fluid / FEWEST)
        take = f"take {most:,} at most" if most > 1 else "run it in one process"
        result.warnings.append(f"{own:,.0f} fluid particles a process, and about {remote:,.0f} remote ones: fewer than "
                               f"{FEWEST:,} are not worth it; {take}")
