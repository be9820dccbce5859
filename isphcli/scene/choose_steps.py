"""The limits of the time steps of a case, for the run and for the check before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..flow.step_lengths import LACKING, VISCOUS, StepLengths

if TYPE_CHECKING:
    from ..case.blocks import Case


def step_lengths(case: Case, nu_min: float, capillary_step: float | None, walls: bool,
                 lacking: float = 0.0) -> StepLengths:
    """StepLengths of a case of moving particles. nu_min: of the fluids that are there, m2/s; capillary_step: the limit
    of their tension, s, or None; walls: whether there are any; lacking: kinematic viscosity that the rotational term
    lacks, m2/s. Beside tension that bounds no step: the capillary limit is shorter but in gases as viscous as liquids,
    which drops at rest are tested with."""
    time, spacing = case.time, case.particles.spacing
    assert time is not None
    return StepLengths(
        fixed=time.step, reach=time.cfl * spacing, viscous=VISCOUS * spacing**2 / nu_min,
        steady=time.steady is not None, capillary=None if capillary_step is None else time.capillary * capillary_step,
        walls=walls, pressure=LACKING * spacing**2 / lacking if lacking > 0.0 and capillary_step is None else None,
    )
