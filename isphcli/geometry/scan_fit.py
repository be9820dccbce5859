"""The body that a scan shows: the field whose zero is the wall, corrected until its own scan is the image.

A scan of two values holds the share of fluid in each voxel, blurred. Sharpening undoes that as far as it is linear, and
a field that is smooth between voxels rounds off edges and walls along the voxels. Here the body of the field is scanned
in turn: its share of fluid in each voxel, blurred as the image is. What the image has beside that is added to the
field, as often as the two come nearer to each other (the Landweber iteration, with the scan as a function of the body
and not of the field).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.optimize import brentq
from scipy.special import ndtri

from ..domain import reduce
from ..domain.row_threads import in_one_piece, over_rows
from ..domain.slabs import Slabs
from .grey import UNBLURRED, sharpen
from .modes import Modes
from .spline import SEEN, neighbours, spline_coefficients, weights_in_voxel

# Cells along an edge of a voxel whose shares are taken from the value and the slope in their middles; fewer while the
# blur is looked for: with 2 it is found 0.01 to 0.02 voxel larger than with 3, with 1 up to 0.12 (docs/design_notes.md)
PARTS, ROUGH_PARTS = 3, 2
SAMPLE = 64  # voxels along each axis, of the middle of an image, that the blur is looked for in; see `_middle`
# Corrections at most. Errors of k of 24 perfect scans in per cent, median and root mean square: with none 3.7, 6.3,
# with 4 0.45, 3.4, with 8 0.31, 3.0 (docs/design_notes.md)
CORRECTIONS = 8
PURE = 0.999  # of the scan of a field, -1 to 1: voxels beyond hold no wall, and what they differ by is noise
FLAT = 0.9  # of the same: between neighbours beyond, what they differ by changes by noise alone
# Corrections end before one that leaves more of the misfit than GAIN, where it is OF_NOISE times the noise or less,
# and than GAIN_OF_NOISE where it is AS_NOISE times that (Morozov's discrepancy principle): noise that is fitted is
# missing in what is left. With a blur of 1 voxel and noise of 5 % of the contrast k of blobs 14 is +3.7 % off, with 1
# in place of 1.05 -56 % (docs/design_notes.md). What leaves more than GAIN fits noise, or grey values that no body of
# one solid has: with a seventh of the solid 2.5 times as bright, a blur of 0.9 voxel and noise of 5 % k of blobs 17 was
# -49 % off without it, and is -15 % (benchmarks/noisy_scans.py). What sharpening leaves round walls along the voxels
# seems noise, and falls faster than noise: k of the slit of 5.3 voxels was 4.5 % off by AS_NOISE alone
AS_NOISE, GAIN, GAIN_OF_NOISE = 1.05, 0.95, 0.8
WIDTHS = (0.4, 0.8, 1.2, 2.0)  # voxels, between which the width of the blur is looked for
STILL = 0.02  # square voxels, to which the variance of the blur is found before the corrections, which go on with it
MOST_CUT = 0.7  # share of pure voxels with the last value, beyond which it is that of a scan without noise
RARE = 0.05  # share of the voxels: noise is not told by pure ones where they are fewer
# Steps to the value half-way, of which a sixth of what Otsu's threshold is off is left (docs/design_notes.md)
CENTRED = 2
# An image is no scan where the corrections leave more than MISFIT half contrasts and OF_NOISE times the noise. Scans
# without noise leave 0.036 at most, but 0.047 of touching spheres (0.5236), signed distances that are cut off at 1 and
# 1.5 voxels 0.032 to 0.08, random fields 0.043 and more (docs/design_notes.md)
MISFIT, OF_NOISE = 0.04, 1.5
# voxels a square voxel of blur: the part of `ScanFit.off` of scans without noise, whose blur is not known exactly
# (benchmarks/noisy_scans.py)
OF_BLUR = 0.04
# half contrasts: of more noise than a quarter of the contrast values on one side of the threshold are not of one fluid
# or solid. 0.31 at most of scans with noise of 10 % at thresholds of 0.3 to 0.7 of the contrast; 0.54 to 0.63 of ramps
# and waves (docs/design_notes.md)
NOISIEST = 0.5


@dataclass(frozen=True)
class ScanFit:
    """The field whose scan an image is, and what it leaves.

    field: float32 [z, y, x], > 0 in fluid; blur: of the scanner, voxels; first, misfit: root mean square of the image
    less the scan of the field over the voxels at walls, before and after the corrections, in half contrasts; noise,
    pure: of what it has beside any body, and of what voxels without a wall differ by in the end; zero: the value of the
    image half-way between fluid and solid.
    """

    field: np.ndarray
    blur: float
    first: float
    misfit: float
    noise: float
    pure: float
    zero: float

    @property
    def worth_a_correction(self) -> float:
        """The part of the misfit that the next correction may leave."""
        if self.misfit <= AS_NOISE * self.noise:
            return GAIN_OF_NOISE
        return GAIN if self.misfit <= OF_NOISE * max(self.noise, self.pure) else 1.0

    @property
    def off(self) -> float:
        """How far the walls may be off, voxels: what the image has beside the scan, at walls or where there are none
        if that is more, over the slope of a step that the scanner, the average over a voxel and the spline have made
        wide, times that width, as what takes the blur out enlarges it; and a part of the blur itself."""
        square = self.blur * self.blur
        return max(self.misfit, self.pure) * 0.5 * math.pi * (square + UNBLURRED) + OF_BLUR * square

    @property
    def is_scan(self) -> bool:
        """False of an image that no body and no blur make, such as a signed distance."""
        noise = max(self.noise, self.pure)
        return self.misfit <= max(MISFIT, OF_NOISE * noise) and noise <= NOISIEST


def fit_scan(image: np.ndarray, around: np.ndarray, slabs: Slabs | None = None, blur: float | None = None,
             centred: bool = False) -> ScanFit:
    """The field whose scan is an image of two values, see `field_of_grey`.

    blur: width in voxels of the scanner's Gaussian, None: found with the corrections, by least squares. centred: the
    wall is at the value half-way between fluid and solid, which is found too, and not at 0. Nothing is fitted to noise:
    corrections end where what is left is no more than it. Periodic and mirrored as `spline_coefficients` continues the
    field; slabs: as there.
    """
    slabs = slabs or Slabs.whole(image.shape)
    scanner = Scanner(around, slabs)
    square = _find_blur(image, around, slabs) if blur is None else blur * blur
    zero = 0.0
    for _ in range(CENTRED if centred else 0):
        off = _half_way(image, scanner.scanned(sharpen(image, square**0.5, around, slabs), square))
        image, zero = image - np.float32(off), zero + off
    field = sharpen(image, square**0.5, around, slabs)
    best: ScanFit | None = None
    for _ in range(CORRECTIONS + 1):
        seen = scanner.scanned(field, square)
        left = _beside(image, seen)
        pure = np.abs(seen) > PURE
        misfit = _root_mean_square(left[~pure])
        if best is not None and misfit >= best.misfit * best.worth_a_correction:
            break
        noise = max(_noise_of(left, seen, slabs), _noise_of_pure(image, left, seen))
        best = ScanFit(field, square**0.5, misfit if best is None else best.first, misfit, noise,
                       _root_mean_square(left[pure]), zero + (0.0 if centred else _half_way(image, seen)))
        field = field + np.where(pure, np.float32(0.0), left)
        square = square if blur is not None else max(square + scanner.wider(left, seen), 0.0)
    assert best is not None
    return best


def _find_blur(image: np.ndarray, around: np.ndarray, slabs: Slabs) -> float:
    """Variance, square voxels, of the Gaussian with which the scan of the sharpened image is nearest to the image, 0 to
    the last of WIDTHS^2. The means of the two sides of the threshold do not tell it: in narrow pores and thin grains no
    voxel is pure fluid or solid. The least width is taken: what is sharpened far too much has other ones."""
    image, around, slabs = _middle(image, around, slabs)
    scanner = Scanner(around, slabs, ROUGH_PARTS)

    @functools.cache  # `brentq` asks for the ends anew
    def wider(square: float) -> float:
        seen = scanner.scanned(sharpen(image, square**0.5, around, slabs), square)
        return scanner.wider(_beside(image, seen), seen)

    low = 0.0
    if wider(low) <= 0.0:
        return low
    for width in WIDTHS:
        high = width * width
        if wider(high) < 0.0:
            return float(brentq(wider, low, high, xtol=STILL))
        low = high
    return low


def _middle(image: np.ndarray, around: np.ndarray, slabs: Slabs) -> tuple[np.ndarray, np.ndarray, Slabs]:
    """The middle of an image, with what `fit_scan` takes beside it: SAMPLE voxels along each axis, twice as many where
    a grain or a pore fills it, so that the rarer of the two has at least half of its share in all of the image."""

    def rarer(values: np.ndarray) -> float:
        fluid = float(reduce.mean(values.ravel() > 0))
        return min(fluid, 1.0 - fluid)

    edge, least = SAMPLE, 0.5 * rarer(image)
    while True:
        edges = [min(n, edge) for n in slabs.shape]
        starts = [(n - size) // 2 for n, size in zip(slabs.shape, edges)]
        part, of_part = slabs.part(image, tuple(slice(a, a + size) for a, size in zip(starts, edges)))
        if rarer(part) >= least:
            return part, around & (np.array(edges) == slabs.shape)[::-1], of_part  # a part is mirrored at its faces
        edge *= 2


def _noise_of(left: np.ndarray, seen: np.ndarray, slabs: Slabs) -> float:
    """Standard deviation of the noise in what an image has beside the scan of a field, by the differences between
    neighbours that hold little of a wall."""
    squares, pairs = 0.0, 0
    for axis in range(3):
        value, scan = (slabs.beside(v, 0, 1, False)[0] if axis == 0 and slabs.ranks.size > 1 else v
                       for v in (left, seen))
        flat = np.abs(scan) > FLAT
        lower, upper = (tuple(part if a == axis else slice(None) for a in range(3))
                        for part in (slice(None, -1), slice(1, None)))
        alike = flat[lower] & flat[upper] & (scan[lower] * scan[upper] > 0.0)
        changes = value[upper][alike] - value[lower][alike]
        squares += float(reduce.total(np.square(changes)))
        pairs += reduce.number(changes)
    return float(np.sqrt(0.5 * squares / max(pairs, 1)))


def _noise_of_pure(image: np.ndarray, left: np.ndarray, seen: np.ndarray) -> float:
    """Standard deviation of what an image has beside the scan of a field where there is no wall: of noise whose
    neighbours are alike, of rings and of a drift of the brightness too. Where values end at the least or the largest
    that a voxel can have, the noise beyond is lost there, and not at the walls: it is that of a normal distribution
    that is cut off at the share of voxels which have this value. Where most have it there is hardly any noise. 0
    where voxels without a wall are rare: those that seem so are chosen by their noise, and it was 1.3 times the true
    one."""
    squares, whole, counted = 0.0, 0.0, 0
    for side, end in ((seen > PURE, reduce.largest(image.ravel())), (seen < -PURE, reduce.smallest(image.ravel()))):
        count = reduce.number(left[side])
        if count:
            cut = float(reduce.total((image[side] == end).astype(float))) / count
            squares += float(reduce.total(np.square(left[side])))
            whole += count * (_variance_cut_off(cut) if cut < MOST_CUT else 1.0)
        counted += count
    return float(np.sqrt(squares / whole)) if counted >= RARE * reduce.number(image.ravel()) > 0 else 0.0


def _variance_cut_off(share: float) -> float:
    """Variance of normal noise of variance 1 whose lowest `share` is put at the quantile of that share."""
    if share <= 0.0:
        return 1.0
    z = float(ndtri(share))
    density = float(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))
    return z * z * share + 1.0 - share + z * density - (density + z * share) ** 2


def apart(field: np.ndarray, other: np.ndarray, slabs: Slabs) -> float:
    """How far apart the walls of two fields [z, y, x] are, voxels: root mean square of the first at the walls of the
    other, over that of its changes from voxel to voxel there; of walls along the voxels the distance, else up to 1.4
    times that."""
    values, changes = 0.0, 0.0
    for axis in range(3):
        a, b = (slabs.beside(v, 0, 1, False)[0] if axis == 0 and slabs.ranks.size > 1 else v for v in (field, other))
        lower, upper = (tuple(part if k == axis else slice(None) for k in range(3))
                        for part in (slice(None, -1), slice(1, None)))
        wall = (b[lower] > 0.0) != (b[upper] > 0.0)
        own, change, there = a[lower][wall], (a[upper] - a[lower])[wall], b[lower][wall]
        own = own + there / (there - b[upper][wall]) * change
        values += float(reduce.total(np.square(own)))
        changes += float(reduce.total(np.square(change)))
    return math.sqrt(values / changes) if changes > 0.0 else 0.0


class Scanner:
    """What makes scans of fields [z, y, x]; around, slabs: see `spline_coefficients`; parts: cells along an edge of a
    voxel whose shares of fluid are found one by one."""

    def __init__(self, around: np.ndarray, slabs: Slabs, parts: int = PARTS):
        self.around, self.slabs = around, slabs
        self._weights = weights_in_voxel(parts), weights_in_voxel(parts if slabs.shape[0] > 1 else 1)
        self._modes = Modes(slabs.shape, around, slabs)
        self._square = ((2.0 * np.pi) ** 2 * self._modes.square_frequencies()).astype(np.float32)

    def scanned(self, field: np.ndarray, square: float) -> np.ndarray:
        """The scan of the body that a field has, float32 [z, y, x]: in each voxel the share of fluid less that of
        solid, averaged with a Gaussian of the variance `square`, voxel^2. The field is its cubic spline."""
        coefficients = spline_coefficients(np.array(field, np.float32), self.around, self.slabs)
        fluid, first, here = field > 0, self.slabs.own[0], self.around
        if self.slabs.ranks.size > 1:
            coefficients, first = self.slabs.beside(coefficients, SEEN, SEEN, bool(here[2]))
            fluid, _ = self.slabs.beside(fluid, SEEN, SEEN, bool(here[2]))
            here = np.array([*here[:2], False])  # the layers beyond the own ones are there
        out = np.empty(field.shape, np.float32)
        (parts, _), (deep, _), nx = *(weights[0].shape for weights in self._weights), field.shape[2]
        over_rows(_put_shares, field.shape[0] * field.shape[1], (coefficients, fluid), here, self.slabs.own[0] - first,
                  self._weights, out,
                  work=lambda: tuple(in_one_piece((2, deep, 5, nx), (3, deep, parts, nx + 4), (nx,))))
        return self._modes.filtered(out, np.exp(-0.5 * square * self._square)) if square > 0.0 else out

    def wider(self, left: np.ndarray, seen: np.ndarray) -> float:
        """By how much the variance of the blur, voxel^2, has to be larger so that a scan comes nearest to an image that
        has so much beside it: least squares of `left` by the derivative of the scan, half its Laplacian."""
        slope = self._modes.filtered(seen, -0.5 * self._square)
        squares = float(reduce.total(np.square(slope).ravel()))
        return float(reduce.total((left * slope).ravel())) / max(squares, 1e-30)


def _beside(image: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """What an image has beside the scan of a field, float32, in units of that scan. The zero of the image is that of
    the scan, the values of its fluid and its solid are the best by least squares."""
    fluid, solid = (_value_of(image[side], seen[side]) for side in (seen > 0, seen <= 0))
    return image / np.where(image > 0, fluid, solid) - seen


def _half_way(image: np.ndarray, seen: np.ndarray) -> float:
    """The value of an image half-way between its fluid and its solid, by the scan of a field."""
    return 0.5 * float(_value_of(image[seen > 0], seen[seen > 0]) - _value_of(image[seen <= 0], seen[seen <= 0]))


def _value_of(image: np.ndarray, seen: np.ndarray) -> np.float32:
    """The number by which values seen (n,) are nearest to those of the image, 1 where there are none."""
    squares = reduce.total(np.square(seen))
    return np.float32(reduce.total(image * seen) / squares if squares > 0.0 else 1.0)


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(reduce.mean(np.square(values)))) if reduce.number(values) else 0.0


@njit(cache=True, nogil=True)
def _put_shares(rows, work, body, around, first, weights, out):
    """Shares of fluid less those of solid in the voxels of lines along x, into out [own z, y, x]. A voxel all of whose
    neighbours are alike is pure.

    body: coefficients, and whether there is fluid at the voxel centres, both with the layers beside the own ones, which
    begin at `first`; weights: of `weights_in_voxel`, along x and y, and along z; work: see `_sum_shares`.
    """
    (c, fluid), (_, ny, nx), sums = body, out.shape, work[2]
    cells = len(weights[0][0]) ** 2 * len(weights[1][0])
    for row in range(rows[0], rows[1]):
        k, j = row // ny + first, row % ny
        line = out[k - first, j]
        walls = False
        for i in range(nx):
            line[i] = 0.0 if not _alike(fluid, around, k, j, i) else 1.0 if fluid[k, j, i] else -1.0
            walls |= line[i] == 0.0
        if walls:
            _sum_shares(c, neighbours(k, c.shape[0], around[2]), neighbours(j, ny, around[1]), around[0], weights, work)
            for i in range(nx):
                line[i] = sums[i] / cells if line[i] == 0.0 else line[i]


@njit(cache=True)
def _sum_shares(c, zs, ys, repeats, weights, work):
    """Sums over the cells of each voxel of a line along x of the share of fluid less that of solid: of a plane wall
    across an edge exactly, of others with the right variance of the step. The spline is taken axis by axis at the
    middles of the cells.

    zs, ys: five layers and lines of coefficients round the line; work: [2, r, y, x] values and slopes along z at the
    r-th middle along z; [3, r, q, x + 4] values and slopes along y and z at the q-th middle along y, with two voxels
    more at either end; (nx,) the sums.
    """
    (w, s), (w_deep, s_deep) = weights
    lines, places, sums = work
    nx, parts, deep = len(sums), len(w), len(w_deep)
    for b in range(5):
        for r in range(deep):
            for kind in range(2):
                t = w_deep[r] if kind == 0 else s_deep[r]
                _weigh(t, c[zs[0], ys[b]], c[zs[1], ys[b]], c[zs[2], ys[b]], c[zs[3], ys[b]], c[zs[4], ys[b]],
                       lines[kind, r, b])
    for r in range(deep):
        values, slopes = lines[0, r], lines[1, r]
        for q in range(parts):
            for kind in range(3):
                t = s[q] if kind == 1 else w[q]
                u = slopes if kind == 2 else values
                place = places[kind, r, q]
                _weigh(t, u[0], u[1], u[2], u[3], u[4], place[2 : nx + 2])
                _, _, _, place[nx + 2], place[nx + 3] = _around(place, nx, nx - 1, repeats)
                place[0], place[1], _, _, _ = _around(place, nx, 0, repeats)
    sums[:] = 0.0
    for r in range(deep):
        for q in range(parts):
            for p in range(parts):
                _add_shares(w[p], s[p], places[0, r, q], places[1, r, q], places[2, r, q], 2.0 * parts, sums)


@njit(cache=True)
def _around(place, nx, i, repeats):
    """Values at the five neighbours of voxel i of a line that begins at place[2]."""
    a, b, d, e, f = neighbours(i, nx, repeats)
    return place[a + 2], place[b + 2], place[d + 2], place[e + 2], place[f + 2]


@njit(cache=True)
def _weigh(t, a, b, d, e, f, out):
    """The sum of five lines with the weights t (5,)."""
    t0, t1, t2, t3, t4 = t[0], t[1], t[2], t[3], t[4]
    for i in range(len(out)):
        out[i] = t0 * a[i] + t1 * b[i] + t2 * d[i] + t3 * e[i] + t4 * f[i]


@njit(cache=True)
def _add_shares(w, s, value, along_y, along_z, steepness, sums):
    """Adds the shares in the cells at one place of each voxel of a line. w, s: (5,) weights of the place along x."""
    w0, w1, w2, w3, w4 = w[0], w[1], w[2], w[3], w[4]
    s0, s1, s2, s3, s4 = s[0], s[1], s[2], s[3], s[4]
    for i in range(len(sums)):
        f0, f1, f2, f3, f4 = value[i], value[i + 1], value[i + 2], value[i + 3], value[i + 4]
        f = w0 * f0 + w1 * f1 + w2 * f2 + w3 * f3 + w4 * f4
        x = s0 * f0 + s1 * f1 + s2 * f2 + s3 * f3 + s4 * f4
        y = w0 * along_y[i] + w1 * along_y[i + 1] + w2 * along_y[i + 2] + w3 * along_y[i + 3] + w4 * along_y[i + 4]
        z = w0 * along_z[i] + w1 * along_z[i + 1] + w2 * along_z[i + 2] + w3 * along_z[i + 3] + w4 * along_z[i + 4]
        slope = np.sqrt(x * x + y * y + z * z) + 1e-30  # a flat field is pure
        sums[i] += min(max(steepness * f / slope, -1.0), 1.0)


@njit(cache=True)
def _alike(fluid, around, k, j, i):
    """Whether a voxel and its 26 neighbours are all fluid or all solid."""
    own = fluid[k, j, i]
    for a in range(k - 1, k + 2):
        for b in range(j - 1, j + 2):
            for d in range(i - 1, i + 2):
                z = _index(a, fluid.shape[0], around[2])
                if fluid[z, _index(b, fluid.shape[1], around[1]), _index(d, fluid.shape[2], around[0])] != own:
                    return False
    return True


@njit(cache=True, inline="always")
def _index(i, n, repeats):
    """Of a voxel beside an axis of n: that of its periodic image, else the last before the face."""
    return i % n if repeats else min(max(i, 0), n - 1)
