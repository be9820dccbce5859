"""Draws the figures of docs/method.md, as far as possible with the functions that they explain.

    PYTHONPATH=. python docs/figures/draw.py [NAME...] [--png FOLDER]

Without names all of them, as SVG beside this file; with --png as pictures to look at too. A figure is a function of
`FIGURES`, named as its file.
"""

from __future__ import annotations

import argparse
import csv
import pathlib
import re
from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch, Polygon
from matplotlib.path import Path
from scipy.spatial import ConvexHull, cKDTree

from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.lattice import Particles, make_lattice
from isphcli.domain.neighbours import neighbourhood
from isphcli.geometry.bodies import Disk, Shape
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.geometry.modes import Modes
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.operators.apply import divergence
from isphcli.operators.assemble import assemble
from isphcli.operators.kernel import KERNELS, WENDLAND_C2, normalisation, shape
from isphcli.operators.moments import particle_volumes
from isphcli.operators.narrow_pores import classify_neighbourhoods
from isphcli.operators.pair_weights import Operators, build_operators
from isphcli.operators.wall_scene import WallScene
from isphcli.references.published import DATA
from isphcli.runs.expected_error import usual_error
from isphcli.runs.permeability import EDGE, extrapolate
from isphcli.scene.place import place
from isphcli.solvers.multigrid import hierarchy
from isphcli.validation.known_bodies import body

HERE = pathlib.Path(__file__).parent
INK, GREY, SOLID, FLUID, DUMMY = "#2f2f2f", "#9a9a9a", "#dcdad5", "#20608c", "#d1495b"
OTHER, PALE = "#edae49", "#cfe0ee"  # the second fluid, areas of the first
STYLE = {"font.family": "sans-serif", "font.size": 9, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK,
         "xtick.color": INK, "ytick.color": INK, "axes.titlesize": 9, "axes.linewidth": 0.7, "svg.hashsalt": "isphcli",
         "svg.fonttype": "path"}
SUPPORT = 2.5  # spacings
KERNEL_NAMES = {"wendland_c2": "Wendland C2", "wendland_c4": "Wendland C4", "quintic_spline": "quintic spline"}


def panels(count: int, width: float = 7.4, height: float = 2.9, bare: bool = True) -> tuple[Figure, list[Axes]]:
    """A figure with panels beside each other; bare ones have no axes and one scale for both directions."""
    figure = Figure((width, height), layout="constrained")
    every = [figure.add_subplot(1, count, k + 1) for k in range(count)]
    for axes in every if bare else ():
        axes.set_aspect("equal")
        axes.axis("off")
    return figure, every


def dots(axes: Axes, x: np.ndarray, colour: str, size: float = 4.0, marker: str = "o", hollow: bool = False) -> None:
    """Points x (n, 2)."""
    face = "white" if hollow else colour
    axes.plot(*x.T, marker, color=colour, ms=size, mfc=face, mew=0.8, ls="none", zorder=3)


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str = INK, both: bool = False) -> None:
    """An arrow from one point (2,) to another; both: with a head at either end."""
    style = {"arrowstyle": "<->" if both else "->", "color": colour, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, zorder=4, arrowprops=style)


def disk_scene(radius: float, cells: int) -> tuple[ShapeGeometry, Particles]:
    """A solid disk in the middle of a periodic unit square."""
    geometry = ShapeGeometry([0, 0], [1, 1], [True, True], shapes=[Shape(Disk((0.5, 0.5), radius))])
    lattice = make_lattice("square", geometry.lower, geometry.upper, geometry.periodic, 1 / cells, 0.0)
    return geometry, place(geometry, lattice, SUPPORT / cells)


def kernel_and_support() -> Figure:
    """W over the distance; a support of a particle at a wall, and which sites of the solid become dummies."""
    figure, (left, right) = panels(2, bare=False)
    q = np.linspace(0, 1, 40)
    for (name, kind), colour in zip(KERNELS.items(), (FLUID, DUMMY, OTHER)):
        left.plot(q, [normalisation(kind, 1.0, 2) * shape(kind, at) for at in q], color=colour, lw=1.4,
                  label=KERNEL_NAMES[name])
    left.set(xlabel="q = r / h", ylabel="W h²   (2D)", xlim=(0, 1), ylim=0)
    left.spines[["top", "right"]].set_visible(False)
    left.legend(frameon=False, fontsize=8)
    cells = 20
    _, particles = disk_scene(0.36, cells)
    x, n = particles.x, particles.n_fluid
    every = (np.stack(np.meshgrid(*[np.arange(cells)] * 2), axis=-1).reshape(-1, 2) + 0.5) / cells
    away, _ = cKDTree(x).query(every)
    right.add_patch(Circle((0.5, 0.5), 0.36, color=SOLID, lw=0))
    chosen = x[np.argmin(np.linalg.norm(x[:n] - [0.22, 0.22], axis=1))]
    right.add_patch(Circle(tuple(chosen), SUPPORT / cells, fill=False, ec=INK, lw=1))
    dots(right, x[:n], FLUID, 3.2)
    dots(right, x[n:], DUMMY, 3.2, hollow=True)
    dots(right, every[away > 1e-9], GREY, 2.5, "x")
    dots(right, chosen[None], INK, 5)
    end = chosen + SUPPORT / cells * np.array([-0.6, 0.8])
    right.plot(*np.stack([chosen, end]).T, color=INK, lw=0.9)
    right.text(*(end + [-0.012, 0.008]), "h", ha="right", fontsize=10)
    right.set(xlim=(0, 0.6), ylim=(0, 0.6), aspect="equal", title="fluid, dummies (hollow), left out (×)")
    right.axis("off")
    return figure


def wall_crossing() -> Figure:
    """Where the pairs of a particle meet a wall, and what eq. 11 makes of one of them."""
    figure, (left, right) = panels(2, bare=False)
    cells = 20
    geometry, particles = disk_scene(0.36, cells)
    x, n = particles.x, particles.n_fluid
    i = int(np.argmin(np.linalg.norm(x[:n] - [0.22, 0.22], axis=1)))
    near = np.flatnonzero((np.linalg.norm(x - x[i], axis=1) < SUPPORT / cells) & (np.arange(len(x)) >= n))
    t = geometry.crossing(np.repeat(x[[i]], len(near), axis=0), x[near])
    meets = x[i] + t[:, None] * (x[near] - x[i])
    left.add_patch(Circle((0.5, 0.5), 0.36, color=SOLID, lw=0))
    for j in near:
        left.plot(*x[[i, j]].T, color=GREY, lw=0.7)
    dots(left, x[:n], FLUID, 4)
    dots(left, x[n:], DUMMY, 4, hollow=True)
    dots(left, meets, INK, 3.5)
    left.text(*(x[i] + [-0.012, -0.002]), "i", ha="right", va="top", fontsize=11)
    left.set(xlim=(0.1, 0.42), ylim=(0.12, 0.4), aspect="equal", title="crossing points of i")
    left.axis("off")
    share, f_wall = 0.55, 0.25
    right.axvspan(share, 1.15, color=SOLID, lw=0)
    right.plot([0, 1], [1, 1 + (f_wall - 1) / share], color=INK, lw=1.2)
    for at, value, colour, hollow, words, place_of in (
            (0, 1, FLUID, False, "particle i: f", (0.04, 1.02)),
            (share, f_wall, INK, False, "wall: f at t s", (0.58, 0.3)),
            (1, 1 + (f_wall - 1) / share, DUMMY, True, "dummy: f by eq. 11", (0.6, -0.58))):
        dots(right, np.array([[at, value]]), colour, 6, hollow=hollow)
        right.text(*place_of, words)
    right.axhline(0, color=GREY, lw=0.6)
    arrow(right, np.array([0, -0.75]), np.array([share, -0.75]), both=True)
    right.text(share / 2, -0.71, "t s", ha="center", va="bottom")
    arrow(right, np.array([0, -0.92]), np.array([1, -0.92]), both=True)
    right.text(0.5, -0.94, "s", ha="center", va="top")
    right.set(xlim=(-0.08, 1.15), ylim=(-1.15, 1.25), xticks=[], yticks=[0], xlabel="along the pair",
              ylabel="velocity f", title="one slope to the wall and to the dummy")
    right.spines[["top", "right"]].set_visible(False)
    return figure


def surface_of_labels() -> Figure:
    """A body, the labels of its voxels, and the walls that they stand for: stairs, and the zero of the smooth field."""
    figure, (left, right) = panels(2, 7.2, 3.4)
    n, fine = 20, 60
    noise = np.random.default_rng(5).standard_normal((1, n, n))
    around = np.array([True, True, True])
    modes = Modes((1, n, n), around)
    body = modes.filtered(noise, np.exp(-2 * (np.pi * 1.8) ** 2 * modes.square_frequencies()))  # smooth over 1.8 voxels
    body -= np.median(body) - 0.05 * body.std()
    labels = np.where(body[0] > 0, 0, -1).astype(np.int8)
    geometry = IsoSurfaceGeometry(labels, None, 1.0, (True, True))
    true = IsoSurfaceGeometry(labels, ImageField(body[0].astype(np.float32)), 1.0, (True, True))
    at = np.linspace(0, n, fine)
    x = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    for axes, words in ((left, "stairs"), (right, "smooth")):
        squares = [[(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1), (i, j)] for j, i in zip(*np.nonzero(labels < 0))]
        axes.add_patch(PathPatch(Path.make_compound_path(*map(Path, squares)), color=SOLID, lw=0.4))
        axes.contour(at, at, true.distance(x).reshape(fine, fine), [0.0], colors=[GREY], linewidths=1.1,
                     linestyles="dashed")
        axes.add_patch(Polygon([(0, 0), (n, 0), (n, n), (0, n)], fill=False, ec=GREY, lw=0.6))
        axes.set(xlim=(0, n), ylim=(0, n), title=f"wall_distance: {words}")
    upright, level = (np.nonzero(np.diff(labels, axis=axis)) for axis in (1, 0))
    faces = [[(i + 1, j), (i + 1, j + 1)] for j, i in zip(*upright)]
    faces += [[(i, j + 1), (i + 1, j + 1)] for j, i in zip(*level)]
    left.add_patch(PathPatch(Path.make_compound_path(*map(Path, faces)), fill=False, ec=DUMMY, lw=1.4))
    right.contour(at, at, geometry.distance(x).reshape(fine, fine), [0.0], colors=[DUMMY], linewidths=1.4)
    return figure


def periodic_operators(x: np.ndarray, spacing: float) -> Operators:
    """Operators of particles x (n, 2) in the periodic unit square."""
    lower, upper, around = np.zeros(2), np.ones(2), np.ones(2, bool)
    halo = build_halo(x, lower, upper, around, SUPPORT * spacing)
    neighbours = neighbourhood(halo.positions(x), halo.owners(len(x)), len(x), WENDLAND_C2, SUPPORT * spacing)
    return build_operators(neighbours, particle_volumes(neighbours))


def pair_weights() -> Figure:
    """Weights of the neighbours of one particle in disorder: of d/dx and of the Laplacian."""
    figure, every = panels(2, 6.4, 2.9)
    n = 9
    lattice = (np.stack(np.meshgrid(*[np.arange(n)] * 2), axis=-1).reshape(-1, 2) + 0.5) / n
    x = lattice + np.random.default_rng(7).uniform(-0.25, 0.25, lattice.shape) / n
    ops = periodic_operators(x, 1 / n)
    i = len(x) // 2
    own = slice(ops.start[i], ops.start[i + 1])
    place_of = ops.neighbours.x[ops.neighbours.row[own]]
    for axes, weight, title in ((every[0], ops.grad[own, 0] / n, "∂f/∂x"), (every[1], ops.lap[own] / n**2, "∇²f")):
        axes.add_patch(Circle(tuple(x[i]), SUPPORT / n, fill=False, ec=GREY, lw=0.8))
        dots(axes, x, GREY, 2.5, hollow=True)
        most = np.abs(weight).max()
        axes.scatter(*place_of.T, c=weight, cmap="coolwarm", s=95, lw=0, vmin=-most, vmax=most, zorder=4)
        for at, value in zip(place_of, weight):
            axes.text(*at, f"{value:.2f}", fontsize=4.6, ha="center", va="center", zorder=5,
                      color="white" if abs(value) > 0.7 * most else INK)
        dots(axes, x[[i]], INK, 5)
        axes.set(xlim=(0.16, 0.84), ylim=(0.16, 0.84), title=f"weights of fⱼ − fᵢ in {title}")
    return figure


def ends_of_images() -> Figure:
    """What stands beyond the faces of an image: clear layers, its mirror image, itself."""
    figure, every = panels(3, 7.4, 2.5)
    n = 24
    noise = np.random.default_rng(11).standard_normal((1, n, n))
    modes = Modes((1, n, n), np.zeros(3, bool))
    body = modes.filtered(noise, np.exp(-2 * (np.pi * 1.8) ** 2 * modes.square_frequencies()))[0]
    rock = body < np.quantile(body, 0.45)
    clear = np.zeros((n, 6), bool)
    shown = (("clear layers, sealed sides", np.concatenate([clear, rock, clear], axis=1), 6),
             ("mirror: [x]", np.concatenate([rock, rock[:, ::-1]], axis=1), 0),
             ("periodic: [x]", np.concatenate([rock, rock], axis=1), 0))
    for axes, (title, solid, first) in zip(every, shown):
        axes.imshow(solid, origin="lower", interpolation="none", cmap=ListedColormap([PALE, GREY]), vmin=0, vmax=1)
        axes.add_patch(Polygon(np.array([(0, 0), (n, 0), (n, n), (0, n)]) + [first - 0.5, -0.5], fill=False, ec=DUMMY,
                               lw=1.2))
        axes.set(title=title)
        if first:
            axes.plot([-0.5, solid.shape[1] - 0.5], [[-0.5, n - 0.5]] * 2, color=INK, lw=2)
    return figure


def neighbourhood_classes() -> Figure:
    """The classes of particles between two solid disks that touch each other and a wall."""
    figure, (axes,) = panels(1, 4.4, 3.3)
    cells, names = 27, {"full": FLUID, "wall": OTHER, "narrow": DUMMY, "isolated": INK}
    disks = [Disk((0.25, 0.25), 0.25), Disk((0.75, 0.25), 0.25)]
    geometry = ShapeGeometry([0, 0], [1, 0.75], [True, False], shapes=[Shape(disk) for disk in disks])
    lattice = make_lattice("square", geometry.lower, geometry.upper, geometry.periodic, 1 / cells, SUPPORT / cells)
    particles = place(geometry, lattice, SUPPORT / cells)
    x, dummies = particles.x[: particles.n_fluid], particles.x[particles.n_fluid:]
    scene = WallScene(geometry, dummies, SUPPORT / cells, WENDLAND_C2, particles.site_volume)
    classes = classify_neighbourhoods(scene.stencils(x)[0])
    for disk in disks:
        axes.add_patch(Circle(disk.centre, disk.radius, color=SOLID, lw=0))
    for y in (0.0, 0.75):
        axes.plot([0, 1], [y, y], color=INK, lw=1.5)
    for k, (name, colour) in enumerate(names.items()):
        if np.any(classes == k):
            dots(axes, x[classes == k], colour, 4)
            axes.plot([], [], "o", color=colour, ms=4, label=name)
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.set(xlim=(0, 1), ylim=(-0.02, 0.77))
    return figure


def error_bars() -> Figure:
    """k of a random body over the spacing, with its bar, beside smooth walls and on the faces of voxels: rows of the
    table of known bodies."""
    figure, every = panels(2, 7.0, 2.7, bare=False)
    name, porosity = "blobs 11", body("blobs 11").labels(3).mean()
    with open(DATA / "known_bodies_measured.csv", encoding="utf-8", newline="") as file:
        rows = {row["wall"]: row for row in csv.DictReader(line for line in file if not line.startswith("#"))
                if row["body"] == name}
    spacings = np.array([1.0, 1 / 2, 1 / 3])
    for axes, wall, title in zip(every, ("exact", "stairs"), ("smooth walls", "faces of voxels")):
        k, truth = np.array(rows[wall]["k"].split(), float), float(rows[wall]["truth"])
        value, bar, *_ = extrapolate(spacings, k, EDGE if wall == "stairs" else None,
                                     usual=usual_error(k[-1], porosity, spacings[-1]),
                                     flux=float(rows[wall]["flux"].split()[-1]) if wall == "exact" else 0.0)
        axes.axhline(truth, color=GREY, lw=1, ls="--")
        axes.plot(spacings, k, "o-", color=FLUID, ms=5, lw=0.8)
        axes.errorbar([0.0 if wall == "stairs" else spacings[-1]], [value], [bar], color=DUMMY, capsize=4, lw=1.4,
                      marker="s", ms=4, zorder=4)
        axes.set(xlabel="spacing over that of the voxels", xlim=(-0.06, 1.06), title=title)
        axes.spines[["top", "right"]].set_visible(False)
    every[0].set(ylabel="k, voxel²")
    return figure


def time_step() -> Figure:
    """Move, predict, project: of a vortex, by the operators themselves."""
    figure, every = panels(4, 7.6, 2.2)
    n = 6
    lattice = (np.stack(np.meshgrid(*[np.arange(n)] * 2), axis=-1).reshape(-1, 2) + 0.5) / n
    old = wrap(lattice + np.random.default_rng(1).uniform(-0.15, 0.15, lattice.shape) / n, np.zeros(2), np.ones(2),
               [True, True])

    def vortex(x: np.ndarray) -> np.ndarray:
        a, b = 2 * np.pi * x.T
        return np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)], axis=1)

    new = old + 0.07 * vortex(old)
    x = wrap(new, np.zeros(2), np.ones(2), [True, True])
    ops = periodic_operators(x, 1 / n)
    guess = vortex(x) + 0.5 * np.stack([np.cos(2 * np.pi * x[:, 0]), np.cos(2 * np.pi * x[:, 1])], axis=1)
    minus_lap = assemble(ops.start, ops.column, ops.lap, 0.0, 1.0).toarray()
    q = np.linalg.lstsq(minus_lap, -divergence(ops, guess))[0]  # the constant is free
    push = -ops.gradient_p(q)
    words = ("1, 2  move: x, xⁿ⁺¹", "3  predict: u*, ∇·u*", "4  project: q, −∇q", "uⁿ⁺¹ = u* − ∇q Δt / g₀ρ")
    for axes, title in zip(every, words):
        axes.set(xlim=(-0.06, 1.06), ylim=(-0.06, 1.06), title=title)
        axes.add_patch(Polygon([(0, 0), (1, 0), (1, 1), (0, 1)], fill=False, ec=GREY, lw=0.6))
    dots(every[0], old, GREY, 3.5, hollow=True)
    ways = Path.make_compound_path(*map(Path, np.stack([old, new], axis=1)))
    every[0].add_patch(PathPatch(ways, fill=False, ec=GREY, lw=0.7))
    dots(every[0], new, FLUID, 3.5)
    most = abs(divergence(ops, guess)).max()
    for axes, values, largest, vectors, scale in (
            (every[1], divergence(ops, guess), most, guess, 11), (every[2], q, abs(q).max(), push, 5.5),
            (every[3], divergence(ops, guess + push), most, guess + push, 11)):
        axes.scatter(*x.T, c=values, cmap="coolwarm", s=42, lw=0, vmin=-largest, vmax=largest)
        axes.quiver(*x.T, *vectors.T, color=INK, width=0.009, scale=scale, zorder=4, headwidth=4, headlength=4)
    return figure


def aggregates() -> Figure:
    """Particles of a pore space, and those that the multigrid joins to one unknown of its next level."""
    figure, (axes,) = panels(1, 3.6, 3.6)
    geometry, particles = disk_scene(0.3, 22)
    x = particles.x[: particles.n_fluid]
    ops, _, _ = WallScene(geometry, particles.x[len(x):], SUPPORT / 22, WENDLAND_C2, particles.site_volume).configure(x)
    levels = hierarchy(assemble(ops.start, ops.column, ops.lap_p, 0.0, 1.0))
    joined = np.asarray(abs(levels.levels[0].P).argmax(axis=1)).ravel()
    axes.add_patch(Circle((0.5, 0.5), 0.3, color=SOLID, lw=0))
    colours = (FLUID, DUMMY, "#66a182", OTHER, "#8d6b94", "#3c3c3c")
    points: dict[str, list[np.ndarray]] = {colour: [] for colour in colours}
    for k, number in enumerate(np.unique(joined)):
        own, colour = x[joined == number], colours[k % len(colours)]
        own = own - np.round(own - own[0])  # across the periodic faces
        for shift in np.unique(np.concatenate([[[0, 0]], np.floor(own)]), axis=0):
            here = own - shift
            inside = ((here > 0) & (here < 1)).all(axis=1)
            if not inside.any():
                continue
            if len(here) > 2:
                hull = here[ConvexHull(here, qhull_options="QJ").vertices]
                axes.add_patch(Polygon(hull, color=colour, alpha=0.35, lw=4, joinstyle="round"))
            points[colour].append(here[inside])
    for colour, found in points.items():
        dots(axes, np.concatenate(found), colour, 2.6)
    axes.set(xlim=(0, 1), ylim=(0, 1), title=f"{len(x)} particles, {len(np.unique(joined))} aggregates")
    return figure


def interface_crossing() -> Figure:
    """Two unlike particles, their depths, and where the pair crosses the interface."""
    figure, (axes,) = panels(1, 4.2, 3.0)
    step, slope = 1.0, np.array([0.35, 1.0]) / np.hypot(0.35, 1.0)
    rng = np.random.default_rng(4)
    x = np.stack(np.meshgrid(np.arange(8), np.arange(6)), axis=-1).reshape(-1, 2) * step
    x = x + rng.uniform(-0.16, 0.16, x.shape)
    depth = (x - [3.5, 2.4]) @ slope  # > 0 above
    ends = np.array([[-0.6, 2.4 + 4.1 * 0.35], [7.6, 2.4 - 4.1 * 0.35]])
    axes.add_patch(Polygon([*ends, (7.6, -0.6), (-0.6, -0.6)], color=PALE, lw=0))
    axes.plot(*ends.T, color=INK, lw=1)
    dots(axes, x[depth < 0], FLUID, 5)
    dots(axes, x[depth > 0], OTHER, 5)
    i = int(np.argmin(np.linalg.norm(x - [3, 1], axis=1)))
    j = int(np.argmin(np.linalg.norm(x - [5, 3], axis=1)))
    t = depth[i] / (depth[i] - depth[j])
    meet = x[i] + t * (x[j] - x[i])
    axes.plot(*x[[i, j]].T, color=INK, lw=1.2)
    for k, name, side in ((i, "dᵢ", -1), (j, "dⱼ", 1)):
        foot = x[k] - depth[k] * slope
        axes.plot(*np.stack([x[k], foot]).T, color=INK, lw=0.9, ls=":")
        axes.text(*((x[k] + foot) / 2 + [0.12 * side, 0]), name, ha="left" if side > 0 else "right", va="center")
    dots(axes, meet[None], INK, 4.5)
    axes.text(*(meet + [0.1, 0.14]), "t", ha="right", va="bottom", fontsize=11)
    axes.text(*(x[i] + [-0.1, -0.14]), "i", ha="right", va="top", fontsize=11)
    axes.text(*(x[j] + [0.14, 0.1]), "j", va="bottom", fontsize=11)
    axes.set(xlim=(-0.6, 7.6), ylim=(-0.6, 5.6), title="t = dᵢ / (dᵢ + dⱼ)")
    return figure


def contact_angle() -> Figure:
    """A drop on a wall: the asked angle, and the normal of the interface where it meets the wall."""
    figure, (axes,) = panels(1, 4.6, 3.0)
    theta, contact = np.radians(60.0), np.array([0.0, 0.0])
    radius = 5.0
    centre = contact + radius * np.array([-np.sin(theta), -np.cos(theta)])  # the first fluid is on the left
    x = np.stack(np.meshgrid(np.arange(-6, 6) + 0.5, np.arange(-3, 5) + 0.5), axis=-1).reshape(-1, 2)
    above = x[:, 1] > 0
    drop = above & (np.linalg.norm(x - centre, axis=1) < radius)
    along = np.array([np.cos(theta), -np.sin(theta)])  # the tangent of the interface at the wall, into the wall
    normal = np.array([-np.sin(theta), -np.cos(theta)])  # into the first fluid
    axes.axhspan(-3.2, 0, color=SOLID, lw=0)
    arc = np.linspace(np.pi / 2 - theta, np.pi / 2 + 0.35, 30)
    axes.plot(centre[0] + radius * np.cos(arc), centre[1] + radius * np.sin(arc), color=INK, lw=1.3)
    axes.plot(*np.stack([contact, contact + 3.2 / np.sin(theta) * along]).T, color=INK, lw=1.1, ls="--")
    dots(axes, x[drop], FLUID, 5)
    dots(axes, x[above & ~drop], OTHER, 5)
    dots(axes, x[~above], INK, 5, hollow=True)
    arrow(axes, contact, contact + 1.6 * normal, DUMMY)
    turn = np.linspace(np.pi - theta + np.arcsin(1.9 / (2 * radius)), np.pi, 16)
    axes.plot(1.9 * np.cos(turn), 1.9 * np.sin(turn), color=INK, lw=0.9)
    axes.text(-1.0, 0.6, "θ", fontsize=11, ha="center", va="center")
    arrow(axes, np.array([4.0, 0.0]), np.array([4.0, 1.4]))
    axes.text(4.15, 1.1, "p", fontsize=11)
    arrow(axes, np.array([4.0, 0.0]), np.array([2.6, 0.0]))
    axes.text(2.5, 0.1, "t", fontsize=11, ha="right")
    axes.set(xlim=(-6, 6), ylim=(-3.2, 5))
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {function.__name__: function for function in (
    kernel_and_support, pair_weights, wall_crossing, surface_of_labels, ends_of_images, time_step,
    neighbourhood_classes, error_bars, aggregates, interface_crossing, contact_angle)}


def short(svg: str) -> str:
    """An SVG with a hundredth of a point as its last digit (of numbers below one, as of scales, 1e-4),
    the style of equal markers written once, and without the comments of its writer."""
    svg = re.sub(r"<!--.*?-->\n?|<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"-?\d+\.\d{3,}", lambda found: rounded(float(found[0])), svg)
    svg = re.sub(r"<g ([^>]*)>\s*((?:<use [^>]*/>\s*){2,})</g>", once, svg)
    return re.sub(r"\s*\n\s*", "\n", svg)


def rounded(number: float) -> str:
    """A number of an SVG."""
    return f"{number:.2f}".rstrip("0").rstrip(".") if abs(number) >= 1 else f"{number:.4f}".rstrip("0").rstrip(".")


def once(group: re.Match[str]) -> str:
    """A group of markers with the style that they share."""
    styles = set(re.findall(r' style="[^"]*"', group[2]))
    if len(styles) != 1:
        return group[0]
    (style,) = styles
    return f"<g {group[1]}{style}>\n{group[2].replace(style, '')}</g>"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[[], *FIGURES], metavar="NAME")
    parser.add_argument("--png", type=pathlib.Path)
    asked = parser.parse_args()
    matplotlib.rcParams.update(STYLE)
    for name in asked.names or FIGURES:
        figure, path = FIGURES[name](), HERE / f"{name}.svg"
        figure.savefig(path, metadata={"Date": None})
        path.write_text(short(path.read_text(encoding="utf-8")), encoding="utf-8")
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
        if asked.png:
            figure.savefig(asked.png / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main()
