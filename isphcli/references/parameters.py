"""The keys of `reference.parameters` for each kind of reference. This file imports nothing, because the check of a case
uses it."""

from __future__ import annotations

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
# {kind: {name of a parameter: its meaning}}
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
        "wall": "face of the box that the drop sits on: y_min, ...; without it y_min, where the scene repeats along y "
        "the lower face of the last axis along which it does not",
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
# Kinds that are of two fluids
OF_TWO_FLUIDS = ("two_layer_couette", "two_layer_poiseuille", "two_layer_hydrostatics", "static_drop", "contact_angle",
                 "capillary_wave", "oscillating_drop", "imbibition", "rising_bubble")  # fmt: skip


def needed(kind: str) -> list[str]:
    """Names of the parameters that a kind requires."""
    return [name for name, text in PARAMETERS[kind].items() if text.endswith(", needed")]


def words(kind: str, name: str, fluids: tuple[str, ...], faces: tuple[str, ...]) -> tuple[str, ...] | None:
    """The words that a parameter may be, of the fluids and the faces of a case; None for one that is a number."""
    if name == "start" and kind.startswith("oscillating_"):
        return "rest", "periodic"
    return {"drop": fluids, "wall": faces}.get(name)
