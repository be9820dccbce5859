"""Permeability of a flow by Darcy's law (eq. 28), and its limit over several spacings."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..geometry.extents import POINTS, fluid_part_of_sample, part_of_sample
from ..geometry.protocol import Geometry, sample_box
from ..references.ducts import duct_permeability

if TYPE_CHECKING:
    from ..domain.lattice import Lattice, Particles


def fluid_cells(geometry: Geometry, particles: Particles, distance: np.ndarray | None = None,
                thick: np.ndarray | None = None) -> float:
    """Volume of the fluid in the sample over that of a cell of the lattice, by the wall distance.

    distance: (n,) m, of all particles; None: asked of the geometry. thick: (dim,) m, `Lattice.thick`; None: the volume
    in the whole box.

    A cell of edge h whose middle lies at the distance d of a wall holds fluid in the share 1/2 + d/h of it, between 0
    and 1: exact beside walls along the lattice, and over the many ways in which an oblique plane cuts cells the mean is
    right too. Walls that are curved and edges between walls leave an error that goes as h^2: of grains three spacings
    across a tenth of their volume. So cells at walls are taken whole and in halves along each axis, and the sum is the
    limit of both, halves + (halves - whole) / 3. Faces of voxels are along the lattice.
    """
    x = particles.x
    if not geometry.has_solid:
        held = particles.x[: particles.n_fluid]
        return float(reduce.number(held) if thick is None else reduce.total(part_of_sample(geometry, held, thick)))
    # a face of the box that is a wall cuts cells whose middles lie beyond it
    part = np.ones(len(x)) if thick is None else fluid_part_of_sample(geometry, x, thick, POINTS)
    inside = part > 0.0
    edge = particles.site_volume ** (1.0 / geometry.dim)
    near = geometry.distance(x[inside]) if distance is None else distance[inside]
    share = np.clip(0.5 + near / edge, 0.0, 1.0)
    if not (geometry.level_walls and geometry.voxel_size is not None):
        middles = edge * np.array(list(itertools.product((-0.25, 0.25), repeat=geometry.dim)))
        cut = np.abs(near) < 0.25 * edge * (1.0 + math.sqrt(geometry.dim))
        at = x[inside][cut]
        halves = np.zeros(len(at))
        for middle in middles:
            depth = geometry.distance(at + middle, 0.25 * edge)  # deeper ones hold no fluid
            halves += np.clip(0.5 + depth / (0.5 * edge), 0.0, 1.0) / len(middles)
        share[cut] = halves + (halves - share[cut]) / 3.0
    return float(reduce.total(share * part[inside]))


def microporous_shares(geometry: Geometry, x: np.ndarray, rocks: int, thick: np.ndarray) -> np.ndarray:
    """Shares (rocks,) of the fluid of the sample that seep through each microporous rock; x: (n, dim) m, of the fluid
    particles, which count alike: those of cells that walls cut, too. thick: (dim,) m, `Lattice.thick`."""
    part = part_of_sample(geometry, x, thick)
    inside = part > 0.0
    held = reduce.total_by(geometry.microporous(x[inside]) + np.int64(1), part[inside], rocks + 1)
    return np.asarray(held[1:] / (float(held.sum()) or 1.0))


def mean_velocities(geometry: Geometry, x: np.ndarray, velocity: np.ndarray, site_volume: float,
                    thick: np.ndarray, cells: float | None = None,
                    known: tuple[int, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Superficial and mean velocity (dim,) of the sample, m/s.

    x, velocity: (n, dim) of the fluid particles, or of the cells; site_volume: m^dim; thick: (dim,) m, their extents,
    `Lattice.thick`. cells: `fluid_cells` of the sample, which the mean velocity is taken over: the flux over the volume
    of the fluid. Without it: over the particles. known: an axis and the superficial velocity along it, m/s, where that
    is held.
    """
    lower, upper = sample_box(geometry)
    part = part_of_sample(geometry, x, thick)
    counts = part > 0.0  # of whole layers the sum has the same bits
    total, number = reduce.totals(velocity[counts] * part[counts, None], part)
    if known is not None:
        total[known[0]] = known[1] * np.prod(upper - lower) / site_volume
    return total * (site_volume / np.prod(upper - lower)), total / (cells or number or 1.0)


def spread_of_flux(lattice: Lattice, x: np.ndarray, flux: np.ndarray, axis: int) -> float:
    """Standard deviation over the mean of the flux through the layers of cells across an axis, 0 of exact flows.

    Layers are those of the lattice, wherever its offset puts them: other sections would hold unequal numbers of sites.
    x: (n, dim) m, of cells, whose layer is that of their middle; flux: (n,) of their velocity along the axis times
    their volume, in any unit.
    """
    layers = int(lattice.counts[axis])
    layer = np.floor((x[:, axis] - lattice.corner[axis]) / lattice.cell[axis]).astype(int) % layers
    through = reduce.total_by(layer, flux, layers)
    mean = through.mean()
    return float(through.std() / abs(mean)) if mean != 0.0 else 0.0


def darcy(geometry: Geometry, superficial: np.ndarray, axis: int, force: np.ndarray, viscosity: float) -> np.ndarray:
    """Permeability (dim,) of the sample, m2 (eq. 28): entry `axis` along the drive, the others across it.

    superficial: (dim,) m/s; axis: of the drive; force: (dim,) m/s2; viscosity: kinematic, m2/s. The force acts on the
    whole length of the box; from it the part that drives the clear layers, as a duct, is subtracted:
    k = nu U L_sample / (g L_box - nu U L_clear / k_duct).
    """
    lower, upper = sample_box(geometry)
    size = np.linalg.norm(force)
    along = float(superficial @ force) / size
    length, sample = (geometry.upper - geometry.lower)[axis], (upper - lower)[axis]
    gravity = size * length / sample
    if sample < length:
        clear = viscosity * along / clear_permeability(geometry, axis)
        gravity = max(gravity - clear * (length - sample) / sample, size)  # no sample resists less than a clear one
    permeability = viscosity / gravity * superficial * np.sign(force[axis])
    permeability[axis] = viscosity / gravity * along  # eq. 28
    return permeability


# Bar beside smooth walls: the root of the sum of the squares of the error by the differences between spacings, for
# errors of the order ORDER; of FLUX times the spread of the flux between layers; and of USUAL times the error that nine
# in ten bodies with pores as wide keep within. ORDER is the power of that error in calibration.csv, rounded to halves
# (2.0). Two spacings may agree by chance; the flux of the finest one, which is the same through all sections of an
# exact flow, then tells of an error still. Where all sections are alike, as in ducts, it says nothing, and the last
# part is what stands. FLUX and USUAL are the smallest, in steps of a tenth, by which nine in ten of the known bodies
# and of every family of `benchmarks/bars_elsewhere.py` (seeds 5 and 7) keep within the bars of three spacings, of h
# and h/2 and of h/1.5 and h/2 (docs/design_notes.md, error bars)
ORDER, FLUX, USUAL = 2.0, 1.5, 0.1
# Order of k beside the edges of cubes: twice the exponent of the velocity there, because the error of k is that of the
# dissipation. Across an edge of 90 degrees of solid it is 0.5445 (Dean and Montagnon 1949), along it 2/3 (Laplace)
EDGE = (1.089, 4 / 3)
# Bar beside edges over the difference between the limits by the two orders. 97, 95 and 100 % of the bodies of cubes lie
# within it (two, two finer, three spacings; `benchmarks/calibration.py bars`), with a factor of 1 100, 95, 100 %
EDGE_BAR = 0.75
# Part of the usual error in a bar beside edges, for what is not of edges and may cancel their errors: of the bodies of
# cubes 97, 95 and 100 % hold with it
EDGE_USUAL = 5 / 16
# Part of the dissipation in the cells that `refine: throats` cuts, at least (`half_in_throats.cells_that_lose`)
SHARE = 0.9


def clear_permeability(geometry: Geometry, axis: int) -> float:
    """Permeability along an axis of the empty box of a geometry, m2: that of its clear layers."""
    others = [a for a in range(geometry.dim) if a != axis]
    slip = [None if geometry.periodic[a] else (float(geometry.slip_length[1 + 2 * a]),
                                               float(geometry.slip_length[2 + 2 * a])) for a in others]
    return duct_permeability([float((geometry.upper - geometry.lower)[a]) for a in others], slip)


def extrapolate(spacings: Sequence[float] | np.ndarray, values: Sequence[float] | np.ndarray,
                known: tuple[float, float] | None = None, given: tuple[float, float] | None = None,
                usual: float = 0.0, flux: float = 0.0) -> tuple[float, float, float | None, str]:
    """The value at the limit of fine spacings from values (m,) at spacings (m,), m > 1: (value, error bar, order or
    None, sentence).

    given: (order, safety) of the error, where it is known: the bar is safety times the error by the differences and
    that order; without it the order is ORDER; usual: `expected_error.usual_error`, and flux: the spread of the flux
    between layers (`StokesResult.mass_error`), both relative and at the finest spacing, parts of the bar unless an
    order is given; flux is none of a bar beside edges. known: lowest and highest order of the error, where most of it
    is of a known origin (`EDGE`): the value is then the limit by Richardson. Without it the value is that of the finest
    spacing and the bar an estimate of its error, which the bodies of `validation.known_bodies` and some nine in ten
    scenes of `benchmarks/bars_elsewhere.py` keep within. Beside smooth walls the error changes with the way in which
    the walls lie on each lattice, up and down: an extrapolation would amplify that, and an order that is observed means
    little.
    """
    order = np.argsort(spacings)
    h, k = np.asarray(spacings, float)[order], np.asarray(values, float)[order]
    if known is not None:
        return _with_known_order(h, k, known, usual)
    power, safety = (ORDER, 1.0) if given is None else given
    told = float(np.mean(np.abs(k[1:] - k[0]) / ((h[1:] / h[0]) ** power - 1.0)))
    bar = math.hypot(told, FLUX * flux * k[0], USUAL * usual * k[0]) if given is None else safety * told
    return float(k[0]), bar, None, (f"the value at the finest of {len(h)} spacings; the bar takes errors of order "
                                    f"{power:g} from their differences"
                                    + (", what the flux differs by between sections" if flux else "")
                                    + (", and a part of what is usual in pores and grains as wide" if usual else ""))


def _with_known_order(h: np.ndarray, k: np.ndarray,
                      known: tuple[float, float], usual: float) -> tuple[float, float, float | None, str]:
    """`extrapolate` between two known orders, finest first. The limit is that of the higher one; the bar reaches to
    a part of the way (`EDGE_BAR`) to that of the lower one, or to the limit of the two coarser spacings where there are
    three. What is not of edges has no order, and may cancel their errors: it has the same part of the bar as elsewhere.
    """
    low, high = known

    def limit(first: int, p: float) -> float:
        fine, coarse = h[first] ** p, h[first + 1] ** p
        return float(k[first] + (k[first] - k[first + 1]) * fine / (coarse - fine))

    value = limit(0, high)
    others = [limit(0, low), *([limit(1, high)] if len(h) > 2 else [])]
    bar = math.hypot(EDGE_BAR * max(abs(other - value) for other in others), EDGE_USUAL * usual * k[0])
    return value, bar, high, (f"extrapolated with the known order {high:.2f} of edges over {len(h)} spacings, the bar "
                              f"reaches {EDGE_BAR:g} of the way to that of order {low:.2f}"
                              + (", and has a part of what is usual in pores and grains as wide" if usual else ""))
