"""Panels on a run beside the pictures of its flow: profiles along the axis, sizes of pores and speeds, and, separately,
numerical quantities: k against spacing, convergence of the solver, spread of the flux.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.pore_sizes import ENOUGH_ACROSS
from .plots import COLOURS, INK, new_figure, prefix, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPEEDS = 60  # bins of speeds at most
MOST_SPEEDS = 0.999  # share of the fluid up to which speeds are drawn


@dataclass(frozen=True)
class Numerics:
    """The numerical quantities of a steady case.

    residuals: {label: [(iteration, relative residual)]} of each solve; tolerance: asked of them; by_spacing: {axis:
    {spacing, m: k, m2}}; value, bar: {axis: m2} of the result; profile: rows of `flow_measures.profile_rows`; mass:
    standard deviation over the mean of the flux along the axis.
    """

    residuals: Mapping[str, Sequence[tuple[int, float]]]
    tolerance: float
    by_spacing: Mapping[str, Mapping[float, float]] = field(default_factory=dict)
    value: Mapping[str, float] = field(default_factory=dict)
    bar: Mapping[str, float] = field(default_factory=dict)
    profile: Sequence[Mapping[str, Any]] = ()
    mass: float = 0.0


def plot_flow_profile(path: str | os.PathLike, rows: Sequence[Mapping[str, Any]], mass: float,
                      title: str = "") -> None:
    """Draw pressure and superficial velocity of the layers across the axis of a flow.

    rows: of profiles.csv, with one of x, y, z, `pressure` and `superficial_velocity`; mass: spread of the latter, zero
    for incompressible flow.
    """
    if not rows:
        raise ValueError(f"{path}: there is no profile")
    figure, ((left, right),) = new_figure(10.4, 3.6, 1, 2)
    where, x, unit = _places(rows)
    pressure, flux = _column(rows, "pressure"), _column(rows, "superficial_velocity")
    _plain_line(left, x, pressure, "pressure (Pa)")
    factor, flux_unit = prefix("m/s", float(np.nanmax(np.abs(flux))))
    _plain_line(right, x, factor * flux, f"superficial velocity ({flux_unit})")
    mean = factor * float(np.nanmean(flux))
    right.axhline(mean, color=COLOURS[1], lw=1.0, ls="--", label=f"mean; spread of the layers {mass:.1e} of it")
    reach = max(1.2 * float(np.nanmax(np.abs(factor * flux - mean))), 0.05 * abs(mean))
    right.set_ylim(mean - reach, mean + reach)
    right.legend(frameon=False, fontsize=8, loc="upper right")
    for axes in (left, right):
        axes.set_xlabel(f"{where}  ({unit})")
    _titled(figure, title)
    save_figure(figure, path)


def plot_distributions(path: str | os.PathLike, velocity: np.ndarray, spacing: float,
                       pores: tuple[np.ndarray, np.ndarray] | None, title: str = "") -> None:
    """Draw how the volume of the pores is shared among their sizes, with what the spacing resolves, and the speeds.

    velocity: (n, dim) m/s, of equal volumes; spacing: m, of the particles; pores: (edges (m + 1,) of the diameters, m,
    share (m,) of the pore volume), or None without walls.
    """
    figure, ((*panels,),) = new_figure(10.4 if pores else 5.4, 3.8, 1, 2 if pores else 1)
    if pores is not None:
        _draw_pores(panels[0], *pores, spacing)
    axes, speed = panels[-1], np.linalg.norm(velocity, axis=1)
    top = float(np.quantile(speed, MOST_SPEEDS)) or 1.0
    factor, unit = prefix("m/s", top)
    bins = int(np.clip(np.sqrt(len(speed)), 8, SPEEDS))
    share, edges = np.histogram(factor * speed, bins=bins, range=(0.0, factor * top))
    axes.stairs(share / len(speed), edges, color=COLOURS[0], fill=True, alpha=0.75)
    axes.set_yscale("log" if share.max() > 20 * max(np.median(share), 1) else "linear")
    for value, name, colour in ((speed.mean(), "mean", COLOURS[1]), (np.median(speed), "median", INK)):
        axes.axvline(factor * value, color=colour, lw=1.2, ls="--", label=f"{name} {factor * value:.3g} {unit}")
    axes.set_xlabel(f"speed ({unit}), up to that of {100 * MOST_SPEEDS:g} % of the fluid")
    axes.set_ylabel("share of the fluid")
    axes.legend(frameon=False, fontsize=8)
    _titled(figure, title)
    save_figure(figure, path)


def _draw_pores(axes: Axes, edges: np.ndarray, share: np.ndarray, spacing: float) -> None:
    factor, unit = prefix("m", float(edges[-1]))
    middle = 0.5 * (edges[1:] + edges[:-1])
    axes.stairs(share, factor * edges, color=COLOURS[2], fill=True, alpha=0.75)
    fine = float(share[middle < ENOUGH_ACROSS * spacing].sum())
    axes.axvspan(0.0, factor * ENOUGH_ACROSS * spacing, color=COLOURS[1], alpha=0.12, lw=0,
                 label=f"balls of less than {ENOUGH_ACROSS} particles: {100 * fine:.0f} %")
    axes.axvline(factor * spacing, color=COLOURS[1], lw=1.2, ls="--", label="one particle")
    axes.set_xlim(0.0, factor * max(float(edges[-1]), 1.2 * ENOUGH_ACROSS * spacing))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(f"diameter of the pores ({unit})")
    axes.set_ylabel("share of the pore volume")
    axes.legend(frameon=False, fontsize=8)


def plot_steady_numerics(path: str | os.PathLike, found: Numerics, title: str = "") -> None:
    """Draw the convergence of the solver, k against spacing where there are several, and how the flux of the layers is
    spread about its mean."""
    refined = any(len(known) > 1 for known in found.by_spacing.values())
    panels = 1 + refined + bool(found.profile)
    figure, (grid,) = new_figure(5.2 * panels, 3.8, 1, panels)
    _draw_convergence(grid[0], found)
    if refined:
        _draw_spacings(grid[1], found)
    if found.profile:
        where, x, unit = _places(found.profile)
        flux = _column(found.profile, "superficial_velocity")
        off = flux / np.nanmean(flux) - 1.0
        _plain_line(grid[-1], x, 100.0 * off, "flux of a layer off the mean (%)")
        grid[-1].axhline(0.0, color=INK, lw=0.8)
        reach = max(1.2 * 100.0 * float(np.nanmax(np.abs(off))), 1e-3)
        grid[-1].set_ylim(-reach, reach)
        grid[-1].set_xlabel(f"{where}  ({unit})")
        grid[-1].set_title(f"mass error {found.mass:.1e} (standard deviation)", fontsize=9, color=INK)
    _titled(figure, title)
    save_figure(figure, path)


def _draw_convergence(axes: Axes, found: Numerics) -> None:
    for (label, steps), colour in zip(found.residuals.items(), COLOURS * 9):
        if steps:
            number, residual = np.array(steps, float).T
            marker = "o" if len(number) < 12 else None
            axes.plot(number, residual, color=colour, lw=1.4, marker=marker, ms=3, label=label)
    axes.axhline(found.tolerance, color=INK, lw=0.8, ls="--", label="tolerance")
    axes.set_yscale("log")
    axes.set_xlabel("GMRES iteration")
    axes.set_ylabel("residual over the right-hand side")
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.legend(frameon=False, fontsize=8)


def _draw_spacings(axes: Axes, found: Numerics) -> None:
    """k at every spacing, and the result with its bar at zero or at the finest, as it was found."""
    finest = min(h for known in found.by_spacing.values() for h in known)
    factor, unit = prefix("m", max(h for known in found.by_spacing.values() for h in known))
    for (axis, known), colour in zip(found.by_spacing.items(), COLOURS):
        h, k = np.array(sorted(known)), np.array([known[h] for h in sorted(known)])
        style = {"x": "-", "y": "--", "z": ":"}[axis]
        axes.plot(factor * h, k, color=colour, lw=1.4, ls=style, marker="o", ms=4, label=f"k along {axis}")
        if axis in found.value:
            at = finest if math.isclose(found.value[axis], known[finest], rel_tol=1e-12) else 0.0
            axes.errorbar([factor * at], [found.value[axis]], [found.bar.get(axis, 0.0)], color=colour, marker="s",
                          ms=6, mfc="white", capsize=4, lw=1.4, label=f"result along {axis}, with its bar")
    axes.set_xlim(left=-0.05 * factor * max(h for known in found.by_spacing.values() for h in known))
    axes.set_xlabel(f"spacing ({unit})")
    axes.set_ylabel("permeability (m²)")
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.legend(frameon=False, fontsize=8)


def plot_representative_volume(path: str | os.PathLike, rows: Sequence[Mapping[str, Any]], title: str = "") -> None:
    """Draw porosity and permeability of parts of an image against the edge of the part, with the mean of each edge.

    rows: with `edge` (m), `porosity` and `permeability` (m2).
    """
    figure, ((left, right),) = new_figure(10.4, 3.8, 1, 2)
    edge = _column(rows, "edge")
    factor, unit = prefix("m", float(edge.max()))
    for axes, name, label in ((left, "porosity", "porosity"), (right, "permeability", "permeability (m²)")):
        value = _column(rows, name)
        axes.plot(factor * edge, value, "o", color=COLOURS[0], ms=4, alpha=0.7, label="a part")
        edges = np.unique(edge)
        axes.plot(factor * edges, [value[edge == e].mean() for e in edges], color=COLOURS[1], lw=1.6, label="mean")
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel(f"edge of the part ({unit})")
        axes.set_ylabel(label)
        axes.grid(color="#e6e6e6", lw=0.6)
        axes.legend(frameon=False, fontsize=8)
    _titled(figure, title)
    save_figure(figure, path)


def plot_fit(path: str | os.PathLike, points: tuple[np.ndarray, np.ndarray], line: tuple[np.ndarray, np.ndarray],
             labels: tuple[str, str, str], title: str = "") -> None:
    """Draw points (x, y) and the line (x, y) through them. labels: of x, of y, of the line."""
    figure, ((axes,),) = new_figure(5.6, 4.0)
    axes.plot(*line, color=COLOURS[1], lw=1.4, label=labels[2])
    axes.plot(*points, "o", color=COLOURS[0], ms=5, label="runs")
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.set_xlim(left=min(0.0, float(np.min(points[0]))))
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.legend(frameon=False, fontsize=8)
    _titled(figure, title)
    save_figure(figure, path)


def _places(rows: Sequence[Mapping[str, Any]]) -> tuple[str, np.ndarray, str]:
    """(name of the axis, positions in a unit that fits, that unit)."""
    along = next(name for name in "xyz" if name in rows[0])
    x = _column(rows, along)
    factor, unit = prefix("m", float(np.max(np.abs(x))))
    return along, factor * x, unit


def _column(rows: Sequence[Mapping[str, Any]], name: str) -> np.ndarray:
    return np.array([np.nan if row.get(name) is None else row[name] for row in rows], dtype=float)


def _plain_line(axes: Axes, x: np.ndarray, y: np.ndarray, label: str) -> None:
    axes.plot(x, y, color=COLOURS[0], lw=1.4, marker="o" if len(x) < 30 else None, ms=3)
    axes.set_ylabel(label)
    axes.grid(color="#e6e6e6", lw=0.6)


def _titled(figure: Any, title: str) -> None:
    if title:
        figure.suptitle(title, fontweight="bold", color=INK).set_parse_math(False)
