"""Relative permeability of both fluids of a snapshot: a steady solve of each, with the other one as solid, over one of
both as a single fluid.

The other fluid is a solid without slip: at small capillary numbers tension holds the interface in place, and the flow
that one fluid drags along in the other is small where the other is trapped, or many times more viscous. Where the other
fluid is far less viscous and flows too (gas over a film of water), k_r comes out too small: between plates S^3 in place
of S^2 (3 - S) / 2. With the viscosities of both fluids the interface would move during the solve, and k_r would belong
to a flow and not to a distribution of the fluids.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from ..case.blocks import Drive
from ..case.forcing import flow_axis
from ..case.load import load_case
from ..case.reader import Table
from ..geometry.clear_layer import clear_voxels
from ..geometry.protocol import Geometry, sample_box
from ..output.snapshots import read_series, read_snapshot
from ..scene.build_geometry import build_geometry
from .steady import NoFlowError, build_scene, solve_axis

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..output.clock import Clock

LEAST = 0.1  # spacings: least distance of a particle from the interface; its sign is that of the fluid of the particle
FEW = 0.5  # share of an end face that a fluid holds, over its saturation: below it the face limits its k_r
REACH = 4.0  # spacings up to which the distance to the interface is known; the spline of the wall reads no farther


class SnapshotError(ValueError):
    """A folder without snapshots of two fluids, or for which relative permeabilities cannot be found."""


@dataclass(frozen=True)
class Relative:
    """One snapshot: time, s; axis of the flow; names of both fluids; their saturations in the sample; their relative
    permeabilities; leads_through: whether a path of its own does, of both, without which it is 0; permeability: m2, of
    both as a single fluid; at_ends: the first fluid's share of the pores in the first and last layer of cells."""

    time: float
    axis: str
    names: tuple[str, str]
    saturation: tuple[float, float]
    relative: tuple[float, float]
    leads_through: tuple[bool, bool]
    permeability: float
    at_ends: tuple[float, float]

    @property
    def warnings(self) -> list[str]:
        """Sentences on fluids that percolate and hold less of the pores of an end face than of the sample: all flow
        passes the face, so that k_r is limited by it and does not belong to the saturation."""
        return [f"the flow of {name} is ruled by an end of the sample: {few}"
                for k, name in enumerate(self.names) if self.leads_through[k] and (few := self._few_at_an_end(k))]

    def _few_at_an_end(self, k: int) -> str:
        """The end faces of which fluid k, 0 or 1, holds much less than its saturation, and what to do; '' without
        such."""
        for end, share, part in zip(("first", "last"), self.at_ends, ("0.25:1", "0:0.75")):
            held = share if k == 0 else 1.0 - share
            if held < FEW * self.saturation[k]:
                return (f"it holds {held:.2g} of the pores in the {end} layer along {self.axis} and "
                        f"{self.saturation[k]:.2g} of all; take a part without that layer (--part {part})")
        return ""

    def why_zero(self, k: int) -> str | None:
        """Why the relative permeability of fluid k, 0 or 1, is zero; None where it is not."""
        if self.relative[k] > 0.0:
            return None
        if self.saturation[k] == 0.0:
            return "there is none of it in the sample"
        if not self.leads_through[k]:
            few = self._few_at_an_end(k)
            return (f"no path through {self.names[k]} alone leads through the sample along {self.axis}"
                    + (f"; {few}" if few else ""))
        return "its flow is less than the error of the solve"


def relative_permeabilities(directory: Path, clock: Clock, every: bool = False, along: str | None = None,
                            part: tuple[float, float] = (0.0, 1.0)) -> list[Relative]:
    """Relative permeabilities of the last snapshot of a run, or of every one.

    directory: of the run; along: x, y or z; without it the axis of its reservoirs or of its drive; part: of the sample
    along that axis, from and to as shares of its length.
    Raises SnapshotError where the folder has none, or no two fluids; NoFlowError where no path leads through the rock;
    SolveError.
    """
    case, entries = _read(directory)
    axis = flow_axis(case) if along is None else "xyz".index(along)
    if axis is None:
        raise SnapshotError(f"{directory}: nothing drives a flow along one axis; name it with --axis")
    geometry = build_geometry(case, axis)
    if axis >= geometry.dim:
        raise SnapshotError(f"{directory}: a 2D scene has no axis {'xyz'[axis]}")
    sample = Sample(case, geometry, axis, clock, part)
    whole, open_at_all = sample.permeability(np.full(len(sample.wall), np.inf))
    if whole == 0.0 or not open_at_all:
        raise NoFlowError(f"no path leads through the sample along {'xyz'[axis]}: its permeability is zero")
    found = []
    for time, file in entries if every else entries[-1:]:
        x, fields = read_snapshot(directory / file)
        fluid = fields["phase"] >= 0
        x, phase = x[fluid][:, : geometry.dim], fields["phase"][fluid]
        nearest = sample.nearest(x, phase)
        share, *ends = sample.shares(*nearest)
        sides = [sample.distance_from_the_other(*pair) for pair in (nearest, nearest[::-1])]
        (first, first_leads), (second, second_leads) = (sample.permeability(side) for side in sides)
        found.append(Relative(time, "xyz"[axis], (case.fluid_names[0], case.fluid_names[1]), (share, 1.0 - share),
                              (first / whole, second / whole), (first_leads, second_leads), whole, (ends[0], ends[1])))
    return found


def _read(directory: Path) -> tuple[Case, list[tuple[float, str]]]:
    """(case, [(time, file) of a snapshot]) of the folder of a run."""
    entries = read_series(directory)
    if not (directory / "case.yaml").is_file() or not entries:
        raise SnapshotError(f"{directory}: has no case.yaml and particles.pvd; name the folder of a run with snapshots")
    case = load_case(directory / "case.yaml")
    if len(case.fluids) != 2 or not entries or "phase" not in case.output.fields:
        raise SnapshotError(f"{directory}: has no snapshot of two fluids (fluids, output.fields)")
    return case, entries


class Sample:
    """The region between the reservoirs of a run or the clear layers of its image, or a part of it along the axis, as
    cells with edges of a spacing.

    wall: (n,) distance of the middles of the cells from walls, m; x: (n, dim) m; lower, upper: (dim,) m.
    """

    def __init__(self, case: Case, geometry: Geometry, axis: int, clock: Clock, part: tuple[float, float] = (0.0, 1.0)):
        self.case, self.axis, self.clock, self.spacing = _steady(case, axis), axis, clock, case.particles.spacing
        self.lower, self.upper = (corner.copy() for corner in sample_box(geometry))
        length = self.upper[axis] - self.lower[axis]
        self.lower[axis] += part[0] * length
        self.upper[axis] -= (1.0 - part[1]) * length
        self.box = np.where(geometry.periodic, geometry.upper - geometry.lower, 0.0), geometry.lower
        size = self.upper - self.lower
        self.cells = np.maximum(np.rint(size / self.spacing), 1).astype(int)
        self.edges = size / self.cells
        ends = self.lower[axis] == geometry.lower[axis] and self.upper[axis] == geometry.upper[axis]
        self.periodic = [bool(p) and (a != axis or ends) for a, p in enumerate(geometry.periodic)]
        middles = [low + (np.arange(n) + 0.5) * edge for low, n, edge in zip(self.lower, self.cells, self.edges)]
        # x varies fastest: arrays of cells are [z, y, x]
        self.x = np.stack([a.ravel() for a in np.meshgrid(*middles[::-1], indexing="ij")][::-1], axis=1)
        far = REACH * self.spacing
        self.wall = np.clip(geometry.distance(self.x), -far, far) if geometry.has_solid else np.full(len(self.x), far)

    def nearest(self, x: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) m, distances of the cells from the nearest particles of fluids 0 and 1, inf without any. x: (m, dim) m,
        phase: (m,) of the particles."""
        box, origin = self.box
        trees = [cKDTree(x[mine] - origin, boxsize=box) if mine.any() else None for mine in (phase == 0, phase == 1)]
        first, second = (np.full(len(self.x), np.inf) if tree is None else tree.query(self.x - origin)[0]
                         for tree in trees)
        return first, second

    def shares(self, to_first: np.ndarray, to_second: np.ndarray) -> tuple[float, float, float]:
        """Shares of the pores that fluid 0 has, of the sample and of its first and last layer of cells along the axis.

        By cells, as the run measures its saturations: the volumes of particles differ. A cell that a wall or the
        interface cuts counts in part. to_first, to_second: see `nearest`.
        """
        open_part = np.clip(0.5 + self.wall / self.spacing, 0.0, 1.0)
        # a cell whose middle is solid has no particle of its own: the nearest may be across the wall or the end face
        pores = np.where(self.wall > 0.0, open_part, 0.0).reshape(self.cells[::-1])
        way = np.where(np.isinf(to_second), np.inf, to_second - to_first)
        mine = pores * np.clip(0.5 + 0.5 * way / self.spacing, 0.0, 1.0).reshape(pores.shape)
        across = tuple(a for a in range(mine.ndim) if a != mine.ndim - 1 - self.axis)
        held, there = mine.sum(axis=across), pores.sum(axis=across)
        first, last = (float(held[end] / there[end]) if there[end] else 0.0 for end in (0, -1))
        return float(held.sum() / there.sum()), first, last

    def distance_from_the_other(self, to_mine: np.ndarray, to_other: np.ndarray) -> np.ndarray:
        """(n,) m, signed distance of the cells from the other fluid, positive in the own one; see `nearest`."""
        far, side = REACH * self.spacing, np.full(len(self.x), np.inf)
        nearest = np.where(to_mine <= to_other, to_other, to_mine)
        side = np.clip(nearest - 0.5 * self.spacing, LEAST * self.spacing, far)
        return np.where(to_mine <= to_other, side, -side)

    def permeability(self, distance: np.ndarray) -> tuple[float, bool]:
        """Permeability, m2, of the pores, or of the part of them outside of another fluid, and whether a path
        percolates; distance: (n,) m from that fluid."""
        from ..geometry.faces import Walls
        from ..geometry.iso_surface import ImageField, IsoSurfaceGeometry
        from ..geometry.labels import ClearLayers
        from ..geometry.voxel_geometry import VoxelGeometry

        field = np.minimum(self.wall, distance).reshape(self.cells[::-1])
        labels = np.where(field > 0.0, 0, -1).astype(np.int8)
        scene, axis = self.case.geometry, self.axis
        clear = 0
        if not self.periodic[axis]:
            apart = int(np.ceil(self.case.support * self.spacing / self.edges[axis] - 1e-6))
            clear = max(clear_voxels(labels >= 0, axis, self.edges, self.periodic), apart)
        layers, walls = ClearLayers(axis, clear) if clear else None, Walls(scene.slip_length)
        if self.case.wall_distance == "stairs":
            geometry: VoxelGeometry = VoxelGeometry(labels, self.edges, self.periodic, layers, walls)
        else:
            geometry = IsoSurfaceGeometry(labels, ImageField(field), self.edges, self.periodic, layers, walls)
        try:
            built = build_scene(self.case, geometry, self.spacing, self.clock, [axis])
            flow = solve_axis(self.case, built, axis, np.eye(geometry.dim)[axis], self.clock)
        except NoFlowError:
            return 0.0, False
        assert flow.permeability is not None  # of a flow along an axis
        return max(float(flow.permeability[axis]), 0.0), True


def _steady(case: Case, axis: int) -> Case:
    """The case of a steady flow of its first fluid along an axis, with the walls and the spacing of a run."""
    name = case.fluid_names[0]
    # supports of moving particles are chosen for a curvature
    particles = replace(case.particles, support=None, jitter=0.0, keep_volume=0.0, offset=None)
    return replace(case, flow="stokes", fluids=Table({name: case.fluids[name]}), particles=particles, time=None,
                   drive=Drive(axes=("xyz"[axis],)), interface=None, initial=None, reservoirs=None, reference=None)

