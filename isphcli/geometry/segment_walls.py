"""The first wall along a segment between shapes: exact chords, found by walking a grid of their convex pieces
(Amanatides and Woo 1987).
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numba import njit

from .bodies import BALL, BLOCK, CYLINDER, HALF_SPACE, ROUND_OFF

CELLS_A_PIECE = 8  # cells of the grid per piece: a bead then lies in about three cells along each axis


def extent_of(piece: np.ndarray) -> np.ndarray:
    """Half sides (m, 3) of the blocks round the pieces."""
    extent = np.full((len(piece), 3), np.inf)
    kind, axis = piece[:, 0].astype(int), piece[:, 7].astype(int)
    extent[kind == BALL] = piece[kind == BALL, 4:5]
    extent[kind == BLOCK] = piece[kind == BLOCK, 4:7]
    tube = np.flatnonzero(kind == CYLINDER)
    extent[tube] = piece[tube, 4:5]
    extent[tube, axis[tube]] = piece[tube, 5]
    return extent


def periodic_images(
    piece: np.ndarray, shape: np.ndarray, lower: np.ndarray, upper: np.ndarray, around: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pieces with their periodic images, as far as they reach into the box, and their shapes."""
    size, extent = upper - lower, extent_of(piece)
    piece = piece.copy()
    moves = np.isfinite(extent) & around
    centre = piece[:, 1:4]
    centre[:] = np.where(moves, lower + np.mod(centre - lower, size), centre)
    reach = np.ceil(np.max(np.where(moves, extent, 0.0), axis=0, initial=0.0) / size).astype(int)
    found, owner = [np.zeros((0, 8))], [np.zeros(0, dtype=np.int64)]
    for shift in itertools.product(*(range(-r, r + 1) for r in reach)):
        at = centre + np.array(shift) * size
        slack = extent + ROUND_OFF * size
        keep = ((at + slack >= lower) & (at - slack <= upper) | ~around).all(axis=1)
        keep &= (moves | (np.array(shift) == 0)).all(axis=1)
        found.append(np.column_stack([piece[keep, 0], at[keep], piece[keep, 4:]]))
        owner.append(shape[keep])
    return np.concatenate(found), np.concatenate(owner)


@njit(cache=True)
def fill_cells(piece, extent, lower, edge, counts):
    """Pieces of each cell: entry[start[c] : start[c + 1]], c = (z ny + y) nx + x."""
    cells = counts[0] * counts[1] * counts[2]
    start = np.zeros(cells + 1, np.int64)
    entry = np.zeros(0, np.int64)
    first, last = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for counting in (True, False):
        for p in range(len(piece)):
            for a in range(3):
                slack = extent[p, a] * (1.0 + 1e-9) + 1e-9 * edge[a]
                low = (piece[p, 1 + a] - slack - lower[a]) / edge[a]
                high = (piece[p, 1 + a] + slack - lower[a]) / edge[a]
                first[a] = int(np.floor(min(max(low, 0.0), counts[a] + 0.0)))
                last[a] = int(np.floor(min(max(high, -1.0), counts[a] - 1.0)))
            for z in range(first[2], last[2] + 1):
                for y in range(first[1], last[1] + 1):
                    for x in range(first[0], last[0] + 1):
                        if piece[p, 0] == BALL:
                            gap = 0.0
                            for a in range(3):
                                low = lower[a] + (x if a == 0 else y if a == 1 else z) * edge[a]
                                away = max(low - piece[p, 1 + a], piece[p, 1 + a] - low - edge[a], 0.0)
                                gap += away * away
                            if np.sqrt(gap) > extent[p, 0] * (1.0 + 1e-9) + 1e-9 * edge[0]:
                                continue
                        cell = (z * counts[1] + y) * counts[0] + x
                        if counting:
                            start[cell + 1] += 1
                        else:
                            entry[start[cell]] = p
                            start[cell] += 1
        if counting:
            start = np.cumsum(start)
            entry = np.zeros(start[-1], np.int64)
    start[1:] = start[:-1].copy()
    start[0] = 0
    return start, entry


class Line(NamedTuple):
    """A segment x + t dx, 0 <= t <= 1, and how it walks through the cells of a grid, for kernels.

    x, dx (3,): m; walk (3, 3): cell, step and steps left of each axis; face (3,): t of the next cell face of each axis;
    local (3,): x relative to the cell, without whole box lengths.
    """

    x: np.ndarray
    dx: np.ndarray
    walk: np.ndarray
    face: np.ndarray
    local: np.ndarray


@njit(cache=True, error_model="numpy", nogil=True)
def put_crossings(rows, xi, xj, grid, t):
    """Fraction of the way from xi to xj (n, dim) to the first wall into t (n,); grid: a `shape_geometry.PieceGrid`."""
    dim = xi.shape[1]
    lower, edge, counts, around = grid.lower, grid.edge, grid.counts, grid.around
    line = Line(np.zeros(3), np.zeros(3), np.zeros((3, 3), np.int64), np.zeros(3), np.zeros(3))
    x, dx, states = line.x, line.dx, (grid.solid, grid.outside, grid.filled)
    chords, owner = np.zeros((32, 2)), np.zeros(32, np.int64)
    for k in range(rows[0], rows[1]):
        end, r2 = 1.0, 0.0
        for a in range(dim):
            x[a], dx[a] = xi[k, a], xj[k, a] - xi[k, a]
            r2 += dx[a] * dx[a]
            if around[a]:
                period = edge[a] * counts[a]
                x[a] -= np.floor((x[a] - lower[a]) / period) * period
            elif dx[a] != 0.0:
                wall = lower[a] + edge[a] * counts[a] if dx[a] > 0 else lower[a]
                end = min(end, max((wall - x[a]) / dx[a], 0.0))
        if r2 > 0.0:
            least = grid.round_off / np.sqrt(r2)
            end, m, chords, owner = _chords(line, end, least, grid, chords, owner)
            end = _first_solid(chords, owner, m, end, least, states)
        t[k] = max(end, ROUND_OFF)


@njit(cache=True, error_model="numpy", forceinline=True)
def _chords(line, end, least, grid, chords, owner):
    """Chords (t_in, t_out) of a segment in the pieces of the cells that it passes (Amanatides and Woo 1987).

    Returns (end, m, chords, owner): where a piece that is surely solid begins, the number of chords before,
    the chords and their shapes, in longer arrays where those given are full.
    """
    x, dx, walk, face, local = line
    edge, counts, around, piece, shape = grid.edge, grid.counts, grid.around, grid.piece, grid.shape
    lower, start, entry, sure = grid.lower, grid.start, grid.entry, grid.sure
    m = 0
    for a in range(3):
        first = int(np.floor((x[a] - lower[a]) / edge[a]))
        last = int(np.floor((x[a] + end * dx[a] - lower[a]) / edge[a]))
        if not around[a]:
            first, last = min(max(first, 0), counts[a] - 1), min(max(last, 0), counts[a] - 1)
        walk[a, 0], walk[a, 1], walk[a, 2] = first, 1 if last > first else -1, abs(last - first)
        face[a] = _cell_face(line, grid, a)
    entered = 0.0
    while True:
        axis = 0 if face[0] <= face[1] and face[0] <= face[2] else 1 if face[1] <= face[2] else 2
        left = min(max(face[axis], entered), end)
        cell = 0
        for a in range(2, -1, -1):
            turns = 0 if 0 <= walk[a, 0] < counts[a] else walk[a, 0] // counts[a]  # a division takes ten times as long
            cell = cell * counts[a] + walk[a, 0] - turns * counts[a]
            local[a] = x[a] - turns * (edge[a] * counts[a])
        for q in range(start[cell], start[cell + 1]):
            p = entry[q]
            t_in, t_out = _chord(piece, p, local, dx)
            if piece[p, 0] == HALF_SPACE:  # a half-space has no images: it is cut where points are wrapped
                t_in, t_out = max(t_in, entered), min(t_out, left)
            if t_in >= t_out or t_in >= end or t_out <= 0.0:
                continue
            if sure[shape[p]]:
                if t_out - max(t_in, 0.0) > least:
                    end = max(t_in, 0.0)
                continue
            known = False
            for c in range(m):
                known |= chords[c, 0] == t_in and chords[c, 1] == t_out and owner[c] == shape[p]
            if known:
                continue
            if m == len(chords):
                chords = np.concatenate((chords, np.zeros_like(chords)))
                owner = np.concatenate((owner, np.zeros_like(owner)))
            chords[m, 0], chords[m, 1], owner[m] = t_in, t_out, shape[p]
            m += 1
        if walk[0, 2] + walk[1, 2] + walk[2, 2] == 0 or left >= end:
            return end, m, chords, owner
        entered = left
        walk[axis, 0] += walk[axis, 1]
        walk[axis, 2] -= 1
        face[axis] = _cell_face(line, grid, axis)


@njit(cache=True, error_model="numpy", forceinline=True)
def _cell_face(line, grid, a):
    """Place along the segment of the next cell face of axis a; infinite when no face is left."""
    walk = line.walk
    if walk[a, 2] == 0:
        return np.inf
    return (grid.lower[a] + (walk[a, 0] + (1 if walk[a, 1] > 0 else 0)) * grid.edge[a] - line.x[a]) / line.dx[a]


@njit(cache=True, error_model="numpy")
def _chord(piece, p, x, dx):
    """Where the line x + t dx enters and leaves piece p; (inf, -inf) if it misses it."""
    kind, axis = int(piece[p, 0]), int(piece[p, 7])
    if kind == HALF_SPACE:
        height, rise = 0.0, 0.0
        for a in range(3):
            height += (x[a] - piece[p, 1 + a]) * piece[p, 4 + a]
            rise += dx[a] * piece[p, 4 + a]
        if rise == 0.0:
            return (-np.inf, np.inf) if height < 0.0 else (np.inf, -np.inf)
        return (-height / rise, np.inf) if rise < 0.0 else (-np.inf, -height / rise)
    t_in, t_out = -np.inf, np.inf
    if kind == BLOCK:
        for a in range(3):
            low, high = _slab(x[a] - piece[p, 1 + a], dx[a], piece[p, 4 + a])
            t_in, t_out = max(t_in, low), min(t_out, high)
        return t_in, t_out
    away2, along, step2 = 0.0, 0.0, 0.0
    for a in range(3):
        if kind == BALL or a != axis:
            away = x[a] - piece[p, 1 + a]
            away2 += away * away
            along += away * dx[a]
            step2 += dx[a] * dx[a]
    power = away2 - piece[p, 4] * piece[p, 4]
    if step2 == 0.0:
        if power >= 0.0:
            return np.inf, -np.inf
    else:
        if along >= 0.0 and power >= 0.0:
            return np.inf, -np.inf
        root = along * along - step2 * power
        if root <= 0.0:
            return np.inf, -np.inf
        q = np.sqrt(root) + abs(along)  # without cancellation
        t_in, t_out = (power / q, q / step2) if along < 0.0 else (-q / step2, -power / q)
    if kind == CYLINDER:
        low, high = _slab(x[axis] - piece[p, 1 + axis], dx[axis], piece[p, 5])
        t_in, t_out = max(t_in, low), min(t_out, high)
    return t_in, t_out


@njit(cache=True, error_model="numpy")
def _slab(x, dx, half):
    """Where x + t dx is within half of 0."""
    if half == np.inf:
        return -np.inf, np.inf
    if dx == 0.0:
        return (-np.inf, np.inf) if abs(x) < half else (np.inf, -np.inf)
    low, high = (-half - x) / dx, (half - x) / dx
    return min(low, high), max(low, high)


@njit(cache=True, error_model="numpy")
def _first_solid(chords, owner, m, end, least, states):
    """Begin of the first part of the segment, longer than `least`, whose topmost shape is solid, or `end`. states:
    solid, outside, filled of a PieceGrid, all that is needed of it: to hand over all its arrays takes longer than this.
    """
    (solid, outside, filled), begin = states, 0.0
    while begin < end:
        stop = end  # next end of a chord
        for c in range(m):
            for side in range(2):
                if chords[c, side] > begin:
                    stop = min(stop, chords[c, side])
        if stop - begin > least:
            middle, is_solid = 0.5 * (begin + stop), filled
            for s in range(len(solid) - 1, -1, -1):
                inside = False
                for c in range(m):
                    inside |= owner[c] == s and chords[c, 0] < middle and middle < chords[c, 1]
                if inside != outside[s]:
                    is_solid = solid[s]
                    break
            if is_solid:
                return begin
        begin = stop
    return end
