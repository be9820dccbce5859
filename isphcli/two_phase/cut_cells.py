"""Volumes of the two fluids and the area of their interface, on the cells of a grid that the interface cuts.

What particles carry is phi; their own volumes (eq. 7) are those of a disordered sample of the fluid, beside walls one
that depends on how the dummies lie, and a layer of a thickness round the interface, over which a fraction of them goes
from one fluid to the other, ends at walls. Sums over particles are off by 0.2 % in a bubble that rises, and by 2 % of
the pores in rock. Here the box has cells of about a spacing; in the middle of each phi is the mean of what the
particles round it make of theirs, with slopes and curvatures. The cell is cut by a plane there. Of a box of sides a_k,
in units of which the plane's normal has the components n_k >= 0, the part on the side of phi > 0 at phi = d is

    F(d) = sum_s (prod_k s_k) max(d + sum_k s_k b_k / 2, 0)^dim / (dim! prod_k b_k),   b_k = n_k a_k,  s_k = -1 or 1.

A surface of curvature kappa lies kappa a^2 / 24 beside its plane in the mean over a cell. The area of the interface is
what the volume changes by if the plane moves by a side: F' itself jumps where the plane lies along the cell. The length
of an outline in 2D is known better, from phi in the middles of the cells.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.exchange import NO_EXCHANGE, Exchange

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry
    from .cells_in_sight import CellSight, SeenBy
    from .quadratic_fit import QuadraticFit

REACH = 2.0  # sides of a cell, from its middle to the particles that are asked there
SAMPLES = 4  # along each side of a cell: points that say how much of it is fluid
AT_ONCE = 1 << 20  # points
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
        """(n_cells, dim) m."""
        axes = [lower + (np.arange(first, end) + 0.5) * side
                for lower, first, end, side in zip(self.lower, self.first, self.end, self.side)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(self.side))


class CutCells(NamedTuple):
    """The cells as an interface cuts them.

    cells: Cells; phi: (n_cells,) in their middles, m; volume: (n_cells,) of the first fluid, m^dim; area: (n_cells,) of
    the interface, m^(dim - 1); nearest: (n_cells, 2) particle of either fluid, own or remote, that is nearest to the
    middle of the cell, -1 where none is near; sample: corners (dim,), m, of where volumes are kept by what lies there
    alone, or None: everywhere.
    """

    cells: Cells
    phi: np.ndarray
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
        sight: CellSight | None = None) -> CutCells:
    """CutCells of particles with phi (n,), m, and its QuadraticFit; x: (n + remote, dim) m, and rows behind them that
    are not asked for; exchange: of remote particles; sight: of scenes with walls."""
    phi, slope, form = (exchange.forward(values) for values in (phi, fit.slope, fit.form))
    x = x[: len(phi)]
    n, dim = len(cells.fluid), len(cells.side)
    weight, sums = np.zeros((n, 3)), np.zeros((n, dim + 2))
    nearest = np.full((n, 2), -1)
    _gather(x, phi, (slope, form), cells, weight, sums, nearest)
    if sight is not None:
        asked = np.flatnonzero((nearest >= 0).all(axis=1))
        seen = sight.seen(x, asked, REACH * cells.side.max())
        weight[seen.cells, 0], sums[seen.cells], nearest[seen.cells] = _made_of(
            seen, phi, (slope, form), REACH * cells.side.max(), n)
    volume, area = np.zeros(n), np.zeros(n)
    _cut(cells.fluid, cells.side, weight, sums, nearest, volume, area)
    there = np.divide(sums[:, 0], weight[:, 0], out=np.full(n, math.inf), where=weight[:, 0] > 0.0)
    return CutCells(cells, there, volume, area, nearest)


def _made_of(seen: SeenBy, phi: np.ndarray, fit: tuple[np.ndarray, np.ndarray], reach: float,
             n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `_gather` finds of particles in sight alone, weight (k,), sums (k, dim + 2) and nearest (k, 2), in the k
    cells of `seen`, of n."""
    i, d, (slope, form) = seen.particle, seen.offset, (values[seen.particle] for values in fit)
    dim = d.shape[1]
    form = form.reshape(-1, dim, dim)
    w = (1.0 - np.sqrt((d * d).sum(axis=1)) / reach) ** 4
    bent = 0.5 * np.sqrt((slope * slope).sum(axis=1)) * np.einsum("ij,ijk,ik->i", d, form, d)
    there = phi[i] + (slope * d).sum(axis=1) + bent
    columns = [np.ones(len(w)), there, *slope.T, -np.einsum("ijj->i", form)]
    found = np.stack([np.bincount(seen.cell, w * column, minlength=n) for column in columns], axis=1)[seen.cells]
    nearest = np.full((n, 2), -1)
    order = np.argsort(w, kind="stable")  # the nearest last
    nearest[seen.cell[order], (phi[i[order]] <= 0.0).astype(int)] = i[order]
    return found[:, 0], found[:, 1:], nearest[seen.cells]


def outline(cut: CutCells) -> float:
    """Length of the interface in 2D, m, of what keeps off the walls: straight from side to side of the squares between
    the middles of four cells."""
    cells, most = cut.cells, cut.cells.side.sum()
    place = np.stack(np.unravel_index(np.arange(len(cut.phi)), cells.end - cells.first), axis=1) + cells.first
    near = np.abs(cut.phi) < most  # of four that have zero between them all are
    # a process knows its own cells; those round an interface are few
    place, phi = reduce.together(place[near]), reduce.together(cut.phi[near])
    number = place[:, 0] * cells.shape[1] + place[:, 1]
    order = np.argsort(number)
    height = np.full((4, len(phi)), np.nan)
    for k, step in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        beyond = place + step
        inside = (beyond < cells.shape) | cells.periodic
        beyond %= cells.shape
        wanted = beyond[:, 0] * cells.shape[1] + beyond[:, 1]
        found = order[np.minimum(np.searchsorted(number, wanted, sorter=order), len(order) - 1)]
        height[k] = np.where(inside.all(axis=1) & (number[found] == wanted), phi[found], np.nan)
    height = height[:, np.isfinite(height).all(axis=0)]
    return float(_outline(np.ascontiguousarray(height.T), cells.side))


@njit(cache=True)
def _gather(x, phi, fit, cells, weight, sums, nearest):
    """Adds the particles to the cells round them. weight: (n_cells, 3) all of them, largest of one of either fluid;
    sums: (n_cells, dim + 2) weighted phi, slope, and curvature of the level."""
    slope, form = fit
    lower, side, count, periodic, begin, end, fluid = cells
    dim = x.shape[1]
    reach = REACH * side.max()
    first, last = np.zeros(3, np.int64), np.zeros(3, np.int64)
    place, d = np.zeros(3, np.int64), np.zeros(3)
    for i in range(len(x)):
        size, trace = 0.0, 0.0
        for k in range(dim):
            first[k] = math.floor((x[i, k] - reach - lower[k]) / side[k] + 0.5)
            last[k] = math.floor((x[i, k] + reach - lower[k]) / side[k] - 0.5) + 1
            if not periodic[k]:
                first[k], last[k] = max(first[k], 0), min(last[k], count[k])
            size += slope[i, k] ** 2
            trace += form[i, k * dim + k]
        if dim == 2:
            first[2], last[2] = 0, 1
        size = math.sqrt(size)
        side_of = 1 if phi[i] <= 0.0 else 0
        for a in range(first[0], last[0]):
            for b in range(first[1], last[1]):
                for c in range(first[2], last[2]):
                    place[0], place[1], place[2] = a, b, c
                    cell, r2, here = 0, 0.0, True
                    for k in range(dim):
                        d[k] = lower[k] + (place[k] + 0.5) * side[k] - x[i, k]
                        r2 += d[k] ** 2
                        at = place[k] % count[k]
                        here &= begin[k] <= at < end[k]
                        cell = cell * (end[k] - begin[k]) + at - begin[k]
                    if here and r2 < reach * reach and fluid[cell] > 0.0:
                        w = (1.0 - math.sqrt(r2) / reach) ** 4
                        there = phi[i]
                        for k in range(dim):
                            there += slope[i, k] * d[k]
                            turned = 0.0
                            for m in range(dim):
                                turned += form[i, k * dim + m] * d[m]
                            there += 0.5 * size * d[k] * turned
                            sums[cell, 1 + k] += w * slope[i, k]
                        weight[cell, 0] += w
                        sums[cell, 0] += w * there
                        sums[cell, dim + 1] -= w * trace
                        if w > weight[cell, 1 + side_of]:
                            weight[cell, 1 + side_of] = w
                            nearest[cell, side_of] = i


@njit(cache=True, error_model="numpy")
def _cut(fluid, side, weight, sums, nearest, volume, area):
    """Volumes of the first fluid and areas of the interface in the cells."""
    dim = len(side)
    b = np.empty(dim)
    smallest = side.min()
    square = 0.0
    for k in range(dim):
        square += side[k] ** 2 / dim
    for c in range(len(fluid)):
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
            kappa = min(max(sums[c, dim + 1] / weight[c, 0], -1.0 / smallest), 1.0 / smallest)
            part -= density * kappa * square / 24.0
        else:
            part = 1.0 if sums[c, 0] > 0.0 else 0.0  # no interface is near
        if nearest[c].min() < 0:  # of one fluid all round
            part, area[c] = 1.0 if nearest[c, 0] >= 0 else 0.0, 0.0
        volume[c] = fluid[c] * min(max(part, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _beyond(b, distance):
    """F of the module."""
    dim, total = len(b), 0.0
    if abs(distance) >= 0.5 * b.sum():  # far away the sum is a difference of large numbers
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
def _outline(heights, side):
    """heights: (n, 4) in the corners of squares, round each."""
    total, ends = 0.0, np.empty((4, 2))
    for n in range(len(heights)):
        count = 0
        for k in range(4):  # the sides, round the square
            a, b = heights[n, k], heights[n, (k + 1) % 4]
            if (a > 0.0) != (b > 0.0):
                along = a / (a - b)
                ends[count, 0] = (along, 1.0, 1.0 - along, 0.0)[k] * side[0]
                ends[count, 1] = (0.0, along, 1.0, 1.0 - along)[k] * side[1]
                count += 1
        for k in range(0, count, 2):
            total += math.hypot(ends[k, 0] - ends[k + 1, 0], ends[k, 1] - ends[k + 1, 1])
    return total
