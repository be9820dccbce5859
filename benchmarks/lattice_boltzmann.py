"""Permeability of an image by a lattice-Boltzmann method, walls half way between cells: what many codes for rock do.

usage: PYTHONPATH=. python benchmarks/lattice_boltzmann.py IMAGE.npy AXIS CELLS[,CELLS...]

IMAGE: (nx, ny, nz), 1 in pores, periodic along all axes; AXIS: of the flow, 0 to 2; CELLS: along a voxel's edge. Prints
k in voxel^2. D3Q19 with two relaxation times, of Stokes flow (no terms in u^2), bounce-back at the faces of the voxels,
a uniform force; the product of both relaxation times, less 1/2 each, is 3/16: straight channels are exact.
"""

import itertools
import sys
import time

import numpy as np
from numba import njit

C = np.array([c for c in itertools.product((-1, 0, 1), repeat=3) if sum(map(abs, c)) <= 2])
W = np.array([{0: 1 / 3, 1: 1 / 18, 2: 1 / 36}[int(np.abs(c).sum())] for c in C])
OPPOSITE = np.array([int(np.flatnonzero((C == -c).all(axis=1))[0]) for c in C])
NU = 1 / 6  # in units of the lattice: the relaxation time of the stress is 1
ODD = 1 / (0.5 + 3 / 16 / (3 * NU))
CHECK, TOLERANCE = 100, 1e-5  # steps between looks at the mean velocity; its relative change at the end
MOST = 20_000  # steps


@njit(cache=True)
def step(f, out, neighbour, c, w, opposite, axis, odd):
    """One collision and streaming under a unit force; returns the sum of the momentum along the axis."""
    n, q = f.shape
    total = 0.0
    post = np.empty(q)
    for i in range(n):
        rho = jx = jy = jz = 0.0
        for a in range(q):
            rho += f[i, a]
            jx += c[a, 0] * f[i, a]
            jy += c[a, 1] * f[i, a]
            jz += c[a, 2] * f[i, a]
        total += (jx, jy, jz)[axis] + 0.5
        for a in range(q):
            b = opposite[a]
            j = 3.0 * w[a] * (c[a, 0] * jx + c[a, 1] * jy + c[a, 2] * jz)
            # the even part relaxes with 1: it is w rho after the collision
            post[a] = w[a] * rho + (1.0 - odd) * 0.5 * (f[i, a] - f[i, b]) + odd * j + 3.0 * w[a] * c[a, axis]
        for a in range(q):
            there = neighbour[i, a]
            if there >= 0:
                out[there, a] = post[a]
            else:
                out[i, opposite[a]] = post[a]
    return total


def permeability(pores, axis, finer=1):
    """(k in voxel^2, cells, steps) of an image (nx, ny, nz) bool, `finer` cells a voxel edge."""
    cells = np.asarray(pores, bool).repeat(finer, 0).repeat(finer, 1).repeat(finer, 2)
    number = np.full(cells.shape, -1, np.int64)
    number[cells] = np.arange(int(cells.sum()))
    neighbour = np.stack([np.roll(number, tuple(-c), (0, 1, 2))[cells] for c in C], axis=1)
    f, out = np.zeros((len(neighbour), len(C))), np.zeros((len(neighbour), len(C)))
    before = np.inf
    for steps in range(1, MOST + 1):
        total = step(f, out, neighbour, C, W, OPPOSITE, axis, ODD)
        f, out = out, f
        if steps % CHECK == 0:
            if abs(total - before) < TOLERANCE * abs(total):
                break
            before = total
    return NU * total / cells.size / finer**2, len(neighbour), steps


def main(path, axis, cells):
    pores = np.load(path) == 1
    for finer in map(int, cells.split(",")):
        begin = time.process_time()
        k, count, steps = permeability(pores, int(axis), finer)
        print(f"{finer} cells a voxel edge: k {k:.5f} voxel^2, {count:,} cells, {steps} steps, "
              f"{time.process_time() - begin:.1f} CPU s", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
