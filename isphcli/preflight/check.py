"""What a case uses, needs, costs and risks, before it is run.

`check` looks at the lattice only: nothing is solved and no neighbours are searched. Estimates are meant to be
right within a factor of two; the numbers behind them stand below with the date on which they were measured.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from ..case import expressions
from ..case.blocks import AXES, Case
from ..case.forcing import opens, why_closed
from ..case.load import load_case
from ..domain.lattice import Lattice, ParticleError, make_lattice
from ..geometry.connectivity import Connectivity, report
from ..geometry.protocol import Geometry
from ..scene import memory
from ..scene.build_geometry import build_geometry
from ..scene.place import what_is_solid

# Measured 2026-11-22 on one core at support 2.1, compilation left out: CPU microseconds a particle and step,
# for stokes a particle and axis. stokes: 57 (sphere array, 86,608 particles), 60 (two tubes), 27 in 2D.
# navier_stokes: 7.5 and 14 in 2D, in 3D 22 to 24 without walls, 20 to 63 with them (63: large viscous steps)
MICROSECONDS = {
    ("stokes", 2): 27.0,
    ("stokes", 3): 60.0,
    ("navier_stokes", 2): 10.0,
    ("navier_stokes", 3): 30.0,
}
STEPS_TO_STEADY = 16  # at least, however large they are (trials before 2026-11-22)
# particles across below which a throat is thin; at 4: +7.6 % of k (`isph run cases/square_duct.yaml --set
# particles.spacing=2e-5`, 2026-11-29)
THIN = 4
THINNEST = 3  # particles across the median throat below which there is a warning
LINE_POINTS = 20_000  # points of the centre lines whose width is found exactly
TINY = 1e-6
# Of a lattice that is looked at site by site: 0.6 us each on an idle core, 2 us on a busy one (Berea, 2026-11-29)
MOST_SITES = 30_000_000
BYTES_SITE = 30  # of a lattice site in a check: phase, distance, labels of the connected parts
ON_WALL = 1e-9  # of the support: a site this close to a wall is solid, as for `Geometry.phase`


@dataclass(frozen=True)
class Term:
    """A part of the physics, whether the case uses it, and why."""

    name: str
    used: bool
    why: str


@dataclass(frozen=True)
class Throats:
    """Widths of the pores in spacings, at the points farthest from their walls.

    narrow, median: 10th and 50th percentile; thin: share of the fluid where fewer than `THIN` particles fit
    across; critical: per axis, the largest ball that passes along it (within half a spacing), for periodic
    axes only, because closed faces count as walls.
    """

    narrow: float
    median: float
    thin: float
    critical: dict[int, float]


@dataclass(frozen=True)
class Flow:
    """Estimates of the flow: velocity (m/s) and how it was found, Reynolds and capillary number."""

    velocity: float
    source: str
    reynolds: float | None
    capillary: float | None


@dataclass(frozen=True)
class Steps:
    """Time-step limits by name, s; the steps of the whole run, None where there is no telling."""

    limits: dict[str, float]
    count: float | None

    @property
    def binding(self) -> str:
        """The smallest limit."""
        return min(self.limits, key=lambda name: self.limits[name])


@dataclass
class CheckReport:
    """What is known of a case without running it; lengths in m, axes in the order x, y(, z)."""

    case: Case
    dim: int
    terms: list[Term]
    particles: dict[str, int]
    connectivity: Connectivity | None = None
    throats: Throats | None = None
    flow: Flow | None = None
    steps: Steps | None = None
    neighbours: float = 0.0
    memory: dict[str, float] = field(default_factory=dict)  # bytes, by part
    seconds: float | None = None  # one core
    inputs: tuple[tuple[str, str], ...] = ()  # what was read and how it was understood: (name, text)
    warnings: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    @property
    def can_run(self) -> bool:
        """Whether nothing stands against a run."""
        return not self.errors

    def text(self) -> str:
        """The report as it is printed."""
        return "\n".join(_lines(self))


def check_case_file(path: str | Path, overrides: Sequence[str] = ()) -> CheckReport:
    """Read and check a case; raises CaseError, VoxelError or ShapeError where it cannot even be set up."""
    return check(load_case(path, tuple(overrides)))


def check(case: Case, geometry: Geometry | None = None, to_run: bool = False) -> CheckReport:
    """Check a case; `geometry` where it is at hand already.

    to_run: it is about to be run. However many sites there are, to look at them is then little beside the solve; and
    what the run itself finds out and tells is left to it: which axes are closed, which fluids are absent.
    """
    if geometry is None:
        try:
            geometry = build_geometry(case)
        except ParticleError as error:  # an image whose size alone says that it does not fit
            return CheckReport(case, case.dim or 3, [], {}, errors=[str(error)])
    result = CheckReport(case, geometry.dim, terms(case, geometry), {}, warnings=list(geometry.warnings),
                         inputs=geometry.described)
    try:
        lattice = lattice_of(case, geometry)
        if lattice.sites > MOST_SITES and not to_run:
            _from_samples(result, geometry, lattice)
            return result
        memory.refuse(lattice.sites * BYTES_SITE, f"{lattice.sites:,} lattice sites, to be checked,",
                      memory.too_large(case))
    except ParticleError as error:
        result.errors.append(str(error))
        return result
    sites = Sites(lattice, geometry, case.support * case.particles.spacing, len(case.fluids) == 1)
    result.particles = sites.particles
    if not sites.particles["fluid"]:
        result.errors.append(
            f"no fluid: the scene is solid at every site of the lattice; check {what_is_solid(geometry)}, or take "
            "a smaller particles.spacing"
        )
        return result
    result.connectivity = sites.connectivity()
    driven = driven_axes(case, geometry.dim)
    through = [axis for axis in driven if result.connectivity.percolates[axis] and opens(case, axis)]
    if geometry.has_solid:
        result.throats = throats(sites, geometry, case.particles.spacing, through)
    result.flow = flow_estimate(case, geometry, sites, result.throats, driven)
    if case.flow != "stokes":
        result.steps = steps(case, result.flow, result.throats)
    _costs(result, geometry)
    if not to_run or case.flow != "stokes":
        _drive_findings(result, geometry, driven, through)
    kinds = {(f.density, f.mu) for f in case.fluids.values()}
    if case.flow == "stokes" and sites.per_fluid[1:].any() and len(kinds) > 1:
        result.errors.append("a steady solve has one fluid; use flow: navier_stokes for two")
    result.warnings += list(_resolution_findings(result, geometry, lattice))
    result.warnings += list(_other_findings(result, geometry, sites))
    if not to_run:
        result.warnings += list(_absent_fluids(case, sites))
    elif case.flow != "stokes":  # a run in time goes on, and finds out
        result.warnings += result.errors
    return result


def _from_samples(result: CheckReport, geometry: Geometry, lattice: Lattice) -> None:
    """What random points tell of a lattice that has too many sites to look at each."""
    case = result.case
    size = geometry.upper - geometry.lower
    phase = geometry.phase(geometry.lower + np.random.default_rng(0).random((memory.SAMPLE, geometry.dim)) * size)
    share = float((phase >= 0).mean())
    result.particles = {"fluid": round(share * lattice.sites)}
    if case.flow != "stokes":
        result.steps = steps(case, None, None) if case.time is not None and case.time.step else None
    _costs(result, geometry)
    need, left = sum(result.memory.values()), memory.available()
    if left is not None and need > left:
        result.errors.append(f"needs about {_bytes(need)} of memory, {_bytes(left)} are free; {memory.too_large(case)}")
    result.warnings.append(
        f"{lattice.sites:,} lattice sites are too many to look at each ({MOST_SITES:,} at most): particles, memory and "
        f"time are from {memory.SAMPLE:,} random points (porosity about {100 * share:.2g} %), and pores, throats and "
        "time steps were not looked at; check a part of the scene for those"
    )


# -- the lattice -----------------------------------------------------------------------------------------


def lattice_of(case: Case, geometry: Geometry) -> Lattice:
    """The lattice on which the particles of a case start."""
    p = case.particles
    margin = case.support * p.spacing
    kind = case.lattice_in(geometry.dim)
    box = (geometry.lower, geometry.upper, geometry.periodic)
    return make_lattice(kind, *box, p.spacing, margin, p.offset)


class Sites:
    """Phase and wall distance of every site of a lattice, [x, y(, z), site of the cell].

    sample: the part of the box that is no clear layer, as slices of the cells; around: which axes of that
    part are periodic.
    """

    def __init__(self, lattice: Lattice, geometry: Geometry, support: float, one_fluid: bool = False):
        shape = (*(int(n) for n in lattice.counts), len(lattice.basis))
        phase = np.empty(shape, dtype=np.int8)
        distance = np.full(shape, np.inf, dtype=np.float32)
        by_distance = geometry.has_solid and one_fluid and geometry.labels is None
        flat_phase, flat_distance, first = phase.reshape(-1), distance.reshape(-1), 0
        for x in lattice.slabs():
            part = slice(first, first + len(x))
            if geometry.has_solid:
                flat_distance[part] = d = geometry.distance(x)
            # a distance among thousands of spheres costs a microsecond: with one fluid it tells the phase too
            flat_phase[part] = np.where(d > ON_WALL * support, 0, -1) if by_distance else geometry.phase(x)
            first += len(x)
        self.lattice, self.phase, self.distance = lattice, phase, distance
        lower, upper = geometry.sample_lower, geometry.sample_upper
        self.sample = _cells_between(lattice, lower, upper)
        whole = (np.asarray(lower) <= geometry.lower) & (np.asarray(upper) >= geometry.upper)
        self.around = tuple(bool(p and w) for p, w in zip(geometry.periodic, whole))
        fluid = phase >= 0
        seen = ~fluid & (distance > -support * (1 + 1e-6))
        count = int(fluid.sum())
        dummies = int(seen.sum()) if geometry.has_solid else 0
        self.particles = {"fluid": count, "dummy": dummies, "left_out": phase.size - count - dummies}
        self.per_fluid = np.bincount(phase[fluid], minlength=1) if count else np.zeros(1, dtype=int)

    def fluid(self, k: int = 0) -> np.ndarray:
        """Mask of the fluid in the sample on site k of the cells, [x, y(, z)]."""
        return self.phase[self.sample][..., k] >= 0

    def connectivity(self) -> Connectivity:
        """Of the sample; of lattices with two sites a cell, that of the better connected one."""
        volume = float(self.lattice.cell.prod())
        found = [report(self.fluid(k).T, self.around, volume) for k in range(self.phase.shape[-1])]
        return max(found, key=lambda c: (sum(c.percolates), c.largest_share))

    def points(self, most: int) -> np.ndarray:
        """Positions of some fluid sites, at most `most`, spread evenly; (n, dim)."""
        flat = np.flatnonzero(self.phase >= 0)
        return self.positions(flat[:: -(-len(flat) // most)])

    def positions(self, flat: np.ndarray) -> np.ndarray:
        """Positions (n, dim) of sites by their flat number."""
        *cell, k = np.unravel_index(flat, self.phase.shape)
        return self.lattice.corner + (np.stack(cell, axis=1) + self.lattice.basis[k]) * self.lattice.cell


def _cells_between(lattice: Lattice, lower: np.ndarray, upper: np.ndarray) -> tuple[slice, ...]:
    """Cells whose middle lies between two corners."""
    middle = [c + (np.arange(n) + 0.5) * h for c, n, h in zip(lattice.corner, lattice.counts, lattice.cell)]
    ends = [np.searchsorted(m, (a, b)) for m, a, b in zip(middle, lower, upper)]
    return tuple(slice(int(first), max(int(end), int(first) + 1)) for first, end in ends)


# -- what the scene uses ---------------------------------------------------------------------------------


def terms(case: Case, geometry: Geometry) -> list[Term]:
    """The parts of the physics, used and left out."""
    moving = case.flow != "stokes"
    wall = geometry.has_solid
    moves = wall and bool(np.any(geometry.wall_speed))
    slips = wall and bool(np.any(geometry.slip_length > 0))
    around = "".join(a for a, p in zip(AXES, geometry.periodic) if p)
    fluids = list(case.fluids.values())
    jumps = len({f.mu for f in fluids}) > 1 or len({f.density for f in fluids}) > 1
    shifts = moving and case.particles.shifting > 0
    keeps = moving and case.particles.keep_volume > 0
    layered = around and any(a not in case.geometry.periodic for a in around)
    halo = f"along {around}" + (", closed by clear layers" if layered else "")
    tension = case.interface
    line_slip = tension.slip_length if wall and tension is not None else 0.0
    added = 0.0
    if tension is not None:
        from ..two_phase.surface_tension import damping

        added, _ = damping(tension.tension, [f.density for f in fluids], [f.mu for f in fluids],
                           case.particles.spacing)
    starts = case.initial is not None and bool(case.initial.velocity)
    flood = case.initial.flood if case.initial else None
    return [
        Term("walls", wall, f"distance {case.wall_distance}" if wall else "no solid and no closed face"),
        Term("moving walls", moves, "a wall has a velocity" if moves else "all walls are at rest"),
        Term("slip", slips or line_slip > 0, "a wall has a slip length" if slips else
             f"{line_slip:g} m at contact lines" if line_slip > 0 else "no slip length"),
        Term("periodic halo", bool(around), halo if around else "no periodic axis"),
        Term("inertia", moving, "particles move, in time" if moving else "flow: stokes"),
        Term("viscosity", True, "implicit: no stability limit"),
        Term("fluid contrasts", jumps, "density or viscosity differ" if jumps else "equal or one fluid"),
        Term("shifting", shifts, f"C = {case.particles.shifting:g}" if shifts
             else "particles stay on the lattice" if not moving else "particles.shifting is 0"),
        Term("kept volume", keeps, f"in {case.particles.keep_volume:g} steps" if keeps
             else "particles stay on the lattice" if not moving else "particles.keep_volume is 0"),
        Term("surface tension", tension is not None,
             f"{tension.tension:g} N/m, {tension.method}" if tension else "no interface"),
        Term("artificial viscosity", added > 0, f"{added:.2g} Pa s at the interface, which hardly damps" if added
             else "no interface" if not tension else "the interface damps enough at this spacing"),
        Term("contact angle", tension is not None and wall,
             "no interface" if not tension else f"{tension.contact_angle:g} degrees" if wall else "no walls"),
        Term("drive", case.drive is not None, drive_of(case)),
        Term("initial velocity", starts, "formula" if starts else "starts at rest"),
        Term("flooding", flood is not None, f"{flood.fluid} from {flood.face}" if flood else "none"),
    ]  # fmt: skip


def drive_of(case: Case) -> str:
    """What moves the fluid, in words."""
    if case.drive is None:
        return "no drive"
    held = ["a velocity is held by a pressure drop"] if case.drive.superficial_velocity else []
    return " and ".join(held + (["body force"] if case.drive.body_force or not held else []))


def driven_axes(case: Case, dim: int) -> list[int]:
    """Axes along which the drive pushes, the strongest first."""
    drive = case.drive
    if drive is None:
        return []
    if drive.named_axes:
        return [AXES.index(name) for name in drive.named_axes]
    push = np.abs(_acceleration(case, dim))
    return [int(axis) for axis in np.argsort(-push, kind="stable") if push[axis] > 0]


def _acceleration(case: Case, dim: int, length: np.ndarray | None = None) -> np.ndarray:
    """Acceleration (dim,) of the drive, m/s2; of a pressure drop over 1 m where no length is given."""
    drive = case.drive
    g = np.zeros(dim)
    if drive is not None and drive.body_force:
        g += np.asarray(drive.body_force, dtype=float)[:dim]
    if drive is not None and drive.pressure_drop:
        density = next(iter(case.fluids.values())).density
        for name, drop in drive.pressure_drop.items():
            axis = AXES.index(name)
            if axis < dim:
                g[axis] += drop / density / (1.0 if length is None else length[axis])
    return g


# -- how wide the pores are ------------------------------------------------------------------------------


def throats(sites: Sites, geometry: Geometry, spacing: float, axes: Sequence[int]) -> Throats | None:
    """Widths of the pores in spacings; `axes`: those for which the critical width is wanted.

    A centre line is where no neighbouring site is farther from the walls by more than half a spacing: beside
    it the distance grows by a whole one. The width is twice the largest distance there, looked up half a
    spacing around each point too, because the centre may lie between sites.
    """
    distance = sites.distance[..., 0]
    fluid = sites.phase[..., 0] >= 0
    modes = ["wrap" if p else "nearest" for p in geometry.periodic]
    near = ndimage.maximum_filter(distance, size=3, mode=modes)
    line = np.zeros(sites.phase.shape, dtype=bool)
    line[..., 0] = fluid & (near - distance < 0.5 * spacing)
    line[..., 0] &= _in(sites.sample, fluid.shape)
    flat = np.flatnonzero(line)
    if not len(flat):
        return None
    width = _widths(sites.positions(flat[:: -(-len(flat) // LINE_POINTS)]), geometry, spacing)
    narrow, median = np.percentile(width, [10, 50])
    thin = float(width[width < THIN - TINY].sum() / width.sum())
    inside = np.where(fluid, distance, 0)[sites.sample]
    critical = {
        axis: _critical(inside, sites.around, axis, spacing) / spacing
        for axis in axes
        if geometry.periodic[axis]
    }
    return Throats(float(narrow), float(median), thin, critical)


def _in(part: tuple[slice, ...], shape: tuple[int, ...]) -> np.ndarray:
    mask = np.zeros(shape, dtype=bool)
    mask[part] = True
    return mask


def _widths(x: np.ndarray, geometry: Geometry, spacing: float) -> np.ndarray:
    """Twice the largest wall distance within half a spacing of each point, in spacings."""
    half = np.array(np.meshgrid(*[[-0.5, 0.0, 0.5]] * x.shape[1])).reshape(x.shape[1], -1).T * spacing
    largest = np.zeros(len(x))
    for offset in half:
        largest = np.maximum(largest, geometry.distance(x + offset))
    return 2 * largest / spacing


def _critical(distance: np.ndarray, around: tuple[bool, ...], axis: int, spacing: float) -> float:
    """Diameter of the largest ball that passes along the axis, m; distance: [x, y(, z)], 0 in solids."""
    low, high = 0.0, float(distance.max())
    while high - low > 0.02 * spacing:
        middle = (low + high) / 2
        passes = report((distance >= middle).T, around).percolates[axis]
        low, high = (middle, high) if passes else (low, middle)
    return 2 * low + 0.5 * spacing  # the centre of the throat lies up to half a spacing beside a site


# -- how fast and for how long ---------------------------------------------------------------------------


def flow_estimate(
    case: Case, geometry: Geometry, sites: Sites, widths: Throats | None, driven: Sequence[int]
) -> Flow | None:
    """Largest velocity to expect: of the walls, at the start, or by the drive; None where nothing tells."""
    length = geometry.upper - geometry.lower
    width = _width(widths, case.particles.spacing, length)
    nu = min(f.nu for f in case.fluids.values())
    found: list[tuple[float, str]] = []
    if geometry.has_solid and np.any(geometry.wall_speed):
        found.append((float(geometry.wall_speed.max()), "moving wall"))
    if case.initial is not None and case.initial.velocity:
        variables = dict(zip(AXES, sites.points(LINE_POINTS).T))
        start = np.stack([expressions.evaluate(f, **variables) for f in case.initial.velocity], axis=1)
        found.append((float(np.linalg.norm(start, axis=1).max()), "initial velocity"))
    g = float(np.linalg.norm(_acceleration(case, geometry.dim, length)))
    if g > 0 and driven and not (case.drive and case.drive.axes):
        creeping = (g * width**2 / (8 * nu), "creeping flow in the throats, g w2 / 8 nu")
        end = case.time.end if case.time else None
        inertial = (math.sqrt(2 * g * float(np.max(length))), "free fall over the box")
        started = (g * end, "acceleration until the end") if end else inertial
        found.append(min(creeping, inertial, started, key=lambda estimate: estimate[0]))
    if case.drive is not None and case.drive.superficial_velocity:
        porosity = sites.particles["fluid"] * sites.lattice.site_volume / float(np.prod(length))
        (held,) = case.drive.superficial_velocity.values()
        found.append((abs(held) / porosity, "held superficial velocity over the porosity"))
    if case.interface is not None:
        rho = max(f.density for f in case.fluids.values())
        found.append(
            (math.sqrt(case.interface.tension / (rho * width)), "surface tension, sqrt(sigma / rho w)")
        )
    if not found or max(estimate for estimate, _ in found) == 0:
        return None
    u, source = max(found, key=lambda estimate: estimate[0])
    mu = max(f.mu for f in case.fluids.values())
    capillary = mu * u / case.interface.tension if case.interface else None
    return Flow(u, source, u * width / nu, capillary)


def _width(widths: Throats | None, spacing: float, length: np.ndarray) -> float:
    """Width that the estimates take, m: the critical or the median throat, else the box."""
    if widths is None:
        return float(length.min())
    return spacing * (max(widths.critical.values()) if widths.critical else widths.median)


def steps(case: Case, flow: Flow | None, widths: Throats | None) -> Steps:
    """Time-step limits of a run in time, and its steps."""
    spacing, fluids = case.particles.spacing, list(case.fluids.values())
    assert case.time is not None
    limits = {}
    if case.time.step:
        limits["fixed"] = case.time.step
    if flow is not None:
        limits["cfl"] = case.time.cfl * spacing / flow.velocity
    if case.interface is not None:
        density = sum(f.density for f in fluids) / len(fluids)
        wave = math.sqrt(density * spacing**3 / (2 * math.pi * case.interface.tension))
        limits["capillary"] = case.time.capillary * wave
    limits["viscous accuracy"] = spacing**2 / max(f.nu for f in fluids)
    step = case.time.step or min(
        dt for name, dt in limits.items() if name != "viscous accuracy" or len(limits) == 1
    )
    end = case.time.end
    count = None if end is None else max(end / step, 1.0)
    if case.time.steady and widths is not None:
        slowest = min(f.nu for f in fluids)
        decay = (widths.median * spacing) ** 2 / (math.pi**2 * slowest)
        steady = max(decay * math.log(1 / case.time.steady) / step, STEPS_TO_STEADY)
        count = steady if count is None else min(count, steady)
    count = None if count is None else min(count, float(case.time.max_steps))
    return Steps(limits, count)


# -- what it costs ---------------------------------------------------------------------------------------


def _costs(result: CheckReport, geometry: Geometry) -> None:
    """Neighbours, memory and time."""
    case, dim = result.case, result.dim
    result.neighbours = memory.neighbours(case, dim)
    spacing = case.particles.spacing
    finest = (spacing / min(case.spacings)) ** dim
    fluid, labels = result.particles["fluid"] * finest, geometry.labels
    result.memory = memory.estimate(case, dim, geometry.has_solid, fluid, result.particles.get("dummy", 0) * finest,
                                    0 if labels is None else labels.size, two=len(case.fluids) > 1)
    runs: float | None = 1.0
    if case.flow == "stokes":
        sizes = sum((spacing / other) ** dim for other in case.spacings) / finest
        runs = sizes * max(len(case.drive.axes or ()) if case.drive else 0, 1)
    elif result.steps is not None:
        runs = result.steps.count
    density_of_pairs = result.neighbours / (memory.PAIRS[dim] * 2.1**dim)
    if runs is not None:
        result.seconds = fluid * runs * density_of_pairs * MICROSECONDS[case.flow, dim] * 1e-6


def machine_memory() -> float | None:
    """Bytes of memory of this machine; None where it does not tell."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return None


# -- what may go wrong -----------------------------------------------------------------------------------


def _drive_findings(
    result: CheckReport, geometry: Geometry, driven: Sequence[int], through: Sequence[int]
) -> None:
    """Nothing can flow: an error of a steady case; a warning of others and of too coarse a lattice."""
    case = result.case
    steady = case.flow == "stokes" or (case.time is not None and case.time.steady is not None)
    moved = geometry.has_solid and bool(np.any(geometry.wall_speed))
    held = bool(case.drive and case.drive.superficial_velocity)
    for axis in driven:
        if axis in through or (len({f.density for f in case.fluids.values()}) > 1 and not held):
            continue  # a light fluid rises between walls too
        name, fatal = AXES[axis], held or (steady and not through and not moved)
        if not opens(case, axis):
            found = why_closed(case, axis)
        elif _open_when_finer(case, geometry, axis):
            fatal = False
            found = f"throats along {name} are closed on this lattice; take a smaller particles.spacing"
        else:
            found = (
                f"no pore leads through the scene along {name}: its permeability is zero; check what is solid "
                "(by faces of lattice sites; isph run also counts particles that see each other across an edge)"
            )
        (result.errors if fatal else result.warnings).append(found)
    if case.drive is None and case.flow == "stokes" and not moved:
        result.errors.append("nothing moves the fluid; give a drive or a wall with a velocity")


def _open_when_finer(case: Case, geometry: Geometry, axis: int) -> bool:
    """Whether what the lattice finds closed along an axis is open by the voxels, or at half the spacing."""
    lower, upper, edges = geometry.sample_lower, geometry.sample_upper, geometry.voxel_size
    if edges is None:
        edges = np.full(geometry.dim, case.particles.spacing / 2)
    cells = np.maximum(np.rint((upper - lower) / edges), 1).astype(int)
    around = tuple(AXES[a] in case.geometry.periodic for a in range(geometry.dim))
    lattice = Lattice(np.full((1, geometry.dim), 0.5), (upper - lower) / cells, cells, lower)
    fluid = np.concatenate([geometry.phase(x) >= 0 for x in lattice.slabs()]).reshape(cells)
    return bool(report(fluid.T, around).percolates[axis])


def _resolution_findings(result: CheckReport, geometry: Geometry, lattice: Lattice) -> Iterator[str]:
    """Lattice against throats, voxels, clear layers and box."""
    case, widths = result.case, result.throats
    spacing = case.particles.spacing
    if widths is not None and widths.median < THINNEST - TINY:
        yield (
            f"the median throat is {widths.median:.1f} particles wide: expect errors of 15 % and more; take "
            f"particles.spacing {spacing * widths.median / THIN:.2g} or less for {THIN}"
        )
    for axis, width in (widths.critical if widths is not None else {}).items():
        if width < THINNEST:
            yield (
                f"the way along {AXES[axis]} leads through a throat of about {width:.1f} particles: "
                "its flow is not resolved"
            )
    voxels = case.geometry.voxels
    if voxels is not None:
        assert geometry.voxel_size is not None
        sizes = np.unique(geometry.voxel_size)
        for size in sizes:
            ratio = max(size / spacing, spacing / size)
            if abs(ratio - round(ratio)) > 1e-3:
                fits = size / max(round(size / spacing), 1)
                yield (
                    f"the spacing {spacing:g} does not divide the voxel size {size:g}: particles lie "
                    f"differently to the walls from voxel to voxel; take particles.spacing {fits:.6g}"
                )
        layer = 6 * float(sizes.min()) if voxels.clear_layer is None else voxels.clear_layer
        added = any(p and a not in case.geometry.periodic for a, p in zip(AXES, geometry.periodic))
        if added and layer < case.support * spacing * (1 - TINY):
            yield (
                f"the clear layer, {layer:g}, is thinner than the support {case.support * spacing:.3g}: the "
                "two ends of the image see each other; make geometry.voxels.clear_layer larger"
            )
    stretch = (
        lattice.cell
        / spacing
        / np.array([1, math.sqrt(3) if "hex" in case.lattice_in(result.dim) else 1, 1][: result.dim])
    )
    for axis in range(result.dim):
        if abs(stretch[axis] - 1) > 0.01:
            yield (
                f"the box along {AXES[axis]} is no whole number of spacings: the lattice is stretched by "
                f"{100 * (stretch[axis] - 1):+.1f} % there"
            )


def _other_findings(result: CheckReport, geometry: Geometry, sites: Sites) -> Iterator[str]:
    """Memory, Reynolds number, fluids without particles, pockets."""
    case, there = result.case, machine_memory()
    need = sum(result.memory.values())
    if there is not None and need > there:
        yield f"needs about {_bytes(need)}, this machine has {_bytes(there)}; take a larger particles.spacing"
    if (
        case.flow == "stokes"
        and result.flow is not None
        and result.flow.reynolds
        and result.flow.reynolds > 1
    ):
        yield f"flow: stokes leaves out inertia, but the Reynolds number is about {result.flow.reynolds:.2g}"
    c = result.connectivity
    if c is not None and geometry.has_solid and c.isolated_pockets and any(c.percolates):
        share = 1 - max(c.percolating_porosity) / c.porosity
        if share > 0.05:
            yield f"{100 * share:.0f} % of the fluid lies in pockets that no flow passes through"


def _absent_fluids(case: Case, sites: Sites) -> Iterator[str]:
    flooded = case.initial.flood.fluid if case.initial and case.initial.flood else None
    for k, name in enumerate(case.fluids):
        if name != flooded and (k >= len(sites.per_fluid) or not sites.per_fluid[k]):
            yield f"fluids.{name} has no particle: the scene runs as one of a single fluid"


# -- text ------------------------------------------------------------------------------------------------


def _lines(r: CheckReport) -> Iterator[str]:
    case = r.case
    yield f"{case.path or 'case'}: {case.title}".rstrip(": ")
    if not r.terms:  # refused by its size
        yield from (_row("ERROR", text) for text in r.errors)
        yield _row("verdict", "cannot run")
        return
    yield from (_row(name, text) for name, text in r.inputs)
    used = [f"{t.name} ({t.why})" for t in r.terms if t.used]
    out = [f"{t.name} ({t.why})" for t in r.terms if not t.used]
    yield _row("uses", "; ".join(used))
    yield _row("leaves out", "; ".join(out))
    if r.particles:
        p = r.particles
        kind = f"{case.lattice_in(r.dim)}, spacing {case.particles.spacing:g} m, support {case.support:g}"
        yield _row("lattice", f"{r.dim}D {kind}, about {r.neighbours:.0f} neighbours")
        more = f"{p['dummy']} dummy, {p['left_out']} sites left out" if "dummy" in p else "dummies not counted"
        yield _row("particles", f"{p['fluid']} fluid, {more}")
    if r.connectivity is not None:
        yield from _pore_lines(r.connectivity, r.throats)
    if r.flow is not None:
        numbers = [f"about {r.flow.velocity:.2g} m/s ({r.flow.source})"]
        numbers += [f"Re {r.flow.reynolds:.2g}"] if r.flow.reynolds is not None else []
        numbers += [f"Ca {r.flow.capillary:.2g}"] if r.flow.capillary is not None else []
        yield _row("flow", ", ".join(numbers))
    if r.steps is not None:
        limits = ", ".join(f"{name} {dt:.2g} s" for name, dt in r.steps.limits.items())
        count = "steps: no telling" if r.steps.count is None else f"about {r.steps.count:.2g} steps"
        yield _row("time step", f"{limits}; smallest: {r.steps.binding}; {count}")
    if r.memory:
        parts = ", ".join(f"{name} {_bytes(b)}" for name, b in r.memory.items())
        yield _row("memory", f"about {_bytes(sum(r.memory.values()))} ({parts})")
        if r.seconds is not None:
            yield _row("time", f"about {_seconds(r.seconds)} on one core, compilation not counted")
    for text in r.warnings:
        yield _row("WARNING", text)
    for text in r.errors:
        yield _row("ERROR", text)
    yield _row("verdict", "can run" if r.can_run else "cannot run")


def _pore_lines(c: Connectivity, widths: Throats | None) -> Iterator[str]:
    axes = AXES[: len(c.percolates)]
    connected = [f"{a} ({100 * f:.2f} %)" for a, p, f in zip(axes, c.percolates, c.percolating_porosity) if p]
    yield _row(
        "pores",
        f"porosity {100 * c.porosity:.2f} %, {c.components} connected, {c.isolated_pockets} closed pockets; "
        f"connected along {', '.join(connected) or 'no axis'}",
    )
    if widths is not None:
        critical = "".join(f"; {AXES[a]} passes a ball of {w:.1f}" for a, w in widths.critical.items())
        yield _row(
            "throats",
            f"in particles: 10 % below {widths.narrow:.1f}, median {widths.median:.1f}{critical}; "
            f"{100 * widths.thin:.0f} % of the fluid has fewer than {THIN} across",
        )


def _row(name: str, text: Any) -> str:
    return f"  {name:10}  {text}"


def _bytes(number: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.0f} B"


def _seconds(seconds: float) -> str:
    from ..output.progress import duration

    return duration(max(seconds, 0.1))
