"""One step of the Lagrangian predictor-corrector (paper eqs 2-4, 8-10).

The particles are moved first, with the velocity extrapolated to the middle of the step, and shifted; every operator is
then evaluated once, on the new configuration, where the new velocity has to be divergence-free. Time derivatives
along the particle paths are backward differences of second order (BDF2 with variable steps; L-stable):

    (g0 u* - b0 u^n - b1 u^{n-1}) / dt = -grad p / rho + nu lap u* + F           (eq. 2, `viscous_solve`)
    div (grad q) = (g0 rho / dt) div u*,   u = u* - dt grad q / (g0 rho)         (eq. 3, `projection`)
    p <- p + q - nu rho div u*                                                    (eq. 4, rotational form)

Eq. 2 of the paper is a Crank-Nicolson step on the old configuration. It is first order in time, because the old
configuration is not where the new velocity lives, and it does not damp the modes that an impulsive start excites.
Pressures here are divided by the density of the first fluid (m2/s2).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from ..domain import reduce
from ..domain.components import pair_components
from ..domain.exchange import NO_EXCHANGE
from ..domain.halo import build_halo, wrap
from ..domain.neighbours import neighbourhood
from ..domain.null_space import ComponentMeans
from ..domain.row_threads import over_slices
from ..operators.moments import particle_volumes
from ..operators.pair_weights import build_operators
from ..solvers.kept_hierarchies import KeptHierarchies
from ..solvers.krylov import SolveError
from .held_velocity import HeldVelocity, leads_through
from .projection import (
    PressureSystem,
    driving_pressure,
    laplacian_of_potential,
    pressure_increment,
    pressure_system,
    solve_pressure,
    without_constants,
)
from .shifting import carry, shift
from .state import Configuration, Handover, State, StepResult
from .step_limits import Bounds, RunError, StepError
from .viscous_solve import viscous_solve

if TYPE_CHECKING:
    from ..domain.cut import Share
    from ..domain.migration import Migration
    from ..geometry.protocol import Geometry
    from ..operators.wall_scene import WallScene
    from ..output.clock import Clock
    from .one_fluid import Fluids, Terms
    from .seam import Seam
    from .timed_drive import TimedDrive
    from .volume_control import KeptVolume

NEAR_WALL = 0.25  # of the spacing: no particle comes nearer to a wall than this; with 0.015 a cavity blows up
# The same for particles in narrow pores (`neighbourhood_class`) of scenes with dead ends. Where beads touch, half of
# the fluid lies within 0.25: kept off that far, particles crowd into the middle of the pores, and the flux of a pack is
# 40 % too large.
NEAR_WALL_NARROW = 0.1
# Tolerance of what a unit pressure gradient makes: a small part of it is added to the velocity (`Stepper._hold`)
UNIT_RESPONSE_TOLERANCE = 1e-3


@dataclass
class Stepper:
    """What a scene needs to be advanced.

    geometry: where fluid and walls are; dummies: (n_dummy, dim) m; spacing, support: m; kind: kernel number;
    site_volume: m^dim; fluids: what they put into the equations; shifting: coefficient of eq. 8, 0 for none;
    second_order: BDF2 or implicit Euler; solvers: with the hierarchies that are kept, the only changing state;
    bounds: what no step may exceed; held_velocity: the superficial velocity that is held, or None; volume: what keeps
    the number of particles in blocks, or None; timed_drive: forces and walls that change with time, or None; seam:
    where fluid that leaves one reservoir comes in at the other, or None; migration: between the bricks of processes,
    None of one.
    """

    geometry: Geometry
    dummies: np.ndarray
    spacing: float
    support: float
    kind: int
    site_volume: float
    fluids: Fluids
    shifting: float
    second_order: bool
    solvers: KeptHierarchies
    bounds: Bounds
    held_velocity: HeldVelocity | None = None
    volume: KeptVolume | None = None
    timed_drive: TimedDrive | None = None
    seam: Seam | None = None
    migration: Migration | None = None

    def __post_init__(self) -> None:
        self.walls: WallScene | None = None
        if self.geometry.has_solid:
            from ..operators.wall_scene import WallScene

            self.walls = WallScene(self.geometry, self.dummies, self.support, self.kind, self.site_volume,
                                   self.fluids.line)

    @property
    def reach(self) -> float:
        """How far any particle sees, m."""
        return max(self.support, self.fluids.reach)

    @property
    def clock(self) -> Clock:
        """Where the time of a step is counted."""
        return self.solvers.clock

    def rebuild_hierarchies(self, origins: dict[str, tuple[State, float, int]]) -> None:
        """Build the hierarchies of a restart file again, by the steps that built them: they have the same bits."""

        def take(state: State, dt: float) -> None:
            with suppress(SolveError, StepError):
                self.advance(state, self.ready(state), dt)

        self.solvers.rebuild(origins, take)

    def fluids_at(self, time: float) -> Fluids:
        """The fluids under the forces of a time, s."""
        return self.fluids if self.timed_drive is None else self.fluids.driven_by(*self.timed_drive.forces_at(time))

    def configure(self, x: np.ndarray, time: float = 0.0, phi: np.ndarray | None = None,
                  number: np.ndarray | None = None) -> Configuration:
        """Neighbours and operators of fluid positions x (n, dim); time: s, of forces and walls that change; phi,
        number: (n,) of `State`."""
        n = len(x)
        geometry = self.geometry
        share: Share | None = None
        if self.migration is not None:
            assert number is not None
            with self.clock("neighbours"):
                share = self.migration.around(x, number)
        if self.walls is not None:
            velocity = None if self.timed_drive is None else self.timed_drive.walls_at(time)
            walls = self.walls if velocity is None else self.walls.moving_at(velocity)
            if walls.line is not None and phi is not None:
                walls = walls.with_interface(phi)
            with self.clock("operators"):
                ops, neighbours, images = walls.configure(x, share, self.reach)
        else:
            with self.clock("neighbours"):
                exchange, seen, brick = (NO_EXCHANGE, x, None) if share is None else (
                    share.exchange, np.concatenate([x, share.ghosts]), (share.lower, share.upper))
                images = build_halo(seen, geometry.lower, geometry.upper, np.array(geometry.periodic), self.reach,
                                    brick)
                neighbours = neighbourhood(images.positions(seen), images.owners(len(seen)), n, self.kind,
                                           self.support)
            with self.clock("operators"):
                ops = build_operators(neighbours, exchange.forward(particle_volumes(neighbours)), exchange=exchange)
        with self.clock("terms"):
            terms = self.fluids_at(time).terms(ops, neighbours, phi)
        with self.clock("assembly"):
            # a periodic box full of fluid is one component; pores can be many
            count, labels = 1, np.zeros(n, np.int32)
            if ops.walls is not None:
                joined = ops.walls.symmetric_laplacian > 0.0 if ops.walls.dead_ends else None
                count, labels = pair_components(ops.start, ops.column, joined, ops.exchange)
        return Configuration(ops, neighbours, ComponentMeans(labels, count), len(images.owner), terms)

    def ready(self, state: State) -> Handover:
        """The configuration of a state, for the step that starts from it."""
        return Handover(self.configure(state.x, state.time, state.phi, state.number))

    def move(self, state: State, config: Configuration, dt: float) -> tuple[State, int]:
        """The state with its particles where they are after dt and its fields carried to where they were shifted, and
        the number of particles that would have entered a wall and stay."""
        ratio = dt / state.dt_old if state.dt_old else 0.0
        u, u_old, p = state.u, state.u_old, state.p
        # without walls a uniform velocity is a motion of the frame, on which neither shifts nor the pressure may depend
        frame = 0.0 if self.walls is not None else reduce.mean(u)
        displacement, squares = np.empty_like(u), np.empty(len(u))

        def set_out(rows: slice) -> None:
            v = u[rows] - frame
            displacement[rows] = dt * (u[rows] + 0.5 * ratio * (u[rows] - u_old[rows]))  # eq. 4: old and new velocity
            squares[rows] = _products(v, v)

        over_slices(set_out, len(u))
        speed = np.sqrt(reduce.largest(squares))
        flows = 0.0 if self.seam is None else self.seam.flows(state.x, displacement[:, self.seam.axis])
        dr = self._shift(state, config, dt, speed, displacement)
        if dr is not None:
            with self.clock("terms"):
                second = config.terms.smooth if config.terms.smooth is not None else np.ones(len(u), dtype=np.bool_)
                velocities = np.concatenate([u, u_old], axis=1)
                fields = carry(config.ops, velocities, dr, second, config.terms.kinks)  # eq. 9
                u, u_old = np.ascontiguousarray(fields[:, : u.shape[1]]), np.ascontiguousarray(fields[:, u.shape[1] :])
                displacement += dr  # eq. 8
        with self.clock("terms"):
            phi, volume = self.fluids.carried(config.ops, config.terms, (state.u, state.volume), dr, dt, speed)
        terms, stopped = config.terms, 0
        # eqs 4 and 10: the pressure is carried over the whole displacement, with the flow and by the shift
        p, x = self._carried(state, p, terms, displacement, dt * frame)
        if self.walls is not None:
            # a particle never enters a wall: one that would stays where it is
            inside = self.geometry.phase(x) < 0
            x[inside], displacement[inside] = state.x[inside], 0.0
            stopped = reduce.count(inside)
        phi = state.phi if phi is None else phi  # of fluids that differ in name only
        if self.seam is not None:
            assert phi is not None  # reservoirs have two fluids
            carried = phi
            phi = self.seam.entered(x, carried)
            if volume is not None:
                volume = self.seam.let_in(x, flows, (phi > 0.0) != (carried > 0.0), volume)
        return replace(state, x=x, u=u, u_old=u_old, p=p, phi=phi, volume=volume), stopped

    def _carried(self, state: State, p: np.ndarray, terms: Terms, displacement: np.ndarray,
                 frame: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """(pressures (n,), positions (n, dim)) where a displacement (n, dim), m, of the fluid leads to from p (n,) and
        the positions of a state. frame: the part of it by which the pressure moves along, m."""
        gradient, density = terms.pressure_gradient(p), np.broadcast_to(terms.density, p.shape)
        found, x = np.empty_like(p), np.empty_like(displacement)

        def carry_on(rows: slice) -> None:
            moved = displacement[rows]
            found[rows] = p[rows] + density[rows] * _products(gradient[rows], moved - frame)
            x[rows] = wrap(state.x[rows] + moved, self.geometry.lower, self.geometry.upper, self.geometry.periodic)

        over_slices(carry_on, len(p))
        return found, x

    def _shift(self, state: State, config: Configuration, dt: float, speed: float,
               displacement: np.ndarray) -> np.ndarray | None:
        """Shifts (n, dim) of eq. 8, m, with what keeps particles off the walls; None where there are none.
        speed: largest one, m/s; displacement: (n, dim) with the flow, m."""
        dr = None
        with self.clock("terms"):
            if self.shifting > 0.0 and speed > 0.0:
                dr = shift(config.neighbours, speed, dt, self.shifting, self.spacing)  # eq. 8
            if self.walls is not None:
                assert config.ops.walls is not None
                nearest: float | np.ndarray = NEAR_WALL * self.spacing
                if config.ops.walls.dead_ends:
                    nearest = np.where(config.ops.walls.narrow, NEAR_WALL_NARROW * self.spacing, nearest)
                dr = self.walls.clamp_wall_distance(state.x, displacement, dr, nearest)
        return dr

    def settled(self, moved: State, beside: np.ndarray | None = None) -> tuple[State, np.ndarray | None]:
        """The particles that have come into the brick of this process, with those that stayed there, and what else
        (n, ...) goes with them."""
        if self.migration is None:
            return moved, beside
        assert moved.number is not None
        more = [values for values in (moved.phi, moved.volume, beside) if values is not None]
        x, u, u_old, p, *found, number = self.migration.settled(moved.x, moved.u, moved.u_old, moved.p, *more,
                                                                moved.number)
        phi = None if moved.phi is None else found.pop(0)
        volume = None if moved.volume is None else found.pop(0)
        moved = replace(moved, x=x, u=u, u_old=u_old, p=p, phi=phi, volume=volume, number=number)
        return moved, found[0] if found else None

    def advance(self, state: State, ready: Handover, dt: float) -> StepResult:
        """One step of length dt, which takes over the configuration of the state. Raises SolveError, StepError or
        RunError."""
        config = ready.take()
        self.solvers.begin(state, dt)
        moved, stopped = self.move(state, config, dt)
        changing = None if moved.phi is None else self.fluids.changing(state.p, moved.phi, config.terms)
        self._with_what_drives(changing, config, state.pressure_gradient, -1.0)
        del config  # before the next is made
        moved, changing = self.settled(moved, changing)
        config = self.configure(moved.x, state.time + dt, moved.phi, moved.number)
        ratio = dt / state.dt_old if (state.dt_old and self.second_order) else 0.0
        g0 = (1.0 + 2.0 * ratio) / (1.0 + ratio)
        self._with_what_drives(changing, config, state.pressure_gradient, 1.0)
        p = self.fluids.relabelled(moved.p, changing, config.terms)
        system = pressure_system(config, self.solvers)
        expansion: float | np.ndarray = 0.0
        volume_drift: float | None = None
        if self.volume is not None:  # a step that is tried again with half its length is not to expand twice as hard
            expansion, volume_drift = self.volume.expansion(moved.x, max(dt, state.dt_old))
        first = not state.dt_old
        if first and self.held_velocity is not None:
            moved = self._set_in_motion(config, system, moved)
        slope = self._slope(config, state.pressure_gradient)
        if first and slope is not None and slope.any():
            p = p + self._balance(config, system, slope)
        # eq. 2 in time: backward differences along the paths
        history = ((1.0 + ratio) * moved.u - ratio * ratio / (1.0 + ratio) * moved.u_old) / dt
        held, known = state.pressure_gradient, history + config.terms.force
        # the first step has no pressure to go on from: it is repeated with the one that it found
        for _ in range(self.fluids.first_passes if first else 1):
            # eq. 1: what drives the fluid, then pressure and viscosity
            driven = known
            if held is not None:
                assert config.terms.along is not None
                driven = known + held * config.terms.along
            u, p = self._project(config, self._driven(config, system, held), moved.u, driven, p, g0 / dt, expansion)
            if held is not None and self.held_velocity is not None:
                u, p, increment = self._hold(config, system, u, p, g0 / dt)
                held += increment
        new = State(moved.x, u, moved.u, p, state.time + dt, state.step + 1, dt, held, moved.phi,
                    moved.drive_step, moved.number, moved.volume)
        return StepResult(new, config, dt, config.terms.divergence(u), stopped, self.solvers.solves,
                          self.solvers.rebuilt, volume_drift)

    def _with_what_drives(self, changing: np.ndarray | None, config: Configuration, held: float | None,
                        sign: float) -> None:
        """Adds the Laplacian of the potential that drives, times sign, to those of the pressure in `changing`
        (`Fluids.changing`): a particle that comes into the other fluid keeps that of the whole pressure, p less that
        potential, in which its density weighs both."""
        slope = self._slope(config, held)
        if changing is not None and slope is not None:
            changing[:, 1] += sign * laplacian_of_potential(config.terms, slope)

    def _project(self, config: Configuration, system: PressureSystem, guess: np.ndarray, known: np.ndarray,
                 p: np.ndarray, rate: float, expansion: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Eqs 2-4: (velocity, pressure). known: (n, dim) m/s2, of the steps before and the forces; rate: g0 / dt;
        expansion: divergence that the velocity is to have, 0 or (n,) of `KeptVolume`."""
        terms = config.terms
        gradient = terms.pressure_gradient(p)
        driven = known - gradient
        u_star = viscous_solve(terms, self.fluids.nu_max, self.spacing, rate, driven, guess, self.solvers)  # eq. 2
        rate += terms.least_drag
        div = terms.divergence(u_star) - expansion
        q, beside = pressure_increment(config, system, div, (p, gradient), rate, self.fluids.nu_min, self.solvers)
        u = u_star - terms.ops.gradient_p(q) / rate  # eq. 3
        return u, without_constants(config, p + q + beside - terms.rotational_viscosity * div)  # eq. 4

    def _set_in_motion(self, config: Configuration, system: PressureSystem, moved: State) -> State:
        """The first state with the superficial velocity that is held, which an impulse makes.
        Taken within a step of dt that impulse would be a pressure drop of rho U / dt times the length, with the
        opposite drop in the next step, whose backward difference sees the jump. One solve does not remove all of the
        divergence, so that `first_passes` of them are taken: in rock, where a throat is a few particles wide, the first
        step would otherwise answer the rest with a pressure drop many times too large. The impulse gives all fluid
        one velocity. That of a gradient would give a gas a thousand times the velocity of a liquid, and what the
        passes leave of its divergence is more than what flows through a throat."""
        held, terms = self.held_velocity, config.terms
        assert held is not None and terms.along is not None
        if not leads_through(config.ops, held.axis, (self.geometry.lower, self.geometry.upper)):
            self._nothing_flows()
        v = np.zeros_like(moved.u)
        v[:, held.axis] = 1.0
        with self._response_tolerance():
            for _ in range(self.fluids.first_passes):
                v = self._without_divergence(config, system, v, 1.0)[0]
        impulse = held.gradient_for_flux(config.x, moved.u, v, 1.0)
        if impulse is None:
            self._nothing_flows()
        return replace(moved, u=moved.u + impulse * v, u_old=moved.u_old + impulse * v)

    def _slope(self, config: Configuration, held: float | None) -> np.ndarray | None:
        """What the pressure gradient that drives accelerates the first fluid by, (dim,) m/s2, where densities differ;
        else None. held: of `State.pressure_gradient`, m/s2."""
        given, direction = config.terms.drop, self.fluids.held
        return given if given is None or held is None or direction is None else given + held * direction

    def _driven(self, config: Configuration, system: PressureSystem, held: float | None) -> PressureSystem:
        """The system of the step with the DrivingPressure that goes with its pressure."""
        slope = self._slope(config, held)
        return system if slope is None else replace(system, driving=driving_pressure(config, system, slope))

    @contextmanager
    def _response_tolerance(self) -> Iterator[None]:
        """Solves to UNIT_RESPONSE_TOLERANCE, but for the first one of the pressure: a new hierarchy is judged by it."""
        solvers, tolerance = self.solvers, self.solvers.tolerance
        if "pressure" in solvers:
            solvers.tolerance = max(tolerance, UNIT_RESPONSE_TOLERANCE)
        try:
            yield
        finally:
            solvers.tolerance = tolerance

    def _without_divergence(self, config: Configuration, system: PressureSystem, field: np.ndarray,
                            rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(field (n, dim) without its divergence, the q of eq. 3 that takes it out, the divergence) beside walls at
        rest. rate: g0 / dt of eq. 3."""
        ops, solvers = config.ops, self.solvers
        div = config.terms.divergence(field)
        if ops.walls is not None:
            div -= ops.walls.div_velocity
        q = solve_pressure(config, system, config.means.remove(-rate * div), solvers.tolerance, solvers)
        return field - config.terms.ops.gradient_p(q) / rate, q, div

    def _hold(self, config: Configuration, system: PressureSystem, u: np.ndarray, p: np.ndarray,
              rate: float) -> tuple[np.ndarray, np.ndarray, float]:
        """(velocity, pressure, increment of the pressure gradient) that have the superficial velocity that is held:
        the response to a unit gradient in this step, times the increment, is added (`HeldVelocity`).

        Arguments as those of `_project`.
        """
        held, terms = self.held_velocity, config.terms
        assert held is not None and terms.along is not None
        with self._response_tolerance():
            along, balance = self._unit_drive(config, system)
            u_star = viscous_solve(terms, self.fluids.nu_max, self.spacing, rate, along, np.zeros_like(u), self.solvers,
                                   False)
            rate += terms.least_drag
            v, q, div = self._without_divergence(config, system, u_star, rate)
        increment = held.gradient_for_flux(config.x, u, v, rate)
        if increment is None:
            raise RunError("the pressure drop that holds drive.superficial_velocity cannot be found: what a step makes "
                           "of a drop is no flow along it; take a smaller particles.spacing if throats are one or two "
                           "particles wide, or drive.pressure_drop where one fluid is far lighter")
        response = balance + q - terms.rotational_viscosity * div
        return u + increment * v, without_constants(config, p + increment * response), increment

    def _unit_drive(self, config: Configuration, system: PressureSystem) -> tuple[np.ndarray, np.ndarray | float]:
        """(acceleration (n, dim) by a unit pressure gradient, the pressure (n,) that is in it).

        Where densities differ that gradient alone would accelerate a gas a thousand times as much as a liquid: a
        velocity that jumps as much from particle to particle at the interface, of whose divergence one projection
        leaves more than what flows through a throat. The pressure that balances it comes from A of the potential
        itself, with which layers of any density that move with one velocity are exact.
        """
        terms, held = config.terms, self.fluids.held
        assert terms.along is not None and held is not None
        along = np.ascontiguousarray(np.broadcast_to(terms.along, (config.ops.n, config.ops.dim)))
        if terms.drop is None:
            return along, 0.0
        balance = self._balance(config, system, held)
        return along - terms.ops.gradient_p(balance), balance

    def _balance(self, config: Configuration, system: PressureSystem, slope: np.ndarray) -> np.ndarray:
        """The pressure (n,) that is in the flow that a slope (dim,), m/s2, of `_slope` makes at once."""
        right = config.means.remove(driving_pressure(config, system, slope).image)
        return solve_pressure(config, system, right, self.solvers.tolerance, self.solvers)

    def _nothing_flows(self) -> NoReturn:
        assert self.held_velocity is not None
        axis = "xyz"[self.held_velocity.axis]
        raise RunError(f"no pressure drop moves the fluid along {axis}: no pore leads through the scene, or its "
                       "throats are closed at this spacing")


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (n,) of the rows of two arrays (n, dim)."""
    return np.einsum("nk,nk->n", a, b)
