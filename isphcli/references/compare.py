"""Errors of a result against the reference that its case names.

`compare(case, result)` takes the `Result` of a run. Values that a reference needs and no other key has are in
`reference.parameters` (parameters.py). Flows of one fluid are compared in single_phase.py, those of two in
two_phase.py; errors.py defines the errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from . import single_phase, two_phase
from .arrays import cylinder_array_permeability, sphere_array_permeability
from .errors import CompareError, Errors, OtherSampleError
from .sample import other_geometry

if TYPE_CHECKING:
    from ..case.blocks import Case
    from .result import Result


def compare(case: Case, result: Result) -> Errors:
    """Errors by name; `main` is the name of the one that `reference.tolerance` bounds.

    Raises CompareError; OtherSampleError where the reference is of another body than that of the case.
    """
    reference = case.reference
    if reference is None:
        raise CompareError("the case names no reference; add a block reference with its kind")
    other = other_geometry(case)
    if other is not None:
        raise OtherSampleError(other)
    errors = COMPARISONS[reference.kind](case, result)
    for name, value in errors.items():
        if name != "main" and not math.isfinite(value):
            raise CompareError(f"the error {name} is {value}: the result or the reference is not finite")
    return errors


COMPARISONS: dict[str, Callable[[Case, Result], Errors]] = {
    "slit": single_phase.slit_errors,
    "couette": single_phase.field_errors,
    "poiseuille": single_phase.field_errors,
    "startup_couette": single_phase.field_errors,
    "startup_poiseuille": single_phase.field_errors,
    "oscillating_slit": single_phase.oscillating_slit_errors,
    "oscillating_pipe": single_phase.oscillating_pipe_errors,
    "decaying_channel": single_phase.field_errors,
    "taylor_couette": single_phase.field_errors,
    "annulus": single_phase.annulus_errors,
    "square_duct": single_phase.square_duct_errors,
    "sphere_array": single_phase.array_errors(sphere_array_permeability),
    "cylinder_array": single_phase.array_errors(cylinder_array_permeability),
    "taylor_green": single_phase.taylor_green_errors,
    "taylor_green_3d": single_phase.taylor_green_3d_errors,
    "lid_driven_cavity": single_phase.lid_driven_cavity_errors,
    "permeability": single_phase.published_permeability_errors,
    "flow_split": single_phase.flow_split_errors,
    "two_layer_couette": two_phase.two_layer_couette_errors,
    "two_layer_poiseuille": two_phase.two_layer_poiseuille_errors,
    "two_layer_hydrostatics": two_phase.two_layer_hydrostatics_errors,
    "static_drop": two_phase.static_drop_errors,
    "contact_angle": two_phase.contact_angle_errors,
    "capillary_wave": two_phase.capillary_wave_errors,
    "oscillating_drop": two_phase.oscillating_drop_errors,
    "imbibition": two_phase.imbibition_errors,
    "rising_bubble": two_phase.rising_bubble_errors,
}
