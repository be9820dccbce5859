"""Errors of a result against the reference that its case names.

`compare(case, result)` takes the `Result` of a run. What a reference needs and the case itself does not say stands in
`reference.parameters`, see `PARAMETERS`. Flows of one fluid are compared in single_phase.py, those of two in
two_phase.py; what the errors are is in errors.py.
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
    unknown = set(reference.parameters) - set(PARAMETERS[reference.kind])
    if unknown:
        known = ", ".join(PARAMETERS[reference.kind]) or "none"
        name = min(unknown)
        raise CompareError(f"reference.parameters.{name}: kind {reference.kind} does not know it; it knows {known}")
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
_PLATES = {
    "lower": "y of the lower plate, m; without it the lower face of the box",
    "height": "distance of the plates, m; without it that to the upper face",
}
_LID = {"wall_velocity": "speed of the upper plate, m/s; without it that of the face y_max"}
_NU = {"nu": "kinematic viscosity, m2/s; without it that of the first fluid"}
_PUSH = {"acceleration": "along x, m/s2; without it that of the drive"}
_OSCILLATION = {
    **_NU,
    "acceleration": "amplitude a of the force over its density, a cos(omega t), m/s2, needed",
    "omega": "its angular frequency, rad/s, needed",
    "start": "rest, or periodic where the flow begins as it goes on; without it rest",
}
_CELL = {
    "fraction": "solid fraction, needed",
    "cell": "edge of a cell, m; without it that of the box along x",
}
_VORTEX = {"speed": "largest speed at the start, m/s, needed", "k": "wave number, 1/m; without it 2 pi / box"}
_LAYERS = {**_PLATES, "interface": "its height over the lower plate, m; without it by the particles of each fluid"}
_DROP = {"drop": "name of its fluid; without it that of which there is less"}
_TENSION = {"tension": "surface tension, N/m; without it that of the interface"}
_RADIUS = {"radius": "of the drop at rest, m; without it by its area or volume"}
# What `reference.parameters` of each kind may hold
PARAMETERS: dict[str, dict[str, str]] = {
    "slit": {**_PLATES, **_NU, **_PUSH},
    "couette": {**_PLATES, **_LID},
    "poiseuille": {**_PLATES, **_NU, **_PUSH},
    "startup_couette": {**_PLATES, **_LID, **_NU},
    "startup_poiseuille": {**_PLATES, **_NU, **_PUSH},
    "oscillating_slit": {**_PLATES, **_OSCILLATION},
    "oscillating_pipe": _OSCILLATION,
    "decaying_channel": {
        **_PLATES, **_NU,
        "speed": "largest speed at the start, m/s, needed",
        "mode": "half waves between the plates; without it 1",
    },
    "taylor_couette": {},
    "annulus": {},
    "square_duct": {
        "side": "width of the duct, m; without it that of the box",
        "y": "lower corner of the duct, m; without it that of the box",
        "z": "the same along z",
    },
    "sphere_array": _CELL,
    "cylinder_array": _CELL,
    "taylor_green": {**_VORTEX, **_NU},
    "taylor_green_3d": {**_VORTEX, **_NU},
    "lid_driven_cavity": {**_LID, **_NU},
    "permeability": {},
    "flow_split": {},
    "two_layer_couette": {**_LAYERS, **_LID},
    "two_layer_poiseuille": _LAYERS,
    "two_layer_hydrostatics": _LAYERS,
    "static_drop": {**_DROP, **_TENSION, **_RADIUS},
    "contact_angle": {
        **_DROP,
        "angle": "degrees, through the drop; without it that of the interface",
        "wall": "face of the box that the drop sits on: y_min, ...; without it y_min",
        "at": "coordinate of that wall along its normal, m; without it that of the face",
        "tilt": "degrees by which the wall is turned from y_min, counter-clockwise; needs `at`; without it 0",
    },
    "capillary_wave": {
        **_TENSION,
        "wavelength": "m; without it the box along x",
        "amplitude": "height of the crest at t = 0, m; without it 0",
        "speed": "upward velocity of the crest at t = 0, m/s; without it 0",
    },
    "oscillating_drop": {
        **_DROP, **_TENSION, **_RADIUS,
        "mode": "number of waves round the drop; without it 2",
        "wall_radius": "of a round wall about the drop, m; without it there is none",
        "from": "time from which the oscillation is fitted, s; without it half a period",
    },
    "imbibition": {
        **_TENSION,
        "drop": "name of the fluid that fills the slit; without it the first",
        "angle": "contact angle through the first fluid, degrees; without it that of the interface",
        "width": "of the slit, m, needed",
        "length": "of the slit along x, m, needed",
        "start": "way of the interface past the entrance at t = 0, m, needed",
    },
    "rising_bubble": _DROP,
}  # fmt: skip
