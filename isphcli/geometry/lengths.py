"""Names of units of length, as headers of images and of tables of spheres write them."""

from __future__ import annotations

LENGTHS = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "cm": 1e-2, "mm": 1e-3, "millimeter": 1e-3,
    "millimeters": 1e-3, "millimetre": 1e-3, "millimetres": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6,
    "micron": 1e-6, "microns": 1e-6, "micrometer": 1e-6, "micrometers": 1e-6, "micrometre": 1e-6, "micrometres": 1e-6,
    "nm": 1e-9, "nanometer": 1e-9, "nanometers": 1e-9, "nanometre": 1e-9, "nanometres": 1e-9,
}  # fmt: skip


def metres(unit: str | None) -> float | None:
    """Metres of a unit of length, or None where its name is not known."""
    return None if unit is None else LENGTHS.get(unit.strip().strip("\"'").replace("\\u00B5", "\u00b5").lower())
