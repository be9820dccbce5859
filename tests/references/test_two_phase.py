"""Errors of flows of two fluids, on results that are made up from the references themselves."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from isphcli.case.load import read_case
from isphcli.references import drops, plates
from isphcli.references.compare import compare
from isphcli.references.errors import CompareError, TooShortError
from isphcli.references.published import RISING_BUBBLE
from isphcli.references.two_phase import amplitude, fit_oscillation
from tests.references.results import WRONG, lattice, result_of, rows

TWO_FLUIDS = """\
geometry: {{box: [1, 1], periodic: [x], shapes: [{shape}], {walls}}}
particles: {{spacing: 0.02}}
fluids: {{brine: {{density: 3, viscosity: {mu[0]}}}, oil: {{density: {rho}, viscosity: {mu[1]}}}}}
interface: {{tension: 0.5, contact_angle: 60}}
{drive}
time: {{end: 3}}
reference: {{kind: {kind}, parameters: {parameters}}}
"""
LOWER_OIL = "{box: {lower: [0, 0], upper: [1, 0.4]}, is: oil}"


def ran(history, dim=2):
    """A run of this history, whose last row is what was measured at its end."""
    return SimpleNamespace(x=np.zeros((1, dim)), history=history, two_fluids=history[-1])


def two_fluids(kind, parameters="{}", shape=LOWER_OIL, walls="walls: {}", drive="", rho=1, mu=(1.0, 10.0)):
    text = TWO_FLUIDS.format(
        kind=kind, parameters=parameters, shape=shape, walls=walls, drive=drive, rho=rho, mu=mu
    )
    return read_case(text.encode(), "case.yaml")


def oil_below(case, at=0.4):
    x, _ = lattice(case)
    return x, (x[:, 1] < at).astype(np.int8)


def test_two_layers_take_their_numbers_from_the_case():
    """Oil, the second fluid, lies below: viscosity 10 under 0.4, 1 above. The velocity of the interface by hand."""
    case = two_fluids("two_layer_couette", walls="walls: {y_max: {velocity: [2, 0]}}")
    x, phase = oil_below(case)
    resistance = 0.4 / 10 + 0.6 / 1
    u = np.where(x[:, 1] < 0.4, x[:, 1] / 10, resistance - (1 - x[:, 1])) * 2 / resistance
    u = np.stack([u, 0 * u], axis=1)
    assert compare(case, result_of(case, x, u, phase=phase))["velocity_max"] < 1e-12
    errors = compare(case, result_of(case, x, WRONG * u, phase=phase))
    assert errors["velocity_relative_l2"] == pytest.approx(WRONG - 1)


@pytest.mark.parametrize(
    "drive, force", [("{pressure_drop: {x: 5}}", (5, 5)), ("{body_force: [2, 0]}", (2, 6))]
)
def test_two_layers_driven_by_pressure_or_by_weight(drive, force):
    """The wall shear stresses carry what drives the layers: 0.4 of the lower and 0.6 of the upper force."""
    case = two_fluids("two_layer_poiseuille", drive=f"drive: {drive}")
    x, phase = oil_below(case)
    u = plates.two_layer_poiseuille(x[:, 1], 1.0, 0.4, (10.0, 1.0), force)
    h = 1e-6
    foot = plates.two_layer_poiseuille(np.array([h, 1 - h]), 1.0, 0.4, (10.0, 1.0), force)
    assert 10 * foot[0] / h + foot[1] / h == pytest.approx(0.4 * force[0] + 0.6 * force[1], rel=1e-4)
    errors = compare(case, result_of(case, x, np.stack([WRONG * u, 0 * u], axis=1), phase=phase))
    assert errors["velocity_relative_l2"] == pytest.approx(WRONG - 1)


def test_two_layers_at_rest():
    case = two_fluids("two_layer_hydrostatics", drive="drive: {body_force: [0, -10]}")
    x, phase = oil_below(case)
    p = 7.0 - 10 * np.where(x[:, 1] < 0.4, 1 * (x[:, 1] - 0.4), 3 * (x[:, 1] - 0.4))
    u = np.zeros_like(x)
    u[3, 0] = 0.01
    errors = compare(case, result_of(case, x, u, phase=phase, pressure=p))
    assert errors["pressure_relative_l2"] < 1e-12 and errors["speed_relative"] == pytest.approx(0.01 / 10**0.5)
    errors = compare(case, result_of(case, x, u, phase=phase, pressure=-p))
    assert errors["pressure_relative_l2"] == pytest.approx(2)
    with pytest.raises(CompareError, match="one fluid only"):
        compare(case, result_of(case, x, u, phase=0 * phase, pressure=p))


DISK = "{sphere: {centre: [0.5, 0.5], radius: 0.2}, is: %s}"


@pytest.mark.parametrize("fluid, sign", [("brine", 1), ("oil", -1)])
@pytest.mark.parametrize("dim", [2, 3])
def test_static_drop(fluid, sign, dim):
    """The first fluid's pressure less the second's: positive where the drop is of the first."""
    case = two_fluids("static_drop", shape=DISK % fluid)
    other = {"brine": "oil", "oil": "brine"}[fluid]
    size = np.pi * 0.2**2 if dim == 2 else 4 / 3 * np.pi * 0.2**3
    columns = {f"volume_{fluid}": [size / 1.01, size], f"volume_{other}": 1 - size, "spurious_capillary_number": 3e-4}
    columns |= {"pressure_jump": [0.0, sign * WRONG * (dim - 1) * 0.5 / 0.2], "circularity": 0.98}
    history = rows(**columns)
    errors = compare(case, ran(history, dim))
    assert errors["laplace_relative"] == pytest.approx(WRONG - 1) and errors["main"] == "laplace_relative"
    assert errors["volume_relative"] == pytest.approx(0.01) and errors["spurious_capillary_number"] == 3e-4
    assert errors.get("circularity", -0.02) == pytest.approx(-0.02)


@pytest.mark.parametrize("angle", [60.0, 150.0])
@pytest.mark.parametrize("drop, through_first", [("brine", True), ("oil", False)])
def test_contact_angle_of_a_cap_of_particles(angle, drop, through_first):
    """Particles on a fine lattice inside the exact cap on the wall y_max; area 0.04, as in figure 4 of the paper."""
    case = two_fluids("contact_angle", f"{{wall: y_max, drop: {drop}}}")
    first = angle if through_first else 180 - angle
    case = replace(case, interface=replace(case.interface, contact_angle=first))
    cap = drops.drop_on_wall(0.04, angle)
    g = (np.arange(400) + 0.5) / 400
    x = np.stack(np.meshgrid(g, g, indexing="ij"), -1).reshape(-1, 2)
    inside = np.hypot(x[:, 0] - 0.5, 1 - x[:, 1] - cap["height"] + cap["radius"]) < cap["radius"]
    phase = np.where(inside, case.fluid_names.index(drop), 1 - case.fluid_names.index(drop))
    columns = {f"volume_{drop}": inside.mean(), f"centre_y_{drop}": x[inside, 1].mean()}
    columns |= {f"volume_{name}": 0.9 for name in case.fluid_names if name != drop}
    history = rows(contact_angle=WRONG * first, spurious_capillary_number=1e-5, **columns)
    errors = compare(case, result_of(case, x, phase=phase, history=history, spacing=1 / 400))
    assert errors["spurious_capillary_number"] == 1e-5
    expected = WRONG * angle if through_first else 180 - WRONG * (180 - angle)
    assert errors["angle_relative"] == pytest.approx(expected / angle - 1)
    assert abs(errors["angle_of_cap_relative"]) < 2e-3 and abs(errors["height_relative"]) < 0.02
    columns |= {f"centre_y_{drop}": 1 - 1e-4, "contact_angle": first}
    flat = compare(case, result_of(case, x, phase=phase, history=rows(**columns), spacing=1 / 400))
    assert flat["angle_of_cap_relative"] == pytest.approx(1 / angle - 1)


def test_a_cap_sits_on_a_face_that_is_a_wall():
    """Where the scene repeats along y that is x_min: by the height over a face that is none a cap of 60 degrees had
    179 (3D, walls along z)."""
    case = two_fluids("contact_angle", "{drop: brine}")
    case = replace(case, geometry=replace(case.geometry, periodic=("y",)))
    cap = drops.drop_on_wall(0.04, 60.0)
    end = {"volume_brine": 0.04, "volume_oil": 0.9, "centre_x_brine": cap["centre"], "centre_y_brine": 0.5}
    x = np.array([[cap["height"] - 0.01, 0.5], [0.8, 0.5]])
    phase = np.array([case.fluid_names.index("brine"), case.fluid_names.index("oil")])
    made = result_of(case, x, phase=phase, history=rows(contact_angle=60.0, **end), spacing=0.02)
    errors = compare(case, made)
    assert abs(errors["angle_of_cap_relative"]) < 1e-6 and abs(errors["height_relative"]) < 1e-6
    wrong = replace(case, reference=replace(case.reference, parameters={"drop": "brine", "wall": "y_min"}))
    with pytest.raises(CompareError, match="the face y_min is no wall: the scene repeats along y"):
        compare(wrong, made)


def test_the_error_of_the_angle_is_of_the_angle_that_is_printed():
    """The history has it every 20 steps: its last one is of an earlier state than the summary's."""
    case = two_fluids("contact_angle", "{drop: brine}")
    end = {"volume_brine": 0.04, "volume_oil": 0.9, "centre_y_brine": 0.05}
    history = [end | {"contact_angle": 80.0}, end | {"contact_angle": None}]
    x, phase = oil_below(case, 0.5)
    found = result_of(case, x, phase=1 - phase, history=history, two_fluids=end | {"contact_angle": 63.0})
    errors = compare(case, found)
    assert errors["angle_relative"] == pytest.approx(63 / 60 - 1)
    with pytest.raises(TooShortError, match="no contact angle at its end"):
        compare(case, result_of(case, x, phase=1 - phase, history=history))


def test_contact_angle_on_a_tilted_wall():
    """The exact cap on a wall turned by 30 degrees about (0.5, 0.2)."""
    up, along = np.array([-0.5, np.sqrt(0.75)]), np.array([np.sqrt(0.75), 0.5])
    case = two_fluids("contact_angle", f"{{tilt: 30, at: {up @ [0.5, 0.2]}, drop: brine}}")
    cap = drops.drop_on_wall(0.04, 60.0)
    g = (np.arange(400) + 0.5) / 400
    x = np.stack(np.meshgrid(g, g, indexing="ij"), -1).reshape(-1, 2)
    height, side = (x - [0.5, 0.2]) @ up, (x - [0.5, 0.2]) @ along
    inside = (np.hypot(side, height - cap["height"] + cap["radius"]) < cap["radius"]) & (height > 0)
    columns = {"volume_brine": inside.mean(), "volume_oil": 0.9}
    columns |= {f"centre_{a}_brine": x[inside, k].mean() for k, a in enumerate("xy")}
    history = rows(contact_angle=WRONG * 60.0, **columns)
    result = result_of(case, x, phase=np.where(inside, 0, 1), history=history, spacing=1 / 400)
    errors = compare(case, result)
    assert errors["angle_relative"] == pytest.approx(WRONG - 1) and "spurious_capillary_number" not in errors  # driven
    assert abs(errors["angle_of_cap_relative"]) < 2e-3 and abs(errors["height_relative"]) < 0.02


def test_amplitudes_of_particles():
    """A wave and an odd drop of particles on a lattice of 200; the crest is six spacings high, known within 3 %."""
    g = (np.arange(200) + 0.5) / 200
    x = np.stack(np.meshgrid(g, g, indexing="ij"), -1).reshape(-1, 2)
    case = two_fluids("capillary_wave", "{wavelength: 0.5}")
    for crest in (0.03, -0.03):
        below = x[:, 1] < 0.4 + crest * np.cos(4 * np.pi * x[:, 0])
        for phase in (below, ~below):  # whichever fluid is below
            assert amplitude(case, x, np.ones(len(x)), phase.astype(int)) == pytest.approx(crest, rel=0.03)
    case = two_fluids("oscillating_drop", "{mode: 3}", shape=DISK % "oil")
    r, angle = np.hypot(*(x - [0.4, 0.5]).T), np.arctan2(*(x - [0.4, 0.5]).T[::-1])
    phase = (r < 0.3 * (1 - 0.03 * np.cos(3 * angle))).astype(int)
    assert amplitude(case, x, np.ones(len(x)), phase) == pytest.approx(-0.009, rel=0.02)
    case = two_fluids("oscillating_drop", shape=DISK % "oil")
    assert amplitude(case, x, np.ones(len(x)), phase) == pytest.approx(0, abs=2e-4)


@pytest.mark.parametrize("mu", [(0.06, 0.02), (0.002, 0.02)])
def test_capillary_wave(mu):
    """The solution itself, one that is late, and one that starts with a velocity; fluids alike and unlike."""
    t = np.linspace(0, 1, 400)[1:]
    for start, at_start in (("amplitude", (0.01, 0.0)), ("speed", (0.0, 0.01))):
        case = two_fluids("capillary_wave", f"{{{start}: 0.01}}", rho=1, mu=mu)
        x, phase = oil_below(case)  # below: density 1
        below = (phase == 1).mean()
        layers = drops.Layer(1, mu[1], below), drops.Layer(3, mu[0], 1 - below)
        a = drops.capillary_wave(t, 1.0, 0.5, layers, start=at_start)
        result = result_of(case, x, phase=phase, history=rows(time=t, amplitude=a))
        errors = compare(case, result)
        assert errors["amplitude_relative_l2"] < 1e-12 and abs(errors["first_zero_relative"]) < 1e-12
        late = np.interp(t / 1.05, t, a)
        result.history = rows(time=t, amplitude=late)
        errors = compare(case, result)
        assert errors["first_zero_relative"] == pytest.approx(0.05, abs=1e-3)
        assert 0.05 < errors["amplitude_relative_l2"] < 0.5
    with pytest.raises(CompareError, match="no amplitude"):
        compare(case, result_of(case, x, phase=phase, history=rows(time=t)))
    with pytest.raises(CompareError, match="there is no wave"):
        compare(two_fluids("capillary_wave", mu=(0.06, 0.02)), result)


def test_imbibition():
    """The solution itself, and a flow that is 2 % slower; a fluid that is not there."""
    numbers = "width: 0.5, length: 0.6, start: 0.1"
    case = two_fluids("imbibition", f"{{{numbers}, angle: 60}}", rho=1, mu=(0.06, 0.02))
    volume = {"volume_brine": 0.3, "volume_oil": 0.4}
    slit = plates.SlitBetweenReservoirs(0.5, 0.6, 0.5, (0.25, 0.15))
    t = np.linspace(0, 1, 400)[1:]
    way, velocity = plates.slit_imbibition(t, slit, 2 * 0.5 * 0.5 / 0.5, (3, 1), (0.06, 0.02), 0.1)
    for factor in (1.0, 0.98):
        history = rows(time=t, mean_velocity_x=factor * velocity * 0.5 / 0.7, **volume)
        errors = compare(case, result_of(case, history=history))
        assert errors["gone_relative"] == pytest.approx(factor - 1.0, abs=1e-5)
        assert errors["velocity_relative"] == pytest.approx(factor - 1.0, abs=1e-5)
        assert errors["way_relative"] == pytest.approx((0.1 + factor * (way[-1] - 0.1)) / way[-1] - 1.0, abs=1e-5)


def test_oscillating_drop():
    """The eigenvalue itself in unequal steps, then 4 % too fast and 10 % too little damped; other scales too."""
    size = np.pi * 0.2**2
    for scale in (1.0, 1e-3):
        shape = DISK % "oil"
        case = two_fluids("oscillating_drop", "{wall_radius: 0.5, from: 0.1}", shape=shape, mu=(0.02, 0.01))
        s = drops.drop_oscillation(0.2, 0.5, (1, 3), (0.01, 0.02), wall=0.5)
        t = np.linspace(0, 1.2, 300)[1:] ** 1.3
        noise = 1 + 3 * np.exp(-40 * t)  # what decays before the fit begins

        def errors(rate, t=t, noise=noise, case=case, scale=scale):
            a = scale * noise * (np.exp(rate * t) * (1 - 0.3j)).real
            columns = dict(time=t, amplitude=a, volume_oil=size, volume_brine=1 - size)
            return compare(case, ran(rows(**columns)))

        assert errors(s)["rate_relative"] < 0.05
        found = errors(0.9 * s.real + 1.04j * s.imag)
        assert found["frequency_relative"] == pytest.approx(0.04, abs=0.01)
        assert found["damping_relative"] == pytest.approx(-0.1, abs=0.05)
        with pytest.raises(CompareError, match="too short"):
            errors(s, t=t[:30], noise=1.0)


@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_fit_of_a_decaying_oscillation(factor):
    t = np.sort(np.random.default_rng(0).random(200)) * 7
    s = -0.4 + 2.5j
    a = 1e-6 * (np.exp(s * t) * np.exp(0.7j)).real
    assert fit_oscillation(t, a, factor * s) == pytest.approx(s, abs=1e-5)


def test_rising_bubble():
    """Histories through the published series, with noise and one value on the way up that is 1 % high; a run that ends
    early has fewer numbers."""
    case, series = two_fluids("rising_bubble", shape=DISK % "oil"), RISING_BUBBLE["series"]
    t = np.linspace(0, 3, 3001)
    rise = CubicSpline([0, *series["time_of_velocity"]], [0, *series["rise_velocity"]])(t)
    height = CubicSpline([0, *series["time_of_height"]], [0.5, *series["centre_height"]])(t)
    noise = 3e-4 * np.random.default_rng(0).standard_normal(len(t))
    noise[850] = 3e-3
    columns = dict(time=t, velocity_y_oil=WRONG * (rise + noise), volume_oil=0.2, volume_brine=1.8)
    columns |= dict(circularity=1 - 0.0987 * np.sin(np.pi * t / 3.8), centre_y_oil=height)
    errors = compare(case, ran(rows(**columns)))
    assert errors["benchmark_relative"] == errors["rise_velocity_relative"] == pytest.approx(WRONG - 1, abs=3e-3)
    assert abs(errors["circularity_relative"]) < 1e-6 and abs(errors["centre_height_relative"]) < 2e-3
    assert abs(errors["time_of_rise_velocity"]) < 0.02 < abs(t[np.argmax(rise + noise)] / 0.9225 - 1)
    assert errors["rise_velocity_series"] == pytest.approx(WRONG - 1, abs=0.01)
    assert abs(errors["centre_height_series"]) < 1e-3
    early = compare(case, ran(rows(**columns)[:1500]))
    assert "centre_height_relative" not in early and "circularity_relative" not in early
    with pytest.raises(CompareError, match="ends before"):
        compare(case, ran(rows(**columns)[:500]))


def test_what_two_fluids_lack_is_named():
    history = rows(volume_oil=[0.1], volume_brine=0.9)
    case = two_fluids("static_drop", shape=DISK % "oil")
    with pytest.raises(CompareError, match="no pressure_jump at its end"):
        compare(case, ran(history))
