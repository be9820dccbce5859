"""What makes the fluid move: accelerations of a case, a pressure drop among them, or a velocity that is held."""

from dataclasses import dataclass

import numpy as np

from .geometry import build_geometry
from .particles import sample_box


def drives(case, dim):
    """[(axis, acceleration (dim,) of the first fluid, m/s2)] that a case asks for. The axis is None where walls move:
    what they drag along is not a response to the drive, and gives no permeability."""
    drive = case.drive
    if drive is not None and drive.axes and not walls_move(case):
        return [("xyz".index(a), np.eye(dim)["xyz".index(a)]) for a in drive.axes]
    force = np.zeros(dim)
    if drive is not None and drive.pressure_drop is not None:
        density = next(iter(case.fluids.values())).density
        for name, drop in drive.pressure_drop.items():
            axis = "xyz".index(name)
            force[axis] += drop / (density * _box_length(case, axis))
    if drive is not None and drive.axes:
        force["xyz".index(drive.axes[0])] = 1.0
    if drive is not None and drive.body_force is not None:
        force += drive.body_force
    if not force.any() or walls_move(case):
        return [(None, force)]
    return [(int(np.argmax(np.abs(force))), force)]


def walls_move(case):
    """Whether walls of a case move."""
    walls = [*case.geometry.walls.values(), *case.geometry.shapes]
    turns = any(shape.angular_velocity for shape in case.geometry.shapes)
    return turns or any(wall.velocity is not None and any(wall.velocity) for wall in walls)


def _box_length(case, axis):
    if case.geometry.box is not None:
        return case.geometry.box[axis]
    geometry = build_geometry(case, axis)
    return float(geometry.upper[axis] - geometry.lower[axis])


STUCK = 1e-6  # of what free fluid would gain from a pressure gradient: less is no flow


def held_axis(case):
    """Axis along which a case holds a velocity, or None."""
    held = case.drive.superficial_velocity if case.drive is not None else None
    return "xyz".index(next(iter(held))) if held else None


@dataclass(frozen=True)
class HeldVelocity:
    """A superficial velocity that is held: each step finds the pressure gradient that it takes.

    A step is linear in the gradient G over the density of the first fluid: with v the velocity that a gradient of one
    makes (`Stepper._hold`), U(u + G v) = U(u) + G U(v) is what was asked.

    axis: 0, 1 or 2; wanted: m/s; fraction: of the box that is fluid; areal: density of the first fluid times the length
    of the box, kg/m2.
    """

    axis: int
    wanted: float
    fraction: float
    areal: float

    @property
    def speed(self):
        """Mean speed of the fluid, m/s."""
        return abs(self.wanted) / self.fraction

    def missing(self, u, v, rate):
        """G by which the velocities u (n, dim) miss what is wanted, m/s2. v: (n, dim) of a unit gradient, s; rate: 1/s,
        of the step. None where no gradient moves the fluid along the axis."""
        gain = v[:, self.axis].mean()
        if not gain * rate > STUCK:
            return None
        return (self.wanted / self.fraction - u[:, self.axis].mean()) / gain

    def drop(self, state):
        """Pressure drop over the box in the step to `state` (step.State), Pa."""
        return state.push * self.areal


def held_velocity(case, particles, reference, geometry):
    """HeldVelocity of a case, or None. reference: density of the first fluid, kg/m3."""
    axis = held_axis(case)
    if axis is None:
        return None
    size = geometry.upper - geometry.lower
    fraction = particles.n_fluid * particles.site_volume / float(np.prod(size))
    (wanted,) = case.drive.superficial_velocity.values()
    return HeldVelocity(axis, wanted, fraction, reference * float(size[axis]))


def darcy(geometry, x, velocity, site_volume, axis, force, viscosity):
    """Superficial and mean velocity (dim,) of the sample, and its permeability.

    x, velocity: (n, dim) of the fluid particles; axis: of the drive or None; force: (dim,) m/s2; viscosity: kinematic.
    permeability: (dim,) m2, entry `axis` along the drive, the others across it; None without a drive. The force acts on
    the whole length of the box, the sample resists on its own length: k = nu U L_sample / (g L_box).
    """
    lower, upper = sample_box(geometry)
    inside = np.all((x >= lower) & (x <= upper), axis=1)
    total = velocity[inside].sum(axis=0)
    superficial = total * (site_volume / np.prod(upper - lower))
    mean = total / max(int(inside.sum()), 1)
    if axis is None:
        return superficial, mean, None
    size = np.linalg.norm(force)
    gravity = size * (geometry.upper - geometry.lower)[axis] / (upper - lower)[axis]
    permeability = viscosity / gravity * superficial * np.sign(force[axis])
    permeability[axis] = viscosity / gravity * float(superficial @ force) / size
    return superficial, mean, permeability
