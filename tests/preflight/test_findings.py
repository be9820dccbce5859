"""What is warned of, and what stands against a run."""

import numpy as np
import pytest

from isphcli.preflight import findings as module
from isphcli.preflight.check import check
from tests.preflight.cases import DROP, IMAGE, SLIT, SPHERE, read


def findings(text: str, *overrides: str) -> str:
    found = check(read(text, *overrides))
    assert found.can_run, found.text()
    return "\n".join(found.warnings)


def test_nothing_to_say_about_a_good_case():
    assert findings(SLIT) == findings(SPHERE, "particles.spacing=0.025") == ""
    porous = np.zeros((8, 8, 20), np.uint8)
    porous[:, 4:] = 1
    np.save("rock.npy", porous)
    assert findings(IMAGE) == ""


def test_what_the_geometry_finds_is_a_warning():
    """The image of the fixture is open at six of eight layers."""
    assert findings(IMAGE).startswith("porosity 75.0 %: more than rock has")
    assert "voxels of 10 m" in findings(IMAGE, "geometry.voxels.voxel_size=10", "particles.spacing=10")


def test_throats_that_are_too_narrow():
    """A slit of two particles: four take a quarter of its width."""
    found = findings(SLIT, "particles.spacing=0.25")
    assert "median throat is 2 particles wide" in found
    assert "take particles.spacing 0.125 for 4 or more" in found
    assert "median throat" not in findings(SLIT, "particles.spacing=0.125")


def test_spacing_and_voxel_size():
    assert "does not divide the voxel size" in findings(IMAGE, "particles.spacing=0.7e-5")
    assert "does not divide" not in findings(IMAGE, "particles.spacing=0.5e-5")


def test_clear_layer_thinner_than_the_support():
    assert "clear layer" in findings(IMAGE, "geometry.voxels.clear_layer=2e-5")
    assert "clear layer" not in findings(IMAGE, "geometry.voxels.clear_layer=3e-5")


def test_stretched_lattice():
    """Axes that are stretched alike are one warning."""
    assert "stretched by" in findings(SLIT, "geometry.box=[0.97, 0.5]")
    found = findings(SPHERE, "particles.spacing=0.0485")
    assert found.count("stretched by") == 1 and "the box along x, y, z is no whole number" in found


def test_memory_of_the_machine(monkeypatch):
    monkeypatch.setattr(module, "machine_memory", lambda: 1e6)
    assert "this machine has 1 MB" in findings(SLIT)


def test_inertia_in_a_stokes_case():
    assert "Reynolds number" in findings(SLIT, "drive.body_force=[1000, 0]")


def test_what_has_no_effect_is_told():
    """Such a case runs: a sweep of a drive passes through zero, and a case may be given a step of its own for once."""
    moving = ("flow=navier_stokes", "time={end: 1, step: 0.01, cfl: 0.1, capillary: 2}")
    told = findings(SLIT, "drive.body_force=[0, 0]", *moving)
    assert "drive.body_force is zero along every axis" in told
    assert "time.cfl has no effect beside time.step" in told and "time.capillary has no effect" in told
    wall = "geometry.shapes=[{box: {lower: [-1, 0.4], upper: [2, 0.7]}, is: solid}]"
    assert "is zero" not in findings(SLIT, "drive={pressure_drop: {x: 1, y: 0}}", "geometry.periodic=[x, y]", wall)
    for drops, told in (("[0, 0]", True), ("[0, 1]", False)):  # a curve may begin at rest
        found = findings(IN_STEPS.replace("END", "6"), f"drive.steps.pressure_drop={drops}")
        assert ("drive.steps.pressure_drop is zero in every step and drives nothing" in found) == told


def test_a_fluid_without_particles():
    found = check(read(DROP, "geometry.shapes=[]"))
    assert any("fluids.oil has no particle" in text for text in found.warnings)


def errors(text: str, *overrides: str) -> str:
    found = check(read(text, *overrides))
    assert not found.can_run and "cannot run" in found.text()
    return "\n".join(found.errors)


WALL = "geometry.shapes=[{box: {lower: [0.4, -1], upper: [0.7, 2]}, is: solid}]"


def test_all_solid():
    assert "no fluid" in errors(SLIT, "geometry.shapes=[{box: {lower: [-1, -1], upper: [2, 2]}, is: solid}]")


def test_no_percolation_along_the_drive():
    assert "along x: its permeability is zero" in errors(SLIT, WALL)
    steady = ("flow=navier_stokes", "time={steady: 1e-4}")
    assert "along x" in errors(SLIT, WALL, *steady)
    assert "along y: both faces are walls" in errors(SLIT, "drive.body_force=[0, 1]")


def test_no_percolation_matters_less_in_time_or_beside_another_axis():
    assert "along x" in findings(SLIT, WALL, "flow=navier_stokes", "time={end: 1}")
    assert "along y" in findings(SLIT, "drive.body_force=[1, 2]")


def test_a_velocity_can_only_be_held_where_fluid_flows():
    """The estimate of the speed is that of the pores; a velocity across a slab is an error at any time."""
    held = ("drive={superficial_velocity: {x: 0.25}}", "flow=navier_stokes", "time={end: 1}")
    found = check(read(SLIT, *held))
    assert found.can_run and "held" in found.text() and found.flow.velocity == pytest.approx(2 * 0.25)
    two_a_cell = check(read(SLIT, *held, "particles.lattice=hexagonal"))
    assert two_a_cell.flow.velocity == pytest.approx(2 * 0.25, rel=0.1)  # rows that the walls cut
    assert "along x" in errors(SLIT, WALL, *held)


def test_pockets_between_beads_that_touch_are_those_of_the_lattice():
    """In a body-centred pack all pores are joined; 48 sites of the lattice are not, by their faces."""
    beads = ("{sphere: {centre: [0.13, 0.37, 0.21], radius: 0.4330127}, is: solid}, "
             "{sphere: {centre: [0.63, 0.87, 0.71], radius: 0.4330127}, is: solid}")
    found = check(read(SPHERE, f"geometry.shapes=[{beads}]", "geometry.box=[1, 1, 1]",
                       "particles.spacing=0.0833333333333333"))
    assert found.connectivity.isolated_pockets == 48
    assert "closed by the faces of lattice sites" in "\n".join(found.warnings)


def test_no_percolation_of_an_image(folder):
    values = np.zeros((8, 8, 20), np.uint8)
    values[:, :, 9] = 1
    np.save("rock.npy", values)
    assert "along x: its permeability is zero" in errors(IMAGE)


def test_a_throat_that_only_the_lattice_closes(folder):
    values = np.zeros((8, 8, 20), np.uint8)
    values[:, :, 6:14] = 1
    values[4, 4, 6:14] = 0
    np.save("rock.npy", values)
    assert "throat of about" in findings(IMAGE, "particles.spacing=1e-5")
    assert "closed on this lattice" in findings(IMAGE, "particles.spacing=2e-5")


def test_a_pore_that_leads_over_an_edge_is_left_to_the_run():
    """Two channels that touch in the edge of a particle's cell: faces do not join them."""
    boxes = ", ".join(f"{{box: {{lower: {low}, upper: {up}}}, is: solid}}"
                      for low, up in (([0, -1], [0.5, 0.25]), ([0.5, 0.25], [1, 2])))
    held = ("drive={superficial_velocity: {x: 0.1}}", "flow=navier_stokes", "time={end: 1}")
    found = check(read(SLIT, f"geometry.shapes=[{boxes}]", *held))
    assert found.can_run and any("only over their edges" in text for text in found.warnings)
    assert "along x" in errors(SLIT, WALL, *held)


def test_a_run_that_stops_before_its_end_and_flow_that_no_unit_explains():
    moving = ("flow=navier_stokes", "time={end: 1, max_steps: 30}")
    found = findings(SLIT, *moving, "time.step=0.01")
    assert "after time.max_steps = 30 steps the run stops short of its end, 1 s" in found and "step, 0.01 s" in found
    assert "stops short" not in findings(SLIT, *moving, "time.step=0.5")
    assert "something is due, of output.every" in findings(SLIT, *moving, "output.every=1e-6")
    assert "Reynolds number is about" in findings(SLIT, *moving, "fluids.water.viscosity=1e-7")


def test_steps_that_are_too_few_to_tell_a_steady_state():
    """Three windows of 100 steps, after the first quarter of the run."""
    moving = ("flow=navier_stokes", "drive={pressure_drop: {x: 1}}")
    assert "takes 400 steps" in findings(SLIT, *moving, "time={steady: 0.01, max_steps: 399}")
    assert "takes 400 steps" not in findings(SLIT, *moving, "time={steady: 0.01, max_steps: 400}")


def test_numbers_out_of_range_are_told():
    assert "leaves the range of numbers" in errors(SLIT, "flow=navier_stokes", "time={end: 1}",
                                                   "drive.body_force=[1e300, 1e300]")


def test_nothing_moves_the_fluid():
    """An error of a steady flow, a warning of one in time that has no tension and begins at rest."""
    assert "nothing moves the fluid" in errors(SLIT, "drive=null")
    moving = ("drive=null", "flow=navier_stokes", "time={end: 1}")
    assert "nothing moves the fluid, which stays at rest" in findings(SLIT, *moving)
    assert "nothing moves" not in findings(SLIT, *moving, 'initial={velocity: ["y", 0]}')
    assert "nothing moves" not in findings(DROP)


def test_reservoirs_that_are_all_seam():
    ends = ("geometry.periodic=[x, y]", "drive={pressure_drop: {x: 1}}")
    for length, told in ((0.125, True), (0.25, False)):  # the support is 2.8 spacings of 1/16
        found = findings(DROP, *ends, f"reservoirs={{axis: x, inlet: water, outlet: oil, length: {length}}}")
        assert ("half of a reservoir is taken for the seam" in found) == told


def test_one_fluid_at_both_ends():
    loop = ("geometry.periodic=[x, y]", "geometry.box=[3, 1]", "drive={pressure_drop: {x: 1}}")
    ends = "reservoirs={axis: x, inlet: oil, outlet: END, length: 0.5}"
    assert "are both oil: it goes round" in findings(DROP, *loop, ends.replace("END", "oil"))
    assert "goes round" not in findings(DROP, *loop, ends.replace("END", "water"))


def test_nothing_moves():
    assert "nothing moves the fluid" in errors(SLIT, "drive=null")


@pytest.mark.parametrize("angle, thin", [(0, "water"), (10, "water"), (25, "water"), (170, "oil"), (180, "oil")])
def test_fluid_that_spreads_thinner_than_a_spacing(angle, thin):
    """A wedge of 27 degrees is thinner than a spacing as far from the contact line as the wall asks for the angle, two
    spacings: less is not resolved, of either fluid. Without walls no angle matters."""
    found = findings(DROP, f"interface.contact_angle={angle}")
    assert f"contact_angle {angle}: {thin} on the wall" in found and "27 to 153 degrees" in found
    assert ("film" in found.split("which")[0]) == (angle in (0, 180))
    assert "contact_angle" not in findings(DROP, f"interface.contact_angle={angle}", "geometry.periodic=[x, y]")
    assert "contact_angle" not in findings(DROP, f"interface.contact_angle={30 if angle < 90 else 150}")


IN_STEPS = """
geometry: {box: [4, 1], periodic: [x], fluid: water, shapes: [{box: {lower: [0, 0], upper: [2, 1]}, is: gas}]}
particles: {spacing: 0.125}
fluids: {water: {density: 2, viscosity: 0.3}, gas: {density: 1, viscosity: 0.3}}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 1}
drive: {steps: {pressure_drop: [1, 2, 3], duration: 2}}
time: {end: END}
"""


def test_an_end_before_the_steps_of_a_drive_is_told():
    told = [any("3 drive.steps" in warning for warning in check(read(IN_STEPS.replace("END", end))).warnings)
            for end in ("3", "6")]
    assert told == [True, False]
