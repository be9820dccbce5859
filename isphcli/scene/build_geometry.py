"""The geometry of a case: `ShapeGeometry` of its shapes, or that of its image (`image_geometry`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..case.forcing import flow_axis, sample_times, wall_velocities, walls_change
from ..geometry.faces import Walls
from ..geometry.protocol import Geometry

if TYPE_CHECKING:
    from ..case.blocks import Case, ShapeBlock, SpheresBlock
    from ..geometry.bodies import Region, Shape, Spheres


def build_geometry(case: Case, axis: int | None = None) -> Geometry:
    """Geometry of a case.

    axis: axis of flow (0 x, 1 y, 2 z), that of the drive where it is not given; an image that is not periodic along it,
    or a box with `geometry.clear_layer`, gets its clear layers there.
    """
    along = flow_axis(case) if axis is None else axis
    velocities = wall_velocities(case, case.dim or 3)
    walls = _face_walls(case, velocities)
    if case.geometry.voxels is not None:
        from .image_geometry import image_geometry

        return image_geometry(case, along, walls)
    return _shape_geometry(case, _box_of(case, along), walls, velocities)


def _face_walls(case: Case, velocities: Mapping[int, np.ndarray]) -> Walls:
    """The walls on faces of the box. velocities: {wall: (dim,) m/s} of the walls that move."""
    scene = case.geometry
    faces = {("xyz".index(name[0]), int(name.endswith("max"))): wall for name, wall in scene.walls.items()}
    return Walls(
        slip_length=scene.slip_length,
        face_velocity={(axis, side): velocities[1 + 2 * axis + side] for axis, side in faces
                       if 1 + 2 * axis + side in velocities},
        face_slip={f: w.slip_length for f, w in faces.items() if w.slip_length is not None},
    )  # fmt: skip


@dataclass(frozen=True)
class _Box:
    """The box of a scene of shapes. lower, upper: (dim,) m, with its clear layers; sample: the corners of what lies
    between these; layered: their axis, None without; periodic: per axis; asked: the same as the case says it, without
    clear layers, which make their axis periodic."""

    lower: np.ndarray
    upper: np.ndarray
    sample: tuple[np.ndarray, np.ndarray]
    layered: int | None
    periodic: list[bool]
    asked: list[bool]

    @property
    def period(self) -> np.ndarray:
        """(dim,) m, inf along axes that are not periodic."""
        return np.where(self.periodic, self.upper - self.lower, np.inf)


def _box_of(case: Case, along: int | None) -> _Box:
    scene = case.geometry
    assert scene.box is not None  # one of voxels and box is there
    lower = np.array(scene.origin or np.zeros(len(scene.box)), dtype=float)
    upper = lower + scene.box
    asked = ["xyz"[a] in scene.periodic for a in range(len(lower))]
    if scene.clear_layer is None or along is None or asked[along]:
        return _Box(lower, upper, (lower, upper), None, asked, asked)
    periodic = [known or a == along for a, known in enumerate(asked)]
    return _Box(*with_clear_layers(case, lower, upper, along), (lower, upper), along, periodic, asked)


@dataclass(frozen=True)
class _Said:
    """Sentences on a geometry: `described` and `warnings` of `protocol.Geometry`."""

    described: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def _shape_geometry(case: Case, box: _Box, walls: Walls, velocities: Mapping[int, np.ndarray]) -> Geometry:
    from ..geometry.shape_geometry import ShapeGeometry

    said, scene, names = _Said(), case.geometry, tuple(case.fluids)
    fluid = -1 if scene.fluid == "solid" else names.index(scene.fluid or names[0])
    shapes = _shapes(case, box, fluid, velocities, said)
    geometry = ShapeGeometry(box.lower, box.upper, box.periodic, fluid, shapes, walls)
    geometry.sample_lower, geometry.sample_upper = box.sample
    if (axis := box.layered) is not None:
        thick = box.sample[0][axis] - box.lower[axis]
        said.described.append(("clear layers", f"{thick:.6g} m at each end of {'xyz'[axis]}"))
    geometry.warnings = tuple(said.warnings) + geometry.warnings
    geometry.described = tuple(said.described)
    if case.reservoirs is not None:
        axis = "xyz".index(case.reservoirs.axis)
        geometry.sample_lower, geometry.sample_upper = between_reservoirs(
            box.lower, box.upper, axis, case.reservoirs.length)
    if walls_change(case):  # the speeds of now are those of the start, and steps need the largest
        for wall, at_times in wall_velocities(case, geometry.dim, sample_times(case)).items():
            turning = geometry.wall_speed[wall] - np.linalg.norm(velocities[wall])
            geometry.wall_speed[wall] = np.linalg.norm(at_times, axis=1).max() + turning
    return geometry


def _shapes(case: Case, box: _Box, fluid: int, velocities: Mapping[int, np.ndarray], said: _Said) -> list[Shape]:
    """The shapes of a case in their order. fluid: index of the fluid outside of all shapes."""
    from ..geometry.bodies import Shape

    shapes: list[Shape] = []
    for k, s in enumerate(case.geometry.shapes):
        if s.spheres is not None and s.spheres.random:
            body: Region = _spheres_at_random(s.spheres, box, fluid, shapes)
        elif s.spheres is not None:
            body = _spheres_of_file(s.spheres, box, said)
        else:
            body = _body(s, box.lower, box.upper)
        rock = tuple(case.microporous).index(s.what) if s.what in case.microporous else -1
        wall = 1 + 2 * len(box.lower) + k
        shapes.append(Shape(body, case.phase_of(s.what), s.outside, velocities.get(wall), s.slip_length,
                            s.angular_velocity, rock))
    return shapes


def _spheres_at_random(asked: SpheresBlock, box: _Box, fluid: int, before: Sequence[Shape]) -> Spheres:
    """Spheres in the fluid that the shapes before them leave in the sample."""
    from ..geometry.shape_geometry import ShapeGeometry
    from .spheres import random_spheres

    assert asked.random is not None and asked.radius is not None
    free = ShapeGeometry(*box.sample, box.asked, fluid, before)
    return random_spheres(free, asked.random, asked.radius, asked.clearance, asked.seed)


def _spheres_of_file(asked: SpheresBlock, box: _Box, said: _Said) -> Spheres:
    """Spheres of a file, those of the sample where it has clear layers."""
    from .sphere_files import spheres_of_file

    assert asked.file is not None
    body = spheres_of_file(asked.file, len(box.lower), asked.radius, asked.scale)
    if box.layered is not None:
        body = _within(body, box.layered, box.sample, asked.file.name, said.described)
    _describe_spheres(asked.file, body, box, said)
    return body


def with_clear_layers(case: Case, lower: np.ndarray, upper: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners (dim,) of a box with the layers of `geometry.clear_layer` at both ends of an axis, m: whole spacings, so
    that the lattice lies in the sample as it does without them."""
    assert case.geometry.clear_layer is not None
    spacing = case.particles.spacing
    layer = np.zeros(len(lower))
    layer[axis] = spacing * max(math.ceil(case.geometry.clear_layer / spacing - 1e-6), 1)
    return lower - layer, upper + layer


def _within(body: Spheres, axis: int, sample: tuple[np.ndarray, np.ndarray], name: str,
            described: list[tuple[str, str]]) -> Spheres:
    """The balls of a pack with clear layers: those whose centre lies between its two ends, whole.

    Their parts beyond the ends have on average the volume that spheres centred beyond would have within, so that the
    porosity is that inside.
    Raises ShapeError where none lies there.
    """
    from ..geometry.bodies import ShapeError, Spheres

    centres, (lower, upper) = np.atleast_2d(np.asarray(body.centres, float)), sample
    inside = (centres[:, axis] >= lower[axis]) & (centres[:, axis] <= upper[axis])
    if inside.all():
        return body
    said = f"{np.count_nonzero(~inside)} of {len(inside)} spheres have their centre beyond the ends of {'xyz'[axis]}"
    if not inside.any():
        raise ShapeError(f"{name}: {said}: none is left; check lengths and origin")
    described.append((name, f"{said} and are left out"))
    radii = np.broadcast_to(np.asarray(body.radii, float), len(centres))
    return Spheres(centres[inside], radii[inside], body.columns)


def between_reservoirs(lower: np.ndarray, upper: np.ndarray, axis: int,
                       length: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Corners (dim,) of the region between two reservoirs of a length at the ends of an axis of a box, m."""
    ends = np.eye(len(lower))[axis] * (length or 0.0)
    return lower + ends, upper - ends


def _describe_spheres(file: Path, body: Spheres, box: _Box, said: _Said) -> None:
    """Add sentences on the spheres of a file to the descriptions and to the warnings of a geometry."""
    from .spheres import sphere_findings

    radii = np.ravel(body.radii)
    radius = f"{radii.min():.6g}" + ("" if radii.min() == radii.max() else f" to {radii.max():.6g}")
    held = [f"{len(body.centres)} of radius {radius} m", *([body.columns] if body.columns else [])]
    said.described.append((file.name, ", ".join(held)))
    found, odd = sphere_findings(body, box.lower, box.upper, box.period, file.name)
    said.described.extend((file.name, text) for text in found)
    said.warnings.extend(odd)


def _body(spec: ShapeBlock, lower: np.ndarray, upper: np.ndarray) -> Region:
    """The body of a shape of the case language that is not one of many spheres."""
    from ..geometry.bodies import Box, Cylinder, HalfSpace, Sphere

    if spec.sphere is not None:
        return Sphere(spec.sphere.centre, spec.sphere.radius)
    if spec.box is not None:
        return Box(spec.box.lower, spec.box.upper)
    if spec.half_space is not None:
        return HalfSpace(spec.half_space.point, spec.half_space.normal)
    cylinder = spec.cylinder
    assert cylinder is not None  # one of them is there
    axis = "xyz".index(cylinder.axis)
    ends = None
    if cylinder.lower is not None or cylinder.upper is not None:
        size = upper[axis] - lower[axis]  # an end that is not given lies beyond the box
        ends = (
            lower[axis] - size if cylinder.lower is None else cylinder.lower,
            upper[axis] + size if cylinder.upper is None else cylinder.upper,
        )
    centre = (lower + upper) / 2 if cylinder.centre is None else cylinder.centre
    return Cylinder(axis, centre, cylinder.radius, ends)
