"""The result of a run, for the comparison with its reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry


@dataclass(kw_only=True)
class Result:
    """The flow at the end of a run, in SI units or those of the case; of a steady solve at its finest spacing. Arrays
    of particles are those of this process alone.

    x: (n, dim) positions of the fluid particles, m; velocity: (n, dim) m/s; cell_velocity: (n, dim) its mean over their
    cells of the lattice, m/s, that of the particles where they move or walls cut cells; pressure: (n,) Pa; phase: (n,)
    int8 index of the fluid in case order; spacing: m; time: s, None of a steady solve; geometry: where fluid and walls
    are; history: a dict a step, or a solve (docs/output.md).
    permeability: m2 along the drive, {axis: m2} of several, (dim, dim) m2 or None where there is none; tensor:
    (dim, dim) m2, or None; two_fluids: what is measured of two fluids at the end, by the names of summary.json; the
    last row of the history need not have all of it, as some is measured every few steps only.
    """

    x: np.ndarray
    velocity: np.ndarray
    cell_velocity: np.ndarray
    pressure: np.ndarray
    phase: np.ndarray
    spacing: float
    time: float | None
    geometry: Geometry
    history: Sequence[Mapping[str, Any]]
    permeability: float | Mapping[str, float] | np.ndarray | None = None
    tensor: np.ndarray | None = None
    two_fluids: Mapping[str, Any] = field(default_factory=dict)
