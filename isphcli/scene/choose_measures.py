"""What is measured of the fluids of a case as it runs."""

from __future__ import annotations

from ..references import compare
from ..two_phase.measures import Measures


def choose_measures(case, geometry, particles, fluids):
    """Measures of a case with two fluids; fluids: OneFluid or TwoFluids."""
    named = [case.fluids[name] for name in case.fluid_names]
    amplitude = None
    if case.reference is not None and case.reference.kind in compare.AMPLITUDES:
        def amplitude(x):
            return compare.amplitude(case, x, particles.phase)
    return Measures(case.fluid_names, particles.phase, [f.density for f in named], [f.mu for f in named], geometry,
                    particles.site_volume, fluids.reference, fluids.tension, amplitude)
