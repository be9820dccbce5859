"""What makes the fluid move: accelerations of a case, a pressure drop among them, or a velocity that is held."""

from dataclasses import dataclass

import numpy as np

from .geometry import build_geometry
from .particles import sample_box


def drives(case, dim):
    """[(axis, acceleration (dim,) of the first fluid, m/s2)] that a case asks for. The axis is None where walls move:
    what they drag along is not a response to the drive, and gives no permeability."""
    drive = case.drive
    if drive is not None and drive.axes and not _walls_move(case):
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
    if not force.any() or _walls_move(case):
        return [(None, force)]
    return [(int(np.argmax(np.abs(force))), force)]


def _walls_move(case):
    walls = [*case.geometry.walls.values(), *case.geometry.shapes]
    turns = any(shape.angular_velocity for shape in case.geometry.shapes)
    return turns or any(wall.velocity is not None and any(wall.velocity) for wall in walls)


def _box_length(case, axis):
    if case.geometry.box is not None:
        return case.geometry.box[axis]
    geometry = build_geometry(case, axis)
    return float(geometry.upper[axis] - geometry.lower[axis])


LAG = 5.0  # steps in which a held velocity closes in on what is asked


def held_axis(case):
    """Axis along which a case holds a velocity, or None."""
    held = case.drive.superficial_velocity if case.drive is not None else None
    return "xyz".index(next(iter(held))) if held else None


@dataclass(frozen=True)
class HeldVelocity:
    """Holds the superficial velocity along an axis by a pressure gradient that follows.

    The flux changes as  dU/dt = s G + r,  G the gradient over the density of the first fluid and r all that resists:
    drag, and menisci in throats. What r was is seen from the last step, and G is then what lets U close in on the
    wanted value within LAG steps. s is at most that of a straight channel (`response`); less only slows the answer. A
    state holds the G of the step that made it, m/s2, and U before that step, m/s.

    axis: 0, 1 or 2; wanted: m/s; fraction: of the box that is fluid; response: s; areal: density of the first fluid
    times the length of the box, kg/m2; least: shortest time to close in, s, for the short steps of the start.
    """

    axis: int
    wanted: float
    fraction: float
    response: float
    areal: float
    least: float = 0.0

    @property
    def speed(self):
        """Mean speed of the fluid, m/s."""
        return abs(self.wanted) / self.fraction

    def step(self, state, dt):
        """(2,) G of the step of length dt after `state` (step.State), and U before it."""
        velocity, resisted = self.fraction * state.u[:, self.axis].mean(), 0.0
        push, before = state.hold
        if state.dt_old:
            resisted = (velocity - before) / state.dt_old
        push += ((self.wanted - velocity) / max(self.least, LAG * dt) - resisted) / self.response
        return np.array([push, velocity])

    def drop(self, state):
        """Pressure drop over the box in the step to `state`, Pa."""
        return float(state.hold[0] * self.areal)


def held_velocity(case, particles, density, reference, geometry):
    """HeldVelocity of a case without its `least`, or None. density: (n,) of the particles; reference: of the first
    fluid, kg/m3."""
    axis = held_axis(case)
    if axis is None:
        return None
    size = geometry.upper - geometry.lower
    fraction = particles.n_fluid * particles.site_volume / float(np.prod(size))
    (wanted,) = case.drive.superficial_velocity.values()
    return HeldVelocity(axis, wanted, fraction, fraction * float((reference / density).mean()),
                        reference * float(size[axis]))


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
