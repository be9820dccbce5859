"""The geometry of a case with an image: labels, or grey values, and the walls that they stand for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..domain import reduce
from ..domain.communicator import current
from ..domain.lattice import ParticleError
from ..domain.slabs import Shared, Slabs
from ..geometry.clear_layer import clear_voxels
from ..geometry.images.image import Image, VoxelError
from ..geometry.images.voxel_size import COARSE, voxel_size_of
from ..geometry.labels import ClearLayers, apply_labels, faces_that_differ, histogram, mirrored
from . import memory
from .image_file import image_layers, image_of, shape_of

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
    of the same shape, index of the rock, -1 for none; None where a case has none; off: see `VoxelGeometry.off`;
    warnings: on the threshold of grey values.
    """

    labels: np.ndarray
    field: np.ndarray | None
    words: str
    described: tuple[tuple[str, str], ...] = ()
    microporous: np.ndarray | None = None
    off: float | None = None
    warnings: tuple[str, ...] = ()


def _along_xyz(image: Image) -> list[int]:
    """Voxels along x, y(, z) of the whole array in the file."""
    return [image.whole[image.axes.index(a)] for a in "xyz"[: len(image.axes)]]


@dataclass(frozen=True)
class _Layers:
    """The layers of the image of a case that this process has, all of them where it is alone.

    image: what its file says, and the values of these layers; values: [z, y, x], mirrored as asked; slabs: how the
    processes share them; dim: 2 or 3, of the image.
    """

    image: Image
    values: np.ndarray
    slabs: Slabs
    dim: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Voxels along x, y(, z)."""
        return self.slabs.shape[::-1][: self.dim]


def _layers_of(case: Case, spec: Voxels) -> _Layers:
    """Reads the own layers of the image of a case. Raises VoxelError."""
    if current().size == 1:
        image = image_of(spec)
        values = mirrored(image.values, case.geometry.mirror)
        values = values.reshape(-1, *values.shape[-2:])
        return _Layers(image, values, Slabs(values.shape), 2 if values.shape[0] == 1 else 3)
    shape = shape_of(spec)
    dim = 2 if len(shape) == 2 or shape[0] == 1 else 3
    read = shape if len(shape) == 3 else (1, *shape)
    slabs = Slabs([n * (1 + (name in case.geometry.mirror)) for n, name in zip(read, "zyx")])
    at = np.arange(*slabs.own)
    at = np.where(at < read[0], at, 2 * read[0] - 1 - at)  # behind the mirror the layers come back
    first, end = (int(at.min()), int(at.max()) + 1) if len(at) else (0, 1)  # who has no layers reads one in vain
    image = image_layers(spec, *((first, end) if len(shape) == 3 else (0, shape[0])))
    values = mirrored(image.values.reshape(-1, *read[1:]), [name for name in case.geometry.mirror if name != "z"])
    return _Layers(image, values[at - first], slabs, dim)


def image_geometry(case: Case, axis: int | None, walls: Walls) -> Geometry:
    """Geometry of the image of a case; axis: of flow, which gets the clear layers, or None.

    Raises VoxelError where the image does not fit the case, ParticleError where it does not fit the memory.
    """
    from ..case.checks import check_dimension

    spec = case.geometry.voxels
    assert spec is not None
    memory.refuse_image(case)
    own = _layers_of(case, spec)
    periodic = ["xyz"[a] in case.geometry.repeats for a in range(own.dim)]
    understood = _understood(case, spec, own, periodic)
    check_dimension(case, own.dim)
    size, whence, odd = voxel_size_of(own.image, spec.voxel_size, spec.file)
    edges = (np.ravel(size) if np.size(size) > 1 else np.broadcast_to(size, own.dim))[: own.dim]
    unusual = _unusual_size(case, edges)
    layers = _layers_that_fit(case, understood.labels, own, axis, edges, periodic, unusual)
    geometry, ways = _with_walls(case, understood, own, edges, periodic, layers, walls)
    geometry.off = understood.off
    porosity = _porosity_of(understood, tuple(case.microporous))
    geometry.warnings = (
        *own.image.warnings,
        *understood.warnings,
        *odd,
        *unusual,
        *_unusual_porosity(porosity),
        *_open_edges(understood.labels, periodic),
        *faces_that_differ(understood.labels < 0, periodic, own.slabs),
        *(ways.warnings() if ways is not None else ()),
    )
    geometry.described = (
        _described_image(case, spec, own.shape, own.image),
        *_described_size(geometry, whence, porosity),
        *understood.described,
        *_described_layers(layers),
        *([("surface", ways.described())] if ways is not None else []),
    )
    return geometry


def _layers_that_fit(case: Case, labels: np.ndarray, own: _Layers, axis: int | None, edges: np.ndarray,
                     periodic: list[bool], unusual: tuple[str, ...]) -> ClearLayers | None:
    """The clear layers of an image, or None. Raises ParticleError where the image with them does not fit into the
    memory; labels: of the own layers; unusual: warnings on the size of its voxels, edges (dim,) m, a likely cause."""
    voxels, clear, added = math.prod(own.shape), 0, 0
    if axis is not None and not periodic[axis]:
        clear = _clear_voxels(case, labels, own.slabs, axis, edges, periodic)
        added = 2 * clear * (voxels // own.shape[axis])
    if added > voxels:
        what, fix = f"clear layers of {clear} voxels", "take a smaller geometry.voxels.clear_layer; it is in metres"
    else:
        what, fix = f"the wall distances of {voxels + added:,} voxels", memory.CROP
    memory.refuse(memory.of_this_machine((voxels + added) * memory.BYTES_VOXEL), what, fix)
    fluid = reduce.count(labels.ravel() >= 0)
    two = reduce.any_true(labels.ravel() > 0)
    try:
        memory.refuse_pores(case, own.dim, edges, (voxels + added, fluid + added), two=two)
    except ParticleError as error:  # voxels in another unit than the spacing make absurd numbers of particles
        thick = (f"most of them are in the clear layers of {clear} voxels: {fix}",) if added > voxels else ()
        raise ParticleError("; ".join((str(error), *thick, *unusual))) from None
    return ClearLayers(axis, clear) if axis is not None and clear > 0 else None


def _with_walls(case: Case, understood: Understood, own: _Layers, edges: np.ndarray, periodic: list[bool],
                layers: ClearLayers | None, walls: Walls) -> tuple[VoxelGeometry, SurfaceWays | None]:
    """The geometry whose walls are those of `geometry.wall_distance`, and what a smooth wall opens and closes."""
    from ..geometry.image_brick import ImageBrick, SmoothBrick
    from ..geometry.iso_surface import ImageField, IsoSurfaceGeometry
    from ..geometry.voxel_geometry import VoxelGeometry

    ways: SurfaceWays | None = None
    labels, field, alone = understood.labels, understood.field, own.slabs.ranks.size == 1
    shared = Shared(labels, own.slabs)
    if case.wall_distance == "stairs":
        geometry = (VoxelGeometry(labels, edges, periodic, layers, walls) if alone else
                    ImageBrick(shared, edges, periodic, layers, walls))
    else:
        smooth = ImageField(field) if field is not None else None
        geometry = surface = (IsoSurfaceGeometry(labels, smooth, edges, periodic, layers, walls) if alone else
                              SmoothBrick(shared, smooth, edges, periodic, layers, walls))
        ways = surface.ways()
    if understood.microporous is not None:
        geometry.fill_with(understood.microporous, layers)
    return geometry, ways


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


def _clear_voxels(case: Case, labels: np.ndarray, slabs: Slabs, axis: int, size: np.ndarray,
                  periodic: list[bool]) -> int:
    """Voxels of each clear layer: as asked, else what the flow needs, and no neighbours through the layers."""
    spec = case.geometry.voxels
    assert spec is not None
    if spec.clear_layer is not None:
        return max(round(spec.clear_layer / size[axis]), int(spec.clear_layer > 0))
    support = case.support * max(case.spacings)
    apart = math.ceil(support / size[axis] - 1e-6) if support < slabs.shape[2 - axis] * size[axis] else 1
    return max(clear_voxels(labels >= 0, axis, size, periodic, slabs), apart)


def _understood(case: Case, spec: Voxels, own: _Layers, periodic: list[bool]) -> Understood:
    """Of the own layers."""
    names, fluids = (*case.fluids, *case.microporous), len(case.fluids)
    if spec.grey is None:
        counts: dict[int, int] = {}
        for found in current().collect(histogram(own.values)):
            for value, count in found.items():
                counts[value] = counts.get(value, 0) + count
        labels = apply_labels(own.values, spec.labels, names, spec.file, dict(sorted(counts.items())))
        known = Understood(labels, None, _labels_in_words(spec.labels))
    else:
        known = _understood_grey(spec, spec.grey, own, names, None if case.wall_distance == "stairs" else periodic)
    if not case.microporous:
        return known
    filled = known.labels >= fluids  # rock is numbered behind the fluids; the first of them seeps through it
    return replace(known, labels=np.where(filled, np.int8(0), known.labels),
                   microporous=np.where(filled, known.labels - np.int8(fluids), np.int8(-1)))


def _understood_grey(spec: Voxels, grey: Grey, own: _Layers, names: tuple[str, ...],
                     periodic: list[bool] | None) -> Understood:
    """periodic: along x, y(, z), of the field whose zero is the wall; None of walls on the faces of voxels."""
    from ..geometry.grey import grey_classes, labels_of_grey, range_of

    values = own.values
    threshold = _threshold(grey, values)
    off = grey.uncertainty or 0.0
    low, high, share = grey_classes(values, threshold)
    least, most = range_of(values)
    if not least < threshold - off <= threshold + off < most:
        given = f"{threshold:g}" + (f" +- {off:g}" if off else "")
        raise VoxelError(f"{spec.file}: geometry.voxels.grey.threshold {given} parts nothing: the grey values "
                         f"lie between {least:g} and {most:g}; try otsu")
    found = (_GreyField(None, threshold, _how(grey)) if periodic is None else
             _field_of(spec, values, threshold, own.slabs, np.array([*periodic, True][:3])))
    labels = labels_of_grey(values, found.threshold, grey.solid, grey.fluids, names, spec.file)
    described = (
        ("wall", f"surface of grey value {found.threshold:g} ({found.how}); the means below and above {threshold:g} "
                 f"are {low:g} and {high:g}, {100 * share:.0f} % of the variance lies between them"),
        *([("sharpness", found.words)] if found.words else []),
    )  # fmt: skip
    two = reduce.count(((values == least) | (values == most)).ravel()) == reduce.number(values.ravel())
    warnings = (*found.warnings, *((
        f"{spec.file}: only two grey values, {least:g} and {most:g}: no scan, but an image that is segmented; take "
        "geometry.voxels.labels, whose walls and range of k are those of segmented images",) if two else ()))
    return Understood(labels, found.field, f"solid {grey.solid} {found.threshold:g}", described, off=found.off,
                      warnings=warnings)


@dataclass(frozen=True)
class _GreyField:
    """The field whose zero is the wall of a grey image.

    field: float32 of the shape of the image, > 0 in fluid, or None of walls on the faces of voxels; threshold: grey
    value of the wall; how: where that is from, in words; words: what was taken out of the image; blur: that as
    `geometry.voxels.grey.blur` says it; off: see `VoxelGeometry.off`; warnings: on the threshold.
    """

    field: np.ndarray | None
    threshold: float
    how: str
    words: str = ""
    blur: float = 0.0
    off: float | None = None
    warnings: tuple[str, ...] = ()


def _field_of(spec: Voxels, values: np.ndarray, threshold: float, slabs: Slabs, around: np.ndarray) -> _GreyField:
    """Of grey values [z, y, x] and a threshold, that of the case or Otsu's.

    Where the case asks for Otsu's, the wall of a scan is at the value half-way between its fluid and its solid: where
    there is more of the one than of the other, Otsu's is 1 to 15 % of the contrast off (docs/design_notes.md).
    """
    from ..geometry.grey import TWO_VALUED, WIDEST, field_of_grey, grey_classes, otsu_threshold
    from ..geometry.scan_fit import WIDTHS, apart, fit_scan
    from ..geometry.spline import average

    grey = spec.grey
    assert grey is not None
    low, high, share = grey_classes(values, threshold)
    field = average(field_of_grey(values, threshold, grey.solid), grey.denoise, around, slabs)
    how = _how(grey)
    if grey.blur == 0.0:
        return _GreyField(field, threshold, how, "taken as it is")
    if share < TWO_VALUED:  # a threshold may be given far from the one that parts an image best
        share = max(share, grey_classes(values, otsu_threshold(values))[2])
    if grey.blur is None and share < TWO_VALUED:
        # an average takes noise away and leaves a smooth field, whose share stays
        noisy = grey_classes(average(field, 1.0, around, slabs), 0.0)[2] >= TWO_VALUED
        return _GreyField(field, threshold, how, "it is not one of two grey values: taken as it is",
                          warnings=(_much_noise(spec, "so much noise that its two grey values"),) if noisy else ())
    centred = isinstance(grey.threshold, str) and not grey.fluids  # of two fluids there is no one value of fluid
    # the average against noise is a blur like that of the scanner, and is taken out with it
    known = math.hypot(grey.blur, grey.denoise) if isinstance(grey.blur, float) else None
    found = fit_scan(field, around, slabs, known, centred)
    blur, is_scan = math.sqrt(max(found.blur**2 - grey.denoise**2, 0.0)), found.is_scan and found.blur < WIDTHS[-1]
    scan = (f"the scan of a body with a blur of {blur:.2f} voxels but for {50 * found.misfit:.2g} % of the contrast at "
            "the walls")
    if isinstance(grey.blur, str) and (share < TWO_VALUED or not is_scan):
        raise VoxelError(f"{spec.file}: geometry.voxels.grey.blur: auto needs the scan of a body of one solid; this "
                         f"image is nearest to {scan}; give a number of voxels, or 0 to take it as it is")
    if grey.blur is None and not (is_scan and blur <= WIDEST):
        words, off = f"nearest to {scan}: taken as it is", None
        if is_scan:  # or a smooth field: nothing in the image tells which
            words += "; if it is that scan, say blur: auto"
        if found.blur < WIDTHS[-1]:
            off = found.off + AS_IT_IS * apart(field, found.field, slabs)
        return _GreyField(field, threshold, how, words, off=off)
    half_way = threshold + 0.5 * (high - low) * (-found.zero if grey.solid == "above" else found.zero)
    warnings: tuple[str, ...] = ()
    if centred:
        threshold, how = half_way, f"half-way between fluid and solid of the scan; Otsu {threshold:g}"
    elif not grey.fluids:
        how += f"; half-way between fluid and solid of the scan {half_way:g}"
        if abs(found.zero) > OFF_HALF_WAY:
            warnings = (f"geometry.voxels.grey.threshold {threshold:g} is {50 * abs(found.zero):.0f} % of the contrast "
                        f"from {half_way:g}, half-way between fluid and solid of the scan, where its wall is; the "
                        "range of k does not count that: take otsu, unless this value is known better",)
    noise = max(found.noise, found.pure)
    if noise > TURNS_VOXELS:
        warnings += (_much_noise(spec, f"noise of {50 * noise:.0f} % of the contrast or more: single voxels"),)
    words = f"{scan}; the blur and the average over a voxel are taken out"
    return _GreyField(found.field, threshold, how, words, max(blur, SOME), found.off, warnings)


def _much_noise(spec: Voxels, what: str) -> str:
    """The warning of noise that hides on which side of the threshold a voxel is; what: does."""
    return (f"{spec.file}: {what} are on either side of the threshold: k may be far too low, and its range does not "
            "count that; take geometry.voxels.grey.denoise: 1")


def _how(grey: Grey) -> str:
    return "Otsu" if isinstance(grey.threshold, str) else "given"


def settled(case: Case) -> Grey:
    """`geometry.voxels.grey` of a case with the threshold and the blur that `image_geometry` takes."""
    spec = case.geometry.voxels
    assert spec is not None and spec.grey is not None
    own = _layers_of(case, spec)
    values, threshold = own.values, _threshold(spec.grey, own.values)
    around = np.array([*("xyz"[a] in case.geometry.repeats for a in range(own.dim)), True][:3])
    found = _field_of(spec, values, threshold, own.slabs, around)
    return replace(spec.grey, threshold=found.threshold, blur=found.blur)


def _threshold(grey: Grey, values: np.ndarray) -> float:
    from ..geometry.grey import otsu_threshold

    return otsu_threshold(values) if isinstance(grey.threshold, str) else grey.threshold


# What the walls of an image that is taken as it is and those of the body that was found are apart counts so often in
# `off`: of scans with a blur of 0 to 1.5 voxels nine in ten then are in the range of k (docs/design_notes.md), and of
# bodies half of whose solid is 2.5 times as bright
AS_IT_IS = 1.5
# half contrasts: a threshold that is given farther from half-way has a warning: of four per cent of the contrast k of
# cases/grey_blobs.yaml is a fifth off
OFF_HALF_WAY = 0.1
# half contrasts: of more noise there is a warning. With a blur of half a voxel, three bodies: of 0.21 at most (noise of
# 10 %) k is 3 to 4 % low, within its range, of 0.24 (12 %) 9 to 13 % and of 0.32 (20 %) 74 to 83 %, mostly outside
# (docs/limits.md)
TURNS_VOXELS = 0.22
SOME = 1e-3  # voxels of blur, least of a scan: with 0 nothing is taken out
SI_DENSITY = (300.0, 20_000.0)  # kg/m3 of liquids: a case that has one counts in SI units and not in its own
SI_VISCOSITY = (5e-6, 5e-5)  # Pa s of gases
MOST_POROUS = 0.6  # above it hardly any rock is found
LONG = 8  # voxels: shorter edges may be pore by chance, all four of an image of half pores in one of 2^32


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
        return _Porosity(1.0 - _share(solid), {}, understood.words)
    shares = {name: _share(filled == k) for k, name in enumerate(rocks)}
    return _Porosity(1.0 - _share(solid | (filled >= 0)), shares, understood.words)


def _share(mask: np.ndarray) -> float:
    """Of all voxels, for which a mask of the own layers is true."""
    return float(reduce.mean(mask.ravel()))


def _unusual_porosity(porosity: _Porosity) -> tuple[str, ...]:
    if not MOST_POROUS < porosity.pores < 1.0:
        return ()
    solid = 1.0 - porosity.pores - sum(porosity.rocks.values())
    return (
        f"porosity {100 * porosity.pores:.1f} %: more than rock has; check which values are solid ("
        f"{porosity.words}; the other way round it is {100 * solid:.1f} %)",
    )


def _open_edges(labels: np.ndarray, periodic: list[bool]) -> tuple[str, ...]:
    """A warning where the four edges of an image [z, y, x] along z, the axis of most scans, are pore all along, and
    nothing repeats beyond them: in rock as long as LONG voxels no edge is."""
    if labels.ndim < 3 or any(periodic[:2]):
        return ()
    edges = labels[:, [0, 0, -1, -1], [0, -1, 0, -1]].ravel() >= 0
    if reduce.number(edges) < 4 * LONG or reduce.count(edges) < reduce.number(edges):
        return ()
    return ("the four edges of the image along z are pore from end to end, as the air or the mask around a round core "
            "is; it counts as pore, and water flows through it. If so take a part inside the core: "
            "geometry.voxels.crop",)


def _labels_in_words(labels: Mapping[str, tuple[int, ...]]) -> str:
    """'solid 1, water 0'."""
    return ", ".join(f"{name} {' '.join(str(v) for v in values)}" for name, values in labels.items())


def _product(numbers: Any) -> str:
    """'20 x 20 x 10', of lengths one number where they are equal."""
    words = [f"{n:.6g}" if isinstance(n, float) else str(n) for n in numbers]
    return words[0] if isinstance(numbers, np.ndarray) and len(set(words)) == 1 else " x ".join(words)
