"""Permeability of a flow by Darcy's law (eq. 28), and its limit over several spacings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.protocol import Geometry, sample_box
from ..references.ducts import duct_permeability


def darcy(geometry: Geometry, x: np.ndarray, velocity: np.ndarray, site_volume: float, axis: int | None = None,
          force: np.ndarray | None = None,
          viscosity: float | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Superficial and mean velocity (dim,) of the sample, and its permeability.

    x, velocity: (n, dim) of the fluid particles; axis: of the drive or None; force: (dim,) m/s2, and
    viscosity: kinematic, m2/s, of a drive.
    permeability: (dim,) m2, entry `axis` along the drive, the others across it; None without a drive. The force acts on
    the whole length of the box; on the sample, what the clear layers need as a duct is off:
    k = nu U L_sample / (g L_box - nu U L_clear / k_duct).
    """
    lower, upper = sample_box(geometry)
    inside = np.all((x >= lower) & (x <= upper), axis=1)
    total = velocity[inside].sum(axis=0)
    superficial = total * (site_volume / np.prod(upper - lower))
    mean = total / max(int(inside.sum()), 1)
    if axis is None:
        return superficial, mean, None
    assert force is not None and viscosity is not None
    size = np.linalg.norm(force)
    along = float(superficial @ force) / size
    length, sample = (geometry.upper - geometry.lower)[axis], (upper - lower)[axis]
    gravity = size * length / sample
    if sample < length:
        clear = viscosity * along / clear_permeability(geometry, axis)
        gravity = max(gravity - clear * (length - sample) / sample, size)  # no sample resists less than a clear one
    permeability = viscosity / gravity * superficial * np.sign(force[axis])
    permeability[axis] = viscosity / gravity * along  # eq. 28
    return superficial, mean, permeability


def clear_permeability(geometry: Geometry, axis: int) -> float:
    """Permeability along an axis of the box of a geometry without what is in it, m2: that of its clear layers."""
    others = [a for a in range(geometry.dim) if a != axis]
    slip = [None if geometry.periodic[a] else (float(geometry.slip_length[1 + 2 * a]),
                                               float(geometry.slip_length[2 + 2 * a])) for a in others]
    return duct_permeability([float((geometry.upper - geometry.lower)[a]) for a in others], slip)


def extrapolate(spacings: Sequence[float] | np.ndarray,
                values: Sequence[float] | np.ndarray) -> tuple[float, float, float | None, str]:
    """Richardson extrapolation of values (m,) at spacings (m,): (value, error bar, order or None, sentence).

    Two spacings assume order 1.5, what walls on a lattice showed; three or more measure it on the finest three.
    """
    order = np.argsort(spacings)
    h, k = np.asarray(spacings, float)[order], np.asarray(values, float)[order]
    if len(h) == 2:
        p = 1.5
    else:
        d1, d2 = k[1] - k[0], k[2] - k[1]
        spread = float(np.ptp(k[:3]))
        early = "the trend over the spacings is not yet asymptotic: no extrapolation, the error is their spread"
        if d1 * d2 <= 0.0:
            return k[0], spread, None, early
        from scipy.optimize import brentq

        def mismatch(p: float) -> float:
            return d1 * (h[2] ** p - h[1] ** p) - d2 * (h[1] ** p - h[0] ** p)

        if mismatch(0.3) * mismatch(4.0) > 0.0:
            return k[0], spread, None, early
        p = brentq(mismatch, 0.3, 4.0)
    slope = (k[1] - k[0]) / (h[1] ** p - h[0] ** p)
    limit = k[0] - slope * h[0] ** p
    how = "assumed" if len(h) == 2 else "observed"
    return limit, abs(limit - k[0]), p, f"extrapolated with {how} order {p:.2f} over {len(h)} spacings"
