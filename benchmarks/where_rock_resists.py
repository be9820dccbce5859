"""Where the flow through an image loses its energy, by the width of its pores: what particles of half the spacing in
narrow pores alone could save, and particles of half the spacing where the energy is lost, wherever that is.

usage: python benchmarks/where_rock_resists.py [EDGE]      (64 voxels: the corner of cases/berea.yaml)

The flow with one particle per voxel. Width of a site: diameter, in voxels, of the largest ball of pore that covers it.
Dissipation: squares of the differences of velocity between neighbouring sites, and to walls half a voxel away. Second
table: the sites that lose most, up to a share of the whole, and those within BUFFER voxels of them along every axis.
"""

import sys
from pathlib import Path

import numpy as np
from scipy import ndimage

import isphcli

VOXEL = 3e-6  # m
WIDTHS = (1, 2, 3, 4, 6, 8)
SHARES, BUFFER = (0.5, 0.8, 0.9, 0.95), 1


def on_sites(x, velocity):
    """(pore, velocity) on the sites of the lattice."""
    index = np.rint(x / VOXEL - 0.5).astype(int)
    index -= index.min(axis=0)
    shape = tuple(index.max(axis=0) + 1)
    pore, field = np.zeros(shape, bool), np.zeros((*shape, 3))
    pore[tuple(index.T)], field[tuple(index.T)] = True, velocity
    return pore, field


def dissipation(pore, field):
    """Share of every site."""
    out = np.zeros(pore.shape)
    for axis in range(3):
        for step in (1, -1):
            beside = np.roll(pore, step, axis)
            difference = ((field - np.roll(field, step, axis)) ** 2).sum(axis=-1)
            out += np.where(pore & beside, 0.5 * difference, 0.0)
            out += np.where(pore & ~beside, 2.0 * (field**2).sum(axis=-1), 0.0)
    return out / out.sum()


def widths(pore):
    """Of every site of the pores, voxels."""
    radius = ndimage.distance_transform_edt(pore) - 0.5
    out = np.zeros(pore.shape)
    for r in np.unique(np.round(2.0 * radius[pore]) / 2.0):
        middle = radius >= r
        if middle.any():
            out[pore & (ndimage.distance_transform_edt(~middle) <= r)] = 2.0 * r
    return out


def sites_that_lose(lost, share):
    """The fewest sites that hold a share of the dissipation, with `BUFFER` voxels round them."""
    order = np.argsort(-lost, axis=None)
    most = int(np.searchsorted(np.cumsum(lost.ravel()[order]), share)) + 1
    found = np.zeros(lost.size, bool)
    found[order[:most]] = True
    return ndimage.maximum_filter(found.reshape(lost.shape), size=2 * BUFFER + 1)


def main(edge="64"):
    with np.load(Path(__file__).parents[1] / "cases/data/berea_128.npz") as file:
        image = file[file.files[0]][: int(edge), : int(edge), : int(edge)]
    found = isphcli.permeability(image, voxel_size=VOXEL, axis="x", solid=1, quiet=True, threads=1,
                                 options={"geometry": {"wall_distance": "stairs"}})
    pore, field = on_sites(found.x, found.velocity)
    lost, width = dissipation(pore, field), widths(pore)
    print("| width, voxels | share of the pores | of the dissipation | "
          "particles, of those of half the spacing all over |")
    print("|---|---|---|---|")
    for most in WIDTHS:
        narrow = pore & (width <= most)
        share = narrow.sum() / pore.sum()
        print(f"| up to {most} | {share:.2f} | {lost[narrow].sum():.2f} | {(8.0 * share + 1.0 - share) / 8.0:.2f} |")
    print("\n| dissipation | share of the pores, with what is round it | particles, of those of half the spacing all "
          "over |\n|---|---|---|")
    for share in SHARES:
        part = (pore & sites_that_lose(lost, share)).sum() / pore.sum()
        print(f"| {share:g} | {part:.3f} | {(8.0 * part + 1.0 - part) / 8.0:.2f} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
