"""The first wall along a segment between shapes: exact chords in their convex pieces, which a grid lists by cells."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numba import njit

from .bodies import BALL, BLOCK, CYLINDER, HALF_SPACE, ROUND_OFF

BALLS = 64  # solid balls near a point that are looked through together; what is beyond goes with the other pieces
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
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(pieces with their periodic images, as far as they reach into the box; their shapes; (m, 3) centres of the pieces
    that they are images of, and (m, 3) int64 how many boxes away from those)."""
    size, extent = upper - lower, extent_of(piece)
    piece = piece.copy()
    moves = np.isfinite(extent) & around
    centre = piece[:, 1:4]
    centre[:] = np.where(moves, lower + np.mod(centre - lower, size), centre)
    reach = np.ceil(np.max(np.where(moves, extent, 0.0), axis=0, initial=0.0) / size).astype(int)
    found, owner = [np.zeros((0, 8))], [np.zeros(0, dtype=np.int64)]
    origin, turns = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    for shift in itertools.product(*(range(-r, r + 1) for r in reach)):
        at = centre + np.array(shift) * size
        slack = extent + ROUND_OFF * size
        keep = ((at + slack >= lower) & (at - slack <= upper) | ~around).all(axis=1)
        keep &= (moves | (np.array(shift) == 0)).all(axis=1)
        found.append(np.column_stack([piece[keep, 0], at[keep], piece[keep, 4:]]))
        owner.append(shape[keep])
        origin.append(centre[keep])
        turns.append(np.broadcast_to(np.array(shift), origin[-1].shape))
    return np.concatenate(found), np.concatenate(owner), np.concatenate(origin), np.concatenate(turns)


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


class Surroundings(NamedTuple):
    """Pieces near the point x (3,) that segments begin in, for kernels.

    x: m, within the box along periodic axes; ball: those that are balls and surely solid, BALLS at most: the way to x
    from their centres, three (BALLS,), m, and its square less that of the radius, (BALLS,) m2, and room for where they
    are met; around (m, 14): the others, rows as in `Region.pieces`, with the way from the centre of the piece to x in
    the place of that centre, then the lower and upper corner, from x, of the box that the piece is taken from, infinite
    along closed axes; number (m, 5) int64: the piece, along each axis how many boxes away from that of x it is taken,
    its shape; cells (2, 3) int64, way (3,): scratch.
    """

    x: np.ndarray
    ball: tuple[np.ndarray, ...]
    around: np.ndarray
    number: np.ndarray
    cells: np.ndarray
    way: np.ndarray


@njit(cache=True, error_model="numpy", nogil=True)
def put_crossings(rows, xi, xj, grid, t):
    """Fraction of the way from xi to xj (n, dim) to the first wall into t (n,); grid: a `shape_geometry.PieceGrid`.
    Segments one after the other that begin in one point, as those to the neighbours of a particle, are looked up
    together; what one of them meets does not depend on the others."""
    dim, k = xi.shape[1], rows[0]
    lower, edge, counts, periodic = grid.lower, grid.edge, grid.counts, grid.around
    reach = np.zeros((2, 3))
    ball = np.zeros(BALLS), np.zeros(BALLS), np.zeros(BALLS), np.zeros(BALLS), np.zeros(BALLS)
    near = Surroundings(np.zeros(3), ball, np.zeros((32, 14)), np.zeros((32, 5), np.int64), np.zeros((2, 3), np.int64),
                        np.zeros(3))
    chords, owner = np.zeros((32, 2)), np.zeros(32, np.int64)
    while k < rows[1]:
        first = k
        for a in range(dim):
            near.x[a] = xi[first, a]
            if periodic[a]:
                period = edge[a] * counts[a]
                near.x[a] -= np.floor((near.x[a] - lower[a]) / period) * period
        k += 1
        while k < rows[1] and _same(xi, first, k):
            k += 1
        longest = _reach_of(xi, xj, (first, k), reach)
        balls, m, near = _pieces_near(near, reach, longest, grid)
        if m > len(owner):
            chords, owner = np.zeros((len(near.around), 2)), np.zeros(len(near.around), np.int64)
        _put_first_walls((first, k, balls, m), (xi, xj), near, grid, (chords, owner), longest, t)


@njit(cache=True, error_model="numpy", forceinline=True)
def _same(x, i, k):
    same = True
    for a in range(x.shape[1]):
        same &= x[i, a] == x[k, a]
    return same


@njit(cache=True, error_model="numpy", forceinline=True)
def _reach_of(xi, xj, rows, reach):
    """The greatest length of some segments, m; how far they go down and up along each axis into reach (2, 3), m."""
    longest = 0.0
    reach[:] = 0.0
    for k in range(rows[0], rows[1]):
        r2 = 0.0
        for a in range(xi.shape[1]):
            way = xj[k, a] - xi[k, a]
            r2 += way * way
            reach[0, a], reach[1, a] = min(reach[0, a], way), max(reach[1, a], way)
        longest = max(longest, r2)
    return np.sqrt(longest)


@njit(cache=True, error_model="numpy", forceinline=True)
def _pieces_near(near, reach, longest, grid):
    """(balls, others, Surroundings) with the pieces that segments from near.x may meet, in longer arrays where those
    given are full. reach (2, 3): from x to the lowest and the highest of their ends along each axis, longest: their
    greatest length, m."""
    x, (ball_x, ball_y, ball_z, power, _), around, number, cells, _ = near
    lower, edge, counts, piece, entry, balls, m = grid.lower, grid.edge, grid.counts, grid.piece, grid.entry, 0, 0
    shape, sure, periodic, longest = grid.shape, grid.sure, grid.around, longest * (1.0 + 1e-9)
    origin, turns, start = grid.origin, grid.turns, grid.start
    for a in range(3):
        for side in range(2):
            at = int(np.floor((x[a] + reach[side, a] - lower[a]) / edge[a]))
            cells[side, a] = at if periodic[a] else min(max(at, 0), counts[a] - 1)
    for z in range(cells[0, 2], cells[1, 2] + 1):
        z_turns = 0 if 0 <= z < counts[2] else z // counts[2]  # a division takes ten times as long
        layer = (z - z_turns * counts[2]) * counts[1]
        for y in range(cells[0, 1], cells[1, 1] + 1):
            y_turns = 0 if 0 <= y < counts[1] else y // counts[1]
            line = (layer + y - y_turns * counts[1]) * counts[0]
            for i in range(cells[0, 0], cells[1, 0] + 1):
                x_turns = 0 if 0 <= i < counts[0] else i // counts[0]
                cell = line + i - x_turns * counts[0]
                for q in range(start[cell], start[cell + 1]):
                    p = entry[q]
                    # from the piece itself: the same digits by whichever of its images it is found
                    w0 = x[0] - (origin[p, 0] + (turns[p, 0] + x_turns) * (edge[0] * counts[0]))
                    w1 = x[1] - (origin[p, 1] + (turns[p, 1] + y_turns) * (edge[1] * counts[1]))
                    w2, known = x[2] - (origin[p, 2] + (turns[p, 2] + z_turns) * (edge[2] * counts[2])), False
                    if piece[p, 0] == BALL:
                        far, away2 = longest + piece[p, 4] * (1.0 + 1e-9), w0 * w0 + w1 * w1 + w2 * w2
                        if away2 > far * far:
                            continue
                        if sure[shape[p]] and balls < BALLS:
                            for c in range(balls):
                                known |= ball_x[c] == w0 and ball_y[c] == w1 and ball_z[c] == w2
                            if not known:
                                ball_x[balls], ball_y[balls], ball_z[balls] = w0, w1, w2
                                power[balls] = away2 - piece[p, 4] * piece[p, 4]
                                balls += 1
                            continue
                    for c in range(m):
                        known |= number[c, 0] == p and number[c, 1] == x_turns and number[c, 2] == y_turns and (
                            number[c, 3] == z_turns)
                    if known:
                        continue
                    if m == len(around):
                        around = np.concatenate((around, np.zeros_like(around)))
                        number = np.concatenate((number, np.zeros_like(number)))
                    number[m, 0], around[m, 0], around[m, 1], around[m, 2], around[m, 3] = p, piece[p, 0], w0, w1, w2
                    number[m, 1], number[m, 2], number[m, 3], number[m, 4] = x_turns, y_turns, z_turns, shape[p]
                    for a in range(3):
                        period = edge[a] * counts[a]
                        low = lower[a] + number[m, 1 + a] * period - x[a]
                        around[m, 8 + a], around[m, 11 + a] = (low, low + period) if periodic[a] else (-np.inf, np.inf)
                    for a in range(4, 8):
                        around[m, a] = piece[p, a]
                    m += 1
    return balls, m, Surroundings(x, near.ball, around, number, cells, near.way)


@njit(cache=True, error_model="numpy", forceinline=True)
def _holding_all(around, number, m, longest, chords, owner):
    """(held, rest) of m pieces: those that hold every segment of at most `longest`, m, from x, such as the column round
    a pack, have endless chords; the rest, so many, comes before in the list."""
    held, longest = 0, longest * (1.0 + 1e-9)
    for p in range(m - 1, -1, -1):
        kind, axis, across2, depth = int(around[p, 0]), int(around[p, 7]), 0.0, np.inf
        for a in range(3):
            way = around[p, 1 + a]
            if kind == BALL or (kind == CYLINDER and a != axis):
                across2 += way * way
            elif kind == BLOCK:
                depth = min(depth, around[p, 4 + a] - abs(way))
            elif kind == CYLINDER:
                depth = min(depth, around[p, 5] - abs(way))
        if kind == BALL or kind == CYLINDER:
            depth = min(depth, around[p, 4] - np.sqrt(across2))
        if kind != HALF_SPACE and depth > longest:
            chords[held, 0], chords[held, 1], owner[held] = -np.inf, np.inf, number[p, 4]
            held, m = held + 1, m - 1
            for a in range(14):
                around[p, a] = around[m, a]
            for a in range(5):
                number[p, a] = number[m, a]
    return held, m


@njit(cache=True, error_model="numpy", forceinline=True)
def _put_first_walls(numbers, ends, near, grid, found, longest, t):
    """Puts the first wall of some segments into t: those from numbers[0] to numbers[1], of at most `longest`, m, that
    begin in near.x, beside numbers[2] solid balls and numbers[3] other pieces. ends: xi, xj of `put_crossings`; found:
    room for the chords (t_in, t_out) of a segment and the shapes that they are of.

    One function for all of them, because a tuple of arrays that is made in a loop takes longer than a piece.
    """
    (first, last, balls, m), (xi, xj), (chords, owner), dim = numbers, ends, found, ends[0].shape[1]
    lower, edge, counts, periodic, sure = grid.lower, grid.edge, grid.counts, grid.around, grid.sure
    x, (ball_x, ball_y, ball_z, power, met), around, number, states = near.x, near.ball, near.around, near.number, (
        grid.solid, grid.outside, grid.filled)
    held, m = _holding_all(around, number, m, longest, chords, owner)
    walled = _first_solid(chords, owner, held, 1.0, 0.0, states) < 1.0  # where no other piece is
    dx = near.way
    for q in range(first, last):
        end, step2, many = 1.0, 0.0, held
        for a in range(dim):
            dx[a] = xj[q, a] - xi[q, a]
            step2 += dx[a] * dx[a]
            if not periodic[a] and dx[a] != 0.0:
                wall = lower[a] + edge[a] * counts[a] if dx[a] > 0 else lower[a]
                end = min(end, max((wall - x[a]) / dx[a], 0.0))
        if step2 == 0.0:
            t[q] = 1.0
            continue
        least, dx0, dx1, dx2 = grid.round_off / np.sqrt(step2), dx[0], dx[1], dx[2]
        for c in range(balls):  # as `_chord`, without branches, so that it is vectors
            along = ball_x[c] * dx0 + ball_y[c] * dx1 + ball_z[c] * dx2
            root = along * along - step2 * power[c]
            far = np.sqrt(max(root, 0.0)) + abs(along)
            outer, inner = far / step2, power[c] / far
            t_in, t_out = (inner, outer) if along < 0.0 else (-outer, -inner)
            t_in = max(t_in, 0.0)
            met[c] = t_in if root > 0.0 and t_out - t_in > least else np.inf
        for c in range(balls):
            end = min(end, met[c])
        for p in range(m):
            t_in, t_out = _chord(around, p, dx)
            if around[p, 0] == HALF_SPACE:  # it has no images: it ends where points are wrapped
                for a in range(3):
                    low, high = around[p, 8 + a], around[p, 11 + a]
                    if dx[a] != 0.0:
                        t_in = max(t_in, min(low / dx[a], high / dx[a]))
                        t_out = min(t_out, max(low / dx[a], high / dx[a]))
                    elif low > 0.0 or high <= 0.0:  # a point on a face is wrapped to the lower one
                        t_out = -np.inf
            of, known = number[p, 4], t_in >= t_out or t_in >= end or t_out <= 0.0
            if sure[of]:
                if not known and t_out - max(t_in, 0.0) > least:
                    end = max(t_in, 0.0)
                continue
            for c in range(held, many):
                known |= chords[c, 0] == t_in and chords[c, 1] == t_out and owner[c] == of
            if not known:
                chords[many, 0], chords[many, 1], owner[many] = t_in, t_out, of
                many += 1
        if many > held or walled:
            end = _first_solid(chords, owner, many, end, least, states)
        t[q] = max(end, ROUND_OFF)


@njit(cache=True, error_model="numpy")
def _chord(piece, p, dx):
    """Where the line x + t dx enters and leaves a piece; (inf, -inf) if it misses it. Row p of piece: as in
    `Surroundings.around`."""
    kind, axis = int(piece[p, 0]), int(piece[p, 7])
    if kind == HALF_SPACE:
        height, rise = 0.0, 0.0
        for a in range(3):
            height += piece[p, 1 + a] * piece[p, 4 + a]
            rise += dx[a] * piece[p, 4 + a]
        if rise == 0.0:
            return (-np.inf, np.inf) if height < 0.0 else (np.inf, -np.inf)
        return (-height / rise, np.inf) if rise < 0.0 else (-np.inf, -height / rise)
    t_in, t_out = -np.inf, np.inf
    if kind == BLOCK:
        for a in range(3):
            low, high = _slab(piece[p, 1 + a], dx[a], piece[p, 4 + a])
            t_in, t_out = max(t_in, low), min(t_out, high)
        return t_in, t_out
    away2, along, step2 = 0.0, 0.0, 0.0
    for a in range(3):
        if kind == BALL or a != axis:
            away = piece[p, 1 + a]
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
        low, high = _slab(piece[p, 1 + axis], dx[axis], piece[p, 5])
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
