"""The body that a scan shows: the field whose zero is the wall, corrected until its own scan is the image.

A scan of two values holds the share of fluid in each voxel, blurred. Sharpening undoes that as far as it is linear, and
a field that is smooth between voxels rounds off edges and walls along the voxels. Here the body of the field is scanned
in turn: its share of fluid in each voxel, blurred as the image is. What the image has beside that is added to the
field, as often as the two come nearer to each other (the Landweber iteration, with the scan as a function of the body
and not of the field).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.optimize import brentq
from scipy.special import ndtri

from ..domain import reduce
from ..domain.row_threads import over_rows
from ..domain.slabs import Slabs
from .grey import sharpen
from .modes import Modes
from .spline import SEEN, spline_coefficients, value_and_slope

PARTS = 3  # cells along an edge of a voxel whose shares are taken from the value and the slope in their middles
# Voxels from the middle of a voxel to the wall by value and slope, beyond which it is pure: it ends at 0.87 voxel, and
# slopes fall with the distance
FAR = 1.5
# Corrections at most. Errors of k of 24 perfect scans in per cent, median and root mean square: with none 3.7, 6.3,
# with 4 0.45, 3.4, with 8 0.31, 3.0 (docs/design_notes.md)
CORRECTIONS = 8
PURE = 0.999  # of the scan of a field, -1 to 1: voxels beyond hold no wall, and what they differ by is noise
FLAT = 0.9  # of the same: between neighbours beyond, what they differ by changes by noise alone
# Corrections end where the misfit is so many times the noise before the first of them (Morozov's discrepancy
# principle): what is left later has noise that is fitted already. With a blur of 1 voxel and noise of 5 % of the
# contrast k of blobs 14 is +3.8 % off, with 1 in place of 1.05 -6.7 %, with the noise of what is left each time -56 %
AS_NOISE = 1.05
WIDTHS = (0.4, 0.8, 1.2, 2.0)  # voxels, between which the width of the blur is looked for
STILL = 0.02  # square voxels, to which the variance of the blur is found before the corrections, which go on with it
MOST_CUT = 0.7  # share of pure voxels with the last value, beyond which it is that of a scan without noise
RARE = 0.05  # share of the voxels: noise is not told by pure ones where they are fewer
CENTRED = 2  # steps to the value half-way: Otsu's is 1 to 15 % of the contrast off (docs/design_notes.md), a sixth is left
# An image is no scan where corrections leave more than the share LEFT of the misfit, and that is more than MISFIT half
# contrasts and OF_NOISE times the noise. Scans without noise: 0.5 of it at most; signed distances to a sphere and an
# ellipse that are cut off at 1 and 1.5 voxels: 0.9 to 1, and 0.047 half contrasts or more (docs/design_notes.md)
LEFT, MISFIT, OF_NOISE = 0.7, 0.03, 1.5


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
    def is_scan(self) -> bool:
        """False of an image that no body and no blur make, such as a signed distance: corrections then do not help."""
        return self.misfit <= max(LEFT * self.first, MISFIT, OF_NOISE * max(self.noise, self.pure))


def fit_scan(image: np.ndarray, around: np.ndarray, slabs: Slabs | None = None, blur: float | None = None,
             centred: bool = False) -> ScanFit:
    """The field whose scan is an image of two values, see `field_of_grey`.

    blur: width in voxels of the scanner's Gaussian, None: found with the corrections, by least squares. centred: the
    wall is at the value half-way between fluid and solid, which is found too, and not at 0. Nothing is fitted to noise:
    corrections end where what is left is no more than it. Periodic and mirrored as `spline_coefficients` continues the
    field; slabs: as there.
    """
    slabs = slabs or Slabs.whole(image.shape)
    scanner, square = Scanner(around, slabs), 0.0 if blur is None else blur * blur
    if blur is None:
        square = _find_blur(image, scanner)
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
        if best is not None and misfit >= best.misfit:
            break
        if best is None:
            first, noise = misfit, max(_noise_of(left, seen, slabs), _noise_of_pure(image, left, seen))
        best = ScanFit(field, square**0.5, first, misfit, noise, _root_mean_square(left[pure]),
                       zero + (0.0 if centred else _half_way(image, seen)))
        if misfit <= AS_NOISE * noise:
            break
        field = field + np.where(pure, np.float32(0.0), left)
        square = square if blur is not None else max(square + scanner.wider(left, seen), 0.0)
    assert best is not None
    return best


def _find_blur(image: np.ndarray, scanner: Scanner) -> float:
    """Variance, square voxels, of the Gaussian with which the scan of the sharpened image is nearest to the image, 0 to
    the last of WIDTHS^2. The means of the two sides of the threshold do not tell it: in narrow pores and thin grains no
    voxel is pure fluid or solid. The least width is taken: what is sharpened far too much has other ones."""

    def wider(square: float) -> float:
        seen = scanner.scanned(sharpen(image, square**0.5, scanner.around, scanner.slabs), square)
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
    where voxels without a wall are rare: noise chooses those that seem so, and it was 1.3 times too much."""
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


class Scanner:
    """What makes scans of fields [z, y, x]; around, slabs: see `spline_coefficients`."""

    def __init__(self, around: np.ndarray, slabs: Slabs):
        self.around, self.slabs = around, slabs
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
        over_rows(_put_shares, field.size, coefficients, fluid, here, self.slabs.own[0] - first, out)
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
def _put_shares(rows, c, fluid, around, first, out):
    """Shares of fluid less those of solid in the voxels of the layers from `first` on, into out [own z, y, x]. c and
    fluid, of the voxel centres, have the layers beside them. A voxel all of whose neighbours are alike is pure."""
    _, ny, nx = out.shape
    deep = PARTS if c.shape[0] > 1 else 1
    for row in range(rows[0], rows[1]):
        k, j, i = row // (ny * nx) + first, row // nx % ny, row % nx
        if _alike(fluid, around, k, j, i) or _far(c, around, i + 0.5, j + 0.5, k + 0.5):
            share = 1.0 if fluid[k, j, i] else -1.0
        else:
            share = 0.0
            for z in range(deep):
                for y in range(PARTS):
                    for x in range(PARTS):
                        share += _share(c, around, i + (x + 0.5) / PARTS, j + (y + 0.5) / PARTS, k + (z + 0.5) / deep)
            share /= deep * PARTS * PARTS
        out[k - first, j, i] = share


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


@njit(cache=True)
def _far(c, around, x, y, z):
    """Whether the value at a point, over the slope there, is more than FAR voxels."""
    value, a, b, d = value_and_slope(c, around, x, y, z)
    return value * value > FAR * FAR * (a * a + b * b + d * d)


@njit(cache=True, inline="always")
def _index(i, n, repeats):
    """Of a voxel beside an axis of n: that of its periodic image, else the last before the face."""
    return i % n if repeats else min(max(i, 0), n - 1)


@njit(cache=True)
def _share(c, around, x, y, z):
    """Share of fluid less that of solid in a cell of 1 / PARTS of a voxel round a point: of a plane wall across an
    edge exactly, of others with the right variance of the step."""
    value, a, b, d = value_and_slope(c, around, x, y, z)
    slope = np.sqrt(a * a + b * b + d * d)
    if slope == 0.0:
        return 1.0 if value > 0.0 else -1.0
    return min(max(2.0 * PARTS * value / slope, -1.0), 1.0)
