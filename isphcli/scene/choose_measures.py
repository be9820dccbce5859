"""What is measured of the fluids of a case as it runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..references.two_phase import AMPLITUDES, amplitude
from ..two_phase.measures import MeasuredFluid, Measures

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..flow.one_fluid import Fluids
    from ..geometry.protocol import Geometry


def choose_measures(case: Case, geometry: Geometry, particles: Particles, fluids: Fluids) -> Measures:
    """Measures of a case with two fluids; fluids: OneFluid or TwoFluids."""
    named = [MeasuredFluid(name, case.fluids[name].density, case.fluids[name].mu) for name in case.fluid_names]
    amplitude_of = None
    if case.reference is not None and case.reference.kind in AMPLITUDES:
        def amplitude_of(x: np.ndarray, fraction: np.ndarray) -> float:
            return amplitude(case, x, fraction)
    return Measures(named, particles.phase, geometry, particles.site_volume, fluids.reference, fluids.tension,
                    amplitude_of)
