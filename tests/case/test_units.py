"""Units in values: what they are converted to, and which are refused at their line."""

import pytest

from isphcli.case.load import dump_case, read_case
from isphcli.case.units import UnitError, is_quantity, number_in
from isphcli.case.yaml import CaseError

CASE = """
geometry:
  box: [1 mm, 0.002, 3e3 um]
  periodic: [x, y, z]
  slip_length: 5 nm
  shapes:
    - {sphere: {centre: [0.5 mm, 1 mm, 1 mm], radius: 0.25 mm}, is: solid}
particles: {spacing: 50 um}
fluids: {water: {density: 1 g/cm3, viscosity: 1 cP}, oil: {density: 850, kinematic_viscosity: 5 cSt}}
interface: {tension: 30 mN/m, contact_angle: 1 rad}
drive: {pressure_drop: {x: 1 kPa, y: "0.5*cos(2*pi*t)"}, body_force: [0, 0, -9.81 m/s^2]}
time: {end: 5 ms}
"""


def read(tmp_path, text=CASE, *overrides):
    return read_case(text.encode(), tmp_path / "case.yaml", overrides)


def test_values_with_units_are_those_of_their_keys(tmp_path):
    case = read(tmp_path)
    assert case.geometry.box == (1e-3, 0.002, 3e-3) and case.particles.spacing == 50e-6
    assert case.geometry.shapes[0].sphere.radius == 250e-6 and case.geometry.slip_length == 5e-9
    water, oil = case.fluids.values()
    assert (water.density, water.viscosity, oil.kinematic_viscosity) == (1000.0, 1e-3, 5e-6)
    assert case.interface.tension == 0.03 and case.interface.contact_angle == pytest.approx(57.29577951308232)
    assert dict(case.drive.pressure_drop) == {"x": 1000.0, "y": "0.5*cos(2*pi*t)"}
    assert case.drive.body_force == (0.0, 0.0, -9.81) and case.time.end == 5e-3
    assert read(tmp_path, CASE, "particles.spacing=20 um").particles.spacing == 20e-6


def test_a_case_is_dumped_in_the_units_of_its_keys(tmp_path):
    case = read(tmp_path)
    assert read(tmp_path, dump_case(case)) == case and "1 kPa" not in dump_case(case)


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("50 um", "50 Pa", 8, "particles.spacing: 'Pa' is a unit of pressure, and not of length; .*2.25 um"),
        ("1 cP", "1 m", 9, "fluids.water.viscosity: 'm' is a unit of length, and not of dynamic viscosity"),
        ("5 cSt", "5 cP", 9, "not of kinematic viscosity"),
        ("30 mN/m", "30 mN", 10, "interface.tension: 'mN' is a unit of .* and not of surface tension"),
        ("1 kPa", "1 kN", 11, "drive.pressure_drop.x: .* not of pressure"),
        ("-9.81 m/s^2", "-9.81 m/s", 11, "drive.body_force.2: 'm/s' is a unit of velocity, and not of acceleration"),
        ("5 ms", "5 mm", 12, "time.end: 'mm' is a unit of length, and not of time"),
        ("50 um", "50 furlongz", 8, "the unit 'furlongz' is not known"),
        ("50 um", "-50 um", 8, "must be above 0"),
        ("50 um", "50 um, jitter: 20 um", 8, "particles.jitter: '20 um' has a unit, and this number has none"),
        ("50 um", "50 degC", 8, "temperature"),
        ("50 um", "1e400 um", 8, "is not finite"),
    ],
)
def test_wrong_units_are_told_with_their_line(tmp_path, old, new, line, message):
    with pytest.raises(CaseError, match=message) as error:
        read(tmp_path, CASE.replace(old, new, 1))
    assert f"case.yaml:{line}:" in str(error.value)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("2.25 um", "m", 2.25e-6),
        ("2.25um", "m", 2.25e-6),
        ("2.25 \u00b5m", "m", 2.25e-6),
        ("2.25 \u03bcm", "m", 2.25e-6),
        ("1e-6", "m", 1e-6),
        ("1 kg/m3", "kg/m3", 1.0),
        ("1 kg m^-3", "kg/m3", 1.0),
        ("1 mPa s", "Pa s", 1e-3),
        ("1 mPa*s", "Pa s", 1e-3),
        ("1 mm2/s", "m2/s", 1e-6),
        ("60 rpm", "rad/s", 6.283185307179586),
        ("1 inch", "m", 0.0254),
        ("1 day", "s", 86400.0),
    ],
)
def test_what_people_write(text, unit, value):
    assert number_in(text, unit) == pytest.approx(value, rel=1e-14)


def test_powers_of_ten_are_exact():
    """A number with a unit is the number that the digits stand for, as one written out is."""
    for digits in ("2.25", "3.1", "0.7", "5.3", "12.34"):
        assert number_in(f"{digits} um", "m") == float(f"{digits}e-6")


def test_hertz_are_no_rotation():
    with pytest.raises(UnitError, match="turns or radians"):
        number_in("1 Hz", "rad/s")


@pytest.mark.parametrize("text", ["1e-6", "1_000", "sin(x)", "2*t", "0.5*cos(2*pi*t)", "um", "", "1 2", "1 e-6"])
def test_what_is_no_number_with_a_unit(text):
    assert not is_quantity(text)


def test_units_cost_nothing_where_there_are_none(tmp_path):
    """pint is imported by the first unit and not before."""
    import subprocess
    import sys

    code = (
        "import sys; from isphcli.case.load import read_case; "
        "read_case(b'geometry: {box: [1, 1], periodic: [x]}\\nparticles: {spacing: 0.1}\\n"
        "fluids: {a: {density: 1, viscosity: 1}}\\ndrive: {body_force: [1, 0]}\\ntime: {end: 1}', 'c.yaml'); "
        "print('pint' in sys.modules, 'tifffile' in sys.modules, 'h5py' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False"] * 3
