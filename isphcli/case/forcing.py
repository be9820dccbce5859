"""What drives the flow: the one reading of `drive` and moving walls, and why nothing flows where pores are closed.

Where a case gives formulas of the time t, functions take it as an argument, s, one number or an array of any shape;
without it that of the start, 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from . import expressions

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry
    from .blocks import Case, DriveSteps, ShapeBlock, Timed, Wall

SAMPLES = 4000  # times of a run at which formulas are evaluated to find their largest values


def drives(case: Case, geometry: Geometry) -> list[tuple[int | None, np.ndarray]]:
    """[(axis, acceleration (dim,) of the first fluid, m/s2)] that a case asks for, at the start. The axis is None where
    walls move: the flow that they drag along is not a response to the drive, and has no permeability. A pressure drop
    is over the whole length of the geometry, its clear layers included."""
    dim, axes = geometry.dim, steady_axes(case)
    if axes and not walls_move(case):
        return [(axis, np.eye(dim)[axis]) for axis in axes]
    force = acceleration(case, geometry.upper - geometry.lower)
    if axes:
        force[axes[0]] = 1.0
    if not force.any() or walls_move(case):
        return [(None, force)]
    return [(int(np.argmax(np.abs(force))), force)]


def is_driven(case: Case) -> bool:
    """Whether a case has a drive at all, even one of zeros."""
    return case.drive is not None


def drives_of_zero(case: Case) -> list[str]:
    """'drive.body_force is zero along every axis' of each key of a drive whose numbers are all zero: it drives nothing,
    and of a flux in steps it lets nothing flow."""
    if case.drive is None:
        return []
    given = {"body_force": case.drive.body_force, "pressure_drop": (case.drive.pressure_drop or {}).values()}
    found = [f"drive.{name} is zero along every axis" for name, numbers in given.items()
             if numbers and not any(numbers)]
    steps = case.drive.steps
    in_steps = {} if steps is None else {"pressure_drop": steps.pressure_drop,
                                         "superficial_velocity": steps.superficial_velocity}
    return found + [f"drive.steps.{name} is zero in every step" for name, numbers in in_steps.items()
                    if numbers and not any(numbers)]


def force_is_given(case: Case) -> bool:
    """Whether a case gives a constant driving force; false where it names axes or a velocity, for which the run finds
    the force, and where the force changes with time."""
    return case.drive is None or not (case.drive.named_axes or case.drive.steps or _of_time(_drive_items(case)))


def changes(case: Case) -> bool:
    """Whether a formula of the time drives a case."""
    return _of_time(_drive_items(case)) or walls_change(case)


def walls_change(case: Case) -> bool:
    """Whether a wall of a case has a velocity that is a formula of the time."""
    return any(_of_time(velocity) for velocity in _wall_velocities(case).values())


def sample_times(case: Case) -> np.ndarray:
    """Times (SAMPLES,) from the start to the end of a run, s, in order. They are unequal, so that a formula that
    repeats is not looked at in the same phase every time; only the start where a case has no end."""
    end = case.time.end if case.time is not None else None
    if end is None:
        return np.zeros(1)
    k = np.arange(SAMPLES)
    return end * np.append((k + np.mod(k * (np.sqrt(5.0) - 1.0) / 2.0, 1.0)) / SAMPLES, 1.0)


def body_force(case: Case, dim: int, time: float | np.ndarray = 0.0) -> np.ndarray:
    """Acceleration (..., dim) of every fluid, m/s2, without what a pressure drop adds; zero where there is none."""
    force = np.zeros((*np.shape(time), dim))
    if case.drive is not None and case.drive.body_force is not None:
        force += _values(case.drive.body_force, time)
    return force


def pressure_gradient(case: Case, lengths: np.ndarray, time: float | np.ndarray = 0.0) -> np.ndarray:
    """Force per volume (..., dim), Pa/m, of the pressure drops over a box of edges lengths (dim,), m."""
    gradient = np.zeros((*np.shape(time), len(lengths)))
    for axis, drop in _pressure_drops(case, time).items():
        gradient[..., axis] = drop / lengths[axis]
    return gradient


def acceleration(case: Case, lengths: np.ndarray, time: float | np.ndarray = 0.0) -> np.ndarray:
    """Acceleration (..., dim) of the first fluid, m/s2, that body force and pressure drops give over a box of edges
    lengths (dim,), m; zero where the run finds the force."""
    force = body_force(case, len(lengths), time)
    density = next(iter(case.fluids.values())).density
    for axis, drop in _pressure_drops(case, time).items():
        force[..., axis] += drop / (density * float(lengths[axis]))
    return force


def strongest_acceleration(case: Case, lengths: np.ndarray, time: float | np.ndarray = 0.0) -> np.ndarray:
    """Size (...) of the largest acceleration of a fluid, m/s2: a pressure drop accelerates a light fluid more."""
    body, gradient = body_force(case, len(lengths), time), pressure_gradient(case, lengths, time)
    gradient = gradient + _largest_step(case, lengths)
    densities = {fluid.density for fluid in case.fluids.values()}
    return np.max([np.linalg.norm(body + gradient / density, axis=-1) for density in densities], axis=0)


def largest_acceleration(case: Case, lengths: np.ndarray) -> np.ndarray:
    """Acceleration (dim,) of a run by body force and pressure drops, m/s2, at the time when it is largest."""
    if not _of_time(_drive_items(case)):
        density = next(iter(case.fluids.values())).density
        return acceleration(case, lengths) + _largest_step(case, lengths) / density
    forces = acceleration(case, lengths, sample_times(case))
    return forces[np.argmax(np.linalg.norm(forces, axis=1))]


def wall_velocities(case: Case, dim: int, time: float | np.ndarray = 0.0) -> dict[int, np.ndarray]:
    """{number of a wall (`geometry.protocol`): its velocity (..., dim), m/s} of those that have one."""
    return {wall: _values(velocity, time) for wall, velocity in _wall_velocities(case, dim).items()}


def _wall_velocities(case: Case, dim: int = 3) -> dict[int, Sequence[Timed]]:
    faces = {1 + 2 * "xyz".index(name[0]) + int(name.endswith("max")): wall.velocity
             for name, wall in case.geometry.walls.items()}
    shapes = {1 + 2 * dim + k: shape.velocity for k, shape in enumerate(case.geometry.shapes)}
    return {wall: velocity for wall, velocity in (faces | shapes).items() if velocity is not None}


def _drive_items(case: Case) -> list[Timed]:
    """Numbers and formulas of body force and pressure drops."""
    if case.drive is None:
        return []
    return [*(case.drive.body_force or ()), *(case.drive.pressure_drop or {}).values()]


def _pressure_drops(case: Case, time: float | np.ndarray) -> dict[int, float | np.ndarray]:
    """{axis: drop (...), Pa}."""
    if case.drive is None:
        return {}
    return {"xyz".index(name): _value(drop, time) for name, drop in (case.drive.pressure_drop or {}).items()}


def _of_time(items: Sequence[Timed]) -> bool:
    return any(isinstance(item, str) for item in items)


def _value(item: Timed, time: float | np.ndarray) -> float | np.ndarray:
    return expressions.evaluate(item, t=time) if isinstance(item, str) else item


def _values(items: Sequence[Timed], time: float | np.ndarray) -> np.ndarray:
    """(..., len(items))."""
    return np.stack([np.broadcast_to(_value(item, time), np.shape(time)) for item in items], axis=-1)


def drive_steps(case: Case) -> DriveSteps | None:
    """The steps in which a case is driven between its reservoirs, or None."""
    return case.drive.steps if case.drive is not None else None


def _largest_step(case: Case, lengths: np.ndarray) -> np.ndarray:
    """Pressure gradient (dim,) of the largest pressure drop of all steps, Pa/m; zero without steps of pressure."""
    steps, gradient = drive_steps(case), np.zeros(len(lengths))
    if steps is not None and steps.pressure_drop and case.reservoirs is not None:
        axis = "xyz".index(case.reservoirs.axis)
        gradient[axis] = max(steps.pressure_drop, key=abs) / lengths[axis]
    return gradient


def longest_time(case: Case) -> float | None:
    """Time after which a run ends at the latest, s; None where only its steps or a steady state end it."""
    end, steps = case.time.end if case.time is not None else None, drive_steps(case)
    if steps is None:
        return end
    total = steps.duration * len(steps.pressure_drop or steps.superficial_velocity or ())
    return total if end is None else min(total, end)


def gradient_axis(case: Case) -> int | None:
    """Axis along which the run sets or finds a pressure gradient of its own (steps, a velocity that is held), or None;
    the state carries that gradient."""
    if drive_steps(case) is not None and case.reservoirs is not None:
        return "xyz".index(case.reservoirs.axis)
    return held_axis(case)


def steady_axes(case: Case) -> list[int]:
    """Axes along which a steady case asks for a flow of its own each."""
    return ["xyz".index(name) for name in (case.drive.axes or ())] if case.drive is not None else []


def driven_axes(case: Case, lengths: np.ndarray) -> list[int]:
    """Axes along which the drive pushes, the strongest first; lengths: (dim,) edges of the box, m."""
    if case.drive is not None and case.drive.named_axes:
        return ["xyz".index(name) for name in case.drive.named_axes]
    if drive_steps(case) is not None and case.reservoirs is not None:
        return ["xyz".index(case.reservoirs.axis)]
    strength = np.abs(largest_acceleration(case, lengths))
    return [int(axis) for axis in np.argsort(-strength, kind="stable") if strength[axis] > 0]


def pressed_axes(case: Case) -> set[int]:
    """Axes along which a difference of pressure drives, given, in steps or found for a velocity that is held."""
    found, held = gradient_axis(case), set(_pressure_drops(case, 0.0))
    return held if found is None else held | {found}


def reservoir_axes(case: Case) -> list[int] | None:
    """The axis from one reservoir to the other, alone; None without reservoirs."""
    return None if case.reservoirs is None else ["xyz".index(case.reservoirs.axis)]


def flow_axis(case: Case) -> int | None:
    """Axis of the reservoirs; else that of the only or largest component of the drive, as far as the case alone,
    without the lengths of the box, determines it; None without both."""
    drive = case.drive
    if case.reservoirs is not None:
        return "xyz".index(case.reservoirs.axis)
    if drive is None:
        return None
    if drive.named_axes:
        return "xyz".index(drive.named_axes[0])
    force = np.zeros(3)
    times = sample_times(case)
    if drive.body_force is not None:
        force[: len(drive.body_force)] = np.abs(_values(drive.body_force, times)).max(axis=0)
    for axis, drop in _pressure_drops(case, times).items() if drive.body_force is None else ():
        force[axis] = np.abs(drop).max()
    return int(np.argmax(force)) if force.any() else None


def held_flux(case: Case) -> tuple[int, float] | None:
    """(axis, superficial velocity that is held along it, m/s), or None; of steps that of the first one."""
    steps = drive_steps(case)
    if steps is not None and steps.superficial_velocity and case.reservoirs is not None:
        return "xyz".index(case.reservoirs.axis), steps.superficial_velocity[0]
    held = case.drive.superficial_velocity if case.drive is not None else None
    if not held:
        return None
    ((name, wanted),) = held.items()
    return "xyz".index(name), wanted


def held_axis(case: Case) -> int | None:
    """Axis along which a case holds a velocity, or None."""
    held = held_flux(case)
    return None if held is None else held[0]


def in_words(case: Case) -> str:
    """The drive of a case in words."""
    if case.drive is None:
        return "no drive"
    if case.drive.axes:
        return f"a flow along {', '.join(case.drive.axes)}"
    held = ["a velocity is held by a pressure drop"] if case.drive.superficial_velocity else []
    held += ["a drive in steps"] if case.drive.steps is not None else []
    later = " that changes with time" if _of_time(_drive_items(case)) else ""
    drop, force = (["a pressure drop"] if case.drive.pressure_drop else []), bool(case.drive.body_force)
    return " and ".join(held + drop + (["body force"] if force or not held + drop else [])) + later


def walls_move(case: Case) -> bool:
    """Whether walls of a case move."""
    walls: list[Wall | ShapeBlock] = [*case.geometry.walls.values(), *case.geometry.shapes]
    turns = any(shape.angular_velocity for shape in case.geometry.shapes)
    return turns or any(wall.velocity is not None and any(wall.velocity) for wall in walls)


def opens(case: Case, axis: int) -> bool:
    """Whether fluid can leave the box along an axis: it is periodic, or has clear layers, which lie at both ends of the
    axis of the flow, of each one where a steady case names several."""
    return "xyz"[axis] in case.geometry.repeats or (_has_layers(case) and axis in (flow_axis(case), *steady_axes(case)))


def _has_layers(case: Case) -> bool:
    voxels, layer = case.geometry.voxels, case.geometry.clear_layer
    return layer is not None if voxels is None else voxels.clear_layer != 0


def why_closed(case: Case, *axes: int) -> str:
    """A sentence on why nothing flows along axes without a path, and what to do."""
    walled = [axis for axis in axes if not opens(case, axis)]
    found = []
    if walled:
        names = _listed(walled)
        image = "" if case.geometry.voxels is None or _has_layers(case) else (
            "geometry.voxels.clear_layer is 0: leave it out, name the axis in geometry.mirror, or "
        )
        found.append(f"nothing can flow along {names}: both faces are walls; {image}add {names} to geometry.periodic")
    if blocked := [axis for axis in axes if axis not in walled]:
        voxels = case.geometry.voxels
        what = ("geometry.shapes" if voxels is None else
                "geometry.voxels." + ("labels" if voxels.grey is None else "grey.threshold and grey.solid"))
        found.append(
            f"no fluid path leads through the scene along {_listed(blocked)}: the permeability is zero; check {what}, "
            "or take a smaller particles.spacing if the lattice closes the throats"
        )
    return "; ".join(found)


def _listed(axes: Sequence[int]) -> str:
    """'x', 'x and y' or 'x, y and z'."""
    *names, last = ("xyz"[axis] for axis in axes)
    return f"{', '.join(names)} and {last}" if names else last


def scaled(case: Case, factor: float) -> Case:
    """The case with the forces that it gives, body force and pressure drops, times a factor; formulas stay."""
    drive = case.drive
    if drive is None:
        return case
    force = drive.body_force and tuple(f if isinstance(f, str) else factor * f for f in drive.body_force)
    drops = drive.pressure_drop and type(drive.pressure_drop)(
        {name: drop if isinstance(drop, str) else factor * drop for name, drop in drive.pressure_drop.items()})
    return replace(case, drive=replace(drive, body_force=force, pressure_drop=drops))
