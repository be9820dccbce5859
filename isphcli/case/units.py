"""Numbers with units in a case: `2.25 um`, `1 cP`, `30 mN/m`, converted by pint to the unit of their key."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pint

NUMBER = r"[-+]?(?:[0-9][0-9_]*(?:\.[0-9_]*)?|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?"
UNIT = r"[A-Za-z\u00b5\u03bc\u00b0][A-Za-z0-9_\u00b5\u03bc\u00b0\u00b2\u00b3*/^ ().\u00b7-]{0,39}"
QUANTITY = re.compile(rf"({NUMBER})\s*(?![eE][-+]?[0-9])({UNIT})")
EXACT = 1e-12  # relative: nearer to a power of ten a factor is that power, and 2.25 um is the number 2.25e-6


class UnitError(ValueError):
    """A unit that is not known, or has another dimension than the key."""


@cache
def _registry() -> pint.UnitRegistry:
    import pint

    return pint.UnitRegistry()


def is_quantity(text: str) -> bool:
    """Whether a text is a number and, behind it, what may be a unit."""
    return QUANTITY.fullmatch(text.strip()) is not None


def number_in(text: str, unit: str) -> float:
    """The number that a text like '2.25 um' is in another unit, or a bare number as it is.

    Raises UnitError where the unit is not known or has another dimension, ValueError where there is no number.
    """
    found = QUANTITY.fullmatch(text.strip())
    if found is None:
        return float(text)
    number, given = found.groups()
    factor = _factor(given.strip(), unit)
    power = round(math.log10(factor))
    if abs(factor / 10.0**power - 1.0) < EXACT:
        return float(Decimal(number.replace("_", "")).scaleb(power))
    return float(number) * factor


@cache
def _factor(given: str, unit: str) -> float:
    """The factor from one unit to another."""
    import pint

    try:
        source = _parsed(given)
    except Exception:  # pint raises many kinds of errors for text that is no unit
        raise UnitError(f"the unit '{given}' is not known") from None
    target = _parsed(unit)
    if unit == "rad/s" and not re.search("radian|degree|turn|revolution", str(source)):
        raise UnitError(f"'{given}' leaves open whether turns or radians are counted; give rad/s or rpm")
    try:
        factor = float(_registry().Quantity(1.0, source).to(target).magnitude)
    except pint.DimensionalityError:
        raise UnitError(f"'{given}' is a unit of {_dimension(source)}, and not of {_dimension(target)}") from None
    except Exception:  # offsets of temperatures, overflow
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise UnitError(f"the unit '{given}' cannot be converted to {unit}")
    return factor


def _parsed(text: str) -> pint.Unit:
    """A unit as people write it: m2 and m^2 are squares, a dot or blank is a product."""
    text = re.sub(r"(?<=[A-Za-z\u00b5\u03bc])(-?\d)", r"**\1", text.replace("\u00b7", "*").replace("^", "**"))
    return _registry().parse_units(text)


KINDS = {  # units of our keys
    "m": "length", "m/s": "velocity", "m/s2": "acceleration", "kg/m3": "density", "Pa s": "dynamic viscosity",
    "m2/s": "kinematic viscosity", "N/m": "surface tension", "Pa": "pressure", "s": "time", "rad/s": "rotation",
    "degrees": "angle", "m2": "area or permeability", "kg": "mass",
}  # fmt: skip


def _dimension(unit: pint.Unit) -> str:
    for known, name in KINDS.items():
        if _parsed(known).dimensionality == unit.dimensionality:
            return name
    return str(unit.dimensionality).replace("**", "^").replace("[", "").replace("]", "")
