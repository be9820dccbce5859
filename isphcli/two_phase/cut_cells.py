"""Volumes of the two fluids and the area of their interface, on the cells of a grid that the interface cuts.

Particles carry phi. Their own volumes (eq. 7) vary with the disorder of the particles and, beside walls, with the
places of the dummies; and a volume fraction that goes from one to zero over a layer round the interface is cut off
where that layer meets a wall. Sums over particles are off by 0.2 % in a bubble that rises, and by 2 % of the pores in
rock. Here the box has cells of about a spacing. In the middle of each, phi is the weighted mean of what the particles
round it extrapolate to there, with their slopes and curvatures. The cell is cut by a plane there. Of a box of sides
a_k, in units of which the plane's normal has the components n_k >= 0, the part on the side of phi > 0 at phi = d is

    F(d) = sum_s (prod_k s_k) max(d + sum_k s_k b_k / 2, 0)^dim / (dim! prod_k b_k),   b_k = n_k a_k,  s_k = -1 or 1.

A surface of curvature kappa lies kappa a^2 / 24 beside its plane in the mean over a cell. The area of the interface is
what the volume changes by if the plane moves by a side: F' itself jumps where the plane lies along the cell. The length
of an outline in 2D is known better, from phi and its slope in the middles of the cells: cubic functions say where it
passes between them, and arcs that turn as the normals do lead from one such place to the next.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.exchange import NO_EXCHANGE, Exchange
from ..domain.halo import nearest_image
from ..domain.row_threads import over_rows

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry
    from .cells_in_sight import CellSight
    from .quadratic_fit import QuadraticFit

REACH = 2.0  # sides of a cell, from its middle to the particles that are asked there
# Sides of a cell: particles farther from the interface are not asked. Cells that it cuts, and in 2D the middles beside
# those, have none of them in reach.
FAR = 4.2
SAMPLES = 4  # along each side of a cell: points that say how much of it is fluid
AT_ONCE = 1 << 20  # points
HALVINGS = 30  # of the side of a cell, to where the outline passes
TURN = 0.5 * math.pi  # radians by which an outline turns within a cell at most, as round a drop of two cells
STRAIGHT = 1e-6  # radians: an arc that turns by twice as much at most is as long as its chord to round-off
THINNEST = 1e-3  # n_k below which the plane is taken for one along axis k: a division by zero


class Cells(NamedTuple):
    """Those whose middles lie in the brick of this process, all of one process.

    lower: (dim,) corner of the box, m; side: (dim,) of a cell, m; shape: (dim,) number of cells of the box along each
    axis; periodic: (dim,) bool; first, end: (dim,) of them here; fluid: (n_cells,) volume of the fluid in each that is
    here, m^dim, that of all processes together that of the particles.
    """

    lower: np.ndarray
    side: np.ndarray
    shape: np.ndarray
    periodic: np.ndarray
    first: np.ndarray
    end: np.ndarray
    fluid: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """(n_cells, dim) m, not to be written to."""
        return _middles(*(tuple(values.tolist()) for values in (self.lower, self.side, self.first, self.end)))


@lru_cache(maxsize=1)  # several ask in each step, and the cells of a run stay
def _middles(*cells: tuple[float, ...]) -> np.ndarray:
    """`Cells.middle` of lower, side, first and end."""
    axes = [lower + (np.arange(first, end) + 0.5) * side for lower, side, first, end in zip(*cells)]
    middle = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    middle.flags.writeable = False
    return middle


class CutCells(NamedTuple):
    """The cells as an interface cuts them.

    cells: Cells; phi: (n_cells,) in their middles, m; slope: (n_cells, dim) of phi there, inf where it is not
    known; volume: (n_cells,) of the first fluid, m^dim; area: (n_cells,) of the interface, m^(dim - 1); nearest:
    (n_cells, 2) particle of either fluid, own or remote, that is nearest to the middle of the cell, -1 where none is;
    sample: corners (dim,), m, of where volumes are kept by what lies there alone, or None: everywhere.
    """

    cells: Cells
    phi: np.ndarray
    slope: np.ndarray
    volume: np.ndarray
    area: np.ndarray
    nearest: np.ndarray
    sample: tuple[np.ndarray, np.ndarray] | None = None


def cells_of(geometry: Geometry, spacing: float, total: float,
             brick: tuple[np.ndarray, np.ndarray] | None = None) -> Cells:
    """Cells of about a spacing, m, over the box of a geometry; total: volume of all the fluid, m^dim; brick: (lower,
    upper) corners (dim,) of what this process has, or None of one."""
    size, dim = geometry.upper - geometry.lower, geometry.dim
    shape = np.maximum(np.round(size / spacing), 1).astype(np.int64)
    side, first, end = size / shape, np.zeros(dim, np.int64), shape
    if brick is not None:  # bricks end where the next ones begin, with the same bits
        first, end = (np.clip(np.ceil((corner - geometry.lower) / side - 0.5).astype(np.int64), 0, shape)
                      for corner in brick)
        end = np.maximum(end, first)
    cells = Cells(geometry.lower, side, shape, np.array(geometry.periodic), first, end,
                  np.ones(int(np.prod(end - first))))
    fluid = cells.fluid
    if geometry.has_solid:
        middle, count = cells.middle, SAMPLES**dim
        within = (np.stack(np.meshgrid(*[np.arange(SAMPLES)] * dim, indexing="ij"), axis=-1).reshape(-1, dim) + 0.5
                  ) / SAMPLES - 0.5
        for begin in range(0, len(middle), AT_ONCE // count):
            points = middle[begin : begin + AT_ONCE // count, None] + within * cells.side
            inside = geometry.phase(points.reshape(-1, dim)) >= 0
            fluid[begin : begin + AT_ONCE // count] = inside.reshape(-1, count).mean(axis=1)
    return cells._replace(fluid=fluid * (total / reduce.total(fluid)))


def cut(cells: Cells, x: np.ndarray, phi: np.ndarray, fit: QuadraticFit, exchange: Exchange = NO_EXCHANGE,
        sight: CellSight | None = None, distance: np.ndarray | None = None) -> CutCells:
    """CutCells of particles with phi (n,), m, and its QuadraticFit; x: (n + remote, dim) m, and rows behind them that
    are not asked for; exchange: of remote particles; sight, distance: of scenes with walls, and (n + remote,) of the
    particles to them, m.

    A cell without a particle in reach holds no fluid that is simulated: its volume in `CutCells.cells` is zero, and the
    others are scaled so that all of them have the volume of the particles. One that has both fluids round it, but no
    interface near, as on the two sides of a wall that it does not see over, is of the fluid of the nearest particle.
    """
    phi, slope, form = exchange.forward_each(phi, fit.slope, fit.form)
    n, dim, reach = len(cells.fluid), len(cells.side), REACH * cells.side.max()
    weight, sums, nearest = found = _nothing(n, dim)
    particles, far = (x, phi, slope, form), FAR * cells.side.max()
    over_rows(_gather, n, particles, cells, (reach, far), found, work=lambda: np.full((n, 2), math.inf))
    if sight is not None and distance is not None:
        seen = sight.seen(x[: len(phi)], np.flatnonzero((nearest >= 0).all(axis=1)), reach, distance)
        if len(seen.cells):
            alone = _nothing(len(seen.cells), dim)  # of each cell, from the particles in sight alone
            pairs = np.searchsorted(seen.cell, np.append(seen.cells, n)), seen.particle, seen.offset
            over_rows(_gather_seen, len(seen.cells), particles, pairs, (reach, far), alone,
                      work=lambda: np.full((len(seen.cells), 2), math.inf))
            for whole, part in zip(found, alone):
                whole[seen.cells] = part
    far_off = np.flatnonzero((nearest >= 0).all(axis=1) & (weight == 0.0))
    nearest[far_off, _farther(cells, x, nearest, far_off)] = -1
    held = np.where((nearest < 0).all(axis=1), 0.0, cells.fluid)
    whole, left = reduce.totals(cells.fluid, held)
    cells = cells._replace(fluid=held * (whole / left))
    volume, area = np.zeros(n), np.zeros(n)
    over_rows(_cut, n, cells, found, volume, area, work=lambda: np.empty(dim))
    known = (weight > 0.0)[:, None]
    there = np.divide(sums[:, : dim + 1], weight[:, None], out=np.full((n, dim + 1), math.inf), where=known)
    return CutCells(cells, there[:, 0], there[:, 1:], volume, area, nearest)


def _nothing(n: int, dim: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `_gather` adds to, of n cells: weight (n,), sums (n, dim + 2), nearest (n, 2)."""
    return np.zeros(n), np.zeros((n, dim + 2)), np.full((n, 2), -1)


def _farther(cells: Cells, x: np.ndarray, nearest: np.ndarray, some: np.ndarray) -> np.ndarray:
    """Which of the nearest particles of both fluids is farther from the middle of the cells `some` (k,), 0 or 1."""
    way = nearest_image(x[nearest[some]] - cells.middle[some, None], cells.side * cells.shape, cells.periodic)
    return np.asarray((way * way).sum(axis=2).argmax(axis=1))


def outline(cut: CutCells) -> tuple[float, float]:
    """(length of the interface in 2D, m, area inside of it, m2) of what keeps off the walls and leaves a gap along
    every periodic axis: arcs from side to side of the squares between the middles of four cells.

    Both are of one closed curve: no outline is shorter than that of the circle of its area."""
    cells, most = cut.cells, cut.cells.side.sum()
    place = np.stack(np.unravel_index(np.arange(len(cut.phi)), cells.end - cells.first), axis=1) + cells.first
    near = np.abs(cut.phi) < most  # of four that have zero between them all are
    # a process knows its own cells; those round an interface are few
    place, phi, slope = reduce.together(place[near], cut.phi[near], cut.slope[near])
    number = place[:, 0] * cells.shape[1] + place[:, 1]
    order = np.argsort(number)
    height = np.full((len(phi), 4, 3), np.nan)
    for k, step in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        beyond = place + step
        inside = (beyond < cells.shape) | cells.periodic
        beyond %= cells.shape
        wanted = beyond[:, 0] * cells.shape[1] + beyond[:, 1]
        found = order[np.minimum(np.searchsorted(number, wanted, sorter=order), len(order) - 1)]
        there = inside.all(axis=1) & (number[found] == wanted)
        height[there, k, 0], height[there, k, 1:] = phi[found[there]], slope[found[there]]
    positive = height[:, :, 0] > 0.0
    passed = np.isfinite(height).all(axis=(1, 2)) & (positive.any(axis=1) != positive.all(axis=1))
    length, area = _outline(height[passed], _in_one_piece(place[passed], cells.shape), cells.side)
    return float(length), abs(float(area))


def _in_one_piece(place: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Squares (n, dim) of a box of this many, moved by periods so that the widest gap along each axis lies outside."""
    place = place.copy()
    for axis, count in enumerate(shape if len(place) else ()):
        full = np.unique(place[:, axis])
        gap = np.diff(full, append=full[0] + count)
        place[:, axis] = (place[:, axis] - full[(np.argmax(gap) + 1) % len(full)]) % count
    return place


@njit(cache=True, nogil=True)
def _gather(rows, work, particles, cells, asked, out):
    """Adds the particles to the cells `rows` round them: a range has its own cells, each particle in turn. asked: how
    far particles are asked, reach, m, and how far from the interface they may be, far, m; out: weight (n_cells,); sums
    (n_cells, dim + 2) weighted phi, slope, and curvature of the level; nearest (n_cells, 2). work: least (n_cells, 2)
    squared distances."""
    (x, phi, slope, form), (weight, sums, nearest), least = particles, out, work
    lower, side, _, _, begin, end, fluid = cells
    (reach, far), dim = asked, slope.shape[1]
    # 2D is one layer of 3D: y and z are the last two axes in both
    y, z, deep = dim - 2, dim - 1, 1.0 if dim == 3 else 0.0
    n1, n2 = end[y] - begin[y], end[z] - begin[z]
    for i in range(len(phi)):
        size, trace = _bent(slope, form, i)
        side_of = 1 if phi[i] <= 0.0 else 0
        own, half, near = phi[i], 0.5 * size, abs(phi[i]) <= far
        # numbers of their own: of arrays LLVM does not know that the sums are apart, and reads them for each cell
        g0, g1, g2 = deep * slope[i, 0], slope[i, y], slope[i, z]
        xx, xy, xz = deep * form[i, 0], deep * form[i, y], deep * form[i, z]
        yx, yy, yz = deep * form[i, y * dim], form[i, y * dim + y], form[i, y * dim + z]
        zx, zy, zz = deep * form[i, z * dim], form[i, z * dim + y], form[i, z * dim + z]
        a0, a1 = _window(cells, 0, x[i, 0], reach) if dim == 3 else (0, 1)
        b0, b1 = _window(cells, y, x[i, y], reach)
        e0, e1 = _window(cells, z, x[i, z], reach)
        for a in range(a0, a1):
            d0 = lower[0] + (a + 0.5) * side[0] - x[i, 0] if dim == 3 else 0.0
            p0 = _here(cells, 0, a) if dim == 3 else 0
            if p0 < 0 or (p0 + 1) * n1 * n2 <= rows[0] or p0 * n1 * n2 >= rows[1]:
                continue
            for b in range(b0, b1):
                d1, p1 = lower[y] + (b + 0.5) * side[y] - x[i, y], _here(cells, y, b)
                line = (p0 * n1 + p1) * n2
                if p1 < 0 or line + n2 <= rows[0] or line >= rows[1] or d0 * d0 + d1 * d1 >= reach * reach:
                    continue
                for e in range(e0, e1):
                    d2, p2 = lower[z] + (e + 0.5) * side[z] - x[i, z], _here(cells, z, e)
                    r2, cell = d0 * d0 + d1 * d1 + d2 * d2, line + p2
                    if p2 < 0 or cell < rows[0] or cell >= rows[1] or r2 >= reach * reach or not fluid[cell] > 0.0:
                        continue
                    if r2 < least[cell, side_of]:
                        least[cell, side_of], nearest[cell, side_of] = r2, i
                    if near:
                        w = _weight(r2, reach)
                        there = own + g0 * d0 + half * d0 * (xx * d0 + xy * d1 + xz * d2)
                        there = there + g1 * d1 + half * d1 * (yx * d0 + yy * d1 + yz * d2)
                        there = there + g2 * d2 + half * d2 * (zx * d0 + zy * d1 + zz * d2)
                        weight[cell] += w
                        sums[cell, 0] += w * there
                        if dim == 3:
                            sums[cell, 1] += w * g0
                        sums[cell, 1 + y] += w * g1
                        sums[cell, 1 + z] += w * g2
                        sums[cell, dim + 1] -= w * trace


@njit(cache=True, nogil=True)
def _gather_seen(rows, work, particles, pairs, asked, out):
    """As `_gather`, from the pairs of cells with particles that they see: start (k + 1,), particle (m,), offset (m,
    dim); out: of the k cells. work: least (k, 2).

    What a particle adds stands in both kernels: in a helper of both, `cut` of 32^3 particles takes 1.36 of the time."""
    (_, phi, slope, form), (weight, sums, nearest), least = particles, out, work
    start, particle, offset = pairs
    (reach, far), dim = asked, offset.shape[1]
    for cell in range(rows[0], rows[1]):
        for p in range(start[cell], start[cell + 1]):
            i, d, r2 = particle[p], offset[p], 0.0
            side_of = 1 if phi[i] <= 0.0 else 0
            for k in range(dim):
                r2 += d[k] * d[k]
            if r2 < least[cell, side_of]:
                least[cell, side_of], nearest[cell, side_of] = r2, i
            if abs(phi[i]) > far:
                continue
            size, trace = _bent(slope, form, i)
            w, there = _weight(r2, reach), _level(i, d, size, phi, slope, form)
            weight[cell] += w
            sums[cell, 0] += w * there
            for k in range(dim):
                sums[cell, 1 + k] += w * slope[i, k]
            sums[cell, dim + 1] -= w * trace


@njit(cache=True, inline="always")
def _bent(slope, form, i):
    """Size of the slope of phi of a particle, and trace of the form of its level."""
    size, trace, dim = 0.0, 0.0, slope.shape[1]
    for k in range(dim):
        size += slope[i, k] ** 2
        trace += form[i, k * dim + k]
    return math.sqrt(size), trace


@njit(cache=True, inline="always")
def _weight(r2, reach):
    """Of a particle in a cell, by the square of its distance from the middle."""
    return (1.0 - math.sqrt(r2) / reach) ** 4


@njit(cache=True, inline="always")
def _level(i, d, size, phi, slope, form):
    """phi in the middle of a cell, d (dim,) from a particle, extrapolated from that particle; size: of its slope."""
    there, dim = phi[i], len(d)
    for k in range(dim):
        there += slope[i, k] * d[k]
        turned = 0.0
        for m in range(dim):
            turned += form[i, k * dim + m] * d[m]
        there += 0.5 * size * d[k] * turned
    return there


@njit(cache=True, inline="always")
def _window(cells, k, x, reach):
    """Cells along axis k whose middles are in reach of x, (begin, end); of a periodic box beyond it too."""
    first = math.floor((x - reach - cells.lower[k]) / cells.side[k] + 0.5)
    last = math.floor((x + reach - cells.lower[k]) / cells.side[k] - 0.5) + 1
    return (first, last) if cells.periodic[k] else (max(first, 0), min(last, cells.shape[k]))


@njit(cache=True, inline="always")
def _here(cells, k, place):
    """Which of the cells of this process a cell is along axis k, or below zero."""
    place = place if 0 <= place < cells.shape[k] else place % cells.shape[k]
    return place - cells.first[k] if place < cells.end[k] else -1


@njit(cache=True, nogil=True, error_model="numpy")
def _cut(rows, b, cells, found, volume, area):
    """Volumes of the first fluid and areas of the interface in the cells."""
    fluid, side, (weight, sums, nearest), dim = cells.fluid, cells.side, found, len(b)
    smallest, square = side[0], 0.0
    for k in range(dim):
        smallest = min(smallest, side[k])
        square += side[k] ** 2 / dim
    for c in range(rows[0], rows[1]):
        if nearest[c, 0] < 0 or nearest[c, 1] < 0:  # of one fluid all round, or of none
            volume[c] = fluid[c] if nearest[c, 0] >= 0 else 0.0
            continue
        size = 0.0
        for k in range(dim):
            size += sums[c, 1 + k] ** 2
        size = math.sqrt(size)
        if size > 0.0:
            distance = sums[c, 0] / size
            for k in range(dim):
                b[k] = max(abs(sums[c, 1 + k]) / size, THINNEST) * side[k]
            part = _beyond(b, distance)
            density = (_beyond(b, distance + 0.5 * smallest) - _beyond(b, distance - 0.5 * smallest)) / smallest
            area[c] = fluid[c] * density
            # no surface is bent more than a cell is wide
            kappa = min(max(sums[c, dim + 1] / weight[c], -1.0 / smallest), 1.0 / smallest)
            part -= density * kappa * square / 24.0
        else:
            part = 1.0 if sums[c, 0] > 0.0 else 0.0  # the slopes of the particles cancel: the plane has no direction
        volume[c] = fluid[c] * min(max(part, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _beyond(b, distance):
    """F of the module."""
    dim, total, sides = len(b), 0.0, 0.0
    for k in range(dim):
        sides += b[k]
    if abs(distance) >= 0.5 * sides:  # far away the sum is a difference of large numbers
        return 1.0 if distance > 0.0 else 0.0
    for corner in range(1 << dim):
        sign, over = 1.0, distance
        for k in range(dim):
            if corner >> k & 1:
                over += 0.5 * b[k]
            else:
                over -= 0.5 * b[k]
                sign = -sign
        if over > 0.0:
            total += sign * over**dim
    faculty = 2.0 if dim == 2 else 6.0
    for k in range(dim):
        faculty *= b[k]
    return min(max(total / faculty, 0.0), 1.0)


@njit(cache=True)
def _outline(heights, place, side):
    """Length, and the area inside, positive of phi > 0. heights: (n, 4, 3) phi and slope in the corners of squares,
    round each; place: (n, 2) of the squares."""
    length, area, ends = 0.0, 0.0, np.empty((4, 4))
    for n in range(len(heights)):
        count, first = 0, heights[n, 0, 0] > 0.0
        for k in range(4):  # the sides, round the square
            one, other = heights[n, k], heights[n, (k + 1) % 4]
            if (one[0] > 0.0) != (other[0] > 0.0):
                along = _root(one, other, k % 2, side[k % 2] if k < 2 else -side[k % 2])
                ends[count, 0] = (place[n, 0] + (along, 1.0, 1.0 - along, 0.0)[k]) * side[0]
                ends[count, 1] = (place[n, 1] + (0.0, along, 1.0, 1.0 - along)[k]) * side[1]
                ends[count, 2] = (1.0 - along) * one[1] + along * other[1]
                ends[count, 3] = (1.0 - along) * one[2] + along * other[2]
                count += 1
        for k in range(0, count, 2):  # phi > 0 on the left of the way from a to b
            a, b = (ends[k], ends[k + 1]) if first else (ends[k + 1], ends[k])
            turn = math.atan2(a[2] * b[3] - a[3] * b[2], a[2] * b[2] + a[3] * b[3])
            half = 0.5 * min(max(turn, -TURN), TURN)
            chord = math.hypot(a[0] - b[0], a[1] - b[1])
            area += 0.5 * (a[0] * b[1] - a[1] * b[0])
            if abs(half) > STRAIGHT:
                radius = 0.5 * chord / math.sin(half)
                length += 2.0 * radius * half
                area += radius * radius * (half - 0.5 * math.sin(2.0 * half))
            else:
                length += chord
    return length, area


@njit(cache=True)
def _root(one, other, axis, length):
    """Where the cubic function of the values and slopes at two corners, `length` m apart along an axis, is zero, as a
    part of the way."""
    a, b = one[0], other[0]
    slope_a, slope_b = one[1 + axis] * length, other[1 + axis] * length
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        s = 0.5 * (low + high)
        r = 1.0 - s
        value = (a * (1.0 + 2.0 * s) + slope_a * s) * r * r + (b * (1.0 + 2.0 * r) - slope_b * r) * s * s
        if (value > 0.0) == (a > 0.0):
            low = s
        else:
            high = s
    return 0.5 * (low + high)
