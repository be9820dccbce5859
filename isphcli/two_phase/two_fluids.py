"""What two fluids put into the equations: weights of pairs across the interface, the transposed stress, tension.

The pressure stays a pressure over the density of the first fluid, so that fluids of one density share every array
with a scene of one fluid. With t the fraction of the way from i to j at which a pair meets the interface
(`unlike_pairs`), r_ij and m_ij are what is left of a density and a viscosity between i and j when the normal
acceleration and the stress are continuous:

    grad p / rho  ->  sum_j (1 / r_ij) (p_j - p_i) grad_ij,      r_ij = t rho_i + (1 - t) rho_j
    mu lap u      ->  sum_j m_ij lap_ij (u_j - u_i),         1 / m_ij = t / mu_i + (1 - t) / mu_j

Both are paired: the Poisson matrix has lap_ij / r_ij (only one of the two blows up at density ratio 10).
Where the viscosity jumps, the transposed stress div(mu (grad u)^T) does not vanish: see `transposed_stress`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.row_threads import over_rows
from ..flow.one_fluid import Terms, ViscousWeights, balanced_force, with_forces
from ..flow.state import phase_of
from ..operators.protocol import WallSums
from .cut_cells import Cells, cut
from .interface import MOST, RATE, Interface, UnlikePairs, carried, find_interface, strain
from .interface_rules import FIRST_PASSES, interface_rules, lacking_viscosity
from .kept_volumes import kept_volumes
from .kinks import Kinks
from .transposed_stress import TransposedStress

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..flow.forces import Force
    from ..operators.pair_weights import Operators
    from ..operators.wall_scene import WallChange
    from .cells_in_sight import CellSight
    from .contact_angle import ContactAngle
    from .sight import Sight
    from .surface_tension import SurfaceTension

# Most sweeps over particles that have come into the other fluid; whole rows of them gain a digit in four sweeps
SWEEPS = 100
SETTLED = 1e-12  # of the largest change of a sweep: below this no more of them are made


class TwoFluidForces(NamedTuple):
    """What moves two fluids.

    body: (dim,) force on both, m/s2; drop_force: (dim,) that of a pressure gradient on the first fluid, m/s2,
    which moves the other as its density lets it; held: (dim,) unit vector along which a velocity is held, or
    None; beside: the forces that are not of the drive.
    """

    body: np.ndarray
    drop_force: np.ndarray
    held: np.ndarray | None = None
    beside: Sequence[Force] = ()


class VolumeGrid(NamedTuple):
    """What the volumes of two fluids are measured on.

    cells: Cells of the box; sight: CellSight of those, where there are walls; sample: corners (dim,) of what is not
    clear of solids, m, where volumes are kept, or None: everywhere.
    """

    cells: Cells
    sight: CellSight | None = None
    sample: tuple[np.ndarray, np.ndarray] | None = None


class TwoFluids:
    """density: (2,) kg/m3; viscosity: (2,) dynamic, Pa s; forces: what moves them; spacing: m; tension:
    SurfaceTension or None; contact: contact_angle.ContactAngle or None; line: contact_angle.SlipAtLine or None."""

    first_passes = FIRST_PASSES

    def __init__(self, density: Sequence[float] | np.ndarray, viscosity: Sequence[float] | np.ndarray,
                 forces: TwoFluidForces, spacing: float, tension: SurfaceTension | None = None,
                 contact: ContactAngle | None = None, line: WallChange | None = None):
        self.density = np.array(density, float)
        self.mu = np.array(viscosity, float)
        self.body, self.drop_force, self.held, self.forces = forces
        self.force = self.body + self.drop_force
        self.spacing, self.tension, self.contact, self.line = spacing, tension, contact, line
        self.grid: VolumeGrid | None = None
        self.rules = interface_rules(self.density, self.mu, 0.0 if tension is None else tension.tension, spacing)
        self.added_viscosity = self.rules.added_viscosity

    @property
    def sight(self) -> Sight | None:
        """How far the fit of the interface sees, where there is tension; else None."""
        return None if self.tension is None else self.tension.sight

    @property
    def reach(self) -> float:
        """How far particles see, m, or the support where that is more."""
        return 0.0 if self.sight is None else self.sight.reach

    @property
    def nu_max(self) -> float:
        """Largest kinematic viscosity, m2/s."""
        return float((self.mu / self.density).max())

    @property
    def nu_min(self) -> float:
        """Smallest kinematic viscosity, m2/s."""
        return float((self.mu / self.density).min())

    @property
    def nu_lacking(self) -> float:
        """See `lacking_viscosity`."""
        return lacking_viscosity(self.density, self.mu)

    @property
    def pressed(self) -> bool:
        """Whether a pressure gradient drives them, given or such that it holds a velocity."""
        return self.held is not None or bool(self.drop_force.any())

    @property
    def reference(self) -> float:
        """Density that pressures are divided by, kg/m3."""
        return self.density[0]

    def driven_by(self, body: np.ndarray, drop_force: np.ndarray) -> TwoFluids:
        """The same fluids under other forces; see `one_fluid.Fluids`."""
        other = copy.copy(self)
        other.body, other.drop_force, other.force = body, drop_force, body + drop_force
        return other

    def measured_on(self, grid: VolumeGrid | None) -> TwoFluids:
        """The same fluids, whose volumes are measured on a grid and kept by it; neither without one."""
        other = copy.copy(self)
        other.grid = grid
        return other

    def carried(self, ops: Operators, terms: Terms, moving: tuple[np.ndarray, np.ndarray | None],
                dr: np.ndarray | None, dt: float, speed: float) -> tuple[np.ndarray, np.ndarray | None]:
        """phi and volume (n,) after a step; see `Fluids.carried`."""
        (u, volume), moved = moving, speed * dt / self.spacing
        ways = moved
        if self.tension is not None:
            ways += dt * math.sqrt(self.tension.tension / (self.density.mean() * self.spacing**3))
        interface = terms.interface
        assert isinstance(interface, Interface)
        stretch = dt * strain(interface, ops, u)
        phi = carried(interface, ops, dr, min(RATE * ways, MOST), stretch, min(RATE * moved, MOST))
        if interface.cut is None or volume is None:
            return phi, None
        return kept_volumes(interface.cut, ops.neighbours, interface.phi, phi, volume, self.spacing, ops.exchange)

    def changing(self, p: np.ndarray, phi: np.ndarray, before: Terms) -> np.ndarray:
        """(n, 2): by how much the number of the fluid of each particle falls, and the Laplacian of eq. 3 of p that it
        had; see `Fluids.changing`."""
        assert before.interface is not None
        found = np.zeros((len(p), 2))
        found[:, 0] = before.interface.phase - phase_of(phi)
        rows = np.flatnonzero(found[:, 0])
        if reduce.number(rows):
            found[rows, 1] = _row_laplacians(before, before.ops.exchange.forward(p), rows)
        return found

    def relabelled(self, carried: np.ndarray, changing: np.ndarray | None, now: Terms) -> np.ndarray:
        """carried: (n,) m2/s2; see `Fluids.relabelled`.

        The pressure of the heavy fluid has errors that are a fraction of rho g dx; in the light fluid they accelerate a
        particle by that fraction of g times the density ratio. A particle that has come into the other fluid takes the
        pressure with which its row of eq. 3, in the weights of its new fluid, has the sum that it had before.
        """
        assert changing is not None and now.interface is not None
        change, sums = changing.T
        rows = np.flatnonzero(change)
        if not reduce.number(rows):
            return carried
        new = carried.copy()
        if self.tension is not None and self.tension.method == "jump":
            new[rows] += self.tension.tension / self.reference * now.interface.curvature[rows] * change[rows]
        return _balanced(rows, now, sums[rows], new)

    def terms(self, ops: Operators, neighbours: Neighbourhood, phi: np.ndarray | None = None) -> Terms:
        """Terms of one configuration. ops: Operators; neighbours: all of them, dummies included; phi: (n,) m."""
        assert phi is not None
        interface = find_interface(ops, neighbours, phi, self.spacing, self.contact, self.sight)
        if self.grid is not None:
            found = cut(self.grid.cells, neighbours.x, phi, interface.fit, ops.exchange, self.grid.sight,
                        None if ops.walls is None else ops.walls.distance)
            interface = replace(interface, cut=found._replace(sample=self.grid.sample))
        reference = self.density[0]
        densities_differ, viscosities_differ = self.density[1] != reference, self.mu[1] != self.mu[0]
        distance = ops.exchange.forward(phi)
        phase = phase_of(distance)
        rho, mu = self.density[phase] / reference, self.mu[phase] / reference
        weighted, transposed_stress, smooth, kinks = ops, None, None, None
        viscous = ViscousWeights(self.mu[0] / reference, ops.lap, ops.walls)
        if densities_differ or viscosities_differ:
            weighted, viscous = self._weigh(ops, interface.unlike, rho, mu, densities_differ)
        rho, mu = rho[: ops.n], mu[: ops.n]
        if viscosities_differ or self.added_viscosity > 0.0:
            near = interface.unlike.near
        if self.added_viscosity > 0.0:
            share = self.added_viscosity / reference / (viscous.factor * rho)
            weight = viscous.weight.copy()
            over_rows(_add_viscosity, ops.n, ops.start, ops.column, ops.lap, ops.exchange.forward(near), share, weight)
            viscous = replace(viscous, weight=weight)
        if viscosities_differ:
            smooth = ~near
            free = near if ops.walls is None else near & ~ops.walls.near_wall
            rows = np.flatnonzero(free)
            transposed_stress = TransposedStress.build(ops, viscous.weight, rows)
            kinks = Kinks.build(ops, phase, rows, interface.unlike, interface.normal)
        force, jump_acceleration, laplacian_of_jump, along = balanced_force(ops, self.body), None, None, None
        if self.drop_force.any():
            force = force + weighted.potential_gradient(self.drop_force)
        if self.held is not None:
            along = weighted.potential_gradient(self.held)
        if self.tension is not None:
            tension_force, laplacian_of_jump = self.tension.force(weighted, interface, reference)
            if laplacian_of_jump is None:
                force = force + tension_force
            else:
                jump_acceleration = tension_force
        rules = self.rules
        terms = Terms(weighted, viscous, force, jump_acceleration, laplacian_of_jump, rho if densities_differ else 1.0,
                      rules.rotational_viscosity / reference, transposed_stress, smooth, along, interface, kinks,
                      drop=self.drop_force if densities_differ and self.pressed else None)
        return with_forces(terms, self.forces, neighbours.x[: ops.n], mu / rho)

    @staticmethod
    def _weigh(ops: Operators, unlike: UnlikePairs, rho: np.ndarray, mu: np.ndarray,
               densities_differ: bool) -> tuple[Operators, ViscousWeights]:
        """The operators with the density in the weights of the pressure, and the weights of the viscous term."""
        walls, viscous_walls = ops.walls, None
        symmetric = ops.lap_far if walls is None else walls.symmetric_laplacian
        lap = np.empty(len(ops.lap))
        over_rows(_weigh_viscous, ops.n, (ops.start, ops.column), unlike, (rho, mu), ops.lap, lap)
        lap_far, grad_p = ops.lap_far, ops.grad_p
        if densities_differ:
            weights = lap_far, grad_p, symmetric
            lap_far, grad_p = np.empty_like(lap_far), np.empty_like(grad_p)
            symmetric = lap_far if walls is None else np.empty_like(symmetric)
            over_rows(_weigh_pressure, ops.n, (ops.start, ops.column), unlike, rho, weights,
                      (lap_far, grad_p, symmetric))
        if walls is not None:
            nu = mu[: ops.n] / rho[: ops.n]
            viscous_walls = WallSums(nu * walls.lap, nu[:, None] * walls.lap_velocity, walls.div, walls.div_velocity,
                                     None if walls.slip is None else nu[:, None, None] * walls.slip)
            walls = replace(walls, symmetric_laplacian=symmetric)
        return replace(ops, lap_far=lap_far, grad_p=grad_p, walls=walls), ViscousWeights(1.0, lap, viscous_walls)


def _row_laplacians(terms: Terms, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The Laplacian of eq. 3 of p (n + remote,) without its jumps at particles `rows` (m,), (m,)."""
    sums = np.zeros(len(rows))
    over_rows(_row_sums, len(rows), rows, _laplacian(terms), p, sums)
    return sums - _jumps(terms, rows)


def _laplacian(terms: Terms) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """start, column and weights of the Laplacian of eq. 3."""
    ops = terms.ops
    return ops.start, ops.column, ops.lap_p if ops.walls is None else ops.walls.symmetric_laplacian


def _jumps(terms: Terms, rows: np.ndarray) -> np.ndarray:
    return np.zeros(len(rows)) if terms.laplacian_of_jump is None else terms.laplacian_of_jump[rows]


@njit(cache=True, nogil=True)
def _weigh_viscous(rows, pairs, unlike, given, lap, new_lap):
    """new_lap (n_pairs,): lap times the viscosity between the two particles over rho_i."""
    (start, column), (first, pair, fraction), (rho, mu) = pairs, unlike, given
    for i in range(rows[0], rows[1]):
        for p in range(start[i], start[i + 1]):
            new_lap[p] = lap[p] * mu[i] / rho[i]  # eq. 2: div(mu grad u) / rho
        for q in range(first[i], first[i + 1]):
            p, t = pair[q], fraction[q]
            j = column[p]
            between = 1.0 / (t / mu[i] + (1.0 - t) / mu[j]) if mu[i] != mu[j] else mu[i]
            new_lap[p] = lap[p] * between / rho[i]


@njit(cache=True, nogil=True)
def _weigh_pressure(rows, pairs, unlike, rho, weights, new):
    """The weights of the pressure over the density between the two particles."""
    (start, column), (first, pair, fraction) = pairs, unlike
    lap_far, grad_p, symmetric = weights
    new_lap_far, new_grad_p, new_symmetric = new
    for i in range(rows[0], rows[1]):
        light = 1.0 / rho[i]
        for p in range(start[i], start[i + 1]):
            new_lap_far[p] = lap_far[p] * light  # eq. 3: div(grad q / rho)
            new_symmetric[p] = symmetric[p] * light
            for k in range(grad_p.shape[1]):
                new_grad_p[p, k] = grad_p[p, k] * light
        for q in range(first[i], first[i + 1]):
            p, t = pair[q], fraction[q]
            light = 1.0 / (t * rho[i] + (1.0 - t) * rho[column[p]])
            new_lap_far[p] = lap_far[p] * light
            new_symmetric[p] = symmetric[p] * light
            for k in range(grad_p.shape[1]):
                new_grad_p[p, k] = grad_p[p, k] * light


@njit(cache=True, nogil=True)
def _row_sums(turns, rows, pairs, p, sums):
    """sum_j lap_ij (p_j - p_i) of `rows` (m,); pairs: start, column, lap."""
    start, column, lap = pairs
    for m in range(turns[0], turns[1]):
        i = rows[m]
        for k in range(start[i], start[i + 1]):
            sums[m] += lap[k] * (p[column[k]] - p[i])


def _balanced(rows: np.ndarray, now: Terms, sums: np.ndarray, p: np.ndarray) -> np.ndarray:
    """p (n,) with values at particles `rows` (m,) for which  lap p - jumps = sums (m,): a row of particles can change
    at once, on several processes, and the result must not depend on their order."""
    pairs, right, most = _laplacian(now), -_jumps(now, rows) - sums, 0.0
    for _ in range(SWEEPS):
        everyone = now.ops.exchange.forward(p)
        change = reduce.largest(np.array([_sweep(rows, pairs, right, everyone)]))
        p, most = everyone[: len(p)], max(most, change)
        if not change > SETTLED * most:
            break
    return p


@njit(cache=True)
def _sweep(rows, pairs, right, p):
    """One sweep of Gauss and Seidel over `rows` (m,); returns the largest change."""
    start, column, lap = pairs
    largest = 0.0
    for m in range(len(rows)):
        i = rows[m]
        mean, total = right[m], 0.0
        for k in range(start[i], start[i + 1]):
            mean += lap[k] * p[column[k]]
            total += lap[k]
        if total > 0.0:
            largest = max(largest, abs(mean / total - p[i]))
            p[i] = mean / total
    return largest


@njit(cache=True, nogil=True)
def _add_viscosity(rows, start, column, lap, near, share, out):
    """Adds share (n,) of `lap` (n_pairs,) between the particles of `near` (n,) to out (n_pairs,)."""
    for i in range(rows[0], rows[1]):
        if near[i]:
            for p in range(start[i], start[i + 1]):
                if near[column[p]]:
                    out[p] += share[i] * lap[p]
