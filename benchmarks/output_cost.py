"""CPU seconds of what a steady run in 3D leaves: its snapshot and its pictures, part by part, from the folder of a run.

Usage: PYTHONPATH=. NUMBA_NUM_THREADS=1 python benchmarks/output_cost.py RUN DIR [repeats]

RUN: folder of a run of `flow: stokes` with one spacing and its snapshot; DIR: where the files are written. The process
that draws in 3D is counted. Shear at the walls leaves out the curvature of the velocity, which no snapshot holds.
Libraries are loaded before the clock starts, but for those of the process that draws.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from isphcli.case.load import read_case
from isphcli.output import render
from isphcli.output.files import write_vtu
from isphcli.output.panels import plot_distributions
from isphcli.output.plots import Frame, frame_picture, plot_slice
from isphcli.output.snapshots import read_series, read_snapshot
from isphcli.runs.flow_measures import wall_stress
from isphcli.runs.results import draw_distributions
from isphcli.scene.build_geometry import build_geometry


def cpu() -> float:
    """CPU seconds of this process and of those that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def timed(rows: dict[str, list[float]], name: str, call: Callable[[], Any]) -> Any:
    """What a call returns; its seconds go into a row."""
    start = cpu()
    found = call()
    rows.setdefault(name, []).append(cpu() - start)
    return found


def draw_in_3d(rows: dict[str, list[float]], scene: render.Scene3D, frame: Frame, out: Path) -> None:
    """The pictures in 3D and their frames, with the scale of the speed for both."""
    key = render._key_of(render.FLOW, {"top": float(np.linalg.norm(scene.velocity, axis=-1).max())}, (), frame, 0)
    names = [render.FLOW, *[render.SHEAR] * (scene.shear is not None)]
    images = timed(rows, "process in 3D", lambda: render.draw_images(scene, names))

    def draw() -> None:
        for name, image in images.items():
            frame_picture(out / f"{name}.png", image, frame, key)

    timed(rows, "frames in 3D", draw)


def main(run: Path, out: Path, repeats: int) -> None:
    """Every part, some times over; prints the smallest of each."""
    case = read_case((run / "case.yaml").read_bytes(), str(run / "case.yaml"))
    x, fields = read_snapshot(run / read_series(run)[-1][1])
    velocity, spacing = fields["velocity"], case.particles.spacing
    axis = int(np.argmax(np.abs(velocity.mean(axis=0))))
    geometry, fluid = build_geometry(case, axis), next(iter(case.fluids.values()))
    stress = wall_stress(geometry, x, velocity, np.zeros_like(velocity), (spacing, fluid.viscosity))
    frame = Frame(3, spacing, case.title, geometry.lower, geometry.upper, geometry.periodic, geometry.distance, axis)
    out.mkdir(parents=True, exist_ok=True)
    plot_distributions(out / "distributions.png", velocity[:100], spacing, None)  # imports what draws
    rows: dict[str, list[float]] = {}
    for _ in range(repeats):
        timed(rows, "snapshot", lambda: write_vtu(out / "particles.vtu", x, fields))
        timed(rows, "slice", lambda: plot_slice(out / "slice.png", x, velocity, frame))
        timed(rows, "distributions", lambda: draw_distributions(out, case, geometry, x, velocity, spacing))
        scene = timed(rows, "grid in 3D", lambda: render.scene_of(geometry, {"x": x, "velocity": velocity}, spacing,
                                                                  axis, stress))
        draw_in_3d(rows, scene, frame, out)
    least = {name: min(seconds) for name, seconds in rows.items()}
    for name, seconds in {**least, "sum": sum(least.values())}.items():
        print(f"{name:24s}{seconds:7.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 1)
