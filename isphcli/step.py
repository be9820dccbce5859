"""One step of the Lagrangian predictor-corrector (paper eqs 2-4, 8-10).

The particles are moved first, with the velocity extrapolated to the middle of the step, and shifted; every operator is
then evaluated once, on the new configuration, where the new velocity has to be divergence-free. Time derivatives
along the particle paths are backward differences of second order (BDF2 with variable steps; L-stable):

    (g0 u* - b0 u^n - b1 u^{n-1}) / dt = -grad p / rho + nu lap u* + F           (eq. 2)
    div (grad q) = (g0 rho / dt) div u*,   u = u* - dt grad q / (g0 rho)         (eq. 3; see `Stepper._poisson`)
    p <- p + q - nu rho div u*                                                    (eq. 4, rotational form)

Eq. 2 of the paper is a Crank-Nicolson step on the old configuration. It is first order in time, because the old
configuration is not where the new velocity lives, and it does not damp the modes that an impulsive start excites.
Pressures here are divided by the density (m2/s2).
"""

from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from . import linear
from .drive import leads_through
from .failure import STRONGER, RunError, StepError
from .halo import build_halo, wrap
from .neighbours import find_pairs
from .operators import build_operators, gradient_p, particle_volumes, total_divergence
from .shifting import carry, shift

JACOBI_LIMIT = 2.0  # nu dt / dx^2 up to which the Helmholtz matrix is solved with its diagonal alone
NEAR_WALL = 0.25  # of the spacing: no particle comes nearer to a wall than this; at 0.015 a cavity blew up
# The same for particles that see few others (coupling.NARROW). Where beads touch, half of the fluid lies within 0.25:
# kept off that far, particles crowd into the middle of the pores, and the flux of a pack is 40 % too large.
NEAR_WALLS = 0.1
# Of the shift, near an interface, which it blurs. A bubble that rises (1/24) lost 1.4 % of its height to a whole one; a
# drop without any comes apart.
SHY = 1.0 / 3.0
ROUND_OFF = 1e-14  # of what the right-hand side of the pressure is a difference of
ROUGHLY = 1e-3  # tolerance of what a unit gradient makes: a small part of it is added to the velocity (`Stepper._hold`)
STALE = 1.5  # a hierarchy is rebuilt when its iterations exceed those of its first use by this factor and by 4


@dataclass(frozen=True)
class State:
    """Fluid particles at one time. x, u, u_old: (n, dim); p: (n,) over density; dt_old: 0 before the first step;
    push, drift: pressure gradient over the density of the first fluid that held the velocity, m/s2, and the flux of the
    shifts that it makes up for (drive.HeldVelocity), m/s, or None."""

    x: np.ndarray
    u: np.ndarray
    u_old: np.ndarray
    p: np.ndarray
    time: float = 0.0
    step: int = 0
    dt_old: float = 0.0
    push: float | None = None
    drift: float | None = None


@dataclass(frozen=True)
class Configuration:
    """Everything that depends on the positions only.

    ops: Operators; x: (n_rows, dim) table of positions, row: (n_pairs,) rows of the neighbours in it; terms: Terms, the
    operators with the densities and viscosities of the fluids, and the forces.
    """

    ops: object
    x: np.ndarray
    row: np.ndarray
    pairs: object
    means: linear.ComponentMeans
    halo: int
    terms: object


@dataclass
class Stepper:
    """What a scene needs to be advanced; the preconditioners that it may keep are its only changing state.

    geometry: Geometry; dummies: (n_dummy, dim); spacing, support: m; kind: kernel number; site_volume: m^dim;
    fluids: OneFluid or TwoFluids; shifting: coefficient, 0 for none; second_order: BDF2 or implicit Euler;
    clock: output.Clock; rate: drive.HeldVelocity or None; volume: volume.KeptVolume or None.
    """

    geometry: object
    dummies: np.ndarray
    spacing: float
    support: float
    kind: int
    site_volume: float
    fluids: object
    shifting: float
    second_order: bool
    tolerance: float
    restart: int
    max_iterations: int
    clock: object
    rate: object = None
    volume: object = None
    reports: dict = field(default_factory=dict)
    rebuilt: bool = False
    held: int = 0

    def __post_init__(self):
        self._levels = {}
        self._first = {}
        self._origin = {}  # of each hierarchy: the state before the step in which it was built, and that step
        self._scene = None
        if self.geometry.has_solid:
            from .wall_scene import WallScene

            self._scene = WallScene(self.geometry, self.dummies, self.support, self.kind, self.site_volume,
                                    self.fluids.line)

    def origins(self):
        """Where the kept hierarchies came from: {name: (state, dt, iterations of the first use)}."""
        return {name: (*self._origin[name], self._first[name]) for name in self._levels}

    def take_up(self, origins):
        """Build the hierarchies of `origins` again, by the steps that built them: they have the same bits."""
        found = {}
        for state, dt in {(id(state), dt): (state, dt) for state, dt, _ in origins.values()}.values():
            self._levels = {}
            with suppress(linear.SolveError, StepError):  # what is missing then is built when it is needed
                self.advance(state, self.configure(state.x), dt)
            wanted = [name for name, (s, t, _) in origins.items() if s is state and t == dt]
            found |= {name: self._levels[name] for name in wanted if name in self._levels}
        self._levels = found
        self._origin = {name: (state, dt) for name, (state, dt, _) in origins.items()}
        self._first = {name: first for name, (_, _, first) in origins.items()}

    def forget(self):
        """Drop the hierarchies: the next step builds new ones."""
        self._levels.clear()

    def configure(self, x):
        """Neighbours and operators of fluid positions x (n, dim)."""
        n = len(x)
        geometry = self.geometry
        if self._scene is not None:
            with self.clock("operators"):
                ops, table, pairs, images = self._scene.configure(x)
                row, owner = ops.walls.row, images.owners(n + len(self.dummies))
        else:
            with self.clock("neighbours"):
                images = build_halo(x, geometry.lower, geometry.upper, np.array(geometry.periodic), self.support)
                table, owner = images.positions(x), images.owners(n)
                pairs = find_pairs(table, n, self.support)
                row = pairs.index
            with self.clock("operators"):
                volume = particle_volumes(table, pairs, self.kind, self.support)
                ops = build_operators(table, pairs, owner, volume, self.kind, self.support)
        with self.clock("terms"):
            terms = self.fluids.terms(ops, table, row, pairs, owner)
        with self.clock("assembly"):
            # a periodic box full of fluid is one component; pores can be many
            labels = np.zeros(n, np.int32)
            if self._scene is not None:
                joined = None if ops.walls.still is None else ops.walls.natural > 0.0
                labels = linear.components(ops.start, ops.column, joined)[1]
        return Configuration(ops, table, row, pairs, linear.ComponentMeans(labels), len(images.owner), terms)

    def move(self, state, config, dt):
        """Positions after dt, and the fields carried to where the particles were shifted."""
        ratio = dt / state.dt_old if state.dt_old else 0.0
        u, u_old, p = state.u, state.u_old, state.p
        # without walls nothing tells a wind from a motion of the box: shifting and the carried pressure must not either
        wind = 0.0 if self._scene is not None else u.mean(axis=0)
        speed = np.sqrt(((u - wind) ** 2).sum(axis=1).max())
        displacement = dt * (u + 0.5 * ratio * (u - u_old))
        dr = None
        with self.clock("terms"):
            if self.shifting > 0.0 and speed > 0.0:
                dr = shift(config.x, config.pairs, len(u), speed, dt, self.shifting, self.spacing)
                if config.terms.shy is not None:
                    dr[config.terms.shy] *= SHY
            if self._scene is not None:
                few, nearest = config.ops.walls.few, NEAR_WALL * self.spacing
                if few is not None:
                    nearest = np.where(few, NEAR_WALLS * self.spacing, nearest)
                dr = self._scene.keep_off(state.x, displacement, dr, nearest)
            if self.rate is not None:
                state = replace(state, drift=self.rate.drifted(state, dr, dt))
            if dr is not None:
                walls = config.ops.walls
                second = ~walls.near if walls is not None else np.ones(len(u), dtype=np.bool_)
                if config.terms.smooth is not None:
                    second = second & config.terms.smooth
                fields = carry(config.ops, np.concatenate([u, u_old], axis=1), dr, second)
                u, u_old = np.ascontiguousarray(fields[:, : u.shape[1]]), np.ascontiguousarray(fields[:, u.shape[1] :])
                displacement += dr
        terms = config.terms
        p = p + terms.density * (terms.slope(p) * (displacement - dt * wind)).sum(axis=1)
        x = wrap(state.x + displacement, self.geometry.lower, self.geometry.upper, self.geometry.periodic)
        if self._scene is not None:
            # a particle never enters a wall: one that would stays where it is
            stopped = self.geometry.phase(x) < 0
            x[stopped] = state.x[stopped]
            self.held = int(stopped.sum())
        return replace(state, x=x, u=u, u_old=u_old, p=p)

    def advance(self, state, config, dt):
        """One step of length dt: (new state, its configuration). Raises SolveError or StepError."""
        self.reports, self.rebuilt, self._now = {}, False, (state, dt)
        moved = self.move(state, config, dt)
        config = self.configure(moved.x)
        ratio = dt / state.dt_old if (state.dt_old and self.second_order) else 0.0
        g0 = (1.0 + 2.0 * ratio) / (1.0 + ratio)
        history = ((1.0 + ratio) * moved.u - ratio * ratio / (1.0 + ratio) * moved.u_old) / dt
        p, push, known = moved.p, state.push, history + config.terms.force
        system = self._div_grad(config)
        expansion = 0.0
        if self.volume is not None:  # a step that is tried again with half its length is not to push twice as hard
            expansion = self.volume.expansion(moved.x, max(dt, state.dt_old))
        first = not state.dt_old
        if push is not None and first and not leads_through(config.ops, config.x, config.row, self.rate.axis):
            self._nothing_flows()
        # the first step finds the pressure of the start: it is taken again with what it found
        for _ in range(self.fluids.first_passes if first else 1):
            driven = known if push is None else known + push * config.terms.along
            u, p = self._project(config, system, moved.u, driven, p, g0 / dt, expansion)
            if push is not None:
                u, p, more = self._hold(config, system, u, p, g0 / dt, moved.drift)
                push += more
        self.divergences = total_divergence(config.ops, u)
        self.divergence = float(np.abs(self.divergences).max()) * dt
        return State(moved.x, u, moved.u, p, state.time + dt, state.step + 1, dt, push, moved.drift), config

    def _project(self, config, system, guess, known, p, rate, expansion):
        """Eqs 2-4: (velocity, pressure). system: of `_div_grad`; known: (n, dim) m/s2, of the steps before and the
        forces; rate: g0 / dt; expansion: divergence that the velocity is to have, 0 or (n,) of `KeptVolume`."""
        ops, terms = config.ops, config.terms
        slope = terms.slope(p)
        right = known - slope
        if ops.walls is not None:
            right += terms.viscosity * terms.ops.walls.lap_velocity
        star = self._helmholtz(config, rate, right, guess)
        div = total_divergence(ops, star) - expansion
        q = self._poisson(config, system, div, p, slope, rate)
        u = star - gradient_p(terms.ops, q) / rate
        return u, self._settled(config, p + q - terms.bulk * div)

    @staticmethod
    def _settled(config, p):
        """A pressure p (n,) without its constants, in dead ends that of the fluid next to them."""
        p, walls = config.means.remove(p), config.ops.walls
        if walls is not None and walls.still is not None:
            from .coupling import fill

            fill(config.ops, p)
        return p

    def _hold(self, config, system, u, p, rate, drift):
        """(velocity, pressure, further pressure gradient) that have the superficial velocity of `self.rate`: what a
        gradient of one makes in this step is added so many times (drive.HeldVelocity). drift: m/s, of the shifts;
        other arguments as those of `_project`."""
        ops, terms, tolerance = config.ops, config.terms, self.tolerance
        if "pressure" in self._levels:  # a new hierarchy is judged by its first solve, which has to be a whole one
            self.tolerance = max(tolerance, ROUGHLY)
        try:
            star = self._helmholtz(config, rate, np.broadcast_to(terms.along, u.shape), np.zeros_like(u))
            div = total_divergence(ops, star)
            if ops.walls is not None:
                div -= ops.walls.div_velocity
            q = self._solve_poisson(config, system, config.means.remove(-rate * div), self.tolerance)
        finally:
            self.tolerance = tolerance
        v = star - gradient_p(terms.ops, q) / rate
        more = self.rate.missing(config.x[: len(u)], u, v, rate, drift)
        if more is None:
            self._nothing_flows()
        return u + more * v, self._settled(config, p + more * (q - terms.bulk * div)), more

    def _nothing_flows(self):
        raise RunError(f"no pressure drop moves the fluid along {'xyz'[self.rate.axis]}: no pore leads through the "
                       "scene, or its throats are closed at this spacing")

    def _helmholtz(self, config, shift_, right, guess):
        """(g0 / dt - nu lap) u* = right, one matrix for all components unless slip or a transposed stress couple
        them."""
        terms, walls = config.terms, config.terms.ops.walls
        with self.clock("assembly"):
            matrix = linear.assemble(terms.ops.start, terms.ops.column, terms.ops.lap, shift_, terms.viscosity,
                                     walls.lap if walls is not None else None)
            slip = walls.slip if walls is not None else None
        stiff = self.fluids.stiffest > JACOBI_LIMIT * shift_ * self.spacing**2
        if not stiff:
            guess = right / shift_  # what viscosity then changes little
        if slip is not None or terms.turn is not None:
            return self._coupled_helmholtz(config, matrix, slip, right, guess, stiff)
        inverse = 1.0 / matrix.diagonal()

        def solve(b, x0):
            if not stiff:
                found = linear.gmres(matrix.dot, b, inverse.__mul__, self.tolerance, self.restart,
                                     self.max_iterations, x0)
                if found[1].converged:
                    return found
            return self._multigrid("velocity", matrix, matrix.dot, b, x0)

        out = np.empty_like(right)
        for k in range(right.shape[1]):
            with self.clock("krylov"):
                out[:, k], report = solve(np.ascontiguousarray(right[:, k]), np.ascontiguousarray(guess[:, k]))
            self._record("velocity", report, lambda k=k: right[:, k] - matrix @ out[:, k])
        return out

    def _coupled_helmholtz(self, config, matrix, slip, right, guess, stiff):
        """All components at once; the preconditioner leaves their coupling out.

        Every row is divided by its diagonal: where viscosities differ by 1e4, the thin fluid would be lost in the
        residual of the thick one.
        """
        n, dim = right.shape
        turn, viscosity = config.terms.turn, config.terms.viscosity
        diagonal = matrix.diagonal()[:, None]

        def apply(v):
            u = v.reshape(n, dim)
            out = matrix @ u
            if slip is not None:
                out -= viscosity * np.einsum("nkm,nm->nk", slip, u)
            if turn is not None:
                turn.add(u, out, -1.0)
            return (out / diagonal).ravel()

        def by_component(once):
            def precondition(v):
                parts = v.reshape(n, dim) * diagonal
                return np.stack([once(np.ascontiguousarray(parts[:, k])) for k in range(dim)], axis=1).ravel()

            return precondition

        scaled = (right / diagonal).ravel()
        with self.clock("krylov"):
            if stiff:
                solution, report = self._multigrid("velocity", matrix, apply, scaled, guess.ravel(), by_component)
            else:
                for more in (1, STRONGER):
                    solution, report = linear.gmres(apply, scaled, np.copy, self.tolerance, more * self.restart,
                                                    more * self.max_iterations, start=guess.ravel())
                    if report.converged:
                        break
        self._record("velocity", report, lambda: np.abs(scaled - apply(solution)).reshape(n, dim).max(axis=1))
        return solution.reshape(n, dim)

    def _poisson(self, config, system, div, p, slope, rate):
        """The pressure increment q of A q = rate div u* - w (A - div grad) p, with the constant of each component
        projected out (eqs 25-26). system: of `_div_grad`; div: (n,) of u*; p: (n,) and its slope (n, dim); rate:
        g0 / dt.

        A is the Laplacian of eq. 6 without walls, which then stands for div grad. Beside walls the divergence sees the
        wall and the pressure gradient does not: there the two differ so much that a correction by the Laplacian
        overshoots and the pressure grows from step to step. Scenes with walls therefore take div grad itself, the
        odd-even mode added, preconditioned by the Laplacian.
        """
        with self.clock("krylov"):
            old = system[1](p, slope)
            right = config.means.remove(self._odd_even(config, slope, old, rate) - rate * div)
            # a small increment is the difference of large pressures: no solve is more exact than their round-off
            size, floor = np.linalg.norm(right), ROUND_OFF * np.linalg.norm(old)
            if size <= floor:
                right[:] = 0.0
            tolerance = max(self.tolerance, floor / size) if size > 0.0 else self.tolerance
        return self._solve_poisson(config, system, right, tolerance)

    def _solve_poisson(self, config, system, right, tolerance):
        """q of A q = -right, see `_poisson`."""
        means, weighted = config.means, config.terms.ops
        matrix, minus, scale = system

        def apply(q):
            return means.remove(minus(q, gradient_p(weighted, q)))

        def settle(once):
            return lambda v: means.remove(once(v if scale is None else means.remove(v / scale)))

        with self.clock("krylov"):
            q, report = self._multigrid("pressure", matrix, apply, right, None, settle, tolerance)
        self._record("pressure", report, lambda: right - apply(q))
        return means.remove(q)

    def _div_grad(self, config):
        """The Laplacian as a matrix, -A as a function of a pressure and its gradient, and by what its diagonal exceeds
        that of the Laplacian, or None."""
        ops, terms = config.ops, config.terms
        with self.clock("assembly"):
            matrix = linear.assemble(ops.start, ops.column, terms.ops.lap_p, 0.0, 1.0)
        if ops.walls is None:
            return matrix, (lambda p, slope: matrix @ p), None
        from .coupling import diagonal, divergence_and_jump

        natural = terms.ops.walls.natural
        with self.clock("assembly"):
            exact, own = diagonal(ops, config.x, natural, terms.ops.grad_p), matrix.diagonal()
            scale = np.where(exact > own, exact / np.where(own > 0.0, own, 1.0), 1.0)
        return matrix, (lambda p, slope: divergence_and_jump(ops, config.x, natural, p, slope)), scale

    def _odd_even(self, config, slope, old, rate):
        """w (A - div grad) p of `_poisson`, (n,). slope: (n, dim) of p; old: (n,) -A p.

        w is the part of inertia in what a particle sets against a force, rate / (rate + nu sum_j lap_ij), nu that of
        the thinner fluid. Without it, what A sees of p and the gradient does not, its odd-even part, is handed on from
        step to step, hardly damped: layers of density ratio 100 at rest grew by 5 % a step, whatever its length, and a
        drop of density ratio 1000 blew up. Where drag sets the speed there is nothing to damp, and w = 1 would keep the
        pressure from growing to what balances it. Tension between fluids that differ in name only is kinder, and more
        accurate with w = 0 (not terms.forgets).
        """
        ops, terms = config.ops, config.terms
        if not terms.forgets:
            return 0.0
        odd_even, drag = -total_divergence(ops, slope) - old, linear.row_sums(ops.start, ops.lap)
        if ops.walls is not None:
            odd_even += ops.walls.div_velocity
            drag += ops.walls.lap
        if terms.lift is not None:
            odd_even -= terms.lift
        return odd_even * (rate / (rate + self.fluids.thinnest * drag))

    def _multigrid(self, name, matrix, apply, right, guess, spread=None, tolerance=None):
        """GMRES with the hierarchy kept under `name`. A stale one is dropped; a failed solve is repeated with a new
        one, then with more of it (failure.py). spread: makes of a cycle the preconditioner of `apply`."""
        tries = [1, STRONGER] if name not in self._levels else [1, 1, STRONGER]
        for more in tries:
            fresh = name not in self._levels
            if fresh:
                with self.clock("preconditioner"):
                    self._levels[name] = linear.hierarchy(matrix)
                self._origin[name] = self._now
                self.rebuilt = True
            levels = self._levels[name]
            levels.levels[0].A = matrix
            once = _cycles(linear.cycle(levels), matrix, more)
            if spread is not None:
                once = spread(once)
            solution, report = linear.gmres(apply, right, once, tolerance or self.tolerance, more * self.restart,
                                            more * self.max_iterations, start=guess)
            if fresh:
                self._first[name] = report.iterations
            if report.converged and report.iterations <= max(STALE * self._first[name], self._first[name] + 4):
                break
            self._levels.pop(name)
            if report.converged:
                break
        return solution, report

    def _record(self, name, report, residual):
        if not report.converged:
            error = linear.SolveError(name, report)
            error.badness = residual()
            raise error
        before = self.reports.get(name)
        if before is None or before.iterations < report.iterations:
            self.reports[name] = report


def _cycles(once, matrix, count):
    """So many cycles of a hierarchy as a function of the right-hand side."""

    def apply(b):
        x = once(b)
        for _ in range(count - 1):
            x += once(b - matrix @ x)
        return x

    return apply
