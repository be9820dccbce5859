"""What every geometry answers, and which parts of its fluid are connected.

`VoxelGeometry` (voxel_geometry.py) and `ShapeGeometry` (shapes.py) implement `Geometry`; `report` counts
the connected fluid of a lattice of labels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

if TYPE_CHECKING:
    from .case import Case
    from .case_blocks import Voxels


class Geometry(Protocol):
    """Labels and wall distances of a scene. Points are (n, dim) float64, lengths in metres.

    Points may lie outside the box: along periodic axes they are wrapped, along the others everything outside
    is solid.
    """

    dim: int
    lower: np.ndarray  # (dim,) corner of the box
    upper: np.ndarray  # (dim,)
    periodic: tuple[bool, ...]  # per axis
    wall_velocity: np.ndarray  # (n_walls, dim), m/s; wall 0 is at rest
    wall_spin: np.ndarray | None  # (n_walls, dim, dim), 1/s: a wall moves at wall_velocity + wall_spin @ x; None: 0
    wall_speed: np.ndarray  # (n_walls,) largest speed, m/s
    slip_length: np.ndarray  # (n_walls,) Navier slip length, m
    has_solid: bool  # False: no solid anywhere
    warnings: tuple[str, ...]  # what is odd about the input, sentences; () where nothing is
    described: tuple[tuple[str, str], ...]  # what was read and how it was understood: (name, text); () without a file

    def phase(self, x: np.ndarray) -> np.ndarray:
        """(n,) int8: -1 in a solid, otherwise the index of the fluid."""
        ...

    def distance(self, x: np.ndarray) -> np.ndarray:
        """(n,) signed distance to the wall, > 0 in fluid; +inf where there is no wall at all."""
        ...

    def wall(self, x: np.ndarray) -> np.ndarray:
        """(n,) int32 index of the nearest wall in `wall_velocity` and `slip_length`."""
        ...

    def crossing(self, xi: np.ndarray, xj: np.ndarray) -> np.ndarray:
        """(n,) fraction t in (0, 1] of the way from fluid point xi to xj where the first wall is met;
        1.0 where none is met."""
        ...


@dataclass(frozen=True)
class Connectivity:
    """Connected fluid of a lattice; axes in the order x, y(, z)."""

    porosity: float  # fluid cells over all cells
    components: int
    percolates: tuple[bool, ...]  # per axis
    percolating_porosity: tuple[float, ...]  # per axis: cells of components percolating along it / all cells
    isolated_pockets: int  # components that percolate along no axis
    isolated_volume: float  # their cells times the cell volume
    largest_share: float  # cells of the largest component over fluid cells (0 without fluid)


def components(fluid: np.ndarray, periodic: tuple[bool, ...]) -> tuple[np.ndarray, int, np.ndarray]:
    """Face-connected components of a fluid mask, across periodic faces.

    fluid: bool [z, y, x] or [y, x]; periodic: per axis in the order x, y(, z).
    Returns (labels with 0 in solid and 1..n, n, percolates (n + 1, dim) bool with axes x, y(, z)).
    A component percolates along a periodic axis if a closed path in it winds round that axis, and along
    another axis if it touches both faces.
    """
    fluid = np.asarray(fluid, dtype=bool)
    dim = fluid.ndim
    if len(periodic) != dim:
        raise ValueError(f"periodic has {len(periodic)} entries for an image of {dim} dimensions")
    raw, n_raw = ndimage.label(fluid)
    edges = _periodic_edges(raw, periodic)
    n, owner, winding = merge_periodic(n_raw, edges, dim)
    labels = np.concatenate([[0], owner + 1]).astype(raw.dtype)[raw]
    percolates = np.zeros((n + 1, dim), dtype=bool)
    percolates[1:] = winding
    for axis in range(dim):
        if not periodic[axis]:
            first, last = np.take(labels, [0, -1], axis=dim - 1 - axis).swapaxes(0, dim - 1 - axis)
            percolates[np.intersect1d(first, last), axis] = True
    percolates[0] = False
    return labels, n, percolates


def report(fluid: np.ndarray, periodic: tuple[bool, ...], cell_volume: float = 1.0) -> Connectivity:
    """Porosity, components, percolation and pockets of a fluid mask [z, y, x] or [y, x]; see `components`."""
    fluid = np.asarray(fluid, dtype=bool)
    labels, n, percolates = components(fluid, periodic)
    size = np.bincount(labels.ravel(), minlength=n + 1)
    size[0] = 0
    isolated = np.logical_not(percolates.any(axis=1))
    isolated[0] = False
    return Connectivity(
        porosity=float(size.sum() / max(fluid.size, 1)),
        components=n,
        percolates=tuple(bool(p) for p in np.ravel(percolates.any(axis=0))),
        percolating_porosity=tuple(float(s) for s in size @ percolates / max(fluid.size, 1)),
        isolated_pockets=int(isolated.sum()),
        isolated_volume=float(size[isolated].sum() * cell_volume),
        largest_share=float(size.max() / max(size.sum(), 1)),
    )


def percolating(fluid: np.ndarray, periodic: tuple[bool, ...], axis: int) -> np.ndarray:
    """Mask (shape of fluid) of the fluid in components that percolate along the axis (0 x, 1 y, 2 z)."""
    labels, _, percolates = components(fluid, periodic)
    return percolates[:, axis][labels]


def _periodic_edges(raw: np.ndarray, periodic: tuple[bool, ...]) -> np.ndarray:
    """(m, 3) int: component on the upper face, the one it touches on the lower face, axis."""
    dim = raw.ndim
    edges = [np.empty((0, 3), dtype=np.int64)]
    for axis in range(dim):
        if periodic[axis]:
            upper = np.take(raw, -1, axis=dim - 1 - axis).ravel().astype(np.int64)
            lower = np.take(raw, 0, axis=dim - 1 - axis).ravel().astype(np.int64)
            both = (upper > 0) & (lower > 0)
            pairs = np.unique(np.stack([upper[both], lower[both]], axis=1), axis=0)
            edges.append(np.column_stack([pairs - 1, np.full(len(pairs), axis)]))
    return np.concatenate(edges)


def merge_periodic(n_raw: int, edges: np.ndarray, dim: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Join components by periodic edges: (n, owner (n_raw,), winding (n, dim) bool).

    Each raw component gets the periodic cell it lies in along a spanning tree; an edge that disagrees with
    the tree closes a path round the box.
    """
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n_raw, n_raw)).tocsr()
    n, owner = connected_components(graph, directed=False) if n_raw else (0, np.empty(0, dtype=np.int64))
    winding = np.zeros((n, dim), dtype=bool)
    if not len(edges):
        return n, owner, winding
    shift_of: dict[tuple[int, int], np.ndarray] = {}
    for upper, lower, axis in edges:
        step = np.zeros(dim, dtype=np.int64)
        step[axis] = 1
        shift_of[int(upper), int(lower)] = step
        shift_of.setdefault((int(lower), int(upper)), -step)
    cell = np.zeros((n_raw, dim), dtype=np.int64)
    for start in np.unique(owner[edges[:, 0]]):
        root = int(edges[owner[edges[:, 0]] == start][0, 0])
        order, parent = breadth_first_order(graph, root, directed=False)
        for node in order[1:]:
            cell[node] = cell[parent[node]] + shift_of[int(parent[node]), int(node)]
    step = np.zeros((len(edges), dim), dtype=np.int64)
    step[np.arange(len(edges)), edges[:, 2]] = 1
    loop = cell[edges[:, 0]] + step - cell[edges[:, 1]]
    np.logical_or.at(winding, owner[edges[:, 0]], loop != 0)
    return n, owner, winding


def block_distance(q: np.ndarray) -> np.ndarray:
    """Signed distance of a block from its per-axis signed distances q (n, k), exact inside and outside."""
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def face_distance(
    x: np.ndarray, lower: np.ndarray, upper: np.ndarray, periodic: tuple[bool, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (n,) to the faces of the non-periodic axes, > 0 in the box, and the wall number (n,)
    int32 of the nearest: 1 + 2 axis + side. +inf and 0 where all axes are periodic."""
    walls = [a for a in range(len(lower)) if not periodic[a]]
    if not walls:
        return np.full(len(x), np.inf), np.zeros(len(x), dtype=np.int32)
    depth = np.stack([q for a in walls for q in (x[:, a] - lower[a], upper[a] - x[:, a])], axis=1)
    numbers = np.array([1 + 2 * a + side for a in walls for side in (0, 1)], dtype=np.int32)
    return -block_distance(-depth), numbers[np.argmin(depth, axis=1)]


def face_walls(
    dim: int, slip: float, face_velocity: dict | None, face_slip: dict | None, n_more: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Table of walls: velocity (n, dim), m/s, and slip length (n,), m.

    Wall 0 is any wall at rest, 1 + 2 axis + side a face, n_more others follow. face_velocity, face_slip:
    {(axis, side): value}, side 0 lower, 1 upper.
    """
    velocity = np.zeros((1 + 2 * dim + n_more, dim))
    slips = np.full(len(velocity), float(slip))
    for (axis, side), value in (face_velocity or {}).items():
        velocity[1 + 2 * axis + side] = value
    for (axis, side), value in (face_slip or {}).items():
        slips[1 + 2 * axis + side] = value
    return velocity, slips


def build_geometry(case: Case, axis: int | None = None) -> Geometry:
    """Geometry of a case.

    axis: axis of flow (0 x, 1 y, 2 z), that of the drive where it is not given; an image that is not periodic
    along it gets its clear layers there.
    """
    scene = case.geometry
    names = tuple(case.fluids)
    faces = {("xyz".index(name[0]), int(name.endswith("max"))): wall for name, wall in scene.walls.items()}
    walls: dict[str, Any] = dict(
        slip_length=scene.slip_length,
        face_velocity={f: w.velocity for f, w in faces.items() if w.velocity is not None},
        face_slip={f: w.slip_length for f, w in faces.items() if w.slip_length is not None},
    )
    if scene.voxels is not None:
        return _image_geometry(case, _flow_axis(case) if axis is None else axis, walls)
    from .shapes import Shape, ShapeGeometry, random_spheres

    assert scene.box is not None  # one of voxels and box is there
    lower = np.array(scene.origin or np.zeros(len(scene.box)), dtype=float)
    upper = lower + scene.box
    fluid = -1 if scene.fluid == "solid" else names.index(scene.fluid or names[0])
    periodic = ["xyz"[a] in scene.periodic for a in range(len(lower))]
    shapes: list[Shape] = []
    warnings: list[str] = []
    described: list[tuple[str, str]] = []
    period = np.where(periodic, upper - lower, np.inf)
    for s in scene.shapes:
        if s.spheres is not None and s.spheres.random:
            before = ShapeGeometry(lower, upper, periodic, fluid, shapes)
            asked = s.spheres
            body = random_spheres(before, asked.random, asked.radius, asked.clearance, asked.seed)
        else:
            body = _body(s, lower, upper)
            if s.spheres is not None:
                _describe_spheres(s.spheres.file, body, lower, upper, period, described, warnings)
        phase = -1 if s.what == "solid" else names.index(s.what)
        shapes.append(Shape(body, phase, s.outside, s.velocity, s.slip_length, s.angular_velocity))
    geometry = ShapeGeometry(lower, upper, periodic, fluid, shapes, **walls)
    geometry.warnings = tuple(warnings) + geometry.warnings
    geometry.described = tuple(described)
    return geometry


def _describe_spheres(file, body, lower, upper, period, described, warnings) -> None:
    """Put what a file of spheres holds and what is odd about it on the two lists."""
    from .shapes import sphere_findings

    radii = np.ravel(body.radii)
    radius = f"{radii.min():.6g}" + ("" if radii.min() == radii.max() else f" to {radii.max():.6g}")
    said = [f"{len(body.centres)} of radius {radius} m", *([body.columns] if body.columns else [])]
    described.append((file.name, ", ".join(said)))
    found, odd = sphere_findings(body, lower, upper, period, file.name)
    described.extend((file.name, text) for text in found)
    warnings.extend(odd)


def _image_geometry(case: Case, axis: int | None, walls: dict) -> Geometry:
    from . import memory, voxels
    from .case_checks import check_dimension
    from .particles import ParticleError
    from .voxel_geometry import VoxelGeometry

    spec = case.geometry.voxels
    assert spec is not None
    memory.refuse_image(case)
    image = voxels.read_image(spec.file, spec.array)
    values = image.values.transpose() if spec.axes == "xyz" else image.values
    values_shape = values.shape
    values = voxels.crop(values, spec.crop, spec.file)
    labels = voxels.apply_labels(values, spec.labels, tuple(case.fluids), spec.file)
    check_dimension(case, labels.ndim)
    size, whence, odd = voxels.voxel_size_of(image, spec.voxel_size, spec.file, spec.axes)
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
        *voxels.faces_that_differ(solid, periodic),
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
    from . import voxels

    if spec.voxel_size is not None:
        return np.ravel(spec.voxel_size)
    return voxels.voxel_size_of(voxels.read_image(spec.file, spec.array), None, spec.file, spec.axes)[0]


def _unusual_size(case: Case, size: np.ndarray) -> tuple[str, ...]:
    """A voxel of millimetres and more in a case whose fluids are in SI units is mistaken, mostly micrometres."""
    from .voxels import COARSE

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


def _body(spec, lower: np.ndarray, upper: np.ndarray):
    """The body of a shape of the case language."""
    from . import shapes

    if spec.sphere is not None:
        return shapes.Sphere(spec.sphere.centre, spec.sphere.radius)
    if spec.spheres is not None:
        return shapes.spheres_of_file(spec.spheres.file, len(lower), spec.spheres.radius)
    if spec.box is not None:
        return shapes.Box(spec.box.lower, spec.box.upper)
    if spec.half_space is not None:
        return shapes.HalfSpace(spec.half_space.point, spec.half_space.normal)
    cylinder = spec.cylinder
    axis = "xyz".index(cylinder.axis)
    ends = None
    if cylinder.lower is not None or cylinder.upper is not None:
        size = upper[axis] - lower[axis]  # an end that is not given lies beyond the box
        ends = (
            lower[axis] - size if cylinder.lower is None else cylinder.lower,
            upper[axis] + size if cylinder.upper is None else cylinder.upper,
        )
    centre = (lower + upper) / 2 if cylinder.centre is None else cylinder.centre
    return shapes.Cylinder(axis, centre, cylinder.radius, ends)
