"""Permeability of images over the thickness of their clear layers, and with sealed, periodic and mirrored boundaries.

    PYTHONPATH=. python benchmarks/clear_layers.py [layers | sides | chosen [smooth | stairs] | walls]

Flow along x, one particle per voxel, walls smooth unless told otherwise, lengths in voxels. Images: corners of the
Berea cube of cases/data, a random field cut at its 60 % quantile, spheres of radius 8 as a close packing turned against
the axes. `chosen`: k with the thickness of the estimate against 24 voxels, of more images. `walls`: share of pores
within 8 voxels of either end that are on the other side of the smooth wall than between layers of 8 correlation lengths
l, over the least thickness that the field sees (`label_field.DEEP`), with layers of 3 voxels.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from isphcli.case.load import read_case
from isphcli.domain.slabs import Slabs
from isphcli.geometry import label_field
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


def blobs(seed: int = 3, width: float = 2.5) -> np.ndarray:
    field = gaussian_filter(np.random.default_rng(seed).standard_normal((64,) * 3), width, mode="wrap")[:40, :40, :40]
    return field < np.quantile(field, 0.6)


def spheres() -> np.ndarray:
    cells = np.stack(np.meshgrid(*[np.arange(-1, 6)] * 3, indexing="ij"), -1).reshape(-1, 1, 3)
    centres = (cells + [[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]]).reshape(-1, 3) * np.sqrt(2) * 16.2
    turned = (centres - centres.mean(0)) @ Rotation.from_euler("xyz", [0.4, 0.7, 0.3]).as_matrix() + 24
    voxels = np.stack(np.meshgrid(*[np.arange(48) + 0.5] * 3, indexing="ij"), -1)
    return cKDTree(turned).query(voxels)[0] < 8.0


def images() -> dict[str, np.ndarray]:
    """Solid voxels by name."""
    rock = berea()
    return {"berea_a": rock[:48, :48, :48], "berea_b": rock[:48, 80:, :48], "spheres": spheres(), "blobs": blobs()}


def more_images() -> dict[str, np.ndarray]:
    rock = berea()
    corners = {f"berea x {x} y {y} z {z}": rock[z : z + 48, y : y + 48, x : x + 48]
               for x, y, z in ((80, 0, 0), (0, 0, 80), (40, 40, 40), (80, 80, 80), (80, 80, 0))}
    return {**corners, "blobs of width 1.5": blobs(5, 1.5), "blobs of width 4": blobs(6, 4.0)}


def berea() -> np.ndarray:
    held = np.load(Path(__file__).parents[1] / "cases/data/berea_128.npz")
    return held[held.files[0]]


def permeabilities(named: dict[str, np.ndarray], layers: tuple[int | None, ...], sides: tuple[str, ...]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for name, solid in named.items():
            np.save(Path(folder) / "image.npy", solid.astype(np.uint8))
            for layer, side in [(c, s) for c in layers for s in sides]:
                text = CASE.format(name="image", sides=side, layer="" if layer is None else f", clear_layer: {layer}")
                case = read_case(text.encode(), Path(folder) / "c.yaml", (f"output.directory={folder}/out",))
                found = run_case(case, quiet=True, overwrite=True)
                said = [text for text in found["inputs"] if text.startswith("clear layers")]
                print(name, side or "sealed", f"k {found['permeability']:.5f}", *said, flush=True)


def pores_beside_the_ends(solid: np.ndarray, deep: float, layer: int = 3) -> np.ndarray:
    """Whether the smooth surface has fluid at points half a voxel apart along x and a quarter across it."""
    label_field.DEEP, n = deep, solid.shape[2]
    fluid = np.pad(solid == 0, ((0, 0), (0, 0), (layer, layer)), constant_values=True)
    part = (slice(0, None), slice(0, None), slice(layer, layer + n))
    field = label_field.most_probable_field(fluid, np.array([True, False, False]), part)
    deeps, across = np.arange(0.5, 8.1, 0.5), np.arange(0.125, n, 0.25) - 0.5
    x = np.concatenate([deeps, n - deeps]) + layer - 0.5
    return map_coordinates(field, np.meshgrid(across, across, x, indexing="ij"), order=3, mode="nearest") > 0


def walls() -> None:
    for name, solid in images().items():
        length = label_field.correlation_length(solid == 0, Slabs.whole(solid.shape), np.zeros(3, bool))
        far = pores_beside_the_ends(solid, 8.0)
        unlike = {deep: np.mean(pores_beside_the_ends(solid, deep) != far) / far.mean() for deep in (0, 1.5, 2, 3, 4)}
        print(f"{name}, l {length:.2f}:", ", ".join(f"{d} l {100 * u:.3f} %" for d, u in unlike.items()), flush=True)


def main(what: str, wall: str = "smooth") -> None:
    if what == "walls":
        walls()
    elif what == "chosen":
        permeabilities({**images(), **more_images()}, (None, 24), (f"wall_distance: {wall}",))
    else:
        permeabilities(images(), LAYERS if what == "layers" else (None,), ("",) if what == "layers" else SIDES)


if __name__ == "__main__":
    main(*(sys.argv[1:] or ["layers"]))
