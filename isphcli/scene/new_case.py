"""`isph init`: a commented case to begin with, of an image, a list of spheres, or a drop in a throat."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

PER_RADIUS = 4.0  # spacings per radius of the spheres: eight particles across each of them
NEAR = 1.15  # largest factor between that spacing and one that divides the box: at most 1.5 times as many particles
WHOLE = 1e-4  # relative stretch of a lattice that counts as none; a list of spheres has few digits
GUESSED_SIZE = 5.0e-6  # m, where the image has none and none was given


class NewCaseError(ValueError):
    """A file that no case can be written for."""


@dataclass(frozen=True)
class NewCase:
    """text: of the case; notes: what was assumed and has to be looked at, sentences."""

    text: str
    notes: tuple[str, ...] = ()


def is_list_of_spheres(file: Path) -> bool:
    """Whether a file is taken for a table or a dump of spheres: text that is not of a format of images."""
    from ..geometry.images.read import FORMATS

    if file.suffix.lower() in FORMATS or not file.is_file():
        return file.suffix.lower() in (".csv", ".txt")
    with open(file, "rb") as stream:
        head = stream.read(4096)
    try:
        head[: head.rfind(b"\n") + 1 or len(head)].decode("utf-8-sig")
    except UnicodeDecodeError:
        return False
    return b"\0" not in head


def case_for_image(file: Path, folder: Path, voxel_size: float | Sequence[float] | None = None) -> NewCase:
    """A steady permeability of an image: labels where it has few values, else a grey image with Otsu's threshold.

    folder: of the case, which the path of the image starts from; voxel_size: m. Raises VoxelError.
    """
    from ..geometry.images.read import read_image
    from ..geometry.images.voxel_size import known_spacing
    from ..geometry.labels import FEW, guess_labels

    image = read_image(file, grey=True)
    values = image.values
    notes: list[str] = []
    known = known_spacing(image)
    sizes = np.ravel(known if voxel_size is None and known is not None else GUESSED_SIZE if voxel_size is None
                     else voxel_size)
    unsure = voxel_size is None and known is None
    if unsure:
        notes.append(f"the image has no voxel size: {GUESSED_SIZE:g} m stands in the case; correct it there")
    size = f"{sizes[0]:g}" if np.all(sizes == sizes[0]) else f"[{', '.join(f'{s:g}' for s in sizes)}]"
    shape = " x ".join(map(str, values.shape[::-1]))
    axes = ", ".join("xyz"[: values.ndim])
    whole = values.dtype.kind in "iub"
    guess = guess_labels(values)
    if guess is not None:
        solid, pores = guess.solid, guess.pores
        shares = ", ".join(f"{label} {100 * count / values.size:.1f} %" for label, count in guess.shares.items())
        water = pores[0] if len(pores) == 1 else pores
        meaning = f"    labels: {{solid: {solid}, water: {water}}}   # CHECK which is solid: of the voxels {shares}\n"
        notes.append(f"{solid} is taken as solid, {', '.join(map(str, pores))} as pores ({shares}): check it")
        if not pores:
            raise NewCaseError(f"{file}: every voxel has the value {solid}: nothing can flow")
    else:
        meaning = "    grey: {threshold: otsu, solid: above}   # CHECK: bright is solid; isph run says the threshold\n"
        notes.append(f"the image has {'more than ' + str(FEW) if whole else 'real'} values and is taken as grey, "
                     "bright as solid: check it")
    spacing = float(sizes.min())
    text = (
        f"# Permeability of {file.name}, {shape} voxels along x, y(, z). Units: SI. `isph keys` explains every key.\n"
        f"title: Permeability of {file.stem}\n"
        "geometry:\n"
        "  voxels:\n"
        f"    file: {_quoted(_relative(file, folder))}\n"
        f"{meaning}"
        f"    voxel_size: {size}   # m, edge of a voxel{': NOT KNOWN, correct it' if unsure else ''}\n"
        "    # crop: [[0, 100], [0, 100], [0, 100]]   # voxels kept along x, y, z, for a quick first run\n"
        "  # mirror: [x, y, z]   # the image and its mirror image repeat: no sealed sides, more particles\n"
        f"particles: {{spacing: {spacing:g}}}   # m: one particle per voxel\n"
        "fluids: {water: {density: 1000, viscosity: 1.0e-3}}   # kg/m3, Pa s\n"
        "flow: stokes   # steady creeping flow; navier_stokes: moving particles, in time\n"
        f"drive: {{axes: [x]}}   # of {axes}: several give a permeability each\n"
        "# refine: auto   # two more spacings as memory and time allow: gives the permeability its error bar\n"
        "# measure: [formation_factor]\n"
        "# output: {grid: auto}   # VTI beside the particles, for streamlines in ParaView\n")
    return NewCase(text, tuple(notes))


def case_for_spheres(file: Path, folder: Path, radius: float | None = None) -> NewCase:
    """A steady permeability of the spheres of a table or dump, periodic along all axes. The box is that of a dump
    along the axes that it repeats along, else what the spheres fill.

    radius: m, of a file without such a column. Raises ShapeError.
    """
    from .sphere_files import box_of_dump, spheres_of_file

    found = spheres_of_file(file, 3, radius)
    radii = np.ravel(np.asarray(found.radii, float))
    lower, upper = (found.centres - radii[:, None]).min(axis=0), (found.centres + radii[:, None]).max(axis=0)
    if (given := box_of_dump(file)) is not None:
        lower, upper = np.where(given[2], given[:2], (lower, upper))
    of_spheres = [a for k, a in enumerate("xyz") if given is None or not given[2][k]]
    whose = _whose(of_spheres)
    size = upper - lower
    share = float((4 / 3 * np.pi * np.broadcast_to(radii, len(found.centres)) ** 3).sum() / np.prod(size))
    median = float(np.median(radii))
    spacing = _spacing_that_divides(size, median / PER_RADIUS)
    of_all = f", radius: {radius:g}" if radius is not None else ""
    sphere = f"{{file: {_quoted(_relative(file, folder))}{of_all}}}"
    text = (
        f"# Permeability of the {len(found.centres)} spheres of {file.name}. Units: SI.\n"
        "# `isph keys` explains every key.\n"
        f"title: Permeability of {file.stem}\n"
        "geometry:\n"
        f"  box: {_list(size)}      # m: {''.join(whose)}\n"
        f"  origin: {_list(lower)}   # m, lower corner\n"
        "  periodic: [x, y, z]   # along the others the faces are walls\n"
        "  shapes:\n"
        f"    - {{spheres: {sphere}, is: solid}}\n"
        f"particles: {{spacing: {spacing:g}}}   # m: {median / spacing:.2g} a radius\n"
        "fluids: {water: {density: 1000, viscosity: 1.0e-3}}   # kg/m3, Pa s\n"
        "flow: stokes   # steady creeping flow\n"
        "drive: {axes: [z]}   # several axes give a permeability each\n"
        "# refine: auto   # two more spacings: gives the permeability its error bar\n"
        "# output: {grid: auto}   # VTI beside the particles, for streamlines in ParaView\n")
    solid = f"{100 * share:.0f} % of it solid if none overlap"
    note = f"the box is {whose[0]}, {solid}; it repeats along x, y, z{': check both' if of_spheres else ''}"
    metres = "" if given is None else "; lengths are taken as metres: scale is the key of other units"
    return NewCase(text, (note + metres,))


def _whose(of_spheres: list[str]) -> tuple[str, str]:
    """Where the box comes from, in words, and what to look at; of_spheres: the axes along which no dump gave it."""
    if not of_spheres:
        return "that of the dump", ""
    filled = "what the spheres fill"
    where = filled if len(of_spheres) == 3 else f"that of the dump, along {', '.join(of_spheres)} {filled}"
    return where, "; CHECK, of a periodic pack its periods"


def _spacing_that_divides(box: np.ndarray, about: float) -> float:
    """The spacing next to `about`, m, that all edges of the box (dim,) are whole multiples of, so that the lattice of a
    periodic box is not stretched; where there is none near, that whose lattice is stretched least, to three digits."""
    shortest = float(box.min())
    fewest, most = math.ceil(shortest / (about * NEAR)), math.floor(shortest / about * NEAR)
    for n in sorted(range(max(fewest, 1), most + 1), key=lambda n: abs(shortest / n - about)):
        spacing = float(f"{shortest / n:.6g}")  # as the case has it
        whole = np.round(box / spacing)
        if np.all(np.abs(box - whole * spacing) <= WHOLE * box):
            return spacing
    near = [float(f"{about * factor:.3g}") for factor in np.linspace(1 / NEAR, NEAR, 101)]
    return min(near, key=lambda spacing: float(np.abs(box / (np.round(box / spacing) * spacing) - 1.0).max()))


def case_for_drop() -> NewCase:
    """Oil pushed through a throat between two disks, 2D: a first case of two fluids."""
    return NewCase(
        "# A drop of oil in the throat between two grains, driven by a pressure drop, 2D. Units: SI.\n"
        "# `isph keys` explains every key.\n"
        "title: Drop in a throat\n"
        "geometry:\n"
        "  box: [4.0e-4, 2.0e-4]          # m\n"
        "  periodic: [x]                  # walls below and above\n"
        "  fluid: water                   # fills the box before the shapes, later ones on top of earlier ones\n"
        "  shapes:\n"
        "    - {sphere: {centre: [8.0e-5, 1.0e-4], radius: 6.0e-5}, is: oil}\n"
        "    - {sphere: {centre: [2.4e-4, 0], radius: 6.0e-5}, is: solid}\n"
        "    - {sphere: {centre: [2.4e-4, 2.0e-4], radius: 6.0e-5}, is: solid}\n"
        "particles: {spacing: 8.0e-6}     # m: ten across the throat of 8e-5 m\n"
        "fluids:                          # the contact angle is measured through the first one\n"
        "  oil: {density: 850, viscosity: 5.0e-3}      # kg/m3, Pa s\n"
        "  water: {density: 1000, viscosity: 1.0e-3}\n"
        "interface: {tension: 0.03, contact_angle: 120}   # N/m, degrees\n"
        "drive: {pressure_drop: {x: 200}}  # Pa over the box\n"
        "time: {end: 2.0e-3}              # s\n"
        "output: {every: 2.0e-4}          # s between snapshots\n")


def _relative(file: Path, folder: Path) -> str:
    """The path as a case in `folder` names it, absolute where there is no way between them (drives of Windows)."""
    try:
        return Path(os.path.relpath(file.absolute(), folder.absolute())).as_posix()
    except ValueError:
        return file.absolute().as_posix()


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _list(values: np.ndarray) -> str:
    return f"[{', '.join(f'{v:.6g}' for v in values)}]"
