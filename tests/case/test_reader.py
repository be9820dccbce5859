"""The case reader: what it reads, what it refuses and how it says so."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest

from isphcli.case.load import dump_case, read_case
from isphcli.case.reader import Table
from isphcli.case.yaml import CaseError
from tests.case.texts import BEADS, MINIMAL, SHAPES, problems, read


def test_reads_an_image_case(files):
    case = read(BEADS)
    assert case.geometry.voxels.file == files / "beads.npz"
    assert case.geometry.voxels.labels == Table({"solid": (1, 3), "brine": (0,), "co2": (2,)})
    assert case.geometry.voxels.voxel_size == 2.3e-5
    assert case.fluid_names == ("brine", "co2")
    assert case.fluids["brine"].nu == pytest.approx(1e-6)
    assert case.fluids["co2"].mu == pytest.approx(1e-4)
    assert case.dim is None
    assert (case.wall_distance, case.support, case.lattice_in(3)) == ("smooth", 2.1, "bcc")
    assert case.output.directory == files / "out/beadpack"
    assert case.path == files / "case.yaml"


def test_reads_a_case_of_shapes_and_fills_in_what_it_can_decide(files):
    case = read(SHAPES)
    assert case.dim == 2
    assert case.geometry.origin == (0.0, 0.0)
    assert case.geometry.fluid == "water"
    assert case.geometry.shapes[1].what == "oil"
    assert case.geometry.shapes[4].spheres.file == files / "beads.csv"
    assert case.particles.lattice == "square"
    assert case.output.directory == files / "out/case"
    assert case.reference.parameters == Table({"wall_velocity": 1.0})
    assert case.initial.velocity == ("sin(2*pi*x)", "0")
    assert read(MINIMAL).support == 2.1


def test_cases_are_frozen_and_replaceable():
    case = read(MINIMAL)
    finer = dataclasses.replace(case, particles=dataclasses.replace(case.particles, spacing=0.05))
    assert finer != case and finer.path == case.path
    with pytest.raises(dataclasses.FrozenInstanceError):
        case.title = "x"
    with pytest.raises(TypeError):
        case.fluids["water"] = None


def test_overrides_make_blocks_replace_values_and_remove_them():
    case = read(
        SHAPES,
        "geometry.shapes.0.sphere.radius=2e-1",
        "geometry.shapes.5={sphere: {centre: [0, 0], radius: 1}, is: water}",
        "solver.restart=30",
        "initial=null",
        "title=a = b",
        "fluids.oil.density=850",
    )
    assert case.geometry.shapes[0].sphere.radius == 0.2
    assert len(case.geometry.shapes) == 6
    assert case.solver.restart == 30
    assert case.initial is None
    assert case.title == "a = b"
    assert case.fluids["oil"].density == 850


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("particles.keep_volume=0.5", "--set particles.keep_volume: 0.5 steps would throw the particles about"),
        ("particles.spacing=-1", "--set particles.spacing: must be above 0, found '-1'"),
        ("particles.spacin=1", "--set particles.spacin: unknown key; did you mean 'spacing'?"),
        ("particles={}", "--set particles: particles.spacing: missing"),
        ("particles", "--set particles: not of the form key.sub=value"),
        ("a..b=1", "--set a..b: not of the form"),
        ("title.a=1", "--set title.a: title has no entry 'a'; it is a single value"),
        ("refine.7=1", "--set refine.7: refine has no entry '7'; it is a list: use 0 to 2"),
        ("refine.0=[", "--set refine.0: not YAML"),
        ("title=", "--set title: has no value; give one or remove the key"),
        ("drive.axes=[q]", "--set drive.axes: drive.axes.0: 'q' is not a choice; known are x, y, z"),
    ],
)
def test_problems_of_overrides_name_them(override, message):
    assert any(p.startswith(message) for p in problems("title: t\n" + MINIMAL, override))


def test_all_problems_at_once_with_line_key_and_remedy():
    text = """\
geometry:
  box: [1, one]
  periodic: [w]
particles: {spacing: -1, kernal: wendland_c2}
fluids:
  co2: {density: 1e3, viscosty: 1.0}
  water: {density: .inf, viscosity: 1, kinematic_viscosity: 1}
flow: stoke
tme: {end: 1}
"""
    assert problems(text) == [
        "case.yaml:2: geometry.box.1: expected a number, found 'one'; give a number, in m",
        "case.yaml:3: geometry.periodic.0: 'w' is not a choice; known are x, y, z",
        "case.yaml:4: particles.kernal: unknown key; did you mean 'kernel'?",
        "case.yaml:4: particles.spacing: must be above 0, found '-1'",
        "case.yaml:6: fluids.co2.viscosty: unknown key; did you mean 'viscosity'?",
        "case.yaml:7: fluids.water.density: expected a number, found '.inf'; "
        "give a number, in kg/m3",
        "case.yaml:7: fluids.water: viscosity and kinematic_viscosity exclude each other; keep one of them",
        "case.yaml:8: flow: 'stoke' is not a choice; did you mean 'stokes'?",
        "case.yaml:9: tme: unknown key; did you mean 'time'?",
    ]


@pytest.mark.parametrize("override, message", [
    ("particles.spacing=1/8", "expected a number, found '1/8'; write it as 0.001 or 1e-3, in m"),
    ("particles.spacing=fine", "expected a number, found 'fine'; give a number, in m"),
    ("particles.seed=one", "expected a whole number, found 'one'; give a whole number"),
])
def test_the_hint_fits_what_was_written(override, message):
    """How numbers are written is news to who began one, and not of a count."""
    assert problems(MINIMAL, override)[0].endswith(message)


def test_null_stands_for_an_absent_key():
    """Also where the key has a default."""
    case = read(MINIMAL, "refine=null", "particles.shifting=null", "output=null", "solver={tolerance: null}")
    assert case == read(MINIMAL.replace("refine: [0.08, 0.05]\n", ""))
    assert case.refine == () and read(MINIMAL).refine != ()


def test_a_misspelt_key_is_not_reported_missing_too():
    assert len(problems(MINIMAL.replace("spacing", "spacin"))) == 1


def test_importing_the_reader_does_not_import_numpy():
    code = "import sys, isphcli.case.load; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_paths_of_outputs_may_be_anywhere(files):
    assert read(MINIMAL, "output.directory=/tmp/a/../b").output.directory == Path("/tmp/b")
    assert read(MINIMAL, "output.directory=x").output.directory == Path(os.getcwd()) / "x"


@pytest.mark.parametrize("block", ["geometry", "particles", "fluids"])
def test_an_empty_required_block_is_a_problem(block):
    """Found by the property test: `geometry: null` once ended in a traceback."""
    text = {"geometry": "{box: [1, 1]}", "particles": "{spacing: 0.1}", "fluids": "{a: {density: 1, viscosity: 1}}"}
    text[block] = "null"
    with pytest.raises(CaseError):
        read_case("".join(f"{k}: {v}\n" for k, v in text.items()).encode(), "case.yaml")


def test_a_word_beside_a_list():
    """`refine` is a list of spacings, or auto: then the run chooses the others."""
    assert read(MINIMAL).spacings == (0.1, 0.08, 0.05)
    automatic = read(MINIMAL, "refine=auto")
    assert automatic.refine == "auto" and automatic.spacings == (0.1,)
    assert read(dump_case(automatic)).refine == "auto"
