"""Errors of a result against the reference that its case names.

`compare(case, result)` takes the `Result` of a run. What a reference needs and the case itself does not say stands in
`reference.parameters`, see `PARAMETERS`.

All errors are relative and plain floats; those of permeabilities carry a sign. `velocity_relative_l2` is
|u - u_ref| / |u_ref| over the particles, `velocity_max` the largest deviation over the largest |u_ref|.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import trapezoid
from scipy.optimize import brentq, least_squares
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .solutions import (
    RISING_BUBBLE,
    annulus,
    annulus_flux,
    capillary_wave,
    cavity,
    cylinder_array_permeability,
    decaying_channel,
    drop_on_wall,
    drop_oscillation,
    drop_radius,
    laplace_jump,
    plane_couette,
    slit_permeability,
    slit_poiseuille,
    spectral_velocity,
    sphere_array_permeability,
    square_duct,
    square_duct_flux,
    startup_couette,
    startup_poiseuille,
    taylor_couette,
    taylor_green_2d,
    taylor_green_3d,
    two_layer_couette,
    two_layer_hydrostatics,
    two_layer_poiseuille,
)

if TYPE_CHECKING:
    from ..case.blocks import Case
    from .result import Result

Array = np.ndarray
Errors = dict[str, Any]
AXES = "xyz"
LINKED = 1.5  # spacings: particles closer than this and in sight of each other are in the same pore
STENCIL = 2.5  # spacings: particles that a value on a line is interpolated from


class CompareError(ValueError):
    """A reference that lacks what its comparison needs, or a result that does not have it."""


def compare(case: Case, result: Result) -> Errors:
    """Errors by name; `main` is the name of the one that `reference.tolerance` bounds.

    Raises CompareError.
    """
    reference = case.reference
    if reference is None:
        raise CompareError("the case names no reference; add a block reference with its kind")
    unknown = set(reference.parameters) - set(PARAMETERS[reference.kind])
    if unknown:
        known = ", ".join(PARAMETERS[reference.kind]) or "none"
        name = min(unknown)
        raise CompareError(f"reference.parameters.{name}: kind {reference.kind} does not know it; it knows {known}")
    errors = COMPARISONS[reference.kind](case, result)
    for name, value in errors.items():
        if name != "main" and not math.isfinite(value):
            raise CompareError(f"the error {name} is {value}: the result or the reference is not finite")
    return errors


def compare_snapshot(case: Case, x: Array, velocity: Array, time: float | None) -> Errors:
    """Velocity errors of one moment of a start-up flow or a Taylor-Green vortex, or of a steady flow, which may have no
    time; raises CompareError."""
    kind = case.reference.kind if case.reference else ""
    field = FIELDS.get(kind)
    if field is None:
        raise CompareError(f"reference.kind {kind} has no field at a time; known are {', '.join(FIELDS)}")
    return {**_velocity_errors(velocity, field(case, np.asarray(x), time)), "main": MAIN_OF_FIELD[kind]}


# -- numbers of the case ---------------------------------------------------------------------------------


def _parameter(case: Case, name: str, derived: Any = None) -> Any:
    """reference.parameters.<name>, or what the case says elsewhere; one of them must be there."""
    assert case.reference is not None
    value = case.reference.parameters.get(name, derived)
    if value is None:
        raise CompareError(f"reference.kind {case.reference.kind} needs reference.parameters.{name}")
    return value


def _number(case: Case, name: str, derived: float | None = None) -> float:
    value = _parameter(case, name, derived)
    if isinstance(value, str) or not math.isfinite(value):
        raise CompareError(f"reference.parameters.{name} is {value!r}; give a number")
    return float(value)


def _fluid(case: Case) -> Any:
    return case.fluids[case.fluid_names[0]]


def _force(case: Case, lengths: Array) -> Array | None:
    """Acceleration (dim,) of the drive; None where it names axes or a velocity, whose force is up to the run."""
    force = np.zeros(len(lengths))
    if case.drive is None:
        return force
    if case.drive.named_axes:
        return None
    if case.drive.body_force:
        force += case.drive.body_force
    for axis, drop in (case.drive.pressure_drop or {}).items():
        force[AXES.index(axis)] += drop / (_fluid(case).density * lengths[AXES.index(axis)])
    return force


def _box(case: Case, result: Result | None = None) -> tuple[Array, Array]:
    """Lower and upper corner of the scene."""
    if case.geometry.box is None:
        if result is None:
            raise CompareError(f"reference.kind {case.reference.kind} needs a box, not voxels")  # type: ignore[union-attr]
        return np.asarray(result.geometry.lower), np.asarray(result.geometry.upper)
    lower = np.array(case.geometry.origin or np.zeros(len(case.geometry.box)), dtype=float)
    return lower, lower + case.geometry.box


# -- measures --------------------------------------------------------------------------------------------


def _velocity_errors(u: Array, expected: Array) -> Errors:
    """u, expected: (n, k), or expected (n, dim) with the part of the flow that is compared."""
    deviation = np.linalg.norm(np.asarray(u) - expected, axis=1)
    size = np.linalg.norm(expected, axis=1)
    if not size.any():
        raise CompareError("the reference is at rest: there is nothing to be relative to")
    return {
        "velocity_relative_l2": float(np.linalg.norm(deviation) / np.linalg.norm(size)),
        "velocity_max": float(deviation.max() / size.max()),
    }


def _pressure_error(p: Array, expected: Array) -> Errors:
    """A pressure is known up to a constant: both without their mean."""
    expected = expected - expected.mean()
    deviation = p - np.mean(p) - expected
    return {"pressure_relative_l2": float(np.linalg.norm(deviation) / np.linalg.norm(expected))}


def _permeability_errors(case: Case, result: Result, expected: dict[str, float]) -> Errors:
    """Signed errors of each axis that was measured; permeability_relative is the worst of them."""
    measured = _by_axis(case, result.permeability)
    errors = {
        f"permeability_relative_{axis}": float(k / expected[axis] - 1)
        for axis, k in measured.items()
        if axis in expected
    }
    if not errors:
        raise CompareError("the run gave no permeability along an axis of the reference; is there a drive, and was the "
                           "flow steady?")
    worst = max(errors.values(), key=abs)
    tensor = result.tensor
    if tensor is None and isinstance(result.permeability, np.ndarray) and result.permeability.ndim == 2:
        tensor = result.permeability
    if tensor is not None:
        diagonal = np.diag(tensor)
        rest = np.abs(tensor - np.diag(diagonal)).max()
        errors["permeability_off_diagonal"] = float(rest / np.abs(diagonal).mean())
    return {"permeability_relative": worst, **errors, "main": "permeability_relative"}


def _by_axis(case: Case, permeability: Any) -> dict[str, float]:
    """{axis: m2} of the axes that were measured."""
    if permeability is None:
        return {}
    if isinstance(permeability, Mapping):
        return {axis: float(k) for axis, k in permeability.items() if k is not None}
    if np.ndim(permeability) == 2:
        return dict(zip(AXES, map(float, np.diag(permeability))))
    return {_flow_axis(case): float(permeability)}


def _flow_axis(case: Case) -> str:
    """The axis along which the drive is strongest."""
    drive = case.drive
    if drive is None:
        raise CompareError("the case has no drive, so no axis of flow")
    if drive.named_axes:
        return drive.named_axes[0]
    pushes = dict(zip(AXES, drive.body_force)) if drive.body_force else dict(drive.pressure_drop or {})
    return max(pushes, key=lambda axis: abs(pushes[axis]))


# -- flow between plates ---------------------------------------------------------------------------------


def _plates(case: Case, x: Array) -> tuple[Array, float]:
    """Distance (n,) from the plate at the lower y, and the distance of the plates."""
    lower, upper = _box(case)
    foot = _number(case, "lower", float(lower[1]))
    return x[:, 1] - foot, _number(case, "height", float(upper[1] - foot))


def _lid_speed(case: Case) -> float:
    wall = case.geometry.walls.get("y_max")
    return _number(case, "wall_velocity", wall.velocity[0] if wall and wall.velocity else None)


def _push(case: Case) -> float:
    """Acceleration along x."""
    force = _force(case, np.subtract(*_box(case)[::-1]))
    return _number(case, "acceleration", None if force is None else float(force[0]))


def _along_x(x: Array, u: Array) -> Array:
    return np.stack([u, *[np.zeros_like(u)] * (x.shape[1] - 1)], axis=1)


def _moment(time: float | None) -> float:
    """The time of a result that a field depends on."""
    if time is None:
        raise CompareError("the reference depends on the time, and a steady solve has none; use flow: navier_stokes")
    return time


def _couette_field(case: Case, x: Array, time: float | None) -> Array:
    y, height = _plates(case, x)
    return _along_x(x, plane_couette(y, height, _lid_speed(case)))


def _poiseuille_field(case: Case, x: Array, time: float | None) -> Array:
    y, height = _plates(case, x)
    nu = _number(case, "nu", _fluid(case).nu)
    return _along_x(x, slit_poiseuille(y, height, _push(case), nu))


def _startup_couette_field(case: Case, x: Array, time: float | None) -> Array:
    y, height = _plates(case, x)
    nu = _number(case, "nu", _fluid(case).nu)
    return _along_x(x, startup_couette(y, _moment(time), height, nu, _lid_speed(case)))


def _startup_poiseuille_field(case: Case, x: Array, time: float | None) -> Array:
    y, height = _plates(case, x)
    nu = _number(case, "nu", _fluid(case).nu)
    return _along_x(x, startup_poiseuille(y, _moment(time), height, nu, _push(case)))


def _decaying_channel_field(case: Case, x: Array, time: float | None) -> Array:
    y, height = _plates(case, x)
    nu = _number(case, "nu", _fluid(case).nu)
    mode = int(_number(case, "mode", 1))
    return _along_x(x, decaying_channel(y, _moment(time), height, nu, _number(case, "speed"), mode))


def _slit(case: Case, result: Result) -> Errors:
    """Permeability of a slit in its box, and the profile where the force is known."""
    lower, upper = _box(case)
    height = _plates(case, result.x)[1]
    k = slit_permeability(height) * height / float(upper[1] - lower[1])
    errors = _permeability_errors(case, result, {"x": k})
    if _force(case, upper - lower) is not None:
        errors |= _velocity_errors(result.velocity, _poiseuille_field(case, result.x, 0.0))
    return errors


def _field(case: Case, result: Result) -> Errors:
    """The velocity of every particle, for the kinds in FIELDS."""
    return compare_snapshot(case, result.x, result.velocity, result.time)


# -- between cylinders -----------------------------------------------------------------------------------


def _cylinders(case: Case) -> tuple[Any, Any, list[int], Array]:
    """The two shapes of an annulus, the axes across it and its centre, by the shapes of the case: the first disk or
    cylinder of solid, and the first whose outside is."""
    shapes = [s for s in case.geometry.shapes if s.what == "solid" and (s.cylinder or s.sphere)]
    inner = next((s for s in shapes if not s.outside), None)
    outer = next((s for s in shapes if s.outside), None)
    if inner is None or outer is None:
        raise CompareError("an annulus needs a solid disk or cylinder and one whose outside is solid")
    lower, upper = _box(case)
    body = inner.cylinder or inner.sphere
    assert body is not None
    centre = (lower + upper) / 2 if body.centre is None else np.array(body.centre, dtype=float)
    across = [a for a in range(len(lower)) if not inner.cylinder or a != AXES.index(inner.cylinder.axis)]
    return inner, outer, across, centre


def _radius(shape: Any) -> float:
    return (shape.cylinder or shape.sphere).radius


def _taylor_couette_field(case: Case, x: Array, time: float | None) -> Array:
    """Azimuthal flow between cylinders that turn."""
    inner, outer, across, centre = _cylinders(case)
    omega = [shape.angular_velocity or 0.0 for shape in (inner, outer)]
    offset = x - centre
    first, second = across if across != [0, 2] else [2, 0]  # as the axes follow each other
    r = np.hypot(offset[:, first], offset[:, second])
    turning = taylor_couette(r, _radius(inner), _radius(outer), *omega) / r
    u = np.zeros_like(x)
    u[:, first], u[:, second] = -turning * offset[:, second], turning * offset[:, first]
    return u


def _annulus(case: Case, result: Result) -> Errors:
    """Permeability of an annulus along its axis, of the area of the box, and the profile where the force is known."""
    inner, outer, across, centre = _cylinders(case)
    lower, upper = _box(case)
    radii = _radius(inner), _radius(outer)
    axis = next(iter(set(range(len(lower))) - set(across)))
    k = annulus_flux(*radii, 1.0, 1.0) / float(np.prod((upper - lower)[across]))
    errors = _permeability_errors(case, result, {AXES[axis]: k})
    force = _force(case, upper - lower)
    if force is not None:
        r = np.hypot(*(result.x - centre)[:, across].T)
        expected = np.zeros_like(result.x)
        expected[:, axis] = annulus(r, *radii, force[axis], _fluid(case).nu)
        errors |= _velocity_errors(result.velocity, expected)
    return errors


# -- ducts and arrays ------------------------------------------------------------------------------------


def _square_duct(case: Case, result: Result) -> Errors:
    """Permeability of a duct along x in its box, the profile where the force is known, and centre over mean.

    Parameters: side (m), and y, z (m) of the lower corner of the duct if it is not that of the box.
    """
    lower, upper = _box(case, result)
    side = _number(case, "side", float(upper[1] - lower[1]))
    corner = [_number(case, axis, float(foot)) for axis, foot in zip("yz", lower[1:])]
    area = float(np.prod((upper - lower)[1:]))
    errors = _permeability_errors(case, result, {"x": square_duct_flux(side, 1.0, 1.0) / area})
    y, z = result.x[:, 1] - corner[0], result.x[:, 2] - corner[1]
    profile = square_duct(y, z, side, 1.0, 1.0)
    force = _force(case, upper - lower)
    if force is not None:
        u = profile * force[0] / _fluid(case).nu
        errors |= _velocity_errors(result.velocity, _along_x(result.x, u))
    middle = np.array([*(lower + upper)[:1] / 2, corner[0] + side / 2, corner[1] + side / 2])
    centre = _at_points(result, middle[None], result.velocity[:, 0])[0]
    ratio = square_duct(np.array([side / 2]), np.array([side / 2]), side, 1.0, 1.0)[0]
    ratio *= side**2 / square_duct_flux(side, 1.0, 1.0)
    errors["centre_over_mean"] = float(centre / result.velocity[:, 0].mean() / ratio - 1)
    return errors


def _array(permeability: Callable[[float, float], float]) -> Callable[[Case, Result], Errors]:
    """Comparison with an array of one obstacle a cell. Parameters: fraction, and cell (m) if not the box."""

    def comparison(case: Case, result: Result) -> Errors:
        lower, upper = _box(case, result)
        cell = _number(case, "cell", float(upper[0] - lower[0]))
        k = permeability(_number(case, "fraction"), cell)
        return _permeability_errors(case, result, dict.fromkeys(AXES, k))

    return comparison


def _permeability(case: Case, result: Result) -> Errors:
    """A published permeability: one number for every axis, or one an axis."""
    value = case.reference.value  # type: ignore[union-attr]
    if value is None:
        raise CompareError("reference.kind permeability needs reference.value, in m2")
    expected = dict(zip(AXES, value)) if isinstance(value, tuple) else dict.fromkeys(AXES, value)
    return _permeability_errors(case, result, expected)


def _flow_split(case: Case, result: Result) -> Errors:
    """Shares of the flow of the connected parts of the fluid, the smallest first, against reference.value."""
    value = case.reference.value  # type: ignore[union-attr]
    if not isinstance(value, tuple) or min(value) <= 0:
        raise CompareError("reference.kind flow_split needs reference.value, the flow of each part: [16, 81]")
    along = result.cell_velocity[:, AXES.index(_flow_axis(case))]
    flows = np.sort(np.bincount(connected_parts(result), weights=along))[::-1][: len(value)][::-1]
    if len(flows) < len(value):
        raise CompareError(f"the fluid has {len(flows)} parts; reference.value names {len(value)}")
    expected = np.sort(value) / np.sum(value)
    parts = flows / along.sum() / expected - 1
    errors = {f"flow_split_{i}": float(part) for i, part in enumerate(parts, 1)}
    return {"flow_split": max(errors.values(), key=abs), **errors, "main": "flow_split"}


def connected_parts(result: Result) -> Array:
    """Number (n,) of the connected part of the fluid that each particle is in; walls separate."""
    geometry = result.geometry
    lower, period = np.asarray(geometry.lower), np.asarray(geometry.upper) - geometry.lower
    around = np.array(geometry.periodic)
    x = result.x - lower
    x = np.where(around, np.mod(x, period), x)
    x = np.where(around & (x >= period), 0.0, x)
    tree = cKDTree(x, boxsize=np.where(around, period, 0.0) if around.any() else None)
    i, j = tree.query_pairs(LINKED * result.spacing, output_type="ndarray").T
    step = x[j] - x[i]
    step -= np.where(around, period * np.round(step / period), 0.0)
    start = x[i] + lower
    sees = geometry.crossing(start, start + step) >= 1.0
    graph = coo_matrix((np.ones(sees.sum(), dtype=np.int8), (i[sees], j[sees])), shape=(len(x),) * 2)
    return connected_components(graph, directed=False)[1]


# -- vortices and the cavity -----------------------------------------------------------------------------


def _vortex(case: Case, dim: int) -> dict[str, float]:
    lower, upper = _box(case)
    if len(lower) != dim:
        raise CompareError(f"reference.kind {case.reference.kind} is for a scene in {dim}D")  # type: ignore[union-attr]
    return {
        "nu": _number(case, "nu", _fluid(case).nu),
        "speed": _number(case, "speed"),
        "k": _number(case, "k", 2 * math.pi / float(upper[0] - lower[0])),
    }


def _taylor_green_field(case: Case, x: Array, time: float | None) -> Array:
    return taylor_green_2d(x, _moment(time), **_vortex(case, 2))[0]


def _taylor_green(case: Case, result: Result) -> Errors:
    u, p = taylor_green_2d(result.x, _moment(result.time), density=_fluid(case).density, **_vortex(case, 2))
    return {
        **_velocity_errors(result.velocity, u),
        **_pressure_error(result.pressure, p),
        "kinetic_energy_relative": _energy_error(result.velocity, u),
        "main": MAIN_OF_FIELD["taylor_green"],
    }


def _taylor_green_3d_field(case: Case, x: Array, time: float | None) -> Array:
    vortex = _vortex(case, 3)
    _, fields = taylor_green_3d([_moment(time)], n=32, **vortex)
    return spectral_velocity(fields[0], x, vortex["k"])


def _taylor_green_3d(case: Case, result: Result) -> Errors:
    u = _taylor_green_3d_field(case, result.x, result.time)
    errors = _velocity_errors(result.velocity, u)
    energy = _energy_error(result.velocity, u)
    return {**errors, "kinetic_energy_relative": energy, "main": MAIN_OF_FIELD["taylor_green_3d"]}


def _energy_error(u: Array, expected: Array) -> float:
    return float((u**2).sum() / (expected**2).sum() - 1)


def _lid_driven_cavity(case: Case, result: Result) -> Errors:
    """u on the vertical and v on the horizontal middle line, against the tables of Ghia et al.

    Over the points of both tables that are not on walls; `velocity_max` is over the speed of the lid.
    """
    lower, upper = _box(case)
    side, lid = float(upper[0] - lower[0]), _lid_speed(case)
    reynolds = round(lid * side / _number(case, "nu", _fluid(case).nu))
    try:
        table = cavity(reynolds)
    except KeyError:
        raise CompareError(f"no table for Reynolds number {reynolds}; there are 100, 400 and 1000") from None
    deviations, values = [], []
    for component, places, expected in ((0, table["y"], table["u"]), (1, table["x"], table["v"])):
        inside = (places > 0) & (places < 1)
        points = np.full((inside.sum(), 2), 0.5)
        points[:, 1 - component] = places[inside]
        u = _at_points(result, lower + side * points, result.velocity[:, component])
        deviations.append(u / lid - expected[inside])
        values.append(expected[inside])
    deviation, value = np.concatenate(deviations), np.concatenate(values)
    return {
        "velocity_relative_l2": float(np.linalg.norm(deviation) / np.linalg.norm(value)),
        "velocity_max": float(np.abs(deviation).max()),
        "main": "velocity_relative_l2",
    }


def _at_points(result: Result, points: Array, values: Array) -> Array:
    """Values (n,) of the particles at points (m, dim): a local least squares fit, weights exp(-r^2).

    Of a quadratic where there are neighbours enough, else linear: a linear fit cuts the peak of a profile by
    about u'' dx^2 / 4, 1 % with 16 particles across a duct.
    """
    tree = cKDTree(result.x)
    dim = result.x.shape[1]
    upper = np.triu_indices(dim)
    out = np.empty(len(points))
    for k, point in enumerate(points):
        near = tree.query_ball_point(point, STENCIL * result.spacing)
        if len(near) <= 2 * dim:
            near = tree.query(point, k=min(3 * dim, len(result.x)))[1]
        offset = (result.x[near] - point) / result.spacing
        columns = [np.ones((len(offset), 1)), offset]
        if len(near) >= 2 * (1 + dim + len(upper[0])):
            columns.append((offset[:, :, None] * offset[:, None, :])[:, upper[0], upper[1]])
        weight = np.exp(-(offset**2).sum(axis=1))
        basis = np.concatenate(columns, axis=1) * weight[:, None]
        out[k] = np.linalg.lstsq(basis, values[near] * weight, rcond=None)[0][0]
    return out


# -- two fluids ------------------------------------------------------------------------------------------


def _column(result: Result, name: str) -> Array:
    """A column of the history, (steps,)."""
    values = [row[name] for row in result.history if row.get(name) is not None]
    if not values:
        raise CompareError(f"the run left no {name} in its history; the reference needs it")
    return np.array(values, dtype=float)


def _times(result: Result, count: int) -> Array:
    return _column(result, "time")[-count:]


def _two_fluids(case: Case) -> None:
    if len(case.fluid_names) != 2:
        raise CompareError(f"reference.kind {case.reference.kind} needs two fluids")  # type: ignore[union-attr]


def _layers(case: Case, result: Result) -> tuple[Array, float, float, list[Any]]:
    """Height (n,) of the particles over the lower plate, that of the channel and the interface; the fluids, lower
    one first."""
    _two_fluids(case)
    y, height = _plates(case, result.x)
    first = result.phase == 0
    if first.all() or not first.any():
        raise CompareError("the result has particles of one fluid only")
    upside_down = y[first].mean() > y[~first].mean()
    below = (~first if upside_down else first).mean()
    fluids = [case.fluids[name] for name in case.fluid_names]
    return y, height, _number(case, "interface", height * below), fluids[:: -1 if upside_down else 1]


def _two_layer_couette(case: Case, result: Result) -> Errors:
    y, height, interface, fluids = _layers(case, result)
    u = two_layer_couette(y, height, interface, [f.mu for f in fluids], _lid_speed(case))
    return {**_velocity_errors(result.velocity, _along_x(result.x, u)), "main": "velocity_relative_l2"}


def _two_layer_poiseuille(case: Case, result: Result) -> Errors:
    """Driven by one force per volume (pressure_drop) or by one per mass (body_force)."""
    y, height, interface, fluids = _layers(case, result)
    lengths = np.subtract(*_box(case)[::-1])
    drop = case.drive.pressure_drop.get("x", 0.0) if case.drive and case.drive.pressure_drop else 0.0
    body = case.drive.body_force[0] if case.drive and case.drive.body_force else 0.0
    gradient = [drop / lengths[0] + body * f.density for f in fluids]
    u = two_layer_poiseuille(y, height, interface, [f.mu for f in fluids], gradient)
    return {**_velocity_errors(result.velocity, _along_x(result.x, u)), "main": "velocity_relative_l2"}


def _two_layer_hydrostatics(case: Case, result: Result) -> Errors:
    """Pressure of layers at rest; the speed that is left over the square root of gravity times height."""
    y, height, interface, fluids = _layers(case, result)
    gravity = -_gravity(case)
    p = two_layer_hydrostatics(y, interface, [f.density for f in fluids], gravity)
    return {
        **_pressure_error(result.pressure, p),
        "speed_relative": float(np.linalg.norm(result.velocity, axis=1).max() / math.sqrt(abs(gravity) * height)),
        "main": "pressure_relative_l2",
    }


def _gravity(case: Case) -> float:
    """Acceleration along y."""
    force = case.drive.body_force if case.drive else None
    return float(force[1]) if force else 0.0


def _drop(case: Case, result: Result) -> int:
    """Index of the fluid of the drop: reference.parameters.drop, or that of which there is less."""
    _two_fluids(case)
    volumes = [_column(result, f"volume_{name}")[-1] for name in case.fluid_names]
    name = _parameter(case, "drop", case.fluid_names[int(np.argmin(volumes))])
    if name not in case.fluid_names:
        raise CompareError(f"reference.parameters.drop is {name!r}; the fluids are {', '.join(case.fluid_names)}")
    return case.fluid_names.index(str(name))


def _tension(case: Case) -> float:
    return _number(case, "tension", case.interface.tension if case.interface else None)


def _size(case: Case, result: Result, drop: int) -> tuple[float, Errors]:
    """Area or volume of the drop, and how far it went in the run from what it was."""
    volume = _column(result, f"volume_{case.fluid_names[drop]}")
    return float(volume[-1]), {"volume_relative": float(volume[-1] / volume[0] - 1)}


def _static_drop(case: Case, result: Result) -> Errors:
    """Pressure jump of a drop at rest (Young and Laplace); capillary number and circularity of what is left."""
    drop = _drop(case, result)
    dim = result.x.shape[1]
    size, errors = _size(case, result, drop)
    radius = _number(case, "radius", drop_radius(size, dim))
    expected = laplace_jump(_tension(case), radius, dim)
    measured = (1 - 2 * drop) * _column(result, "pressure_jump")[-1]  # of the inside over the outside
    errors = {"laplace_relative": float(measured / expected - 1), **errors}
    errors["capillary_number"] = float(_column(result, "capillary_number")[-1])
    if dim == 2:
        errors["circularity"] = float(_column(result, "circularity")[-1] - 1)
    return {**errors, "main": "laplace_relative"}


def _contact_angle(case: Case, result: Result) -> Errors:
    """Contact angle of a drop on a wall: as the run measured it, and of the cap whose centre of mass is as high."""
    drop = _drop(case, result)
    dim = result.x.shape[1]
    size, errors = _size(case, result, drop)
    asked = case.interface.contact_angle if case.interface else None
    asked = _number(case, "angle", asked if asked is None or drop == 0 else 180.0 - asked)  # through the drop
    wall = str(_parameter(case, "wall", "y_min"))
    if wall not in [f"{axis}_{end}" for axis in AXES[:dim] for end in ("min", "max")] or not 0 < asked < 180:
        raise CompareError(f"a drop on the wall {wall} at {asked:g} degrees has no cap to compare with")
    axis, lowest = AXES.index(wall[0]), wall.endswith("min")
    tilt = math.radians(_number(case, "tilt", 0.0))
    if tilt and (dim == 3 or wall != "y_min"):
        raise CompareError("reference.parameters.tilt turns the wall y_min of a scene of two axes")
    up = np.eye(dim)[axis] if tilt == 0.0 else np.array([-math.sin(tilt), math.cos(tilt)])
    foot = _number(case, "at", float(_box(case, result)[0 if lowest else 1][axis]) if tilt == 0.0 else None)
    place = [_column(result, f"centre_{a}_{case.fluid_names[drop]}")[-1] for a, n in zip(AXES, up) if n]
    centre = abs(up[up != 0.0] @ place - foot)
    cap = _angle_of_cap(centre, size, dim)
    measured = _column(result, "contact_angle")[-1]
    measured = measured if drop == 0 else 180.0 - measured
    expected = drop_on_wall(size, asked, dim)
    mine = result.x[result.phase == drop] @ up - foot
    height = float(np.abs(mine).max() + result.spacing / 2)
    return {
        "angle_relative": float(measured / asked - 1),
        "angle_of_cap_relative": float(cap / asked - 1),
        "height_relative": height / expected["height"] - 1,
        **errors,
        "capillary_number": float(_column(result, "capillary_number")[-1]),
        "main": "angle_relative",
    }


def _angle_of_cap(centre: float, size: float, dim: int) -> float:
    """Contact angle (degrees) of the cap of a size whose centre of mass is at a height; its range is 1 to 179."""

    def lower(angle: float) -> float:
        return drop_on_wall(size, angle, dim)["centre"] - centre

    if lower(1.0) * lower(179.0) > 0:
        return 1.0 if lower(1.0) > 0 else 179.0
    return float(brentq(lower, 1.0, 179.0))


def amplitude(case: Case, x: Array, phase: Array) -> float:
    """Height of the crest of a wave, or how much longer than round a drop is along x, m, of particles x (n, 2).

    What a run writes as the column `amplitude` of its history where the kind of its reference is in `AMPLITUDES`.
    First moments of the fluid as a set: 2 / width times its integral of cos(k x); its integral of z^n over
    pi R^(n + 1), z = x + i y from the middle of the drop. Both are exact for small amplitudes.
    """
    assert case.reference is not None
    lower, upper = _box(case)
    if case.reference.kind == "capillary_wave":
        k = 2 * math.pi / _number(case, "wavelength", float(upper[0] - lower[0]))
        below = int(np.mean(x[phase == 0, 1]) > np.mean(x[phase == 1, 1]))
        # the upper fluid says the same with the other sign; what both have is no wave
        sign = np.where(phase == below, 1.0, -1.0)
        return float((sign * np.cos(k * (x[:, 0] - lower[0]))).mean() * (upper[1] - lower[1]))
    counts = np.bincount(phase, minlength=2)
    name = _parameter(case, "drop", case.fluid_names[int(np.argmin(counts))])
    mine = x[phase == case.fluid_names.index(name)]
    z = (mine - mine.mean(axis=0)) @ [1, 1j]
    n = _mode(case)
    # second moments give the radius: no volume of a particle is needed
    radius = math.sqrt(2 * float((np.abs(z) ** 2).mean()))
    return float((z**n).real.mean() / radius ** (n - 1))


AMPLITUDES = ("capillary_wave", "oscillating_drop")


def _mode(case: Case) -> int:
    return int(_number(case, "mode", 2))


def _capillary_wave(case: Case, result: Result) -> Errors:
    """Height of the crest over time against the initial-value solution for two deep fluids.

    Starts from rest with reference.parameters.amplitude, or flat with a velocity, reference.parameters.speed.
    """
    _two_fluids(case)
    lower, upper = _box(case)
    fluids = [case.fluids[name] for name in case.fluid_names]
    if result.x[result.phase == 0, 1].mean() > result.x[result.phase == 1, 1].mean():
        fluids.reverse()
    if abs(fluids[0].nu - fluids[1].nu) > 1e-6 * fluids[0].nu:
        raise CompareError("the solution for capillary waves is for fluids of the same kinematic viscosity")
    height = _column(result, "amplitude")
    t = _times(result, len(height))
    expected = capillary_wave(
        t, _number(case, "wavelength", float(upper[0] - lower[0])), _tension(case), [f.density for f in fluids],
        fluids[0].nu, -_gravity(case), _number(case, "amplitude", 0.0), _number(case, "speed", 0.0),
    )  # fmt: skip
    if not expected.any():
        raise CompareError("give reference.parameters.amplitude or .speed: without them there is no wave")
    deviation, size = (math.sqrt(trapezoid(f**2, t)) for f in (height - expected, expected))
    errors = {"amplitude_relative_l2": deviation / size, "main": "amplitude_relative_l2"}
    crossings = [np.flatnonzero(np.diff(np.sign(f))) for f in (height, expected)]
    if all(len(found) for found in crossings):
        times = [_zero(t, f, found[0]) for f, found in zip((height, expected), crossings)]
        errors["first_zero_relative"] = times[0] / times[1] - 1
    return errors


def _zero(t: Array, f: Array, i: int) -> float:
    """Where f is zero between rows i and i + 1."""
    return float(t[i] - f[i] * (t[i + 1] - t[i]) / (f[i + 1] - f[i]))


def _oscillating_drop(case: Case, result: Result) -> Errors:
    """Frequency and damping of a drop, fitted to its amplitude, against the eigenvalue of the viscous problem.

    From reference.parameters.from on (s; without it: half a period), when what the start has excited besides
    has decayed.
    """
    assert case.reference is not None
    drop = _drop(case, result)
    size, errors = _size(case, result, drop)
    order = [case.fluids[case.fluid_names[k]] for k in (drop, 1 - drop)]
    wall = _number(case, "wall_radius") if "wall_radius" in case.reference.parameters else math.inf
    s = drop_oscillation(
        _number(case, "radius", drop_radius(size, 2)), _tension(case), [f.density for f in order],
        [f.mu for f in order], _mode(case), wall,
    )  # fmt: skip
    a = _column(result, "amplitude")
    t = _times(result, len(a))
    kept = t >= _number(case, "from", math.pi / s.imag)
    if kept.sum() < 10 or np.ptp(t[kept]) < math.pi / s.imag:
        raise CompareError("the run is too short to tell the frequency of the drop: less than half a period is left")
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


def _rising_bubble(case: Case, result: Result) -> Errors:
    """The numbers of the benchmark that the run got to; `benchmark_relative` is the worst of the three bold ones."""
    name = case.fluid_names[_drop(case, result)]
    bubble = RISING_BUBBLE
    rise, roundness = _column(result, f"velocity_y_{name}"), _column(result, "circularity")
    height = _column(result, f"centre_y_{name}")
    t = _times(result, len(rise))
    errors = {}
    if t[-1] > bubble["time_of_rise_velocity_max"][1]:
        peak = int(np.argmax(rise))
        errors["rise_velocity_relative"] = float(rise[peak] / bubble["rise_velocity_max"] - 1)
        errors["time_of_rise_velocity"] = float(t[peak] / np.mean(bubble["time_of_rise_velocity_max"]) - 1)
    if t[-1] > bubble["time_of_circularity_min"]:
        errors["circularity_relative"] = float(roundness.min() / bubble["circularity_min"] - 1)
    if t[-1] >= 3.0 * (1 - 1e-9):
        errors["centre_height_relative"] = float(np.interp(3.0, t, height) / bubble["centre_height_at_3"] - 1)
    if not errors:
        raise CompareError("the run ends before the bubble is fastest, at t = 0.92: there is nothing to compare")
    judged = [errors[k] for k in ("rise_velocity_relative", "circularity_relative", "centre_height_relative")
              if k in errors]  # fmt: skip
    errors |= _size(case, result, case.fluid_names.index(name))[1]
    return {"benchmark_relative": max(judged, key=abs), **errors, "main": "benchmark_relative"}


# Velocity fields (n, dim) at a time, None of a steady solve, and the error that is judged
FIELDS: dict[str, Callable[[Case, Array, float | None], Array]] = {
    "couette": _couette_field,
    "poiseuille": _poiseuille_field,
    "startup_couette": _startup_couette_field,
    "startup_poiseuille": _startup_poiseuille_field,
    "decaying_channel": _decaying_channel_field,
    "taylor_couette": _taylor_couette_field,
    "taylor_green": _taylor_green_field,
    "taylor_green_3d": _taylor_green_3d_field,
}
MAIN_OF_FIELD = dict.fromkeys(FIELDS, "velocity_relative_l2") | {
    "startup_couette": "velocity_max",  # relative to the largest velocity, as Morris, Fox and Zhu have it
    "startup_poiseuille": "velocity_max",
}
COMPARISONS: dict[str, Callable[[Case, Result], Errors]] = {
    "slit": _slit,
    "couette": _field,
    "poiseuille": _field,
    "startup_couette": _field,
    "startup_poiseuille": _field,
    "decaying_channel": _field,
    "taylor_couette": _field,
    "annulus": _annulus,
    "square_duct": _square_duct,
    "sphere_array": _array(sphere_array_permeability),
    "cylinder_array": _array(cylinder_array_permeability),
    "taylor_green": _taylor_green,
    "taylor_green_3d": _taylor_green_3d,
    "lid_driven_cavity": _lid_driven_cavity,
    "permeability": _permeability,
    "flow_split": _flow_split,
    "two_layer_couette": _two_layer_couette,
    "two_layer_poiseuille": _two_layer_poiseuille,
    "two_layer_hydrostatics": _two_layer_hydrostatics,
    "static_drop": _static_drop,
    "contact_angle": _contact_angle,
    "capillary_wave": _capillary_wave,
    "oscillating_drop": _oscillating_drop,
    "rising_bubble": _rising_bubble,
}
_PLATES = {
    "lower": "y of the lower plate, m; without it the lower face of the box",
    "height": "distance of the plates, m; without it that to the upper face",
}
_LID = {"wall_velocity": "speed of the upper plate, m/s; without it that of the face y_max"}
_NU = {"nu": "kinematic viscosity, m2/s; without it that of the first fluid"}
_PUSH = {"acceleration": "along x, m/s2; without it that of the drive"}
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
    "rising_bubble": _DROP,
}  # fmt: skip
