"""Sizes of pores: how the pore volume is shared among the largest balls that fit into it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

MOST_CELLS = 300_000  # most cells of the mask, to bound the time: of a larger one every second cell or fewer
STEPS = 24  # number of diameters of the balls
# Particles across a pore from which on a steady flow in it is resolved; at 4: +7.6 % of k (`isph run
# cases/square_duct.yaml --set particles.spacing=2e-5`, 2026-11-29; docs/method.md 8)
ENOUGH_ACROSS = 4


def pore_sizes(fluid: np.ndarray, cell: Sequence[float] | np.ndarray,
               periodic: Sequence[bool]) -> tuple[np.ndarray, np.ndarray] | None:
    """(edges (m + 1,) of the diameters, m, share (m,) of the pore volume) of a mask of the fluid; None without fluid or
    without solid.

    fluid: bool [z, y, x] or [y, x]; cell: edges of a cell x, y(, z), m; periodic: per axis x, y(, z). The size at a
    point is the diameter of the largest ball in the pores that holds it (local thickness: Hildebrand and Rüegsegger
    1997, J. Microsc. 185, 67): an opening by balls, a distance transform for each diameter. Walls are the faces of
    cells: a slit of an odd number of cells has its width, of an even number a cell less, as no ball has its centre
    between cells.
    """
    fluid, edges = np.asarray(fluid, bool), np.asarray(cell, float)
    if fluid.all() or not fluid.any():
        return None
    step = max(1, round((fluid.size / MOST_CELLS) ** (1.0 / fluid.ndim)))
    fluid, edges = fluid[(slice(None, None, step),) * fluid.ndim], edges * step
    if fluid.all() or not fluid.any():
        return None
    # pores go on behind a periodic face; behind other faces the cells at the face are repeated
    wide = [min(n, max(2, n // 3)) for n in fluid.shape]
    for axis, (width, again) in enumerate(zip(wide, periodic[::-1])):
        pad = [(width, width) if a == axis else (0, 0) for a in range(fluid.ndim)]
        fluid = np.pad(fluid, pad, mode="wrap" if again else "edge")
    middle = tuple(slice(w, -w) for w in wide)
    sampling = edges[::-1]
    half = 0.5 * float(edges.min())
    depth = ndimage.distance_transform_edt(fluid, sampling=sampling) - half
    top, fluid = float(depth[middle].max()), fluid[middle]
    # the centre of a ball that reaches inside is no farther outside than the largest radius
    beside = [min(w, int(np.ceil(top / edge)) + 1) for w, edge in zip(wide, sampling)]
    depth = depth[tuple(slice(w - b, b - w or None) for w, b in zip(wide, beside))]
    middle = tuple(slice(b, -b) for b in beside)
    size = np.zeros(fluid.shape)
    for radius in np.linspace(0.0, top, STEPS, endpoint=False)[1:]:
        reached = ndimage.distance_transform_edt(depth < radius, sampling=sampling)[middle] < radius
        size[reached & fluid] = radius
    bins = np.linspace(0.0, top, STEPS + 1)
    found = np.histogram(size[fluid], bins=np.append(bins[:-1], np.inf))[0]
    return 2.0 * bins, found / found.sum()
