"""What is measured of the fluids of a case as it runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..references import compare
from ..two_phase.measures import MeasuredFluid, Measures

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..flow.one_fluid import Fluids
    from ..geometry.protocol import Geometry


def choose_measures(case: Case, geometry: Geometry, particles: Particles, fluids: Fluids) -> Measures:
    """Measures of a case with two fluids; fluids: OneFluid or TwoFluids."""
    named = [MeasuredFluid(name, case.fluids[name].density, case.fluids[name].mu) for name in case.fluid_names]
    amplitude = None
    if case.reference is not None and case.reference.kind in compare.AMPLITUDES:
        def amplitude(x: np.ndarray) -> float:
            return compare.amplitude(case, x, particles.phase)
    return Measures(named, particles.phase, geometry, particles.site_volume, fluids.reference, fluids.tension,
                    amplitude)
