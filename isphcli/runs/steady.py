"""Steady creeping flow and permeability: one coupled solve per axis, on one or several spacings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..case.force_list import forces_of
from ..case.forcing import why_closed
from ..domain import reduce
from ..domain.communicator import current
from ..domain.components import pair_components
from ..domain.exchange import NO_EXCHANGE
from ..domain.lattice import ParticleError
from ..flow.stokes import StokesFlow, StokesSystem
from ..geometry.connectivity import merge_periodic
from ..operators.cell_means import CellMeans, means_over_cells
from ..operators.kernel import KERNELS
from ..operators.lattice_weights import LatticeWeights, build_lattice_weights
from ..operators.wall_scene import WallScene
from ..output.environment import give_back_freed_memory
from ..scene import memory
from ..scene.place import jittered_at_rest, lattice_at, place_case
from ..solvers.engine import engine_of
from ..solvers.krylov import Limits, recorded
from .flow_measures import wall_shear, wall_stress
from .permeability import darcy, fluid_cells, mean_velocities, spread_of_flux

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.cut import Share
    from ..domain.halo import Halo
    from ..domain.lattice import Lattice, Particles
    from ..geometry.protocol import Geometry
    from ..output.clock import Clock
    from ..solvers.krylov import Convergence, Watch
    from .half_in_throats import InThroats


class NoFlowError(ParticleError):
    """A scene through which nothing can flow along the drive."""


class NoPathError(NoFlowError):
    """No fluid leads through the scene along any of the axes that were asked for."""


@dataclass
class StokesResult:
    """Flow along one axis at one spacing.

    axis: 0, 1, 2 or None where the walls drive the flow; thick: (dim,) m, `Lattice.thick`; velocity (n, dim) m/s of
    the particles; means: its means over the cells of the lattice; pressure (n,) Pa; superficial, mean, permeability:
    see `runs/permeability.py`; divergence, mass_error: see `_mass`; halo, narrow (particles in pores that the lattice
    does not resolve), components, isolated_pockets, cells: of the scene that it was solved in; drop: Pa, over the box
    along the axis; stress: see `flow_measures.wall_stress`; diffusivity: effective over that of the fluid, where it was
    asked for; throats: the permeability with half the spacing in throats, where that was asked for; residuals:
    relative, of the iterations of the solve.
    """

    axis: int | None
    particles: Particles
    geometry: Geometry
    spacing: float
    thick: np.ndarray
    velocity: np.ndarray
    means: CellMeans
    pressure: np.ndarray
    superficial: np.ndarray
    mean: np.ndarray
    permeability: np.ndarray | None
    divergence: float
    mass_error: float
    convergence: Convergence
    halo: int
    narrow: int
    components: int
    isolated_pockets: int
    cells: float
    drop: float
    stress: tuple[np.ndarray, np.ndarray] | None
    diffusivity: float | None = None
    throats: InThroats | None = None
    residuals: list[tuple[int, float]] = field(default_factory=list)

    @property
    def cell_velocity(self) -> np.ndarray:
        """(n, dim) m/s, of equal volumes of fluid: means over the cells of the particles. Where walls cut cells, of
        which they are less the more of a cell is solid, velocities of the particles."""
        return self.velocity if self.means.cut else self.means.fluid

    @property
    def all_cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Places (m, dim), m, and mean velocities (m, dim), m/s, of cells, those of the fluid particles first."""
        return self.means.everywhere(self.particles.x[: self.particles.n_fluid])

    @property
    def shear(self) -> dict[str, float] | None:
        """`flow_measures.wall_shear`."""
        return wall_shear(None if self.stress is None else self.stress[1])


@dataclass
class SteadyScene:
    """One geometry at one spacing with its matrices; every axis that it serves shares them.

    geometry: of this process; whole: that of all, of which other bricks than its own can be had (`Geometry.within`);
    cells: volume of the fluid in the sample over that of a cell, see `permeability.fluid_cells`; lattice: of the
    particles; on_lattice: whether they are on it.
    """

    geometry: Geometry
    particles: Particles
    system: StokesSystem
    halo: int
    percolates: np.ndarray
    cells: float
    lattice: Lattice
    whole: Geometry
    on_lattice: bool


def build_scene(case: Case, geometry: Geometry, spacing: float, clock: Clock, needs: Sequence[int] = ()) -> SteadyScene:
    """Particles, operators and matrices of a geometry at a spacing.

    needs: axes of which the fluid has to percolate along one; NoPathError where it percolates along none.
    """
    if not geometry.has_solid:
        raise NoFlowError("no wall holds the flow: steady creeping flow needs solids or walls; "
                          "add them, or take flow: navier_stokes")
    support = case.support * spacing
    kind = KERNELS[case.particles.kernel]
    whole = geometry
    with clock("geometry"):
        memory.refuse_lattice(case, geometry, spacing)
        particles = place_case(case, geometry, spacing)
        if particles.share is not None:
            geometry = geometry.within(particles.share.lower, particles.share.upper, support)
            if case.particles.jitter > 0.0:
                particles = jittered_at_rest(case, geometry, particles, spacing)
        give_back_freed_memory()
    n = particles.n_fluid
    share = memory.neighbours_held(case, geometry, particles.x[:n], spacing)
    need = memory.estimate(case, geometry.dim, True, n, particles.n_dummy, share=share)
    own = sum(need.values())
    most = float(reduce.largest(np.array([own]))) * current().here / own
    memory.refuse_flow(case, {part: most * size for part, size in need.items()}, f"{n:,} fluid particles")
    with clock("operators"):
        dummies = particles.x[n:]
        seen = dummies if particles.share is None else np.concatenate([dummies, particles.share.dummies])
        walls = WallScene(geometry, seen, support, kind, particles.site_volume)
        ops, row, images, distance = _operators(walls, particles, case.particles.jitter == 0.0)
        give_back_freed_memory()
    with clock("assembly"):
        percolates = _percolation(ops, row, _shifts(n, len(seen), images, particles.share))
        del row
    if needs and not percolates[:, list(needs)].any():
        raise NoPathError(why_closed(case, *needs))
    with clock("preconditioner"):
        nu = next(iter(case.fluids.values())).nu
        system = StokesSystem(ops, spacing, nu, forces=forces_of(case, geometry), x=particles.x[:n],
                              engine=engine_of(case.solver.engine))
        give_back_freed_memory()
    lattice = lattice_at(case, geometry, spacing)
    with clock("geometry"):
        cells = fluid_cells(geometry, particles, distance, thick=lattice.thick)
    return SteadyScene(geometry, particles, system, len(images.owner), percolates, cells, lattice, whole,
                       case.particles.jitter == 0.0)


def _operators(walls: WallScene, particles: Particles,
               fixed: bool) -> tuple[LatticeWeights, np.ndarray, Halo, np.ndarray]:
    """(LatticeWeights, row of each pair in the table of positions, Halo, wall distance of the particles, m): pairs and
    crossings are gone when it returns.

    The gradient in the consistent divergence is of order 2: on the sphere array of solid fraction 0.216 with 16
    spacings a cell the permeability is 0.05 % high, with order 1 1.2 % low.
    """
    n, share = particles.n_fluid, particles.share
    stencils, images = walls.stencils(particles.x[:n], fixed, share)
    exchange, remote = (NO_EXCHANGE, 0) if share is None else (share.exchange, len(share.ghosts))
    # remote particles stand between the two in the table, dummies of others and images behind them
    fluid, dummies = stencils.walls.distance[:n], stencils.walls.distance[n + remote :][: particles.n_dummy]
    distance = np.concatenate([fluid, dummies])
    return *build_lattice_weights(stencils, 2, exchange), images, distance


def _shifts(n: int, dummies: int, images: Halo, share: Share | None) -> np.ndarray:
    """(n_rows, dim) int8 of the table of positions: whether a row lies above (1) or below (-1) the place of its
    particle in the box."""
    ghosts = np.zeros((0, images.shift.shape[1]), np.int8) if share is None else share.shift
    own = np.concatenate([np.zeros((n, ghosts.shape[1]), np.int8), ghosts,
                          np.zeros((dummies, ghosts.shape[1]), np.int8)])
    moved = own[images.owner] + np.sign(images.shift).astype(np.int8)
    return np.concatenate([own, np.sign(moved)]).astype(np.int8)


def _percolation(ops: LatticeWeights, row: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(components, dim) bool: the component winds round the box along the axis. row: of each pair in the table of
    positions; shift: see `_shifts`."""
    inside = np.logical_not(np.any(shift, axis=1))[row]
    count, raw = pair_components(ops.start, ops.column, inside, ops.exchange)
    raw = ops.exchange.forward(raw)
    edges = [np.empty((0, 3), np.int64)]
    crossing = np.flatnonzero(~inside)
    first, by = np.searchsorted(ops.start, crossing, side="right") - 1, shift[row[crossing]]
    for axis in range(ops.dim):
        up = (by[:, axis] > 0) & (np.abs(by).sum(axis=1) == 1)
        pairs = np.unique(np.stack([raw[first[up]], raw[ops.column[crossing[up]]]], axis=1), axis=0)
        edges.append(np.column_stack([pairs, np.full(len(pairs), axis)]))
    every = np.unique(np.concatenate(current().collect(np.concatenate(edges).astype(np.int64))), axis=0)
    _, _, winding = merge_periodic(count, every, ops.dim)
    return winding


def solve_axis(case: Case, scene: SteadyScene, axis: int | None, force: np.ndarray, clock: Clock,
               watch: Watch | None = None) -> StokesResult:
    """The flow of a scene under an acceleration; see `StokesResult`."""
    geometry, particles, system = scene.geometry, scene.particles, scene.system
    fluid = next(iter(case.fluids.values()))
    with clock("krylov"):
        asked = case.solver
        residuals: list[tuple[int, float]] = []
        flow = system.solve(force, Limits(asked.tolerance, asked.restart, asked.max_iterations),
                            recorded(residuals, watch))
    laplacian = system.laplacian(flow, force)
    with clock("geometry"):
        means = _cell_means(scene, flow.velocity, laplacian, case.support * system.spacing)
        x, velocity = means.everywhere(particles.x[: particles.n_fluid])
    superficial, mean = mean_velocities(geometry, x, velocity, particles.site_volume, scene.lattice.thick, scene.cells)
    if axis is not None and system.acceleration is not None:
        raise ValueError("the flux is not that of the drive where another force accelerates the fluid: its check of a "
                         "case has to refuse drive.axes with flow: stokes")
    permeability = None if axis is None else darcy(geometry, superficial, axis, force, fluid.nu)
    drop = 0.0 if axis is None else fluid.density * float(force[axis]) * float((geometry.upper - geometry.lower)[axis])
    return StokesResult(axis, particles, geometry, system.spacing, scene.lattice.thick, flow.velocity, means,
                 flow.pressure * fluid.density, superficial, mean, permeability,
                 *_mass(scene, flow, (x, velocity), axis), flow.convergence, scene.halo,
                 int(reduce.total(system.ops.narrow)), system.count, int((~scene.percolates.any(axis=1)).sum()),
                 scene.cells, drop, wall_stress(geometry, particles.x[: particles.n_fluid], flow.velocity, laplacian,
                                                (system.spacing, fluid.mu)), residuals=residuals)


def solve_diffusion(case: Case, scene: SteadyScene, axis: int, clock: Clock, watch: Watch | None = None) -> float:
    """Effective diffusivity along an axis over that of the fluid; see `flow.diffusion`. Raises SolveError."""
    from ..flow.diffusion import DiffusionSystem
    from .flow_measures import effective_diffusivity

    x, system = scene.particles.x[: scene.particles.n_fluid], scene.system
    with clock("preconditioner"):
        diffusion = DiffusionSystem(system.ops, scene.geometry, x, system.spacing, system.means, system.engine)
    with clock("krylov"):
        asked = case.solver
        flux = diffusion.solve(axis, Limits(asked.tolerance, asked.restart, asked.max_iterations), watch)
    return effective_diffusivity(scene.geometry, x, flux, scene.cells, scene.lattice, axis)


def _cell_means(scene: SteadyScene, velocity: np.ndarray, laplacian: np.ndarray, support: float) -> CellMeans:
    """Means over cells of a velocity (n, dim), m/s, with its Laplacian by the momentum balance, 1/(m s); the velocity
    itself where particles are off their lattice."""
    if not scene.on_lattice:
        return CellMeans.whole(velocity)
    particles = scene.particles
    return means_over_cells(scene.geometry, particles.x, scene.lattice, support, (velocity, laplacian), particles.share)


def _mass(scene: SteadyScene, flow: StokesFlow, cells: tuple[np.ndarray, np.ndarray],
          axis: int | None) -> tuple[float, float]:
    """(largest |div u| over the largest speed per spacing, spread of the flux between layers of the lattice across the
    axis).

    The flux is that of which the permeability is the mean. cells: places (m, dim) m and mean velocities (m, dim) m/s.
    """
    dx = scene.system.spacing
    div = scene.system.ops.total_divergence(flow.velocity)
    speed = reduce.largest(np.abs(flow.velocity))
    worst = float(reduce.largest(np.abs(div)) * dx / speed) if speed > 0.0 else 0.0
    if axis is None:
        return worst, 0.0
    return worst, spread_of_flux(scene.lattice, cells[0], cells[1][:, axis], axis)
