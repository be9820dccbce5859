"""The geometry of a case: `ShapeGeometry` of its shapes or `VoxelGeometry` of its image."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import flow_axis, sample_times, wall_velocities, walls_change
from ..geometry.protocol import Geometry

if TYPE_CHECKING:
    from ..case.blocks import Case, Voxels
    from ..case.blocks import Shape as ShapeOfCase
    from ..geometry.bodies import Body, Spheres


def build_geometry(case: Case, axis: int | None = None) -> Geometry:
    """Geometry of a case.

    axis: axis of flow (0 x, 1 y, 2 z), that of the drive where it is not given; an image that is not periodic
    along it gets its clear layers there.
    """
    scene = case.geometry
    names = tuple(case.fluids)
    faces = {("xyz".index(name[0]), int(name.endswith("max"))): wall for name, wall in scene.walls.items()}
    moves_at = wall_velocities(case, case.dim or 3)
    walls: dict[str, Any] = dict(
        slip_length=scene.slip_length,
        face_velocity={(axis, side): moves_at[1 + 2 * axis + side] for axis, side in faces
                       if 1 + 2 * axis + side in moves_at},
        face_slip={f: w.slip_length for f, w in faces.items() if w.slip_length is not None},
    )
    if scene.voxels is not None:
        return _image_geometry(case, flow_axis(case) if axis is None else axis, walls)
    from ..geometry.bodies import Shape, Spheres
    from ..geometry.shape_geometry import ShapeGeometry
    from .spheres import random_spheres

    assert scene.box is not None  # one of voxels and box is there
    lower = np.array(scene.origin or np.zeros(len(scene.box)), dtype=float)
    upper = lower + scene.box
    fluid = -1 if scene.fluid == "solid" else names.index(scene.fluid or names[0])
    periodic = ["xyz"[a] in scene.periodic for a in range(len(lower))]
    shapes: list[Shape] = []
    warnings: list[str] = []
    described: list[tuple[str, str]] = []
    period = np.where(periodic, upper - lower, np.inf)
    for k, s in enumerate(scene.shapes):
        if s.spheres is not None and s.spheres.random:
            before = ShapeGeometry(lower, upper, periodic, fluid, shapes)
            asked = s.spheres
            assert asked.random is not None and asked.radius is not None
            body: Body = random_spheres(before, asked.random, asked.radius, asked.clearance, asked.seed)
        else:
            body = _body(s, lower, upper)
            if s.spheres is not None and s.spheres.file is not None:
                assert isinstance(body, Spheres)
                _describe_spheres(s.spheres.file, body, lower, upper, period, described, warnings)
        phase = -1 if s.what == "solid" else names.index(s.what)
        shapes.append(Shape(body, phase, s.outside, moves_at.get(1 + 2 * len(lower) + k), s.slip_length,
                            s.angular_velocity))
    geometry = ShapeGeometry(lower, upper, periodic, fluid, shapes, **walls)
    geometry.warnings = tuple(warnings) + geometry.warnings
    geometry.described = tuple(described)
    if walls_change(case):  # what they move at now is that of the start
        for wall, velocities in wall_velocities(case, geometry.dim, sample_times(case)).items():
            turning = geometry.wall_speed[wall] - np.linalg.norm(moves_at[wall])
            geometry.wall_speed[wall] = np.linalg.norm(velocities, axis=1).max() + turning
    return geometry


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


def _image_geometry(case: Case, axis: int | None, walls: dict) -> Geometry:
    from ..case.checks import check_dimension
    from ..domain.lattice import ParticleError
    from ..geometry.images.read import read_image
    from ..geometry.images.voxel_size import voxel_size_of
    from ..geometry.labels import apply_labels, crop, faces_that_differ
    from ..geometry.voxel_geometry import VoxelGeometry
    from . import memory

    spec = case.geometry.voxels
    assert spec is not None
    memory.refuse_image(case)
    image = read_image(spec.file, spec.array)
    values = image.values.transpose() if spec.axes == "xyz" else image.values
    values_shape = values.shape
    values = crop(values, spec.crop, spec.file)
    labels = apply_labels(values, spec.labels, tuple(case.fluids), spec.file)
    check_dimension(case, labels.ndim)
    size, whence, odd = voxel_size_of(image, spec.voxel_size, spec.file, spec.axes)
    periodic = ["xyz"[a] in case.geometry.periodic for a in range(labels.ndim)]
    clear = added = 0
    if axis is not None and not periodic[axis]:
        h = size[axis if len(size) > 1 else 0]
        clear = 6 if spec.clear_layer is None else max(round(spec.clear_layer / h), int(spec.clear_layer > 0))
        added = 2 * clear * (labels.size // labels.shape[labels.ndim - 1 - axis])
    if added > labels.size:
        what, fix = f"clear layers of {clear} voxels", "take a smaller geometry.voxels.clear_layer; it is in metres"
    else:
        what, fix = f"the wall distances of {labels.size + added:,} voxels", memory.CROP
    memory.refuse((labels.size + added) * memory.BYTES_VOXEL, what, fix)
    unusual = _unusual_size(case, np.broadcast_to(size, labels.ndim))
    try:
        memory.refuse_pores(case, labels, size, added)
    except ParticleError as error:  # voxels in another unit than the spacing make absurd numbers of particles
        raise ParticleError("; ".join((str(error), *unusual))) from None
    geometry = VoxelGeometry(labels, size, periodic, case.wall_distance, axis, clear, **walls)
    solid = labels < 0
    porosity, name = 1.0 - float(solid.mean()), spec.file.name
    geometry.warnings = (
        *image.warnings,
        *odd,
        *unusual,
        *_unusual_porosity(porosity, spec.labels),
        *faces_that_differ(solid, periodic),
    )
    geometry.described = (
        ("image", f"{_product(labels.shape[::-1])} voxels along {', '.join('xyz'[: labels.ndim])}"
                  + (f", cropped from {_product(values_shape[::-1])}" if spec.crop else "")
                  + f"; {name} is an array {_product(image.values.shape)}, its axes taken as "
                  + f"{', '.join(spec.axes if labels.ndim == 3 else spec.axes.replace('z', ''))}"),
        ("voxel size", f"{_product(geometry.voxel_size)} m, {whence}"),
        ("porosity", f"{100 * porosity:.2f} % of the image's voxels ({_labels_in_words(spec.labels)})"),
    )  # fmt: skip
    return geometry


SI_DENSITY = (300.0, 20_000.0)  # kg/m3 of liquids: a case that has one counts in SI units and not in its own
SI_VISCOSITY = (5e-6, 5e-5)  # Pa s of gases
MOST_POROUS = 0.6  # above it hardly any rock


def image_voxel_size(spec: Voxels) -> np.ndarray:
    """Edges of a voxel of an image of a case, m: those of the case, else of its file."""
    from ..geometry.images.read import read_image
    from ..geometry.images.voxel_size import voxel_size_of

    if spec.voxel_size is not None:
        return np.ravel(spec.voxel_size)
    return voxel_size_of(read_image(spec.file, spec.array), None, spec.file, spec.axes)[0]


def _unusual_size(case: Case, size: np.ndarray) -> tuple[str, ...]:
    """A voxel of millimetres and more in a case whose fluids are in SI units is mistaken, mostly micrometres."""
    from ..geometry.images.voxel_size import COARSE

    si = any(
        SI_DENSITY[0] <= f.density <= SI_DENSITY[1] or SI_VISCOSITY[0] <= f.mu <= SI_VISCOSITY[1]
        for f in case.fluids.values()
    )
    if not si or size.max() < COARSE:
        return ()
    return (
        f"voxels of {_product(size)} m (the fluids are in SI units): images of rock are finer; if micrometres are "
        f"meant, the voxel size is {_product(size * 1e-6)} m, if millimetres, {_product(size * 1e-3)} m",
    )


def _unusual_porosity(porosity: float, labels: Mapping[str, tuple[int, ...]]) -> tuple[str, ...]:
    if not MOST_POROUS < porosity < 1.0:
        return ()
    return (
        f"porosity {100 * porosity:.1f} %: more than rock has; check which values are solid ("
        f"{_labels_in_words(labels)}; the other way round it is {100 * (1 - porosity):.1f} %)",
    )


def _labels_in_words(labels: Mapping[str, tuple[int, ...]]) -> str:
    """'solid 1, water 0'."""
    return ", ".join(f"{name} {' '.join(str(v) for v in values)}" for name, values in labels.items())


def _product(numbers: Any) -> str:
    """'20 x 20 x 10', of lengths one number where they are equal."""
    words = [f"{n:.6g}" if isinstance(n, float) else str(n) for n in numbers]
    return words[0] if isinstance(numbers, np.ndarray) and len(set(words)) == 1 else " x ".join(words)


def _body(spec: ShapeOfCase, lower: np.ndarray, upper: np.ndarray) -> Body:
    """The body of a shape of the case language."""
    from ..geometry.bodies import Box, Cylinder, HalfSpace, Sphere
    from .spheres import spheres_of_file

    if spec.sphere is not None:
        return Sphere(spec.sphere.centre, spec.sphere.radius)
    if spec.spheres is not None:
        assert spec.spheres.file is not None
        return spheres_of_file(spec.spheres.file, len(lower), spec.spheres.radius)
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
