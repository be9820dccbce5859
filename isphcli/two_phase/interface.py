"""The interface as a field of its own: each particle carries phi, its signed distance to the interface, m.

phi > 0 in the first fluid, and D phi / D t = 0: particles carry it as they move, and where they are shifted it is taken
from its Taylor series, like the velocity (eq. 9). What the paper draws from the colour of the particles (eqs 15-17, 23)
follows from a quadratic function fitted to phi (`quadratic_fit`):

    the fluid of a particle: the sign of phi;       a pair of unlike particles meets the interface at
    t = phi_i / (phi_i - phi_j);       n = g / |g| into the first fluid;       kappa = -(tr H - n . H n) / |g|.

Colours alone cannot hold an interface: an averaged curvature hardly sees roughness of two or three spacings, nothing
opposes it, and drops fall apart. A field need not be rough. In each step a part of what the quadratic function
does not fit is taken out of phi, and |grad phi| is brought towards one; an interface that is smooth over a support is
moved by neither (errors of fourth order). What that changes of the volume of the first fluid is given back along the
interface, to each connected piece its own: bubbles do not feed each other. What the motion changes over many steps is
made up for by `kept_volumes`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from ..domain import reduce
from ..domain.components import parts_of
from ..domain.row_threads import REDUCE, over_rows
from ..flow.shifting import taylor
from ..flow.state import phase_of
from ..operators.kernel import shape
from .quadratic_fit import APART, QuadraticFit, no_slopes, own_gradient, quadratic_fit

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..operators.pair_weights import Operators
    from .contact_angle import ContactAngle
    from .cut_cells import CutCells
    from .sight import Sight

THICKNESS = 1.5  # spacings: half of the thickness over which the volume fraction of the first fluid goes from 0 to 1
SPREAD = 1.0 / 3.0 - 2.0 / math.pi**2  # variance of the slope of the volume fraction, of the square of THICKNESS
RATE = 0.1  # part of the roughness that is taken out in the capillary time of a spacing, or on the way of one
MOST = 0.5  # part that is taken out in one step, however long it is
SLOWER = 0.1  # part of that part by which |grad phi| comes nearer to one
LARGEST_STRETCH = 0.2  # of a step, relative: it would be wrong at the walls of an impulsive start
ITERATIONS = 4  # of Newton's method for the volumes; the second is of round-off already


class UnlikePairs(NamedTuple):
    """Pairs that the interface parts: start (n + 1,) row pointers of them; pair: (m,) which of the neighbours, in the
    order of these; fraction: (m,) t of the way from i to j at which the pair meets the interface."""

    start: np.ndarray
    pair: np.ndarray
    fraction: np.ndarray

    @property
    def near(self) -> np.ndarray:
        """Particles with a neighbour of the other fluid, (n,) bool."""
        return np.diff(self.start) > 0


@dataclass(frozen=True)
class Interface:
    """The interface of one configuration; lengths in m.

    phi: (n,) signed distance, up to `reach` on either side; fit: QuadraticFit to it; steepness: (n,) size of its slope;
    reach, spacing: m; fraction: (n,) volume fraction of the first fluid; strength: (n,) its gradient, 1/m; curvature:
    (n,) 1/m, averaged along the interface; unlike: the pairs that it parts; cut: the volumes on both sides of it, or
    None where they are not asked for.
    """

    phi: np.ndarray
    fit: QuadraticFit
    steepness: np.ndarray
    reach: float
    spacing: float
    fraction: np.ndarray
    strength: np.ndarray
    curvature: np.ndarray
    unlike: UnlikePairs
    cut: CutCells | None = None

    @property
    def normal(self) -> np.ndarray:
        """(n, dim) into the first fluid, zero where phi is not known."""
        return self.fit.slope / np.where(self.steepness > 0.0, self.steepness, 1.0)[:, None]

    @property
    def colour(self) -> np.ndarray:
        """(n,) 1 of particles of the first fluid, else 0 (eq. 15, the same for all particles)."""
        return colour_of(self.phi)

    @property
    def phase(self) -> np.ndarray:
        """(n,) int8 fluid of each particle."""
        return phase_of(self.phi)


def colour_of(phi: np.ndarray) -> np.ndarray:
    """`Interface.colour` of particles with phi (n,), m."""
    return (phi > 0.0).astype(float)


def reach_of(support: float, spacing: float) -> float:
    """Signed distance up to which particles know theirs, m: those that a curvature at the interface is fitted to."""
    return support + THICKNESS * spacing


def volume_fraction(phi: np.ndarray, spacing: float) -> np.ndarray:
    """Of the first fluid in the volume of particles, (n,), from phi (n,), m."""
    q = np.clip(phi / (THICKNESS * spacing), -1.0, 1.0)
    return 0.5 * (1.0 + q + np.sin(math.pi * q) / math.pi)


def fraction_slope(phi: np.ndarray, spacing: float) -> np.ndarray:
    """Derivative of `volume_fraction`, (n,) 1/m."""
    q = np.clip(phi / (THICKNESS * spacing), -1.0, 1.0)
    return 0.5 * (1.0 + np.cos(math.pi * q)) / (THICKNESS * spacing)


def of_one_interface(phi: np.ndarray, steepness: np.ndarray, spacing: float) -> np.ndarray:
    """0 to 1, (n,): how much of what a particle knows is of one interface, from phi (n,), m, and |grad phi| (n,) of its
    fit. Half way between two interfaces phi has a kink: its slope and its curvature are those of neither. A kink nearer
    to the interface than a spacing belongs to it, as in `quadratic_fit`, and so does one before an edge of up to a
    right angle, where the slope is cos 45 degrees and more: without edges a square drop that becomes round gains twice
    the momentum."""
    apart = np.minimum((phi / spacing) ** 2, 1.0)
    return 1.0 - apart * (1.0 - np.minimum(math.sqrt(2.0) * steepness, 1.0) ** APART)


def find_interface(ops: Operators, neighbours: Neighbourhood, phi: np.ndarray, spacing: float,
                   contact: ContactAngle | None = None, sight: Sight | None = None) -> Interface:
    """The Interface of a configuration.

    ops: Operators; neighbours: all of them, dummies included; phi: (n,) m; contact: the angle at walls, or None; sight:
    of the fit where it sees farther than the operators, or None.
    """
    seen, everyone = ops.neighbours, ops.exchange.forward
    reach = reach_of(seen.support if sight is None else max(seen.support, sight.reach), spacing)
    distance = everyone(phi)
    known = np.abs(distance) < reach
    fitted, neighbours = (seen, neighbours) if sight is None else sight.neighbours(ops, neighbours, known)
    gradient = everyone(own_gradient(fitted, distance, known, everyone(ops.gradient_with_remote(distance)), spacing))
    fit = quadratic_fit(fitted, distance, known, known, gradient, spacing, no_slopes(ops.n, ops.dim))
    if contact is not None:
        fit = contact.at_walls(ops, (fitted, neighbours), distance, known, fit)
    steepness = np.sqrt(np.einsum("ij,ij->i", fit.slope, fit.slope))
    strength = fraction_slope(phi, spacing) * steepness
    # no drop is smaller than the spacing
    sharpest = (ops.dim - 1) / spacing
    curvature, slope = ops.exchange.forward_each(np.clip(fit.curvature, -sharpest, sharpest), steepness)
    # `fit.curvature` is that of phi = 0 all along a normal: any weight that ends within the support will do
    weight = np.where(known, np.maximum(1.0 - (distance / seen.support) ** 2, 0.0) ** 2, 0.0)
    weight *= of_one_interface(distance, slope, spacing)
    curvature = averages(seen, weight * ops.volume, curvature)
    # where the interface is bent, its outer half-layer is the larger one: the fraction less this has the right volume
    resolved = np.clip(curvature, -0.5 * sharpest, 0.5 * sharpest)
    bent = 0.5 * SPREAD * (THICKNESS * spacing) ** 2 * resolved * strength
    return Interface(phi, fit, steepness, reach, spacing, volume_fraction(phi, spacing) - bent, strength, curvature,
                     unlike_pairs(ops.start, ops.column, distance))


def carried(interface: Interface, ops: Operators, dr: np.ndarray | None, part: float,
            stretch: np.ndarray | float = 0.0, moved: float = 0.0) -> np.ndarray:
    """phi (n,) of the particles after a step: smoother by a part of its roughness, |grad phi| nearer to one, with the
    volumes that the fluids had before, and shifted by dr (n, dim), m, or None.

    ops: Operators before the step; stretch: (n,) or 0, relative increase in the step of the distance between levels of
    phi by the flow, with which phi is rescaled; moved: part of the difference of |grad phi| from one that is taken out
    because particles have moved.
    """
    phi, fit, reach, spacing = interface.phi, interface.fit, interface.reach, interface.spacing
    everyone, known = ops.exchange.forward, np.abs(interface.phi) < reach
    # the slope is brought to one as an explicit step of an advection away from the interface would do it: it has to be
    # slower than the smoothing that keeps it stable
    distance, steepness, slope = ops.exchange.forward_each(phi, np.clip(interface.steepness, 0.0, 2.0), fit.slope)
    weight = np.where(np.abs(distance) < reach, ops.volume, 0.0) * of_one_interface(distance, steepness, spacing)
    stretched = averages(ops.neighbours, weight, steepness) - 1.0
    change = np.clip(fit.value - phi, -spacing, spacing)
    slower = SLOWER * part + moved
    factor = 1.0 + np.clip(stretch, -LARGEST_STRETCH, LARGEST_STRETCH) - slower * stretched
    new = np.where(known, factor * phi + part * change, phi)
    # |phi| has its minima at the interface alone: one elsewhere is left from an interface that has gone, and is set to
    # `reach`
    left = np.zeros(ops.n, np.bool_)
    over_rows(_left_behind, ops.n, ops.neighbours, distance, known, left)
    new[left] = np.sign(phi[left]) * reach
    known &= ~left
    # particles that the interface comes near to, by less than a spacing a step, know their distance from those that do
    beyond, value = np.zeros(ops.n, np.bool_), np.zeros(ops.n)
    over_rows(_extended, ops.n, ops.neighbours, distance, slope, everyone(known), beyond, value)
    beyond &= ~left
    there = np.sign(phi) * np.clip(np.sign(phi) * value, reach - spacing, reach)
    new[beyond] = there[beyond]
    new = with_volumes_of(phi, np.clip(new, -reach, reach), ops, spacing)
    if dr is not None:
        # eq. 9; without the second derivative each shift along a bent interface moves it to its outer side
        second = np.abs(phi) < THICKNESS * spacing  # all neighbours know their slopes
        new = taylor(ops, new[:, None], fit.slope[:, None], dr, second)[:, 0]
    return new


def strain(interface: Interface, ops: Operators, u: np.ndarray) -> np.ndarray:
    """n . grad u . n (n,), 1/s, at which the velocity u (n, dim) parts the levels of phi; zero where n is not known."""
    out = np.zeros(ops.n)
    over_rows(_strain, ops.n, ops.start, ops.column, ops.grad_p, interface.fit.slope, ops.exchange.forward(u), out)
    return out


def with_volumes_of(before: np.ndarray, phi: np.ndarray, ops: Operators, spacing: float) -> np.ndarray:
    """phi (n,) moved along the normals by one length for each connected piece of the interface, so that the volume of
    the first fluid round it is that of `before` (n,)."""
    inside = (fraction_slope(phi, spacing) > 0.0) | (fraction_slope(before, spacing) > 0.0)
    band = np.flatnonzero(inside)
    count, piece = parts_of(ops.start, ops.column, ops.exchange.forward(inside), exchange=ops.exchange)
    if not count:
        return phi
    piece = piece[band]
    volume = ops.volume[band]
    wanted = volume * volume_fraction(before[band], spacing)
    shift = np.zeros(count)
    for _ in range(ITERATIONS):
        now = phi[band] + shift[piece]
        lacks, slope = reduce.totals_by(count, (piece, wanted - volume * volume_fraction(now, spacing)),
                                        (piece, volume * fraction_slope(now, spacing)))
        step = np.divide(lacks, slope, out=np.zeros(count), where=slope > 0.0)
        shift += np.clip(step, -0.5 * spacing, 0.5 * spacing)
    out = phi.copy()
    out[band] += shift[piece]
    return out


def unlike_pairs(start: np.ndarray, column: np.ndarray, phi: np.ndarray) -> UnlikePairs:
    """UnlikePairs among the pairs start (n + 1,), column (n_pairs,) of particles with phi (n + remote,), m."""
    first, n = phi > 0.0, len(start) - 1
    count = np.zeros(n + 1, np.int64)
    over_rows(_count_unlike, n, start, column, first, count[1:])
    begin = np.cumsum(count)
    pair, fraction = np.empty(begin[-1], np.int64), np.empty(begin[-1])
    over_rows(_put_unlike, n, (start, column, phi, first), begin, pair, fraction)
    return UnlikePairs(begin, pair, fraction)


@njit(cache=True, nogil=True)
def _count_unlike(rows, start, column, first, count):
    for i in range(rows[0], rows[1]):
        found = 0
        for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
            found += first[np.uint32(column[p])] != first[i]
        count[i] = found


@njit(cache=True, nogil=True, error_model="numpy")
def _put_unlike(rows, given, begin, pair, fraction):
    start, column, phi, first = given
    for i in range(rows[0], rows[1]):
        at, p = begin[i], start[i]
        while at < begin[i + 1]:
            j = column[p]
            pair[at] = p  # overwritten by the next one unless it is unlike: no branch to mispredict
            fraction[at] = phi[i] / (phi[i] - phi[j])
            at += np.int64(first[j] != first[i])
            p += 1


@njit(cache=True, nogil=True, fastmath=REDUCE)
def _strain(rows, start, column, grad, slope, u, out):
    last, deep = slope.shape[1] - 1, 1.0 if slope.shape[1] == 3 else 0.0
    for i in range(rows[0], rows[1]):
        g0, g1, g2, total = slope[i, 0], slope[i, 1], deep * slope[i, last], 0.0
        square = g0 * g0 + g1 * g1 + g2 * g2
        if square > 0.0:
            u0, u1, u2 = u[i, 0], u[i, 1], u[i, last]
            for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                j = np.uint32(column[p])
                apart = (u[j, 0] - u0) * g0 + (u[j, 1] - u1) * g1 + (u[j, last] - u2) * g2
                total += (grad[p, 0] * g0 + grad[p, 1] * g1 + grad[p, last] * g2) * apart
            out[i] = total / square


def averages(neighbours: Neighbourhood, weight: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Kernel averages sum_j w W f / sum_j w W of f (n,) over the particles of weight w (n,) above zero, j = i included;
    f elsewhere; (n,), what is given is that of remote particles too."""
    out = f[: neighbours.n].copy()
    over_rows(_average, neighbours.n, neighbours, weight, f, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REDUCE)
def _average(rows, neighbours, weight, f, out):
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    kind, over, last = neighbours.kind, 1.0 / neighbours.support, x.shape[1] - 1
    deep = 1.0 if last == 2 else 0.0
    for i in range(rows[0], rows[1]):
        if weight[i] > 0.0:
            total = weight[i] * shape(kind, 0.0)
            mean, x0, x1, x2 = total * f[i], x[i, 0], x[i, 1], x[i, last]
            for p in range(np.uint64(start[i]), np.uint64(start[i + 1])):
                j, there = np.uint32(column[p]), np.uint32(row[p])
                r2 = (x[there, 0] - x0) ** 2 + (x[there, 1] - x1) ** 2 + deep * (x[there, last] - x2) ** 2
                w = weight[j] * shape(kind, math.sqrt(r2) * over)
                total += w
                mean += w * f[j]
            out[i] = mean / total


@njit(cache=True, inline="always")
def _distance(x, i, j):
    """Between two rows of x (n, dim)."""
    r2 = (x[j, 0] - x[i, 0]) ** 2 + (x[j, 1] - x[i, 1]) ** 2
    if x.shape[1] == 3:
        r2 += (x[j, 2] - x[i, 2]) ** 2
    return math.sqrt(r2)


@njit(cache=True, nogil=True)
def _left_behind(rows, neighbours, phi, known, out):
    """Particles that know their phi and see neither the other fluid nor a smaller distance, (n,) bool."""
    start, column = neighbours.start, neighbours.column
    for i in range(rows[0], rows[1]):
        if known[i]:
            out[i] = True
            for p in range(start[i], start[i + 1]):
                j = column[p]
                if abs(phi[j]) < abs(phi[i]) or (phi[j] > 0.0) != (phi[i] > 0.0):
                    out[i] = False
                    break


@njit(cache=True, nogil=True)
def _extended(rows, neighbours, phi, slope, known, beyond, out):
    """Particles that do not know their phi and see some that do, (n,) bool, and the mean of what those make of theirs
    with their slopes, (n,)."""
    start, column, row, x = neighbours.start, neighbours.column, neighbours.row, neighbours.x
    dim = x.shape[1]
    for i in range(rows[0], rows[1]):
        if not known[i]:
            total, mean = 0.0, 0.0
            for p in range(start[i], start[i + 1]):
                j = column[p]
                if known[j]:
                    there = phi[j]
                    for k in range(dim):
                        there += slope[j, k] * (x[i, k] - x[row[p], k])
                    w = shape(neighbours.kind, _distance(x, i, row[p]) / neighbours.support)
                    total += w
                    mean += w * there
            if total > 0.0:
                beyond[i] = True
                out[i] = mean / total
