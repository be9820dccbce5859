"""Surface tension: the force of an interface (paper eqs 14 and 24); its curvature is that of `interface`.

`jump` (default): the pressure of unlike neighbours differs by J_ij = sigma kappa_ij (c_j - c_i), c the colour. Eq. 2
sees what is left of the difference, so that each particle is accelerated by  sum_j b_ij J_ij grad_ij  with the very
weights b_ij grad_ij of its pressure gradient: a constant curvature is balanced to round-off by a pressure.
`csf` (eq. 24): the force sigma kappa grad C, C the volume fraction (in place of the colour of eq. 16), with the weights
of the pressure gradient too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from ..domain.row_threads import over_rows
from .interface_rules import capillary_step

if TYPE_CHECKING:
    from ..operators.pair_weights import Operators
    from .interface import Interface
    from .sight import Sight


class SurfaceTension:
    """tension: N/m; method: jump or csf; density: (2,) kg/m3; support, spacing: m; sight: of the fit that the curvature
    comes from, or None where it sees as far as the operators."""

    def __init__(self, tension: float, method: str, density: Sequence[float] | np.ndarray, support: float,
                 spacing: float, sight: Sight | None = None):
        self.tension, self.method, self.density = tension, method, np.asarray(density, float)
        self.support, self.spacing, self.sight = support, spacing, sight

    @property
    def largest_step(self) -> float:
        """`capillary_step` of these fluids, s."""
        return capillary_step(self.density, self.spacing, self.tension)

    def force(self, weighted: Operators, interface: Interface,
              reference: float) -> tuple[np.ndarray, np.ndarray | None]:
        """Acceleration (n, dim), m/s2, and what the Laplacian of the pressure makes of the jump
        (`Terms.laplacian_of_jump`), or None.

        weighted: Operators with pressure weights divided by the density of each pair over `reference`, kg/m3.
        """
        if self.method == "jump":
            across = weighted.lap_p if weighted.walls is None else weighted.walls.symmetric_laplacian
            curvature = weighted.exchange.forward(interface.curvature)
            return _jump(weighted, across, interface, curvature, self.tension / reference)
        gradient = weighted.gradient_p(interface.fraction)
        return (self.tension / reference * interface.curvature)[:, None] * gradient, None  # eq. 24


def _jump(ops: Operators, lap: np.ndarray, interface: Interface, kappa: np.ndarray,
          tension: float) -> tuple[np.ndarray, np.ndarray]:
    """What the weights of the pressure gradient and lap (n_pairs,) make of the jumps of the pressure across the
    interface, (n, dim) and (n,). kappa: (n + remote,)."""
    out, laplacian_of_jump = np.zeros((ops.n, ops.dim)), np.zeros(ops.n)
    pairs, kappas = (ops.column, ops.grad_p, lap), (interface.phi, kappa)
    over_rows(_add_jumps, ops.n, pairs, interface.unlike, kappas, tension, out, laplacian_of_jump)
    return out, laplacian_of_jump


@njit(cache=True, nogil=True, error_model="numpy")
def _add_jumps(rows, pairs, unlike, given, tension, out, laplacian_of_jump):
    (column, grad, lap), (first, pair, fraction), (phi, kappa) = pairs, unlike, given
    last = grad.shape[1] - 1
    for i in range(rows[0], rows[1]):
        scale, own, s0, s1, s2, total = -tension if phi[i] > 0.0 else tension, kappa[i], 0.0, 0.0, 0.0, 0.0
        for q in range(np.uint64(first[i]), np.uint64(first[i + 1])):
            p, t = np.uint64(pair[q]), fraction[q]
            # eqs 14 and 24 as the jump of the pressure that balances the force
            jump = scale * ((1.0 - t) * own + t * kappa[np.uint32(column[p])])
            total += lap[p] * jump
            s0, s1, s2 = s0 + grad[p, 0] * jump, s1 + grad[p, 1] * jump, s2 + grad[p, last] * jump
        laplacian_of_jump[i], out[i, 0], out[i, 1] = total, s0, s1
        if last == 2:
            out[i, 2] = s2
