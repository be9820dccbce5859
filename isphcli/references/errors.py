"""Functions for comparisons of all kinds: numbers of the case, and errors of velocities, pressures, permeabilities.

All errors are relative and plain floats; those of permeabilities carry a sign. `velocity_relative_l2` is
|u - u_ref| / |u_ref| over the particles, `velocity_max` the largest deviation over the largest |u_ref|. Errors of
fields are of the particles of all processes, each of which gives its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from ..case import forcing
from ..domain import reduce

if TYPE_CHECKING:
    from ..case.blocks import Case
    from .result import Result

Array = np.ndarray
Errors = dict[str, Any]
AXES = "xyz"


STENCIL = 2.5  # spacings: particles that a value on a line is interpolated from


class CompareError(ValueError):
    """A reference that lacks what its comparison needs, or a result that does not have it."""


class NotComparedError(CompareError):
    """A comparison that cannot be made, although neither case nor run is wrong."""


class OtherSampleError(NotComparedError):
    """A published value of another body than that of the run."""


class TooShortError(NotComparedError):
    """A run that ends, or was ended, before the time of the comparison."""


# -- numbers of the case --------------------------------------------------------------------------------


def parameter(case: Case, name: str, derived: Any = None) -> Any:
    """reference.parameters.<name>, or `derived`, a value of other keys; CompareError where both are missing."""
    assert case.reference is not None
    value = case.reference.parameters.get(name, derived)
    if value is None:
        raise CompareError(f"reference.kind {case.reference.kind} needs reference.parameters.{name}")
    return value


def number(case: Case, name: str, derived: float | None = None) -> float:
    """A parameter of the reference of a case that is a number, `derived` where it is not given. Raises CompareError."""
    value = parameter(case, name, derived)
    if isinstance(value, str) or not math.isfinite(value):
        raise CompareError(f"reference.parameters.{name} is {value!r}; give a number")
    return float(value)


def first_fluid(case: Case) -> Any:
    """The fluid of a case of one fluid, of two the first (`case.blocks.Fluid`)."""
    return case.fluids[case.fluid_names[0]]


def given_force(case: Case, lengths: Array) -> Array | None:
    """Acceleration (dim,) of the drive; None where it names axes or a velocity, for which the run finds the force."""
    return forcing.acceleration(case, lengths) if forcing.force_is_given(case) else None


def flow_axis(case: Case) -> str:
    """The axis along which the drive is strongest."""
    axis = forcing.flow_axis(case)
    if axis is None:
        raise CompareError("the case has no drive, so no axis of flow")
    return AXES[axis]


def box_of(case: Case, result: Result | None = None) -> tuple[Array, Array]:
    """Lower and upper corner of the scene."""
    if case.geometry.box is None:
        if result is None:
            raise CompareError(f"reference.kind {case.reference.kind} needs a box, not voxels")  # type: ignore[union-attr]
        return np.asarray(result.geometry.lower), np.asarray(result.geometry.upper)
    lower = np.array(case.geometry.origin or np.zeros(len(case.geometry.box)), dtype=float)
    return lower, lower + case.geometry.box


def plates(case: Case, x: Array) -> tuple[Array, float]:
    """Distance (n,) from the plate at the lower y, and the distance of the plates."""
    lower, upper = box_of(case)
    foot = number(case, "lower", float(lower[1]))
    return x[:, 1] - foot, number(case, "height", float(upper[1] - foot))


def lid_speed(case: Case) -> float:
    """Speed of the face y_max along x; of one that changes it has to be given."""
    lid = None if forcing.walls_change(case) else forcing.wall_velocities(case, len(AXES)).get(4)
    return number(case, "wall_velocity", None if lid is None else float(lid[0]))


def acceleration_along_x(case: Case) -> float:
    """Acceleration along x."""
    force = given_force(case, np.subtract(*box_of(case)[::-1]))
    return number(case, "acceleration", None if force is None else float(force[0]))


# -- measures --------------------------------------------------------------------------------------------


def velocity_errors(u: Array, expected: Array) -> Errors:
    """u, expected: (n, k), or expected (n, dim) with the part of the flow that is compared."""
    deviation = np.linalg.norm(np.asarray(u) - expected, axis=1)
    size = np.linalg.norm(expected, axis=1)
    fastest = reduce.largest(size)
    if fastest == 0.0:
        raise CompareError("the reference is at rest: there is nothing to be relative to")
    return {
        "velocity_relative_l2": float(reduce.norm(deviation) / reduce.norm(size)),
        "velocity_max": float(reduce.largest(deviation) / fastest),
    }


def pressure_error(p: Array, expected: Array) -> Errors:
    """A pressure is known up to a constant: both without their mean."""
    expected = expected - reduce.mean(expected)
    deviation = p - reduce.mean(p) - expected
    return {"pressure_relative_l2": float(reduce.norm(deviation) / reduce.norm(expected))}


def energy_error(u: Array, expected: Array) -> float:
    """Signed error of the kinetic energy, relative; u, expected: (n, dim) m/s."""
    return float(reduce.total(u**2).sum() / reduce.total(expected**2).sum() - 1)


def permeability_errors(case: Case, result: Result, expected: dict[str, float]) -> Errors:
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
    return {flow_axis(case): float(permeability)}


def along_x(x: Array, u: Array) -> Array:
    """Velocities (n, dim) of which u (n,) is the component along x and the others are zero."""
    return np.stack([u, *[np.zeros_like(u)] * (x.shape[1] - 1)], axis=1)


def moment(time: float | None) -> float:
    """The time of a result that a field depends on."""
    if time is None:
        raise CompareError("the reference depends on the time, and a steady solve has none; use flow: navier_stokes")
    return time


def at_points(result: Result, points: Array, values: Array) -> Array:
    """Values (n,) of the particles at points (m, dim): a local least squares fit, weights exp(-r^2).

    Of a quadratic where there are neighbours enough, else linear: a linear fit cuts the peak of a profile by
    about u'' dx^2 / 4, 1 % with 16 particles across a duct. The particles are those of all processes.
    """
    dim = result.x.shape[1]
    x, values = _near(result.x, values, points, STENCIL * result.spacing, 3 * dim)
    tree = cKDTree(x)
    upper = np.triu_indices(dim)
    out = np.empty(len(points))
    for k, point in enumerate(points):
        near = tree.query_ball_point(point, STENCIL * result.spacing)
        if len(near) <= 2 * dim:
            near = tree.query(point, k=min(3 * dim, len(x)))[1]
        offset = (x[near] - point) / result.spacing
        columns = [np.ones((len(offset), 1)), offset]
        if len(near) >= 2 * (1 + dim + len(upper[0])):
            columns.append((offset[:, :, None] * offset[:, None, :])[:, upper[0], upper[1]])
        weight = np.exp(-(offset**2).sum(axis=1))
        basis = np.concatenate(columns, axis=1) * weight[:, None]
        out[k] = np.linalg.lstsq(basis, values[near] * weight, rcond=None)[0][0]
    return out


def _near(x: Array, values: Array, points: Array, reach: float, least: int) -> tuple[Array, Array]:
    """Places and values of the particles of all processes that lie within a reach of one of the points, and of at least
    so many that are nearest to each: few, and the same on all processes."""
    near = np.zeros(len(x), np.bool_)
    if len(x):
        tree = cKDTree(x)
        near[tree.query(points, k=min(least, len(x)))[1]] = True
        for found in tree.query_ball_point(points, reach):
            near[found] = True
    there, of_them = reduce.together(x[near], values[near])
    return there, of_them


def column(result: Result, name: str) -> Array:
    """A column of the history, (steps,)."""
    values = [row[name] for row in result.history if row.get(name) is not None]
    if not values:
        raise CompareError(f"the run left no {name} in its history; the reference needs it")
    return np.array(values, dtype=float)


def at_end(result: Result, name: str) -> float:
    """A measure of two fluids at the end of the run, as it prints it. Raises CompareError."""
    value = result.two_fluids.get(name)
    if value is None:
        raise CompareError(f"the run has no {name} at its end; the reference needs it")
    return float(value)


def times(result: Result, count: int) -> Array:
    """Times of the last steps of the history, (count,) s."""
    return column(result, "time")[-count:]
