"""The fluids of a scene as the equations see them; a scene of one fluid needs no more than this."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..domain import reduce
from ..operators.apply import laplacian
from ..operators.fourth_order import laplacian_excess
from .forces import Force, acceleration_of, resistance_of

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..operators.pair_weights import Operators
    from ..operators.protocol import DiscreteOperators, WallSums
    from ..operators.wall_scene import WallChange


class StressCoupling(Protocol):
    """The part of the viscous stress that couples the components of the velocity (two_fluids.TransposedStress)."""

    def add(self, u: np.ndarray, out: np.ndarray, factor: float) -> None:
        """out += factor times the stress over the density, m/s2; u: (n + remote, dim); out: (n, dim)."""


class KinksOfVelocity(Protocol):
    """Where the viscosity jumps (kinks.Kinks)."""

    def put_slopes(self, fields: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Puts the slopes of velocities (n + remote, c) on the own side of a kink into gradients (n, c, dim); returns
        of which particles, (n,) bool."""

    def divergence(self, u: np.ndarray) -> np.ndarray:
        """What a kink makes of the divergence of u (n, dim), (n,), 1/s."""


class FluidInterface(Protocol):
    """The interface of one configuration (two_phase.interface.Interface)."""

    @property
    def phi(self) -> np.ndarray:
        """(n,) signed distance to it, m, positive in the first fluid."""

    @property
    def phase(self) -> np.ndarray:
        """(n,) int8 fluid of each particle, 0 or 1."""

    @property
    def fraction(self) -> np.ndarray:
        """(n,) volume fraction of the first fluid."""

    @property
    def curvature(self) -> np.ndarray:
        """(n,) 1/m, positive round a drop of the first fluid."""

    @property
    def strength(self) -> np.ndarray:
        """(n,) gradient of the volume fraction, 1/m."""


class Tension(Protocol):
    """What a step, and what measures it, need to know of surface tension."""

    @property
    def tension(self) -> float:
        """N/m."""

    @property
    def support(self) -> float:
        """Of the kernel, m."""

    @property
    def largest_step(self) -> float:
        """Capillary limit of the time step, s."""


class Fluids(Protocol):
    """What fluids put into the equations; `OneFluid` and `two_fluids.TwoFluids` implement it.

    force: (dim,) m/s2, on the first fluid; held: (dim,) unit vector along which a velocity is held, or None; line: what
    walls do near a contact line, or None; first_passes: through the equations in the first step, which has no pressure
    to go on from; added_viscosity: dynamic, Pa s, of an interface that would hardly damp with its own, else 0; forces:
    beside the drive.
    """

    force: np.ndarray
    held: np.ndarray | None
    line: WallChange | None
    first_passes: int
    added_viscosity: float
    forces: Sequence[Force]

    @property
    def reach(self) -> float:
        """How far particles see, m, or the support where that is more."""

    @property
    def tension(self) -> Tension | None:
        """Of the interface, or None."""

    @property
    def reference(self) -> float:
        """Density that pressures are divided by, kg/m3."""

    @property
    def nu_max(self) -> float:
        """Largest kinematic viscosity, m2/s."""

    @property
    def nu_min(self) -> float:
        """Smallest kinematic viscosity, m2/s."""

    @property
    def nu_lacking(self) -> float:
        """Kinematic viscosity that the rotational term of eq. 4 lacks, m2/s; see `StepLengths`."""

    def terms(self, ops: Operators, neighbours: Neighbourhood, phi: np.ndarray | None = None) -> Terms:
        """Terms of one configuration. neighbours: all of them, dummies included; phi: (n,) of `State`."""

    def carried(self, ops: Operators, terms: Terms, moving: tuple[np.ndarray, np.ndarray | None],
                dr: np.ndarray | None, dt: float, speed: float) -> tuple[np.ndarray | None, np.ndarray | None]:
        """`State.phi` and `State.volume` after a step of dt, s, from a configuration with these operators and terms;
        None of one fluid. moving: `State.u` and `State.volume`; dr: (n, dim) shifts, m, or None; speed: largest one,
        m/s."""

    def changing(self, p: np.ndarray, phi: np.ndarray, before: Terms) -> np.ndarray | None:
        """What `relabelled` has to know of the particles (n,) before they have moved, a row each; None of one fluid. p:
        (n,) of these Terms; phi: (n,) of `State` when they have moved."""

    def relabelled(self, carried: np.ndarray, changing: np.ndarray | None, now: Terms) -> np.ndarray:
        """The pressure (n,) that is `carried` where the particles have gone, with what changes for those that have come
        into the other fluid."""

    def driven_by(self, body: np.ndarray, drop_force: np.ndarray) -> Fluids:
        """The same fluids under a body force and that of a pressure gradient on the first fluid, (dim,) m/s2 each."""


@dataclass(frozen=True)
class ViscousWeights:
    """The viscous term of eq. 2 in weights per pair: factor (sum_j weight_ij (u_j - u_i) + what walls add), m/s2.

    factor: a number: the viscosity, m2/s, where the weights are those of the Laplacian, 1 where they hold a viscosity
    that varies; weight: (n_pairs,); walls: the sums over walls, of which lap, lap_velocity and slip are of this term,
    or None.
    """

    factor: float
    weight: np.ndarray
    walls: WallSums | None


@dataclass(frozen=True)
class Terms:
    """The fluids of one configuration, as the equations see them.

    ops: Operators, the weights of the pressure over the density; viscous: the weights of the viscous term; force:
    (dim,) or (n, dim) m/s2; jump_acceleration: (n, dim) m/s2 by the jump of the pressure at the interface, or None;
    laplacian_of_jump: (n,) 1/s2, what the Laplacian of the pressure makes of that jump; density: over that of the first
    fluid, (n,) or 1; rotational_viscosity: number, dynamic viscosity over the density of the first fluid of the
    rotational term (eq. 4), m2/s; transposed_stress: of two fluids, or None where the viscosity does not jump; smooth:
    (n,) bool, where the velocity has no kink, or None; along: (dim,) or (n, dim), acceleration by a unit pressure
    gradient along the axis of a held velocity, or None; interface: of two fluids, or None; kinks: of the velocity,
    where the viscosity jumps, or None; excess: (n,) m2, c of `viscous_solve`, or None where the velocity has kinks and
    forces jump; drag: (n,) 1/s, -drag u of the forces that resist (`Force`), or None; drop: (dim,) m/s2, acceleration
    of the first fluid by a given pressure gradient (it is in `force` too), where densities differ and a pressure
    gradient drives, given or held; else None.
    """

    ops: Operators
    viscous: ViscousWeights
    force: np.ndarray
    jump_acceleration: np.ndarray | None = None
    laplacian_of_jump: np.ndarray | None = None
    density: np.ndarray | float = 1.0
    rotational_viscosity: float = 0.0
    transposed_stress: StressCoupling | None = None
    smooth: np.ndarray | None = None
    along: np.ndarray | None = None
    interface: FluidInterface | None = None
    kinks: KinksOfVelocity | None = None
    excess: np.ndarray | None = None
    drag: np.ndarray | None = None
    drop: np.ndarray | None = None

    @property
    def least_drag(self) -> float:
        """The drag that acts everywhere, 1/s: in the projection it adds to inertia."""
        return 0.0 if self.drag is None else reduce.smallest(self.drag)

    def sharpened(self, right: np.ndarray) -> np.ndarray:
        """right + c L right of `viscous_solve`: accelerations (n, dim), m/s2, as they stand in eq. 2."""
        return right if self.excess is None else right + self.excess[:, None] * laplacian(self.ops, right)

    def divergence(self, u: np.ndarray) -> np.ndarray:
        """Divergence (n,), 1/s, of u (n, dim), walls and their velocities included, without what a kink makes of it."""
        divergence = self.ops.total_divergence(u)
        return divergence if self.kinks is None else divergence - self.kinks.divergence(u)

    def pressure_gradient(self, p: np.ndarray) -> np.ndarray:
        """Gradient of the pressure p (n,) over the density without its jump, (n, dim) m/s2."""
        gradient = self.ops.gradient_p(p)
        return gradient if self.jump_acceleration is None else gradient - self.jump_acceleration


def balanced_force(ops: DiscreteOperators, force: np.ndarray) -> np.ndarray:
    """The body force (dim,), m/s2; beside walls as the gradient of its potential, (n, dim), as in
    `StokesSystem.balanced_force`: fluid in a pocket or a dead end one particle wide rests."""
    if ops.walls is None or not force.any():
        return force
    return ops.potential_gradient(force)


def with_forces(terms: Terms, forces: Sequence[Force], x: np.ndarray, nu: np.ndarray | float) -> Terms:
    """The terms with those of forces beside the drive. x: (n, dim) particles, m; nu: kinematic viscosity there, (n,) or
    a number, m2/s."""
    acceleration, resistance = acceleration_of(forces, x), resistance_of(forces, x)
    if acceleration is not None:
        terms = replace(terms, force=terms.force + acceleration)
    if resistance is not None:
        terms = replace(terms, drag=nu * resistance, excess=None)
    return terms


class OneFluid:
    """A single fluid, or two that differ in name only. reference: density, kg/m3; viscosity: kinematic,
    m2/s; force: (dim,) m/s2; held: (dim,) unit vector along which a velocity is held, or None; forces: beside the
    drive."""

    tension: Tension | None = None
    line: WallChange | None = None
    first_passes = 3
    added_viscosity = 0.0
    reach = 0.0

    def __init__(self, reference: float, viscosity: float, force: np.ndarray, held: np.ndarray | None = None,
                 forces: Sequence[Force] = ()):
        self.reference, self.viscosity, self.force, self.held = reference, viscosity, force, held
        self.forces = forces

    @property
    def nu_max(self) -> float:
        """Largest kinematic viscosity, m2/s."""
        return self.viscosity

    @property
    def nu_min(self) -> float:
        """Smallest kinematic viscosity, m2/s."""
        return self.viscosity

    @property
    def nu_lacking(self) -> float:
        """None is: the term has the viscosity of the fluid."""
        return 0.0

    def driven_by(self, body: np.ndarray, drop_force: np.ndarray) -> OneFluid:
        """The same fluid under other forces; see `Fluids.driven_by`."""
        other = copy.copy(self)
        other.force = body + drop_force
        return other

    def terms(self, ops: Operators, neighbours: Neighbourhood, phi: np.ndarray | None = None) -> Terms:
        """Terms of one configuration; see `Fluids.terms`."""
        along = balanced_force(ops, self.held) if self.held is not None else None
        viscous = ViscousWeights(self.viscosity, ops.lap, ops.walls)
        terms = Terms(ops, viscous, balanced_force(ops, self.force), rotational_viscosity=self.viscosity, along=along,
                      excess=laplacian_excess(ops))
        return with_forces(terms, self.forces, neighbours.x[: ops.n], self.viscosity)

    def carried(self, ops: Operators, terms: Terms, moving: tuple[np.ndarray, np.ndarray | None],
                dr: np.ndarray | None, dt: float, speed: float) -> tuple[None, None]:
        """Nothing: there is no interface."""
        return None, None

    def changing(self, p: np.ndarray, phi: np.ndarray, before: Terms) -> None:
        """Nothing: particles keep their fluid."""

    def relabelled(self, carried: np.ndarray, changing: np.ndarray | None, now: Terms) -> np.ndarray:
        """carried: particles keep their fluid."""
        return carried
