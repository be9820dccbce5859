"""Errors of flows of one fluid, on results that are made up from the references themselves."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from isphcli.case.load import read_case
from isphcli.references import ducts, plates, published, vortices
from isphcli.references.compare import compare
from isphcli.references.errors import CompareError
from isphcli.references.single_phase import FIELDS, compare_snapshot, connected_parts
from isphcli.scene.build_geometry import build_geometry
from tests.references.results import WRONG, lattice, result_of, rows, the_case


@pytest.mark.parametrize(
    "name",
    ["couette", "startup_couette", "startup_poiseuille", "decaying_channel", "taylor_green_2d"],
)
def test_fields_that_are_the_reference_but_for_a_factor(name):
    case = the_case(name)
    x, _ = lattice(case)
    time = case.time.end / 3
    u = FIELDS[case.reference.kind](case, x, time)
    result = result_of(case, x, WRONG * u, time=time)
    if case.reference.kind == "taylor_green":
        nu = case.fluids["water"].nu
        result.pressure = vortices.taylor_green_2d(x, time, nu)[1] + 7.0  # a pressure has no zero
    errors = compare(case, result)
    assert errors["velocity_relative_l2"] == pytest.approx(WRONG - 1)
    assert errors["velocity_max"] == pytest.approx(WRONG - 1)
    assert errors.get("pressure_relative_l2", 0.0) < 1e-12
    assert errors["main"] in errors
    snapshot = compare_snapshot(case, x, u, time)
    assert snapshot["velocity_max"] == 0.0 and snapshot["main"] == errors["main"]


def test_the_fields_take_their_numbers_from_the_case():
    """Steady limits of the series, and the profile at half height, by hand."""
    case = the_case("startup_poiseuille", "time.end=9")
    y = np.array([[0.0, 5e-4]])
    assert FIELDS["startup_poiseuille"](case, y, 9.0)[0] == pytest.approx([1e-4 * 1e-3**2 / 8e-6, 0])
    case = the_case("startup_poiseuille", "drive={pressure_drop: {x: 2.5e-5}}", "reference.kind=poiseuille")
    assert FIELDS["poiseuille"](case, y, 0.0)[0, 0] == pytest.approx(
        1.25e-5
    )  # drop / (density length) = 1e-4
    case = the_case("startup_couette", "reference.parameters={wall_velocity: 3, lower: -1e-3, height: 3e-3}")
    assert FIELDS["couette"](case, y, 0.0)[0, 0] == pytest.approx(1.5)


def test_taylor_green_3d():
    """At t = 0 the reference is the initial field of the case itself."""
    case = the_case("taylor_green_3d", "particles.spacing=0.25")
    x, _ = lattice(case)
    sx, sy = np.sin(2 * np.pi * x[:, 0]), np.sin(2 * np.pi * x[:, 1])
    cx, cy, cz = np.cos(2 * np.pi * x).T
    u = np.stack([sx * cy * cz, -cx * sy * cz, 0 * cz], axis=1)
    errors = compare(case, result_of(case, x, WRONG * u, time=0.0))
    assert errors["velocity_relative_l2"] == pytest.approx(WRONG - 1)
    assert errors["kinetic_energy_relative"] == pytest.approx(WRONG**2 - 1)


def test_slit_with_and_without_a_known_force():
    case = the_case("slit")
    x, _ = lattice(case)
    u = np.stack([plates.slit_poiseuille(x[:, 1], 1e-4, 1.0, 1e-6), 0 * x[:, 1]], axis=1)
    k = 1e-4**2 / 12
    errors = compare(case, result_of(case, x, u, permeability={"x": WRONG * k}))
    assert errors["velocity_max"] < 1e-12
    assert errors[errors["main"]] == pytest.approx(WRONG - 1)
    case = the_case("slit", "drive={axes: [x]}")
    errors = compare(case, result_of(case, x, u, permeability=k / WRONG))
    assert set(errors) == {"permeability_relative", "permeability_relative_x", "main"}
    assert errors["permeability_relative"] == pytest.approx(1 / WRONG - 1)  # with its sign


@pytest.mark.parametrize("axis, middle", [("z", [5e-4, 5e-4, 5e-5]), ("x", [5e-5, 5e-4, 6e-4])])
def test_annulus(axis, middle):
    """Flux by the profile itself, 100 across; and a permeability that is too large by a factor."""
    a = "xyz".index(axis)
    size, force = np.full(3, 1e-3), np.zeros(3)
    size[a], force[a] = 1e-4, 0.1
    ring = f"cylinder: {{axis: {axis}, centre: {middle}, radius:"
    case = the_case(
        "annulus", f"geometry.box={size.tolist()}", f"drive.body_force={force.tolist()}", "particles.spacing=1e-5",
        f"geometry.shapes=[{{{ring} 3.9e-4}}, outside: true, is: solid}}, {{{ring} 2e-4}}, is: solid}}]",
    )  # fmt: skip
    x, _ = lattice(case)
    r = np.hypot(*np.delete(x - middle, a, axis=1).T)
    inside = (r > 2e-4) & (r < 3.9e-4)
    u = np.zeros_like(x)
    u[:, a] = np.where(inside, ducts.annulus(r, 2e-4, 3.9e-4, 0.1, 1e-6), 0.0)
    k = 1e-6 * u[:, a].mean() / 0.1
    errors = compare(case, result_of(case, x[inside], u[inside], permeability={axis: WRONG * k}))
    assert errors["velocity_max"] < 1e-12 and errors["permeability_relative"] == pytest.approx(WRONG - 1, abs=0.003)


def test_taylor_couette_turns_counterclockwise():
    """At the inner wall u = omega x r; at half the gap the formula by hand. A turning outer wall has its sign."""
    case = the_case("taylor_couette")
    x = np.array([[3.1, 2.1], [2.1, 3.6]])
    u = np.array([[0.0, 1.0], [-(4 - 1.5**2) / 3 / 1.5, 0.0]])
    errors = compare(case, result_of(case, x, u))
    assert errors["velocity_max"] < 1e-12
    case = the_case("taylor_couette", "geometry.shapes.0.angular_velocity=1")
    assert compare(case, result_of(case, x, (x - 2.1)[:, ::-1] * [-1, 1]))["velocity_max"] < 1e-12
    case = the_case("taylor_couette", "geometry.shapes=[]")
    with pytest.raises(CompareError, match="an annulus needs"):
        compare(case, result_of(case, x, u))


def test_square_duct_in_its_image():
    case = the_case("square_duct")
    h = 2.5e-6
    across = np.arange(2e-5 + h / 2, 1e-4, h)
    x = np.stack(np.meshgrid(np.arange(h / 2, 4e-5, h), across, across, indexing="ij"), -1).reshape(-1, 3)
    u = np.zeros_like(x)
    u[:, 0] = ducts.square_duct(x[:, 1] - 2e-5, x[:, 2] - 2e-5, 8e-5, 1e4, 1e-3)
    k = 0.56230806 * (4e-5) ** 4 / (1.2e-4) ** 2
    errors = compare(case, result_of(case, x, u, spacing=h, permeability={"x": k}))
    assert abs(errors["permeability_relative"]) < 1e-7
    assert errors["velocity_relative_l2"] < 1e-12
    # 32 across: the mean over the particles is 0.1 % high, 1 / (2 n^2) on each pair of walls
    assert abs(errors["centre_over_mean"]) < 2e-3


@pytest.mark.parametrize(
    "name, k", [("sphere_array", 1e-6 / (6 * np.pi * 7.442 * 0.37221029)), ("cylinder_array", 0.01 / 30.3506)]
)
def test_arrays(name, k):
    """The drag coefficients as published; the tables have four to six digits."""
    case = the_case(name)
    dim = len(case.geometry.box)
    errors = compare(case, result_of(case, permeability={"x": k, "y": WRONG * k}))
    assert abs(errors["permeability_relative_x"]) < 2e-5
    assert errors["permeability_relative"] == errors["permeability_relative_y"]
    tensor = k * (np.eye(dim) + 0.01 * np.eye(dim, k=1))
    for result in (
        result_of(case, permeability=tensor),
        result_of(case, permeability={"x": k}, tensor=tensor),
    ):
        errors = compare(case, result)
        assert errors["permeability_off_diagonal"] == pytest.approx(0.01)
        assert abs(errors["permeability_relative"]) < 2e-5


def test_published_permeabilities():
    """Those of the case are the voxel^2 values at 3 um; one number counts for the axes that it names."""
    case = the_case("berea_three_axes")
    geometry = SimpleNamespace(voxel_size=np.full(3, 3e-6), lower=np.zeros(3), upper=np.full(3, 128 * 3e-6))
    assert case.reference.value == pytest.approx([published.berea_permeability(a, 3e-6) for a in range(3)])
    measured = dict(zip("xyz", np.array(case.reference.value) * [1.0, WRONG, 1 / WRONG]))
    errors = compare(case, SimpleNamespace(permeability=measured, tensor=None, geometry=geometry))
    assert errors["permeability_relative_x"] == 0.0
    assert errors["permeability_relative"] == errors["permeability_relative_y"] == pytest.approx(WRONG - 1)
    case = the_case("berea", "reference.value=1e-12", "reference.axes=[x]")
    result = SimpleNamespace(permeability=1.1e-12, tensor=None, geometry=geometry)
    assert compare(case, result)["permeability_relative"] == pytest.approx(0.1)


def tubes(case, periods=16, h=1.0):
    """One particle per voxel of the two tubes, h the voxel, in the narrow tube and in the wide one."""
    narrow = np.stack(np.meshgrid(np.arange(2, 6), np.arange(2, 6), np.arange(periods)), -1).reshape(-1, 3)
    wide = np.stack(np.meshgrid(np.arange(9, 15), np.arange(9, 15), np.arange(periods)), -1).reshape(-1, 3)
    return (narrow + 0.5) * h, (wide + 0.5) * h


def test_flow_split():
    case = the_case("two_tubes", "particles.spacing=1e-5")
    narrow, wide = tubes(case, h=1e-5)
    x = np.concatenate([wide, narrow])
    u = np.zeros_like(x)
    u[: len(wide), 2] = 81 / len(wide)
    u[len(wide) :, 2] = 16 / len(narrow)
    result = result_of(case, x, u)
    assert len(np.unique(connected_parts(result))) == 2
    errors = compare(case, result)
    assert abs(errors["flow_split"]) < 1e-12
    u[len(wide) :, 2] *= 2
    errors = compare(case, result)
    assert errors["flow_split_1"] == pytest.approx(32 / 113 / (16 / 97) - 1)
    assert errors["flow_split"] == errors["flow_split_1"]
    with pytest.raises(CompareError, match="1 parts"):
        compare(case, result_of(case, wide, u[: len(wide)]))


def test_a_wall_separates_particles_that_are_close():
    """Two voxels beside each other with a wall of 0.02 between them: one part or two, by the wall alone."""
    text = (
        b"geometry: {box: [1, 1], periodic: [x], shapes: [%s]}\n"
        b"particles: {spacing: 0.25}\nfluids: {water: {density: 1, viscosity: 1}}\n"
        b"flow: stokes\ndrive: {axes: [x]}\n"
    )
    wall = b"{box: {lower: [-1, 0.49], upper: [2, 0.51]}, is: solid}"
    for inside, parts in ((b"", 1), (wall, 2)):
        case = read_case(text % inside, "case.yaml")
        assert len(np.unique(connected_parts(result_of(case)))) == parts


def test_cavity_from_its_own_tables():
    """u(y) and v(x) as splines through the tables: what is left is the interpolation."""
    case = the_case("lid_driven_cavity")
    x, _ = lattice(case)
    table = published.cavity(100)
    order = np.argsort(table["y"]), np.argsort(table["x"])
    u = CubicSpline(table["y"][order[0]], table["u"][order[0]])(x[:, 1])
    v = CubicSpline(table["x"][order[1]], table["v"][order[1]])(x[:, 0])
    errors = compare(case, result_of(case, x, np.stack([u, v], axis=1), time=15.0))
    assert errors["velocity_relative_l2"] < 0.005
    scaled = compare(case, result_of(case, x, WRONG * np.stack([u, v], axis=1), time=15.0))
    assert scaled["velocity_relative_l2"] == pytest.approx(WRONG - 1, abs=0.005)


@pytest.mark.parametrize("name", ["oscillating_slit", pytest.param("oscillating_pipe", marks=pytest.mark.slow)])
def test_amplitude_and_phase_of_an_oscillation(name):
    """Histories of the reference itself, then 3 % too strong and 0.05 radians late, with what is left of the start."""
    case = the_case(name)
    geometry = build_geometry(case)
    x, _ = lattice(case)
    x = x[geometry.phase(x) >= 0]
    period = 2 * np.pi / 100
    t = np.linspace(0, 3 * period, 400)[1:]
    slit = name == "oscillating_slit"
    share, axis = (1.0, "x") if slit else (np.pi / 4, "z")
    mean = (lambda t: plates.oscillating_slit_mean(t, 1e-3, 1e-6, 0.5, 100.0, True)) if slit else (
        lambda t: ducts.oscillating_pipe_mean(t, 5e-4, 1e-6, 0.5, 100.0, True))
    u = FIELDS[name](case, x, t[-1])

    def errors(flux, u=u, t=t):
        history = rows(time=t, **{f"superficial_velocity_{axis}": share * flux})
        return compare(case, result_of(case, x, u, time=t[-1], history=history))

    exact = errors(mean(t))
    assert exact["response_relative"] < 1e-12 and exact["velocity_over_largest"] == 0 and exact["main"] in exact
    # a wave that is late: its periodic part, which is what is left after the second period within exp(-pi^2 t / 4)
    late = errors(WRONG * mean(t - 0.05 / 100), WRONG * u)
    assert late["amplitude_relative"] == pytest.approx(WRONG - 1, abs=0.01)
    assert late["phase"] == pytest.approx(-0.05, abs=0.01)
    assert late["response_relative"] == pytest.approx(np.hypot(0.03, 0.05), abs=0.01)
    assert 0.005 < late["velocity_over_largest"] <= 0.03 + 1e-12
    with pytest.raises(CompareError, match="too short"):
        errors(mean(t[:100]), t=t[:100])


def test_an_oscillation_that_begins_as_it_goes_on():
    case = the_case("oscillating_slit", "reference.parameters.start=periodic")
    x, _ = lattice(case)
    expected = plates.oscillating_slit(x[:, 1], 0.0, 1e-3, 1e-6, 0.5, 100.0)
    assert np.array_equal(FIELDS["oscillating_slit"](case, x, 0.0)[:, 0], expected)
    at_rest = FIELDS["oscillating_slit"](the_case("oscillating_slit"), x, 0.0)
    assert np.abs(at_rest).max() < 1e-4 * np.abs(expected).max()
