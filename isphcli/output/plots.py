"""Pictures of a run: a slice of the flow, where two fluids are, the histories.

matplotlib is imported when the first picture is drawn, and only its Agg canvas: no display, no pyplot, no
global state.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

DARCY = 9.869233e-13  # m2
SOLID = "#dcdad5"
INK = "#2f2f2f"
PHASES = ("#7fbf9b", "#9dc3e6")  # first and second fluid
COLOURS = ("#20608c", "#d1495b", "#66a182", "#edae49", "#8d6b94", "#3c3c3c")
SPIKE = 5.0  # times the range of most values: what lies farther out is cut off in histories
# Splat of a particle onto the pixels: a Gaussian of half a spacing, cut off at 1.25 spacings. The sum over
# a lattice is 1 within 3 %, at a plane wall 1/2; a solid begins where it falls under 0.42, so that tubes of
# one voxel, which reach 0.47, are still drawn.
_SIGMA, _CUTOFF, _FILLED = 0.5, 1.25, 0.42
PNG_LEVEL = 3  # of zlib: half of the seconds of level 6 for files that are 14 % larger
MOST_TIMES = 7  # lines of a picture of profiles
MOST_ASKED = 100_000  # points of a plane whose distance from walls is asked of the geometry: a second or two


@dataclass(frozen=True)
class PictureKey:
    """What the colours of a picture mean.

    scale: (label, colour map, power of the value that it follows, highest value), from zero, or None; colours: (name,
    colour) of what has one of its own.
    """

    scale: tuple[str, Any, float, float] | None = None
    colours: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True)
class Frame:
    """The scene that a picture is of.

    dim: 2 or 3; spacing: of the particles; lower, upper: (dim,) box; without them that of the particles; periodic: of
    each axis; wall_distance: of points (m, dim), signed, m: solids are drawn where they are, without it where no
    particle is; flow_axis: without it that of the largest mean component; plane: (normal axis, position), without it
    the mid-plane with more fluid in it of the two, moved to the nearest particles; note: a few words under the title;
    top: of the scale of speeds, m/s, without it by the speeds; units: of length and velocity;
    ("m", "m/s") are written with the prefix that fits, others, such as ("", ""), as they are.
    """

    dim: int
    spacing: float
    title: str = ""
    lower: Sequence[float] | np.ndarray | None = None
    upper: Sequence[float] | np.ndarray | None = None
    periodic: Sequence[bool] | None = None
    wall_distance: Callable[[np.ndarray], np.ndarray] | None = None
    flow_axis: int | None = None
    plane: tuple[int, float] | None = None
    note: str = ""
    top: float | None = None
    units: tuple[str, str] = ("m", "m/s")

    def box(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (dim,); x: (n, dim) particles."""
        return (x.min(axis=0) - self.spacing / 2 if self.lower is None else np.asarray(self.lower, dtype=float),
                x.max(axis=0) + self.spacing / 2 if self.upper is None else np.asarray(self.upper, dtype=float))


def plot_slice(path: str | os.PathLike, x: np.ndarray, velocity: np.ndarray, frame: Frame, *,
               distance: np.ndarray | None = None, permeability: float | None = None,
               phase: np.ndarray | None = None) -> None:
    """Draw the velocity magnitude: of a 2D scene the whole, of a 3D one a plane that holds the flow axis.

    x: (n, dim); velocity: (n, dim). distance: (n,) signed wall distance or None; particles with a negative
    one, in solids, are not drawn, and +inf everywhere says that there are no solids. permeability: m2, for the second
    line. phase: (n,) draws the interfaces.
    Raises ValueError if there is nothing to draw or a value is not finite.
    """
    x, speed, flow, phase = _drawable(x, velocity, distance, phase)
    dim, spacing, (low, high) = frame.dim, frame.spacing, frame.box(x)
    axis = int(np.argmax(np.abs(flow))) if frame.flow_axis is None else frame.flow_axis
    across, normal, position = _choose_plane(x, dim, axis, low, high, spacing, frame.plane)
    shown = (axis, across) if normal is not None or axis == 0 else (0, 1)

    offset = np.zeros(len(x)) if normal is None else x[:, normal] - position
    near = np.abs(offset) < _CUTOFF * spacing
    box = low[list(shown)], high[list(shown)]
    wrap = _pair(frame.periodic, shown)
    values = {"speed": speed[near]} | ({} if phase is None else {"phase": phase[near].astype(float)})
    filled, images = _splat(x[near][:, list(shown)], offset[near], spacing, *box, values, wrap)
    if distance is not None and np.isposinf(distance).all():
        filled[:] = 1.0  # no walls: gaps between particles are not solids
    elif frame.wall_distance is not None:
        filled = _fill_by_distance(filled.shape, box, (dim, shown, normal, position), frame.wall_distance, spacing)
    if not (filled > _FILLED).any():
        raise ValueError(f"{path}: no fluid in the plane {'xyz'[normal or 0]} = {position:.4g}")

    factor, unit = prefix(frame.units[0], float(np.max(box[1] - box[0])))
    extent = [factor * v for v in (box[0][0], box[1][0], box[0][1], box[1][1])]
    aspect = (extent[3] - extent[2]) / (extent[1] - extent[0])
    width, height = (6.4, 6.4 * aspect) if aspect <= 1.3 else (8.0 / aspect, 8.0)
    figure, ((axes,),) = new_figure(width + 1.7, height + 1.15)
    if "phase" in images:
        _draw_interfaces(axes, _smooth(images["phase"], filled, wrap), extent, "white")
    picture, unit_speed = _draw_speed(axes, images["speed"], filled, extent, frame.units[1], frame.top)
    _colour_bar(figure, axes, picture, unit_speed)
    axes.set_xlabel("xyz"[shown[0]] + (f"  ({unit})" if unit else ""))
    axes.set_ylabel("xyz"[shown[1]] + (f"  ({unit})" if unit else ""))
    where = "" if normal is None else f"plane {'xyz'[normal]} = {factor * position:.4g} {unit}".rstrip()
    parts = (frame.note, _permeability(permeability), where)
    draw_headline(axes, frame.title, "    ".join(part for part in parts if part))
    if shown[0] == axis and abs(flow[axis]) > 0.05 * speed.mean() and speed.max() > 0:
        arrow = "flow →" if flow[axis] > 0 else "← flow"
        axes.annotate(arrow, (1, 1.015), xycoords="axes fraction", ha="right", va="bottom", color="#6b6b6b")
    save_figure(figure, path)


def plot_phases(path: str | os.PathLike, x: np.ndarray, phase: np.ndarray, names: Sequence[str], frame: Frame,
                walls: bool = True) -> None:
    """Draw where each of two fluids is and the interface: of a 3D scene the middle slice, normal to its shortest side.

    x: (n, dim); phase: (n,) 0 and 1; names: of the fluids; walls: whether what has no particles is solid.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    dim, spacing, (low, high) = frame.dim, frame.spacing, frame.box(x)
    normal = None if dim == 2 else int(np.argmin(high - low))
    a, b = (axis for axis in range(dim) if axis != normal)
    middle = 0.0 if normal is None else (low[normal] + high[normal]) / 2
    offset = np.zeros(len(x)) if normal is None else x[:, normal] - middle
    near = np.abs(offset) < _CUTOFF * spacing
    if not near.any():
        raise ValueError(f"{path}: no fluid in the plane {'xyz'[normal or 0]} = {middle:.4g}")
    box = low[[a, b]], high[[a, b]]
    wrap = _pair(frame.periodic, (a, b))
    values = {"phase": phase[near].astype(float)}
    filled, images = _splat(x[near][:, [a, b]], offset[near], spacing, *box, values, wrap)
    if not walls:
        filled[:] = 1.0
    elif frame.wall_distance is not None:
        filled = _fill_by_distance(filled.shape, box, (dim, (a, b), normal, middle), frame.wall_distance, spacing)
    factor, unit = prefix("m", float(np.max(box[1] - box[0])))
    extent = [factor * v for v in (box[0][0], box[1][0], box[0][1], box[1][1])]
    aspect = (extent[3] - extent[2]) / (extent[1] - extent[0])
    width, height = (6.4, 6.4 * aspect) if aspect <= 1.3 else (8.0 / aspect, 8.0)
    figure, ((axes,),) = new_figure(width + 1.3, height + 1.15)
    smooth = _smooth(images["phase"], filled, wrap)
    second = smooth > 0.5
    axes.imshow(second, origin="lower", extent=extent, cmap=ListedColormap(list(PHASES)), vmin=0, vmax=1)
    _draw_interfaces(axes, smooth, extent, INK)
    if filled.min() < _FILLED:
        axes.contourf(filled, [-1, _FILLED], extent=extent, colors=[SOLID], zorder=2)
    axes.set_xlabel("xyz"[a] + f"  ({unit})")
    axes.set_ylabel("xyz"[b] + f"  ({unit})")
    where = "" if normal is None else f"plane {'xyz'[normal]} = {factor * middle:.4g} {unit}"
    draw_headline(axes, frame.title, "    ".join(filter(None, (frame.note, where))))
    patches = [Patch(color=colour, label=name) for colour, name in zip(PHASES, names)]
    axes.legend(handles=patches, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    for text in axes.get_legend().get_texts():
        text.set_parse_math(False)
    save_figure(figure, path)


def plot_histories(path: str | os.PathLike, rows: Sequence[Mapping[str, Any]], title: str = "") -> None:
    """Draw velocity, energy, pressures and the measures of two fluids over time (or over the step).

    rows: of history.csv, as `files.read_history` returns them. Columns are found by their first word (`PHYSICAL`). A
    panel without data is left out. Raises ValueError if nothing is left.
    """
    _draw_columns(path, rows, title, PHYSICAL)


def plot_numerics(path: str | os.PathLike, rows: Sequence[Mapping[str, Any]], title: str = "") -> None:
    """Draw time step, iterations, residuals and divergence (`NUMERICAL`), as `plot_histories` does the rest."""
    _draw_columns(path, rows, title, NUMERICAL)


# label of a panel, first words of its columns, whether it is logarithmic
Panels = Sequence[tuple[str, tuple[str, ...], bool]]
PHYSICAL: Panels = (
    ("mean pore velocity, whole box (m/s)", ("mean_velocity",), False),
    ("superficial velocity, whole box (m/s)", ("superficial_velocity",), False),
    ("pressure drop (Pa)", ("pressure_drop",), False),
    ("kinetic energy (J, J/m in 2D)", ("kinetic_energy",), False),
    ("pressure jump (Pa)", ("pressure_jump",), False),
    ("saturation", ("saturation",), False),
    ("centre (m)", ("centre",), False),
    ("circularity", ("circularity",), False),
    ("capillary number", ("capillary_number", "peak_capillary_number"), True),
    ("contact angle (degrees)", ("contact_angle",), False),
)
NUMERICAL: Panels = (
    ("time step (s)", ("dt",), False),
    ("iterations", ("iterations",), False),
    ("residual, divergence", ("residual", "divergence", "max_divergence", "change"), True),
)


def _draw_columns(path: str | os.PathLike, rows: Sequence[Mapping[str, Any]], title: str, wanted: Panels) -> None:
    by_time = sum(row.get("time") is not None for row in rows) > 1 and rows[-1]["time"] > rows[0]["time"]
    key = "time" if by_time else "step"
    coordinate = np.array([row.get(key, i) for i, row in enumerate(rows)], dtype=float)
    panels = []
    for label, words, log in wanted:
        lines = {
            name: values for name in _columns(rows, words) if (values := _series(rows, name)) is not None
        }
        if log:
            lines = {name: np.where(v > 0, v, np.nan) for name, v in lines.items() if np.any(v > 0)}
        # a line has two points
        lines = {name: v for name, v in lines.items() if len(rows) == 1 or np.isfinite(v).sum() > 1}
        if lines:
            panels.append((label, words, log, lines))
    if not panels:
        raise ValueError(f"{path}: the history has no column that can be drawn")
    columns = min(len(panels), 2)
    count = -(-len(panels) // columns)
    figure, grid = new_figure(5.2 * columns, 2.9 * count + 0.4, count, columns)
    for axes, (label, words, log, lines) in zip(grid.flat, panels):
        for (name, values), colour in zip(lines.items(), COLOURS * 9):
            _line(axes, coordinate, values, colour, _short(name, words))
        axes.set_yscale("log" if log else "linear")
        if not log:
            _limits(axes, np.concatenate(list(lines.values())))
        axes.set_ylabel(label)
        axes.set_xlabel("time (s)" if by_time else "step")
        axes.ticklabel_format(axis="x", style="sci", scilimits=(-2, 5))
        if len(lines) > 1:
            axes.legend(frameon=False, fontsize=8)
    for axes in list(grid.flat)[len(panels) :]:
        axes.set_visible(False)
    if title:
        figure.suptitle(title, fontweight="bold", color=INK).set_parse_math(False)
    save_figure(figure, path)


def plot_profiles(path: str | os.PathLike, rows: Sequence[Mapping[str, Any]], names: Sequence[str],
                  title: str = "") -> None:
    """Draw saturation of the second fluid, pressure and flux along the axis, at up to MOST_TIMES times, the last one
    dark, and how far the flux at the last one is spread.

    rows: of profiles.csv; names: of the fluids. Raises ValueError without rows.
    """
    from matplotlib import colormaps

    if not rows:
        raise ValueError(f"{path}: there is no profile")
    times = sorted({row["time"] for row in rows})
    kept = [times[k] for k in np.unique(np.linspace(0, len(times) - 1, min(len(times), MOST_TIMES)).astype(int))]
    along = next(name for name in "xyz" if name in rows[0])
    factor, unit = prefix("m", max(abs(row[along]) for row in rows))
    with_flux = any(row.get("superficial_velocity") is not None for row in rows)
    figure, ((left, right, *more),) = new_figure(10.4 + 5.0 * with_flux, 3.6, 1, 2 + with_flux)
    keys = [(left, f"saturation_{names[1]}"), (right, "pressure"), *((axes, "superficial_velocity") for axes in more)]
    shades = colormaps["viridis_r"](np.linspace(0.15, 1.0, len(kept)))
    for time, shade in zip(kept, shades):
        now = [row for row in rows if row["time"] == time]
        x = factor * np.array([row[along] for row in now])
        for axes, key in keys:
            values = np.array([np.nan if row.get(key) is None else row[key] for row in now], dtype=float)
            axes.plot(x, values, color=shade, lw=1.4, label=f"{time:.3g} s")
            axes.grid(color="#e6e6e6", lw=0.6)
    left.set_ylim(-0.03, 1.03)
    left.set_ylabel(f"saturation {names[1]}").set_parse_math(False)
    right.set_ylabel("pressure (Pa)")
    for axes in more:
        axes.set_ylabel("superficial velocity (m/s)")
        flux = values[np.isfinite(values)]  # of the last time
        if len(flux) and flux.mean() != 0.0:
            spread = float(flux.std() / abs(flux.mean()))
            axes.set_title(f"spread of the slices at the end: {spread:.1e} of the mean", fontsize=9, color=INK)
    for axes, _ in keys:
        axes.set_xlabel(f"{along}  ({unit})")
    right.legend(frameon=False, fontsize=8)
    if title:
        figure.suptitle(title, fontweight="bold", color=INK).set_parse_math(False)
    save_figure(figure, path)


def plot_curve(path: str | os.PathLike, rows: Sequence[Mapping[str, Any]], names: Sequence[str],
               title: str = "") -> None:
    """Draw capillary pressure and pressure drop over the saturation of the first fluid, with separate parts and what is
    trapped of both, a point a step of the drive, numbered in their order.

    rows: of curve.csv; names: of the fluids. Raises ValueError without rows.
    """
    if not rows:
        raise ValueError(f"{path}: the curve has no point")
    saturation = _series(rows, f"saturation_{names[0]}")
    assert saturation is not None  # a column of every curve
    figure, ((left, middle, right),) = new_figure(14.0, 3.8, 1, 3)
    panels = ((left, "pressure (Pa)", ("capillary_pressure", "pressure_drop")),
              (middle, "separate parts", tuple(f"ganglia_{name}" for name in names)),
              (right, "trapped saturation", tuple(f"trapped_{name}" for name in names)))
    for axes, label, keys in panels:
        for key, colour in zip(keys, COLOURS):
            values = _series(rows, key)
            if values is not None:
                _line(axes, saturation, values, colour, key.replace("_", " "))
        axes.set_xlabel(f"saturation {names[0]}").set_parse_math(False)
        axes.set_ylabel(label)
        axes.set_xlim(-0.03, 1.03)
        for text in axes.legend(frameon=False, fontsize=8).get_texts():
            text.set_parse_math(False)
    drops = _series(rows, "pressure_drop")
    for row, x, y in zip(rows, saturation, drops if drops is not None else ()):
        left.annotate(f"{row['drive_step']:g}", (x, y), xytext=(3, 3), textcoords="offset points", fontsize=7)
    if title:
        figure.suptitle(title, fontweight="bold", color=INK).set_parse_math(False)
    save_figure(figure, path)


def frame_picture(path: str | os.PathLike, image: np.ndarray, frame: Frame, key: PictureKey) -> None:
    """A picture of a scene in 3D with its title, the size of its box and what its colours mean.

    image: (height, width, 3) uint8; white margins are cut off.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import PowerNorm
    from matplotlib.patches import Patch

    ink = np.nonzero((image < 250).any(axis=2))
    if len(ink[0]):
        rows, columns = (slice(max(int(i.min()) - 8, 0), int(i.max()) + 9) for i in ink)
        image = image[rows, columns]
    aspect = image.shape[0] / image.shape[1]
    figure, ((axes,),) = new_figure(9.0, 7.4 * aspect + 1.0)
    axes.imshow(image, interpolation="hanning")
    axes.set_axis_off()
    size = np.asarray(frame.upper) - np.asarray(frame.lower)
    factor, unit = prefix(frame.units[0], float(size.max()))
    second = f"box {' × '.join(f'{factor * s:.3g}' for s in size)} {unit}".rstrip()
    if frame.flow_axis is not None:
        second += f"    flow along {'xyz'[frame.flow_axis]}"
    draw_headline(axes, frame.title, "    ".join(filter(None, (frame.note, second))))
    if key.scale is not None:
        label, colours, power, high = key.scale
        bar = figure.colorbar(ScalarMappable(PowerNorm(power, 0.0, high), colours), ax=axes, fraction=0.035, pad=0.02,
                              shrink=0.8, extend="max")
        bar.set_label(label)
        bar.outline.set_linewidth(0.4)
    if key.colours:
        patches = [Patch(facecolor=colour, edgecolor="#8f8b84", lw=0.6, label=name) for name, colour in key.colours]
        legend = axes.legend(handles=patches, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=3, frameon=False)
        for text in legend.get_texts():
            text.set_parse_math(False)
    save_figure(figure, path)


# -- the slice -------------------------------------------------------------------------------------------


def _drawable(x: np.ndarray, velocity: np.ndarray, distance: np.ndarray | None,
              phase: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Points, speeds, mean velocity and phases of the particles that are not in a solid."""
    x, velocity = np.asarray(x, dtype=float), np.asarray(velocity, dtype=float)
    keep = np.ones(len(x), dtype=bool) if distance is None else np.asarray(distance) > 0
    x, velocity = x[keep], velocity[keep]
    if not len(x):
        raise ValueError("there is no fluid particle to draw")
    if not (np.isfinite(x).all() and np.isfinite(velocity).all()):
        raise ValueError("positions or velocities to be drawn are not finite")
    speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
    return x, speed, velocity.mean(axis=0), None if phase is None else np.asarray(phase)[keep]


def _choose_plane(x: np.ndarray, dim: int, axis: int, lower: np.ndarray, upper: np.ndarray, spacing: float,
                  plane: tuple[int, float] | None) -> tuple[int, int | None, float]:
    """The axis shown beside the flow axis, the normal axis and the position of the plane (2D: 1, None, 0)."""
    if dim == 2:
        return 1 - axis, None, 0.0
    if plane is not None:
        normal, position = plane
        return next(a for a in range(3) if a not in (axis, normal)), normal, position
    middle = (lower + upper) / 2
    fluid = np.count_nonzero(np.abs(x - middle) < spacing, axis=0)
    across, normal = sorted((a for a in range(3) if a != axis), key=lambda a: (fluid[a], a))
    return across, normal, float(x[np.argmin(np.abs(x[:, normal] - middle[normal])), normal])


def _pair(periodic: Sequence[bool] | None, shown: Sequence[int]) -> tuple[bool, ...]:
    return (False, False) if periodic is None else tuple(bool(periodic[a]) for a in shown)


def _splat(points: np.ndarray, offset: np.ndarray, spacing: float, lower: np.ndarray, upper: np.ndarray,
           values: Mapping[str, np.ndarray],
           periodic: Sequence[bool] = (False, False)) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Spread particles over pixels: the filled share (ny, nx), near 1 in fluid, and each value's mean.

    points: (n, 2); offset: (n,) distance from the plane; values: name -> (n,).
    """
    cells = (upper - lower) / spacing
    per_spacing = float(np.clip(760 / cells.max(), 1, 12))
    shape = np.maximum(np.rint(cells * per_spacing).astype(int), 1)
    pixel = (upper - lower) / shape
    reach = math.ceil(_CUTOFF * spacing / pixel.min())
    points, offset, values = _carried_on(points, offset, values, lower, upper, _CUTOFF * spacing, periodic)
    home = np.floor((points - lower) / pixel).astype(int)
    weight = np.zeros(shape[0] * shape[1])
    sums = {name: np.zeros_like(weight) for name in values}
    j = home[:, 1] + np.arange(-reach, reach + 1)[:, None]
    for i in home[:, 0] + np.arange(-reach, reach + 1)[:, None]:  # a column of pixels beside every particle
        dx = lower[0] + (i + 0.5) * pixel[0] - points[:, 0]
        dy = lower[1] + (j + 0.5) * pixel[1] - points[:, 1]
        r2 = (dx**2 + dy**2 + offset**2) / spacing**2
        inside = (r2 < _CUTOFF**2) & (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
        index = (j * shape[0] + i)[inside]
        w = np.exp(-r2[inside] / (2 * _SIGMA**2))
        weight += np.bincount(index, w, minlength=len(weight))
        for name, value in values.items():
            sums[name] += np.bincount(
                index, w * np.broadcast_to(value, j.shape)[inside], minlength=len(weight)
            )
    safe = np.where(weight > 0, weight, 1.0)
    image = {name: (total / safe).reshape(shape[::-1]) for name, total in sums.items()}
    filled = weight.reshape(shape[::-1])
    return filled / (np.quantile(filled[filled > 0], 0.9) if filled.any() else 1.0), image


def _fill_by_distance(shape: tuple[int, ...], box: tuple[np.ndarray, np.ndarray],
                      plane: tuple[int, tuple[int, int], int | None, float],
                      wall_distance: Callable[[np.ndarray], np.ndarray], spacing: float) -> np.ndarray:
    """Filled share (ny, nx) of a plane by the distance from walls: above `_FILLED` in fluid, and that on a wall.

    plane: (dim, axes shown, normal axis or None, position along it). The distance is asked of at most MOST_ASKED points
    and linear between them.
    """
    from scipy.ndimage import map_coordinates

    dim, shown, normal, position = plane
    coarse = max(1, math.ceil(math.sqrt(shape[0] * shape[1] / MOST_ASKED)))
    counts = [max(2, math.ceil(n / coarse)) for n in shape[::-1]]
    edges = [(low + (np.arange(n) + 0.5) * (high - low) / n) for low, high, n in zip(*box, counts)]
    points = np.zeros((counts[0] * counts[1], dim))
    points[:, shown[0]], points[:, shown[1]] = (a.ravel() for a in np.meshgrid(*edges))
    if normal is not None:
        points[:, normal] = position
    depth = np.asarray(wall_distance(points)).reshape(counts[::-1])
    rows, columns = ((np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(shape, counts[::-1]))
    fine = map_coordinates(depth, np.meshgrid(rows, columns, indexing="ij"), order=1, mode="nearest")
    return np.clip(_FILLED + fine / spacing, 0.0, 1.0)


def _carried_on(points: np.ndarray, offset: np.ndarray, values: Mapping[str, np.ndarray], lower: np.ndarray,
                upper: np.ndarray, reach: float,
                periodic: Sequence[bool]) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Points within `reach` of the box's faces once more, behind the other face where the box
    is periodic, else reflected: no edge is left half filled."""
    index = np.arange(len(points))
    for a in (0, 1):
        for face, other in ((lower[a], upper[a]), (upper[a], lower[a])):
            near = np.abs(points[:, a] - face) < reach
            image = points[near].copy()
            image[:, a] = image[:, a] + (other - face) if periodic[a] else 2 * face - image[:, a]
            points, index = np.concatenate([points, image]), np.concatenate([index, index[near]])
    return points, offset[index], {name: value[index] for name, value in values.items()}


def _draw_speed(axes: Axes, speed: np.ndarray, filled: np.ndarray, extent: Any, unit: str,
                largest: float | None = None) -> tuple[Any, str]:
    """The picture itself: solids grey with an edge, fluid from dark (slow) to bright (fast)."""
    from matplotlib.colors import Normalize, PowerNorm

    fluid = speed[filled > _FILLED]
    most = float(np.quantile(fluid, 0.995)) if largest is None else largest
    factor, unit = prefix(unit, most)
    top, usual = factor * most, factor * float(np.median(fluid))
    channels = largest is None and usual < 0.2 * top
    highest = top if largest is not None else factor * fluid.max() or 1.0
    norm = PowerNorm(0.5, 0, top) if channels else Normalize(0, highest)
    picture = axes.imshow(
        factor * speed, origin="lower", extent=extent, cmap=flow_map(), norm=norm, interpolation="bilinear"
    )
    if filled.min() < _FILLED:
        axes.contourf(filled, [-1, _FILLED], extent=extent, colors=[SOLID], zorder=2)
        axes.contour(filled, [_FILLED], extent=extent, colors="#8f8b84", linewidths=0.6, zorder=3)
    return picture, unit


def _smooth(phase: np.ndarray, filled: np.ndarray, periodic: Sequence[bool]) -> np.ma.MaskedArray:
    """The phase over a spacing or so, as particles are no finer: every picture draws the interface of this."""
    from scipy.ndimage import gaussian_filter

    share = (filled > _FILLED).astype(float)
    width = 0.012 * max(phase.shape) if max(phase.shape) > 300 else 1.0
    mode = ["wrap" if p else "nearest" for p in (periodic[1], periodic[0])]
    weight = np.maximum(gaussian_filter(share, width, mode=mode), 1e-3)
    return np.ma.array(gaussian_filter(share * phase, width, mode=mode) / weight, mask=share == 0)


def _draw_interfaces(axes: Axes, smooth: np.ma.MaskedArray, extent: Any, colour: str) -> None:
    """Lines where the phase changes."""
    levels = np.arange(0.5, smooth.max())
    if len(levels) and np.ptp(smooth) > 0.5:
        axes.contour(smooth, levels, extent=extent, colors=colour, linewidths=1.6, zorder=4)


def flow_map() -> Colormap:
    """Perceptually uniform; without the near-white end that the grey solids are close to."""
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("flow", colormaps["inferno"](np.linspace(0.03, 0.95, 256)))


def _colour_bar(figure: Figure, axes: Axes, picture: Any, unit: str) -> None:
    clipped = float(picture.get_array().max()) > picture.norm.vmax * 1.001
    bar = figure.colorbar(picture, ax=axes, fraction=0.05, pad=0.025, extend="max" if clipped else "neither")
    bar.set_label("speed" + (f"  ({unit})" if unit else ""))
    bar.outline.set_linewidth(0.4)
    if picture.norm.__class__.__name__ == "PowerNorm":
        ticks = [_round_down(share * picture.norm.vmax) for share in (0, 0.04, 0.15, 0.35, 0.6, 1.0)]
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.ax.minorticks_off()


def _round_down(value: float) -> float:
    """The nearest smaller number with one digit (two from 10 to 15, 100 to 150, ...)."""
    if value <= 0:
        return 0.0
    unit = 10.0 ** math.floor(math.log10(value))
    unit *= 0.1 if value < 1.5 * unit else 0.5
    return float(f"{math.floor(value / unit) * unit:.3g}")


# -- parts of every picture ------------------------------------------------------------------------------


def prefix(unit: str, size: float) -> tuple[float, str]:
    """Factor and name of the unit that makes `size` 1 to 1000; only m, m/s and Pa have prefixes."""
    if unit not in ("m", "m/s", "Pa") or size <= 0:
        return 1.0, unit
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n"), (1e12, "p")):
        if size * factor >= 1:
            return factor, prefix + unit
    return 1.0, unit


def _permeability(k: float | None) -> str:
    if k is None:
        return ""
    exponent = math.floor(math.log10(abs(k))) if k else 0
    number = f"{k:.3g}" if -3 < exponent < 4 else rf"{k / 10.0**exponent:.2f}$\times$10$^{{{exponent}}}$"
    in_darcy = k / DARCY
    text = f"{in_darcy:.3g} darcy" if in_darcy >= 0.1 else f"{1e3 * in_darcy:.3g} mD"
    return f"permeability {number} m²  ({text})"


def new_figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, np.ndarray]:
    """(figure, its axes (rows, columns)) in the style of all pictures; width, height: inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=160, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.tick_params(labelsize=9, colors=INK, width=0.6)
        for spine in axes.spines.values():
            spine.set_linewidth(0.6)
    return figure, grid


def draw_headline(axes: Axes, title: str, second: str) -> None:
    """Title in bold, a second line in grey under it; a long title loses its end."""
    title = title if len(title) <= 64 else title[:63] + "…"
    if title:
        text = axes.set_title(title, loc="left", fontweight="bold", fontsize=12, color=INK, pad=22 if second else 8)
        text.set_parse_math(False)
    if second:
        axes.annotate(second, (0, 1.015), xycoords="axes fraction", va="bottom", fontsize=9, color="#6b6b6b")


def _line(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str, label: str) -> None:
    known = np.isfinite(y)  # what is measured every few steps is joined over the rows between
    x, y = x[known], y[known]
    if len(x) > 2000:
        step = len(x) // 1000
        x, y = x[::step], y[::step]
    axes.plot(x, y, color=colour, lw=1.4, marker="o" if len(x) < 30 else None, ms=3, label=label)
    axes.grid(color="#e6e6e6", lw=0.6)


def _limits(axes: Axes, values: np.ndarray) -> None:
    """From zero where nothing is negative; the spike of a start does not hide the rest."""
    low, high = np.nanpercentile(values, [2, 98])
    reach = 0.1 * (high - low)
    if reach > 0 and max(np.nanmax(values) - high, low - np.nanmin(values)) > SPIKE * (high - low):
        axes.set_ylim(low - reach, high + reach)
    elif np.nanmin(values) >= 0:
        axes.set_ylim(bottom=0)


def _columns(rows: Sequence[Mapping[str, Any]], words: Sequence[str]) -> list[str]:
    """Columns whose name is one of `words`, or starts with one and an underscore."""
    names = dict.fromkeys(name for row in rows for name in row)
    return [name for name in names if any(name == word or name.startswith(word + "_") for word in words)]


def _series(rows: Sequence[Mapping[str, Any]], name: str) -> np.ndarray | None:
    """A column as floats, NaN where a cell is empty; None if it holds no number."""
    found = [row.get(name) for row in rows]
    values = [float(v) if isinstance(v, (int, float)) and math.isfinite(v) else math.nan for v in found]
    return None if all(math.isnan(v) for v in values) else np.array(values)


def _short(name: str, words: Sequence[str]) -> str:
    word = next(word for word in sorted(words, key=len, reverse=True) if name.startswith(word))
    return name[len(word) :].strip("_").replace("_", " ") or name.replace("_", " ")


def save_figure(figure: Figure, path: str | os.PathLike) -> None:
    """Write a figure as PNG, whole or not at all."""
    # laid out here, once: savefig draws a figure that has a layout twice, the first time for the layout alone
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
        figure.set_layout_engine("none")
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", pil_kwargs={"compress_level": PNG_LEVEL})
