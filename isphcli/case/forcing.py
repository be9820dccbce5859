"""What drives the flow: the one reading of `drive` and moving walls, and why nothing flows where pores are closed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry
    from .blocks import Case, Shape, Wall


def drives(case: Case, geometry: Geometry) -> list[tuple[int | None, np.ndarray]]:
    """[(axis, acceleration (dim,) of the first fluid, m/s2)] that a case asks for. The axis is None where walls move:
    what they drag along is not a response to the drive, and gives no permeability. A pressure drop is over the whole
    length of the geometry, its clear layers included."""
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
    """Whether a case has a drive at all, be it of zeros."""
    return case.drive is not None


def force_is_given(case: Case) -> bool:
    """Whether a case says what force drives it; not where it names axes or a velocity, whose force is up to the run."""
    return case.drive is None or not case.drive.named_axes


def body_force(case: Case, dim: int) -> np.ndarray:
    """Acceleration (dim,) of every fluid, m/s2, without what a pressure drop adds; zero where there is none."""
    force = np.zeros(dim)
    if case.drive is not None and case.drive.body_force is not None:
        force += case.drive.body_force
    return force


def pressure_gradient(case: Case, lengths: np.ndarray) -> np.ndarray:
    """Force per volume (dim,), Pa/m, of the pressure drops over a box of edges lengths (dim,), m."""
    gradient = np.zeros(len(lengths))
    if case.drive is not None:
        for name, drop in (case.drive.pressure_drop or {}).items():
            gradient["xyz".index(name)] = drop / lengths["xyz".index(name)]
    return gradient


def acceleration(case: Case, lengths: np.ndarray) -> np.ndarray:
    """Acceleration (dim,) of the first fluid, m/s2, that body force and pressure drops give over a box of edges
    lengths (dim,), m; zero where the force is up to the run."""
    force = body_force(case, len(lengths))
    density = next(iter(case.fluids.values())).density
    if case.drive is not None:
        for name, drop in (case.drive.pressure_drop or {}).items():
            axis = "xyz".index(name)
            force[axis] += drop / (density * float(lengths[axis]))
    return force


def steady_axes(case: Case) -> list[int]:
    """Axes along which a steady case asks for a flow of its own each."""
    return ["xyz".index(name) for name in (case.drive.axes or ())] if case.drive is not None else []


def driven_axes(case: Case, lengths: np.ndarray) -> list[int]:
    """Axes along which the drive pushes, the strongest first; lengths: (dim,) edges of the box, m."""
    if case.drive is not None and case.drive.named_axes:
        return ["xyz".index(name) for name in case.drive.named_axes]
    push = np.abs(acceleration(case, lengths))
    return [int(axis) for axis in np.argsort(-push, kind="stable") if push[axis] > 0]


def flow_axis(case: Case) -> int | None:
    """Axis of the drive: of its only or its largest component, by what the case says without lengths; None without a
    drive."""
    drive = case.drive
    if drive is None:
        return None
    if drive.named_axes:
        return "xyz".index(drive.named_axes[0])
    force = np.zeros(3)
    if drive.body_force is not None:
        force[: len(drive.body_force)] = np.abs(drive.body_force)
    elif drive.pressure_drop is not None:
        for name, drop in drive.pressure_drop.items():
            force["xyz".index(name)] = abs(drop)
    return int(np.argmax(force)) if force.any() else None


def held_flux(case: Case) -> tuple[int, float] | None:
    """(axis, superficial velocity that is held along it, m/s), or None."""
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
    """What moves the fluid."""
    if case.drive is None:
        return "no drive"
    held = ["a velocity is held by a pressure drop"] if case.drive.superficial_velocity else []
    return " and ".join(held + (["body force"] if case.drive.body_force or not held else []))


def walls_move(case: Case) -> bool:
    """Whether walls of a case move."""
    walls: list[Wall | Shape] = [*case.geometry.walls.values(), *case.geometry.shapes]
    turns = any(shape.angular_velocity for shape in case.geometry.shapes)
    return turns or any(wall.velocity is not None and any(wall.velocity) for wall in walls)


def opens(case: Case, axis: int) -> bool:
    """Whether fluid can leave the box along an axis: it is periodic, or an image with clear layers."""
    voxels = case.geometry.voxels
    return "xyz"[axis] in case.geometry.periodic or (voxels is not None and voxels.clear_layer != 0)


def why_closed(case: Case, *axes: int) -> str:
    """Why nothing flows along axes without a path, and what to do."""
    walled = [axis for axis in axes if not opens(case, axis)]
    found = []
    if walled:
        names = _listed(walled)
        image = "geometry.voxels.clear_layer is 0: leave it out, or " if case.geometry.voxels is not None else ""
        found.append(f"nothing can flow along {names}: both faces are walls; {image}add {names} to geometry.periodic")
    if blocked := [axis for axis in axes if axis not in walled]:
        what = "geometry.shapes" if case.geometry.voxels is None else "geometry.voxels.labels"
        found.append(
            f"no fluid path leads through the scene along {_listed(blocked)}: the permeability is zero; check {what}, "
            "or take a smaller particles.spacing if the lattice closes the throats"
        )
    return "; ".join(found)


def _listed(axes: Sequence[int]) -> str:
    """'x', 'x and y' or 'x, y and z'."""
    *names, last = ("xyz"[axis] for axis in axes)
    return f"{', '.join(names)} and {last}" if names else last
