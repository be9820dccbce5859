"""A picture of three slices through the middle of a labelled image."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from .plots import PHASES, SOLID, new_figure, save_figure

MOST_COLOURS = 8  # labels with a colour of their own; others are drawn as grey values
MORE = ("#edae49", "#8d6b94", "#d1495b", "#3c3c3c", "#20608c", "#66a182")  # of further values that are not solid


def plot_slices(
    path: str | os.PathLike, values: np.ndarray, solids: Sequence[int], spacing: Sequence[float] | None, title: str = ""
) -> None:
    """Draw the middle slices across z, y and x of labels [z, y, x], or the one of [y, x]: solids grey, pores coloured.

    spacing: edges of a voxel x, y(, z), m, or None; axes are then in voxels.
    """
    cuts = [0, 1, 2] if values.ndim == 3 else []
    shown = [np.take(values, values.shape[cut] // 2, axis=cut) for cut in cuts] or [values]
    plot_cuts(path, shown, values.shape, solids, spacing, title)


def plot_cuts(
    path: str | os.PathLike, shown: Sequence[np.ndarray], shape: Sequence[int], solids: Sequence[int],
    spacing: Sequence[float] | None, title: str = "",
) -> None:  # fmt: skip
    """`plot_slices` of the middle slices themselves; shape: of the image [z, y, x], or [y, x]."""
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Patch

    edges = np.asarray(spacing if spacing is not None else np.ones(len(shape)))
    scale, unit = (1.0, "voxels") if spacing is None else _unit(edges * tuple(shape)[::-1])
    cuts = [0, 1, 2] if len(shape) == 3 else [None]
    figure, panels = new_figure(4.2 * len(cuts), 4.4, 1, len(cuts))
    found = sorted({int(v) for one in shown for v in np.unique(one)})
    few = len(found) <= MOST_COLOURS
    pores = iter((*PHASES[::-1], *MORE))
    colours = [SOLID if v in solids else next(pores) for v in found] if few else []
    for axes, one, cut in zip(np.ravel(panels), shown, cuts):
        across = [a for a in (0, 1, 2) if a != (2 - cut if cut is not None else 2)]  # axes x, y, z of the panel
        width, height = (one.shape[1 - k] * edges[a] * scale for k, a in enumerate(across))
        look = (
            {
                "cmap": ListedColormap(colours),
                "norm": BoundaryNorm([v - 0.5 for v in [*found, found[-1] + 1]], len(found)),
            }
            if few
            else {"cmap": "gray"}
        )
        axes.imshow(one, origin="lower", extent=(0, width, 0, height), interpolation="nearest", **look)
        axes.set_xlabel(f"{'xyz'[across[0]]}, {unit}")
        axes.set_ylabel(f"{'xyz'[across[1]]}, {unit}")
        if cut is not None:
            axes.set_title(f"{'zyx'[cut]} = {shape[cut] // 2} of {shape[cut]} voxels", fontsize=9)
    if few:
        figure.legend(
            handles=[Patch(color=c, label=f"{v} {'solid' if v in solids else 'pore'}") for v, c in zip(found, colours)],
            loc="outside lower center",
            ncol=len(found),
            frameon=False,
        )
    if title:
        figure.suptitle(title, fontsize=10)
    save_figure(figure, path)


def _unit(lengths: np.ndarray) -> tuple[float, str]:
    """Factor and name of the unit in which lengths in m are numbers of a few digits."""
    longest = float(np.max(lengths))
    for factor, name in ((1e9, "nm"), (1e6, "um"), (1e3, "mm")):
        if longest * factor < 1e4:
            return factor, name
    return 1.0, "m"
