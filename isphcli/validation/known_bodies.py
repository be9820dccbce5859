"""Porous bodies whose permeability is known, as images and as exact surfaces.

Every body is periodic along all axes and measured in voxels: it is a level function, positive in fluid, whose zero is
the wall. From it come the images that a scanner would leave (labels by the middle of a voxel, grey values) and, for
bodies without a formula, the scene whose permeability benchmarks/true_permeabilities.py computes on the exact surface.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from ..references.arrays import cylinder_array_permeability, sphere_array_permeability
from ..references.ducts import annulus_flux, pipe_flux, square_duct_flux
from ..references.published import DATA

Level = Callable[[np.ndarray], np.ndarray]
GREY_LEVEL = 32767.5  # grey value of the wall in all grey images; above it is solid
PARTS = 6  # cells along an edge of a voxel whose shares of solid are those beside a plane wall
FINER = 4  # grid points per voxel edge between which a random field is a cubic spline: off by less than 1e-4 of it


@dataclass(frozen=True)
class Body:
    """A periodic body. Lengths are in voxels.

    family: bodies of like shape; size: (3,) voxels along x, y, z; axis: of the flow, 0, 1 or 2; level: of points (n, 3)
    -> (n,), > 0 in fluid and 0 on the wall; known: (permeability in voxel^2, its relative uncertainty, source) where a
    formula or a publication has it; spheres: (centres (m, 3), radii (m,)) of a body of spheres; field: the grey image
    is the level function itself, unless it is scanned, else shares of solid.
    """

    name: str
    family: str
    size: tuple[int, int, int]
    axis: int
    level: Level
    known: tuple[float, float, str] | None = None
    spheres: tuple[np.ndarray, np.ndarray] | None = None
    field: bool = False

    def truth(self) -> tuple[float, float, str]:
        """(permeability in voxel^2, relative uncertainty, source); KeyError where it has not been computed."""
        if self.known is not None:
            return self.known
        row = computed()[self.name]
        return float(row["permeability"]), float(row["uncertainty"]), row["source"]

    def labels(self, finer: int = 1) -> np.ndarray:
        """(nx, ny, nz) int8, 1 in pores and 0 in solid, by the middle of a voxel; `finer` points per voxel edge."""
        return (self.levels(finer) > 0.0).astype(np.int8)

    def grey(self, scanned: bool = False) -> np.ndarray:
        """(nx, ny, nz) uint16, wall at `GREY_LEVEL`, solid above it: the share of solid in a voxel as an ideal scanner
        shows it, or of a `field` the level function, unless it is `scanned`."""
        if self.field and not scanned:
            value = self.levels(1)
            return np.rint(GREY_LEVEL - value * (32000.0 / np.abs(value).max())).astype(np.uint16)
        # counted by the middles of cells the place of a wall along the voxels would be known to 1 / PARTS only
        level = self.levels(PARTS)
        steepness = sum((np.roll(level, -1, axis) - np.roll(level, 1, axis)) ** 2 for axis in range(3)) ** 0.5 / 2
        solid = np.clip(0.5 - level / np.maximum(steepness, 1e-12), 0.0, 1.0)
        shares = solid.reshape(*(e for n in self.size for e in (n, PARTS))).mean(axis=(1, 3, 5))
        return np.rint(shares * 2 * GREY_LEVEL).astype(np.uint16)

    def levels(self, finer: int = 1) -> np.ndarray:
        """Level function in the middles of voxels, (nx, ny, nz) * finer; `finer` points per voxel edge."""
        axes = [(np.arange(n * finer) + 0.5) / finer for n in self.size]
        out = np.empty([n * finer for n in self.size])
        for i, x in enumerate(axes[0]):  # slab by slab: memory
            points = np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), axis=-1).reshape(-1, 3)
            out[i] = self.level(points).reshape(out.shape[1:])
        return out


@cache
def computed() -> dict[str, dict[str, str]]:
    """Rows of isphcli/data/known_bodies.csv by name: permeabilities of bodies that have no formula."""
    with open(DATA / "known_bodies.csv", encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(line for line in file if not line.startswith("#"))}


@dataclass(frozen=True)
class LevelGeometry:
    """The exact surface of a body as a `Geometry`, for bodies that no shapes of the case language describe.

    The distance is the level over its slope, right to second order beside the wall.
    """

    body: Body
    STEP = 1e-3  # voxels, of the differences that the slope is taken from
    FARTHEST = 3.0  # voxels: distances beyond are not needed, supports end before

    dim = 3
    has_solid = True
    level_walls = False
    wall_spin = None
    labels = None
    voxel_size = None
    periodic = (True, True, True)
    warnings = ()
    described = ()

    @property
    def lower(self) -> np.ndarray:
        """Lower corner (3,) of the box, voxels."""
        return np.zeros(3)

    @property
    def upper(self) -> np.ndarray:
        """Upper corner (3,) of the box, voxels."""
        return np.asarray(self.body.size, float)

    sample_lower, sample_upper = lower, upper

    @property
    def wall_velocity(self) -> np.ndarray:
        """(1, 3): the walls are at rest."""
        return np.zeros((1, 3))

    @property
    def wall_speed(self) -> np.ndarray:
        """(1,): the walls are at rest."""
        return np.zeros(1)

    slip_length = wall_speed

    def phase(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8, -1 in the solid."""
        return np.where(self.body.level(np.asarray(x, float)) > 0.0, 0, -1).astype(np.int8)

    def distance(self, x: np.ndarray, depth: float = np.inf) -> np.ndarray:
        """(n,) signed distance to the wall, voxels, at any depth, cut off at `FARTHEST`."""
        x = np.asarray(x, float)
        value, steepness = self.body.level(x), np.zeros(len(x))
        for step in np.eye(3) * self.STEP:
            steepness += ((self.body.level(x + step) - self.body.level(x - step)) / (2 * self.STEP)) ** 2
        return np.clip(value / np.maximum(np.sqrt(steepness), 1e-12), -self.FARTHEST, self.FARTHEST)

    def wall(self, x: np.ndarray) -> np.ndarray:
        """(n,) int32: there is one wall."""
        return np.zeros(len(x), np.int32)

    def nearest(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(`distance`, `wall`) of points."""
        return self.distance(x), self.wall(x)

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """(n,) first zero between xi and xj: the first of 8 parts that ends in solid, halved 20 times."""
        xi, xj = np.asarray(xi, float), np.asarray(xj, float)
        low, high, found = np.zeros(len(xi)), np.ones(len(xi)), np.zeros(len(xi), bool)
        for end in np.arange(1, 9) / 8:
            hit = ~found & (self.body.level(xi + end * (xj - xi)) <= 0.0)
            low[hit], high[hit] = end - 1 / 8, end
            found |= hit
        first, way = xi[found], (xj - xi)[found]
        a, b = low[found], high[found]
        for _ in range(20):
            middle = (a + b) / 2
            fluid = self.body.level(first + middle[:, None] * way) > 0.0
            a, b = np.where(fluid, middle, a), np.where(fluid, b, middle)
        out = np.ones(len(xi))
        out[found] = np.maximum((a + b) / 2, 1e-9)
        return out


# -- level functions ----------------------------------------------------------------------------------------


def _near(offset: np.ndarray, period: float) -> np.ndarray:
    return offset - np.round(offset / period) * period


def _slit(x: np.ndarray, normal: Sequence[float], period: float, width: float, shift: float) -> np.ndarray:
    """Between planes: half the width less the distance from the middle plane. normal: of length 1."""
    return width / 2 - np.abs(_near(x @ np.asarray(normal) - shift, period))


def _section(x: np.ndarray, size: Sequence[int], centre: Sequence[float],
             angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (u, v) across a straight duct along z, turned by an angle in radians."""
    a, b = _near(x[:, 0] - centre[0], size[0]), _near(x[:, 1] - centre[1], size[1])
    return math.cos(angle) * a + math.sin(angle) * b, math.cos(angle) * b - math.sin(angle) * a


def _duct(x: np.ndarray, size: Sequence[int], centre: Sequence[float], angle: float, a: float, b: float) -> np.ndarray:
    u, v = _section(x, size, centre, angle)
    return np.minimum(a / 2 - np.abs(u), b / 2 - np.abs(v))


def _ellipse(x: np.ndarray, size: Sequence[int], centre: Sequence[float], angle: float, a: float,
             b: float) -> np.ndarray:
    """Half axes a, b."""
    u, v = _section(x, size, centre, angle)
    return (1.0 - np.hypot(u / a, v / b)) * min(a, b)


def _annulus(x: np.ndarray, size: Sequence[int], centre: Sequence[float], inner: float, outer: float) -> np.ndarray:
    r = np.hypot(*_section(x, size, centre, 0.0))
    return np.minimum(r - inner, outer - r)


def _oblique_pipe(x: np.ndarray, n: int, height: int, radius: float) -> np.ndarray:
    """Along (1, 1, 0) through a box n x n x height."""
    across = _near(x[:, 0] - x[:, 1], n) / math.sqrt(2.0)
    return radius - np.hypot(across, _near(x[:, 2] - height / 2 - 0.2, height))


def _cylinder(x: np.ndarray, n: int, centre: Sequence[float], radius: float) -> np.ndarray:
    """Outside a cylinder along z in a box of n x n."""
    return np.hypot(_near(x[:, 0] - centre[0], n), _near(x[:, 1] - centre[1], n)) - radius


def _outside_spheres(x: np.ndarray, size: Sequence[int], centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    out = np.full(len(x), np.inf)
    box = np.asarray(size, float)
    for centre, radius in zip(centres, radii):
        offset = x - centre
        offset -= np.round(offset / box) * box
        np.minimum(out, np.sqrt(np.einsum("ij,ij->i", offset, offset)) - radius, out=out)
    return out


@cache
def _spline_of(source: tuple) -> tuple[np.ndarray, float]:
    """(spline coefficients on a grid FINER times finer than the voxels, level of the wall) of a random field.

    source: ("file", name) of a grey image, or (seed, voxels per edge, correlation length in voxels, porosity). The
    field is a Fourier series without modes beyond half the voxels per edge, so the finer grid has its exact values.
    """
    from scipy.ndimage import spline_filter

    if source[0] == "file":
        samples = GREY_LEVEL + 0.5 - np.load(DATA / source[1]).astype(float)
        samples /= samples.std()
    else:
        seed, n, length, _ = source
        m = np.fft.fftfreq(n) * 2 * math.pi * length
        damping = np.exp(-0.5 * (m[:, None, None] ** 2 + m[None, :, None] ** 2 + m[None, None, :] ** 2))
        samples = np.fft.ifftn(np.fft.fftn(np.random.default_rng(seed).standard_normal((n,) * 3)) * damping).real
        samples /= samples.std()
    fine = _between(samples)
    level = 0.0 if source[0] == "file" else float(np.quantile(fine, 1.0 - source[3]))
    return spline_filter(fine - level, 3, mode="grid-wrap"), level


def _between(samples: np.ndarray) -> np.ndarray:
    """The Fourier series of samples in the middles of voxels, on the middles of cells FINER times finer."""
    for axis in range(3):
        n = samples.shape[axis]
        series = np.moveaxis(np.fft.rfft(samples, axis=axis), axis, -1)
        if n % 2 == 0:
            series[..., -1] = 0.0  # the mode of half the samples has no sine
        shift = (0.5 / FINER - 0.5) / n  # middles of the finer cells start before those of the voxels
        series = series * np.exp(2j * math.pi * shift * np.arange(series.shape[-1]))
        samples = np.moveaxis(np.fft.irfft(series, n * FINER, axis=-1) * FINER, -1, axis)
    return samples


def _blobs(x: np.ndarray, source: tuple) -> np.ndarray:
    from scipy.ndimage import map_coordinates

    coefficients, _ = _spline_of(source)
    return map_coordinates(coefficients, (x * FINER - 0.5).T, order=3, mode="grid-wrap", prefilter=False)


# -- spheres ------------------------------------------------------------------------------------------------


def _separate(seed: int, box: int, diameter: float, count: int, gap: float) -> np.ndarray:
    """Centres of spheres at random, `gap` or more between them, (count, 3)."""
    rng, centres = np.random.default_rng(seed), np.empty((0, 3))
    for _ in range(200_000):
        one = rng.random(3) * box
        if not len(centres) or np.linalg.norm(_near(centres - one, box), axis=1).min() >= diameter + gap:
            centres = np.vstack([centres, one])
            if len(centres) == count:
                return centres
    raise ValueError(f"{count} spheres of {diameter} voxels do not fit a box of {box}")


def _touching(seed: int, box: int, diameter: float, count: int) -> np.ndarray:
    """Centres of spheres of which each touches one that was placed before it, (count, 3)."""
    rng = np.random.default_rng(seed)
    centres = rng.random((1, 3)) * box
    for _ in range(200_000):
        way = rng.standard_normal(3)
        one = np.mod(centres[rng.integers(len(centres))] + diameter * way / np.linalg.norm(way), box)
        if np.linalg.norm(_near(centres - one, box), axis=1).min() >= diameter * (1 - 1e-9):
            centres = np.vstack([centres, one])
            if len(centres) == count:
                return centres
    raise ValueError(f"{count} spheres of {diameter} voxels do not fit a box of {box}")


# -- the bodies ---------------------------------------------------------------------------------------------

EXACT = 1e-12  # relative uncertainty of a formula


def _slit_body(name: str, size: tuple[int, int, int], axis: int, direction: Sequence[int], period: float, width: float,
               shift: float) -> Body:
    normal = np.asarray(direction, float) / np.linalg.norm(direction)
    k = width**3 / 12 / period * (1.0 - normal[axis] ** 2)  # flow along the walls, seen along an axis
    return Body(name, "slit", size, axis, partial(_slit, normal=tuple(normal), period=period, width=width, shift=shift),
                (k, EXACT, "h^3 / 12 of a period, times the square of the sine between axis and normal"))


def _duct_body(name: str, n: int, centre: Sequence[float], degrees: float, side: float) -> Body:
    level = partial(_duct, size=(n, n), centre=centre, angle=math.radians(degrees), a=side, b=side)
    return Body(name, "duct", (n, n, 6), 2, level,
                (square_duct_flux(side, 1.0, 1.0) / n**2, EXACT, "references.ducts.square_duct_flux"))


def _ellipse_body(name: str, size: tuple[int, int, int], centre: Sequence[float], degrees: float, a: float,
                  b: float) -> Body:
    k = math.pi * (a * b) ** 3 / (4 * (a * a + b * b)) / (size[0] * size[1])
    level = partial(_ellipse, size=size[:2], centre=centre, angle=math.radians(degrees), a=a, b=b)
    return Body(name, "pipe" if a == b else "ellipse", size, 2, level,
                (k, EXACT, "pi a^3 b^3 / 4 (a^2 + b^2) of the cross section"))


def _annulus_body(name: str, n: int, centre: Sequence[float], inner: float, outer: float) -> Body:
    return Body(name, "annulus", (n, n, 6), 2, partial(_annulus, size=(n, n), centre=centre, inner=inner, outer=outer),
                (annulus_flux(inner, outer, 1.0, 1.0) / n**2, EXACT, "references.ducts.annulus_flux"))


def _oblique_pipe_body(name: str, n: int, height: int, radius: float) -> Body:
    # length n sqrt(2) in a box of n x n x height; flux and drive are each seen at 45 degrees
    k = pipe_flux(radius, 1.0, 1.0) * 0.5 * n * math.sqrt(2.0) / (n * n * height)
    return Body(name, "pipe", (n, n, height), 0, partial(_oblique_pipe, n=n, height=height, radius=radius),
                (k, EXACT, "references.ducts.pipe_flux at 45 degrees"))


def _sphere_array(name: str, n: int, fraction: float, centre: Sequence[float], uncertainty: float) -> Body:
    radius = n * (3 * fraction / (4 * math.pi)) ** (1 / 3)
    spheres = np.array([centre], float), np.array([radius])
    return Body(name, "sphere array", (n, n, n), 0,
                partial(_outside_spheres, size=(n, n, n), centres=spheres[0], radii=spheres[1]),
                (sphere_array_permeability(fraction, n), uncertainty, "references.arrays.sphere_array_permeability"),
                spheres)


def _cylinders(name: str, n: int, fraction: float, centre: Sequence[float]) -> Body:
    radius = n * math.sqrt(fraction / math.pi)
    return Body(name, "cylinder array", (n, n, 6), 0, partial(_cylinder, n=n, centre=centre, radius=radius),
                (cylinder_array_permeability(fraction, n), 1e-4, "references.arrays.cylinder_array_permeability"))


def _pack(name: str, family: str, box: int, diameter: float, centres: np.ndarray) -> Body:
    radii = np.full(len(centres), diameter / 2)
    return Body(name, family, (box,) * 3, 0, partial(_outside_spheres, size=(box,) * 3, centres=centres, radii=radii),
                None, (centres, radii))


def _blob_body(name: str, n: int, source: tuple) -> Body:
    return Body(name, "blobs", (n,) * 3, 0, partial(_blobs, source=source), field=True)


@cache
def bodies() -> tuple[Body, ...]:
    """All known bodies."""
    off = (0.27, 0.11, 0.4)  # of centres from the middle of the box, so that no body is symmetric to the voxels

    def centre(n: float) -> tuple[float, float, float]:
        return n / 2 + off[0], n / 2 + off[1], n / 2 + off[2]

    root2, root5 = math.sqrt(2.0), math.sqrt(5.0)
    return (
        _slit_body("slit 3.4", (6, 8, 6), 0, (0, 1, 0), 8, 3.4, 4.17),
        _slit_body("slit 5.3", (6, 10, 6), 0, (0, 1, 0), 10, 5.3, 5.0),
        _slit_body("slit 8.7", (6, 13, 6), 0, (0, 1, 0), 13, 8.7, 6.4),
        _slit_body("slit at 45 degrees", (14, 14, 6), 0, (1, 1, 0), 14 / root2, 5.0, 0.3),
        _slit_body("slit at 27 degrees", (16, 16, 6), 0, (1, 2, 0), 16 / root5, 4.2, 0.1),
        _duct_body("duct 4.3", 8, (4.1, 3.9), 0.0, 4.3),
        _duct_body("duct 6.4", 10, (5.3, 5.17), 0.0, 6.4),
        _duct_body("duct 10.7", 14, (7.0, 7.0), 0.0, 10.7),
        _duct_body("duct 8 at 30 degrees", 15, (7.4, 7.6), 30.0, 8.0),
        _ellipse_body("pipe 2.6", (8, 8, 6), (4.2, 4.1), 0.0, 2.6, 2.6),
        _ellipse_body("pipe 4.3", (12, 12, 6), (6.0, 6.0), 0.0, 4.3, 4.3),
        _ellipse_body("pipe 7.5", (18, 18, 6), (9.3, 9.1), 0.0, 7.5, 7.5),
        _oblique_pipe_body("pipe 3.7 at 45 degrees", 14, 11, 3.7),
        _annulus_body("annulus 2.2 6.7", 16, (8.1, 8.2), 2.2, 6.7),
        _annulus_body("annulus 4.5 8.1", 19, (9.5, 9.5), 4.5, 8.1),
        _annulus_body("annulus 7.6 15.2", 34, (17.0, 17.0), 7.6, 15.2),
        _ellipse_body("ellipse 6.3 3.6", (15, 10, 6), (7.4, 5.2), 0.0, 6.3, 3.6),
        _ellipse_body("ellipse 8.5 4.1", (20, 14, 6), (10.1, 7.2), 25.0, 8.5, 4.1),
        _ellipse_body("ellipse 15 9", (34, 22, 6), (17.0, 11.0), 0.0, 15.0, 9.0),
        _sphere_array("spheres 0.064, 8", 8, 0.064, centre(8), 2e-3),
        _sphere_array("spheres 0.216, 8", 8, 0.216, centre(8), 1e-3),
        _sphere_array("spheres 0.216, 12", 12, 0.216, centre(12), 1e-3),
        _sphere_array("spheres 0.216, 20", 20, 0.216, (10.0, 10.0, 10.0), 1e-3),
        _sphere_array("spheres 0.45, 14", 14, 0.45, centre(14), 2e-3),
        _sphere_array("spheres 0.5236, 20", 20, 0.5236, centre(20), 2e-3),
        _cylinders("cylinders 0.2, 12", 12, 0.2, centre(12)),
        _cylinders("cylinders 0.4, 16", 16, 0.4, centre(16)),
        _pack("separate 6", "separate spheres", 15, 6.0, _separate(1, 15, 6.0, 7, 0.4)),
        _pack("separate 8", "separate spheres", 16, 8.0, _separate(2, 16, 8.0, 4, 0.8)),
        _pack("separate 12", "separate spheres", 20, 12.0, _separate(3, 20, 12.0, 2, 1.0)),
        _pack("separate 20", "separate spheres", 30, 20.0, _separate(4, 30, 20.0, 2, 1.5)),
        _pack("touching 6", "touching spheres", 14, 6.0, _touching(5, 14, 6.0, 9)),
        _pack("touching 9", "touching spheres", 18, 9.0, _touching(6, 18, 9.0, 7)),
        _pack("touching 14", "touching spheres", 24, 14.0, _touching(7, 24, 14.0, 4)),
        _pack("touching 20", "touching spheres", 26, 20.0, _touching(8, 26, 20.0, 2)),
        _blob_body("blobs20", 20, ("file", "blobs20_grey.npy")),
        *(_blob_body(f"blobs {seed}", n, (seed, n, length, porosity)) for seed, n, length, porosity in (
            (11, 16, 1.5, 0.35), (12, 16, 1.8, 0.30), (13, 16, 1.3, 0.50), (14, 16, 2.2, 0.40), (15, 18, 1.6, 0.25),
            (16, 16, 1.2, 0.40), (17, 18, 2.0, 0.55), (18, 16, 1.0, 0.50), (19, 20, 2.5, 0.30),
        )),
    )  # fmt: skip


def body(name: str) -> Body:
    """A body by its name; KeyError where there is none."""
    return {one.name: one for one in bodies()}[name]
