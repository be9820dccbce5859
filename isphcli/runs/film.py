"""A film of the snapshots of a run: the fluids where there are two, else the speed of the flow."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.forcing import flow_axis
from ..case.load import load_case
from ..output.files import replacing
from ..output.plots import Frame, plot_phases, plot_slice
from ..output.snapshots import read_series, read_snapshot
from ..scene.build_geometry import build_geometry

if TYPE_CHECKING:
    from PIL.Image import Image

    from ..case.blocks import Case
    from ..geometry.protocol import Geometry

WIDTH = 960  # pixels of a film
BLOCK = 16  # pixels: sides of an mp4 are multiples of it
FORMATS = (".gif", ".mp4")


class FilmError(ValueError):
    """A folder without snapshots for a film, or a file that the film cannot be written to."""


def make_film(directory: Path, target: Path, rate: float = 10.0, view: str = "plane",
              seen: Callable[[int, int], None] | None = None) -> int:
    """Write a film of the snapshots in the folder of a run, whole or not at all; returns the number of its frames.

    target: .gif, or .mp4 (needs imageio with ffmpeg); rate: frames a second; view: "plane" or "3d"; seen: told of each
    frame that is drawn, with how many there are. Raises FilmError; RenderError where nothing can be drawn in 3D.
    """
    if target.suffix.lower() not in FORMATS:
        raise FilmError(f"{target}: '{target.suffix}' films are not written; give {' or '.join(FORMATS)}")
    if not (directory / "case.yaml").is_file():
        raise FilmError(f"{directory}: has no case.yaml; name the folder of a run")
    case = load_case(directory / "case.yaml")
    entries = read_series(directory)
    if len(entries) < 2:
        raise FilmError(f"{directory}: has {len(entries)} snapshots, a film needs two or more; run it with "
                        "output.every")
    write = _mp4_writer() if target.suffix.lower() == ".mp4" else _write_gif
    geometry = build_geometry(case, flow_axis(case))
    if view == "3d":
        from ..output.render import deep_enough

        if not deep_enough(geometry, case.particles.spacing):
            raise FilmError(f"{directory}: is not deep enough for a film in 3D; leave out --view 3d")
    frames = []
    for number, frame in enumerate(_frames(case, geometry, directory, entries, view), 1):
        frames.append(frame)
        if seen is not None:
            seen(number, len(entries))
    with replacing(target) as temporary:
        write(temporary, frames, rate)
    return len(frames)


def _frames(case: Case, geometry: Geometry, directory: Path, entries: Sequence[tuple[float, str]],
            view: str) -> Iterator[Image]:
    """The pictures of the snapshots, all of one size and with one scale of the speed."""
    from PIL import Image

    dim, spacing = geometry.dim, case.particles.spacing
    frame = Frame(dim, spacing, case.title, geometry.lower, geometry.upper, geometry.periodic,
                  geometry.distance if geometry.has_solid else None, flow_axis=flow_axis(case))
    two = len(case.fluids) > 1
    if not two:
        speeds = [np.quantile(np.linalg.norm(_particles(directory / file, dim)["velocity"], axis=1), 0.995)
                  for _, file in entries]
        frame = replace(frame, top=float(max(speeds)) or 1.0)
    with tempfile.TemporaryDirectory(prefix="isph-film-") as folder:
        path = Path(folder, "frame.png")
        body = None
        for time, file in entries:
            found = _particles(directory / file, dim)
            now = replace(frame, note=f"time {time:.4g} s")
            if view == "3d":
                body = _draw_3d(path, case, geometry, found, now, body)
            elif two:
                plot_phases(path, found["x"], found["phase"], case.fluid_names, now, walls=geometry.has_solid)
            else:
                plot_slice(path, found["x"], found["velocity"], now)
            with Image.open(path) as picture:
                height = round(picture.height * WIDTH / picture.width / BLOCK) * BLOCK
                yield picture.convert("RGB").resize((WIDTH, height))


def _particles(path: Path, dim: int) -> dict[str, np.ndarray]:
    """`x`, `velocity` (n, dim) and `phase` (n,) of the fluid particles of a snapshot."""
    x, fields = read_snapshot(path)
    missing = {"velocity", "phase"} - set(fields)
    if missing:
        raise FilmError(f"{path}: has no {' and '.join(sorted(missing))} (output.fields)")
    fluid = fields["phase"] >= 0
    return {"x": x[fluid][:, :dim], "velocity": fields["velocity"][fluid][:, :dim], "phase": fields["phase"][fluid]}


def _draw_3d(path: Path, case: Case, geometry: Geometry, found: dict[str, np.ndarray], frame: Frame,
             body: int | None) -> int:
    """Draws a snapshot; returns the fluid that was drawn as a body: the same one in the snapshots that follow."""
    from ..output.render import FLOW, FLUIDS, rendering, scene_of

    two = len(case.fluids) > 1
    axis = frame.flow_axis if frame.flow_axis is not None else 0
    if not two:
        found = {name: found[name] for name in ("x", "velocity")}
    scene = scene_of(geometry, found, frame.spacing, axis, body=body)
    with rendering(scene, frame, {FLUIDS if two else FLOW: path}, case.fluid_names if two else ()):
        pass
    return scene.body


def _write_gif(path: Path, frames: Sequence[Image], rate: float) -> None:
    from PIL import Image

    few = [frame.quantize(128, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(path, format="GIF", save_all=True, append_images=few[1:], duration=round(1000.0 / rate), loop=0,
                disposal=1)


def _mp4_writer() -> Callable[[Path, Sequence[Image], float], None]:
    try:
        import imageio.v2 as imageio
        import imageio_ffmpeg  # noqa: F401  # imageio writes mp4 with it
    except ImportError:
        raise FilmError("an mp4 needs imageio and ffmpeg: pip install 'imageio[ffmpeg]', or write a .gif") from None

    def write(path: Path, frames: Sequence[Image], rate: float) -> None:
        writer: Any = imageio.get_writer(path, format="FFMPEG", mode="I", fps=rate, macro_block_size=BLOCK)
        with writer as film:
            for frame in frames:
                film.append_data(np.asarray(frame))

    return write
