"""Permeability of an image by staggered finite volumes with walls on the faces of the voxels: an independent reference.

usage: PYTHONPATH=. python benchmarks/finite_volumes.py IMAGE.npy AXIS CELLS[,CELLS...]

IMAGE: (nx, ny, nz), 1 in pores, periodic along all axes; AXIS: of the flow, 0 to 2; CELLS: along a voxel's edge.
Prints k in voxel^2. Stokes flow on a marker-and-cell grid: pressures in the middles of cells, velocities on faces.
Unit viscosity, unit force, unit cell. MINRES with smoothed aggregation for each velocity and for the pressure as
preconditioner.
"""

import sys
import time

import numpy as np
import pyamg
import scipy.sparse as sp
from scipy.ndimage import label
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, minres


def largest_pore(pores):
    """Mask of the largest part of the pores that is connected by faces, periodic images too."""
    parts, count = label(pores)
    pairs = []
    for axis in range(3):
        first, last = np.take(parts, 0, axis).ravel(), np.take(parts, -1, axis).ravel()
        both = (first > 0) & (last > 0)
        pairs.append(np.stack([first[both], last[both]], axis=1))
    pairs = np.concatenate(pairs)
    graph = sp.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count + 1, count + 1))
    _, whole = connected_components(graph, directed=False)
    parts = whole[parts]
    sizes = np.bincount(parts[pores])
    return pores & (parts == sizes.argmax())


def velocity_matrix(cells, across, faces, axis):
    """-laplacian of the velocities on the faces of one axis: no slip on faces between a cell and solid.

    cells: mask; across: the mask of the cells on the other side of each face; faces: number of a face, -1 without.
    """
    inside = faces >= 0
    own = faces[inside]
    diagonal = np.zeros(len(own))
    rows, columns = [], []
    for direction in range(3):
        for step in (1, -1):
            other = np.roll(faces, step, direction)[inside]
            there = other >= 0
            rows.append(own[there])
            columns.append(other[there])
            if direction == axis:
                diagonal += 1.0  # the next face bears a velocity, or lies on the wall and has none
                continue
            one, two = np.roll(cells, step, direction)[inside], np.roll(across, step, direction)[inside]
            # a wall half a cell away counts twice; where half the way is open the face there is a wall's corner
            diagonal += np.where(there | (one != two), 1.0, 2.0)
    rows, columns = np.concatenate(rows), np.concatenate(columns)
    off = sp.csr_matrix((-np.ones(len(rows)), (rows, columns)), shape=(len(own),) * 2)
    return (off + sp.diags(diagonal)).tocsr()


def permeability(pores, axis, finer=1, tolerance=1e-8):
    """(k in voxel^2, cells, iterations, residual) of an image (nx, ny, nz) bool, `finer` cells a voxel edge."""
    voxels = pores.size
    cells = largest_pore(np.asarray(pores, bool)).repeat(finer, 0).repeat(finer, 1).repeat(finer, 2)
    number = np.full(cells.shape, -1, np.int64)
    n_cells = int(cells.sum())
    number[cells] = np.arange(n_cells)
    matrices, gradients, forces, counts = [], [], [], []
    for direction in range(3):
        across = np.roll(cells, 1, direction)
        between = cells & across
        faces = np.full(cells.shape, -1, np.int64)
        n = int(between.sum())
        faces[between] = np.arange(n)
        matrices.append(velocity_matrix(cells, across, faces, direction))
        ends = np.concatenate([number[between], np.roll(number, 1, direction)[between]])
        signs = np.repeat([1.0, -1.0], n)
        gradients.append(sp.csr_matrix((signs, (np.tile(np.arange(n), 2), ends)), shape=(n, n_cells)))
        forces.append(np.full(n, float(direction == axis)))
        counts.append(n)
    grad = sp.vstack(gradients).tocsr()
    div = grad.T.tocsr()
    laplace = sp.block_diag(matrices, format="csr")
    hierarchies = [pyamg.smoothed_aggregation_solver(m, strength=("symmetric", {"theta": 0.0}), max_coarse=200)
                   for m in matrices]
    response = np.concatenate([h.solve(np.ones(m.shape[0]), tol=1e-2, accel="cg")
                               for h, m in zip(hierarchies, matrices)])
    darcy = (div @ sp.diags(np.maximum(response, 1e-8)) @ grad).tocsr()
    darcy = (darcy + sp.diags(np.full(n_cells, 1e-8 * darcy.diagonal().mean()))).tocsr()
    cycles = [h.aspreconditioner() for h in hierarchies]
    pressure = pyamg.smoothed_aggregation_solver(darcy, max_coarse=200).aspreconditioner()
    n_faces = sum(counts)
    start = np.concatenate([[0], np.cumsum(counts)])

    def matrix(x):
        return np.concatenate([laplace @ x[:n_faces] + grad @ x[n_faces:], div @ x[:n_faces]])

    def precondition(x):
        u = np.concatenate([c(x[a:b]) for c, a, b in zip(cycles, start[:-1], start[1:])])
        q = x[n_faces:] - x[n_faces:].mean()
        q = q + pressure(q)
        return np.concatenate([u, q - q.mean()])

    iterations = [0]

    def count(_):
        iterations[0] += 1

    shape = (n_faces + n_cells,) * 2
    right = np.concatenate([*forces, np.zeros(n_cells)])
    x, _ = minres(LinearOperator(shape, matrix), right, M=LinearOperator(shape, precondition), rtol=tolerance,
                  maxiter=1500, callback=count)
    residual = np.linalg.norm(matrix(x) - right) / np.linalg.norm(right)
    flux = x[start[axis] : start[axis + 1]].sum()
    return float(flux / finer**3 / voxels / finer**2), n_cells, iterations[0], float(residual)


def main(path, axis, cells):
    pores = np.load(path) == 1
    for finer in map(int, cells.split(",")):
        begin = time.process_time()
        k, count, iterations, residual = permeability(pores, int(axis), finer)
        print(f"{finer} cells a voxel edge: k {k:.5f} voxel^2, {count:,} cells, {iterations} iterations, "
              f"residual {residual:.1e}, {time.process_time() - begin:.1f} CPU s", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
