"""What an interface changes in a step beyond the equations: one function decides, and one table says why.

| rule | with | measured |
|---|---|---|
| `rotational_viscosity`, min(rho) min(nu) in the rotational term of eq. 4 | always (of one fluid it is mu) | with min(mu) drops of density ratio 1000 blew up within 0.5 of a period; with this they rest |
| `added_viscosity`, what the viscosity lacks to OHNESORGE_MIN, pairs at the interface | tension, Ohnesorge number of a spacing below OHNESORGE_MIN | of Laplace number 1e6, 16 across, four capillary steps, a drop at rest shook itself apart after t = 12 without |
| FIRST_PASSES through the equations of the first step | two fluids (one: 3) | with 3, layers of density ratio 1000 moved at 1e-8 sqrt(g H) |

The Ohnesorge number of a spacing, mean(mu) / sqrt(mean(rho) sigma dx), says whether viscosity damps waves a spacing long
while they turn over once. Where the measurements are told: docs/design_notes.md, two fluids.
"""  # noqa: E501

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

OHNESORGE_MIN = 0.04  # Ohnesorge number of a spacing that an interface is given viscosity up to
FIRST_PASSES = 5  # through the equations in the first step


@dataclass(frozen=True)
class InterfaceRules:
    """added_viscosity: dynamic, Pa s, on top of that of pairs at the interface; rotational_viscosity: dynamic, Pa s, of
    the rotational term (eq. 4)."""

    added_viscosity: float
    rotational_viscosity: float


def interface_rules(density: Sequence[float] | np.ndarray, viscosity: Sequence[float] | np.ndarray,
                    tension: float = 0.0, spacing: float = 0.0) -> InterfaceRules:
    """What an interface needs. density: (2,) kg/m3; viscosity: (2,) dynamic, Pa s; tension: N/m; spacing: m."""
    density, viscosity = np.asarray(density, float), np.asarray(viscosity, float)
    rotational = float(density.min()) * float((viscosity / density).min())
    if not tension > 0.0:
        return InterfaceRules(0.0, rotational)
    unit = math.sqrt(np.mean(density) * tension * spacing)
    return InterfaceRules(max(OHNESORGE_MIN * unit - float(np.mean(viscosity)), 0.0), rotational)


def lacking_viscosity(density: Sequence[float] | np.ndarray, viscosity: Sequence[float] | np.ndarray) -> float:
    """Kinematic viscosity, m2/s, that the rotational term lacks in the fluid of least dynamic viscosity, the lighter
    of two: 0 of fluids of one density, and where that fluid has the least kinematic viscosity too. Arguments as
    those of `interface_rules`."""
    density, viscosity = np.asarray(density, float), np.asarray(viscosity, float)
    least, its_density = min(zip(viscosity.tolist(), density.tolist()))
    lacking = least - interface_rules(density, viscosity).rotational_viscosity
    if lacking <= 1e-9 * least:  # round-off
        return 0.0
    return lacking / its_density


def capillary_step(density: Sequence[float] | np.ndarray, spacing: float, tension: float) -> float:
    """sqrt(rho dx^3 / (2 pi sigma)), rho the mean density, s: the limit of Brackbill, Kothe and Zemach (1992).
    density: (2,) kg/m3; spacing: m; tension: N/m."""
    return math.sqrt(float(np.mean(density)) * spacing**3 / (2.0 * math.pi * tension))
