"""Particles of half the spacing where the flow loses its energy alone: error of k over CPU seconds, against lattices of
one spacing.

usage: PYTHONPATH=. python benchmarks/two_spacings.py exact
       PYTHONPATH=. python benchmarks/two_spacings.py scalar
       PYTHONPATH=. python benchmarks/two_spacings.py bodies [NAME ...]
       PYTHONPATH=. python benchmarks/two_spacings.py cubes [NAME ...]
       PYTHONPATH=. python benchmarks/two_spacings.py rock [EDGE] [stairs|smooth] [FINEST]

A cell of the cubic lattice of spacing H is replaced by eight of half its edge. A pair has the support of 2.1 times the
mean spacing of both, so that pair weights times volumes stay symmetric; eqs 5, 6 and 11 are corrected over whatever
neighbours there are (kernels of `isphcli.operators.moments`). All matrices are SciPy's, for one spacing as for two: what
is compared is the same code. Cells are chosen by a solve on the coarse lattice: those of the strongest dissipation until
they hold SHARE of it, and BUFFER cells round them; its seconds are part of those of two spacings.
"""

import os
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
import scipy.sparse as sp
from calibration import case_of
from formation_factor import cylinders, spheres
from numba import njit
from scipy import ndimage

from isphcli.case.load import load_case
from isphcli.domain.components import pair_components
from isphcli.domain.halo import build_halo
from isphcli.domain.neighbours import Neighbourhood, find_pairs
from isphcli.domain.row_threads import over_rows
from isphcli.flow.stokes import CYCLES, ROUGH, STRENGTH, TAU
from isphcli.geometry.protocol import inside_sample
from isphcli.geometry.wall_normals import wall_normals
from isphcli.operators.crossings import MEETS_WALL, WallTable, crossings
from isphcli.operators.kernel import WENDLAND_C2, normalisation, slope
from isphcli.operators.lattice_weights import _smallest
from isphcli.operators.moments import LANES, correction, invert_gradient, stencil_moments, stencil_weights
from isphcli.operators.neighbourhood_class import NARROW_SHARE_FIXED
from isphcli.operators.wall_weights import meet_walls, second_moments
from isphcli.runs.permeability import EDGE, darcy, extrapolate
from isphcli.scene.build_geometry import build_geometry
from isphcli.solvers.krylov import Limits, gmres_from_the_right
from isphcli.solvers.multigrid import BlockCycle, cycle, hierarchy
from isphcli.validation.known_bodies import Body, LevelGeometry, body

SUPPORT = 2.1  # over the mean spacing of a pair, as steady solves have it
BEYOND = 3  # coarse cells round a box that is not periodic, where dummies lie
LIMITS = Limits(1e-6, 100, 400)
CUBIC = True  # whether the Laplacian of rows that see both spacings is exact for functions of third order
HEAVIEST = 1.5
SHARES, BUFFER = (0.5, 0.8), 1


# -- points and pairs -----------------------------------------------------------------------------------------


class Points:
    """Sites of a lattice of cells of edge `coarse`, those of `fine` (bool, by cell) in eight parts.

    x (n, 3) and d (n,): fluid sites and their spacings; dummies and theirs behind; cell: (n + dummies, 3).
    """

    def __init__(self, geometry, coarse, fine=None):
        self.geometry, self.coarse = geometry, coarse
        periodic = np.array(geometry.periodic)
        self.pad = np.where(periodic, 0, BEYOND)
        self.cells = np.rint((geometry.upper - geometry.lower) / coarse).astype(int)
        assert np.allclose(self.cells * coarse, geometry.upper - geometry.lower, rtol=1e-6)
        shape = tuple(self.cells + 2 * self.pad)
        self.fine = np.zeros(shape, bool) if fine is None else fine
        index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
        inner = self.fine[tuple(index.T)]
        parts = np.stack(np.meshgrid(*[[-0.25, 0.25]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        cell = np.concatenate([index[~inner], np.repeat(index[inner], 8, axis=0)])
        off = np.concatenate([np.zeros(((~inner).sum(), 3)), np.tile(parts, (inner.sum(), 1))])
        d = np.concatenate([np.full((~inner).sum(), coarse), np.full(8 * inner.sum(), coarse / 2)])
        x = geometry.lower + (cell - self.pad + 0.5 + off) * coarse
        fluid = geometry.phase(x) >= 0
        reach = SUPPORT * np.where(d == coarse, coarse, 0.75 * coarse)
        near = np.zeros(len(x), bool)
        near[~fluid] = -geometry.distance(x[~fluid], SUPPORT * coarse) < reach[~fluid]
        order = np.concatenate([np.flatnonzero(fluid), np.flatnonzero(near)])
        self.n = int(fluid.sum())
        self.x, self.d, self.cell = x[order], d[order], cell[order]
        self.volume = self.d[: self.n] ** 3

    def seam(self):
        """Whether each point lies within two cells of one of the other spacing."""
        if not self.fine.any():
            return np.zeros(len(self.x), bool)
        box = np.ones((5, 5, 5), bool)
        mode = {"mode": "wrap"} if not self.pad.any() else {"mode": "nearest"}
        both = (ndimage.maximum_filter(self.fine, footprint=box, **mode)
                & ndimage.maximum_filter(~self.fine, footprint=box, **mode))
        return both[tuple(self.cell.T)]


def neighbours_of(points):
    """Neighbourhood of all pairs, those of two spacings with the support of their mean."""
    geometry, n, coarse = points.geometry, points.n, points.coarse
    images = build_halo(points.x, geometry.lower, geometry.upper, np.array(geometry.periodic), SUPPORT * coarse)
    table, owner = images.positions(points.x), images.owners(len(points.x))
    d, seam = points.d[owner], points.seam()[owner]
    first, second = [], []

    def find(some, support, other):
        rows = np.concatenate([np.flatnonzero(some[:n]), n + np.flatnonzero(some[n:])])
        pairs = find_pairs(np.ascontiguousarray(table[rows]), int(some[:n].sum()), support)
        i, j = np.repeat(rows[: len(pairs.start) - 1], pairs.count), rows[pairs.index]
        keep = (d[i] != d[j]) == other
        first.append(i[keep])
        second.append(j[keep])

    for size in np.unique(points.d):
        find(d == size, SUPPORT * size, False)
    if seam.any():
        find(seam, SUPPORT * 0.75 * coarse, True)
    i, j = np.concatenate(first), np.concatenate(second)
    order = np.argsort(i, kind="stable")
    start = np.zeros(n + 1, np.int64)
    np.cumsum(np.bincount(i, minlength=n), out=start[1:])
    row = j[order].astype(np.int32)
    return Neighbourhood(start, owner[row], row, table, owner, WENDLAND_C2, SUPPORT * coarse), d


# -- operators ------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _rows(rows, work, neighbours, d, links, out):
    """Weights of the pairs of rows in sight and of walls: see `Operators`."""
    (stencil, moments, tensors, weights, g_p) = work
    (lap, grad, grad_p, symmetric, lap_wall, div_wall, narrow) = out
    link, t, first = links
    ex, ey, ez, s, w = stencil
    x, start = neighbours.x, neighbours.start
    for i in range(rows[0], rows[1]):
        begin, count, h = start[i], start[i + 1] - start[i], 2.1 * d[i]
        padded = (count + LANES - 1) // LANES * LANES
        for k in range(padded):
            ex[k], ey[k], ez[k], s[k], w[k] = 0.0, 0.0, 0.0, 1.0, 0.0
        for k in range(count):
            j = neighbours.row[begin + k]
            a, b, c = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            r = np.sqrt(a * a + b * b + c * c)
            both = 1.05 * (d[i] + d[j])
            ex[k], ey[k], ez[k], s[k] = a / r, b / r, c / r, r / h
            w[k] = d[j] ** 3 * h / both * normalisation(0, both, 3) * slope(0, r / both)
        whole, near_wall = meet_walls(stencil, t, first[i], link[begin : begin + count])
        stencil_moments(stencil, padded, moments)
        correction(moments, 3, 2, tensors)
        stencil_weights(stencil, padded, tensors, 2, weights)
        if near_wall:
            second_moments(stencil, link[begin : begin + count], moments)
            invert_gradient(moments, 3, g_p)
            narrow[i] = not _smallest(moments, 3) > 0.3 * whole / 3.0
        for k in range(count):
            q = begin + k
            if link[q] == MEETS_WALL:
                lap_wall[i] += weights[0, k] / h**2
                if not narrow[i]:
                    for m in range(3):
                        div_wall[i, m] += weights[1 + m, k] / h
                continue
            lap[q] = weights[0, k] / h**2
            symmetric[q] = 6.0 * w[k] / (whole * s[k]) / h**2
            for m in range(3):
                grad[q, m] = grad_p[q, m] = weights[1 + m, k] / h
                if near_wall:
                    grad_p[q, m] = (g_p[m, 0] * ex[k] + g_p[m, 1] * ey[k] + g_p[m, 2] * ez[k]) * w[k] / h
        if whole == 0.0:
            lap_wall[i] = 1.0 / d[i] ** 2


def _work(longest):
    size = longest + LANES
    return (tuple(np.empty(size) for _ in range(5)), np.empty(41),
            (np.empty((3, 3)), np.empty((6, 6)), np.empty((6, 4)), np.empty(3), np.empty((3, 3))),
            np.empty((4, size)), np.empty((3, 3)))


def _exact_for_cubes(neighbours, d, links, lap_and_wall):
    """Laplacian of the rows that see both spacings: the smallest weights that are exact for functions of third order,
    where the sum of their sizes stays below HEAVIEST of their sum (what GMRES bears); else it stays as it is."""
    (lap, lap_wall), n, start, x = lap_and_wall, neighbours.n, neighbours.start, neighbours.x
    count = np.diff(start)
    i = np.repeat(np.arange(n), count)
    rows = np.flatnonzero(np.bincount(i, d[neighbours.row] != d[i], minlength=n))
    if not len(rows):
        return
    wall = links.link == MEETS_WALL
    t = np.ones(len(i))
    t[wall] = links.t
    places = np.arange(count[rows].max())
    valid = places < count[rows][:, None]
    place = np.where(valid, start[rows][:, None] + places, 0)
    h = SUPPORT * d[rows]
    other = neighbours.row[place]
    step = x[other] - x[rows][:, None, :]
    r, both = np.linalg.norm(step, axis=2), 0.5 * SUPPORT * (d[other] + d[rows][:, None])
    q = np.minimum(r / both, 1.0)
    omega = np.where(valid, q * (1.0 - q) ** 3 / both**4 * d[other] ** 3 / np.maximum(r, 1e-300) / t[place], 0.0)
    a, b, c = np.moveaxis(step * (t[place] / h[:, None])[..., None], 2, 0)
    phi = np.stack([a, b, c, a * a, b * b, c * c, b * c, a * c, a * b, a**3, b**3, c**3, a * a * b, a * a * c, b * b * a,
                    b * b * c, c * c * a, c * c * b, a * b * c], axis=2)
    weighted = phi * omega[..., None]
    matrix = np.matmul(weighted.transpose(0, 2, 1), phi)
    matrix += 1e-13 * np.einsum("raa->r", matrix)[:, None, None] * np.eye(19)
    wanted = np.zeros((len(rows), 19, 1))
    wanted[:, 3:6] = 2.0
    found = np.matmul(weighted, np.linalg.solve(matrix, wanted))[..., 0] / h[:, None] ** 2
    good = np.abs(found).sum(axis=1) < HEAVIEST * found.sum(axis=1)
    rows, place, valid, found = rows[good], place[good], valid[good], found[good]
    beyond = wall[place] & valid
    lap_wall[rows] = (found * beyond).sum(axis=1)
    seen = valid & ~beyond
    lap[place[seen]] = found[seen]


class Operators:
    """Matrices (n, n) of a set of points, per unit of length: lap (velocity, walls included), grad (velocity, three),
    div, grad_p, laplacian (symmetric weights), half (their half steps); matrices of cells and their faces."""

    def __init__(self, points):
        assert NARROW_SHARE_FIXED == 0.3
        geometry, n = points.geometry, points.n
        self.points, self.n = points, n
        neighbours, d = neighbours_of(points)
        distance, _ = geometry.nearest(points.x)
        self.distance = distance
        owner = neighbours.owner
        walls = WallTable(owner < n, distance[owner], np.zeros(len(owner), np.int32), np.zeros((1, 3)), np.zeros(1),
                          np.zeros((0, 3)), np.zeros((0, 3, 3)))
        links = crossings(geometry, neighbours, walls)
        pairs = len(neighbours.row)
        out = (np.zeros(pairs), np.zeros((pairs, 3)), np.zeros((pairs, 3)), np.zeros(pairs), np.zeros(n),
               np.zeros((n, 3)), np.zeros(n, np.bool_))
        over_rows(_rows, n, neighbours, d, tuple([links.link, links.t, links.first]), out,
                  work=partial(_work, int(neighbours.longest)))
        lap, grad, grad_p, symmetric, self.lap_wall, self.div_wall, self.narrow = out
        if CUBIC:
            _exact_for_cubes(neighbours, d, links, lap_and_wall=out[::4])
        seen = links.link != MEETS_WALL
        first = np.repeat(np.arange(n), np.diff(neighbours.start))[seen]
        self.start = np.concatenate([[0], np.cumsum(np.bincount(first, minlength=n))]).astype(np.int64)
        self.column = neighbours.column[seen]
        step = neighbours.x[neighbours.row[seen]] - neighbours.x[first]
        self.step, self.first = step, first
        self.symmetric, self.weights = symmetric[seen], lap[seen]
        self.lap = self._differences(lap[seen], self.lap_wall)
        self.grad_p = [self._differences(grad_p[seen, k]) for k in range(3)]
        self.tilt = np.stack([[np.bincount(first, grad_p[seen, k] * step[:, m], minlength=n) for m in range(3)]
                              for k in range(3)])  # gradient k of the coordinate m
        self.slope = [self._differences(grad[seen, k]) for k in range(3)]
        self.laplacian = self._differences(self.symmetric)
        self.half = [self._differences(0.5 * self.symmetric * step[:, k], sign=1.0) for k in range(3)]
        self._faces(step, d[:n])

    def _differences(self, values, wall=None, sign=-1.0):
        """sum_j values (f_j - f_i) - wall f_i; sign = 1: of sums (f_j + f_i)."""
        n = self.n
        diagonal = sign * np.bincount(self.first, values, minlength=n) - (0.0 if wall is None else wall)
        pairs = sp.csr_matrix((values, self.column, self.start), shape=(n, n))
        return (pairs + sp.diags(diagonal)).tocsr()

    def _faces(self, step, d):
        """Pairs whose cells share a face: area over distance."""
        i, j, reach = self.first, self.column, np.abs(step).max(axis=1)
        mean = 0.5 * (d[i] + d[j])
        same = d[i] == d[j]
        r = np.linalg.norm(step, axis=1)
        share = np.where(same, r < 1.02 * mean, r < 0.84 / 0.75 * mean)
        self.face = i[share], j[share], (np.minimum(d[i], d[j]) ** 2 / reach)[share]

    def divergence(self, div_wall):
        """Three matrices; narrow rows are minus the adjoint of the pressure gradient."""
        narrow, volume, out = self.narrow.astype(float), self.points.volume, []
        for k in range(3):
            plain = self.slope[k] - sp.diags(div_wall[:, k])
            if self.narrow.any():
                adjoint = -sp.diags(narrow / volume) @ self.grad_p[k].T @ sp.diags(volume)
                plain = (sp.diags(1.0 - narrow) @ plain + adjoint).tocsr()
            out.append(plain.tocsr())
        return out

    def odd_even(self, p, gradient):
        """S p (`operators.div_grad`)."""
        return self.laplacian @ p - sum(self.half[k] @ gradient[:, k] for k in range(3))

    def gradient(self, p):
        """(n, 3)."""
        return np.stack([g @ p for g in self.grad_p], axis=1)

    def conductance(self, w, wall=None, raised=0.0):
        """Symmetric matrix of the faces of the cells, w (n,) at their middles."""
        i, j, c = self.face
        c = c * 0.5 * (w[i] + w[j])
        total = np.bincount(i, c, minlength=self.n)
        diagonal = total * (1.0 + raised) + (0.0 if wall is None else wall * self.points.volume)
        diagonal[diagonal <= 0.0] = 1.0
        return (sp.csr_matrix((-c, (i, j)), shape=(self.n, self.n)) + sp.diags(diagonal)).tocsr()

    def means(self):
        """Takes the mean over each component, by volume, out of a vector."""
        count, labels = pair_components(self.start, self.column)
        volume = self.points.volume
        whole = np.bincount(labels, volume, minlength=count)
        return lambda v: v - (np.bincount(labels, volume * v, minlength=count) / whole)[labels]


# -- flows ----------------------------------------------------------------------------------------------------


def stokes(ops, axis):
    """(velocity (n, 3), its Laplacian, iterations) under a unit force along an axis, viscosity one."""
    n, points = ops.n, ops.points
    d, volume = points.d[:n], points.volume
    div, remove = ops.divergence(ops.div_wall), ops.means()
    velocity = BlockCycle(hierarchy(ops.conductance(np.ones(n), np.maximum(ops.lap_wall, 0.0)), STRENGTH), CYCLES)
    w = np.maximum(velocity(np.repeat(volume[:, None], 3, axis=1))[:, 0], 1e-3 * d**2)
    darcy_cycle = cycle(hierarchy(ops.conductance(w, raised=1e-6)))
    size = points.coarse

    def split(v):
        return v[: 3 * n].reshape(n, 3), v[3 * n :]

    def apply(v):
        u, p = split(v)
        q = p / size
        gradient = ops.gradient(q)
        mass = sum(div[k] @ u[:, k] for k in range(3)) - TAU * d**2 * ops.odd_even(q, gradient)
        return np.concatenate([((gradient - ops.lap @ u) * (d**2)[:, None]).ravel(), d * remove(mass)])

    def precondition(v):
        forces, mass = split(v)
        mass = remove(mass / d)
        q = mass + remove(darcy_cycle(volume * mass) - ROUGH * d**2 * (ops.laplacian @ mass))
        u = velocity(volume[:, None] * (forces / (d**2)[:, None] - ops.gradient(q)))
        return np.concatenate([u.ravel(), q * size])

    force = ops.tilt[:, axis].T
    rhs = np.concatenate([(force * (d**2)[:, None]).ravel(), np.zeros(n)])
    found, how = gmres_from_the_right(apply, rhs, precondition, LIMITS)
    if not how.converged:
        print(f"    not converged: {how}", flush=True)
    u, p = split(found)
    return u, ops.gradient(p / size) - force, how.iterations


def diffusion(ops, axis):
    """(flux (n, 3) of a unit gradient past insulating walls, iterations)."""
    n, points = ops.n, ops.points
    wall, beside = ops.div_wall.copy(), np.flatnonzero(np.any(ops.div_wall != 0.0, axis=1))
    normal = wall_normals(points.geometry, points.x[beside], points.coarse)
    wall[beside] = np.einsum("nk,nk->n", wall[beside], normal)[:, None] * normal
    div, remove, volume = ops.divergence(wall), ops.means(), points.volume
    inverse = cycle(hierarchy(ops.conductance(np.ones(n), raised=1e-6)))
    d2 = points.d[:n] ** 2

    def flux_out(field):
        return sum(div[k] @ field[:, k] for k in range(3))

    def apply(phi):
        gradient = ops.gradient(phi)
        return -d2 * remove(flux_out(gradient) + ops.odd_even(phi, gradient))

    field = ops.tilt[:, axis].T
    phi, how = gmres_from_the_right(apply, -d2 * remove(flux_out(field)),
                                    lambda b: remove(inverse(volume * remove(b / d2))), LIMITS)
    return field - ops.gradient(phi), how.iterations


def permeability(ops, u, laplacian, axis):
    """Of the sample, by Darcy's law; cell means where walls are faces of voxels."""
    points, n = ops.points, ops.n
    if points.geometry.level_walls:
        u = u + laplacian * (points.d[:n] ** 2 / 24.0)[:, None]
    lower, upper = points.geometry.sample_lower, points.geometry.sample_upper
    inside = inside_sample(points.geometry, points.x[:n])
    superficial = (u * points.volume[:, None])[inside].sum(axis=0) / np.prod(upper - lower)
    return darcy(points.geometry, superficial, axis, np.eye(3)[axis], 1.0)[axis]


def lost(ops, u):
    """Dissipation of each particle over its volume, (n,)."""
    square = ((u[ops.column] - u[ops.first]) ** 2).sum(axis=1)
    return (0.5 * np.bincount(ops.first, ops.symmetric * square, minlength=ops.n)
            + np.maximum(ops.lap_wall, 0.0) * (u**2).sum(axis=1))


def chosen(ops, u, share, buffer=BUFFER):
    """Cells of the strongest dissipation that hold `share` of it, and `buffer` cells round them."""
    points, density = ops.points, lost(ops, u)
    order = np.argsort(-density)
    most = np.searchsorted(np.cumsum(density[order]), share * density.sum()) + 1
    fine = np.zeros(points.fine.shape, bool)
    fine[tuple(points.cell[order[:most]].T)] = True
    if buffer:
        mode = "nearest" if points.pad.any() else "wrap"
        fine = ndimage.maximum_filter(fine, size=2 * buffer + 1, mode=mode)
    return fine


def solved(geometry, coarse, axis, fine=None):
    """(k, particles, iterations, CPU seconds, operators, velocity)."""
    begin = time.process_time()
    ops = Operators(Points(geometry, coarse, fine))
    u, laplacian, iterations = stokes(ops, axis)
    return (permeability(ops, u, laplacian, axis), ops.n, iterations, time.process_time() - begin, ops, u)


# -- what is measured -----------------------------------------------------------------------------------------


class Moved:
    """A periodic geometry whose body lies elsewhere on the lattice."""

    def __init__(self, inner, shift):
        self.__dict__["inner"], self.__dict__["shift"] = inner, np.asarray(shift)

    def __getattr__(self, name):
        found = getattr(self.inner, name)
        if name not in ("phase", "distance", "nearest", "crossing", "wall"):
            return found
        return lambda *points: found(*(p + self.shift if np.ndim(p) == 2 else p for p in points))


def exact():
    """What is left of linear and quadratic functions at a seam without walls, and of sines on finer and finer ones."""

    def open_space(x):
        return np.full(len(x), 3.0)

    for cells in (8, 16, 32):
        fine = np.zeros((cells,) * 3, bool)
        fine[cells // 4 : cells // 2, cells // 4 : 3 * cells // 4, cells // 4 : 3 * cells // 4] = True
        ops = Operators(Points(LevelGeometry(Body("open", "open", (1, 1, 1), 0, open_space)), 1.0 / cells, fine))
        x, seam, step = ops.points.x, ops.points.seam(), ops.step
        square = np.bincount(ops.first, ops.weights * (step[:, 0] ** 2 + 3 * step[:, 1] * step[:, 0]), minlength=ops.n)
        wave = np.sin(2 * np.pi * x[:, 0]) * np.cos(2 * np.pi * x[:, 1])
        slope = 2 * np.pi * np.cos(2 * np.pi * x[:, 0]) * np.cos(2 * np.pi * x[:, 1])
        errors = ops.lap @ wave + 8 * np.pi**2 * wave, ops.grad_p[0] @ wave - slope
        seen = [f"{np.sqrt(np.mean(e[part] ** 2)):.2e}" for e in errors for part in (seam, ~seam)]
        print(f"{cells} cells: gradient of x less one {np.abs(ops.tilt[0, 0] - 1).max():.0e}, Laplacian of a quadratic "
              f"function {np.abs(square - 2.0).max():.0e}; rms at the seam and away of the Laplacian of sines {seen[0]} "
              f"{seen[1]}, of their gradient {seen[2]} {seen[3]}; pairs a particle {len(step) / ops.n:.1f}", flush=True)


def diffused(geometry, coarse, axis, fine=None):
    """As `solved`, of the effective diffusivity; the volume of the fluid as `permeability.fluid_cells` has it."""
    begin = time.process_time()
    points = Points(geometry, coarse, fine)
    ops = Operators(points)
    flux, iterations = diffusion(ops, axis)
    fluid = (points.d**3 * np.clip(0.5 + ops.distance / points.d, 0.0, 1.0)).sum()
    mean = (points.volume * flux[:, axis]).sum() / points.volume.sum()
    porosity = fluid / np.prod(geometry.upper - geometry.lower)
    return mean * porosity, ops.n, iterations, time.process_time() - begin, ops, flux


SHIFTS = np.array([[0.0, 0.0, 0.0], [0.37, 0.71, 0.13], [0.81, 0.29, 0.57]])  # of the lattice, voxels
UNIFORM = 1.0, 2 / 3, 1 / 2
NAMES = ("throat", "spheres 0.45, 14", "cylinders 0.4, 16", "touching 9", "blobs 11", "blobs 12", "blobs 15", "blobs 16",
         "blobs 18")


def throat():
    """A tube of 24 voxels a period whose radius goes from 7 to 1.8 voxels and back: one throat rules it."""
    def level(x):
        radius = 1.8 + 5.2 * np.sin(np.pi * x[:, 0] / 24.0) ** 2
        return radius - np.hypot(*(x[:, k] - np.floor(x[:, k] / 16.0) * 16.0 - 8.2 for k in (1, 2)))

    return Body("throat", "throat", (24, 16, 16), 0, level)


def table_of(name, kinds, truth):
    """Prints a row a kind: error of k over the places of the lattice, particles, iterations, CPU seconds.
    kinds: (what it is called, function of (geometry) -> (k, particles, iterations, seconds))."""
    one = throat() if name == "throat" else body(name)
    for kind, run in kinds:
        found = [run(Moved(LevelGeometry(one), shift), one.axis) for shift in SHIFTS]
        errors = np.array([k for k, *_ in found]) / truth(one) - 1.0
        print(f"| {name} | {kind} | {100 * errors.mean():+.2f} | {100 * np.sqrt((errors**2).mean()):.2f} | "
              f"{np.mean([f[1] for f in found]):.0f} | {np.mean([f[2] for f in found]):.0f} | "
              f"{np.mean([f[3] for f in found]):.2f} |", flush=True)


def two(geometry, axis, coarse, share, solve):
    """With two spacings, the coarse solve that chooses the cells included in the seconds."""
    *_, seconds, ops, u = solved(geometry, coarse, axis)
    fine = chosen(ops, u, share)
    k, n, iterations, more = solve(geometry, coarse, axis, fine)[:4]
    return k, n, iterations, seconds + more


def kinds_of(solve, uniform=UNIFORM):
    return [(f"{1 / h:g}", lambda g, axis, h=h: solve(g, h, axis)[:4]) for h in uniform] + [
        (f"{1 / h:g} and {2 / h:g}, {share:g}", lambda g, axis, h=h, share=share: two(g, axis, h, share, solve))
        for h in uniform[:2] for share in SHARES]


HEAD = ("| body | particles a voxel | error, % | rms, % | particles | iterations | CPU s |\n"
        "|---|---|---|---|---|---|---|")


def truth_of(one):
    """A formula, or k at a quarter of a voxel."""
    return one.known[0] if one.known else solved(LevelGeometry(one), 1 / 4, one.axis)[0]


def scalar():
    """The effective diffusivity of arrays of insulating cylinders and spheres."""
    known = {"cylinders 0.4, 16": 1 / cylinders(0.4), "cylinders 0.2, 12": 1 / cylinders(0.2),
             "spheres 0.216, 12": 1 / spheres(0.216)}
    diffused(LevelGeometry(body("spheres 0.216, 12")), 2.0, 0)
    print(HEAD)
    for name, truth in known.items():
        table_of(name, kinds_of(diffused, (1.0, 2 / 3, 1 / 2, 1 / 3)), lambda _, truth=truth: truth)


def bodies(*names):
    solved(LevelGeometry(throat()), 2.0, 0)  # loads the kernels
    print(HEAD)
    for name in names or NAMES:
        known = truth_of(throat() if name == "throat" else body(name))
        table_of(name, kinds_of(solved), lambda _, known=known: known)


def rock(edge="32", walls="stairs", finest="3", *, where="x"):
    """A corner of Berea; finest: particles a voxel edge of what all are compared with."""
    crop = [[0, int(edge)]] * 3
    case = load_case(Path(__file__).parents[1] / "cases/berea.yaml",
                     [f"geometry.voxels.crop={crop}", f"geometry.wall_distance={walls}"])
    geometry, axis, voxel = build_geometry(case), "xyz".index(where), float(case.particles.spacing)
    against(geometry, axis, voxel, int(finest), f"Berea {edge}^3, {walls}")


def cubes(*names):
    """Known bodies as the cubes of their labels."""
    solved(LevelGeometry(throat()), 2.0, 0)
    for name in names or ("blobs 12", "blobs 15", "blobs 18", "touching 9"):
        with tempfile.TemporaryDirectory() as folder:
            geometry = build_geometry(case_of(body(name), "stairs", Path(folder)))
        against(geometry, body(name).axis, 1.0, 4, f"{name}, stairs")


def against(geometry, axis, voxel, finest, name):
    """Prints k of one and of two spacings, and how far it is from the limit of the two finest single ones."""
    found = {}

    def add(kind, *result):
        found[kind] = result
        print(f"  {name}: {kind}: {result[0] / voxel**2:.6g} {result[1:]}", file=sys.stderr, flush=True)

    for n in range(1, finest + 1):
        *result, ops, u = solved(geometry, voxel / n, axis)
        add(f"{n}", *result)
        for share in SHARES if 2 * n <= finest else ():
            again = solved(geometry, voxel / n, axis, chosen(ops, u, share))
            add(f"{n} and {2 * n}, {share:g}", *again[:3], result[3] + again[3])
    limit, bar = found[f"{finest}"][0], 0.0
    if geometry.level_walls:
        limit, bar, *_ = extrapolate([1 / (finest - 1), 1 / finest], [found[f"{m}"][0] for m in (finest - 1, finest)],
                                     EDGE)
    print(f"{name}: limit {limit / voxel**2:.5g} +- {bar / voxel**2:.2g} voxel^2")
    print("| particles a voxel edge | k, voxel^2 | from the limit, % | particles | iterations | CPU s |")
    print("|---|---|---|---|---|---|")
    for kind, (k, n, iterations, seconds) in found.items():
        print(f"| {kind} | {k / voxel**2:.5f} | {100 * (k / limit - 1):+.2f} | {n} | {iterations} | {seconds:.2f} |",
              flush=True)


if __name__ == "__main__":
    {"exact": exact, "scalar": scalar, "bodies": bodies, "rock": rock, "cubes": cubes}[sys.argv[1]](*sys.argv[2:])
