"""What an interface changes in a step beyond the equations: one function decides, and one table says why.

Two numbers decide. The contrast: whether densities or viscosities differ. The Ohnesorge number of a spacing,
mean(mu) / sqrt(mean(rho) sigma dx): whether viscosity damps roughness of the interface a spacing long.

| rule | with | measured |
|---|---|---|
| `added_viscosity`, ADDED_VISCOSITY times what the viscosity lacks, pairs at the interface | tension, Ohnesorge number below OHNESORGE_MIN | with 1 time a drop of Laplace number 1e6 lost particles after 1000 steps, with 2.5 not after 1500 (support 2.3) |
| `damps_odd_even`, the odd-even part of the pressure is taken out (`flow/projection.py`) | a contrast, or no tension | layers of density ratio 100 grew by 5 % a step without; with it and no contrast the crest of a capillary wave of 16 spacings is 15 % late, without 4 % |
| `rotational_viscosity`, min(rho) min(nu) in the rotational term of eq. 4 | always (of one fluid it is mu) | with min(mu) drops of density ratio 1000 blew up within 0.5 of a period; with this they rest |
| FIRST_PASSES through the equations of the first step | two fluids (one: 3) | with 3, layers of density ratio 1000 moved at 1e-8 sqrt(g H) |

Where the measurements are told: docs/design_notes.md, two fluids and the odd-even part of the pressure.
"""  # noqa: E501

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

OHNESORGE_MIN = 0.04  # Ohnesorge number of a spacing that an interface is given viscosity up to
ADDED_VISCOSITY = 2.5  # of what it lacks
FIRST_PASSES = 5  # through the equations in the first step


@dataclass(frozen=True)
class InterfaceRules:
    """added_viscosity: dynamic, Pa s, on top of that of pairs at the interface; damps_odd_even: whether the
    odd-even part of the pressure is taken out; rotational_viscosity: dynamic, Pa s, of the rotational term (eq. 4)."""

    added_viscosity: float
    damps_odd_even: bool
    rotational_viscosity: float


def interface_rules(density: Sequence[float] | np.ndarray, viscosity: Sequence[float] | np.ndarray,
                    tension: float = 0.0, spacing: float = 0.0) -> InterfaceRules:
    """What an interface needs. density: (2,) kg/m3; viscosity: (2,) dynamic, Pa s; tension: N/m; spacing: m."""
    density, viscosity = np.asarray(density, float), np.asarray(viscosity, float)
    contrast = bool(np.ptp(density) or np.ptp(viscosity))
    rotational = float(density.min()) * float((viscosity / density).min())
    if not tension > 0.0:
        return InterfaceRules(0.0, True, rotational)
    unit = math.sqrt(np.mean(density) * tension * spacing)
    ohnesorge = float(np.mean(viscosity)) / unit
    added = ADDED_VISCOSITY * max(OHNESORGE_MIN - ohnesorge, 0.0) * unit
    return InterfaceRules(added, contrast, rotational)
