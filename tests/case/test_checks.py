"""What must hold between keys of a case, and how it is said."""

import re

import numpy as np
import pytest

from isphcli.case.load import load_case
from isphcli.case.yaml import CaseError
from isphcli.scene.build_geometry import build_geometry
from tests.case.texts import BEADS, MINIMAL, SHAPES, problems, read

OF = "reference={kind: slit, geometry: {%s}}"


@pytest.mark.parametrize(
    ("base", "overrides", "message"),
    [
        (MINIMAL, ["fluids.water.density=true"], "expected a number, found 'true'"),
        (MINIMAL, ["fluids.water.density=1e999"], "'1e999' is not finite"),
        (MINIMAL, ["fluids.water.density=[1]"], "expected number, found a list"),
        (
            MINIMAL,
            ["fluids.water.viscosity=null"],
            "fluids.water: needs one of viscosity, kinematic_viscosity",
        ),
        (MINIMAL, ["fluids={}"], "fluids: no fluid is declared"),
        (MINIMAL, ["fluids.solid={density: 1, viscosity: 1}"], "fluids.solid: not a name for a fluid"),
        (MINIMAL, ["particles.seed=1.5"], "expected a whole number"),
        (MINIMAL, ["particles.seed=1e400"], "not finite"),
        (MINIMAL, ["output.plots=1"], "expected true or false, found '1'"),
        (MINIMAL, ["particles.support=1.4"], "must be at least 1.5"),
        (MINIMAL, ["particles.support=7"], "must be at most 6"),
        (MINIMAL, ["particles.lattice=square"], "square is not a lattice in 3D; use cubic or bcc"),
        (MINIMAL, ["particles.spacing=1"], "particles.spacing: 1 is not smaller than the box, 1"),
        (MINIMAL, ["particles.spacing=1e-4"], "about 1e12 sites; are box and spacing in the same unit?"),
        (MINIMAL, ["refine=[0.1]"], "repeats particles.spacing"),
        (MINIMAL, ["refine=finer"], "refine: 'finer' is not a choice"),
        (MINIMAL, ["refine=auto", "flow=navier_stokes"], "refine: needs flow: stokes"),
        (MINIMAL, ["refine=[3]"], "refine.0: 3 is not smaller than the box"),
        (MINIMAL, ["time.end=1"], "time: has no meaning in flow: stokes"),
        (MINIMAL, ["time.cfl=1.1"], "must be at most 1"),
        (MINIMAL, ["flow=navier_stokes"], "time: the run would not end; give time.end or time.steady"),
        (MINIMAL, ["flow=navier_stokes"], "drive.axes: needs flow: stokes"),
        (MINIMAL, ["flow=navier_stokes"], "refine: needs flow: stokes"),
        (MINIMAL, ["drive.body_force=[1, 0, 0]"], "drive.axes: makes its own flow"),
        (MINIMAL, ["drive={}"], "drive: drives nothing"),
        (SHAPES, ["drive={superficial_velocity: {x: 0 m/s}}"], "drive.superficial_velocity.x: is zero and drives"),
        (SHAPES, ["drive={superficial_velocity: {x: 1, y: 1}}"], "drive.superficial_velocity: needs one axis"),
        (
            MINIMAL,
            ["drive={body_force: [1, 0]}"],
            "drive.body_force: has 2 entries; the scene has 3 dimensions",
        ),
        (MINIMAL, ["geometry.periodic=[x, y]"], "drive.axes: z ends at walls; add z to geometry.periodic"),
        (MINIMAL, ["geometry.periodic=[x, x]"], "an entry is given twice"),
        (MINIMAL, ["geometry.box=[1]"], "expected 2 or 3 entries, found 1"),
        (MINIMAL, ["geometry.wall_distance=stairs"], "only voxels have stairs"),
        (MINIMAL, ["geometry.walls.x_min.velocity=[0, 0, 1]"], "x is periodic and has no walls"),
        (MINIMAL, ["geometry.walls.w_min={}"], "geometry.walls.w_min: unknown name"),
        (MINIMAL, ["reference.kind=permeability"], "kind permeability needs a value"),
        (MINIMAL, ["reference={kind: permeability, value: [1, 2]}"],
         "reference.value: has 2 numbers, and the scene has 3 axes; give one an axis, or one number and"),
        (MINIMAL, ["reference={kind: permeability, value: 1, axes: [x], crop: [[0, 1], [0, 1]]}"],
         "reference.crop: has 2 ranges, and the scene has 3 axes"),
        (MINIMAL, ["reference={kind: permeability, value: -1, axes: [x]}"], "a permeability is above 0"),
        (MINIMAL, [OF % "voxels: {labels: {sollid: 1}}"],
         "reference.geometry.voxels.labels.sollid: 'sollid' is not a fluid of this case; did you mean 'solid'?"),
        (MINIMAL, [OF % "voxels: {labels: {solid: 1, watr: 0}}"], "did you mean 'water'?"),
        (MINIMAL, [OF % "voxels: {grey: {fluids: {watr: [0, 9]}}}"], "'watr' is not a fluid of this case"),
        (MINIMAL, [OF % "fluid: watr"], "reference.geometry.fluid: 'watr' is not a fluid"),
        (MINIMAL, ["flow=navier_stokes", "time={end: 1, step: 2}"], "time.step: 2 is longer than the run, 1"),
        (MINIMAL, ["reference.kind=sphere_array"], "kind sphere_array needs fraction"),
        (MINIMAL, ["reference.kind=taylor_green"], "kind taylor_green needs speed"),
        (MINIMAL, ["reference={kind: sphere_array, parameters: {fraction: 0.2, fraktion: 0.2}}"],
         "reference.parameters.fraktion: kind sphere_array does not know it; did you mean 'fraction'?"),
        (MINIMAL, ["reference={kind: sphere_array, parameters: {fraction: a fifth}}"],
         "reference.parameters.fraction: expected a number, found 'a fifth'"),
        (MINIMAL, ["reference.kind=static_drop"], "reference.kind: static_drop is of two fluids, and the case has one"),
        (SHAPES, ["reference={kind: static_drop, parameters: {drop: oill}}"], "'oill' is not a choice; did you mean"),
        (SHAPES, ["geometry.periodic=[z]"], "geometry.periodic: a 2D scene has no axis z"),
        (SHAPES, ["geometry.mirror=[y]"], "geometry.mirror: mirrors an image, and there is none"),
        (SHAPES, ["drive.pressure_drop={z: 1}"], "drive.pressure_drop: a 2D scene has no axis z"),
        (SHAPES, ["geometry.walls.y_max.velocity=[0, 1]"], "moves the wall along y"),
        (SHAPES, ["geometry.walls.y_max.velocity=[0, t]"], "moves the wall along y"),
        (SHAPES, ["geometry.walls.y_max.velocity=[sin(x), 0]"], "velocity.0: unknown name 'x'; known are t, pi, e"),
        (SHAPES, ["drive={body_force: [0, cos(t]}"], "drive.body_force.1: 'cos(t' is not a formula"),
        (SHAPES, ["drive={body_force: [0, t]}", "time={steady: 1e-3}"], "drive.body_force.1: changes with time, up to "
         "an end that is not given; give time.end"),
        (SHAPES, ["drive={pressure_drop: {x: 1/(t-t)}}", "time.end=2"], "drive.pressure_drop.x: '1/(t-t)' is not "
         "finite everywhere"),
        (SHAPES, ["geometry.shapes.0.velocity=[exp(t), 0]", "time.end=1e6"], "geometry.shapes.0.velocity.0: 'exp(t)' "
         "is not finite everywhere"),
        (SHAPES, ["drive={body_force: [t, 0]}", "time.end=2", "reference={kind: poiseuille}"],
         "poiseuille is the flow under a constant force; give numbers in drive"),
        (MINIMAL, ["drive={pressure_drop: {z: cos(t)}}"], "drive.pressure_drop.z: changes with time, and flow: stokes "
         "is steady; give a number, or use navier_stokes"),
        (MINIMAL, ["drive={body_force: [0, 0, sin(t)]}"], "drive.body_force.2: changes with time, and flow: stokes"),
        (MINIMAL, ["reference.kind=oscillating_slit"], "kind oscillating_slit needs omega"),
        (SHAPES, ["geometry.shapes.1.is=oill"], "'oill' is not a fluid of this case; did you mean 'oil'?"),
        (SHAPES, ["geometry.shapes.1.velocity=[1, 0]"], "shapes.1.velocity: only solids have one"),
        (SHAPES, ["geometry.shapes.3.angular_velocity=1"], "shapes.3.angular_velocity: only cylinders turn"),
        (SHAPES, ["geometry.shapes.0.sphere=null"], "shapes.0: needs one of sphere, spheres, box"),
        (SHAPES, ["geometry.shapes.0.sphere.centre=[1]"], "shapes.0.sphere.centre: has 1 entries"),
        (SHAPES, ["geometry.shapes.2.half_space.normal=[0, 0]"], "has no direction"),
        (SHAPES, ["geometry.shapes.3.box.upper=[0, 0]"], "lower must be below upper"),
        (SHAPES, ["geometry.shapes.4.spheres.file=no.csv"], "no such file"),
        (SHAPES, ["geometry.shapes.0={cylinder: {axis: z, radius: 1}, is: solid}"], "a cylinder is 3D"),
        (SHAPES, ["geometry.fluid=mud"], "geometry.fluid: 'mud' is not a fluid"),
        (SHAPES, ["initial.velocity=[z, 0]"], "initial.velocity.0: unknown name 'z'"),
        (SHAPES, ["initial.velocity=[x^2, 0]"], "a power is written **"),
        (BEADS, ["geometry.box=[1, 1]"], "geometry: voxels and box exclude each other"),
        (BEADS, ["geometry.origin=[0, 0, 0]"], "geometry.origin: belongs to a box, not to voxels"),
        (BEADS, ["geometry.wall_distance=exact"], "voxels have no exact walls"),
        (BEADS, ["geometry.voxels.labels.oil=7"], "geometry.voxels.labels.oil: 'oil' is not a fluid"),
        (BEADS, ["geometry.voxels.labels.co2=3"], "labels.co2: value 3 already stands for solid"),
        (BEADS, ["geometry.voxels.labels.co2=-3"], "must be at least 0"),
        (BEADS, ["geometry.voxels.labels={solid: 0}"], "no voxel is fluid"),
        (BEADS, ["geometry.voxels.crop=[[0, 4], [5, 5]]"], "keeps nothing along y"),
        (BEADS, ["geometry.voxels.crop=[[0, 4, 5], [5, 5]]"], "crop.0: expected 2 entries, found 3"),
        (BEADS, ["geometry.voxels.file=nul"], "no such file"),
        (BEADS, ["drive.body_force=[1]"], "has 1 entries; the scene has 2 or 3 dimensions"),
        (BEADS, ["fluids.oil={density: 1, viscosity: 1}"], "interface: needs two fluids, found 3"),
        (BEADS, ["flow=stokes"], "interface: has no meaning in flow: stokes"),
    ],
)
def test_cross_checks(base, overrides, message):
    assert any(message in problem for problem in problems(base, *overrides))


def test_limits_of_steps_that_a_run_wrote_itself_are_no_problem():
    """Its case.yaml has all defaults."""
    assert read(SHAPES, "time={end: 1, step: 0.1, capillary: 1, cfl: 0.2}").time.step == 0.1


def test_problems_of_all_kinds_come_together_with_their_lines(tmp_path):
    """A key that nobody knows, a block that is missing, what does not fit another key, the dimension of an image."""
    np.save(tmp_path / "rock.npy", np.zeros((4, 4, 4), np.uint8))
    lines = ["geometry:", "  voxels: {file: rock.npy, labels: {water: 0}, voxel_size: 1, shade: 2}",
             "  mirror: [y]", "  periodic: [y]", "drive: {pressure_drop: {x: 0}}", "time: {end: 1, step: 2}",
             "particles: {spacing: 1}", "initial: {velocity: [x, y]}", "reference:", "  kind: permeability",
             "  value: [1, 2]"]
    (tmp_path / "rock.yaml").write_text("\n".join(lines))
    with pytest.raises(CaseError) as error:
        load_case(tmp_path / "rock.yaml")
    assert [(problem.line, problem.key) for problem in error.value.problems] == [
        (1, "fluids"), (2, "geometry.voxels.shade"), (3, "geometry.mirror"),
        (6, "time.step"), (8, "initial.velocity"), (11, "reference.value")]


IMAGE = """\
geometry:
  voxels: {file: i.npy, labels: {solid: 1, water: 0}, voxel_size: 1}
particles: {spacing: 1}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
"""


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("axes: [x]", "axes: [z]", "drive.axes: a 2D scene has no axis z"),
        ("axes: [x]", "pressure_drop: {z: 1}", "drive.pressure_drop: a 2D scene has no axis z"),
        ("axes: [x]", "body_force: [0, 0, 1]", "drive.body_force: has 3 entries"),
        ("voxel_size: 1}", "voxel_size: [1, 1, 1]}", "voxel_size: has 3 entries; the image has 2 dimensions"),
        ("voxel_size: 1}", "voxel_size: 1}\n  periodic: [z]", "geometry.periodic: a 2D scene has no axis z"),
        ("voxel_size: 1}", "voxel_size: 1}\n  mirror: [z]", "geometry.mirror: a 2D scene has no axis z"),
        ("voxel_size: 1}", "voxel_size: 1}\n  periodic: [x]\n  mirror: [x]", "geometry.mirror: x is periodic too"),
        ("spacing: 1", "spacing: 1, lattice: bcc", "particles.lattice: bcc is not a lattice in 2D"),
        ("spacing: 1", "spacing: 1, offset: [0, 0, 0]", "particles.offset: has 3 entries"),
        ("flow: stokes\ndrive: {axes: [x]}", "time: {end: 1}\ninitial: {velocity: ['z', '0']}", "unknown name 'z'"),
    ],
)
def test_a_case_must_fit_the_dimensions_of_its_image(old, new, message, tmp_path):
    image = np.zeros((6, 6), np.uint8)
    image[2:4, 2:4] = 1
    np.save(tmp_path / "i.npy", image)
    (tmp_path / "case.yaml").write_text(IMAGE)
    assert build_geometry(load_case(tmp_path / "case.yaml")).dim == 2
    assert old in IMAGE
    (tmp_path / "case.yaml").write_text(IMAGE.replace(old, new))
    with pytest.raises(CaseError, match=re.escape(message)):
        build_geometry(load_case(tmp_path / "case.yaml"))


def test_an_image_of_one_layer_is_of_two_dimensions(tmp_path):
    """Also where its file, or what is cropped from it, has three axes: numpy complained of shapes."""
    np.save(tmp_path / "i.npy", np.tile(np.array([[0, 0], [0, 1]], np.uint8), (1, 3, 3)))
    (tmp_path / "case.yaml").write_text(IMAGE.replace("axes: [x]", "body_force: [1, 0, 0]"))
    with pytest.raises(CaseError, match=r"drive\.body_force: has 3 entries; the scene has 2 dimensions"):
        build_geometry(load_case(tmp_path / "case.yaml"))
    (tmp_path / "case.yaml").write_text(IMAGE)
    assert build_geometry(load_case(tmp_path / "case.yaml")).dim == 2


def test_a_value_an_axis_must_fit_the_image(tmp_path):
    """Where only the image tells the dimensions, and where its case misspells what the reference is of."""
    np.save(tmp_path / "i.npy", np.tile(np.array([[0, 0], [0, 1]], np.uint8), (3, 3)))
    three = "reference: {kind: permeability, value: [1, 2, 3]}\n"
    (tmp_path / "case.yaml").write_text(IMAGE + three)
    with pytest.raises(CaseError, match=r"reference\.value: has 3 numbers, and the scene has 2 axes"):
        build_geometry(load_case(tmp_path / "case.yaml"))
    misspelled = "reference:\n  kind: permeability\n  value: [1, 2]\n  geometry: {voxels: {labels: {sollid: 1}}}\n"
    (tmp_path / "case.yaml").write_text(IMAGE + misspelled)
    line = 1 + (IMAGE + misspelled).splitlines().index("  geometry: {voxels: {labels: {sollid: 1}}}")
    message = f"case.yaml:{line}: reference.geometry.voxels.labels.sollid: 'sollid' is not a fluid"
    with pytest.raises(CaseError, match=re.escape(message)):
        load_case(tmp_path / "case.yaml")


LOOP = """\
geometry: {box: [4, 1], periodic: [x, y]}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}, gas: {density: 1, viscosity: 1}}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 1}
drive: {steps: {pressure_drop: [1, 2], duration: 1}}
time: {}
"""
SCAN = "geometry={voxels: {file: beads.npz, labels: {solid: 1, water: 0}, voxel_size: 1CLEAR}, periodic: [AXES]}"


def test_reservoirs_and_steps_need_no_end():
    assert read(LOOP).reservoirs.length == 1


@pytest.mark.parametrize("overrides, message", [
    (["reservoirs.inlet=oil"], "reservoirs.inlet: 'oil' is not a fluid of this case"),
    (["reservoirs.axis=z"], "reservoirs.axis: a 2D scene has no axis z"),
    (["geometry.periodic=[y]"], "reservoirs.axis: x ends at walls; add x to geometry.periodic"),
    (["reservoirs.length=2"], "reservoirs.length: two of them fill the box"),
    (["reservoirs.length=null"], "reservoirs.length: missing: a box has no clear layers"),
    (["reservoirs.length=0.01"], "reservoirs.length: it is less than a spacing, 0.1"),
    (["reservoirs.length=1.99"], "reservoirs.length: what two of them leave of the box is less than a spacing"),
    (["drive.steps.pressure_drop=[]"], "drive.steps: have no step; give at least one pressure or velocity"),
    (["flow=stokes"], "reservoirs: has no meaning in flow: stokes"),
    (["drive={pressure_drop: {y: 1}}", "time.end=1"], "drive.pressure_drop: drives across the axis of the reservoirs"),
    (["reservoirs=null"], "drive.steps: are between reservoirs, and there are none"),
    (["drive.pressure_drop={x: 1}"], "drive.steps: are all of the drive along their axis"),
    (["drive.steps.superficial_velocity=[1]"], "drive.steps: pressure_drop and superficial_velocity exclude"),
    (["drive.steps.window=2"], "drive.steps.window: is longer than a step"),
    (["time.steady=0.1"], "time.steady: is of one flow, and the drive has steps"),
    ([SCAN.replace("CLEAR", "").replace("AXES", "y")], "reservoirs.length: an image has its reservoirs in its clear"),
    ([SCAN.replace("CLEAR", "").replace("AXES", "x"), "reservoirs.length=null"], "the image repeats along x"),
    ([SCAN.replace("CLEAR", ", clear_layer: 0").replace("AXES", "y"), "reservoirs.length=null"],
     "geometry.voxels.clear_layer: is 0: no room for reservoirs"),
])  # fmt: skip
def test_reservoirs_that_cannot_be(overrides, message):
    assert any(message in line for line in problems(LOOP, *overrides)), problems(LOOP, *overrides)
