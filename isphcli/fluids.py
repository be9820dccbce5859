"""The fluids of a scene as the equations see them; a scene of one fluid needs no more than this."""

from dataclasses import dataclass

import numpy as np

from .operators import gradient_p, potential_gradient


@dataclass(frozen=True)
class Terms:
    """The fluids of one configuration, as the equations see them.

    ops: Operators, the weights of the pressure over the density, those of the velocity times the viscosity;
    viscosity: number that still multiplies the latter, m2/s; force: (dim,) or (n, dim) m/s2; jump: (n, dim) m/s2 what a
    jump of the pressure at the interface accelerates by, or None; lift: (n,) 1/s2, what the Laplacian of the pressure
    makes of that jump; density: over that of the first fluid, (n,) or 1;
    bulk: number, dynamic viscosity over the density of the first fluid of the rotational term (eq. 4), m2/s;
    turn: Turn, or None where the viscosity does not jump; smooth: (n,) bool, where the velocity has no kink, or None;
    shy: (n,) bool, near an interface, or None;
    along: (dim,) or (n, dim), what a unit pressure gradient along the axis of a held velocity accelerates by, or None;
    band: interface.Band of the tension, or None;
    forgets: whether the odd-even part of the pressure is taken out (see `Stepper._odd_even`).
    """

    ops: object
    viscosity: float
    force: np.ndarray
    jump: np.ndarray | None = None
    lift: np.ndarray | None = None
    density: object = 1.0
    bulk: float = 0.0
    turn: object = None
    smooth: np.ndarray | None = None
    shy: np.ndarray | None = None
    forgets: bool = True
    along: np.ndarray | None = None
    band: object = None

    def slope(self, p):
        """Gradient of the pressure p (n,) over the density without its jump, (n, dim) m/s2."""
        slope = gradient_p(self.ops, p)
        return slope if self.jump is None else slope - self.jump


def body_force(ops, x, row, force):
    """The body force (dim,), m/s2; beside walls as the gradient of its potential, (n, dim), as in `StokesSystem.drive`:
    fluid in a pocket or a dead end one particle wide rests. Arguments as those of `TwoFluids.terms`."""
    if ops.walls is None or not force.any():
        return force
    return potential_gradient(ops.start, row, x, ops.grad_p, force)


class OneFluid:
    """A single fluid, or two that differ in name only. reference: density, kg/m3; viscosity: kinematic,
    m2/s; force: (dim,) m/s2; held: (dim,) unit vector along which a velocity is held, or None."""

    tension = line = None
    first_passes = 3  # through the equations in the first step, which has no pressure to go on from

    def __init__(self, reference, viscosity, force, held=None):
        self.reference, self.viscosity, self.force, self.held = reference, viscosity, force, held

    @property
    def stiffest(self):
        """Largest kinematic viscosity, m2/s."""
        return self.viscosity

    @property
    def thinnest(self):
        """Smallest kinematic viscosity, m2/s."""
        return self.viscosity

    def terms(self, ops, x, row, pairs, owner):
        """Terms of one configuration; arguments as those of `TwoFluids.terms`."""
        along = body_force(ops, x, row, self.held) if self.held is not None else None
        return Terms(ops, self.viscosity, body_force(ops, x, row, self.force), bulk=self.viscosity, along=along)
