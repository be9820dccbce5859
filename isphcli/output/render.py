"""Pictures in three dimensions: rock cut open with streamlines, the shear at its walls, two fluids and their interface.

pyvista draws them in a process of its own (`python -m isphcli.output.render`): what a graphics driver does to that one,
a crash or a hang, leaves the run and its results alone. Title, scales and captions are drawn by `plots`.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .plots import COLOURS, MOST_ASKED, PHASES, Frame, PictureKey, frame_picture, prefix

if TYPE_CHECKING:
    import pyvista

    from ..geometry.protocol import Geometry
    from .grid import Grid

LEAST_ACROSS = 8  # spacings along every axis of the box: of less, a picture in 3D shows no more than a slice
MOST_CELLS = 1_000_000  # of the grid that is drawn; bounds the time of a picture to some seconds
FEW = 50_000  # particles, up to which the grid is finer than they are
LINES = 150  # streamlines
SIZE = (1500, 1100)  # pixels
SECONDS = 120.0  # that a picture may take
FLOW, SHEAR, FLUIDS = "flow_3d", "wall_shear_3d", "fluids_3d"
ROCK = "#d9d6d0"
LINES_MAP, STRESS_MAP = "turbo", "viridis"  # neither has a colour that is lost before grey rock or on white


class RenderError(RuntimeError):
    """Pictures that could not be drawn: why."""


@dataclass(frozen=True)
class Scene3D:
    """What is drawn: arrays of points in the middles of the cells of a grid.

    lower, cell: (3,) m, corner of the box and edges of a cell; wall: [z, y, x] distance from walls in cells, negative
    in solids; velocity: [z, y, x, 3] m/s; phase: [z, y, x] share of the fluid that is drawn as a body, 0 to 1, or None
    with one fluid; axis: of the flow; shear: (points (m, 3) m, stress (m,) Pa) beside walls, or None; body: number of
    that fluid, 0 or 1.
    """

    lower: np.ndarray
    cell: np.ndarray
    wall: np.ndarray
    velocity: np.ndarray
    axis: int
    phase: np.ndarray | None = None
    shear: tuple[np.ndarray, np.ndarray] | None = None
    body: int = 1


def deep_enough(geometry: Geometry, spacing: float) -> bool:
    """Whether a scene is three-dimensional with enough to see along every axis."""
    return geometry.dim == 3 and bool(np.all(geometry.upper - geometry.lower >= (LEAST_ACROSS - 0.5) * spacing))


def scene_of(geometry: Geometry, particles: Mapping[str, np.ndarray], spacing: float, axis: int,
             shear: tuple[np.ndarray, np.ndarray] | None = None, body: int | None = None) -> Scene3D:
    """The scene of some particles: `x`, `velocity` (n, 3) and, of two fluids, `phase` (n,). spacing: m, of them; body:
    the fluid to draw as a body, or None: that which covers less of the faces of the box; it hides less of the other.
    """
    from .grid import make_grid

    size = geometry.upper - geometry.lower
    # half a spacing where few particles would draw round walls as polygons
    fine = 0.5 * spacing if np.prod(size / spacing) < FEW else spacing
    cell = max(fine, float(np.prod(size) / MOST_CELLS) ** (1.0 / 3.0))
    fields = {"velocity": particles["velocity"]}
    if "phase" in particles:  # as a number: between the particles of both it goes over from one to the other
        fields["second"] = (particles["phase"] == 1).astype(float)
    grid = _from_lattice(geometry, particles, spacing, cell)
    if grid is None:
        grid = make_grid(geometry, particles["x"], fields, spacing, cell)
    solid = grid.arrays["solid"].astype(bool)
    phase = grid.arrays.get("second")
    if phase is not None:
        if body is None:
            body = 1 if _share_of_faces(phase, ~solid) <= 0.5 else 0
        phase = _spread(phase if body == 1 else 1.0 - phase, ~solid)
    return Scene3D(np.asarray(grid.lower, float), grid.cell, _depth(geometry, grid.lower, grid.cell, solid),
                   grid.arrays["velocity"], axis, phase, shear, 1 if body is None else body)


def _from_lattice(geometry: Geometry, particles: Mapping[str, np.ndarray], spacing: float,
                  cell: float) -> Grid | None:
    """As `make_grid` for particles of one fluid on a lattice, without a search: linear between the sites, those in
    solids at rest. None of others, and of a grid that is finer than the lattice. Arguments as those of `scene_of`;
    cell: edge of the cells, m.

    Without the sites in solids streamlines would turn back beside walls, where the fluid is at rest.
    """
    from .grid import Grid, GridCells

    sites, cells = GridCells.of(geometry, spacing), GridCells.of(geometry, spacing, cell)
    place = (particles["x"] - geometry.lower) / sites.edges - 0.5
    index = np.rint(place).astype(int)
    if ("phase" in particles or np.any(cells.counts > sites.counts) or np.abs(place - index).max(initial=0.0) > 1e-6
            or np.any(index < 0) or np.any(index >= sites.counts)):
        return None
    velocity = np.zeros((*sites.shape, 3), np.float32)
    velocity[tuple(index.T[::-1])] = particles["velocity"]
    for axis, (n, m) in enumerate(zip(sites.shape, cells.shape)):
        if n != m:
            at = (np.arange(m) + 0.5) * n / m - 0.5
            low = np.clip(at.astype(int), 0, max(n - 2, 0))
            share = (at - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(4)])
            velocity = ((1.0 - share) * velocity.take(low, axis)
                        + share * velocity.take(np.minimum(low + 1, n - 1), axis))
    solid = np.ones(cells.shape, np.uint8)
    for layer, flags in enumerate(solid):  # one at a time: bounds the memory
        number = layer * flags.size + np.arange(flags.size)
        flags[:] = (geometry.phase(geometry.lower + cells.middles(number)) < 0).reshape(flags.shape)
    velocity[solid == 1] = 0.0
    return Grid(cells.lower, cells.edges, {"velocity": velocity, "solid": solid})


def _share_of_faces(second: np.ndarray, fluid: np.ndarray) -> float:
    """Share of the second fluid in the fluid cells at the faces of the box."""
    face = np.ones(fluid.shape, bool)
    face[1:-1, 1:-1, 1:-1] = False
    face &= fluid
    return float(second[face].mean()) if face.any() else 0.0


def _depth(geometry: Geometry, lower: np.ndarray, cell: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Distance from walls in cells [z, y, x], as far as a surface through it needs: exact beside walls where there are
    few enough points there, else by how solid the surroundings are."""
    from scipy.ndimage import binary_dilation, gaussian_filter

    if not geometry.has_solid or not solid.any():
        return np.ones(solid.shape)
    beside = binary_dilation(solid, iterations=2) & binary_dilation(~solid, iterations=2)
    if np.count_nonzero(beside) > MOST_ASKED:
        return 4.0 * (0.5 - gaussian_filter(solid.astype(float), 0.7, mode="nearest"))
    depth = np.where(solid, -2.0, 2.0)
    index = np.stack(np.nonzero(beside)[::-1], axis=1)
    exact = geometry.distance(lower + (index + 0.5) * cell) / float(cell.min())
    depth[beside] = np.clip(exact, -2.0, 2.0)
    return depth


def _spread(share: np.ndarray, fluid: np.ndarray) -> np.ndarray:
    """Share (1 or 0) of a fluid, over a cell or so, carried on into solids: an interface meets walls without a rim."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(fluid.astype(float), 1.0, mode="nearest")
    spread = gaussian_filter(share * fluid, 1.0, mode="nearest") / np.maximum(weight, 1e-6)
    return np.where(weight > 1e-3, spread, 0.0)


# -- what the run calls ------------------------------------------------------------------------------------


@contextlib.contextmanager
def rendering(scene: Scene3D, frame: Frame, targets: Mapping[str, str | os.PathLike],
              names: Sequence[str] = ("", "")) -> Iterator[None]:
    """Draws pictures of a scene while the block goes on; they exist after it. targets: {FLOW, SHEAR or FLUIDS: file};
    names: of the fluids, for FLUIDS.

    Raises RenderError, and leaves no picture, where pyvista is not installed or cannot draw here.
    """
    with _other_process(scene, list(targets)) as (wait, folder):
        yield
        facts = wait()
        for name, path in targets.items():
            image = np.load(folder / f"{name}.npy", allow_pickle=False)
            frame_picture(path, image, frame, _key_of(name, facts[name], names, frame, scene.body))


def draw_images(scene: Scene3D, names: Sequence[str]) -> dict[str, np.ndarray]:
    """The bare pictures, (height, width, 3) uint8, by name. Raises RenderError."""
    with _other_process(scene, names) as (wait, folder):
        wait()
        return {name: np.load(folder / f"{name}.npy", allow_pickle=False) for name in names}


@contextlib.contextmanager
def _other_process(scene: Scene3D, names: Sequence[str]) -> Iterator[tuple[Callable[[], dict[str, Any]], Path]]:
    """Starts the process that draws `<name>.npy` into a folder; yields a function that waits for it and returns what it
    says of the pictures, and the folder. A process that is not waited for is ended with the block."""
    command = [sys.executable, "-W", "ignore", "-m", "isphcli.output.render"]
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    # windows of another machine's screen are not for pictures in files
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"PYTHONPATH": path}
    process: subprocess.Popen[str] | OSError
    with contextlib.ExitStack() as places:
        folder = Path()
        try:  # a full disk too is told by who waits: what the block does needs no other process
            folder = Path(places.enter_context(tempfile.TemporaryDirectory(prefix="isph-render-")))
            np.savez(folder / "scene.npz", **_arrays_of(scene))
            process = subprocess.Popen([*command, str(folder), *names], env=environment, stdout=subprocess.DEVNULL,
                                       stderr=subprocess.PIPE, text=True)
        except OSError as error:
            process = error
        try:
            yield lambda: _answer(process, SECONDS * len(names), folder), folder
        finally:
            if isinstance(process, subprocess.Popen):
                process.kill()
                process.communicate()


def _arrays_of(scene: Scene3D) -> dict[str, Any]:
    arrays: dict[str, Any] = {"lower": scene.lower, "cell": scene.cell, "wall": scene.wall.astype(np.float32),
              "velocity": scene.velocity.astype(np.float32), "axis": np.array(scene.axis), "body": np.array(scene.body)}
    if scene.phase is not None:
        arrays["phase"] = scene.phase.astype(np.float32)
    if scene.shear is not None:
        arrays["points"], arrays["stress"] = scene.shear
    return arrays


def _answer(process: subprocess.Popen[str] | OSError, seconds: float, folder: Path) -> dict[str, Any]:
    """What the process, or the error of its start, says of its pictures, when they are drawn. seconds: to wait."""
    if isinstance(process, OSError):
        raise RenderError(str(process))
    try:
        _, errors = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        raise RenderError(f"it took more than {seconds:g} s") from None
    answer = folder / "facts.json"
    if process.returncode or not answer.is_file():
        said = [line.strip() for line in errors.splitlines() if line.strip()]
        raise RenderError(said[-1] if said else f"it ended with code {process.returncode}")
    return json.loads(answer.read_text(encoding="utf-8"))


def _key_of(name: str, facts: Mapping[str, Any], names: Sequence[str], frame: Frame, body: int) -> PictureKey:
    if name == FLUIDS:
        return PictureKey(colours=[(names[body], PHASES[body]),
                                   (f"{names[1 - body]} (what is left of the pores)", "white"),
                                   ("interface", COLOURS[1])])
    what, unit = ("speed", frame.units[1]) if name == FLOW else ("wall shear", "Pa" if frame.units[1] else "")
    factor, shown = prefix(unit, float(facts["top"]))
    colours, power = (LINES_MAP, 0.5) if name == FLOW else (STRESS_MAP, 1.0)
    return PictureKey(scale=(f"{what}  ({shown})" if shown else what, colours, power, factor * float(facts["top"])))


# -- what the process of the pictures does -----------------------------------------------------------------


def main(folder: Path, names: Sequence[str]) -> None:
    """Draws the pictures of the scene in a folder into it."""
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger, vtkObject

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    vtkObject.GlobalWarningDisplayOff()
    with np.load(folder / "scene.npz", allow_pickle=False) as arrays:
        shear = (arrays["points"], arrays["stress"]) if "stress" in arrays else None
        scene = Scene3D(arrays["lower"], arrays["cell"], arrays["wall"], arrays["velocity"], int(arrays["axis"]),
                        arrays["phase"] if "phase" in arrays else None, shear, int(arrays["body"]))
    drawn = {FLOW: _draw_flow, SHEAR: _draw_shear, FLUIDS: _draw_fluids}
    grid, facts = _grid(pv, scene), {}
    for name in names:
        plotter: Any = pv.Plotter(off_screen=True, window_size=list(SIZE), lighting="light kit")
        plotter.set_background("white")
        facts[name] = drawn[name](pv, plotter, grid, scene)
        _look(pv, plotter, scene)
        image = plotter.screenshot(None, return_img=True)
        plotter.close()
        np.save(folder / f"{name}.npy", np.asarray(image)[..., :3])
    (folder / "facts.json").write_text(json.dumps(facts), encoding="utf-8")


def _grid(pv: Any, scene: Scene3D) -> pyvista.ImageData:
    """Wall distance, velocity and phase as image data of points."""
    counts = scene.wall.shape[::-1]
    grid = pv.ImageData(dimensions=counts, spacing=tuple(scene.cell), origin=tuple(scene.lower + 0.5 * scene.cell))
    grid.point_data["wall"] = scene.wall.ravel()
    grid.point_data["velocity"] = scene.velocity.reshape(-1, 3)
    grid.point_data["speed"] = np.linalg.norm(scene.velocity, axis=-1).ravel()
    if scene.phase is not None:
        grid.point_data["phase"] = scene.phase.ravel()
    return grid


def _across(axis: int) -> tuple[int, int]:
    """(axis that the cut is normal to, axis that points up) for a flow along an axis."""
    return {0: (1, 2), 1: (0, 2), 2: (1, 2)}[axis]


def _back(grid: Any, axis: int) -> Any:
    """The half of the grid behind the cut."""
    counts = grid.dimensions
    extent = [0, counts[0] - 1, 0, counts[1] - 1, 0, counts[2] - 1]
    normal = _across(axis)[0]
    # seen from the lower side of y, and from the upper side of x
    extent[2 * normal + (0 if normal == 1 else 1)] = counts[normal] // 2
    return grid.extract_subset(extent)


def _rock(pv: Any, plotter: Any, grid: Any, axis: int, **look: Any) -> None:
    """The solid behind the cut."""
    back = _back(grid, axis)
    if float(back.point_data["wall"].min()) >= 0.0:
        return
    body = back.clip_scalar(scalars="wall", value=0.0, invert=True).extract_surface()
    if body.n_points:
        plotter.add_mesh(body, **({"color": ROCK, "smooth_shading": False, "specular": 0.0, "ambient": 0.35} | look))


def _draw_flow(pv: Any, plotter: Any, grid: Any, scene: Scene3D) -> dict[str, Any]:
    """Rock cut open, streamlines coloured by the root of the speed: of rock most of it is far below the fastest. The
    top of the scale is what 99 % of the points of lines are below."""
    _rock(pv, plotter, grid, scene.axis)
    lines = _streamlines(pv, grid, scene)
    if lines is None:
        return {"top": 1.0}
    top = float(np.quantile(lines.point_data["speed"], 0.99)) or 1.0
    lines.point_data["root"] = np.sqrt(lines.point_data["speed"])
    radius = 0.0018 * float(np.linalg.norm(scene.cell * np.array(scene.wall.shape[::-1])))
    plotter.add_mesh(lines.tube(radius=radius, n_sides=8), scalars="root", clim=(0.0, math.sqrt(top)),
                     cmap=LINES_MAP, show_scalar_bar=False, smooth_shading=True, specular=0.1, ambient=0.4)
    return {"top": top}


def _streamlines(pv: Any, grid: Any, scene: Scene3D) -> Any:
    """Streamlines both ways from points in the fluid, the more the faster it is there; None where nothing flows."""
    from vtkmodules.vtkFiltersFlowPaths import vtkStreamTracer

    speed = np.where(scene.wall > 0.0, np.linalg.norm(scene.velocity, axis=-1), 0.0).ravel().astype(float)
    if not speed.max() > 0.0:
        return None
    some = np.random.default_rng(0).choice(len(speed), min(LINES, int((speed > 0.0).sum())), False, speed / speed.sum())
    length = float(np.linalg.norm(scene.cell * np.array(scene.wall.shape[::-1])))
    tracer = vtkStreamTracer()
    tracer.SetInputData(grid)
    tracer.SetSourceData(pv.PolyData(np.asarray(grid.points)[np.sort(some)]))
    tracer.SetInputArrayToProcess(0, 0, 0, 0, "velocity")  # of points
    tracer.SetIntegratorTypeToRungeKutta4()
    tracer.SetIntegrationDirectionToBoth()
    tracer.SetIntegrationStepUnit(2)  # cells
    tracer.SetInitialIntegrationStep(0.3)
    tracer.SetMaximumPropagation(4.0 * length)
    tracer.SetMaximumNumberOfSteps(20_000)
    tracer.SetTerminalSpeed(1e-5 * float(speed.max()))
    tracer.Update()
    lines = pv.wrap(tracer.GetOutput())
    return lines if lines.n_points else None


def _draw_shear(pv: Any, plotter: Any, grid: Any, scene: Scene3D) -> dict[str, Any]:
    """All walls, without the rock behind them, coloured by the shear of the particles beside them."""
    from scipy.spatial import cKDTree

    assert scene.shear is not None
    points, stress = scene.shear
    walls = grid.contour([0.0], scalars="wall")
    top = float(np.quantile(stress, 0.98)) or 1.0
    if walls.n_points:
        tree = cKDTree(points)
        apart = float(np.median(tree.query(points, k=2)[0][:, 1])) if len(points) > 1 else float(scene.cell.max())
        # of the walls of pockets without particles nothing is known: they are shown without shear
        away, near = tree.query(np.asarray(walls.points), k=4, distance_upper_bound=3.0 * apart)
        weight = np.where(np.isfinite(away), 1.0 / np.maximum(away, 0.1 * apart) ** 2, 0.0)
        known = np.append(stress, 0.0)[near]
        walls.point_data["stress"] = (weight * known).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
        plotter.add_mesh(walls, scalars="stress", clim=(0.0, top), cmap=STRESS_MAP, show_scalar_bar=False,
                         smooth_shading=False, specular=0.0, ambient=0.4)
    return {"top": top}


def _draw_fluids(pv: Any, plotter: Any, grid: Any, scene: Scene3D) -> dict[str, Any]:
    """Rock cut open, one fluid as a body and the interface as a surface; the other fluid is what is left."""
    _rock(pv, plotter, grid, scene.axis)
    fluid = grid.clip_scalar(scalars="wall", value=0.0, invert=False)
    if not fluid.n_cells:
        return {}
    body = fluid.clip_scalar(scalars="phase", value=0.5, invert=False).extract_surface().triangulate()
    if body.n_cells:
        of_each = np.asarray(body.point_data["phase"])[body.faces.reshape(-1, 4)[:, 1:]]
        front = of_each.max(axis=1) < 0.5 + 1e-4  # the other cells are where the fluid ends at walls or at the box
        for cells, colour in ((~front, PHASES[scene.body]), (front, COLOURS[1])):
            if cells.any():
                plotter.add_mesh(body.extract_cells(cells), color=colour, specular=0.1, ambient=0.35)
    return {}


def _look(pv: Any, plotter: Any, scene: Scene3D) -> None:
    """The box, the directions of the axes and where it is seen from."""
    counts = np.array(scene.wall.shape[::-1])
    lower, upper = scene.lower, scene.lower + scene.cell * counts
    middle, size = (lower + upper) / 2, float(np.linalg.norm(upper - lower))
    box = pv.Box(bounds=[v for pair in zip(lower, upper) for v in pair]).extract_all_edges()
    plotter.add_mesh(box, color="#8f8b84", line_width=2.0)
    normal, up = _across(scene.axis)
    side = -1.0 if normal == 1 else 1.0
    turn, height = math.radians(28.0), math.radians(22.0)
    other = next(a for a in range(3) if a not in (normal, up))
    towards = np.zeros(3)
    towards[normal] = side * math.cos(height) * math.cos(turn)
    towards[other] = math.cos(height) * math.sin(turn)
    towards[up] = math.sin(height)
    view_up = np.zeros(3)
    view_up[up] = 1.0
    plotter.camera.focal_point = tuple(middle)
    plotter.camera.position = tuple(middle + 2.2 * size * towards)
    plotter.camera.up = tuple(view_up)
    plotter.camera.view_angle = 26.0
    plotter.reset_camera(bounds=[v for pair in zip(lower, upper) for v in pair])
    plotter.camera.zoom(0.98)
    plotter.add_axes(line_width=3, labels_off=False)
    plotter.enable_anti_aliasing("msaa", multi_samples=8)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
