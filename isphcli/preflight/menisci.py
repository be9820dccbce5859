"""Whether a flow is faster than the spurious currents of menisci at rest in pores of its width."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..case import forcing

if TYPE_CHECKING:
    from .check_result import CheckResult

# Spacings across a tube, and capillary number of the root mean square speed of a slug in it that should be at rest, by
# the larger viscosity (benchmarks/menisci_in_pores.py 3 4 6 8; smooth tubes). Beyond, the last slope.
ACROSS = np.log([3.0, 4.0, 6.0, 8.0])
AT_REST = np.log([1.1e-3, 7.4e-4, 1.2e-4, 3.5e-5])
SHARE = 0.1  # of the mean velocity in the pores that speeds at rest may have for velocities to mean something


def menisci_findings(result: CheckResult) -> Iterator[str]:
    """A held flux whose velocity is less than ten times that of the spurious currents of menisci."""
    case, widths, held = result.case, result.throats, forcing.held_flux(result.case)
    if widths is None or held is None or case.interface is None or not case.interface.tension > 0.0:
        return
    # between the narrowest tenth and the median: of the corner of Berea in cases/berea_drainage.yaml it makes the
    # 5e-3 m/s that were measured there
    across = math.sqrt(widths.narrow * widths.median)
    number = math.exp(_at_rest(math.log(across)))
    speed = number * case.interface.tension / max(fluid.mu for fluid in case.fluids.values())
    mean = abs(held[1]) / (result.connectivity.porosity if result.connectivity is not None else 1.0)
    if mean > 0.0 and speed > SHARE * mean:
        yield (
            f"menisci in pores {across:.1f} particles wide move by about {speed:.1g} m/s when they should be "
            f"at rest (capillary number {number:.0e}), and the drive moves the fluids by {mean:.2g} m/s: velocities "
            "near them are noise, saturations and the pressure drop are not; refine where velocities matter"
        )


def _at_rest(across: float) -> float:
    """Logarithm of the capillary number at rest, by that of the spacings across."""
    if across <= ACROSS[-1]:
        return float(np.interp(across, ACROSS, AT_REST))
    slope = (AT_REST[-1] - AT_REST[-2]) / (ACROSS[-1] - ACROSS[-2])
    return float(AT_REST[-1] + slope * (across - ACROSS[-1]))
