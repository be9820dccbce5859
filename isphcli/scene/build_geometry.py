"""The geometry of a case: `ShapeGeometry` of its shapes, or that of its image (`image_geometry`)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..case.forcing import flow_axis, sample_times, wall_velocities, walls_change
from ..geometry.faces import Walls
from ..geometry.protocol import Geometry

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..case.blocks import Shape as ShapeOfCase
    from ..geometry.bodies import Body, Spheres


def build_geometry(case: Case, axis: int | None = None) -> Geometry:
    """Geometry of a case.

    axis: axis of flow (0 x, 1 y, 2 z), that of the drive where it is not given; an image that is not periodic along it,
    or a box with `geometry.clear_layer`, gets its clear layers there.
    """
    scene = case.geometry
    names = tuple(case.fluids)
    faces = {("xyz".index(name[0]), int(name.endswith("max"))): wall for name, wall in scene.walls.items()}
    moves_at = wall_velocities(case, case.dim or 3)
    walls = Walls(
        slip_length=scene.slip_length,
        face_velocity={(axis, side): moves_at[1 + 2 * axis + side] for axis, side in faces
                       if 1 + 2 * axis + side in moves_at},
        face_slip={f: w.slip_length for f, w in faces.items() if w.slip_length is not None},
    )
    if scene.voxels is not None:
        from .image_geometry import image_geometry

        return image_geometry(case, flow_axis(case) if axis is None else axis, walls)
    from ..geometry.bodies import Shape, Spheres
    from ..geometry.shape_geometry import ShapeGeometry
    from .spheres import random_spheres

    assert scene.box is not None  # one of voxels and box is there
    lower = np.array(scene.origin or np.zeros(len(scene.box)), dtype=float)
    upper = lower + scene.box
    fluid = -1 if scene.fluid == "solid" else names.index(scene.fluid or names[0])
    periodic = ["xyz"[a] in scene.periodic for a in range(len(lower))]
    sample, closed = (lower, upper), list(periodic)
    along = flow_axis(case) if axis is None else axis
    layered = scene.clear_layer is not None and along is not None and not periodic[along]
    if layered:
        assert along is not None
        lower, upper = with_clear_layers(case, lower, upper, along)
        periodic[along] = True
    shapes: list[Shape] = []
    warnings: list[str] = []
    described: list[tuple[str, str]] = []
    period = np.where(periodic, upper - lower, np.inf)
    for k, s in enumerate(scene.shapes):
        if s.spheres is not None and s.spheres.random:
            before = ShapeGeometry(*sample, closed, fluid, shapes)
            asked = s.spheres
            assert asked.random is not None and asked.radius is not None
            body: Body = random_spheres(before, asked.random, asked.radius, asked.clearance, asked.seed)
        else:
            body = _body(s, lower, upper)
            if s.spheres is not None and s.spheres.file is not None:
                assert isinstance(body, Spheres)
                if layered and along is not None:
                    body = _within(body, along, sample, s.spheres.file.name, described)
                _describe_spheres(s.spheres.file, body, lower, upper, period, described, warnings)
        rock = tuple(case.microporous).index(s.what) if s.what in case.microporous else -1
        shapes.append(Shape(body, case.phase_of(s.what), s.outside, moves_at.get(1 + 2 * len(lower) + k), s.slip_length,
                            s.angular_velocity, rock))
    geometry = ShapeGeometry(lower, upper, periodic, fluid, shapes, walls)
    geometry.sample_lower, geometry.sample_upper = sample
    if layered and along is not None:
        described.append(("clear layers", f"{sample[0][along] - lower[along]:.6g} m at each end of {'xyz'[along]}"))
    geometry.warnings = tuple(warnings) + geometry.warnings
    geometry.described = tuple(described)
    if case.reservoirs is not None:
        along = "xyz".index(case.reservoirs.axis)
        geometry.sample_lower, geometry.sample_upper = between_reservoirs(lower, upper, along, case.reservoirs.length)
    if walls_change(case):  # what they move at now is that of the start
        for wall, velocities in wall_velocities(case, geometry.dim, sample_times(case)).items():
            turning = geometry.wall_speed[wall] - np.linalg.norm(moves_at[wall])
            geometry.wall_speed[wall] = np.linalg.norm(velocities, axis=1).max() + turning
    return geometry


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

    As much of them sticks out at the ends as is missing of those beyond, so that the pack is as dense as it is inside.
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
    """Corners (dim,) of what lies between two reservoirs of a length at the ends of an axis of a box, m."""
    ends = np.eye(len(lower))[axis] * (length or 0.0)
    return lower + ends, upper - ends


def _describe_spheres(file: Path, body: Spheres, lower: np.ndarray, upper: np.ndarray, period: np.ndarray,
                      described: list[tuple[str, str]], warnings: list[str]) -> None:
    """Put what a file of spheres holds and what is odd about it on the two lists."""
    from .spheres import sphere_findings

    radii = np.ravel(body.radii)
    radius = f"{radii.min():.6g}" + ("" if radii.min() == radii.max() else f" to {radii.max():.6g}")
    said = [f"{len(body.centres)} of radius {radius} m", *([body.columns] if body.columns else [])]
    described.append((file.name, ", ".join(said)))
    found, odd = sphere_findings(body, lower, upper, period, file.name)
    described.extend((file.name, text) for text in found)
    warnings.extend(odd)


def _body(spec: ShapeOfCase, lower: np.ndarray, upper: np.ndarray) -> Body:
    """The body of a shape of the case language."""
    from ..geometry.bodies import Box, Cylinder, HalfSpace, Sphere
    from .sphere_files import spheres_of_file

    if spec.sphere is not None:
        return Sphere(spec.sphere.centre, spec.sphere.radius)
    if spec.spheres is not None:
        assert spec.spheres.file is not None
        return spheres_of_file(spec.spheres.file, len(lower), spec.spheres.radius, spec.spheres.scale)
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
