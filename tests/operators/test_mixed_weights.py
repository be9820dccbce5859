"""Operators of two spacings: exact where they meet, and of what order."""

import numpy as np

from isphcli.domain.lattice import make_lattice
from isphcli.operators.apply import laplacian
from isphcli.operators.mixed_weights import build_mixed_operators
from isphcli.runs.half_in_throats import place_two
from tests.operators.walls import channel


def between_plates(cells, width=1.0):
    """Operators and faces between plates at y = 0 and `width`, and particles, of which a block at a plate is cut."""
    dx, geometry = 1.0 / cells, channel(3, width)
    lattice = make_lattice("cubic", geometry.lower, geometry.upper, geometry.periodic, dx, 2.1 * dx)
    cut = np.zeros(lattice.counts, bool)
    # the lattice goes on beyond the plates
    beyond = round(-lattice.corner[1] / dx)
    cut[cells // 4 : cells // 2, : beyond + cells // 2, cells // 4 : 3 * cells // 4] = True
    particles = place_two(geometry, lattice, cut, dx, 2.1 * dx)
    return *build_mixed_operators(geometry, particles, 0, 2.1 * dx)[:2], particles


def rows(ops, particles):
    """(pairs of each row (n_pairs,), rows that see both spacings, rows that see no wall), (n,) bool each."""
    first = np.repeat(np.arange(ops.n), np.diff(ops.start))
    other = particles.half[first] != particles.half[ops.column]
    return first, np.bincount(first, other, minlength=ops.n) > 0, ~ops.walls.near_wall


def test_functions_of_second_order_are_exact_where_spacings_meet():
    """Velocities with their values at walls, pressures away from them; of third order half of the rows (`HEAVIEST`)."""
    ops, _, particles = between_plates(8)
    first, mixed, free = rows(ops, particles)
    assert mixed.sum() > 300 and (mixed & free).sum() > 100
    table, row = ops.neighbours.x, ops.neighbours.row
    y = table[:, 1]
    parabola = y * (1.0 - y)
    sums = np.bincount(first, ops.lap * (parabola[row] - parabola[first]), minlength=ops.n)
    lap = sums - ops.walls.lap * parabola[: ops.n]
    assert np.abs(lap + 2.0).max() < 1e-8  # weights beside walls are about 1e3
    square = table[:, 0] ** 2 + table[:, 0] * table[:, 2]
    slope = np.bincount(first, ops.grad_p[:, 0] * (square[row] - square[first]), minlength=ops.n)
    assert np.abs(slope - 2 * table[: ops.n, 0] - table[: ops.n, 2])[mixed & free].max() < 1e-9
    cube = table[:, 0] ** 3 + table[:, 0] * table[:, 2] ** 2
    left = np.bincount(first, ops.lap * (cube[row] - cube[first]), minlength=ops.n) - 8.0 * table[: ops.n, 0]
    assert np.mean(np.abs(left[mixed & free]) < 1e-8) > 0.4  # measured 0.52, of a block of few cells; without any 0


def test_order_where_spacings_meet():
    """The Laplacian of sines converges there, fitted over three spacings: with order 2 where it is exact for functions
    of third order, with 1 in the few rows where it is not."""
    errors = []
    for cells in (8, 12, 16):
        ops, _, particles = between_plates(cells)
        _, mixed, free = rows(ops, particles)
        wave = np.prod(np.sin(2.0 * np.pi * particles.x[: ops.n] + [0.3, 0.8, 1.1]), axis=1)
        error = laplacian(ops, wave[:, None])[:, 0] + 12.0 * np.pi**2 * wave
        errors.append(np.sqrt(np.mean(error[mixed & free] ** 2)))
    assert np.polyfit(np.log([8, 12, 16]), np.log(errors), 1)[0] < -1.0


def test_cells_share_faces_and_balances_are_symmetric():
    """Conductances of one: every inner cell has area over distance of its faces, both ways the same."""
    ops, faces, particles = between_plates(8)
    matrix = faces.conductance(np.ones(ops.n), np.zeros(ops.n))
    assert abs(matrix - matrix.T).max() < 1e-12
    linear = particles.x[: ops.n, 0] / particles.spacing
    found = matrix @ linear
    _, mixed, free = rows(ops, particles)
    inside = free & ~mixed & (linear > 1.0) & (linear < 7.0)  # of the cells: not round the period
    assert np.abs(found[inside]).max() < 1e-9
