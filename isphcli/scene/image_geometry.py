"""The geometry of a case with an image: labels, or grey values, and the walls that they stand for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..domain.communicator import current, on_first
from ..domain.lattice import ParticleError
from ..geometry.clear_layer import clear_voxels
from ..geometry.images.image import Image, VoxelError
from ..geometry.images.read import image_shape, read_image
from ..geometry.images.voxel_size import COARSE, voxel_size_of
from ..geometry.labels import ClearLayers, apply_labels, faces_that_differ, histogram, mirrored, unlike_next
from . import memory
from .image_file import image_of, layout_of

if TYPE_CHECKING:
    from ..case.blocks import Case, Grey, Voxels
    from ..geometry.faces import Walls
    from ..geometry.protocol import Geometry
    from ..geometry.surface_ways import SurfaceWays
    from ..geometry.voxel_geometry import VoxelGeometry


@dataclass(frozen=True)
class Understood:
    """The meaning of the values of an image.

    labels: int8 [z, y, x] or [y, x], -1 solid, else the index of a fluid; field: None, or float32 of that shape, > 0 in
    fluid, whose zero is the wall; words: which values are solid; described: see `protocol.Geometry`; microporous: int8
    of the same shape, index of the rock, -1 for none; None where a case has none.
    """

    labels: np.ndarray
    field: np.ndarray | None
    words: str
    described: tuple[tuple[str, str], ...] = ()
    blur: float | None = None
    denoise: float = 0.0
    microporous: np.ndarray | None = None


def _along_xyz(image: Image) -> list[int]:
    """Voxels along x, y(, z) of the whole array in the file."""
    return [image.whole[image.axes.index(a)] for a in "xyz"[: len(image.axes)]]


def image_geometry(case: Case, axis: int | None, walls: Walls) -> Geometry:
    """Geometry of the image of a case; axis: of flow, which gets the clear layers, or None.

    Raises VoxelError where the image does not fit the case, ParticleError where it does not fit the memory.
    """
    from ..case.checks import check_dimension

    spec = case.geometry.voxels
    assert spec is not None
    if current().size > 1 and in_parts(case):
        return _brick_geometry(case, spec, axis, walls)
    memory.refuse_image(case)
    image = image_of(spec)
    values = mirrored(image.values, case.geometry.mirror)
    periodic = ["xyz"[a] in case.geometry.repeats for a in range(values.ndim)]
    understood = _understood(case, spec, values, periodic)
    check_dimension(case, 2 if values.shape[0] == 1 else values.ndim)  # of one layer the geometry is of two dimensions
    size, whence, odd = voxel_size_of(image, spec.voxel_size, spec.file)
    edges = np.broadcast_to(size, values.ndim)
    unusual = _unusual_size(case, edges)
    layers = _layers_that_fit(case, understood.labels, axis, edges, periodic, unusual)
    geometry, ways = _with_walls(case, understood, edges, periodic, layers, walls)
    porosity = _porosity_of(understood, tuple(case.microporous))
    geometry.warnings = (
        *image.warnings,
        *odd,
        *unusual,
        *_unusual_porosity(porosity),
        *faces_that_differ(understood.labels < 0, periodic),
        *(ways.warnings() if ways is not None else ()),
    )
    geometry.described = (
        _described_image(case, spec, values.shape[::-1], image),
        *_described_size(geometry, whence, porosity),
        *understood.described,
        *_described_layers(layers),
        *([("surface", ways.described())] if ways is not None else []),
    )
    return geometry


def _layers_that_fit(case: Case, labels: np.ndarray, axis: int | None, edges: np.ndarray, periodic: list[bool],
                     unusual: tuple[str, ...]) -> ClearLayers | None:
    """The clear layers of an image, or None. Raises ParticleError where the image with them does not fit into the
    memory; unusual: warnings on the size of its voxels, edges (dim,) m, a likely cause."""
    clear = added = 0
    if axis is not None and not periodic[axis]:
        clear = _clear_voxels(case, labels, axis, edges, periodic)
        added = 2 * clear * (labels.size // labels.shape[labels.ndim - 1 - axis])
    if added > labels.size:
        what, fix = f"clear layers of {clear} voxels", "take a smaller geometry.voxels.clear_layer; it is in metres"
    else:
        what, fix = f"the wall distances of {labels.size + added:,} voxels", memory.CROP
    memory.refuse((labels.size + added) * memory.BYTES_VOXEL * current().here, what, fix)
    try:
        memory.refuse_pores(case, labels, edges, added)
    except ParticleError as error:  # voxels in another unit than the spacing make absurd numbers of particles
        thick = (f"most of them are in the clear layers of {clear} voxels: {fix}",) if added > labels.size else ()
        raise ParticleError("; ".join((str(error), *thick, *unusual))) from None
    return ClearLayers(axis, clear) if axis is not None and clear > 0 else None


def _with_walls(case: Case, understood: Understood, edges: np.ndarray, periodic: list[bool],
                layers: ClearLayers | None, walls: Walls) -> tuple[VoxelGeometry, SurfaceWays | None]:
    """The geometry whose walls are those of `geometry.wall_distance`, and what a smooth wall opens and closes."""
    from ..geometry.iso_surface import ImageField, IsoSurfaceGeometry
    from ..geometry.voxel_geometry import VoxelGeometry

    ways: SurfaceWays | None = None
    if case.wall_distance == "stairs":
        geometry = VoxelGeometry(understood.labels, edges, periodic, layers, walls)
    else:
        field = understood.field
        smooth = ImageField(field, understood.denoise, understood.blur) if field is not None else None
        geometry = surface = IsoSurfaceGeometry(understood.labels, smooth, edges, periodic, layers, walls)
        ways = surface.ways()
    if understood.microporous is not None:
        geometry.fill_with(understood.microporous, layers)
    return geometry, ways


def in_parts(case: Case) -> bool:
    """Whether processes hold a part of the image of a case each: labels whose walls are faces of voxels. A smooth wall
    is found by waves that run through the whole image, and what fills a solid by the nearest voxel of fluid in it."""
    spec = case.geometry.voxels
    assert spec is not None
    return case.wall_distance == "stairs" and spec.grey is None and not case.geometry.mirror and not case.microporous


def _brick_geometry(case: Case, spec: Voxels, axis: int | None, walls: Walls) -> Geometry:
    """The geometry of an image of which several processes hold a part each; each counts the values of a slab."""
    from ..case.checks import check_dimension
    from ..geometry.image_brick import ImageBrick, LabelsInFile

    memory.refuse_image(case, parts=True)
    whole = image_shape(spec.file, layout=layout_of(spec))
    start, end = np.zeros(3, int), np.array((whole or image_of(spec).values.shape)[::-1])
    if spec.crop is not None:
        start, end = np.array(spec.crop).T
    dim, shape, ranks = len(end), end - start[: len(end)], current()

    def part(ranges: Sequence[tuple[int, int]]) -> Image:
        return read_image(spec.file, layout=layout_of(spec), crop=[(int(a + s), int(b + s)) for (a, b), s
                                                                   in zip(ranges, start)])

    deep = int(shape[-1])
    low, high = ranks.rank * deep // ranks.size, (ranks.rank + 1) * deep // ranks.size
    # where there are more processes than slices some read one in vain
    slab = part([*((0, int(n)) for n in shape[:-1]), (low, high) if low < high else (0, 1)])
    found: dict[int, int] = {}
    for counts in ranks.collect(histogram(slab.values) if low < high else {}):
        for value, count in counts.items():
            found[value] = found.get(value, 0) + count
    names = tuple(case.fluids)

    def labelled(values: np.ndarray) -> np.ndarray:
        return apply_labels(values, spec.labels, names, spec.file, dict(sorted(found.items())))

    labelled(slab.values[:0])  # raises VoxelError here where the labels do not fit the case
    solid = {int(v) for v in np.ravel(np.asarray(spec.labels.get("solid", ())))}
    fluid = sum(count for value, count in found.items() if value not in solid)
    def read(ranges: Sequence[tuple[int, int]]) -> np.ndarray:
        return labelled(part(ranges).values)

    in_file = LabelsInFile(tuple(map(int, shape)), fluid, read, *_of_slabs(read, shape, (low, high)))
    check_dimension(case, dim)
    periodic = ["xyz"[a] in case.geometry.repeats for a in range(dim)]
    size, whence, odd = voxel_size_of(slab, spec.voxel_size, spec.file)
    clear, edges = 0, np.broadcast_to(size, dim)
    if axis is not None and not periodic[axis]:
        # the thickness depends on the percolating pores of the whole image: rank 0 reads it, and frees it
        clear = on_first(lambda: _clear_voxels(
            case, in_file.part(np.zeros(dim, int), shape if spec.clear_layer is None else np.ones(dim, int), None),
            axis, edges, periodic))
    voxels = int(np.prod(shape))
    added = 2 * clear * (voxels // int(shape[axis])) if axis is not None else 0
    memory.refuse_pore_voxels(case, dim, size, (voxels + added, fluid + added), two=len(spec.labels) > 2)
    layers = ClearLayers(axis, clear) if axis is not None and clear > 0 else None
    geometry = ImageBrick(in_file, size, periodic, layers, walls)
    porosity = _Porosity(fluid / voxels, {}, _labels_in_words(spec.labels))
    geometry.warnings = (*slab.warnings, *odd, *_unusual_size(case, edges), *_unusual_porosity(porosity))
    geometry.described = (_described_image(case, spec, tuple(map(int, shape)), slab),
                          *_described_size(geometry, whence, porosity), *_described_layers(layers))
    return geometry


def _of_slabs(read: Callable[[Sequence[tuple[int, int]]], np.ndarray], shape: np.ndarray,
              slab: tuple[int, int]) -> tuple[float, bool]:
    """`walls` and `straight` of `LabelsInFile`, of which each process looks at the slices from slab[0] to before
    slab[1] across the last of the axes x, y(, z)."""
    (low, high), deep = slab, int(shape[-1])

    def slices(first: int, end: int) -> np.ndarray:
        return read([*((0, int(n)) for n in shape[:-1]), (first, end)]) >= 0

    unlike, same = 0, np.ones(len(shape), np.int64)
    if low < high:
        pores = slices(low, high)
        following = np.concatenate([pores, slices(high % deep, high % deep + 1)])
        unlike = int(np.count_nonzero(unlike_next(following, 0, False)))
        unlike += sum(int(np.count_nonzero(unlike_next(pores, axis, True))) for axis in range(1, pores.ndim))
        same[0] = np.all(pores == slices(0, 1))
        same[1:] = [np.all(pores == np.take(pores, [0], axis)) for axis in range(1, pores.ndim)]
    walls = current().sum(unlike) / (len(shape) * int(np.prod(shape)))
    everywhere = current().sum(same) == current().size
    return float(walls), len(shape) == 2 or bool(everywhere.any())


def _described_image(case: Case, spec: Voxels, shape: Sequence[int], image: Image) -> tuple[str, str]:
    """The entry of `described` for an image of so many voxels along x, y(, z)."""
    return ("image", f"{_product(shape)} voxels along {', '.join('xyz'[: len(shape)])}"
            + (f", cropped from {_product(_along_xyz(image))}" if spec.crop else "")
            + (f", with the mirror image along {', '.join(case.geometry.mirror)}" if case.geometry.mirror else "")
            + f"; {spec.file.name} is an array {_product(image.whole)}, its axes taken as " + ", ".join(image.axes))


def _described_size(geometry: VoxelGeometry, whence: str, porosity: _Porosity) -> tuple[tuple[str, str], ...]:
    rocks = ", ".join(f"{name} {100 * share:.2f} %" for name, share in porosity.rocks.items())
    return (("voxel size", f"{_product(geometry.voxel_size)} m, {whence}"),
            ("porosity", f"{100 * porosity.pores:.2f} % of the image's voxels ({porosity.words})"),
            *((("microporous", f"{rocks} of the image's voxels"),) if rocks else ()))


def _described_layers(layers: ClearLayers | None) -> tuple[tuple[str, str], ...]:
    return (("clear layers", f"{layers.voxels} voxels at each end of {'xyz'[layers.axis]}"),) if layers else ()


def _clear_voxels(case: Case, labels: np.ndarray, axis: int, size: np.ndarray, periodic: list[bool]) -> int:
    """Voxels of each clear layer: as asked, else what the flow needs, and no neighbours through the layers."""
    spec = case.geometry.voxels
    assert spec is not None
    if spec.clear_layer is not None:
        return max(round(spec.clear_layer / size[axis]), int(spec.clear_layer > 0))
    support = case.support * max(case.spacings)
    apart = math.ceil(support / size[axis] - 1e-6) if support < labels.shape[-1 - axis] * size[axis] else 1
    return max(clear_voxels(labels >= 0, axis, size, periodic), apart)


def _understood(case: Case, spec: Voxels, values: np.ndarray, periodic: list[bool]) -> Understood:
    names, fluids = (*case.fluids, *case.microporous), len(case.fluids)
    if spec.grey is None:
        labels = apply_labels(values, spec.labels, names, spec.file)
        found = Understood(labels, None, _labels_in_words(spec.labels))
    else:
        found = _understood_grey(spec, spec.grey, values, names, periodic)
    if not case.microporous:
        return found
    filled = found.labels >= fluids  # rock is numbered behind the fluids; the first of them seeps through it
    return replace(found, labels=np.where(filled, np.int8(0), found.labels),
                   microporous=np.where(filled, found.labels - np.int8(fluids), np.int8(-1)))


def _understood_grey(spec: Voxels, grey: Grey, values: np.ndarray, names: tuple[str, ...],
                     periodic: list[bool]) -> Understood:
    from ..geometry.grey import (
        TWO_VALUED,
        estimate_blur,
        field_of_grey,
        grey_classes,
        labels_of_grey,
        otsu_threshold,
    )

    otsu = isinstance(grey.threshold, str)
    threshold = otsu_threshold(values) if isinstance(grey.threshold, str) else grey.threshold
    off = grey.uncertainty or 0.0
    low, high, share = grey_classes(values, threshold)
    if not values.min() < threshold - off <= threshold + off < values.max():
        given = f"{threshold:g}" + (f" +- {off:g}" if off else "")
        raise VoxelError(f"{spec.file}: geometry.voxels.grey.threshold {given} parts nothing: the grey values "
                         f"lie between {values.min():g} and {values.max():g}; try otsu")
    field = field_of_grey(values, threshold, grey.solid)
    labels = labels_of_grey(values, threshold, grey.solid, grey.fluids, names, spec.file)
    grid, around = field if field.ndim == 3 else field[None], np.array([*periodic, True][:3])
    found = estimate_blur(grid, around)
    two_valued = share >= TWO_VALUED
    if isinstance(grey.blur, str) and not two_valued:
        raise VoxelError(
            f"{spec.file}: geometry.voxels.grey.blur: auto needs an image of two grey values; here only "
            f"{100 * share:.0f} % of the variance lies between the two sides of the threshold; give a number of voxels")
    blur = found if isinstance(grey.blur, str) else grey.blur or None
    slopes = (f"its slopes at the walls are those of a step blurred by {found:.2f} voxels" if two_valued
              else "it is not one of two grey values")
    taken = f"; {blur:.2f} voxels of blur and the average over a voxel are taken out" if blur is not None else ""
    described = (
        ("wall", f"surface of grey value {threshold:g} ({'Otsu' if otsu else 'given'}); the means below and above it "
                 f"are {low:g} and {high:g}, {100 * share:.0f} % of the variance lies between them"),
        ("sharpness", f"{slopes}{taken}"),
    )  # fmt: skip
    return Understood(labels, field, f"solid {grey.solid} {threshold:g}", described, blur, grey.denoise)


def threshold_of(spec: Voxels) -> float:
    """Grey value of the wall of a grey image of a case, as `image_geometry` takes it."""
    from ..geometry.grey import otsu_threshold

    assert spec.grey is not None
    if not isinstance(spec.grey.threshold, str):
        return spec.grey.threshold
    return otsu_threshold(image_of(spec).values)


SI_DENSITY = (300.0, 20_000.0)  # kg/m3 of liquids: a case that has one counts in SI units and not in its own
SI_VISCOSITY = (5e-6, 5e-5)  # Pa s of gases
MOST_POROUS = 0.6  # above it hardly any rock is found


def image_voxel_size(spec: Voxels) -> np.ndarray:
    """Edges of a voxel of an image of a case, m: those of the case, else of its file."""
    if spec.voxel_size is not None:
        return np.ravel(spec.voxel_size)
    return voxel_size_of(image_of(spec), None, spec.file)[0]


def _unusual_size(case: Case, size: np.ndarray) -> tuple[str, ...]:
    """Warnings of a voxel of millimetres or more in a case whose fluids are in SI units: most are meant in
    micrometres."""
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


@dataclass(frozen=True)
class _Porosity:
    """The share of the voxels of an image that are pores, the shares of microporous rocks by name, and which values are
    solid, in words."""

    pores: float
    rocks: dict[str, float]
    words: str


def _porosity_of(understood: Understood, rocks: tuple[str, ...]) -> _Porosity:
    filled, solid = understood.microporous, understood.labels < 0
    if filled is None:
        return _Porosity(1.0 - float(solid.mean()), {}, understood.words)
    shares = {name: float((filled == k).mean()) for k, name in enumerate(rocks)}
    return _Porosity(1.0 - float((solid | (filled >= 0)).mean()), shares, understood.words)


def _unusual_porosity(porosity: _Porosity) -> tuple[str, ...]:
    if not MOST_POROUS < porosity.pores < 1.0:
        return ()
    solid = 1.0 - porosity.pores - sum(porosity.rocks.values())
    return (
        f"porosity {100 * porosity.pores:.1f} %: more than rock has; check which values are solid ("
        f"{porosity.words}; the other way round it is {100 * solid:.1f} %)",
    )


def _labels_in_words(labels: Mapping[str, tuple[int, ...]]) -> str:
    """'solid 1, water 0'."""
    return ", ".join(f"{name} {' '.join(str(v) for v in values)}" for name, values in labels.items())


def _product(numbers: Any) -> str:
    """'20 x 20 x 10', of lengths one number where they are equal."""
    words = [f"{n:.6g}" if isinstance(n, float) else str(n) for n in numbers]
    return words[0] if isinstance(numbers, np.ndarray) and len(set(words)) == 1 else " x ".join(words)
