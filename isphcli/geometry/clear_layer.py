"""Layers of clear fluid between the two end faces of an image: their least thickness, and their resistance.

The flow comes out of the pores of one end face, spreads over the cross section, and gathers at the pores of the other.
With the velocities through both faces given, creeping flow between them has a formula for each wave of the cross
section: its pressure drop, and the drop if the faces were far apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage
from scipy.fft import dctn, fftn

from ..domain.slabs import Slabs
from .connectivity import percolating
from .labels import unlike_next
from .modes import frequencies, sum_of_squares

SHARE = 0.01  # of the pressure drop over the sample: how much the nearness of its two faces may change, by estimate
FAR = 300.0  # largest wave number times distance: hyperbolic functions of twice as much do not overflow
KOZENY = 5.0  # k = porosity^3 / (KOZENY surface^2), surface in a volume of the whole (Carman 1937, packed beds)


def clear_voxels(fluid: np.ndarray, axis: int, edges: np.ndarray, periodic: Sequence[bool],
                 slabs: Slabs | None = None) -> int:
    """Voxels of clear fluid that an image needs at either end of an axis: beyond them k changes by SHARE at most.

    fluid: bool [z, y, x] or [y, x]; edges: of a voxel (dim,), m, and periodic: (dim,), along x, y(, z); slabs: how the
    processes share the fluid, of which each has its layers [z, y, x]; without it one process has all.
    The velocity through the percolating pores is taken to grow with the square of the distance to their walls, and the
    pressure drop to be that of Kozeny and Carman for these pores, layer by layer in series. 0 where none percolate.
    """
    dim = len(periodic)
    fluid = fluid.reshape(-1, *fluid.shape[-2:])
    slabs = slabs or Slabs.whole(fluid.shape)
    around = [bool(p) and a != axis for a, p in enumerate(periodic)]
    through = percolating(fluid, tuple(around), axis, slabs)
    if not slabs.ranks.max(int(through.any())):
        return 0
    length = slabs.shape[2 - axis] * edges[axis]
    allowed = SHARE * length / _kozeny_carman(through, axis, edges, slabs)
    others = [a for a in reversed(range(dim)) if a != axis]  # in the order of the axes of an array
    sides, repeat = [float(edges[a]) for a in others], [around[a] for a in others]
    first, last = (_through_a_face(_layer(through, end, axis, slabs).reshape([slabs.shape[2 - a] for a in others]),
                                   sides, repeat) for end in (0, slabs.shape[2 - axis] - 1))
    widest = max(int(np.ceil(slabs.shape[2 - a] * edges[a] / edges[axis])) for a in others)
    low, high = 0, widest  # faces as far apart as twice their width are far apart
    while high - low > 1:
        middle = (low + high) // 2
        near = nearness(first, last, sides, repeat, 2 * middle * float(edges[axis])) > allowed
        low, high = (middle, high) if near else (low, middle)
    return high


def _layer(fluid: np.ndarray, at: int, axis: int, slabs: Slabs) -> np.ndarray:
    """One of the layers across an axis, of all processes, on each."""
    first, end = [0, 0, 0], list(slabs.shape)
    first[2 - axis], end[2 - axis] = at, at + 1
    return slabs.box(fluid, first, end)


def _kozeny_carman(fluid: np.ndarray, axis: int, edges: np.ndarray, slabs: Slabs) -> float:
    """Estimate of the permeability of a mask of fluid [z, y, x] along an axis, m2: that of its layers of voxels in
    series. A layer without walls has that of a slit as wide as the image.
    """
    dim, along = len(edges), 2 - axis
    rest, cells = tuple(a for a in range(3) if a != along), np.prod(slabs.shape) / slabs.shape[along]
    layers = slabs.beside(fluid, 0, 1, False)[0] if slabs.ranks.size > 1 else fluid

    def in_layers(counts: np.ndarray) -> np.ndarray:
        """Counts of the own layers as those of the whole axis."""
        if along:
            return slabs.ranks.sum(counts)
        whole = np.zeros(slabs.shape[0], counts.dtype)
        whole[slabs.own[0] : slabs.own[0] + len(counts)] = counts
        return slabs.ranks.sum(whole)

    surface = np.zeros(slabs.shape[along])
    for a, edge in enumerate(edges):
        of = layers if a == 2 else fluid  # along z each process counts the faces to the layer above its own ones
        faces = in_layers(np.count_nonzero(unlike_next(of, 2 - a, False), axis=rest)) / edge
        if a == axis and along:
            surface += (np.append(faces, 0) + np.append(0, faces)) / 2
        elif a == axis:
            surface += (faces + np.append(0, faces[:-1])) / 2
        else:
            surface += faces
    surface *= (2 / 3 if dim == 3 else np.pi / 4) / cells  # of smooth walls in all directions: voxels have more
    porosity = in_layers(np.count_nonzero(fluid, axis=rest)) / cells
    resistance = KOZENY * surface**2 / porosity**3 + 12 / (max(slabs.shape) * float(edges.max())) ** 2
    return float(1 / resistance.mean())


def _through_a_face(fluid: np.ndarray, edges: Sequence[float], periodic: Sequence[bool]) -> np.ndarray:
    """Velocity through the pores of a face over its mean, as between walls: by the square of the distance to them."""
    widths = [(n, n) if around else (1, 1) for n, around in zip(fluid.shape, periodic)]
    for axis, (width, around) in enumerate(zip(widths, periodic)):
        each = [width if a == axis else (0, 0) for a in range(fluid.ndim)]
        fluid = np.pad(fluid, each, mode="wrap") if around else np.pad(fluid, each)
    distance = ndimage.distance_transform_edt(fluid, edges)
    square = distance[tuple(slice(before, -after) for before, after in widths)] ** 2
    return square / square.mean()


def nearness(first: np.ndarray, last: np.ndarray, edges: Sequence[float], periodic: Sequence[bool],
             thickness: float) -> float:
    """Difference between the pressure drop between two near faces and that between faces far apart, over mu U, 1/m.
    What nearness saves and what it costs are added, not balanced.

    first, last: velocities through the two faces (any shape of one or two axes), over their mean U; edges: of their
    cells, m, and periodic: per axis of the arrays; sides that are not periodic let the fluid slip. thickness: m,
    between the faces, at which the fluid does not move sideways.

    Creeping flow between planes z = -h/2 and h/2 through which the velocity is W cos(k y): w = A cosh kz + B kz sinh kz
    for equal velocities on both, A sinh kz + B kz cosh kz for opposite ones, with w' = 0 at the planes; t = k h / 2.
    The power that the flow takes is 4 mu k W^2 times sinh^2 t / (sinh t cosh t + t), or cosh^2 t / (sinh t cosh t
    - t): 1 far apart, and 3 / (2 t^3), Hele-Shaw's flow, for fluid that has to move sideways between near planes.
    """
    k, even = _waves((first + last) / 2, edges, periodic)
    odd = _waves((first - last) / 2, edges, periodic)[1]
    t = np.minimum(k * thickness / 2, FAR)
    sinh, cosh = np.sinh(t), np.cosh(t)
    straight = 1.0 - sinh**2 / (sinh * cosh + t)  # flow straight from pore to pore between near faces does not spread
    return float(np.sum(4.0 * k * (straight * even + (cosh**2 / _sinh_cosh_less_t(t) - 1.0) * odd)))


def _sinh_cosh_less_t(t: np.ndarray) -> np.ndarray:
    """sinh t cosh t - t without the loss of digits where t is small."""
    series = t**3 * (2 / 3 + t**2 * (2 / 15 + t**2 * 4 / 315))  # to 1e-9 at 0.1
    return np.where(t < 0.1, series, np.sinh(t) * np.cosh(t) - t)


def _waves(velocity: np.ndarray, edges: Sequence[float], periodic: Sequence[bool]) -> tuple[np.ndarray, np.ndarray]:
    """(wave numbers (m,), 1/m, mean square (m,) of each wave of a velocity), without the mean."""
    found = np.asarray(velocity, dtype=complex)
    for axis, around in enumerate(periodic):
        if around:
            found = fftn(found, axes=[axis], norm="forward")
        else:
            real, imaginary = (dctn(part, axes=[axis], norm="ortho") for part in (found.real, found.imag))
            found = (real + 1j * imaginary) / np.sqrt(found.shape[axis])
    k = [2 * np.pi / edge * frequencies(n, around) for n, edge, around in zip(found.shape, edges, periodic)]
    return np.sqrt(sum_of_squares(k)).ravel()[1:], (np.abs(found) ** 2).ravel()[1:]
