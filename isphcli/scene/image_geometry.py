"""The geometry of a case with an image: labels, or grey values, and the walls that they stand for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..domain.lattice import ParticleError
from ..geometry.clear_layer import clear_voxels
from ..geometry.images.image import Image, VoxelError
from ..geometry.images.voxel_size import COARSE, voxel_size_of
from ..geometry.labels import ClearLayers, apply_labels, faces_that_differ, mirrored
from . import memory
from .image_file import image_of

if TYPE_CHECKING:
    from ..case.blocks import Case, Grey, Voxels
    from ..geometry.faces import Walls
    from ..geometry.protocol import Geometry
    from ..geometry.surface_ways import SurfaceWays


@dataclass(frozen=True)
class Understood:
    """What the values of an image stand for.

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
    from ..geometry.iso_surface import ImageField, IsoSurfaceGeometry
    from ..geometry.voxel_geometry import VoxelGeometry

    spec = case.geometry.voxels
    assert spec is not None
    memory.refuse_image(case)
    image = image_of(spec)
    values = mirrored(image.values, case.geometry.mirror)
    periodic = ["xyz"[a] in case.geometry.repeats for a in range(values.ndim)]
    understood = _understood(case, spec, values, periodic)
    labels = understood.labels
    check_dimension(case, labels.ndim)
    size, whence, odd = voxel_size_of(image, spec.voxel_size, spec.file)
    clear = added = 0
    if axis is not None and not periodic[axis]:
        clear = _clear_voxels(case, labels, axis, np.broadcast_to(size, labels.ndim), periodic)
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
    layers = ClearLayers(axis, clear) if axis is not None and clear > 0 else None
    geometry: VoxelGeometry
    ways: SurfaceWays | None = None
    if case.wall_distance == "stairs":
        geometry = VoxelGeometry(labels, size, periodic, layers, walls)
    else:
        field = understood.field
        smooth = ImageField(field, understood.denoise, understood.blur) if field is not None else None
        geometry = surface = IsoSurfaceGeometry(labels, smooth, size, periodic, layers, walls)
        ways = surface.ways()
    if understood.microporous is not None:
        geometry.fill_with(understood.microporous, layers)
    solid = labels < 0
    porosity, name = 1.0 - float(solid.mean()), spec.file.name
    geometry.warnings = (
        *image.warnings,
        *odd,
        *unusual,
        *_unusual_porosity(porosity, understood.words),
        *faces_that_differ(solid, periodic),
        *(ways.warnings() if ways is not None else ()),
    )
    geometry.described = (
        ("image", f"{_product(labels.shape[::-1])} voxels along {', '.join('xyz'[: labels.ndim])}"
                  + (f", cropped from {_product(_along_xyz(image))}" if spec.crop else "")
                  + (f", with the mirror image along {', '.join(case.geometry.mirror)}" if case.geometry.mirror else "")
                  + f"; {name} is an array {_product(image.whole)}, its axes taken as "
                  + ", ".join(image.axes)),
        ("voxel size", f"{_product(geometry.voxel_size)} m, {whence}"),
        ("porosity", f"{100 * porosity:.2f} % of the image's voxels ({understood.words})"),
        *understood.described,
        *((("clear layers", f"{clear} voxels at each end of {'xyz'[axis]}"),) if clear and axis is not None else ()),
        *([("surface", ways.described())] if ways is not None else []),
    )  # fmt: skip
    return geometry


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
MOST_POROUS = 0.6  # above it hardly any rock


def image_voxel_size(spec: Voxels) -> np.ndarray:
    """Edges of a voxel of an image of a case, m: those of the case, else of its file."""
    if spec.voxel_size is not None:
        return np.ravel(spec.voxel_size)
    return voxel_size_of(image_of(spec), None, spec.file)[0]


def _unusual_size(case: Case, size: np.ndarray) -> tuple[str, ...]:
    """A voxel of millimetres and more in a case whose fluids are in SI units is mistaken, mostly micrometres."""
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


def _unusual_porosity(porosity: float, words: str) -> tuple[str, ...]:
    if not MOST_POROUS < porosity < 1.0:
        return ()
    return (
        f"porosity {100 * porosity:.1f} %: more than rock has; check which values are solid ("
        f"{words}; the other way round it is {100 * (1 - porosity):.1f} %)",
    )


def _labels_in_words(labels: Mapping[str, tuple[int, ...]]) -> str:
    """'solid 1, water 0'."""
    return ", ".join(f"{name} {' '.join(str(v) for v in values)}" for name, values in labels.items())


def _product(numbers: Any) -> str:
    """'20 x 20 x 10', of lengths one number where they are equal."""
    words = [f"{n:.6g}" if isinstance(n, float) else str(n) for n in numbers]
    return words[0] if isinstance(numbers, np.ndarray) and len(set(words)) == 1 else " x ".join(words)
