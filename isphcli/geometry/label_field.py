"""The smooth body that the labels of an image are samples of: the most probable field with their signs.

Prior: a Gaussian random field of unit variance with the covariance exp(-r^2 / (2 l^2)) between centres r voxels apart,
the share FINE of it with l = SHORTEST; l follows from the area of the walls (`correlation_length`). A label is the sign
of the field at its centre, up to noise of the variance NOISE (probit regression; Rasmussen and Williams 2006, ch. 3).
The maximum of the posterior is found by expectation and maximisation: the field is lifted to its expected value on the
side of its label, then filtered by C / (C + NOISE), C the spectrum of the covariance; with Nesterov's momentum.
Slits of 2, 3 and 5 voxels in 14 are 2.14, 3.09 and 5.05 wide; sharp corners become round.

benchmarks/walls_from_labels.py compares it with Gaussian averages of the labels, on bodies whose truth is known: an
average over half a voxel leaves the staircase as roughness, of which finer particles see more, and k falls by 3.4 %
from one particle per voxel to two; a wider one opens the throats.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.special import ndtri

from ..domain.row_threads import over_rows
from ..domain.slabs import Slabs
from .labels import faces_and_pairs
from .modes import Modes

# Correlation length, voxels, of a random field with walls of the same area: longer ones are that of the prior; of
# shorter ones the prior has the share length / RESOLVED. The most probable field lacks roughness finer than labels
# resolve, and so opens throats, the more the shorter it is: k of random bodies of 2 to 3 voxels is 3 to 7 % too much
# with their own length. With a share of 0.45 for all, staircases stay on large smooth bodies: k of ellipses and annuli
# at random places is 3.4 and 3.3 % off (rms), with this rule 2.8 and 3.1 %; others are alike
# (benchmarks/random_places.py)
RESOLVED = 6.85
SHORTEST, LONGEST = 1.4, 8.0  # voxels. With 1.2 k of random bodies falls by 1.5 % from one particle per voxel to two
# Share of the shortest length in the prior, so that pores one voxel wide beside large smooth walls stay open. With 0.03
# these walls keep more of their roughness
FINE = 0.003
NOISE = 0.01  # variance, over that of the field; 0.05 opens the throats by 1.6 %
# Iterations a voxel of the correlation length, and the most. After 60 with the shortest the wall of a random body moves
# by 0.01 voxels rms, 0.0002 in the mean; with 5 voxels k of an ellipse moves by 1.7 % from 60 to 120
ITERATIONS, MOST = 43, 120
START = 0.4  # factor of the filtered labels for the first field; with 1 twice as many iterations are needed
LEAST = 0.05  # standard deviations of the field: least value at a centre, so that every label keeps its sign
# Least clear fluid that the field sees at either end of an image with clear layers, correlation lengths, so that the
# walls do not depend on how thick the layers are. Within 8 voxels of the ends 0.26 and 0.32 % of the pores of Berea
# (l = 4) lie on the other side of the wall with layers of 3 voxels than with 8 l, 0.03 and 0.04 % with 2 l and 0.02 %
# with 4 l (`python benchmarks/clear_layers.py walls`)
DEEP = 2.0
CERTAIN = 6.0  # standard deviations of the noise beyond which a label changes nothing (1e-8)


def most_probable_field(fluid: np.ndarray, around: np.ndarray, sample: tuple[slice, ...] = (slice(None),) * 3,
                        slabs: Slabs | None = None) -> np.ndarray:
    """Field, float32, > 0 in fluid and 0 on the wall, of labels `fluid` (bool [z, y, x]).

    around: (3,) bool x, y, z. Along periodic axes the field repeats, along the others it is mirrored at the faces.
    sample: the part [z, y, x] that is no clear layer; the correlation length is that of its pores, and the walls are
    those between layers of DEEP correlation lengths, however thin the layers are. slabs: how the processes share the
    labels, of which each has its layers; without it one process has all.
    """
    slabs = slabs or Slabs.whole(fluid.shape)
    cells, of_fluid = slabs.ranks.sum(np.array([fluid.size, np.count_nonzero(fluid)]))
    if of_fluid in (0, cells):
        return np.where(fluid, np.float32(1.0), np.float32(-1.0))
    whole = [s.stop is None or s.stop - (s.start or 0) == n for s, n in zip(sample, slabs.shape)][::-1]  # x, y, z
    length = correlation_length(*slabs.part(fluid, sample), around & whole)
    more = [(0, 0) if w else (max(math.ceil(DEEP * length) - (s.start or 0), 0),) * 2
            for w, s in zip(whole[::-1], sample)]
    inner = tuple(slice(before, before + n) for (before, _), n in zip(more, slabs.shape))
    fluid, slabs = slabs.padded(fluid, more, True), slabs.grown(more)
    return slabs.part(_most_probable(fluid, around, length, slabs), inner)[0]


def _most_probable(fluid: np.ndarray, around: np.ndarray, length: float, slabs: Slabs) -> np.ndarray:
    """The same of a correlation length, voxels, and of all labels that are given."""
    modes = Modes(slabs.shape, around, slabs)
    share = _share_kept(modes, length)
    sign = np.where(fluid, np.int8(1), np.int8(-1))
    field = modes.filtered(np.float32(START) * sign, share)
    ahead, momentum = field, 1.0
    for _ in range(min(round(ITERATIONS * length), MOST)):
        following = modes.filtered(_lifted(ahead, sign, math.sqrt(NOISE)), share)
        # momentum against the slope: it starts anew (O'Donoghue and Candes)
        if slabs.ranks.sum(_turns(ahead, following, field)) > 0.0:
            momentum = 1.0
        next_momentum = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = _ahead(following, field, np.float32((momentum - 1.0) / next_momentum))
        field, momentum = following, next_momentum
    return sign * np.maximum(sign * field, np.float32(LEAST))


def correlation_length(fluid: np.ndarray, slabs: Slabs, around: np.ndarray) -> float:
    """Correlation length of the prior, voxels: that of the Gaussian random field which, cut at a level, has the
    porosity and the wall area of the labels `fluid` (bool, the own layers of `slabs`), or a share of it (`RESOLVED`).

    Such a field has walls of the area 2 / pi exp(-t^2 / 2) / l a volume, t the level in standard deviations (Rice); a
    voxelised wall has 3/2 of its area.
    """
    faces, pairs = faces_and_pairs(fluid, slabs, around)
    cells, of_fluid = slabs.ranks.sum(np.array([fluid.size, np.count_nonzero(fluid)]))
    area = 2.0 / 3.0 * 3.0 * faces / max(pairs, 1)
    level = float(ndtri(of_fluid / cells))
    length = 2.0 / math.pi * math.exp(-0.5 * level * level) / max(area, 1e-9)
    return min(max(length * min(length / RESOLVED, 1.0), SHORTEST), LONGEST)


def _share_kept(modes: Modes, length: float) -> np.ndarray:
    """C / (C + NOISE) of every mode; length: of the correlation, voxels."""
    square, c = modes.square_frequencies(), np.zeros(1)
    for own, part in ((length, 1.0 - FINE), (SHORTEST, FINE)):
        c = c + part * (2 * np.pi) ** (modes.dim / 2) * own**modes.dim * np.exp(-2.0 * (np.pi * own) ** 2 * square)
    return (c / (c + NOISE)).astype(np.float32)


def _lifted(field: np.ndarray, sign: np.ndarray, noise: float) -> np.ndarray:
    """Expected value of the noisy field where its sign is known: f + s noise phi(z) / Phi(z), z = s f / noise."""
    out = np.empty(field.shape, field.dtype)
    over_rows(_put_lifted, field.size, field.reshape(-1), sign.reshape(-1), noise, out.reshape(-1))
    return out


@njit(cache=True, nogil=True)
def _put_lifted(rows, field, sign, noise, out):
    for k in range(rows[0], rows[1]):
        f, s = field[k], sign[k]
        z = s * f / noise
        if z > CERTAIN:
            more = 0.0
        elif z < -5.0 * CERTAIN:
            more = -z  # the limit of the quotient
        else:
            more = math.exp(-0.5 * z * z) / (math.sqrt(0.5 * math.pi) * math.erfc(-z / math.sqrt(2.0)))
        out[k] = f + s * noise * more


def _turns(ahead: np.ndarray, following: np.ndarray, field: np.ndarray) -> float:
    """Scalar product of the last correction and the step that it ended in: > 0 where momentum leads uphill."""
    return float(np.vdot(ahead - following, following - field))


def _ahead(following: np.ndarray, field: np.ndarray, share: np.float32) -> np.ndarray:
    out = np.empty(following.shape, following.dtype)
    over_rows(_put_ahead, field.size, following.reshape(-1), field.reshape(-1), share, out.reshape(-1))
    return out


@njit(cache=True, nogil=True)
def _put_ahead(rows, following, field, share, out):
    for k in range(rows[0], rows[1]):
        out[k] = following[k] + share * (following[k] - field[k])
