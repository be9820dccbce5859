"""Names and values of a run for the terminal, Python and reports, from the summary."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..case.blocks import Case

MILLIDARCY = 9.869233e-16  # m2
DIGITS = 3  # significant digits of a result whose error is unknown: beside walls it is hardly less than 1 %


def closing_lines(case: Case, summary: Mapping[str, Any], directory: Path | None) -> str:
    """The lines that are printed at the end of a run; directory: of its files, if they were kept."""
    lines = [*scene_lines(summary), *permeability_lines(summary)]
    if summary.get("permeability") is None:
        part = case.geometry.voxels or case.geometry.clear_layer or case.reservoirs
        lines += velocity_lines(summary, bool(part))
    lines += [*measure_lines(summary), *drop_lines(summary), *two_fluid_lines(case.fluids, summary)]
    if case.flow == "stokes" and summary.get("mass_error") is not None:
        lines += [("mass error", f"{summary['mass_error']:.1e} between slices across the flow")]
    lines += [("warning", text) for text in summary.get("warnings") or ()]
    lines += [*reference_lines(case, summary), *time_lines(summary)]
    if directory is not None:
        lines += [("results", str(directory))]
        lines += [("picture", str(path)) for path in sorted(directory.glob("*.png"))]
        lines += [("report", str(path)) for path in directory.glob("report.html")]
    if summary.get("message"):
        lines += [("note", str(summary["message"]))]
    return table(lines)


def scene_lines(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The scene of a run: the image, its porosity, the axes along which fluid can flow through, the throats."""
    throats = summary.get("throats")
    lines = [tuple(text.split(": ", 1)) for text in summary.get("inputs") or ()]
    if summary.get("porosity") is not None:
        lines += [("porosity", f"{100 * summary['porosity']:.{DIGITS}g} % (cells that walls cut with their part)")]
    for name, share in (summary.get("microporous") or {}).items():
        lines += [("microporous", f"{name} {100 * share:.{DIGITS}g} %")]
    if summary.get("open_axes") is not None:
        lines += [("open axes", ", ".join(summary["open_axes"]) or "none: nothing flows through the scene")]
    if throats:
        lines += [("throats", f"median {throats['median']:.1f} particles wide, 10 % of the fluid in pores below "
                              f"{throats['narrow']:.1f}")]
    return lines


def permeability_lines(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Permeability, m2 and mD: one number, one per axis, or the tensor; as many digits as the error bar allows."""
    bars = dict(per_axis(summary.get("permeability_error")))
    given = summary.get("permeability_range")
    ranges: dict[str, Any] = {"": given} if given else {}
    if isinstance(given, Mapping):
        ranges = {f" {axis}": ends for axis, ends in given.items()}
    lines = []
    for axis, k in per_axis(summary.get("permeability")):
        bar = bars.get(axis)
        lines.append((f"permeability{axis}", permeability(k, digits_within(k, bar))))
        if bar is not None:
            lines.append((f"  +-{axis}", permeability(bar, 2)))
        if axis in ranges:
            lines.append((f"  range{axis}", between(*ranges[axis])))
    if summary.get("permeability_range_from"):
        lines.append(("  range from", summary["permeability_range_from"]))
    lines += threshold_lines(summary.get("permeability_by_threshold"))
    tensor = summary.get("permeability_tensor")
    if tensor is not None:
        heads = ["tensor, m2"] + [""] * (len(tensor) - 1)
        lines += [(head, " ".join(f"{k:10.{DIGITS - 1}e}" for k in row)) for head, row in zip(heads, tensor)]
    return lines


def between(low: float, high: float) -> str:
    """'1.2e-12 to 1.4e-12 m2': with two digits of the width, DIGITS at least and 6 at most."""
    digits = max(DIGITS, min(digits_within(high, high - low) + 1, 6))
    ends = [f"{k:.{digits - 1}e}" for k in (low, high)]
    return f"{ends[0]} m2, to {digits} digits" if ends[0] == ends[1] else f"{ends[0]} to {ends[1]} m2"


def threshold_lines(known: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """The range of the permeability along each axis by the uncertainty of the threshold of a grey image."""
    if known is None:
        return []
    lower, own, upper = known["thresholds"]
    lines = []
    for axis, (low, k, high) in known["permeability"].items():
        change = " and ".join(f"{100 * (other / k - 1):+.2g} %" for other in (low, high))
        lines.append((f"  threshold {axis}", f"{change} at {lower:g}, {upper:g} in place of {own:g}"))
    return lines


def digits_within(value: float, error: float | None) -> int:
    """Significant digits down to the first one of the error; DIGITS where it is not known."""
    if not error or not value:
        return DIGITS
    return min(max(math.floor(math.log10(abs(value))) - math.floor(math.log10(error)) + 1, 1), 6)


def velocity_lines(summary: Mapping[str, Any], is_part: bool = False) -> list[tuple[str, str]]:
    """Mean velocity in the pores and superficial velocity of the sample along each axis, m/s; is_part: the sample may
    be a part of the box, between clear layers or reservoirs, over all of which history.csv has both."""
    lines = []
    for key, name in (("mean_velocity", "mean pore velocity"), ("superficial_velocity", "superficial velocity")):
        values = [v for _, v in per_axis(None if summary.get(key) is None else list(summary[key]))]
        if values:
            least = 10.0**-DIGITS * max(abs(v) for v in values)  # smaller components are errors of the largest
            shown = (f"{a} {v if abs(v) >= least else 0:.{DIGITS}g}" for a, v in zip("xyz", values))
            lines.append((name, ", ".join(shown) + " m/s" + " in the sample" * is_part))
    return lines


def measure_lines(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Tortuosity, formation factor, and the shear at the walls of a steady flow."""
    lines = []
    for key, more in (("tortuosity", "mean speed over mean velocity along the axis"),
                      ("formation_factor", "resistance over that of the fluid alone")):
        bars = dict(per_axis(summary.get(f"{key}_error")))
        for axis, value in per_axis(summary.get(key)):
            digits = digits_within(value, bars.get(axis))
            lines.append((f"{key.replace('_', ' ')}{axis}", f"{value:.{digits}g} ({more})"))
            if axis in bars:
                lines.append((f"  +-{axis}", f"{bars[axis]:.2g}"))
    shear = summary.get("wall_shear")
    if shear is not None:
        lines.append(("wall shear", f"mean {shear['mean']:.{DIGITS}g} Pa, 95 % below {shear['q95']:.{DIGITS}g} Pa"))
    return lines


def drop_lines(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The pressure drop of a run that finds its own."""
    drop, mean = summary.get("pressure_drop"), summary.get("pressure_drop_mean")
    if drop is None:
        return []
    if mean is None:
        return [("pressure drop", f"{drop:.4g} Pa over the box, of the last step")]
    found, scatter = with_error(mean, summary["pressure_drop_error"]), summary["pressure_drop_scatter"]
    return [("pressure drop", f"{found} Pa over the box, mean over the last quarter of the time; single steps are "
                              f"{scatter:.2g} Pa off it (root mean square)")]


def with_error(value: float, error: float) -> str:
    """'9060 +- 120': a mean and its standard error, with two digits of that, six of the mean at most."""
    digits = max(min(digits_within(value, error) + 1, 6), 2)
    return f"{float(f'{value:.{digits - 1}e}'):g} +- {float(f'{error:.1e}'):g}"


def two_fluid_lines(names: Iterable[str], summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Saturation, pressure jump and contact angle at the end of a run with two fluids; between reservoirs what is
    trapped too. names: of the fluids."""
    names = list(names)
    found = summary.get("two_fluids") or {}
    lines = [(f"saturation {name}", found.get(f"saturation_{name}"), "") for name in names]
    lines += [(f"  trapped {name}", found.get(f"trapped_{name}"), " of the fluid in the sample") for name in names]
    lines += [("  closed pockets", found.get("closed_pockets") or None,
               " of the fluid in the sample: no flow passes through them")]
    lines += [("capillary pressure", found.get("capillary_pressure"),
               " Pa between the fluids of inlet and outlet, what viscous flow takes included")]
    lines += [("  in the mean", found.get("capillary_pressure_mean"),
               f" +- {found.get('capillary_pressure_error') or 0.0:.2g} Pa over the last quarter of the time")]
    lines += [("pressure jump", found.get("pressure_jump"), f" Pa at the interface, {' less '.join(names)}")]
    lines += [("contact angle", found.get("contact_angle"), f" degrees through {next(iter(names), '')}")]
    return [(head, f"{value:.4g}{unit}") for head, value, unit in lines if value is not None]


def per_axis(value: Any) -> list[tuple[str, float]]:
    """(' x', value) of each axis; ('', value) of a single number; values that are None left out."""
    if value is None:
        return []
    if isinstance(value, Mapping):
        return [(f" {axis}", k) for axis, k in value.items() if k is not None]
    if isinstance(value, (list, tuple)):
        return [(f" {axis}", k) for axis, k in zip("xyz", value) if k is not None]
    return [("", value)]


def permeability(k: float, digits: int = DIGITS) -> str:
    """1.23e-12 m2 = 1250 mD."""
    if not k:
        return "0 m2 = 0 mD"
    return f"{k:.{digits - 1}e} m2 = {float(f'{k / MILLIDARCY:.{digits}g}'):g} mD"


def reference_lines(case: Case, summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The published value, and the errors that the run found against the reference."""
    reference = case.reference
    if reference is None:
        return []
    if summary.get("not_compared"):
        return [("reference", f"not compared: {summary['not_compared']}")]
    lines = []
    is_permeability = reference.kind == "permeability"
    for axis, value in per_axis(reference.value):
        shown = f"{value:g} m2 = {value / MILLIDARCY:.4g} mD" if is_permeability else f"{value:.6g}"
        lines.append((f"published{axis}", shown))
    if reference.source:
        lines.append(("  source", reference.source))
    errors = dict(summary.get("errors") or {})
    main = errors.pop("main", None)
    for name, error in errors.items():
        bound = reference.tolerance if name == main or len(errors) == 1 else None
        lines.append((f"error {name}", shown_error(name, error, bound)))
    if is_permeability and not errors:
        published = per_axis(reference.value)
        for axis, k in per_axis(summary.get("permeability")):
            expected = published[0][1] if len(published) == 1 else dict(published).get(axis)
            if expected:
                lines.append((f"error{axis}", shown_error("", k / expected - 1, reference.tolerance)))
    return lines


def shown_error(name: str, error: Any, tolerance: float | None) -> str:
    """A relative error in per cent, and the bound on it, and whether it is outside."""
    if not isinstance(error, (int, float)):
        return str(error)
    if name.endswith("capillary_number"):  # a capillary number at rest is no relative error
        return f"{error:.2g}"
    outside = ", not met" if tolerance and abs(error) > tolerance else ""
    return f"{100 * error:+.3g} %" + (f" (bound {100 * tolerance:.3g} %{outside})" if tolerance else "")


def time_lines(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """CPU and wall seconds, and their split."""
    lines = []
    for name, key in (("wall", "wall_seconds"), ("cpu", "cpu_seconds")):
        split = summary.get(key)
        if isinstance(split, Mapping):
            parts = ", ".join(
                f"{part} {s:.2f}" for part, s in split.items() if part != "total" and s >= 0.005
            )
            total = split.get("total", sum(split.values()))
            lines.append((f"{name} time", f"{total:.2f} s" + (f" ({parts})" if parts else "")))
        elif split is not None:
            lines.append((f"{name} time", f"{split:.2f} s"))
    return lines


def table(lines: Iterable[tuple[str, str]]) -> str:
    """Names and values in two columns."""
    lines = list(lines)
    width = max((len(name) for name, _ in lines), default=0)
    return "\n".join(f"{name:{width}}  {value}".rstrip() for name, value in lines)
