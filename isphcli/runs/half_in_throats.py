"""The permeability with particles of half the spacing where a flow loses its energy: `refine: throats`.

The flow of the case's own spacing says where that is. Throats of rock hold most of it: half the spacing in the cells
that lose most, `SHARE` of the whole, and in those round them, is nearly what half the spacing everywhere is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..domain.communicator import current
from ..domain.lattice import Lattice, ParticleError
from ..domain.migration import Migration
from ..domain.mixed_lattice import MixedLattice, cells_of
from ..flow.mixed_stokes import MixedStokes
from ..geometry.extents import part_of_sample
from ..geometry.protocol import sample_box
from ..operators.cell_means import CellMeans, means_over_cells
from ..operators.kernel import KERNELS
from ..operators.lattice_weights import LatticeWeights, symmetric_laplacian
from ..operators.mixed_weights import MixedParticles, build_mixed_operators
from ..scene import memory
from ..scene.place import cells_in_sight, lattice_at, place, place_share
from ..solvers.engine import engine_of
from ..solvers.krylov import Limits, recorded
from .expected_error import usual_error
from .permeability import (
    EDGE,
    EDGE_BAR,
    EDGE_USUAL,
    FLUX,
    ORDER,
    SHARE,
    USUAL,
    darcy,
    extrapolate,
    spread_of_flux,
)

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry
    from ..output.clock import Clock
    from ..solvers.krylov import Convergence, Watch

# Of k, what is added where spacings meet: 0.04 to 0.08 % in pores of 15 particles and more, whose bars by the spacings
# are 0.01 to 0.04 % (`benchmarks/two_spacings.py bars`)
MEETING = 5e-4
BUFFER = 1  # cells round those that are chosen
# Of the dissipation in the last cell that is chosen: symmetric flows lose as much in cells that are images of each
# other, and what a solve leaves, with the number of processes too, is some 1e-5 of it
TIED = 1e-4
# Share of the fluid in cells that are cut, above which half the spacing everywhere costs no more: a third of its
# particles took 60 % of its time, twice as much each (docs/resolution.md), and 6 kB of each are not 2 (scene/memory.py)
MOST_CUT = 0.6


@dataclass(frozen=True)
class InThroats:
    """permeability: along the axis, m2; superficial: velocity of the sample (dim,), m/s; mass_error: spread of the flux
    between layers of the larger spacing; particles: fluid particles of both spacings, of all processes; everywhere:
    about how many there would be with half the spacing everywhere; cut: share of the fluid in cells that are cut;
    convergence: of the solve; residuals: relative, of its iterations."""

    permeability: float
    superficial: np.ndarray
    mass_error: float
    particles: int
    everywhere: int
    cut: float
    convergence: Convergence
    residuals: list[tuple[int, float]]


def dissipation(ops: LatticeWeights, u: np.ndarray) -> np.ndarray:
    """Squares of the velocity differences of each particle, weighted as in the Laplacian, walls at rest included:
    (n,), m2/s2 over m2."""
    lost = np.maximum(-(ops.walls.laplacian(u) * u).sum(axis=1), 0.0)
    for along in u.T:
        along = np.ascontiguousarray(along)
        lost += 0.5 * symmetric_laplacian(ops, along * along) - along * symmetric_laplacian(ops, along)
    return lost


def cells_that_lose(lattice: Lattice, x: np.ndarray, lost: np.ndarray, share: float = SHARE) -> np.ndarray:
    """The fewest cells of all processes that hold a share of the dissipation, and all others that lose more than the
    mean: of these the cells (m, dim) that this process finds by the dissipation lost (n,) of its particles at x
    (n, dim).

    One throat may hold the whole share in so few cells that its mouths, where the flow is as badly resolved, are none
    of them.
    """
    least = (1.0 - TIED) * min(reduce.least_of_largest(lost, share), float(reduce.mean(lost)))
    return np.unique(cells_of(lattice, x[lost >= max(least, np.finfo(float).tiny)]), axis=0)


def place_two(geometry: Geometry, mixed: MixedLattice, spacing: float, support: float) -> MixedParticles:
    """The particles of a lattice some of whose cells are cut, those of this process and what they see. spacing,
    support: m, of the others. All processes call it together. Raises ParticleError where there is no fluid."""
    if current().size == 1:
        mixed = mixed.within(np.zeros_like(mixed.counts), mixed.counts)
        placed = place(geometry, mixed, support)
        rows, share = placed.x, None
    else:
        placed = place_share(geometry, mixed, support)
        assert placed.share is not None
        n, first = placed.n_fluid, placed.share
        between = Migration(first, geometry.lower, geometry.upper, geometry.periodic, support)
        # the adjoint divergence asks for pairs from the other side, by numbers
        share = between.around(placed.x[:n], first.exchange.numbers(n)[:n])
        rows = np.concatenate([placed.x[:n], share.ghosts, placed.dummies_in_sight])
        mixed = mixed.within(*cells_in_sight(geometry, mixed, np.array([share.lower, share.upper]), support))
    return MixedParticles(rows, placed.n_fluid, mixed.half(rows), mixed.beside(rows), spacing, mixed.site_volume, share)


def limit_of_throats(coarse: float, fine: float, spacing: float, pores: tuple[float, float], wall: str,
                     flux: float) -> tuple[float, float, str]:
    """(permeability, bar, sentence) of k at a spacing, m, and with half of it in throats, m2: as of half of it
    everywhere (`extrapolate`), and squares of two more: what lies outside the throats may be off by as much of its
    part, and where spacings meet something is added (`MEETING`). pores: porosity and chord of the grains, m, see
    `grain_chord`; wall: smooth or stairs; flux: `InThroats.mass_error`."""
    edges, half = EDGE if wall == "stairs" else None, 0.5 * spacing
    porosity, grain = pores
    usual = usual_error(fine, porosity, half, grain) if fine > 0.0 else 0.0
    limit, bar, _, _ = extrapolate((spacing, half), (coarse, fine), edges, usual=usual, flux=flux)
    outside = (1.0 - SHARE) / SHARE * (coarse - fine)
    if edges is None:
        sentence = ("the value is that of this second solve, and its bar is made of the difference of both values, by "
                    f"errors of order {ORDER:g}, of {FLUX:g} of what its flux differs by between sections")
    else:
        sentence = (f"the value is the limit of both solves, by the known order {edges[1]:.2f} of edges, and its bar "
                    f"is made of {EDGE_BAR:g} of the way to the limit by order {edges[0]:.2f}")
    part = USUAL if edges is None else EDGE_USUAL
    sentence += f", of {part:.2g} of the error that is usual in pores and grains as wide"
    return limit, math.hypot(bar, outside, MEETING * fine), (
        f"{sentence}, and of what the larger spacing elsewhere may change")


def _superficial(geometry: Geometry, particles: MixedParticles, means: CellMeans, axis: int,
                 lattice: Lattice) -> tuple[np.ndarray, float]:
    """(velocity (dim,) of the sample, m/s, spread of the flux along an axis between layers of the lattice of the larger
    spacing) from means over the cells."""
    lower, upper = sample_box(geometry)
    x, u = means.everywhere(particles.x[: particles.n_fluid])
    volume = particles.volumes[np.concatenate([np.arange(particles.n_fluid), particles.own[means.rows]])]
    flux = u * volume[:, None]
    thick = lattice.cell * (volume / lattice.site_volume)[:, None] ** (1.0 / geometry.dim)
    part = part_of_sample(geometry, x, thick)
    counts = part > 0.0
    velocity = reduce.total(flux[counts] * part[counts, None]) / float(np.prod(upper - lower))
    return np.asarray(velocity), spread_of_flux(lattice, x, flux[:, axis], axis)


def _refuse(need: float, what: str, case: Case) -> None:
    """Raises ParticleError on all processes where one has not `need` bytes left on its machine: the run goes on without
    the second solve, and then all have to."""
    told = ""
    try:
        memory.refuse(need, what, memory.too_large(case))
    except ParticleError as error:
        told = str(error)
    reasons = list(filter(None, current().collect(told)))
    if reasons:
        raise ParticleError(reasons[0])


def in_throats(case: Case, geometry: Geometry, flow: tuple[LatticeWeights, np.ndarray, np.ndarray],
               drive: tuple[int, np.ndarray], clock: Clock, share: float = SHARE,
               watch: Watch | None = None) -> InThroats:
    """The permeability along an axis. geometry: whole, not that of this process alone; flow: operators, positions
    (n, dim), m, and velocities (n, dim), m/s, of the spacing of the case; drive: the axis and the force (dim,), m/s2.
    Raises SolveError, and ParticleError where the memory does not hold it."""
    (ops, x, velocity), (axis, force), spacing = flow, drive, case.particles.spacing
    lattice, nu = lattice_at(case, geometry, spacing), next(iter(case.fluids.values())).nu
    support = case.support * spacing
    with clock("geometry"):
        chosen = cells_that_lose(lattice, x, dissipation(ops, velocity), share)
        particles = place_two(geometry, MixedLattice(lattice, chosen, support, BUFFER), spacing, support)
        if particles.share is not None:
            geometry = geometry.within(particles.share.lower, particles.share.upper, support)
    d, asked = particles.spacings, case.solver
    number, half = reduce.number(d), reduce.count(d < spacing)
    most = float(reduce.largest(np.array([len(d) + particles.exchange.remote])))
    _refuse(most * current().here * memory.BYTES_TWO_SPACINGS, f"{number:,} particles of two spacings", case)
    with clock("operators"):
        mixed, faces = build_mixed_operators(geometry, particles, KERNELS[case.particles.kernel], support)
    with clock("preconditioner"):
        system = MixedStokes(mixed, faces, d, spacing, engine_of(asked.engine))
    with clock("krylov"):
        residuals: list[tuple[int, float]] = []
        limits = Limits(asked.tolerance, asked.restart, asked.max_iterations)
        u, laplacian, convergence = system.solve(force / nu, limits, recorded(residuals, watch))
    with clock("geometry"):
        own = particles.own
        means = means_over_cells(geometry, particles.x[own], lattice, support, (u, laplacian), particles.share,
                                 np.where(particles.half, 0.5, 1.0))
    superficial, mass_error = _superficial(geometry, particles, means, axis, lattice)
    everywhere = half + (number - half) * 2**geometry.dim
    return InThroats(float(darcy(geometry, superficial, axis, force, nu)[axis]), superficial, mass_error, number,
                     everywhere, half / everywhere, convergence, residuals)
