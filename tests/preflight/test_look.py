"""What is said of a scene that is about to run."""

from isphcli.output.clock import Clock
from isphcli.preflight.look import look
from isphcli.scene.build_geometry import build_geometry
from tests.preflight.cases import IMAGE, SLIT, read


def test_warnings_are_said_once_unless_quiet(capfd):
    """The image of the fixture is three quarters pores, and open along x and z between sealed sides of y."""
    case = read(IMAGE)
    geometry = build_geometry(case)
    seen = look(case, geometry, Clock(), True)
    assert capfd.readouterr().err == "" and seen.warnings[0].startswith("porosity 75.0 %")
    again = look(case, geometry, Clock(), False)
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert lines == [f"warning: {text}" for text in again.warnings] and again.warnings == seen.warnings


def test_open_axes_and_throats():
    """A slit of 8 particles across: the throat is that wide; a plate along x closes the way across."""
    case = read(SLIT, "geometry.shapes=[{box: {lower: [-1, 0.5], upper: [2, 0.6]}, is: solid}]",
                "geometry.box=[1, 0.6]", "particles.spacing=0.05")
    assert look(case, build_geometry(case), Clock(), True).open_axes == ["x"]
    case = read(SLIT)
    seen = look(case, build_geometry(case), Clock(), True)
    assert abs(seen.throats["median"] - 8) < 0.01 and seen.throats["thin"] == 0
    free = read(SLIT, "geometry.periodic=[x, y]", "flow=navier_stokes", "time={end: 1}")
    seen = look(free, build_geometry(free), Clock(), True)
    assert seen.open_axes == [] and seen.throats is None
