"""Pictures in three dimensions: rock cut open with streamlines, the shear at its walls, two fluids and their interface.

VTK draws them in a process of its own (`python -m isphcli.output.render`): what a graphics driver does to that one, a
crash or a hang, leaves the run and its results alone. Title, scales and captions are drawn by `plots`.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .plots import COLOURS, MOST_ASKED, PHASES, Frame, PictureKey, frame_picture, prefix

if TYPE_CHECKING:
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
AXES = ("#ff6347", "#2e8b57", "#0000ff")
FAR = 1000.0  # cells: distance from walls of points beyond the box, so that the surface of rock ends at the box
ENOUGH = 2000  # points whose distances from their neighbours give the median of all
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
    """As `make_grid` for particles of one fluid on a lattice, without a search: linear between the sites, of which
    those without a particle do not count. None of others, and of a grid that is finer than the lattice. Arguments as of
    `scene_of`; cell: edge of the cells, m.

    The sites around a point are those of one cube of the lattice, which walls of a spacing or more do not cross.
    """
    from .grid import Grid, GridCells

    sites, cells = GridCells.of(geometry, spacing), GridCells.of(geometry, spacing, cell)
    place = (particles["x"] - geometry.lower) / sites.edges - 0.5
    index = np.rint(place).astype(int)
    if ("phase" in particles or np.any(cells.counts > sites.counts) or np.abs(place - index).max(initial=0.0) > 1e-6
            or np.any(index < 0) or np.any(index >= sites.counts)):
        return None
    known = np.zeros((*sites.shape, 4), np.float32)  # velocity, and 1 where there is a particle
    known[tuple(index.T[::-1])] = np.column_stack([particles["velocity"], np.ones(len(index))])
    for axis, (n, m) in enumerate(zip(sites.shape, cells.shape)):
        if n != m:
            at = (np.arange(m) + 0.5) * n / m - 0.5
            low = np.clip(at.astype(int), 0, max(n - 2, 0))
            share = (at - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(4)])
            known = (1.0 - share) * known.take(low, axis) + share * known.take(np.minimum(low + 1, n - 1), axis)
    solid = np.ones(cells.shape, np.uint8)
    for layer, flags in enumerate(solid):  # one at a time: bounds the memory
        number = layer * flags.size + np.arange(flags.size)
        flags[:] = (geometry.phase(geometry.lower + cells.middles(number)) < 0).reshape(flags.shape)
    velocity = known[..., :3] / np.maximum(known[..., 3:], np.float32(1e-6))
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


def render(scene: Scene3D, frame: Frame, targets: Mapping[str, str | os.PathLike],
           names: Sequence[str] = ("", "")) -> None:
    """Draw pictures of a scene. targets: {FLOW, SHEAR or FLUIDS: file}; names: of the fluids, for FLUIDS.

    Raises RenderError, and leaves no picture, where VTK is not installed or cannot draw here.
    """
    with tempfile.TemporaryDirectory(prefix="isph-render-") as folder:
        facts = _hand_over(scene, list(targets), Path(folder))
        for name, path in targets.items():
            image = np.load(Path(folder, f"{name}.npy"), allow_pickle=False)
            frame_picture(path, image, frame, _key_of(name, facts[name], names, frame, scene.body))


def draw_images(scene: Scene3D, names: Sequence[str]) -> dict[str, np.ndarray]:
    """The bare pictures, (height, width, 3) uint8, by name. Raises RenderError."""
    with tempfile.TemporaryDirectory(prefix="isph-render-") as folder:
        _hand_over(scene, names, Path(folder))
        return {name: np.load(Path(folder, f"{name}.npy"), allow_pickle=False) for name in names}


def _hand_over(scene: Scene3D, names: Sequence[str], folder: Path) -> dict[str, Any]:
    """Lets the other process draw `<name>.npy` into a folder; returns what it says of them."""
    arrays: dict[str, Any] = {"lower": scene.lower, "cell": scene.cell, "wall": scene.wall.astype(np.float32),
              "velocity": scene.velocity.astype(np.float32), "axis": np.array(scene.axis), "body": np.array(scene.body)}
    if scene.phase is not None:
        arrays["phase"] = scene.phase.astype(np.float32)
    if scene.shear is not None:
        arrays["shear"], arrays["stress"] = _shear_on_grid(scene), scene.shear[1]
    arrays |= {f"map_{name}": _colour_map(name) for name in (LINES_MAP, STRESS_MAP)}
    np.savez(folder / "scene.npz", **arrays)
    command = [sys.executable, "-W", "ignore", "-m", "isphcli.output.render", str(folder), *names]
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    # windows of another machine's screen are not for pictures in files
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"PYTHONPATH": path}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=SECONDS * len(names),
                              check=False)
    except subprocess.TimeoutExpired:
        raise RenderError(f"it took more than {SECONDS:g} s") from None
    except OSError as error:
        raise RenderError(str(error)) from None
    answer = folder / "facts.json"
    if done.returncode or not answer.is_file():
        said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        raise RenderError(said[-1] if said else f"it ended with code {done.returncode}")
    return json.loads(answer.read_text(encoding="utf-8"))


def _shear_on_grid(scene: Scene3D) -> np.ndarray:
    """[z, y, x] Pa: shear at the points of the grid that a wall is beside, of the four particles that are next, with
    the inverse squares of the distances as weights; elsewhere zero."""
    from scipy.spatial import cKDTree

    assert scene.shear is not None
    points, stress = scene.shear
    beside = np.zeros(scene.wall.shape, bool)
    for axis in range(3):
        low, high = (tuple(part if a == axis else slice(None) for a in range(3))
                     for part in (slice(-1), slice(1, None)))
        between = (scene.wall[low] < 0.0) != (scene.wall[high] < 0.0)
        beside[low] |= between
        beside[high] |= between
    tree = cKDTree(points)
    some = points[:: max(len(points) // ENOUGH, 1)]
    apart = float(np.median(tree.query(some, k=2)[0][:, 1])) if len(points) > 1 else float(scene.cell.max())
    # of the walls of pockets without particles nothing is known: they are shown without shear
    places = scene.lower + (np.stack(np.nonzero(beside)[::-1], axis=1) + 0.5) * scene.cell
    away, near = tree.query(places, k=4, distance_upper_bound=3.0 * apart)
    weight = np.where(np.isfinite(away), 1.0 / np.maximum(away, 0.1 * apart) ** 2, 0.0)
    shear = np.zeros(beside.shape, np.float32)
    shear[beside] = (weight * np.append(stress, 0.0)[near]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
    return shear


def _colour_map(name: str) -> np.ndarray:
    """(256, 4) uint8; here, as the other process would take longer to import matplotlib than to draw."""
    from matplotlib import colormaps

    return colormaps[name](np.arange(256), bytes=True)


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
# By the modules of VTK alone: pyvista, with what it imports, took longer than a picture.


def main(folder: Path, names: Sequence[str]) -> None:
    """Draws the pictures of the scene in a folder into it."""
    # what draws is there once these are imported
    import vtkmodules.vtkRenderingFreeType  # noqa: F401
    import vtkmodules.vtkRenderingOpenGL2  # noqa: F401
    from vtkmodules.vtkCommonCore import vtkLogger, vtkObject

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    vtkObject.GlobalWarningDisplayOff()
    with np.load(folder / "scene.npz", allow_pickle=False) as arrays:
        shear = (arrays["shear"], arrays["stress"]) if "stress" in arrays else None
        maps = {name: arrays[f"map_{name}"] for name in (LINES_MAP, STRESS_MAP)}
        scene = Scene3D(arrays["lower"], arrays["cell"], arrays["wall"], arrays["velocity"], int(arrays["axis"]),
                        arrays["phase"] if "phase" in arrays else None, shear, int(arrays["body"]))
    drawn = {FLOW: _draw_flow, SHEAR: _draw_shear, FLUIDS: _draw_fluids}
    window, facts = _Window(scene, maps), {}
    for name in names:
        window.clear()
        facts[name] = drawn[name](window, scene)
        np.save(folder / f"{name}.npy", window.picture())
    (folder / "facts.json").write_text(json.dumps(facts), encoding="utf-8")


class _Window:
    """A window without a screen, with the edges of the box of a scene and the directions of its axes: one for all
    pictures, whose shaders are compiled once. maps: {name: (256, 4) uint8}."""

    def __init__(self, scene: Scene3D, maps: Mapping[str, np.ndarray]):
        from vtkmodules.vtkRenderingCore import vtkLightKit, vtkRenderer, vtkRenderWindow

        self.maps, self.window, self.renderer, self.corner = maps, vtkRenderWindow(), vtkRenderer(), vtkRenderer()
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(0)
        self.renderer.UseFXAAOn()
        self.window.SetSize(*SIZE)
        self.window.SetNumberOfLayers(2)
        for renderer in (self.renderer, self.corner):
            self.window.AddRenderer(renderer)
        self.renderer.SetBackground(1.0, 1.0, 1.0)
        self.renderer.AutomaticLightCreationOff()
        vtkLightKit().AddLightsToRenderer(self.renderer)
        self.lower, self.upper = scene.lower, scene.lower + scene.cell * np.array(scene.wall.shape[::-1])
        self._look(scene.axis)
        self._draw_axes()

    def _look(self, axis: int) -> None:
        """Where it is seen from."""
        normal, up = _across(axis)
        side = -1.0 if normal == 1 else 1.0
        turn, height = math.radians(28.0), math.radians(22.0)
        other = next(a for a in range(3) if a not in (normal, up))
        towards, view_up = np.zeros(3), np.zeros(3)
        towards[normal] = side * math.cos(height) * math.cos(turn)
        towards[other] = math.cos(height) * math.sin(turn)
        towards[up] = math.sin(height)
        view_up[up] = 1.0
        middle = (self.lower + self.upper) / 2
        for renderer, focus in ((self.renderer, middle), (self.corner, np.zeros(3))):
            camera = renderer.GetActiveCamera()
            camera.SetFocalPoint(*focus)
            camera.SetPosition(*(focus + 2.2 * float(np.linalg.norm(self.upper - self.lower)) * towards))
            camera.SetViewUp(*view_up)
        camera = self.renderer.GetActiveCamera()
        camera.SetViewAngle(26.0)
        self.renderer.ResetCamera([v for pair in zip(self.lower, self.upper) for v in pair])
        camera.Zoom(0.98)

    def _draw_axes(self) -> None:
        """The directions of the axes, in a corner."""
        from vtkmodules.vtkRenderingAnnotation import vtkAxesActor

        axes = vtkAxesActor()
        for name, colour in zip("XYZ", AXES):
            for part, width in (("Shaft", 3.0), ("Tip", 1.0)):
                look = getattr(axes, f"Get{name}Axis{part}Property")()
                look.SetColor(*_rgb(colour))
                look.SetAmbient(0.5)
                look.SetLineWidth(width)
            getattr(axes, f"Get{name}AxisCaptionActor2D")().GetCaptionTextProperty().SetColor(0.0, 0.0, 0.0)
            getattr(axes, f"Get{name}AxisCaptionActor2D")().GetCaptionTextProperty().ShadowOff()
        axes.SetShaftTypeToLine()
        self.corner.SetLayer(1)
        self.corner.SetViewport(0.0, 0.0, 0.2, 0.2)
        self.corner.AddViewProp(axes)
        self.corner.ResetCamera()

    def clear(self) -> None:
        """Nothing is left but the edges of the box."""
        from vtkmodules.vtkFiltersSources import vtkCubeSource

        self.renderer.RemoveAllViewProps()
        box = vtkCubeSource()
        box.SetBounds([v for pair in zip(self.lower, self.upper) for v in pair])
        box.Update()
        look = self.add(box.GetOutput(), "#8f8b84", ambient=0.0).GetProperty()
        look.SetRepresentationToWireframe()
        look.LightingOff()
        look.SetLineWidth(2.0)

    def add(self, surface: Any, colour: str, specular: float = 0.0, ambient: float = 0.35) -> Any:
        """Adds a surface (vtkPolyData) in one colour; returns what draws it."""
        from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

        mapper, actor = vtkPolyDataMapper(), vtkActor()
        mapper.SetInputData(surface)
        mapper.ScalarVisibilityOff()
        actor.SetMapper(mapper)
        look = actor.GetProperty()
        look.SetColor(*_rgb(colour))
        look.SetInterpolationToFlat()
        look.SetSpecular(specular)
        look.SetSpecularPower(100.0)
        look.SetAmbient(ambient)
        self.renderer.AddActor(actor)
        return actor

    def add_scaled(self, surface: Any, values: np.ndarray, top: float, colours: str, specular: float = 0.0) -> Any:
        """As `add`, in the colours of a map. values: (m,) of the points, from zero to `top`."""
        from vtkmodules.vtkCommonCore import vtkLookupTable

        table = vtkLookupTable()
        table.SetTable(_vtk_array("colours", self.maps[colours]))
        table.SetTableRange(0.0, top)
        surface.GetPointData().SetScalars(_vtk_array("shown", values))
        actor = self.add(surface, "#ffffff", specular, ambient=0.4)
        mapper = actor.GetMapper()
        mapper.ScalarVisibilityOn()
        mapper.SetLookupTable(table)
        mapper.SetScalarRange(0.0, top)
        mapper.InterpolateScalarsBeforeMappingOn()
        return actor

    def picture(self) -> np.ndarray:
        """(height, width, 3) uint8."""
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter

        self.renderer.ResetCameraClippingRange()
        grab = vtkWindowToImageFilter()
        grab.SetInput(self.window)
        grab.SetInputBufferTypeToRGB()
        grab.ReadFrontBufferOff()
        grab.Update()
        return vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars()).reshape(*SIZE[::-1], 3)[::-1]


def _rgb(colour: str) -> list[float]:
    return [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]


def _vtk_array(name: str, values: np.ndarray) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtk

    found = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    found.SetName(name)
    return found


def _image(scene: Scene3D, lower: np.ndarray, arrays: Mapping[str, np.ndarray]) -> Any:
    """Image data of points. lower: (3,) m, the first point; arrays: {name: [z, y, x] or [z, y, x, 3]}."""
    from vtkmodules.vtkCommonDataModel import vtkImageData

    image = vtkImageData()
    image.SetDimensions(*next(iter(arrays.values())).shape[2::-1])
    image.SetSpacing(*scene.cell)
    image.SetOrigin(*lower)
    for name, values in arrays.items():
        image.GetPointData().AddArray(_vtk_array(name, values.reshape(-1, *values.shape[3:])))
    return image


def _across(axis: int) -> tuple[int, int]:
    """(axis that the cut is normal to, axis that points up) for a flow along an axis."""
    return {0: (1, 2), 1: (0, 2), 2: (1, 2)}[axis]


def _surface(scene: Scene3D, lower: np.ndarray, wall: np.ndarray, shear: np.ndarray | None = None) -> Any:
    """The surface where the distance from walls is zero, which ends at the outermost points. wall, shear: [z, y, x];
    the latter is carried over to the points of the surface."""
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    image = _image(scene, lower, {"wall": wall} | ({} if shear is None else {"shear": shear}))
    image.GetPointData().SetActiveScalars("wall")
    contour = vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, 0.0)
    contour.ComputeNormalsOff()
    contour.ComputeScalarsOff()
    contour.SetInterpolateAttributes(shear is not None)
    contour.Update()
    return contour.GetOutput()


def _draw_rock(window: _Window, scene: Scene3D) -> None:
    """The solid behind the cut: half of the grid, seen from the lower side of y and from the upper side of x."""
    normal = _across(scene.axis)[0]
    half = scene.wall.shape[2 - normal] // 2
    kept = [slice(None)] * 3
    kept[2 - normal] = slice(half, None) if normal == 1 else slice(half + 1)
    back, lower = scene.wall[tuple(kept)], scene.lower - 0.5 * scene.cell
    if normal == 1:
        lower[1] += half * scene.cell[1]
    if float(back.min()) >= 0.0:
        return
    # a layer far from all walls closes the surface a thousandth of a cell outside the outermost points
    window.add(_surface(scene, lower, np.pad(back, 1, constant_values=FAR)), ROCK)


def _draw_flow(window: _Window, scene: Scene3D) -> dict[str, Any]:
    """Rock cut open, streamlines coloured by the root of the speed: of rock most of it is far below the fastest. The
    top of the scale is what 99 % of the points of lines are below."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTubeFilter

    _draw_rock(window, scene)
    lines = _streamlines(scene)
    if lines is None:
        return {"top": 1.0}
    top = float(np.quantile(vtk_to_numpy(lines.GetPointData().GetArray("speed")), 0.99)) or 1.0
    tube = vtkTubeFilter()
    tube.SetInputData(lines)
    tube.SetRadius(0.0018 * float(np.linalg.norm(window.upper - window.lower)))
    tube.SetNumberOfSides(8)
    tube.CappingOn()
    tube.Update()
    tubes = tube.GetOutput()
    root = np.sqrt(vtk_to_numpy(tubes.GetPointData().GetArray("speed")))
    window.add_scaled(tubes, root, math.sqrt(top), LINES_MAP, specular=0.1).GetProperty().SetInterpolationToPhong()
    return {"top": top}


def _streamlines(scene: Scene3D) -> Any:
    """Streamlines both ways from points in the fluid, the more the faster it is there; None where nothing flows."""
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkPolyData
    from vtkmodules.vtkFiltersFlowPaths import vtkStreamTracer

    norm = np.linalg.norm(scene.velocity, axis=-1)
    speed = np.where(scene.wall > 0.0, norm, 0.0).ravel().astype(float)
    if not speed.max() > 0.0:
        return None
    some = np.random.default_rng(0).choice(len(speed), min(LINES, int((speed > 0.0).sum())), False, speed / speed.sum())
    places = np.stack(np.unravel_index(np.sort(some), scene.wall.shape)[::-1], axis=1)
    seeds, points = vtkPolyData(), vtkPoints()
    points.SetData(_vtk_array("seeds", scene.lower + (places + 0.5) * scene.cell))
    seeds.SetPoints(points)
    length = float(np.linalg.norm(scene.cell * np.array(scene.wall.shape[::-1])))
    tracer = vtkStreamTracer()
    tracer.SetInputData(_image(scene, scene.lower + 0.5 * scene.cell, {"velocity": scene.velocity, "speed": norm}))
    tracer.SetSourceData(seeds)
    tracer.SetInputArrayToProcess(0, 0, 0, 0, "velocity")  # of points
    tracer.SetIntegratorTypeToRungeKutta4()
    tracer.SetIntegrationDirectionToBoth()
    tracer.SetIntegrationStepUnit(2)  # cells
    tracer.SetInitialIntegrationStep(0.3)
    tracer.SetMaximumPropagation(4.0 * length)
    tracer.SetMaximumNumberOfSteps(20_000)
    tracer.SetTerminalSpeed(1e-5 * float(speed.max()))
    tracer.SetComputeVorticity(False)
    tracer.Update()
    lines = tracer.GetOutput()
    return lines if lines.GetNumberOfPoints() else None


def _draw_shear(window: _Window, scene: Scene3D) -> dict[str, Any]:
    """All walls, without the rock behind them, coloured by the shear of the particles beside them."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    assert scene.shear is not None
    shear, stress = scene.shear
    walls = _surface(scene, scene.lower + 0.5 * scene.cell, scene.wall, shear)
    top = float(np.quantile(stress, 0.98)) or 1.0
    if walls.GetNumberOfPoints():
        window.add_scaled(walls, vtk_to_numpy(walls.GetPointData().GetArray("shear")), top, STRESS_MAP)
    return {"top": top}


def _draw_fluids(window: _Window, scene: Scene3D) -> dict[str, Any]:
    """Rock cut open, one fluid as a body and the interface as a surface; the other fluid is what is left."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkFiltersGeneral import vtkTableBasedClipDataSet
    from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter

    assert scene.phase is not None
    _draw_rock(window, scene)
    body = _image(scene, scene.lower + 0.5 * scene.cell, {"wall": scene.wall, "phase": scene.phase})
    for name, value in (("wall", 0.0), ("phase", 0.5)):
        clip = vtkTableBasedClipDataSet()
        clip.SetInputData(body)
        clip.SetInputArrayToProcess(0, 0, 0, 0, name)  # of points
        clip.SetValue(value)
        clip.Update()
        body = clip.GetOutput()
    surface, triangles = vtkDataSetSurfaceFilter(), vtkTriangleFilter()
    surface.SetInputData(body)
    triangles.SetInputConnection(surface.GetOutputPort())
    triangles.PassLinesOff()
    triangles.PassVertsOff()
    triangles.Update()
    skin = triangles.GetOutput()
    if skin.GetNumberOfPolys():
        corners = vtk_to_numpy(skin.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        of_each = vtk_to_numpy(skin.GetPointData().GetArray("phase"))[corners]
        front = of_each.max(axis=1) < 0.5 + 1e-4  # the other cells are where the fluid ends at walls or at the box
        for some, colour in ((~front, PHASES[scene.body]), (front, COLOURS[1])):
            if some.any():
                window.add(_part(skin, corners[some]), colour, specular=0.1)
    return {}


def _part(surface: Any, corners: np.ndarray) -> Any:
    """Triangles (m, 3) between the points of a surface."""
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    part, cells = vtkPolyData(), vtkCellArray()
    cells.SetData(_vtk_array("first", 3 * np.arange(len(corners) + 1)), _vtk_array("corners", corners.ravel()))
    part.SetPoints(surface.GetPoints())
    part.SetPolys(cells)
    return part


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
