"""The nearest point of a wall among the surfaces of shapes, where min and max of their distances are only bounds.

A wall is where there is solid beside fluid. Candidates are the surfaces near by, the lines where two of them meet and
the points of three; those beside which there is both fluid and solid count. `grid` of the kernels is a
`shape_geometry.PieceGrid`.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from .bodies import BALL, BLOCK, CYLINDER, HALF_SPACE

PLANE, ROUND = range(2)  # surfaces of pieces, see `_surfaces_near`
MOST_SURFACES = 48  # nearest ones on which a wall is looked for
PROBE = 1e-9  # of the largest side of the box: distance from a point at which its surroundings are sampled


class Near(NamedTuple):
    """Surfaces near a point, and room to work in, for kernels.

    surface (MOST_SURFACES + 1, 9): rows as in `_surfaces_near`, the last for a candidate; distance: of each (n,), m;
    row (9,): of the candidate; slope, twin (3,); chosen (3,): numbers of the surfaces that are tried together, slopes
    (3, 3): their gradients at a point, gram (3, 3), side (3,): a linear system of them.
    """

    surface: np.ndarray
    distance: np.ndarray
    row: np.ndarray
    slope: np.ndarray
    twin: np.ndarray
    chosen: np.ndarray
    slopes: np.ndarray
    gram: np.ndarray
    side: np.ndarray


class Query(NamedTuple):
    """A point x (3,) whose nearest wall is looked for: no nearer than `least`, m; solid is `wanted` there, or fluid."""

    x: np.ndarray
    least: float
    wanted: bool


@njit(cache=True)
def _inside(piece, p, x, y, z):
    """Whether a point lies inside a piece, not on its surface."""
    x, y, z = x - piece[p, 1], y - piece[p, 2], z - piece[p, 3]
    kind = piece[p, 0]
    if kind == BALL:
        return x * x + y * y + z * z < piece[p, 4] ** 2
    if kind == BLOCK:
        return abs(x) < piece[p, 4] and abs(y) < piece[p, 5] and abs(z) < piece[p, 6]
    if kind == HALF_SPACE:
        return x * piece[p, 4] + y * piece[p, 5] + z * piece[p, 6] < 0.0
    axis = piece[p, 7]
    along = x if axis == 0 else y if axis == 1 else z
    return x * x + y * y + z * z - along * along < piece[p, 4] ** 2 and abs(along) < piece[p, 5]


@njit(cache=True)
def _topmost(x, y, z, grid):
    """The topmost shape that holds a point, -1 where it is none, -2 beyond a face that is a wall."""
    edge, counts, start, entry, piece, shape = grid.edge, grid.counts, grid.start, grid.entry, grid.piece, grid.shape
    outside, cell = grid.outside, 0
    at = (x, y, z)
    for a in range(2, -1, -1):
        i = int(np.floor((at[a] - grid.lower[a]) / edge[a]))
        turns = 0 if 0 <= i < counts[a] else i // counts[a]  # a division takes ten times as long
        if turns != 0 and not grid.around[a]:
            return -2
        if turns != 0:
            length = edge[a] * counts[a]
            x, y, z = (x - turns * length, y, z) if a == 0 else (x, y - turns * length, z) if a == 1 else (
                x, y, z - turns * length)
        cell = cell * counts[a] + i - turns * counts[a]
    top = -1
    for q in range(start[cell], start[cell + 1]):
        s = shape[entry[q]]
        if s > top and not outside[s] and _inside(piece, entry[q], x, y, z):
            top = s
    for s in range(len(outside) - 1, top, -1):
        if outside[s]:
            held = False
            for q in range(start[cell], start[cell + 1]):
                held |= shape[entry[q]] == s and _inside(piece, entry[q], x, y, z)
            if not held:
                return s
    return top


@njit(cache=True)
def _is_solid(x, y, z, grid):
    top = _topmost(x, y, z, grid)
    return True if top == -2 else grid.filled if top == -1 else bool(grid.solid[top])


def _directions() -> np.ndarray:
    """(m, 3) unit vectors all round, turned off the axes, so that none lies in a face of a box."""
    steps = np.array([v for v in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(v)])
    return steps / np.linalg.norm(steps, axis=1)[:, None] @ Rotation.from_euler("xyz", [0.17, 0.23, 0.31]).as_matrix()


def in_3d(x: np.ndarray) -> np.ndarray:
    """Points (n, 3), z = 0 in 2D."""
    return np.ascontiguousarray(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))


# Unit vectors along which the surroundings of a point are sampled; the 16 of the plane are turned off its axes
ROUND_ABOUT = _directions()
ROUND_ABOUT_2D = np.array([[np.cos(a), np.sin(a), 0.0] for a in (np.arange(16) + 0.3) * np.pi / 8])


@njit(cache=True, nogil=True)
def put_beside(rows, x, grid, found):
    """A fluid shape (-1: what fills the box) beside each point, -2 if there is solid beside it too, into found (n,)."""
    ways, step = ROUND_ABOUT_2D if grid.dim == 2 else ROUND_ABOUT, grid.probe
    for k in range(rows[0], rows[1]):
        beside = -2
        for w in range(len(ways)):
            top = _topmost(
                x[k, 0] + step * ways[w, 0], x[k, 1] + step * ways[w, 1], x[k, 2] + step * ways[w, 2], grid
            )
            if top == -2 or (top == -1 and grid.filled) or (top >= 0 and grid.solid[top]):
                beside = -2
                break
            beside = max(beside, top)
        found[k] = beside


@njit(cache=True)
def _value(surface, s, p, slope):
    """Signed distance of point p to a surface; its gradient goes to slope."""
    if surface[s, 0] == PLANE:
        f = -surface[s, 4]
        for a in range(3):
            slope[a] = surface[s, 1 + a]
            f += slope[a] * p[a]
        return f
    r = 0.0
    for a in range(3):
        slope[a] = (p[a] - surface[s, 1 + a]) * surface[s, 5 + a]
        r += slope[a] * slope[a]
    r = np.sqrt(r)
    if r == 0.0:  # at the centre all directions are alike
        slope[0 if surface[s, 5] > 0 else 1] = 1.0
    else:
        slope /= r
    return r - surface[s, 4]


@njit(cache=True)
def _add_surface(near, n, x, reach, step):
    """Put the surface near.row on the list of the n nearest, if it is within reach and new; returns how many there
    are."""
    surface, row, distance = near.surface, near.row, near.distance
    surface[-1] = row
    f = abs(_value(surface, len(surface) - 1, x, near.slope))
    if f > reach:
        return n
    for s in range(n):
        same = surface[s, 0] == row[0] and abs(surface[s, 4] - row[4]) < 0.1 * step
        for a in range(3):
            small = 1e-12 if row[0] == PLANE else 0.1 * step
            same &= abs(surface[s, 1 + a] - row[1 + a]) < small and surface[s, 5 + a] == row[5 + a]
        if same:
            return n
    at = n
    if n == MOST_SURFACES:
        at = int(np.argmax(distance[:n]))
        if f >= distance[at]:
            return n
    surface[at] = row
    distance[at] = f
    return min(n + 1, MOST_SURFACES)


@njit(cache=True)
def _surfaces_near(x, reach, grid, near):
    """Planes and round surfaces of the pieces within reach of point x, periodic images too, and closed faces: how many
    there are now in `near`.

    Rows of surface: kind; normal (3,) of a plane or centre (3,); offset of the plane or radius; of round ones 1 along
    the axes that count (a cylinder leaves one out), of planes 0; the shape, -1 of a face.
    """
    lower, edge, counts, piece, row = grid.lower, grid.edge, grid.counts, grid.piece, near.row
    start, entry, step, n = grid.start, grid.entry, grid.probe, np.int64(0)  # a literal 0 would be a type of its own
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for a in range(3):
        first[a] = int(np.floor((x[a] - reach - lower[a]) / edge[a]))
        last[a] = int(np.floor((x[a] + reach - lower[a]) / edge[a]))
        if not grid.around[a]:
            first[a] = min(max(first[a], 0), counts[a] - 1)
            last[a] = min(max(last[a], 0), counts[a] - 1)
            if a < grid.dim:
                for side in range(2):
                    row[:] = 0.0
                    row[1 + a], row[4], row[8] = 1.0, lower[a] + side * edge[a] * counts[a], -1.0
                    n = _add_surface(near, n, x, reach, step)
    for z in range(first[2], last[2] + 1):
        for y in range(first[1], last[1] + 1):
            for i in range(first[0], last[0] + 1):
                tx, ty, tz = i // counts[0], y // counts[1], z // counts[2]
                cell = ((z - tz * counts[2]) * counts[1] + y - ty * counts[1]) * counts[0] + i - tx * counts[0]
                for q in range(start[cell], start[cell + 1]):
                    p = entry[q]
                    kind = piece[p, 0]
                    c = (piece[p, 1] + tx * edge[0] * counts[0], piece[p, 2] + ty * edge[1] * counts[1],
                         piece[p, 3] + tz * edge[2] * counts[2])
                    row[:] = 0.0
                    row[8] = grid.shape[p]
                    if kind == HALF_SPACE:
                        for a in range(3):
                            row[1 + a] = piece[p, 4 + a]
                            row[4] += row[1 + a] * c[a]
                        n = _add_surface(near, n, x, reach, step)
                        continue
                    if kind != BLOCK:
                        row[0], row[4] = ROUND, piece[p, 4]
                        for a in range(3):
                            row[1 + a] = c[a]
                            row[5 + a] = 0.0 if kind == CYLINDER and a == piece[p, 7] else 1.0
                        n = _add_surface(near, n, x, reach, step)
                    if kind == BALL:
                        continue
                    for a in range(3):
                        half = piece[p, 4 + a] if kind == BLOCK else piece[p, 5] if a == piece[p, 7] else np.inf
                        if half == np.inf:
                            continue
                        for side in (-1.0, 1.0):
                            row[:8] = 0.0
                            row[1 + a], row[4] = 1.0, c[a] + side * half
                            n = _add_surface(near, n, x, reach, step)
    return n


@njit(cache=True)
def _solve(g, b, m):
    """Solution of the symmetric m by m system g x = b in place of b; False where it is singular."""
    for i in range(m):
        if g[i, i] < 1e-10:
            return False
        for j in range(i + 1, m):
            factor = g[j, i] / g[i, i]
            for k in range(i, m):
                g[j, k] -= factor * g[i, k]
            b[j] -= factor * b[i]
    for i in range(m - 1, -1, -1):
        for j in range(i + 1, m):
            b[i] -= g[i, j] * b[j]
        b[i] /= g[i, i]
    return True


@njit(cache=True)
def _foot(x, p, m, near, grid):
    """Move p to the point nearest to x that lies on all m chosen surfaces; False where none is found."""
    surface, chosen, j, g, b = near.surface, near.chosen, near.slopes, near.gram, near.side
    scale = grid.probe / PROBE
    for turn in range(60):
        # full steps along tight curves swing about the point nearest to x; the last ones only return to the surfaces
        share = 1.0 if turn < 15 else 0.4 if turn < 30 else 0.15 if turn < 50 else 0.0
        off = 0.0
        for i in range(m):
            b[i] = -_value(surface, chosen[i], p, j[i])
            off = max(off, abs(b[i]))
            for a in range(3):
                b[i] -= share * j[i, a] * (x[a] - p[a])
        if m == grid.dim and turn == 12 and off > 1e-3 * scale:  # the surfaces do not meet
            return False
        for i in range(m):
            for k in range(m):
                g[i, k] = j[i, 0] * j[k, 0] + j[i, 1] * j[k, 1] + j[i, 2] * j[k, 2]
        if not _solve(g, b, m):
            return False
        moved = 0.0
        for a in range(3):
            to = p[a] + share * (x[a] - p[a])
            for i in range(m):
                to += b[i] * j[i, a]
            moved = max(moved, abs(to - p[a]))
            p[a] = to
        if not moved < 1e6 * scale:
            return False
        if moved < 1e-13 * scale:
            break
    for i in range(m):
        if not abs(_value(surface, chosen[i], p, j[i])) < 1e-12 * scale:
            return False
    return True


@njit(cache=True)
def _well_inside(p, grid):
    """Whether all that is sampled round point p lies in one ball of a shape that is solid whatever the others are."""
    cell = 0
    for a in range(2, -1, -1):
        i = int(np.floor((p[a] - grid.lower[a]) / grid.edge[a]))
        if not 0 <= i < grid.counts[a]:
            return False
        cell = cell * grid.counts[a] + i
    for q in range(grid.start[cell], grid.start[cell + 1]):
        c = grid.entry[q]
        if grid.piece[c, 0] == BALL and grid.sure[grid.shape[c]]:
            away = 0.0
            for a in range(3):
                away += (p[a] - grid.piece[c, 1 + a]) ** 2
            if away < max(grid.piece[c, 4] - 2.0 * grid.probe, 0.0) ** 2:
                return True
    return False


@njit(cache=True)
def _meets(p, m, wanted, near, grid):
    """Whether there is solid (wanted True) or fluid (False) beside point p, on m surfaces of gradients near.slopes.

    Sampled are all sides of the surfaces and directions all round.
    """
    j, g, b, dim, step = near.slopes, near.gram, near.side, grid.dim, grid.probe
    ways = ROUND_ABOUT_2D if dim == 2 else ROUND_ABOUT
    if not wanted and _well_inside(p, grid):
        return False
    for w in range(2**m + len(ways)):
        d0, d1, d2 = 0.0, 0.0, 0.0
        if w < 2**m:
            for i in range(m):
                b[i] = 1.0 if (w >> i) & 1 else -1.0
                for k in range(m):
                    g[i, k] = j[i, 0] * j[k, 0] + j[i, 1] * j[k, 1] + j[i, 2] * j[k, 2]
            if not _solve(g, b, m):
                continue
            for i in range(m):
                d0, d1, d2 = d0 + b[i] * j[i, 0], d1 + b[i] * j[i, 1], d2 + b[i] * j[i, 2]
            size = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
            d0, d1, d2 = d0 / size + 4e-4, d1 / size + 9e-4, d2 / size + (5e-4 if dim == 3 else 0.0)
        else:
            d0, d1, d2 = ways[w - 2**m, 0], ways[w - 2**m, 1], ways[w - 2**m, 2]
        if wanted == _is_solid(p[0] + step * d0, p[1] + step * d1, p[2] + step * d2, grid):
            return True
    return False


@njit(cache=True, nogil=True)
def put_walls(rows, x, d, wall, grid):
    """Put the signed distance to the nearest wall and its index in place of lower bounds d (n,) and the indices (n,) of
    the surfaces that they are to.

    x: (n, 3) in the box or beyond closed faces. Walls are where there is solid beside fluid. The nearest point of them
    is the foot of x on one surface, on the line where two meet or on a point of three: those of the surfaces near by
    are tried.
    """
    dim, step = grid.dim, grid.probe
    size = np.sqrt(((grid.edge[:dim] * grid.counts[:dim]) ** 2).sum())
    near = Near(np.zeros((MOST_SURFACES + 1, 9)), np.zeros(MOST_SURFACES), np.zeros(9), np.zeros(3), np.zeros(3),
                np.zeros(3, np.int64), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3))
    p, at = np.zeros(3), np.zeros(3)
    ways, away = ROUND_ABOUT_2D if dim == 2 else ROUND_ABOUT, 4.0 * step
    for k in range(rows[0], rows[1]):
        at[:], p[:] = x[k], 0.0
        least = abs(d[k])
        wanted = d[k] > 0.0  # in fluid solid is looked for, in a solid fluid
        if least <= 2.0 * step:  # on a surface, which is a wall or lies inside fluid or inside solid
            here, other = False, False
            for w in range(len(ways)):
                is_solid = _is_solid(
                    at[0] + away * ways[w, 0], at[1] + away * ways[w, 1], at[2] + away * ways[w, 2], grid
                )
                here, other = here | is_solid, other | (not is_solid)
            if here and other:
                continue
            wanted = not here
        elif _met_at_once(Query(at, least, wanted), wall[k] - 1 - 2 * dim, p, grid):
            continue
        query = Query(at, least, wanted)
        reach, best, owner = least * (1.0 + 1e-9) + 4.0 * step, np.inf, np.int64(-1)  # typed, as above
        while True:
            order = np.argsort(near.distance[: _surfaces_near(at, reach, grid, near)])
            for count in range(1, dim + 1):
                best, owner = _nearest_foot(query, order, count, (best, owner), p, near, grid)
            if best <= reach or reach > 2.0 * size:
                break
            reach = 2.0 * reach + 0.01 * size
        if best < np.inf:
            d[k] = max(best, least) if wanted else -max(best, least)
            if owner >= 0:
                wall[k] = 1 + 2 * dim + owner


@njit(cache=True)
def _twin(near, count, p):
    """Mirror image of a point that `count` (the dimension) surfaces share, in the plane that holds the centres of the
    round ones and the normals of the planes, where they meet too; False where there is none."""
    surface, chosen, j, twin = near.surface, near.chosen, near.gram, near.twin
    centre, m = -1, 0
    for i in range(count):
        c = chosen[i]
        if surface[c, 0] == PLANE:
            j[m] = surface[c, 1:4]
            m += 1
        elif centre < 0:
            centre = c
        else:
            j[m] = surface[c, 1:4] - surface[centre, 1:4]
            m += 1
    if count == 2:
        j[1, 0], j[1, 1], j[1, 2] = 0.0, 0.0, 1.0
    twin[0] = j[0, 1] * j[1, 2] - j[0, 2] * j[1, 1]
    twin[1] = j[0, 2] * j[1, 0] - j[0, 0] * j[1, 2]
    twin[2] = j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]
    size = np.sqrt((twin * twin).sum())
    if size == 0.0:
        return False
    twin /= size
    height = 0.0
    for a in range(3):
        height += (p[a] - surface[centre, 1 + a]) * twin[a]
    for a in range(3):
        twin[a] = p[a] - 2.0 * height * twin[a]
    return True


@njit(cache=True)
def _foot_on_balls(x, p, m, near, dim):
    """Move p to the point nearest to x that lies on all m chosen balls, in closed form: on one, on the circle where two
    meet, or the nearer one of the two points of three, the other one into near.twin; False where they do not meet. In
    2D two meet in two points."""
    surface, chosen, twin, e, b = near.surface, near.chosen, near.twin, near.gram, near.side
    c0, radius = chosen[0], surface[chosen[0], 4]
    left = radius * radius  # square of the radius of what the balls so far have in common, round the point p
    for a in range(3):
        p[a] = surface[c0, 1 + a]
    for i in range(1, m):  # e[i - 1]: unit vector from the first centre to this one, across those before
        c, size2, far2, along = chosen[i], 0.0, 0.0, 0.0
        for a in range(3):
            e[i - 1, a] = surface[c, 1 + a] - surface[c0, 1 + a]
            far2 += e[i - 1, a] ** 2
        for k in range(i - 1):
            b[k] = 0.0
            for a in range(3):
                b[k] += e[i - 1, a] * e[k, a]
            for a in range(3):
                e[i - 1, a] -= b[k] * e[k, a]
        for a in range(3):
            size2 += e[i - 1, a] ** 2
        if size2 <= 1e-20 * far2 or far2 == 0.0:
            return False
        size = np.sqrt(size2)
        for a in range(3):
            e[i - 1, a] /= size
        # (q - c0)^2 = R0^2 and (q - c)^2 = R^2: 2 (q - c0) (c - c0) = R0^2 - R^2 + (c - c0)^2
        along = 0.5 * (radius * radius - surface[c, 4] ** 2 + far2)
        for a in range(3):
            for k in range(i - 1):
                along -= (p[a] - surface[c0, 1 + a]) * b[k] * e[k, a]
        along /= size
        left -= along * along
        if left < 0.0:
            return False
        for a in range(3):
            p[a] += along * e[i - 1, a]
    _towards(x, p, m, e, b, dim)
    for a in range(3):
        twin[a] = p[a] - np.sqrt(left) * b[a]
        p[a] += np.sqrt(left) * b[a]
    return True


@njit(cache=True)
def _towards(x, p, m, e, b, dim):
    """The unit vector from p to x across the first m - 1 rows of e into b; where x is right beside p, one
    that is across them."""
    if m == dim:  # one way is left, and its opposite
        if dim == 3:
            for a in range(3):
                b[a] = e[0, (a + 1) % 3] * e[1, (a + 2) % 3] - e[0, (a + 2) % 3] * e[1, (a + 1) % 3]
        else:
            b[0], b[1], b[2] = -e[0, 1], e[0, 0], 0.0
        along = 0.0
        for a in range(3):
            along += b[a] * (x[a] - p[a])
        if along < 0.0:
            for a in range(3):
                b[a] = -b[a]
        return
    for start in range(4):
        whole = 0.0
        for a in range(3):
            b[a] = x[a] - p[a] if start == 0 else 1.0 if a == start - 1 else 0.0
            whole += b[a] * b[a]
        for _ in range(2):  # once more, for what rounding leaves along the rows
            size = 0.0
            for k in range(m - 1):
                along = 0.0
                for a in range(3):
                    along += b[a] * e[k, a]
                for a in range(3):
                    b[a] -= along * e[k, a]
            for a in range(3):
                size += b[a] * b[a]
            if size <= 1e-24 * whole:
                break
            whole = 1.0
            for a in range(3):
                b[a] /= np.sqrt(size)
        if size > 1e-24 * whole:
            return


@njit(cache=True)
def _nearest_foot(query, order, count, known, p, near, grid):
    """(best, owner): distance of the nearest point of a wall on `count` of the surfaces near by, if it is nearer than
    that of `known`, and a shape whose surface it is on. order (m,): the surfaces, nearest first; p (3,): workspace."""
    best, owner = known
    m, x, least, dim, step = len(order), query.x, query.least, grid.dim, grid.probe
    surface, distance, chosen, twin = near.surface, near.distance, near.chosen, near.twin
    for i0 in range(m):
        if distance[order[i0]] >= best:
            break
        for i1 in range(i0 + 1 if count > 1 else 0, m if count > 1 else 1):
            if count > 1 and distance[order[i1]] >= best:
                break
            for i2 in range(i1 + 1 if count > 2 else 0, m if count > 2 else 1):
                if count > 2 and distance[order[i2]] >= best:
                    break
                chosen[0], chosen[1], chosen[2] = order[i0], order[i1], order[i2]
                curved, tube, balls = False, False, True
                for i in range(count):
                    curved |= surface[chosen[i], 0] == ROUND
                    balls &= surface[chosen[i], 0] == ROUND
                    for a in range(dim):
                        tube |= surface[chosen[i], 0] == ROUND and surface[chosen[i], 5 + a] == 0.0
                balls &= not tube
                # round surfaces also meet on their far sides; on the line between two centres their gradients are
                # parallel
                found = False
                for side in range(1 + (count == dim) if balls else count + 4 if curved and count > 1 else 1):
                    middle = chosen[min(max(side - 1, 0), count - 1)]
                    if balls:
                        if side == 0 and not _foot_on_balls(x, p, count, near, dim):
                            break
                        off = 0.0
                        for a in range(dim if side == 1 else 0):
                            p[a] = twin[a]
                        for i in range(count):  # and the gradients there
                            off = max(off, abs(_value(surface, chosen[i], p, near.slopes[i])))
                        if not off < 1e-12 * step / PROBE:
                            continue
                    else:
                        if 0 < side <= count and (surface[middle, 0] == PLANE or (found and not tube)):
                            continue
                        if (count < side < count + 3 and found) or (side == count + 3 and not (found and count == dim)):
                            continue
                        for a in range(dim):
                            p[a] = twin[a] if side > count + 2 else x[a]
                            if count < side < count + 3:
                                aside = 0.3 * distance[chosen[count - 1]]
                                p[a] += aside * ROUND_ABOUT[0, a] * (1.0 if side == count + 1 else -1.0)
                            elif 0 < side <= count and surface[middle, 5 + a] > 0.0:
                                p[a] = 2.0 * surface[middle, 1 + a] - x[a]
                        if not _foot(x, p, count, near, grid):
                            continue
                        if curved and not found:
                            found = count < dim or _twin(near, count, p)
                    away = np.sqrt((p[0] - x[0]) ** 2 + (p[1] - x[1]) ** 2 + (p[2] - x[2]) ** 2)
                    if away < best and away > least * (1.0 - 1e-9) - step and _meets(
                        p, count, query.wanted, near, grid
                    ):
                        best, owner = away, int(surface[chosen[0], 8])
                        if best <= least * (1.0 + 1e-9) + step:
                            return best, owner
    return best, owner


@njit(cache=True)
def _met_at_once(query, k, p, grid):
    """Whether there is a wall right at the foot of the point on the piece of shape k that holds it, or on the tube or
    ball that it is outside of, where the shape is what is outside (k < 0: on the faces). p (3,): workspace."""
    lower, edge, counts, piece, dim, step = grid.lower, grid.edge, grid.counts, grid.piece, grid.dim, grid.probe
    x, least, wanted = query
    if k < 0:
        for a in range(3):
            inside = 2.0 * step if a < dim else 0.0
            low, high = lower[a] + inside, lower[a] + edge[a] * counts[a] - inside
            p[a] = x[a] if grid.around[a] else min(max(x[a], low), high)
            p[a] += 0.3 * inside * ROUND_ABOUT[0, a]  # not on a seam
        return wanted == _is_solid(p[0], p[1], p[2], grid)
    cell = 0
    for a in range(2, -1, -1):
        i = int(np.floor((x[a] - lower[a]) / edge[a]))
        cell = cell * counts[a] + min(max(i, 0), counts[a] - 1)
    for q in range(grid.start[cell], grid.start[cell + 1]):
        c = grid.entry[q]
        outward = 1.0 if _inside(piece, c, x[0], x[1], x[2]) else -1.0  # the way to the surface
        if grid.shape[c] != k:
            continue
        if outward < 0.0 and (not grid.outside[k] or (piece[c, 0] != CYLINDER and piece[c, 0] != BALL)):
            continue
        p[:] = x
        middle = False
        if piece[c, 0] == BLOCK:
            for a in range(dim):
                if abs(piece[c, 4 + a] - abs(x[a] - piece[c, 1 + a]) - least) <= step:
                    p[a] = piece[c, 1 + a] + np.copysign(piece[c, 4 + a] + step, x[a] - piece[c, 1 + a])
                    break
        elif piece[c, 0] == HALF_SPACE:
            for a in range(dim):
                p[a] += (least + step) * piece[c, 4 + a]
        else:
            r, tube = 0.0, piece[c, 0] == CYLINDER
            for a in range(3):
                if not (tube and a == piece[c, 7]):
                    r += (x[a] - piece[c, 1 + a]) ** 2
            r = np.sqrt(r)
            if abs(outward * (piece[c, 4] - r) - least) > step:
                continue
            middle = r == 0.0
            for a in range(3):
                if not (middle or (tube and a == piece[c, 7])):
                    p[a] = piece[c, 1 + a] + (x[a] - piece[c, 1 + a]) * (piece[c, 4] + outward * step) / r
        for turn in range(4 if middle else 1):
            if middle:  # all directions are alike: both ways along two axes, not along that of a tube
                p[:] = x
                a = turn // 2 + (1 if tube and piece[c, 7] <= turn // 2 else 0)
                p[a] += (1 - 2 * (turn % 2)) * (piece[c, 4] + step)
            away = 0.0
            for a in range(3):
                away += (p[a] - x[a]) ** 2
            for a in range(dim):
                p[a] += 0.3 * step * ROUND_ABOUT[0, a]  # not on a seam
            if np.sqrt(away) <= least + 3.0 * step and wanted == _is_solid(p[0], p[1], p[2], grid):
                return True
    return False
