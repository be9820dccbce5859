"""Comparisons of flows of two fluids: layers, drops, waves, a bubble; and the amplitude that a run writes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import trapezoid
from scipy.optimize import brentq, least_squares

from ..case import forcing
from ..domain import reduce
from .drops import Layer, capillary_wave, drop_on_wall, drop_oscillation, drop_radius, laplace_jump
from .errors import (
    AXES,
    Array,
    CompareError,
    Errors,
    TooShortError,
    along_x,
    at_end,
    box_of,
    column,
    lid_speed,
    number,
    parameter,
    plates,
    pressure_error,
    times,
    velocity_errors,
)
from .plates import (
    SlitBetweenReservoirs,
    slit_imbibition,
    two_layer_couette,
    two_layer_hydrostatics,
    two_layer_poiseuille,
)
from .published import RISING_BUBBLE

if TYPE_CHECKING:
    from ..case.blocks import Case
    from .result import Result


def _two_fluids(case: Case) -> None:
    if len(case.fluid_names) != 2:
        raise CompareError(f"reference.kind {case.reference.kind} needs two fluids")  # type: ignore[union-attr]


def _layers(case: Case, result: Result) -> tuple[Array, float, float, list[Any]]:
    """Height (n,) of the particles over the lower plate, that of the channel and the interface; the fluids, lower
    one first."""
    _two_fluids(case)
    y, height = plates(case, result.x)
    first = result.phase == 0
    if not reduce.any_true(first) or not reduce.any_true(~first):
        raise CompareError("the result has particles of one fluid only")
    upside_down = reduce.mean(y[first]) > reduce.mean(y[~first])
    below = reduce.mean(~first if upside_down else first)
    fluids = [case.fluids[name] for name in case.fluid_names]
    return y, height, number(case, "interface", height * below), fluids[:: -1 if upside_down else 1]


def two_layer_couette_errors(case: Case, result: Result) -> Errors:
    """Errors of the velocity of two layers under a lid (`plates.two_layer_couette`). Raises CompareError."""
    y, height, interface, fluids = _layers(case, result)
    u = two_layer_couette(y, height, interface, [f.mu for f in fluids], lid_speed(case))
    return {**velocity_errors(result.velocity, along_x(result.x, u)), "main": "velocity_relative_l2"}


def two_layer_poiseuille_errors(case: Case, result: Result) -> Errors:
    """Driven by one force per volume (pressure_drop) or by one per mass (body_force)."""
    y, height, interface, fluids = _layers(case, result)
    lengths = np.subtract(*box_of(case)[::-1])
    body, drop = forcing.body_force(case, len(lengths))[0], forcing.pressure_gradient(case, lengths)[0]
    gradient = [drop + body * f.density for f in fluids]
    u = two_layer_poiseuille(y, height, interface, [f.mu for f in fluids], gradient)
    return {**velocity_errors(result.velocity, along_x(result.x, u)), "main": "velocity_relative_l2"}


def two_layer_hydrostatics_errors(case: Case, result: Result) -> Errors:
    """Pressure of layers at rest; the speed that is left over the square root of gravity times height."""
    y, height, interface, fluids = _layers(case, result)
    gravity = -_gravity(case, result.x.shape[1])
    p = two_layer_hydrostatics(y, interface, [f.density for f in fluids], gravity)
    return {
        **pressure_error(result.pressure, p),
        "speed_relative": float(reduce.largest(np.linalg.norm(result.velocity, axis=1))
                                / math.sqrt(abs(gravity) * height)),
        "main": "pressure_relative_l2",
    }


def _gravity(case: Case, dim: int) -> float:
    """Acceleration along y."""
    return float(forcing.body_force(case, dim)[1])


def _drop(case: Case, result: Result) -> int:
    """Index of the fluid of the drop: reference.parameters.drop, or that of which there is less."""
    _two_fluids(case)
    volumes = [at_end(result, f"volume_{name}") for name in case.fluid_names]
    name = parameter(case, "drop", case.fluid_names[int(np.argmin(volumes))])
    return case.fluid_names.index(str(name))


def _tension(case: Case) -> float:
    return number(case, "tension", case.interface.tension if case.interface else None)


def _size(case: Case, result: Result, drop: int) -> tuple[float, Errors]:
    """Area or volume of the drop, and its relative change in the run."""
    name = f"volume_{case.fluid_names[drop]}"
    volume = at_end(result, name)
    return volume, {"volume_relative": float(volume / column(result, name)[0] - 1)}


def _spurious(result: Result) -> Errors:
    """The spurious capillary number that the run prints; {} for a run that is driven by more than tension."""
    known = result.two_fluids.get("spurious_capillary_number")
    return {} if known is None else {"spurious_capillary_number": float(known)}


def static_drop_errors(case: Case, result: Result) -> Errors:
    """Pressure jump of a drop at rest (Young and Laplace), its spurious capillary number, and circularity."""
    drop = _drop(case, result)
    dim = result.x.shape[1]
    size, errors = _size(case, result, drop)
    radius = number(case, "radius", drop_radius(size, dim))
    expected = laplace_jump(_tension(case), radius, dim)
    measured = (1 - 2 * drop) * at_end(result, "pressure_jump")  # of the inside over the outside
    errors = {"laplace_relative": float(measured / expected - 1), **errors}
    errors |= _spurious(result)
    if dim == 2:
        errors["circularity"] = at_end(result, "circularity") - 1
    return {**errors, "main": "laplace_relative"}


def contact_angle_errors(case: Case, result: Result) -> Errors:
    """Contact angle of a drop on a wall: as the run measured it, and of the cap whose centre of mass is as high."""
    assert case.reference is not None
    drop = _drop(case, result)
    dim = result.x.shape[1]
    size, errors = _size(case, result, drop)
    asked = case.interface.contact_angle if case.interface else None
    asked = number(case, "angle", asked if asked is None or drop == 0 else 180.0 - asked)  # through the drop
    tilt = math.radians(number(case, "tilt", 0.0))
    wall = str(parameter(case, "wall", "y_min" if tilt else _lower_wall(case, dim)))
    if wall not in [f"{axis}_{end}" for axis in AXES[:dim] for end in ("min", "max")] or not 0 < asked < 180:
        raise CompareError(f"a drop on the wall {wall} at {asked:g} degrees has no cap to compare with")
    if wall[0] in case.geometry.repeats and "at" not in case.reference.parameters:
        raise CompareError(f"the face {wall} is no wall: the scene repeats along {wall[0]}; name the wall that the "
                           "drop sits on, reference.parameters.wall, or where it is, reference.parameters.at")
    axis, lowest = AXES.index(wall[0]), wall.endswith("min")
    if tilt and (dim == 3 or wall != "y_min"):
        raise CompareError("reference.parameters.tilt turns the wall y_min of a scene of two axes")
    up = np.eye(dim)[axis] if tilt == 0.0 else np.array([-math.sin(tilt), math.cos(tilt)])
    foot = number(case, "at", float(box_of(case, result)[0 if lowest else 1][axis]) if tilt == 0.0 else None)
    place = [at_end(result, f"centre_{a}_{case.fluid_names[drop]}") for a, n in zip(AXES, up) if n]
    centre = abs(up[up != 0.0] @ place - foot)
    cap = _angle_of_cap(centre, size, dim)
    if result.two_fluids.get("contact_angle", 0.0) is None:
        raise TooShortError("the run ends while no circle or sphere fits the interface near the wall: it has no "
                            "contact angle at its end")
    measured = at_end(result, "contact_angle")
    measured = measured if drop == 0 else 180.0 - measured
    expected = drop_on_wall(size, asked, dim)
    mine = result.x[result.phase == drop] @ up - foot
    height = float(reduce.largest(np.abs(mine)) + result.spacing / 2)
    return {
        "angle_relative": float(measured / asked - 1),
        "angle_of_cap_relative": float(cap / asked - 1),
        "height_relative": height / expected["height"] - 1,
        **errors,
        **_spurious(result),
        "main": "angle_relative",
    }


def _lower_wall(case: Case, dim: int) -> str:
    """y_min, or where the scene repeats along y the lower face of the last axis along which it does not."""
    ends = [axis for axis in AXES[:dim] if axis not in case.geometry.repeats]
    return "y_min" if "y" in ends or not ends else f"{ends[-1]}_min"


def _angle_of_cap(centre: float, size: float, dim: int) -> float:
    """Contact angle (degrees) of the cap of a size whose centre of mass is at a height; its range is 1 to 179."""

    def lower(angle: float) -> float:
        return drop_on_wall(size, angle, dim)["centre"] - centre

    if lower(1.0) * lower(179.0) > 0:
        return 1.0 if lower(1.0) > 0 else 179.0
    return float(brentq(lower, 1.0, 179.0))


def amplitude(case: Case, x: Array, volume: Array, first: Array) -> float:
    """Height of the crest of a wave, or how much longer than round a drop is along x, m, of particles x (n, 2) of
    volumes (n,) with volume fractions `first` (n,) of the first fluid.

    What a run writes as the column `amplitude` of its history where the kind of its reference is in `AMPLITUDES`; of
    several processes all of them ask, each with its own particles.
    First moments of the fluid as a set: 2 / width times its integral of cos(k x); its integral of z^n over
    pi R^(n + 1), z = x + i y from the middle of the drop. Both are exact for small amplitudes. Particles do not count
    alike: where shifting has taken some from one fluid to the other, fewer are left, each of a larger volume.
    """
    assert case.reference is not None
    lower, upper = box_of(case)
    if case.reference.kind == "capillary_wave":
        k = 2 * math.pi / number(case, "wavelength", float(upper[0] - lower[0]))
        upside_down = reduce.mean(x[:, 1], volume * first) > reduce.mean(x[:, 1], volume * (1.0 - first))
        # the upper fluid has the same wave with the other sign; what both share is no wave
        sign = (1.0 - 2.0 * first) if upside_down else (2.0 * first - 1.0)
        return float(reduce.mean(sign * np.cos(k * (x[:, 0] - lower[0])), volume) * (upper[1] - lower[1]))
    name = parameter(case, "drop", case.fluid_names[0 if reduce.mean(first, volume) < 0.5 else 1])
    part = volume * (first if case.fluid_names.index(name) == 0 else 1.0 - first)
    z = (x - reduce.dot(part, x) / reduce.total(part)) @ [1, 1j]
    n = _mode(case)
    # second moments give the radius: no volume of a particle is needed
    radius = math.sqrt(2 * float(reduce.mean(np.abs(z) ** 2, part)))
    return float(reduce.mean((z**n).real, part) / radius ** (n - 1))


AMPLITUDES = ("capillary_wave", "oscillating_drop")


def _mode(case: Case) -> int:
    return int(number(case, "mode", 2))


def capillary_wave_errors(case: Case, result: Result) -> Errors:
    """Height of the crest over time against the linear initial value problem of two fluids between plates.

    Starts from rest with reference.parameters.amplitude, or flat with a velocity, reference.parameters.speed.
    """
    _two_fluids(case)
    lower, upper = box_of(case)
    names, first = case.fluid_names, result.phase == 0
    upside_down = reduce.mean(result.x[first, 1]) > reduce.mean(result.x[~first, 1])
    part = float(reduce.mean(first))
    thickness = (upper[1] - lower[1]) * np.array([part, 1.0 - part])
    if result.geometry.periodic[1]:
        thickness[:] = math.inf  # no plates
    layers = [Layer(case.fluids[name].density, case.fluids[name].mu, h) for name, h in zip(names, thickness)]
    height = column(result, "amplitude")
    t = times(result, len(height))
    expected = capillary_wave(
        t, number(case, "wavelength", float(upper[0] - lower[0])), _tension(case), layers[:: -1 if upside_down else 1],
        -_gravity(case, result.x.shape[1]), (number(case, "amplitude", 0.0), number(case, "speed", 0.0)),
    )  # fmt: skip
    if not expected.any():
        raise CompareError("give reference.parameters.amplitude or .speed: without them there is no wave")
    deviation, size = (math.sqrt(trapezoid(f**2, t)) for f in (height - expected, expected))
    errors = {"amplitude_relative_l2": deviation / size, "main": "amplitude_relative_l2"}
    changes = [np.flatnonzero(np.diff(np.sign(f))) for f in (height, expected)]
    if all(len(found) for found in changes):
        zeros = [_zero(t, f, found[0]) for f, found in zip((height, expected), changes)]
        errors["first_zero_relative"] = zeros[0] / zeros[1] - 1
    return errors


def _zero(t: Array, f: Array, i: int) -> float:
    """Where f is zero between rows i and i + 1."""
    return float(t[i] - f[i] * (t[i + 1] - t[i]) / (f[i + 1] - f[i]))


def oscillating_drop_errors(case: Case, result: Result) -> Errors:
    """Frequency and damping of a drop, fitted to its amplitude, against the eigenvalue of the viscous problem.

    From reference.parameters.from on (s; without it: half a period), when what the start has excited besides
    has decayed.
    """
    assert case.reference is not None
    drop = _drop(case, result)
    size, errors = _size(case, result, drop)
    order = [case.fluids[case.fluid_names[k]] for k in (drop, 1 - drop)]
    wall = number(case, "wall_radius") if "wall_radius" in case.reference.parameters else math.inf
    s = drop_oscillation(
        number(case, "radius", drop_radius(size, 2)), _tension(case), [f.density for f in order],
        [f.mu for f in order], _mode(case), wall,
    )  # fmt: skip
    a = column(result, "amplitude")
    t = times(result, len(a))
    kept = t >= number(case, "from", math.pi / s.imag)
    if kept.sum() < 10 or np.ptp(t[kept]) < math.pi / s.imag:
        raise TooShortError("the run is too short to tell the frequency of the drop: less than half a period is left")
    found = fit_oscillation(t[kept], a[kept], s)
    return {
        "rate_relative": abs(found - s) / abs(s),
        "frequency_relative": found.imag / s.imag - 1,
        "damping_relative": found.real / s.real - 1,
        **errors,
        "main": "rate_relative",
    }


def fit_oscillation(t: Array, a: Array, guess: complex) -> complex:
    """The s of a = Re(c e^(s t)) that fits best, c linear and s from a guess; unequal steps count by their length."""
    weight = np.sqrt(np.gradient(t))
    weight /= np.linalg.norm(a * weight)  # the tolerances of the fit are absolute
    t = t - t[0]

    def misfit(s: Array) -> Array:
        wave = np.exp((s[0] + 1j * s[1]) * abs(guess) * t) * weight
        basis = np.stack([wave.real, wave.imag], axis=1)
        return basis @ np.linalg.lstsq(basis, a * weight, rcond=None)[0] - a * weight

    start = np.array([guess.real, guess.imag]) / abs(guess)
    found = min((least_squares(misfit, start * f) for f in (1.0, 0.8, 1.25)), key=lambda fit: fit.cost)
    return complex(*found.x) * abs(guess)


def imbibition_errors(case: Case, result: Result) -> Errors:
    """Way that a fluid has gone into a slit by the end of a run, from the flow rate over time, and its velocity there.

    The slit lies along x between reservoirs, and the other end of each meets that of the other (periodic).
    """
    _two_fluids(case)
    lower, upper = box_of(case)
    fills = str(parameter(case, "drop", case.fluid_names[0]))
    names = [fills, *(name for name in case.fluid_names if name != fills)]
    width, length, start = (number(case, key) for key in ("width", "length", "start"))
    volumes = [column(result, f"volume_{name}")[0] for name in names]
    (long, high), inside = upper - lower, (start, length - start)
    slit = SlitBetweenReservoirs(
        width, length, width / high, tuple((v - width * way) / high for v, way in zip(volumes, inside)),  # type: ignore[arg-type]
    )  # fmt: skip
    angle = number(case, "angle", case.interface.contact_angle if case.interface else None)
    sign = 1.0 if fills == case.fluid_names[0] else -1.0  # the angle is that through the first fluid
    driving = sign * 2.0 * _tension(case) * math.cos(math.radians(angle)) / width
    fluids = [case.fluids[name] for name in names]
    u = column(result, "mean_velocity_x") * sum(volumes) / (long * width)
    t = times(result, len(u))
    t, u = np.append(0.0, t), np.append(0.0, u)
    way, velocity = slit_imbibition(t, slit, driving, [f.density for f in fluids], [f.mu for f in fluids], start)
    gone = trapezoid(u, t)
    return {
        "way_relative": float((start + gone) / way[-1] - 1),
        "gone_relative": float(gone / (way[-1] - start) - 1),
        "velocity_relative": float(u[-1] / velocity[-1] - 1),
        "main": "way_relative",
    }


PEAK = 0.96  # of the largest value: a cubic function is fitted to the rows above, of the bubble 0.3 on either side
LEAST = 10  # rows above it: through fewer no function is fitted


def _peak(t: Array, f: Array) -> tuple[float, float]:
    """Time and value of the largest of f (n,) at times t (n,), by a cubic function fitted to what lies round it: the
    rise velocity of the bubble is 0.1 % less 5 % of the time away from its largest."""
    top = int(np.argmax(f))
    low = np.flatnonzero(f < PEAK * f[top])
    part = slice(low[low < top].max(initial=-1) + 1, low[low > top].min(initial=len(f)))
    if len(f[part]) < LEAST:
        return float(t[top]), float(f[top])
    fit = np.polynomial.Polynomial.fit(t[part], f[part], 3)
    when = [float(r.real) for r in fit.deriv().roots() if abs(r.imag) < 1e-9 and t[part][0] <= r.real <= t[part][-1]]
    best = max(when, key=fit, default=float(t[top]))
    return best, float(fit(best))


def _worst(t: Array, f: Array, times: Array, published: Array) -> float:
    """Deviation of f (n,) at times t (n,) from published values at theirs, over the largest of those: the worst."""
    reached = times <= t[-1]
    deviation = np.interp(times[reached], t, f) - published[reached]
    return float(max(deviation, key=abs) / published.max())


def rising_bubble_errors(case: Case, result: Result) -> Errors:
    """The numbers of the benchmark that the run got to, and the worst deviations from the published series, over their
    largest values; `benchmark_relative` is the worst of the three bold numbers."""
    name = case.fluid_names[_drop(case, result)]
    bubble, series = RISING_BUBBLE, RISING_BUBBLE["series"]
    rise, roundness = column(result, f"velocity_y_{name}"), column(result, "circularity")
    height = column(result, f"centre_y_{name}")
    t = times(result, len(rise))
    errors = {}
    if t[-1] > bubble["time_of_rise_velocity_max"][1]:
        when, largest = _peak(t, rise)
        errors["rise_velocity_relative"] = largest / bubble["rise_velocity_max"] - 1
        errors["time_of_rise_velocity"] = float(when / np.mean(bubble["time_of_rise_velocity_max"]) - 1)
        errors["rise_velocity_series"] = _worst(t, rise, series["time_of_velocity"], series["rise_velocity"])
        errors["centre_height_series"] = _worst(t, height, series["time_of_height"], series["centre_height"])
    if t[-1] > bubble["time_of_circularity_min"]:
        errors["circularity_relative"] = float(roundness.min() / bubble["circularity_min"] - 1)
    if t[-1] >= 3.0 * (1 - 1e-9):
        errors["centre_height_relative"] = float(np.interp(3.0, t, height) / bubble["centre_height_at_3"] - 1)
    if not errors:
        raise TooShortError("the run ends before the bubble is fastest, at t = 0.92: there is nothing to compare")
    judged = [errors[k] for k in ("rise_velocity_relative", "circularity_relative", "centre_height_relative")
              if k in errors]  # fmt: skip
    errors |= _size(case, result, case.fluid_names.index(name))[1]
    return {"benchmark_relative": max(judged, key=abs), **errors, "main": "benchmark_relative"}
