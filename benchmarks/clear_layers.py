"""Permeability of images over the thickness of their clear layers, and with sealed, periodic and mirrored boundaries.

    PYTHONPATH=. python benchmarks/clear_layers.py [layers | sides]

Flow along x, one particle per voxel, walls smooth, lengths in voxels. Images: corners of the Berea cube of cases/data,
a random field cut at its 60 % quantile, spheres of radius 8 as a close packing turned against the axes.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from isphcli.case.load import read_case
from isphcli.runs.run import run_case

CASE = """
geometry: {{voxels: {{file: {name}.npy, labels: {{solid: 1, water: 0}}, voxel_size: 1{layer}}}, {sides}}}
particles: {{spacing: 1}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
output: {{snapshots: false, plots: false}}
"""
LAYERS = (None, 1, 3, 6, 12, 24)
SIDES = ("periodic: [y, z]", "mirror: [y, z]", "periodic: [x]", "mirror: [x]", "periodic: [x, y, z]",
         "mirror: [x, y, z]")  # fmt: skip


def blobs() -> np.ndarray:
    field = gaussian_filter(np.random.default_rng(3).standard_normal((64,) * 3), 2.5, mode="wrap")[:40, :40, :40]
    return field < np.quantile(field, 0.6)


def spheres() -> np.ndarray:
    cells = np.stack(np.meshgrid(*[np.arange(-1, 6)] * 3, indexing="ij"), -1).reshape(-1, 1, 3)
    centres = (cells + [[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]]).reshape(-1, 3) * np.sqrt(2) * 16.2
    turned = (centres - centres.mean(0)) @ Rotation.from_euler("xyz", [0.4, 0.7, 0.3]).as_matrix() + 24
    voxels = np.stack(np.meshgrid(*[np.arange(48) + 0.5] * 3, indexing="ij"), -1)
    return cKDTree(turned).query(voxels)[0] < 8.0


def main(what: str) -> None:
    berea = np.load(Path(__file__).parents[1] / "cases/data/berea_128.npz")
    rock = berea[berea.files[0]]
    images = {"berea_a": rock[:48, :48, :48], "berea_b": rock[:48, 80:, :48], "spheres": spheres(), "blobs": blobs()}
    with tempfile.TemporaryDirectory() as folder:
        for name, solid in images.items():
            np.save(Path(folder) / f"{name}.npy", solid.astype(np.uint8))
            for layer, sides in [(c, "") for c in LAYERS] if what == "layers" else [(None, s) for s in SIDES]:
                text = CASE.format(name=name, sides=sides, layer="" if layer is None else f", clear_layer: {layer}")
                case = read_case(text.encode(), Path(folder) / "c.yaml", (f"output.directory={folder}/out",))
                found = run_case(case, quiet=True, overwrite=True)
                said = [text for text in found["inputs"] if text.startswith("clear layers")]
                print(name, sides or "sealed", f"k {found['permeability']:.5f}", *said, flush=True)


if __name__ == "__main__":
    main((sys.argv[1:] or ["layers"])[0])
