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
    drive, dim = case.drive, geometry.dim
    if drive is not None and drive.axes and not walls_move(case):
        return [("xyz".index(a), np.eye(dim)["xyz".index(a)]) for a in drive.axes]
    force = np.zeros(dim)
    if drive is not None and drive.pressure_drop is not None:
        density = next(iter(case.fluids.values())).density
        for name, drop in drive.pressure_drop.items():
            axis = "xyz".index(name)
            force[axis] += drop / (density * float(geometry.upper[axis] - geometry.lower[axis]))
    if drive is not None and drive.axes:
        force["xyz".index(drive.axes[0])] = 1.0
    if drive is not None and drive.body_force is not None:
        force += drive.body_force
    if not force.any() or walls_move(case):
        return [(None, force)]
    return [(int(np.argmax(np.abs(force))), force)]


def walls_move(case: Case) -> bool:
    """Whether walls of a case move."""
    walls: list[Wall | Shape] = [*case.geometry.walls.values(), *case.geometry.shapes]
    turns = any(shape.angular_velocity for shape in case.geometry.shapes)
    return turns or any(wall.velocity is not None and any(wall.velocity) for wall in walls)


def held_axis(case: Case) -> int | None:
    """Axis along which a case holds a velocity, or None."""
    held = case.drive.superficial_velocity if case.drive is not None else None
    return "xyz".index(next(iter(held))) if held else None


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


def _flow_axis(case: Case) -> int | None:
    """Axis of the drive: of its only or its largest component; None without a drive."""
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
