"""Comparisons of flows of one fluid: with fields of velocity at a time, permeabilities, lines and shares of a flow."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

from ..domain import reduce
from ..domain.communicator import current
from ..domain.components import pair_components
from ..domain.exchange import NO_EXCHANGE, Exchange, NeighbourExchange
from ..domain.halo import nearest_image
from .ducts import (
    annulus,
    annulus_flux,
    oscillating_pipe,
    oscillating_pipe_mean,
    square_duct,
    square_duct_flux,
    taylor_couette,
)
from .errors import (
    AXES,
    Array,
    CompareError,
    Errors,
    OtherSampleError,
    TooShortError,
    acceleration_along_x,
    along_x,
    at_points,
    box_of,
    column,
    energy_error,
    first_fluid,
    flow_axis,
    given_force,
    lid_speed,
    moment,
    number,
    parameter,
    permeability_errors,
    plates,
    pressure_error,
    times,
    velocity_errors,
)
from .plates import (
    decaying_channel,
    oscillating_slit,
    oscillating_slit_mean,
    plane_couette,
    slit_permeability,
    slit_poiseuille,
    startup_couette,
    startup_poiseuille,
)
from .published import cavity
from .sample import other_sample
from .vortices import spectral_velocity, taylor_green_2d, taylor_green_3d

if TYPE_CHECKING:
    from ..case.blocks import Case
    from .result import Result


LINKED = 1.5  # spacings: particles closer than this and in sight of each other are in the same pore


# -- fields of velocity ---------------------------------------------------------------------------------


def couette_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, dim) m/s at x (n, dim), m: steady flow under a lid that slides (`plates.plane_couette`)."""
    y, height = plates(case, x)
    return along_x(x, plane_couette(y, height, lid_speed(case)))


def poiseuille_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, dim) m/s at x (n, dim), m: steady flow between plates under a force (`plates.slit_poiseuille`)."""
    y, height = plates(case, x)
    nu = number(case, "nu", first_fluid(case).nu)
    return along_x(x, slit_poiseuille(y, height, acceleration_along_x(case), nu))


def startup_couette_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, dim) m/s at x (n, dim), m: from rest under a lid, at a time, s (`plates.startup_couette`)."""
    y, height = plates(case, x)
    nu = number(case, "nu", first_fluid(case).nu)
    return along_x(x, startup_couette(y, moment(time), height, nu, lid_speed(case)))


def startup_poiseuille_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, dim) m/s at x (n, dim), m: from rest under a force, at a time, s (`plates.startup_poiseuille`)."""
    y, height = plates(case, x)
    nu = number(case, "nu", first_fluid(case).nu)
    return along_x(x, startup_poiseuille(y, moment(time), height, nu, acceleration_along_x(case)))


def decaying_channel_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, dim) m/s at x (n, dim), m: one mode between plates that decays (`plates.decaying_channel`)."""
    y, height = plates(case, x)
    nu = number(case, "nu", first_fluid(case).nu)
    mode = int(number(case, "mode", 1))
    return along_x(x, decaying_channel(y, moment(time), height, nu, number(case, "speed"), mode))


def _oscillation(case: Case) -> dict[str, Any]:
    """Viscosity, amplitude and frequency of a force acceleration * cos(omega t), and how the flow began."""
    start = parameter(case, "start", "rest")
    return {"nu": number(case, "nu", first_fluid(case).nu), "acceleration": number(case, "acceleration"),
            "omega": number(case, "omega"), "from_rest": start == "rest"}


def oscillating_slit_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, dim) m/s at x (n, dim), m: between plates under a force that oscillates (`plates.oscillating_slit`)."""
    y, height = plates(case, x)
    return along_x(x, oscillating_slit(y, moment(time), height, **_oscillation(case)))


def _pipe(case: Case) -> tuple[int, list[int], Array, float]:
    """Axis of a pipe, the axes across it, its centre (dim,) and its radius, by the first cylinder whose outside is
    solid."""
    shape = next((s for s in case.geometry.shapes if s.what == "solid" and s.cylinder and s.outside), None)
    if shape is None or shape.cylinder is None:
        raise CompareError("a pipe needs a cylinder whose outside is solid")
    lower, upper = box_of(case)
    axis, centre = AXES.index(shape.cylinder.axis), shape.cylinder.centre
    middle = (lower + upper) / 2 if centre is None else np.array(centre, dtype=float)
    return axis, [a for a in range(3) if a != axis], middle, shape.cylinder.radius


def oscillating_pipe_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, 3) m/s at x (n, 3), m: in a pipe under a force that oscillates (`ducts.oscillating_pipe`)."""
    axis, across, centre, radius = _pipe(case)
    u = np.zeros_like(x)
    r = np.hypot(*(x - centre)[:, across].T)
    u[:, axis] = oscillating_pipe(r, moment(time), radius, **_oscillation(case))
    return u


def _cylinders(case: Case) -> tuple[Any, Any, list[int], Array]:
    """The two shapes of an annulus, the axes across it and its centre, by the shapes of the case: the first disk or
    cylinder of solid, and the first whose outside is."""
    shapes = [s for s in case.geometry.shapes if s.what == "solid" and (s.cylinder or s.sphere)]
    inner = next((s for s in shapes if not s.outside), None)
    outer = next((s for s in shapes if s.outside), None)
    if inner is None or outer is None:
        raise CompareError("an annulus needs a solid disk or cylinder and one whose outside is solid")
    lower, upper = box_of(case)
    body = inner.cylinder or inner.sphere
    assert body is not None
    centre = (lower + upper) / 2 if body.centre is None else np.array(body.centre, dtype=float)
    across = [a for a in range(len(lower)) if not inner.cylinder or a != AXES.index(inner.cylinder.axis)]
    return inner, outer, across, centre


def _radius(shape: Any) -> float:
    return (shape.cylinder or shape.sphere).radius


def taylor_couette_field(case: Case, x: Array, time: float | None) -> Array:
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


def _vortex(case: Case, dim: int) -> dict[str, float]:
    lower, upper = box_of(case)
    if len(lower) != dim:
        raise CompareError(f"reference.kind {case.reference.kind} is for a scene in {dim}D")  # type: ignore[union-attr]
    return {
        "nu": number(case, "nu", first_fluid(case).nu),
        "speed": number(case, "speed"),
        "k": number(case, "k", 2 * math.pi / float(upper[0] - lower[0])),
    }


def taylor_green_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, 2) m/s at x (n, 2), m: decaying vortices, exact (`vortices.taylor_green_2d`)."""
    return taylor_green_2d(x, moment(time), **_vortex(case, 2))[0]


def taylor_green_3d_field(case: Case, x: Array, time: float | None) -> Array:
    """(n, 3) m/s at x (n, 3), m: decaying vortices by a spectral solution of 32^3 modes
    (`vortices.taylor_green_3d`)."""
    vortex = _vortex(case, 3)
    _, fields = taylor_green_3d([moment(time)], n=32, **vortex)
    return spectral_velocity(fields[0], x, vortex["k"])


# Velocity fields (n, dim) at a time, None of a steady solve, and the error that is judged
FIELDS: dict[str, Callable[[Case, Array, float | None], Array]] = {
    "couette": couette_field,
    "poiseuille": poiseuille_field,
    "startup_couette": startup_couette_field,
    "startup_poiseuille": startup_poiseuille_field,
    "oscillating_slit": oscillating_slit_field,
    "oscillating_pipe": oscillating_pipe_field,
    "decaying_channel": decaying_channel_field,
    "taylor_couette": taylor_couette_field,
    "taylor_green": taylor_green_field,
    "taylor_green_3d": taylor_green_3d_field,
}
MAIN_OF_FIELD = dict.fromkeys(FIELDS, "velocity_relative_l2") | {
    "startup_couette": "velocity_max",  # relative to the largest velocity, as Morris, Fox and Zhu have it
    "startup_poiseuille": "velocity_max",
}


def compare_snapshot(case: Case, x: Array, velocity: Array, time: float | None) -> Errors:
    """Velocity errors of one moment of a start-up flow or a Taylor-Green vortex, or of a steady flow, which may have no
    time; raises CompareError."""
    kind = case.reference.kind if case.reference else ""
    field = FIELDS.get(kind)
    if field is None:
        raise CompareError(f"reference.kind {kind} has no field at a time; known are {', '.join(FIELDS)}")
    return {**velocity_errors(velocity, field(case, np.asarray(x), time)), "main": MAIN_OF_FIELD[kind]}


def field_errors(case: Case, result: Result) -> Errors:
    """The velocity of every particle, for the kinds in FIELDS."""
    return compare_snapshot(case, result.x, result.velocity, result.time)


def oscillating_slit_errors(case: Case, result: Result) -> Errors:
    """Amplitude and phase of the flux through a slit along x over the last period, and the velocity at the end."""
    lower, upper = box_of(case)
    _, height = plates(case, result.x)
    t, mean = _through(result, "x", float(upper[1] - lower[1]) / height)
    expected = oscillating_slit_mean(t, height, **_oscillation(case))
    return _response(case, result, oscillating_slit_field, t, mean, expected)


def oscillating_pipe_errors(case: Case, result: Result) -> Errors:
    """The same of a pipe, along its axis."""
    lower, upper = box_of(case)
    axis, across, _, radius = _pipe(case)
    area = float(np.prod((upper - lower)[across]))
    t, mean = _through(result, AXES[axis], area / (math.pi * radius**2))
    expected = oscillating_pipe_mean(t, radius, **_oscillation(case))
    return _response(case, result, oscillating_pipe_field, t, mean, expected)


def _through(result: Result, axis: str, share: float) -> tuple[Array, Array]:
    """Times and mean velocities of the history by the flux; share: of the box over the fluid's cross section."""
    flux = column(result, f"superficial_velocity_{axis}")
    return times(result, len(flux)), flux * share


def _response(case: Case, result: Result, field: Callable[[Case, Array, float | None], Array], t: Array, mean: Array,
              expected: Array) -> Errors:
    """Errors of a mean velocity (steps,) that oscillates: cosine and sine that fit it over the last period, against
    those that fit what is expected at the same times. The phase is in radians, late where it is negative; the velocity
    at the end is over its largest value in a period."""
    oscillation = _oscillation(case)
    period = 2 * math.pi / oscillation["omega"]
    last = t > t[-1] - period * (1 + 1e-9)
    if t[-1] - t[0] < period or last.sum() < 8:
        raise TooShortError("the run is too short to tell amplitude and phase: give it a period, in 8 steps or more")
    weight = np.sqrt(np.gradient(t)[last])
    waves = np.exp(-1j * oscillation["omega"] * t[last])
    basis = np.stack([waves.real, waves.imag], axis=1) * weight[:, None]
    fits = [np.linalg.lstsq(basis, f[last] * weight, rcond=None)[0] @ [1, 1j] for f in (mean, expected)]
    ratio = complex(fits[0] / fits[1])
    end = moment(result.time)
    fields = [field(case, result.x, end - part * period) for part in np.arange(0, 1, 0.05)]
    off, *sizes = reduce.largest_of_each(np.abs(result.velocity - fields[0]), *map(np.abs, fields))
    return {
        "response_relative": abs(ratio - 1),
        "amplitude_relative": abs(ratio) - 1,
        "phase": math.atan2(ratio.imag, ratio.real),
        "velocity_over_largest": off / max(sizes),
        "main": "response_relative",
    }


# -- slits, ducts and arrays -----------------------------------------------------------------------------


def slit_errors(case: Case, result: Result) -> Errors:
    """Permeability of a slit in its box, and the profile where the force is known."""
    lower, upper = box_of(case)
    height = plates(case, result.x)[1]
    k = slit_permeability(height) * height / float(upper[1] - lower[1])
    errors = permeability_errors(case, result, {"x": k})
    if given_force(case, upper - lower) is not None:
        errors |= velocity_errors(result.velocity, poiseuille_field(case, result.x, 0.0))
    return errors


def annulus_errors(case: Case, result: Result) -> Errors:
    """Permeability of an annulus along its axis, of the area of the box, and the profile where the force is known."""
    inner, outer, across, centre = _cylinders(case)
    lower, upper = box_of(case)
    radii = _radius(inner), _radius(outer)
    axis = next(iter(set(range(len(lower))) - set(across)))
    k = annulus_flux(*radii, 1.0, 1.0) / float(np.prod((upper - lower)[across]))
    errors = permeability_errors(case, result, {AXES[axis]: k})
    force = given_force(case, upper - lower)
    if force is not None:
        r = np.hypot(*(result.x - centre)[:, across].T)
        expected = np.zeros_like(result.x)
        expected[:, axis] = annulus(r, *radii, force[axis], first_fluid(case).nu)
        errors |= velocity_errors(result.velocity, expected)
    return errors


def square_duct_errors(case: Case, result: Result) -> Errors:
    """Permeability of a duct along x in its box, the profile where the force is known, and centre over mean.

    Parameters: side (m), and y, z (m) of the lower corner of the duct if it is not that of the box.
    """
    lower, upper = box_of(case, result)
    side = number(case, "side", float(upper[1] - lower[1]))
    corner = [number(case, axis, float(foot)) for axis, foot in zip("yz", lower[1:])]
    area = float(np.prod((upper - lower)[1:]))
    errors = permeability_errors(case, result, {"x": square_duct_flux(side, 1.0, 1.0) / area})
    y, z = result.x[:, 1] - corner[0], result.x[:, 2] - corner[1]
    profile = square_duct(y, z, side, 1.0, 1.0)
    force = given_force(case, upper - lower)
    if force is not None:
        u = profile * force[0] / first_fluid(case).nu
        errors |= velocity_errors(result.velocity, along_x(result.x, u))
    middle = np.array([*(lower + upper)[:1] / 2, corner[0] + side / 2, corner[1] + side / 2])
    centre = at_points(result, middle[None], result.velocity[:, 0])[0]
    ratio = square_duct(np.array([side / 2]), np.array([side / 2]), side, 1.0, 1.0)[0]
    ratio *= side**2 / square_duct_flux(side, 1.0, 1.0)
    errors["centre_over_mean"] = float(centre / reduce.mean(result.velocity[:, 0]) / ratio - 1)
    return errors


def array_errors(permeability: Callable[[float, float], float]) -> Callable[[Case, Result], Errors]:
    """Comparison with an array of one obstacle a cell. Parameters: fraction, and cell (m) if not the box."""

    def comparison(case: Case, result: Result) -> Errors:
        lower, upper = box_of(case, result)
        cell = number(case, "cell", float(upper[0] - lower[0]))
        k = permeability(number(case, "fraction"), cell)
        return permeability_errors(case, result, dict.fromkeys(AXES, k))

    return comparison


def published_permeability_errors(case: Case, result: Result) -> Errors:
    """A published permeability: one number along `reference.axes`, or one per axis. Raises OtherSampleError."""
    value = case.reference.value  # type: ignore[union-attr]
    if value is None:
        raise CompareError("reference.kind permeability needs reference.value, in m2")
    other = other_sample(case, result.geometry)
    if other is not None:
        raise OtherSampleError(other)
    axes = case.reference.axes or AXES  # type: ignore[union-attr]
    values = zip(AXES, value) if isinstance(value, tuple) else ((axis, value) for axis in axes)
    expected = {axis: k for axis, k in values if axis in axes}
    return permeability_errors(case, result, expected)


def flow_split_errors(case: Case, result: Result) -> Errors:
    """Shares of the flow of the connected parts of the fluid, the smallest first, against reference.value."""
    value = case.reference.value  # type: ignore[union-attr]
    if not isinstance(value, tuple) or min(value) <= 0:
        raise CompareError("reference.kind flow_split needs reference.value, the flow of each part: [16, 81]")
    along = result.cell_velocity[:, AXES.index(flow_axis(case))]
    flows = np.sort(reduce.total_by(connected_parts(result), along))[::-1][: len(value)][::-1]
    if len(flows) < len(value):
        raise CompareError(f"the fluid has {len(flows)} parts; reference.value names {len(value)}")
    expected = np.sort(value) / np.sum(value)
    parts = flows / reduce.total(along) / expected - 1
    errors = {f"flow_split_{i}": float(part) for i, part in enumerate(parts, 1)}
    return {"flow_split": max(errors.values(), key=abs), **errors, "main": "flow_split"}


def connected_parts(result: Result) -> Array:
    """Number (n,) of the connected part of the fluid that each particle is in; walls separate. Parts are those of all
    processes."""
    geometry = result.geometry
    lower, period = np.asarray(geometry.lower), np.asarray(geometry.upper) - geometry.lower
    around = np.array(geometry.periodic)
    x = result.x - lower
    x = np.where(around, np.mod(x, period), x)
    x = np.where(around & (x >= period), 0.0, x)
    sides = np.where(around, period, 0.0)
    exchange: Exchange = NO_EXCHANGE
    n = len(x)
    if current().size > 1:
        exchange, remote = _beside(x, sides, LINKED * result.spacing)
        x = np.concatenate([x, remote])
    i, j = _tree(x, sides).query_pairs(LINKED * result.spacing, output_type="ndarray").T
    step = nearest_image(x[j] - x[i], period, around)
    start = x[i] + lower
    sees = geometry.crossing(start, start + step) >= 1.0
    graph = coo_matrix((np.ones(sees.sum(), dtype=np.int8), (i[sees], j[sees])), shape=(len(x),) * 2)
    rows = (graph + graph.T).tocsr()[:n]
    return pair_components(rows.indptr.astype(np.int64), rows.indices.astype(np.int32), exchange=exchange)[1]


def _tree(x: Array, sides: Array) -> cKDTree:
    return cKDTree(x, boxsize=sides if sides.any() else None)


def _beside(x: Array, sides: Array, reach: float) -> tuple[Exchange, Array]:
    """The particles of other processes within a reach of those of this one, x (n, dim): the exchange that brings their
    values, and their places (m, dim). sides: (dim,) of a box at 0, m, 0 of an axis that is not periodic."""
    ranks = current()
    first = sum(ranks.collect(len(x))[: ranks.rank])
    ids = first + np.arange(len(x))
    # of the other processes' particles those count that lie near the corners of the box of these
    boxes = [box for rank, box in enumerate(ranks.collect((x.min(axis=0), x.max(axis=0)) if len(x) else None))
             if box is not None and rank != ranks.rank]
    near = np.zeros(len(x), np.bool_)
    for low, high in boxes:
        off = np.abs(nearest_image(x - (low + high) / 2, np.where(sides > 0.0, sides, 1.0), sides > 0.0))
        near |= (off <= (high - low) / 2 + reach).all(axis=1)
    there, of_them, owner = reduce.together(x[near], ids[near], np.full(near.sum(), ranks.rank))
    other = owner != ranks.rank
    there, of_them, owner = there[other], of_them[other], owner[other]
    seen = np.zeros(len(there), np.bool_)
    if len(x) and len(there):
        distance, _ = _tree(x, sides).query(there, distance_upper_bound=reach * (1 + 1e-9))
        seen = np.isfinite(distance)
    exchange = NeighbourExchange.of_sites(ranks.raw, of_them[seen], owner[seen], ids)  # type: ignore[attr-defined]
    return exchange, there[seen]


# -- vortices and the cavity -----------------------------------------------------------------------------


def taylor_green_errors(case: Case, result: Result) -> Errors:
    """Errors of velocity, pressure and kinetic energy of a result at its time. Raises CompareError."""
    u, p = taylor_green_2d(result.x, moment(result.time), density=first_fluid(case).density, **_vortex(case, 2))
    return {
        **velocity_errors(result.velocity, u),
        **pressure_error(result.pressure, p),
        "kinetic_energy_relative": energy_error(result.velocity, u),
        "main": MAIN_OF_FIELD["taylor_green"],
    }


def taylor_green_3d_errors(case: Case, result: Result) -> Errors:
    """Errors of velocity and kinetic energy of a result at its time. Raises CompareError."""
    u = taylor_green_3d_field(case, result.x, result.time)
    errors = velocity_errors(result.velocity, u)
    energy = energy_error(result.velocity, u)
    return {**errors, "kinetic_energy_relative": energy, "main": MAIN_OF_FIELD["taylor_green_3d"]}


def lid_driven_cavity_errors(case: Case, result: Result) -> Errors:
    """u on the vertical and v on the horizontal middle line, against the tables of Ghia et al.

    Over the points of both tables that are not on walls; `velocity_max` is over the speed of the lid.
    """
    lower, upper = box_of(case)
    side, lid = float(upper[0] - lower[0]), lid_speed(case)
    reynolds = round(lid * side / number(case, "nu", first_fluid(case).nu))
    try:
        table = cavity(reynolds)
    except KeyError:
        raise CompareError(f"no table for Reynolds number {reynolds}; there are 100, 400 and 1000") from None
    deviations, values = [], []
    for component, places, expected in ((0, table["y"], table["u"]), (1, table["x"], table["v"])):
        inside = (places > 0) & (places < 1)
        points = np.full((inside.sum(), 2), 0.5)
        points[:, 1 - component] = places[inside]
        u = at_points(result, lower + side * points, result.velocity[:, component])
        deviations.append(u / lid - expected[inside])
        values.append(expected[inside])
    deviation, value = np.concatenate(deviations), np.concatenate(values)
    return {
        "velocity_relative_l2": float(np.linalg.norm(deviation) / np.linalg.norm(value)),
        "velocity_max": float(np.abs(deviation).max()),
        "main": "velocity_relative_l2",
    }
