"""The objects that measure the fluids of a case during its run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..case.forcing import flow_axis, pressure_gradient
from ..references.two_phase import AMPLITUDES, amplitude
from ..two_phase.measures import MeasuredFluid, Measures
from .place import lattice_at

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..flow.held_velocity import HeldVelocity
    from ..flow.one_fluid import Fluids
    from ..flow.state import State
    from ..geometry.protocol import Geometry
    from ..two_phase.profiles import Profiles
    from ..two_phase.reservoir_measures import ReservoirMeasures


def choose_measures(case: Case, geometry: Geometry, particles: Particles, fluids: Fluids,
                    held: HeldVelocity | None = None) -> Measures:
    """Measures of a case with two fluids; fluids: OneFluid or TwoFluids; held: the flux that is held, or None."""
    named = [MeasuredFluid(name, case.fluids[name].density, case.fluids[name].mu) for name in case.fluid_names]
    amplitude_of = None
    if case.reference is not None and case.reference.kind in AMPLITUDES:
        def amplitude_of(x: np.ndarray, volume: np.ndarray, fraction: np.ndarray) -> float:
            return amplitude(case, x, volume, fraction)
    size = particles.site_volume, _extents(case, geometry)
    return Measures(named, particles.phase, geometry, size, fluids, held, amplitude_of)


def choose_profiles(case: Case, geometry: Geometry, fluids: Fluids) -> Profiles | None:
    """Profiles along the axis of the reservoirs or of the drive; None of a case without both."""
    axis = flow_axis(case)
    if axis is None:
        return None
    from ..two_phase.profiles import Profiles

    return Profiles(axis, case.fluid_names, geometry, case.particles.spacing, float(_extents(case, geometry)[axis]),
                    _pressure(case, geometry, fluids, axis))


def choose_reservoir_measures(case: Case, geometry: Geometry, particles: Particles,
                              fluids: Fluids) -> ReservoirMeasures | None:
    """The measures between the reservoirs of a case, or None."""
    if case.reservoirs is None:
        return None
    from ..two_phase.reservoir_measures import ReservoirMeasures

    axis = "xyz".index(case.reservoirs.axis)
    ends = case.fluid_names.index(case.reservoirs.inlet), case.fluid_names.index(case.reservoirs.outlet)
    return ReservoirMeasures(axis, ends, case.fluid_names, geometry, particles.site_volume,
                             _extents(case, geometry), _pressure(case, geometry, fluids, axis))


def _extents(case: Case, geometry: Geometry) -> np.ndarray:
    """(dim,) m, of the particles (`geometry.extents`), those of their lattice at the start."""
    return lattice_at(case, geometry, case.particles.spacing).thick


def _pressure(case: Case, geometry: Geometry, fluids: Fluids, axis: int) -> Callable[[State], np.ndarray]:
    """A function that gives the pressure (n,), Pa, of the particles of a state, with what falls along the axis: the
    state itself holds the part that repeats from box to box."""
    lengths, lower = geometry.upper - geometry.lower, geometry.lower[axis]

    def pressure(state: State) -> np.ndarray:
        fall = float(pressure_gradient(case, lengths, state.time)[axis])
        fall += fluids.reference * (state.pressure_gradient or 0.0)
        return fluids.reference * state.p - fall * (state.x[:, axis] - lower)

    return pressure
