"""The smooth body that the labels of an image are samples of: the most probable field with their signs.

Prior: a Gaussian random field of unit variance with the covariance exp(-r^2 / (2 l^2)) between centres r voxels apart;
l follows from the area of the walls (`correlation_length`). A label says the sign of the field at its centre, up to
noise of the variance NOISE (probit regression; Rasmussen and Williams 2006, ch. 3). The maximum of the posterior is
found by expectation and maximisation: the field is lifted to its expected value on the side that its label says, then
filtered by C / (C + NOISE), C the spectrum of the covariance; with Nesterov's momentum. Slits of 2, 3 and 5 voxels keep
their width within 0.1 voxels; sharp corners become round.

benchmarks/walls_from_labels.py compares it with Gaussian averages of the labels, on bodies whose truth is known: an
average over half a voxel leaves the staircase as roughness, of which finer particles see more, and k falls by 3.5 %
from one particle a voxel to two; a wider one opens the throats.
"""

from __future__ import annotations

import math

import numpy as np
from numba import get_num_threads, njit, prange
from scipy import fft
from scipy.special import ndtri

# Correlation length of the prior over that of a random field with walls of the same area. Shorter ones leave the
# staircase of large smooth bodies as roughness (an annulus of radii 7.6 and 15.2 voxels: k -2.7 % with 1.4 voxels,
# -1.1 % with 2.7), longer ones open the throats of random bodies (+3 % with 0.65)
SHARE = 0.45
SHORTEST, LONGEST = 1.4, 4.0  # voxels. With 1.2 k of random bodies falls by 1.5 % from one particle a voxel to two
NOISE = 0.01  # variance, over that of the field; 0.05 opens the throats by 1.6 %
ITERATIONS = 60  # after them the wall of a random body moves by 0.01 voxels rms, 0.0002 in the mean
START = 0.4  # of the filtered labels: nearer to the field that is found; with 1 twice as many iterations are needed
CERTAIN = 6.0  # standard deviations of the noise beyond which a label changes nothing (1e-8)


def most_probable_field(fluid: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Field, float32, > 0 in fluid and 0 on the wall, of labels `fluid` (bool [z, y, x]).

    around: (3,) bool x, y, z. Along periodic axes the field repeats, along the others it is mirrored at the faces.
    """
    if fluid.all() or not fluid.any():
        return np.where(fluid, np.float32(1.0), np.float32(-1.0))
    axes = [a for a in range(3) if fluid.shape[a] > 1]
    repeats = [a for a in axes if around[2 - a]]
    mirrored = [a for a in axes if not around[2 - a]]
    share = _share_kept(fluid.shape, repeats, mirrored, correlation_length(fluid, around))
    sign = np.where(fluid, np.int8(1), np.int8(-1))
    field = _filtered(np.float32(START) * sign, share, repeats, mirrored)
    ahead, momentum = field, 1.0
    for _ in range(ITERATIONS):
        following = _filtered(_lifted(ahead, sign, math.sqrt(NOISE)), share, repeats, mirrored)
        if _turns(ahead, following, field) > 0.0:  # momentum against the slope: it starts anew (O'Donoghue and Candes)
            momentum = 1.0
        next_momentum = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = _ahead(following, field, np.float32((momentum - 1.0) / next_momentum))
        field, momentum = following, next_momentum
    return field


def correlation_length(fluid: np.ndarray, around: np.ndarray) -> float:
    """Correlation length of the prior, voxels: a share of that of the Gaussian random field which, cut at a level, has
    the porosity and the wall area of the labels `fluid` (bool [z, y, x]).

    Such a field has walls of the area 2 / pi exp(-t^2 / 2) / l a volume, t the level in standard deviations (Rice); a
    voxelised wall has 3/2 of its area.
    """
    pairs = faces = 0
    for axis in range(3):
        if fluid.shape[axis] > 1:
            other = np.roll(fluid, -1, axis)
            differ = fluid != other
            if not around[2 - axis]:
                differ = np.moveaxis(differ, axis, 0)[:-1]
            faces += int(np.count_nonzero(differ))
            pairs += differ.size
    area = 2.0 / 3.0 * 3.0 * faces / max(pairs, 1)
    level = float(ndtri(fluid.mean()))
    length = 2.0 / math.pi * math.exp(-0.5 * level * level) / max(area, 1e-9)
    return min(max(SHARE * length, SHORTEST), LONGEST)


def _share_kept(shape: tuple[int, ...], repeats: list[int], mirrored: list[int], length: float) -> np.ndarray:
    """C / (C + NOISE) of every mode of `_filtered`; length: of the correlation, voxels."""
    square = np.zeros((1, 1, 1))
    for a in repeats + mirrored:
        n = shape[a]
        q = np.arange(n) / (2 * n) if a in mirrored else fft.rfftfreq(n) if a == repeats[-1] else fft.fftfreq(n)
        square = square + (q**2).reshape([-1 if b == a else 1 for b in range(3)])
    dim = len(repeats) + len(mirrored)
    c = (2 * np.pi) ** (dim / 2) * length**dim * np.exp(-2.0 * (np.pi * length) ** 2 * square)
    return (c / (c + NOISE)).astype(np.float32)


def _filtered(field: np.ndarray, share: np.ndarray, repeats: list[int], mirrored: list[int]) -> np.ndarray:
    """The field with `share` of each of its modes: waves along periodic axes, cosines along mirrored ones."""
    workers, shape = get_num_threads(), field.shape
    for a in mirrored:
        field = fft.dct(field, axis=a, norm="ortho", workers=workers)
    if repeats:
        modes = fft.rfftn(field, axes=repeats, workers=workers)
        modes *= share
        field = fft.irfftn(modes, [shape[a] for a in repeats], axes=repeats, workers=workers, overwrite_x=True)
    else:
        field = field * share
    for a in mirrored:
        field = fft.idct(field, axis=a, norm="ortho", workers=workers, overwrite_x=True)
    return field


@njit(cache=True, parallel=True)
def _lifted(field, sign, noise):
    """Expected value of the noisy field where its sign is known: f + s noise phi(z) / Phi(z), z = s f / noise."""
    out = np.empty_like(field)
    for layer in prange(field.shape[0]):
        for y in range(field.shape[1]):
            for x in range(field.shape[2]):
                f, s = field[layer, y, x], sign[layer, y, x]
                z = s * f / noise
                if z > CERTAIN:
                    more = 0.0
                elif z < -5.0 * CERTAIN:
                    more = -z  # the limit of the quotient
                else:
                    more = math.exp(-0.5 * z * z) / (math.sqrt(0.5 * math.pi) * math.erfc(-z / math.sqrt(2.0)))
                out[layer, y, x] = f + s * noise * more
    return out


def _turns(ahead: np.ndarray, following: np.ndarray, field: np.ndarray) -> float:
    """Scalar product of the last correction and the step that it ended in: > 0 where momentum leads uphill."""
    return float(np.vdot(ahead - following, following - field))


@njit(cache=True, parallel=True)
def _ahead(following, field, share):
    out = np.empty_like(following)
    for layer in prange(following.shape[0]):
        out[layer] = following[layer] + share * (following[layer] - field[layer])
    return out
