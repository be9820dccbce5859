"""The error to expect of a permeability, by its spacing and by its image: from bodies whose k is known.

`isphcli/data/calibration.csv` holds what `benchmarks/calibration.py` found on the bodies of
`isphcli/validation/known_bodies.py`, of images on those of `benchmarks/bodies_held_back.py` too: the relative error
that 90 % of them, of shapes 90 % of each family, keep within is FACTOR / width^POWER. For the error by the spacing
the width is `pore_width` or the mean chord of grains, whichever is smaller, in particles; for the error by the image
the mean chord of pores or of grains, whichever is smaller, in voxels.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..geometry.image_brick import ImageBrick
from ..geometry.labels import runs_straight, unlike_next
from ..geometry.pore_sizes import ENOUGH_ACROSS
from ..geometry.protocol import sample_box, sample_voxels
from ..geometry.voxel_geometry import VoxelGeometry
from ..references.published import DATA

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry

THINNEST = 3.0  # particles across pores, or across the median throat: a run with fewer has a warning
# Lines along each axis that chords of grains are measured on, which bounds time and memory: 3 * 1024 sites for each
# along an edge. Grains of cases/berea.yaml have chords of 87.2 um by them, by all lines 86.9 (2026-11-30)
LINES = 1024
# The part of b dx that a slip length b takes off the mean velocity in the pores, over g / nu. Slits of 4.3, 8.3 and
# 16.3 spacings with b of 0.03 to 2 times their width: 0.305 to 0.325; pipes of 5 and 10, b of 0.1 to 2 radii: 0.10 to
# 0.13, because half of the second derivatives lie along their walls (`benchmarks/slip_walls.py`)
SLIP = 0.33
# Of edges of shapes: at so many particles beside walls at most is it asked how the walls bend, which bounds the time
# (19 distances for each in 3D); step of the second differences, in spacings; radius of a wall, in spacings, below which
# it is an edge: with a wire of radius 0.6 and 1.2 in a pipe k is 1.0 and 0.17 % off, and the range of round bodies is
# 0.17 and 0.04 % (`benchmarks/range_of_edges.py`); spheres of radius 2 are among these bodies
ASKED, STEP, SHARP = 2048, 1e-3, 1.5
# Relative error of k over `Scan.off` over the mean chord: k goes as the fourth power of the width of a pore. Of scans
# with blur and noise 95 % keep within it, of those with a second mineral 99 % (benchmarks/noisy_scans.py)
OFF = 4.0
AS_GIVEN = 0.04  # voxels, `Scan.off` of an image that is taken as it is: of noise of 2 % with a blur of half a voxel
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

    spacing: by the discretisation; image: by the image, 0 of shapes; sentence: on the bodies behind them.
    """

    spacing: float
    image: float
    sentence: str

    def bounds(self, k: float) -> tuple[float, float]:
        """Smallest and largest permeability within the errors of a value k, m2."""
        both = 1.0 + math.hypot(self.spacing, self.image)
        return k / both, k * both

    def with_slip(self, share: float) -> Expected:
        """With the relative error that slip walls add to that of the spacing; see `slip_error`."""
        if share == 0.0:
            return self
        return replace(self, spacing=self.spacing + share, sentence=f"{self.sentence}, slip walls {100 * share:.2g} %")


@cache
def calibrations() -> dict[tuple[str, str], Calibration]:
    """By (wall, part): walls of `WALLS`; part spacing, image or straight (images of straight pores)."""
    with open(DATA / "calibration.csv", encoding="utf-8", newline="") as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        return {(row["wall"], row["part"]): Calibration(float(row["factor"]), float(row["power"]), int(row["bodies"]),
                                                        float(row["widest"])) for row in rows}


def has_edges(geometry: Geometry, x: np.ndarray, spacing: float) -> bool:
    """Whether solid of shapes has edges in the flow, or is thinner than a particle, so that walls bend away from the
    fluid within 1.5 spacings. There the error of k is of the order that faces of voxels have.

    x: (n, dim) m, fluid particles of this process; spacing: m. The distance to a wall has 1 / (radius + distance) as
    its largest second derivative. Where another wall is as near, it has none. All processes call it together.
    """
    x, at = _beside_walls(geometry, x, spacing)
    steps = STEP * spacing * np.eye(geometry.dim)
    second = np.zeros((len(x), geometry.dim, geometry.dim))

    def asked(step: np.ndarray) -> np.ndarray:
        return geometry.distance(x + step) / spacing

    for a, one in enumerate(steps):
        second[:, a, a] = asked(one) + asked(-one) - 2.0 * at
        for b, other in enumerate(steps[:a]):
            mixed = asked(one + other) + asked(-one - other) - asked(one - other) - asked(other - one)
            second[:, a, b] = second[:, b, a] = 0.25 * mixed
    bend = np.linalg.eigvalsh(second / STEP**2)
    return bool(reduce.count((bend[:, -1] * (SHARP + at) > 1.0) & (bend[:, 0] > -0.01 / STEP)))


def _beside_walls(geometry: Geometry, x: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """(places (m, dim), m, wall distances (m,) over the spacing) of ASKED of the particles x (n, dim) beside walls, of
    all where there are fewer. They are asked in random order, as many as it takes to find those: distances of all
    take a second per million."""
    order, found, count = np.random.default_rng(0).permutation(len(x)), [(x[:0], np.zeros(0))], 0
    for first in range(0, len(x), 2 * ASKED):
        some = x[order[first : first + 2 * ASKED]]
        distance = geometry.distance(some) / spacing
        near = (distance > 0.25) & (distance < 1.25)
        found.append((some[near], distance[near]))
        count += len(found[-1][1])
        if count >= ASKED:
            break
    places, distances = (np.concatenate(values)[:ASKED] for values in zip(*found))
    return places, distances


def wall_of(case: Case) -> str:
    """Which of `WALLS` a case has."""
    if case.geometry.voxels is None:
        return "exact"
    if case.wall_distance == "stairs":
        return "stairs"
    return "grey" if case.geometry.voxels.grey is not None else "labels"


@dataclass(frozen=True)
class Scan:
    """The properties of an image that its errors depend on. chord: see `mean_chord`; straight: see `is_straight`;
    off: how far the walls of a grey image may be off, voxels, else 0."""

    chord: float
    straight: bool
    off: float = 0.0


def scan_of(geometry: Geometry, grey: bool) -> Scan | None:
    """Of the sample of an image, without its clear layers; None of shapes, and where all is fluid or solid. grey:
    whether its walls are those of grey values."""
    off = 0.0
    if grey and isinstance(geometry, VoxelGeometry):
        off = AS_GIVEN if geometry.off is None else geometry.off
    if isinstance(geometry, ImageBrick):  # numbers of the whole image, which no process holds
        porosity = geometry.image.fluid / math.prod(geometry.image.shape)
        chord = _chord(porosity, geometry.image.walls)
        return Scan(chord, geometry.image.straight, off) if chord < np.inf else None
    if geometry.labels is None or geometry.voxel_size is None:
        return None
    pores = geometry.labels[sample_voxels(geometry)] >= 0
    chord = mean_chord(pores)
    return Scan(chord, is_straight(pores), off) if chord < np.inf else None


def mean_chord(pores: np.ndarray) -> float:
    """Mean length, in voxels, of lines along the axes within pores or within solid, the smaller of the two.

    pores: bool, along any axes. Pores may be wide between grains of few voxels, which an image shows no better.
    """
    # walls a voxel along a line, of which a chord has two; ends of an image that does not repeat are a pair of many
    ends = float(np.mean([np.mean(unlike_next(pores, axis, True)) for axis in range(pores.ndim)]))
    return _chord(float(pores.mean()), ends)


def _chord(porosity: float, ends: float) -> float:
    return 2.0 * min(porosity, 1.0 - porosity) / ends if ends > 0.0 else math.inf


def is_straight(pores: np.ndarray) -> bool:
    """Whether walls run straight on along an axis; a 2D image is one slice.

    All walls then cut the voxels in the way of one cross section, and k has a larger error by the image: in other pores
    walls cut voxels in many ways, and their errors cancel in part. Voxels that noise has turned change none of that.
    """
    return pores.ndim == 2 or runs_straight([float(np.mean(unlike_next(pores, axis, True))) for axis in range(3)])


def pore_width(k: float, porosity: float) -> float:
    """Width of the slits, m, that have the same permeability (m2) and porosity: k = porosity width^2 / 12.

    Of a slit it is the width itself, of a pipe 1.22 radii.
    """
    return math.sqrt(12.0 * k / porosity)


def too_narrow(along: str, width: float, spacing: float) -> str | None:
    """A sentence on a flow whose pores are fewer than THINNEST particles wide, and the spacing that would do; how far
    off such a flow is stands in the range of its permeability. along: 'the flow along x sees pores'; width and spacing:
    m; None elsewhere."""
    wide = width / spacing
    if wide >= THINNEST * (1 - 1e-6):
        return None
    finer = math.ceil(ENOUGH_ACROSS / wide * (1 - 1e-6))  # a divisor of the spacing, and so of the box or voxel
    return (f"{along} {wide:.3g} particles wide: its flow is not resolved; take particles.spacing "
            f"{spacing / finer:.4g} for {ENOUGH_ACROSS} or more")


def grain_chord(geometry: Geometry, spacing: float) -> float:
    """Mean length, m, of lines along the axes within solid that has fluid before and behind; inf where there is none.

    The velocity changes round grains of few spacings within a layer as thin as they are, however wide the pores are.
    Solid that reaches a face which is not periodic is no grain. Chords are measured at the sites of a lattice of the
    spacing, m, of an image at its voxels.
    """
    share, chords = 0.0, 0.0  # of the lines along an axis, and per metre of them
    for axis in range(geometry.dim):
        lines, cell = _solid_lines(geometry, axis, spacing)
        cells, ends = _between_fluid(lines, geometry.periodic[axis])
        share, chords = share + cells / lines.size, chords + ends / (lines.size * cell)
    return share / chords if chords > 0.0 else math.inf


def _solid_lines(geometry: Geometry, axis: int, spacing: float) -> tuple[np.ndarray, float]:
    """(bool (lines, n) whether there is solid along lines of the sample along an axis, length of a cell, m)."""
    across = round(LINES ** (1.0 / (geometry.dim - 1)))
    if geometry.voxel_size is not None:
        lengths = sample_box(geometry)[1] - sample_box(geometry)[0]
        counts = np.rint(lengths / geometry.voxel_size).astype(int)[::-1]  # of the axes of the labels
        chosen = [np.arange(n) if a == geometry.dim - 1 - axis else (
            (np.arange(min(n, across)) + 0.5) * (n / min(n, across))).astype(int) for a, n in enumerate(counts)]
        if isinstance(geometry, ImageBrick):
            solid = geometry.solid_at(chosen)
        else:
            assert geometry.labels is not None
            solid = geometry.labels[sample_voxels(geometry)][np.ix_(*chosen)] < 0
        solid = np.moveaxis(solid, geometry.dim - 1 - axis, -1)
        return solid.reshape(-1, solid.shape[-1]), float(geometry.voxel_size[axis])
    lower, upper = sample_box(geometry)
    counts = np.maximum(np.rint((upper - lower) / spacing), 1).astype(int)
    counts = np.where(np.arange(geometry.dim) == axis, counts, np.minimum(counts, across))
    middles = [low + (np.arange(n) + 0.5) / n * (high - low) for low, high, n in zip(lower, upper, counts)]
    points = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
    solid = geometry.phase(np.moveaxis(points, axis, -2).reshape(-1, geometry.dim)) < 0
    return solid.reshape(-1, counts[axis]), float((upper - lower)[axis] / counts[axis])


def _between_fluid(solid: np.ndarray, repeats: bool) -> tuple[int, int]:
    """(cells, chords) of solid with fluid before and behind on its line. solid: bool (lines, n). A line that repeats
    and is solid throughout is a long chord: along a plate there are as many of them as it is thick."""
    if repeats:
        starts = solid & ~np.roll(solid, 1, axis=1)
    else:
        fluid = ~solid
        before = np.logical_or.accumulate(fluid, axis=1)
        behind = np.logical_or.accumulate(fluid[:, ::-1], axis=1)[:, ::-1]
        solid = solid & before & behind
        starts = solid[:, 1:] & ~solid[:, :-1]
    return int(solid.sum()), int(starts.sum())


def usual_error(k: float, porosity: float, spacing: float, grain: float = math.inf) -> float:
    """Relative error of a permeability k, m2, at a spacing, m, beside smooth walls, which 90 % of the known bodies with
    pores and grains as wide keep within. grain: see `grain_chord`."""
    return calibrations()["exact", "spacing"].within(min(pore_width(k, porosity), grain) / spacing)


def slip_of(geometry: Geometry) -> float:
    """The largest slip length, m, of the walls, without those that exceed the box: these are planes of symmetry."""
    slip = geometry.slip_length
    return float(np.max(slip[slip <= np.max(geometry.upper - geometry.lower)], initial=0.0))


def slip_error(k: float, porosity: float, spacing: float, slip: float) -> float:
    """Relative error that walls of a slip length, m, leave in a permeability k, m2, at a spacing, m.

    The velocity at such a wall is taken from that of a particle beside it as if it were linear between them. What the
    second derivative, of the size g / nu, adds is missing: the particles within a spacing of the wall feel a force
    more, SLIP g. A flow with the slip length b takes it up by a velocity that is SLIP b dx g / nu smaller everywhere.
    With k = nu U / g the flux misses porosity SLIP b dx of k.
    """
    return SLIP * porosity * slip * spacing / k


def expected(wall: str, k: float, porosity: float, spacing: float, grain: float = math.inf, scan: Scan | None = None,
             bar: float | None = None) -> Expected:
    """Errors to expect of a permeability k, m2, at a spacing, m.

    grain: m, see `grain_chord`; scan: of an image; bar: error bar of several spacings, m2, which takes the place of the
    calibrated one.
    """
    pores = pore_width(k, porosity)
    width, what = (pores, "pores") if pores <= grain else (grain, "grains")
    known = calibrations()
    lattice = known[wall, "spacing"]
    numerical = lattice.within(width / spacing) if bar is None else bar / k
    parts = [f"spacing +-{100 * numerical:.2g} %" + (
        f" (90 % of {lattice.bodies} known bodies, {what} {width / spacing:.2g} particles wide)" if bar is None
        else " (several spacings)")]
    image = 0.0
    if scan is not None:
        scanned = known[wall, "straight" if scan.straight else "image"]
        image = replace(scanned, factor=scanned.factor + OFF * scan.off).within(scan.chord)
        parts.append(f"image +-{100 * image:.2g} % (90 % of {scanned.bodies} known {'straight ' * scan.straight}bodies "
                     f"as {WALLS[wall]}, chords of {scan.chord:.2g} voxels"
                     + (f", walls known to {scan.off:.2g} voxels" if scan.off > 0.0 else "") + ")")
    return Expected(numerical, image, ", ".join(parts))
