"""Errors of a result against the reference that its case names, for scenes with one fluid.

`compare(case, result)` reads of the result: x (n, dim) m, velocity (n, dim) m/s, pressure (n,) Pa, time s,
spacing m, geometry (a `geometry.Geometry`), permeability (None, m2, {axis: m2} or (dim, dim) m2) and tensor
((dim, dim) m2 or None), if it has one. What a reference needs and the case itself does not say stands in
`reference.parameters`.

All errors are relative and plain floats; those of permeabilities carry a sign. `velocity_relative_l2` is
|u - u_ref| / |u_ref| over the particles, `velocity_max` the largest deviation over the largest |u_ref|.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from . import references

if TYPE_CHECKING:
    from .case import Case

Array = np.ndarray
Errors = dict[str, Any]
AXES = "xyz"
LINKED = 1.5  # spacings: particles closer than this and in sight of each other are in the same pore
STENCIL = 2.5  # spacings: particles that a value on a line is interpolated from


class CompareError(ValueError):
    """A reference that lacks what its comparison needs, or a result that does not have it."""


def compare(case: Case, result: Any) -> Errors:
    """Errors by name; `main` is the name of the one that `reference.tolerance` bounds.

    Raises CompareError.
    """
    reference = case.reference
    if reference is None:
        raise CompareError("the case names no reference; add a block reference with its kind")
    comparison = COMPARISONS.get(reference.kind)
    if comparison is None:
        known = ", ".join(COMPARISONS)
        raise CompareError(f"reference.kind {reference.kind} is not compared here; known are {known}")
    errors = comparison(case, result)
    for name, value in errors.items():
        if name != "main" and not math.isfinite(value):
            raise CompareError(f"the error {name} is {value}: the result or the reference is not finite")
    return errors


def compare_snapshot(case: Case, x: Array, velocity: Array, time: float) -> Errors:
    """Velocity errors of one moment of a start-up flow or a Taylor-Green vortex; raises CompareError."""
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
    """Acceleration (dim,) of the drive; None where it names axes only, whose force is up to the run."""
    force = np.zeros(len(lengths))
    if case.drive is None:
        return force
    if case.drive.axes:
        return None
    if case.drive.body_force:
        force += case.drive.body_force
    for axis, drop in (case.drive.pressure_drop or {}).items():
        force[AXES.index(axis)] += drop / (_fluid(case).density * lengths[AXES.index(axis)])
    return force


def _box(case: Case, result: Any = None) -> tuple[Array, Array]:
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


def _permeability_errors(case: Case, result: Any, expected: dict[str, float]) -> Errors:
    """Signed errors of each axis that was measured; permeability_relative is the worst of them."""
    measured = _by_axis(case, result.permeability)
    errors = {
        f"permeability_relative_{axis}": float(k / expected[axis] - 1)
        for axis, k in measured.items()
        if axis in expected
    }
    if not errors:
        raise CompareError("the run gave no permeability along an axis of the reference; is there a drive?")
    worst = max(errors.values(), key=abs)
    tensor = getattr(result, "tensor", None)
    if tensor is None and np.ndim(result.permeability) == 2:
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
    if isinstance(permeability, dict):
        return {axis: float(k) for axis, k in permeability.items() if k is not None}
    if np.ndim(permeability) == 2:
        return dict(zip(AXES, map(float, np.diag(permeability))))
    return {_flow_axis(case): float(permeability)}


def _flow_axis(case: Case) -> str:
    """The axis along which the drive is strongest."""
    drive = case.drive
    if drive is None:
        raise CompareError("the case has no drive, so no axis of flow")
    if drive.axes:
        return drive.axes[0]
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


def _couette_field(case: Case, x: Array, time: float) -> Array:
    y, height = _plates(case, x)
    return _along_x(x, references.plane_couette(y, height, _lid_speed(case)))


def _poiseuille_field(case: Case, x: Array, time: float) -> Array:
    y, height = _plates(case, x)
    nu = _number(case, "nu", _fluid(case).nu)
    return _along_x(x, references.slit_poiseuille(y, height, _push(case), nu))


def _startup_couette_field(case: Case, x: Array, time: float) -> Array:
    y, height = _plates(case, x)
    nu = _number(case, "nu", _fluid(case).nu)
    return _along_x(x, references.startup_couette(y, time, height, nu, _lid_speed(case)))


def _startup_poiseuille_field(case: Case, x: Array, time: float) -> Array:
    y, height = _plates(case, x)
    nu = _number(case, "nu", _fluid(case).nu)
    return _along_x(x, references.startup_poiseuille(y, time, height, nu, _push(case)))


def _slit(case: Case, result: Any) -> Errors:
    """Permeability of a slit in its box, and the profile where the force is known."""
    lower, upper = _box(case)
    height = _plates(case, result.x)[1]
    k = references.slit_permeability(height) * height / float(upper[1] - lower[1])
    errors = _permeability_errors(case, result, {"x": k})
    if _force(case, upper - lower) is not None:
        errors |= _velocity_errors(result.velocity, _poiseuille_field(case, result.x, 0.0))
    return errors


def _field(case: Case, result: Any) -> Errors:
    """The velocity of every particle, for the kinds in FIELDS."""
    return compare_snapshot(case, result.x, result.velocity, result.time)


# -- ducts and arrays ------------------------------------------------------------------------------------


def _square_duct(case: Case, result: Any) -> Errors:
    """Permeability of a duct along x in its box, the profile where the force is known, and centre over mean.

    Parameters: side (m), and y, z (m) of the lower corner of the duct if it is not that of the box.
    """
    lower, upper = _box(case, result)
    side = _number(case, "side", float(upper[1] - lower[1]))
    corner = [_number(case, axis, float(foot)) for axis, foot in zip("yz", lower[1:])]
    area = float(np.prod((upper - lower)[1:]))
    errors = _permeability_errors(case, result, {"x": references.square_duct_flux(side, 1.0, 1.0) / area})
    y, z = result.x[:, 1] - corner[0], result.x[:, 2] - corner[1]
    profile = references.square_duct(y, z, side, 1.0, 1.0)
    force = _force(case, upper - lower)
    if force is not None:
        u = profile * force[0] / _fluid(case).nu
        errors |= _velocity_errors(result.velocity, _along_x(result.x, u))
    middle = np.array([*(lower + upper)[:1] / 2, corner[0] + side / 2, corner[1] + side / 2])
    centre = _at_points(result, middle[None], result.velocity[:, 0])[0]
    ratio = references.square_duct(np.array([side / 2]), np.array([side / 2]), side, 1.0, 1.0)[0]
    ratio *= side**2 / references.square_duct_flux(side, 1.0, 1.0)
    errors["centre_over_mean"] = float(centre / result.velocity[:, 0].mean() / ratio - 1)
    return errors


def _array(permeability: Callable[[float, float], float]) -> Callable[[Case, Any], Errors]:
    """Comparison with an array of one obstacle a cell. Parameters: fraction, and cell (m) if not the box."""

    def comparison(case: Case, result: Any) -> Errors:
        lower, upper = _box(case, result)
        cell = _number(case, "cell", float(upper[0] - lower[0]))
        k = permeability(_number(case, "fraction"), cell)
        return _permeability_errors(case, result, dict.fromkeys(AXES, k))

    return comparison


def _permeability(case: Case, result: Any) -> Errors:
    """A published permeability: one number for every axis, or one an axis."""
    value = case.reference.value  # type: ignore[union-attr]
    if value is None:
        raise CompareError("reference.kind permeability needs reference.value, in m2")
    expected = dict(zip(AXES, value)) if isinstance(value, tuple) else dict.fromkeys(AXES, value)
    return _permeability_errors(case, result, expected)


def _flow_split(case: Case, result: Any) -> Errors:
    """Shares of the flow of the connected parts of the fluid, the smallest first, against reference.value."""
    value = case.reference.value  # type: ignore[union-attr]
    if not isinstance(value, tuple) or min(value) <= 0:
        raise CompareError("reference.kind flow_split needs reference.value, the flow of each part: [16, 81]")
    along = getattr(result, "cell_velocity", result.velocity)[:, AXES.index(_flow_axis(case))]
    flows = np.sort(np.bincount(connected_parts(result), weights=along))[::-1][: len(value)][::-1]
    if len(flows) < len(value):
        raise CompareError(f"the fluid has {len(flows)} parts; reference.value names {len(value)}")
    expected = np.sort(value) / np.sum(value)
    parts = flows / along.sum() / expected - 1
    errors = {f"flow_split_{i}": float(part) for i, part in enumerate(parts, 1)}
    return {"flow_split": max(errors.values(), key=abs), **errors, "main": "flow_split"}


def connected_parts(result: Any) -> Array:
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


def _taylor_green_field(case: Case, x: Array, time: float) -> Array:
    return references.taylor_green_2d(x, time, **_vortex(case, 2))[0]


def _taylor_green(case: Case, result: Any) -> Errors:
    u, p = references.taylor_green_2d(result.x, result.time, density=_fluid(case).density, **_vortex(case, 2))
    return {
        **_velocity_errors(result.velocity, u),
        **_pressure_error(result.pressure, p),
        "kinetic_energy_relative": _energy_error(result.velocity, u),
        "main": MAIN_OF_FIELD["taylor_green"],
    }


def _taylor_green_3d_field(case: Case, x: Array, time: float) -> Array:
    vortex = _vortex(case, 3)
    _, fields = references.taylor_green_3d([time], n=32, **vortex)
    return references.spectral_velocity(fields[0], x, vortex["k"])


def _taylor_green_3d(case: Case, result: Any) -> Errors:
    u = _taylor_green_3d_field(case, result.x, result.time)
    errors = _velocity_errors(result.velocity, u)
    energy = _energy_error(result.velocity, u)
    return {**errors, "kinetic_energy_relative": energy, "main": MAIN_OF_FIELD["taylor_green_3d"]}


def _energy_error(u: Array, expected: Array) -> float:
    return float((u**2).sum() / (expected**2).sum() - 1)


def _lid_driven_cavity(case: Case, result: Any) -> Errors:
    """u on the vertical and v on the horizontal middle line, against the tables of Ghia et al.

    Over the points of both tables that are not on walls; `velocity_max` is over the speed of the lid.
    """
    lower, upper = _box(case)
    side, lid = float(upper[0] - lower[0]), _lid_speed(case)
    reynolds = round(lid * side / _number(case, "nu", _fluid(case).nu))
    try:
        table = references.cavity(reynolds)
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


def _at_points(result: Any, points: Array, values: Array) -> Array:
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


# Velocity fields (n, dim) at a time, and the error that is judged
FIELDS: dict[str, Callable[[Case, Array, float], Array]] = {
    "couette": _couette_field,
    "poiseuille": _poiseuille_field,
    "startup_couette": _startup_couette_field,
    "startup_poiseuille": _startup_poiseuille_field,
    "taylor_green": _taylor_green_field,
    "taylor_green_3d": _taylor_green_3d_field,
}
MAIN_OF_FIELD = dict.fromkeys(FIELDS, "velocity_relative_l2") | {
    "startup_couette": "velocity_max",  # relative to the largest velocity, as Morris, Fox and Zhu have it
    "startup_poiseuille": "velocity_max",
}

COMPARISONS: dict[str, Callable[[Case, Any], Errors]] = {
    "slit": _slit,
    "couette": _field,
    "poiseuille": _field,
    "startup_couette": _field,
    "startup_poiseuille": _field,
    "square_duct": _square_duct,
    "sphere_array": _array(references.sphere_array_permeability),
    "cylinder_array": _array(references.cylinder_array_permeability),
    "taylor_green": _taylor_green,
    "taylor_green_3d": _taylor_green_3d,
    "lid_driven_cavity": _lid_driven_cavity,
    "permeability": _permeability,
    "flow_split": _flow_split,
}
