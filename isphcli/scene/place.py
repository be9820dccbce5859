"""The particles of a case: fluid particles on a lattice, and dummies within a support of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..domain.communicator import current
from ..domain.cut import Cut, Share
from ..domain.exchange import NeighbourExchange
from ..domain.halo import wrap
from ..domain.lattice import Lattice, ParticleError, Particles, make_lattice
from ..geometry.protocol import Geometry, inside_sample, sample_box
from .memory import density

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.mixed_lattice import MixedLattice


def lattice_at(case: Case, geometry: Geometry, spacing: float) -> Lattice:
    """The Lattice of a case at a spacing. Raises ParticleError where the spacing does not fit the box."""
    return make_lattice(case.lattice_in(geometry.dim), geometry.lower, geometry.upper, geometry.periodic, spacing,
                        case.support * spacing, case.particles.offset)


def sight_of(case: Case, spacing: float, dim: int) -> float:
    """How far particles of a case at a spacing see, m: its support, or the reach of the fit of an interface with
    tension where that is longer."""
    support = case.support * spacing
    return support if case.interface is None else max(support, sight_of_fit(case, spacing, dim))


def sight_of_fit(case: Case, spacing: float, dim: int) -> float:
    """Sight.reach of a case at a spacing, m: the fit needs a number of neighbours, and a body-centred lattice has twice
    as many per spacing cubed."""
    from ..two_phase.sight import SIGHT

    return float(SIGHT * spacing / density(case, dim) ** (1.0 / dim))


def place_case(case: Case, geometry: Geometry, spacing: float) -> Particles:
    """The particles of a case at a spacing, which may be another than its own. Of several processes their own, still
    without jitter and of the fluids of the geometry (`jittered`, `with_fluids`). Raises ParticleError."""
    asked = case.particles
    if current().size > 1:
        support = case.support * spacing
        reach = sight_of(case, spacing, geometry.dim)
        return place_share(geometry, lattice_at(case, geometry, spacing), support, reach)
    particles = place(geometry, lattice_at(case, geometry, spacing), case.support * spacing, asked.jitter, spacing,
                      asked.seed)
    return with_fluids(case, geometry, particles)


def with_fluids(case: Case, geometry: Geometry, particles: Particles) -> Particles:
    """The particles, of the fluids that a flood and reservoirs of the case give them. Raises ParticleError."""
    flood = case.initial.flood if case.initial is not None else None
    if flood is not None:
        particles = flooded(particles, geometry, case.fluid_names.index(flood.fluid), flood.face, flood.saturation)
    if case.reservoirs is not None:
        fluids = tuple(case.fluid_names.index(name) for name in (case.reservoirs.inlet, case.reservoirs.outlet))
        particles = filled(particles, geometry, "xyz".index(case.reservoirs.axis), fluids)
    return particles


def filled(particles: Particles, geometry: Geometry, axis: int, fluids: Sequence[int]) -> Particles:
    """The particles, those below the sample along an axis of fluid fluids[0], those above it of fluid fluids[1]."""
    along = particles.x[: particles.n_fluid, axis]
    lower, upper = (corner[axis] for corner in sample_box(geometry))
    phase = particles.phase.copy()
    phase[along < lower], phase[along > upper] = fluids
    return replace(particles, phase=phase)


def flooded(particles: Particles, geometry: Geometry, fluid: int, face: str, saturation: float) -> Particles:
    """The particles, those nearest to a face of fluid `fluid`, up to a share `saturation` of those in the sample.

    Raises ParticleError where the sample holds no fluid.
    """
    axis, side = "xyz".index(face[0]), 1.0 if face.endswith("min") else -1.0
    x = particles.x[: particles.n_fluid]
    lower, upper = sample_box(geometry)
    depth = side * x[:, axis]
    inside = depth[inside_sample(geometry, x)]
    number = reduce.number(inside)
    if not number:
        raise ParticleError("no fluid particle in the sample: there is nothing to flood; "
                            f"check {what_is_solid(geometry)}, or take a smaller particles.spacing")
    wanted = max(round(saturation * number), 1)
    last, = reduce.quantiles(inside, [(wanted - 1) / max(number - 1, 1)])
    phase = particles.phase.copy()
    phase[depth <= last + 1e-9 * abs(upper[axis] - lower[axis])] = fluid
    return replace(particles, phase=phase)


def what_is_solid(geometry: Geometry) -> str:
    """The key of a case that decides what is solid in its scene."""
    return "geometry.voxels.labels" if geometry.labels is not None else "geometry.shapes and geometry.fluid"


def place(geometry: Geometry, lattice: Lattice | MixedLattice, support: float, jitter: float = 0.0,
          spacing: float = 0.0, seed: int = 0) -> Particles:
    """Fluid particles and dummies of a lattice.

    jitter: random displacement of the fluid particles, as a fraction of `spacing`; one that would end in a solid
    stays. Raises ParticleError where there is no fluid.
    """
    fluid, phases, dummies, inside, left_out = [], [], [], 0, 0
    for sites in lattice.slabs():
        # an offset lattice sticks out of the box along periodic axes
        x = wrap(sites, geometry.lower, geometry.upper, geometry.periodic)
        phase = geometry.phase(x)
        is_fluid = phase >= 0
        fluid.append(x[is_fluid])
        phases.append(phase[is_fluid])
        if geometry.has_solid:
            solid = x[~is_fluid]
            reach = support * (1.0 + 1e-9)
            seen = -geometry.distance(solid, reach) < reach
            dummies.append(solid[seen])
            left_out += int((~seen).sum())
        inside += int(np.logical_and.reduce([(at >= low) & (at <= high) for at, low, high in
                                             zip(x.T, geometry.lower, geometry.upper)]).sum())
    x, phase = np.concatenate(fluid), np.concatenate(phases)
    if len(x) == 0:
        raise _all_solid(geometry)
    if jitter > 0.0:
        x = _moved(geometry, x, phase, np.random.default_rng(seed).uniform(-jitter, jitter, x.shape) * spacing)
    rows = np.concatenate([x, *dummies]) if dummies else x
    return Particles(rows, phase, lattice.site_volume, inside, left_out)


def _moved(geometry: Geometry, x: np.ndarray, phase: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Positions x (n, dim) moved by shift (n, dim), m, of those that stay in their fluid."""
    moved = wrap(x + shift, geometry.lower, geometry.upper, geometry.periodic)
    stays = geometry.phase(moved) != phase
    return np.where(stays[:, None], x, moved)


def jittered(case: Case, geometry: Geometry, particles: Particles, number: np.ndarray, spacing: float) -> Particles:
    """The particles of one of several processes, with the random displacements of a run of one process, which draws for
    the first particle, the second and so on. number: (n,) int64; geometry: of this process; spacing: m. Particles that
    leave the brick stay with the process."""
    n, dim, asked = particles.n_fluid, geometry.dim, case.particles
    shift = np.empty((n, dim))
    edges = np.append(np.flatnonzero(np.diff(number, prepend=-2) != 1), n)
    for first, end in itertools.pairwise(edges):  # of particles whose numbers follow each other
        bits = np.random.PCG64(asked.seed).advance(int(number[first]) * dim)
        shift[first:end] = np.random.Generator(bits).uniform(-asked.jitter, asked.jitter, (end - first, dim))
    x = _moved(geometry, particles.x[:n], particles.phase, shift * spacing)
    return replace(particles, x=np.concatenate([x, particles.x[n:]]))


def jittered_at_rest(case: Case, geometry: Geometry, particles: Particles, spacing: float) -> Particles:
    """As `jittered`, each particle on the process of the brick that it is in then, with the `Share` of that process.
    spacing: m."""
    from ..domain.migration import Migration, numbers_of

    share, n = particles.share, particles.n_fluid
    assert share is not None
    number = numbers_of(share.sites, lattice_at(case, geometry, spacing).sites)
    moved = jittered(case, geometry, particles, number, spacing)
    between = Migration(share, geometry.lower, geometry.upper, geometry.periodic, case.support * spacing)
    x, phase, number = between.settled(moved.x[:n], moved.phase, number)
    return replace(moved, x=np.concatenate([x, moved.x[n:]]), phase=phase, share=between.around(x, number))


def _all_solid(geometry: Geometry) -> ParticleError:
    return ParticleError("no fluid particle: the scene is solid everywhere at this spacing; "
                         f"check {what_is_solid(geometry)}, or take a smaller particles.spacing")


def place_share(geometry: Geometry, lattice: Lattice | MixedLattice, support: float, sight: float = 0.0) -> Particles:
    """The particles of a lattice that this process owns, and those that they see (`Share`); all processes call it.

    support: m; sight: how far particles see, m, where that is farther.
    Each classifies a slab of the lattice for the cut, then the sites of its own brick and those in sight of it: only
    histograms are sent. A site is identified by its number, and the geometry is evaluated at its place in the box, with
    the same bits on every process that sees it. Raises ParticleError where there is no fluid.
    """
    ranks, box = current(), (geometry.lower, geometry.upper, geometry.periodic)
    counts, dim = lattice.counts, geometry.dim
    first, end = np.zeros(dim, int), counts.copy()
    deep = int(counts[-1])  # slabs across the last axis, the first one of images: contiguous in their files
    first[-1], end[-1] = ranks.rank * deep // ranks.size, (ranks.rank + 1) * deep // ranks.size
    found, inside = [np.zeros((0, dim))], 0
    slab = geometry.within(lattice.corner + first * lattice.cell, lattice.corner + end * lattice.cell, 0.0)
    part = lattice.within(first, end)
    for index in part.cells(first, end):
        x = wrap(part.at(index), *box)
        found.append(x[slab.phase(x) >= 0])
        inside += int(np.all((x >= geometry.lower) & (x <= geometry.upper), axis=1).sum())
    x = np.concatenate(found)
    if reduce.number(x) == 0:
        raise _all_solid(geometry)
    # beyond walls at the faces of the box there are dummies, which have an owner too
    around = np.array(geometry.periodic)
    cut = Cut(x, np.where(around, geometry.lower, np.minimum(geometry.lower, lattice.corner)),
              np.where(around, geometry.upper, np.maximum(geometry.upper, lattice.corner + counts * lattice.cell)))
    del x, found, slab, part
    near = _near_brick(geometry, lattice, (support, max(support, sight)), cut)
    own, remote, foreign = near.here & (near.phase >= 0), near.there & (near.phase >= 0), near.there & (near.phase < 0)
    dummies = near.here & (near.phase < 0)
    exchange, of_dummies = (
        NeighbourExchange.of_sites(ranks.raw, near.site[others], near.owner[others], near.site[mine])  # type: ignore[attr-defined]
        for others, mine in ((remote, own), (foreign, dummies)))
    lower, upper = cut.bricks[ranks.rank]
    share = Share(lower, upper, near.x[remote], near.shift[remote], near.x[foreign], exchange, of_dummies, cut,
                  near.site[own])
    rows = np.concatenate([near.x[own], near.x[dummies]])
    return Particles(rows, near.phase[own], lattice.site_volume, inside, near.left_out, share)


@dataclass
class _Sites:
    """Sites of the fluid in sight of a brick, and those of solids that fluid may see.

    x: (k, dim) m, of an image near the brick; site: (k,) number in the lattice; owner: (k,) process; phase: (k,) int8;
    shift: (k, dim) int8 whole boxes from the place in the box to x. here: (k,) bool, owned by this process, and not an
    image; there: (k,) bool, owned by others, the first image of each. left_out: own sites that no fluid sees.
    """

    x: np.ndarray
    site: np.ndarray
    owner: np.ndarray
    phase: np.ndarray
    shift: np.ndarray
    left_out: int

    def __post_init__(self) -> None:
        mine = self.owner == current().rank
        self.here = mine & ~self.shift.any(axis=1)
        once = np.zeros(len(self.x), bool)
        once[np.unique(self.site, return_index=True)[1]] = True
        self.there = ~mine & once


def cells_in_sight(geometry: Geometry, lattice: Lattice | MixedLattice, brick: np.ndarray,
                   sight: float) -> tuple[np.ndarray, np.ndarray]:
    """(first, end), (dim,) each, of the cells of a lattice within `sight`, m, of a brick of corners (2, dim), m; beyond
    the ends of periodic axes they go on."""
    around = np.array(geometry.periodic)
    first = np.floor((brick[0] - sight - lattice.corner) / lattice.cell).astype(int) - 1
    end = np.ceil((brick[1] + sight - lattice.corner) / lattice.cell).astype(int) + 2
    return np.where(around, first, np.maximum(first, 0)), np.where(around, end, np.minimum(end, lattice.counts))


def _near_brick(geometry: Geometry, lattice: Lattice | MixedLattice, lengths: tuple[float, float], cut: Cut) -> _Sites:
    lower, upper = cut.bricks[current().rank]
    support, sight = lengths
    geometry = geometry.within(lower, upper, sight)
    around, counts, dim = np.array(geometry.periodic), lattice.counts, geometry.dim
    deepest, reach = support * (1.0 + 1e-9), sight * (1.0 + 1e-9)
    first, end = cells_in_sight(geometry, lattice, cut.bricks[current().rank], sight)
    lattice = lattice.within(first, end)
    parts: list[tuple[np.ndarray, ...]] = []
    left_out = 0
    for index in lattice.cells(first, end):
        raw, within = lattice.at(index), np.where(around, np.mod(index, counts), index)
        x = wrap(lattice.at(within), geometry.lower, geometry.upper, geometry.periodic)
        length = np.where(around, geometry.upper - geometry.lower, np.inf)
        shift = np.rint((raw - x) / length).astype(np.int8)
        image = x + shift * np.where(around, length, 0.0)
        near = np.all((image > lower - reach) & (image < upper + reach), axis=1)
        x, image, shift, site = x[near], image[near], shift[near], lattice.numbers(within)[near]
        phase, owner = geometry.phase(x), cut.owner(x)
        kept = phase >= 0
        solid = np.flatnonzero(~kept)
        if geometry.has_solid:
            kept[solid] = -geometry.distance(x[solid], deepest) < deepest
            left_out += int((~kept & (owner == current().rank) & ~shift.any(axis=1)).sum())
        parts.append((image[kept], site[kept], owner[kept], phase[kept], shift[kept]))
    none = (np.zeros((0, dim)), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int8),
            np.zeros((0, dim), np.int8))
    image, site, owner, phase, shift = (np.concatenate(group) for group in zip(none, *parts))
    return _Sites(image, site, owner, phase, shift, left_out)
