"""The kink of a velocity where the viscosity jumps: its slopes on either side.

The slope of the velocity along the interface jumps, so that the shear stress does not. With the normal n,

    s = (grad u + grad u^T) . n  without its part along n

is the shear on the side of a particle i. There the velocity is a smooth one and s f_i, where f_i = mu_i phi / mu has
the slope n on the side of i and n mu_i / mu_j on the other. Eq. 5 finds of f_i a slope v, which is not n: it has
neighbours on both sides. Of the whole velocity it finds the shear s (v . n), and of the slope it lacks

    s (n - v) / (v . n),      s that of the slopes of eq. 5.

With this, slopes are exact for velocities that are linear on either side, in any arrangement, as the sums of stresses
are (`two_fluids`). A turning of the whole has no s. The velocity across the interface has no kink: of fluid that does
not expand its slope is given by the other ones, which do not jump.

Without it a shift across the shear of the thinner fluid changes the velocity of the thicker one, which is a force on
it. The divergence of the projection is that of eq. 5 on both sides: with these slopes layers came out better, but a
bubble that rises lost the balance of what rises and what sinks (docs/design_notes.md, layers off the lattice).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from ..operators.pair_weights import Operators
    from .interface import Interface

LEAST_SEEN = 0.1  # v . n, of 1 to mu_i / mu_j: particles that find less of a slope lie too oddly to tell (none in runs)


class Kink(NamedTuple):
    """normal: (n, dim); missed: (n, dim) (n - v) / (v . n), zero away from the interface."""

    normal: np.ndarray
    missed: np.ndarray

    def one_sided(self, slope: np.ndarray) -> np.ndarray:
        """Slopes (n, c, dim) of velocities, one after the other, on the side of each particle, from those of eq. 5."""
        n, dim = self.normal.shape
        whole = slope.reshape(n, slope.shape[1] // dim, dim, dim)
        normal = self.normal[:, None]
        shear = _products(whole + whole.swapaxes(2, 3), normal[:, :, None])
        shear -= _products(shear, normal)[:, :, None] * normal
        return slope + (shear[:, :, :, None] * self.missed[:, None, None]).reshape(slope.shape)


def kink_at(interface: Interface, ops: Operators, viscosity: np.ndarray, near: np.ndarray) -> Kink:
    """The Kink of particles `near` (n,) the interface of fluids of viscosities (2,), Pa s. ops: Operators."""
    mu, n = viscosity[interface.phase], interface.normal
    v = mu[:, None] * ops.gradient_p(interface.phi / mu)
    along = _products(v, n)
    known = near & (along > LEAST_SEEN)
    return Kink(n, np.divide(n - v, along[:, None], out=np.zeros_like(n), where=known[:, None]))


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Over the last axis of a and b (..., dim)."""
    return np.einsum("...k,...k->...", a, b)
