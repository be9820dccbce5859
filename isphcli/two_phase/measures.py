"""What is measured of two fluids as a run goes. Imported only by scenes with two fluids.

Volumes and areas are those of the cells that the interface cuts (`cut_cells`); of fluids that differ in name only the
volumes of the particles, 1 / sum W (eq. 7), scaled so that together they fill the pores.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..domain import reduce
from ..domain.components import parts_of
from ..domain.halo import nearest_image
from ..flow.state import phase_of
from ..geometry.extents import POINTS, fluid_part_of_sample, part_of_sample
from ..geometry.protocol import Geometry, inside_sample
from ..operators.apply import gradient_one_sided
from .cut_cells import CutCells, outline
from .interface import Interface

if TYPE_CHECKING:
    from ..flow.held_velocity import HeldVelocity
    from ..flow.one_fluid import Fluids
    from ..flow.state import Configuration, State
    from ..operators.pair_weights import Operators

Centre = list[float | None]  # (dim,) m, None along a periodic axis that a fluid lies all round

SELDOM = 20  # steps between ganglia and contact angles
ADJACENT = 1.25  # mean distances of particles: unlike ones nearer than this have the interface between them
JOINED = 1.5  # mean distances of particles V^(1/dim) that like particles of one ganglion are apart at most
ROUND = 0.1  # length of the mean direction round a periodic axis below which a fluid has no centre there
# Points of the interface that a circle or sphere is fitted to are at least a support off the wall (nearer, the average
# of the colour sees the wall), and at most this many mean distances (farther, gravity and flow may have bent it). Caps
# of 22 across, scatter of the angle at 60 to 150 degrees: up to 9, 5 and 1.7 degrees with 8, 10 and 16.
FARTHEST = 16.0
FLAT = 0.1  # mean distances by which the wall under those points may differ from a plane
OFF = 5.0  # degrees by which a drop may miss its contact angle at the end before a run says so
ON_ARC = 0.5  # mean distances by which the points may differ from their circle (root mean square)


class MeasuredFluid(NamedTuple):
    """name: in the case; density: kg/m3; viscosity: dynamic, Pa s."""

    name: str
    density: float
    viscosity: float


class Measures:
    """fluids: both; phase: (n,) int8 of fluids that differ in name only, else of the start; geometry: Geometry; size:
    of a particle, its volume, m^dim, and extents (dim,), m (`geometry.extents`); flowing: OneFluid or TwoFluids, with
    the density that `State.p` is over and the tension; held: the flux that is held, whose capillary number is told, or
    None; amplitude: function of the positions (n, dim), volumes (n,) and volume fractions (n,), m, or None."""

    def __init__(self, fluids: Sequence[MeasuredFluid], phase: np.ndarray, geometry: Geometry,
                 size: tuple[float, np.ndarray], flowing: Fluids, held: HeldVelocity | None = None,
                 amplitude: Callable[[np.ndarray, np.ndarray, np.ndarray], float] | None = None):
        self.names, self.density, self.viscosity = zip(*fluids)
        self.phase, self.geometry, self.tension, self.pressure = phase, geometry, flowing.tension, flowing.reference
        (self.site_volume, self.thick), self.held, self.amplitude = size, held, amplitude
        self.distance = self.site_volume ** (1.0 / geometry.dim)
        self._kept: tuple[np.ndarray, np.ndarray] | None = None  # middles of the cells, parts of their fluid
        self.centres: list[Centre | None] = [None, None]

    def __call__(self, state: State, config: Configuration, everything: bool = False) -> dict[str, Any]:
        """Entries of a row of the history; what takes longer (ganglia, contact angle) only every `SELDOM` steps, unless
        everything is asked for, and otherwise None."""
        if state.phi is not None:
            self.phase = phase_of(state.phi)
        volume = config.ops.volume[: len(state.x)]
        number, whole = reduce.totals(len(volume), volume)
        volume = volume * (self.site_volume * number / whole)
        row = self._fluids(state, config, volume)
        if self.amplitude is not None:
            row["amplitude"] = self.amplitude(state.x, volume, _interface(config).fraction)
        everything = everything or state.step % SELDOM == 0
        if self.tension is not None:
            row |= self._interface(state, config)
            if self.geometry.has_solid:
                row["contact_angle"] = self.contact_angle(config) if everything else None
        for k, name in enumerate(self.names):
            row[f"ganglia_{name}"] = self.ganglia(config, k) if everything else None
        return row

    def phase_at(self, config: Configuration) -> np.ndarray:
        """(n,) int8 fluid of each particle of a configuration."""
        return self.phase if config.terms.interface is None else config.terms.interface.phase

    def resume(self, row: Mapping[str, Any]) -> None:
        """Takes up the centres of a row of the history, so that those of a restarted run do not jump by a period."""
        self.centres = [[row.get(f"centre_{a}_{name}") for a in "xyz"[: self.geometry.dim]] for name in self.names]

    def _fluids(self, state: State, config: Configuration, volume: np.ndarray) -> dict[str, Any]:
        row: dict[str, Any] = {}
        phase, interface = self.phase_at(config), config.terms.interface
        masks = [phase == k for k in (0, 1)]
        if interface is None:
            x, parts = state.x, [volume * mask for mask in masks]
            part = fluid_part_of_sample(self.geometry, x, self.thick)
            means = [reduce.mean(state.u[mask]) for mask in masks]
        else:
            cut = _interface(config).cut
            assert cut is not None
            x, parts = cut.cells.middle, [cut.volume, cut.cells.fluid - cut.volume]
            means, part = self._mean_velocities(state.u, config, cut), self._fluid_of_sample(cut)
        inside = part > 0.0
        sums = reduce.totals(*parts, *(held[inside] * part[inside] for held in parts),
                             *((state.u[mask] ** 2).ravel() for mask in masks))
        whole, sample, square = sums[:2], sums[2:4], sums[4:]
        centres = self._centres(*((x[held > 0.0], held[held > 0.0], then) for held, then in zip(parts, self.centres)))
        for k, name in enumerate(self.names):
            row[f"volume_{name}"] = float(whole[k])
            row[f"saturation_{name}"] = float(sample[k] / (sample[0] + sample[1]))
            self.centres[k] = centres[k]
            row |= {f"centre_{a}_{name}": c for a, c in zip("xyz", centres[k])}
            row |= {f"velocity_{a}_{name}": float(v) for a, v in zip("xyz", means[k])}
            row[f"kinetic_energy_{name}"] = float(0.5 * self.density[k] * self.site_volume * square[k])
        return row

    def _fluid_of_sample(self, cut: CutCells) -> np.ndarray:
        """(n_cells,) parts, 0 to 1, of the fluid in the cells that lie in the sample: found once, the cells stay."""
        middle = cut.cells.middle
        if self._kept is None or self._kept[0] is not middle:
            self._kept = middle, fluid_part_of_sample(self.geometry, middle, cut.cells.side, POINTS)
        return self._kept[1]

    def _mean_velocities(self, u: np.ndarray, config: Configuration, cut: CutCells) -> list[np.ndarray]:
        """Of both fluids over their volumes, (dim,) m/s each; u: (n, dim).

        The mean over its particles jumps where the interface moves past one, by 1 % for a bubble of 490. Here each cell
        has the velocity of the nearest particle, with its gradient, in the middle of what the cell holds of the fluid.
        """
        ops, cells, sums = config.ops, cut.cells, list[np.ndarray]()
        velocity, normals, gradients = ops.exchange.forward_each(
            u, _interface(config).normal, gradient_one_sided(ops, u).reshape(len(u), ops.dim**2))
        length = self.geometry.upper - self.geometry.lower
        for k, volume in enumerate((cut.volume, cells.fluid - cut.volume)):
            seen = (volume > 0.0) & (cut.nearest[:, k] >= 0)
            near, volume = cut.nearest[seen, k], volume[seen]
            normal = normals[near] * (1.0 - 2.0 * k)  # into fluid k
            beside = 0.5 * (1.0 - volume / cells.fluid[seen])[:, None] * normal * cells.side  # middle of a slab
            way = nearest_image(cells.middle[seen] + beside - config.neighbours.x[near], length, self.geometry.periodic)
            there = velocity[near] + np.einsum("ncd,nd->nc", gradients[near].reshape(-1, ops.dim, ops.dim), way)
            sums += [volume[:, None] * there, volume]
        moved, first, moved_second, second = reduce.totals(*sums)
        return [np.asarray(flux / volume) if volume > 0.0 else np.asarray(reduce.mean(u[self.phase_at(config) == k]))
                for k, (flux, volume) in enumerate(((moved, first), (moved_second, second)))]

    def _centres(self, *given: tuple[np.ndarray, np.ndarray, Centre | None]) -> list[Centre]:
        """Centres of volume, lists of dim, m, of several (places (n, dim), their volumes (n,), the centre before or
        None): None along a periodic axis that the fluid lies all round, else in the period nearest to the centre
        before."""
        periodic, lower = np.array(self.geometry.periodic), self.geometry.lower
        length, middles, sums = self.geometry.upper - lower, list[np.ndarray](), list[list[np.ndarray]]()
        # along a periodic axis about the mean direction round it
        angles = [2.0 * math.pi * (x - lower) / length for x, _, _ in given]
        parts = [part for (x, volume, _), angle in zip(given, angles) for part in (
            volume[:, None] * np.sin(angle), volume[:, None] * np.cos(angle), volume[:, None] * x, volume)]
        whole = reduce.totals(*parts)
        for k in range(len(given)):
            sums.append(whole[4 * k : 4 * k + 4])
            middles.append(lower + length * (np.arctan2(*sums[k][:2]) / (2.0 * math.pi) % 1.0))
        offsets = reduce.totals(*(volume[:, None] * ((x - middle + length / 2) % length - length / 2)
                                  for (x, volume, _), middle in zip(given, middles)))
        found = list[Centre]()
        for (_, _, before), (sine, cosine, plain, volume), middle, offset in zip(given, sums, middles, offsets):
            mean = np.where(periodic, middle + offset / volume, plain / volume)
            all_round = periodic & (np.hypot(sine, cosine) < ROUND * volume)
            known = before if before is not None else [None] * len(mean)
            found.append([None if all_round[a] else float(here) if then is None or not periodic[a]
                          else float(here + length[a] * round((then - here) / length[a]))
                          for a, (here, then) in enumerate(zip(mean, known))])
        return found

    def _interface(self, state: State, config: Configuration) -> dict[str, Any]:
        assert self.tension is not None
        sigma, interface = self.tension.tension, _interface(config)
        assert interface.cut is not None
        part = part_of_sample(self.geometry, interface.cut.cells.middle, interface.cut.cells.side)
        inside = part > 0.0
        area, flux = reduce.totals(interface.cut.area[inside] * part[inside], state.u)
        area, circularity = float(area), None
        if self.geometry.dim == 2 and any(self._enclosed(state.x[interface.phase == k]) for k in (0, 1)):
            area, within = outline(interface.cut)
            circularity = 2.0 * math.sqrt(math.pi * within) / area if area > 0.0 else None
        flux *= self.site_volume / np.prod(self.geometry.upper - self.geometry.lower)
        if self.held is not None:
            flux[self.held.axis] = self.held.flux(state.x, state.u)
        speed = np.sqrt(reduce.largest((state.u * state.u).sum(axis=1)))
        row: dict[str, Any] = {
            "interface_area": area, "surface_energy": sigma * area,
            "pressure_jump": self._jump(state, config) * self.pressure,
            "capillary_number": float(np.linalg.norm(flux) * max(self.viscosity) / sigma),
            "peak_capillary_number": float(speed * max(self.viscosity) / sigma),
        }
        if self.geometry.dim == 2:
            row["circularity"] = circularity
        return row

    def _enclosed(self, x: np.ndarray) -> bool:
        """Whether particles (m, dim) keep off the walls and leave a gap along every periodic axis."""
        if reduce.smallest(self.geometry.distance(x)) < self.distance:
            return False
        for axis in np.flatnonzero(self.geometry.periodic):
            length = self.geometry.upper[axis] - self.geometry.lower[axis]
            if self._widest_gap(x[:, axis] - self.geometry.lower[axis], length) < JOINED * self.distance:
                return False
        return True

    def _widest_gap(self, along: np.ndarray, length: float) -> float:
        """Between coordinates (m,) in a period from 0 to `length`, m, of all processes; 0 if it is below a distance."""
        count = math.ceil(length / self.distance)
        cell = np.clip((along / length * count).astype(int), 0, count - 1)
        last, first = reduce.largest_by(cell, along, count), -reduce.largest_by(cell, -along, count)
        full = np.flatnonzero(np.isfinite(last))
        gaps = np.append(first[full[1:]], first[full[:1]] + length) - last[full]
        return float(gaps.max(initial=0.0))

    def _jump(self, state: State, config: Configuration) -> float:
        """Of the pressure, m2/s2, from the second fluid to the first, at the interface: a linear function of the
        distance through the particles of each that know theirs and lie off the band, where it is zero. Means over the
        fluids would have the weight of what lies between their centres in them. Of interfaces in the sample, where
        there are any: at a seam of two reservoirs nothing jumps."""
        interface, p = _interface(config), state.p
        near = (interface.strength == 0.0) & (np.abs(interface.phi) < interface.reach)
        inside = near & inside_sample(self.geometry, state.x)
        mine = [interface.phase == k for k in (0, 1)]
        if min(reduce.totals(*(inside & some for some in mine))) > 0:
            near = inside
        counts = reduce.totals(*(near & some for some in mine))
        # of a fluid that has none there, all its particles
        taken = [some & near if count > 0 else some for some, count in zip(mine, counts)]
        given = [np.stack([interface.phi[some], p[some], np.ones_like(p[some])], axis=1) for some in taken]
        sums = reduce.totals(*given)
        means = [part[:2] / part[2] for part in sums]
        off = [part[:, :2] - mean for part, mean in zip(given, means)]
        spread = reduce.totals(*(part[:, :1] * part for part in off))
        slopes = [line[1] / line[0] if count > 0 and line[0] > 0.0 else 0.0 for line, count in zip(spread, counts)]
        there = [mean[1] - slope * mean[0] for mean, slope in zip(means, slopes)]
        return float(there[0] - there[1])

    def ganglia(self, config: Configuration, k: int) -> int:
        """Number of the separate parts of fluid k."""
        ops, mine = config.ops, self.phase_at(config) == k
        return parts_of(ops.start, ops.column, ops.exchange.forward(mine), linked(ops, mine, self.distance),
                        ops.exchange)[0]

    def contact_angle(self, config: Configuration) -> float | None:
        """Degrees through the first fluid between a flat wall and the circle or sphere through the interface near it;
        None where there is no such wall or circle, or the circle does not reach the wall."""
        from ..geometry.wall_normals import wall_normals

        assert self.tension is not None
        points = self._interface_points(config)
        depth = self.geometry.distance(points) if len(points) else np.zeros(0)
        kept = (depth > self.tension.support) & (depth < FARTHEST * self.distance)
        points, depth = points[kept], depth[kept]
        normals = wall_normals(self.geometry, points, self.distance)
        # a process knows the walls of its own brick; the points are of a surface, and few
        points, depth, normals = reduce.together(points, depth, normals)
        if len(points) == 0:
            return None
        same = normals @ normals[np.argmin(depth)] > 0.99
        points, depth, normal = points[same], depth[same], normals[np.argmin(depth)]
        if len(points) < 3 * self.geometry.dim:
            return None
        phase = self.phase_at(config)
        centre = self._centre_of_drop(config.x, phase)
        points = self._round(points, centre)
        off, middle, radius = self._fit(points)
        foot = points @ normal - depth  # of the wall along its normal
        if off > ON_ARC * self.distance or np.ptp(foot) > FLAT * self.distance:
            return None
        height = float(middle @ normal - foot.mean())
        if abs(height) > radius + self.distance:
            return None
        through = math.degrees(math.acos(min(max(-height / radius, -1.0), 1.0)))
        inside = self._first_inside(middle, radius, points, config.x, phase)
        if not self._on_one_wall(config.x[phase == (0 if inside else 1)], normal):
            return None
        return through if inside else 180.0 - through

    def _on_one_wall(self, mine: np.ndarray, normal: np.ndarray) -> bool:
        """Whether all that particles (m, dim) touch is a wall of this normal (dim,): a slug between plates is no
        drop."""
        from ..geometry.wall_normals import wall_normals

        at_wall = mine[self.geometry.distance(mine) < self.distance]
        return not reduce.any_true(~(wall_normals(self.geometry, at_wall, self.distance) @ normal > 0.99))

    def _interface_points(self, config: Configuration) -> np.ndarray:
        """Points (m, dim) between particles side by side where phi is zero."""
        start, column = config.ops.start, config.ops.column
        phi = config.ops.exchange.forward(_interface(config).phi)
        owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
        unlike = (phi[owner] > 0.0) & (phi[column] <= 0.0)
        inner, outer = phi[owner[unlike]], phi[column[unlike]]
        a, b = config.x[owner[unlike]], config.ops.neighbours.x[config.ops.neighbours.row[unlike]]
        near = ((b - a) ** 2).sum(axis=1) < (ADJACENT * self.distance) ** 2
        return (a + (inner / (inner - outer))[:, None] * (b - a))[near]

    def _centre_of_drop(self, x: np.ndarray, phase: np.ndarray) -> Centre:
        """Centre of the fluid of which there is less, list of dim, None along axes where it has none."""
        mine = x[phase == (0 if reduce.count(phase == 0) <= reduce.count(phase == 1) else 1)]
        return self._centres((mine, np.ones(len(mine)), None))[0]

    def _round(self, points: np.ndarray, centre: Sequence[float | None]) -> np.ndarray:
        """The points with those brought over periodic faces that are then nearer to a centre (entries may be None)."""
        points = points.copy()
        for axis in np.flatnonzero(self.geometry.periodic):
            if (middle := centre[int(axis)]) is not None:
                length = self.geometry.upper[axis] - self.geometry.lower[axis]
                points[:, axis] = middle + (points[:, axis] - middle + length / 2) % length - length / 2
        return points

    @staticmethod
    def _fit(points: np.ndarray) -> tuple[float, np.ndarray, float]:
        """(root mean square distance, centre (dim,), radius) of the circle or sphere through points, m."""
        # |x|^2 = 2 c . x + (r^2 - |c|^2), about the middle of the points and in their size
        middle = points.mean(axis=0)
        size = math.sqrt(((points - middle) ** 2).sum(axis=1).mean())
        local = (points - middle) / size
        matrix = np.column_stack([2.0 * local, np.ones(len(local))])
        solution = np.linalg.lstsq(matrix, (local * local).sum(axis=1), rcond=None)[0]
        centre = solution[:-1]
        radius = math.sqrt(max(solution[-1] + centre @ centre, 0.0))
        off = np.linalg.norm(local - centre, axis=1) - radius
        return size * math.sqrt((off * off).mean()), middle + size * centre, size * radius

    def _first_inside(self, centre: np.ndarray, radius: float, points: np.ndarray, x: np.ndarray,
                      phase: np.ndarray) -> bool:
        """Whether the first fluid is on the inner side of the circle, by the particles that lie next to the points."""
        x = self._round(x[: len(phase)], list(points.mean(axis=0)))
        near = cKDTree(points).query(x, distance_upper_bound=2.0 * self.distance)[0] < np.inf
        inner = np.linalg.norm(x[near] - centre, axis=1) < radius
        first = phase[near] == 0
        return reduce.count(inner == first) > reduce.count(inner != first)


def linked(ops: Operators, mine: np.ndarray, distance: float) -> np.ndarray:
    """(n_pairs,) bool, pairs of the particles `mine` (n,) within JOINED times their mean distance, m, of each other."""
    owner = np.repeat(np.arange(ops.n), np.diff(ops.start))
    mine = ops.exchange.forward(mine)
    pairs = np.flatnonzero(mine[owner] & mine[ops.column])
    offset = ops.neighbours.x[ops.neighbours.row[pairs]] - ops.neighbours.x[owner[pairs]]
    found = np.zeros(len(owner), np.bool_)
    found[pairs] = (offset * offset).sum(axis=1) < (JOINED * distance) ** 2
    return found


def _interface(config: Configuration) -> Interface:
    """The interface of a configuration of fluids that differ or have tension."""
    assert isinstance(config.terms.interface, Interface)
    return config.terms.interface


def summary(measures: Measures, state: State, config: Configuration, rows: Sequence[Mapping[str, Any]],
            driven: bool) -> dict[str, Any]:
    """The block `two_fluids` of summary.json. rows: of the history; driven: whether more than tension moves fluid."""
    block = measures(state, config, everything=True)
    if measures.tension is not None:
        peak = "peak_capillary_number"
        late = [row[peak] for row in rows[int(0.9 * len(rows)):] if row.get(peak)]
        block["spurious_capillary_number"] = max(late, default=block[peak]) if not driven else None
    if "contact_angle" in block:
        block["contact_angle_through"] = measures.names[0]
    return block


def broke_up(names: Sequence[str], rows: Sequence[Mapping[str, Any]], block: Mapping[str, Any]) -> str | None:
    """A sentence on fluids that end in more parts than they began in, or None. rows: of the history, whose first count
    is the start; block: of `summary`."""
    grown = []
    for name in names:
        known = [row for row in rows if row.get(f"ganglia_{name}") is not None]
        if known and block[f"ganglia_{name}"] > known[0][f"ganglia_{name}"]:
            grown.append(f"{name} is in {block[f'ganglia_{name}']:g} parts at t = {rows[-1]['time']:.4g}, was in "
                         f"{known[0][f'ganglia_{name}']:g} at t = {known[0]['time']:.4g}")
    return (f"the interface broke up though nothing drives the flow: {'; '.join(grown)}; more particles across it "
            "(particles.spacing) tell whether it does") if grown else None


def misses_its_angle(asked: float, rows: Sequence[Mapping[str, Any]], block: Mapping[str, Any]) -> str | None:
    """A sentence on a drop that nothing drives and whose contact angle at the end is not the one that was asked for,
    degrees, or None. rows: of the history; block: of `summary`."""
    angle, speed = block.get("contact_angle"), block.get("spurious_capillary_number")
    known = [row for row in rows if row.get("contact_angle") is not None]
    if speed is None or (angle is None and not known):  # something drives it; no drop on a wall
        return None
    if angle is None:
        last = known[-1]
        if abs(last["contact_angle"] - asked) <= OFF:
            return None
        return (f"no contact angle is found at the end, {asked:g} degrees were asked for: the drop came off its wall "
                f"or spread to a film; at t = {last['time']:.4g} the angle was {last['contact_angle']:.1f} degrees")
    if abs(angle - asked) <= OFF:
        return None
    return (f"the contact angle is {angle:.1f} degrees at the end, {asked:g} were asked for: either the drop still "
            f"moves (capillary number of the largest speed {speed:.1e}; a later time.end tells), or near the wall a "
            "fluid is thinner than a spacing, which is not resolved; more particles (particles.spacing) come nearer")
