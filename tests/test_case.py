"""The case reader: what it reads, what it refuses and how it says so."""

import dataclasses
import json
import os
import pickle
import re
import subprocess
import sys
import time
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.case import docs as case_docs
from isphcli.case import yaml as case_yaml
from isphcli.case.blocks import Case
from isphcli.case.load import dump_case, load_case, read_case
from isphcli.case.reader import Table
from isphcli.case.yaml import MAX_BYTES, MAX_DEPTH, CaseError
from isphcli.scene.build_geometry import build_geometry

BEADS = """\
title: CO2 in a brine-saturated bead pack
geometry:
  voxels: {file: beads.npz, labels: {solid: [1, 3], brine: 0, co2: 2}, voxel_size: 23e-6}
  periodic: [y]
particles: {spacing: 2.3e-5, lattice: bcc}
fluids:
  brine: {density: 1000, viscosity: 1.0e-3}
  co2: {density: 500, kinematic_viscosity: 2e-7}
interface: {tension: 0.03, contact_angle: 60}
drive: {body_force: [0, 4.9, 0]}
time: {end: 4.5e-3}
output: {directory: out/beadpack, every: 1.125e-3, fields: [velocity, pressure, phase]}
"""

SHAPES = """\
geometry:
  box: [1, 1]
  shapes:
    - {sphere: {centre: [0.5, 0.5], radius: 1e-1}, is: solid, velocity: [0, 1]}
    - sphere: {centre: [0.2, 0.2], radius: 0.1}
      is: oil
    - {half_space: {point: [0, 0.1], normal: [0, 1]}, is: solid}
    - {box: {lower: [0, 0], upper: [0.1, 0.1]}, is: solid, slip_length: 1e-3}
    - {spheres: {file: beads.csv}, outside: true, is: solid}
  periodic: [x]
  walls: {y_max: {velocity: [1, 0]}}
particles: {spacing: 0.05}
fluids:
  water: {density: 1, viscosity: 1}
  oil: {density: 1, viscosity: 10}
initial: {velocity: ["sin(2*pi*x)", 0]}
time: {steady: 1e-4}
drive: {pressure_drop: {x: 2}}
reference: {kind: couette, tolerance: 0.01, parameters: {U: 1e0, wall: y_max}}
"""

MINIMAL = """\
geometry: {box: [1, 1, 2], periodic: [x, y, z]}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
drive: {axes: [x, y, z]}
flow: stokes
refine: [0.08, 0.05]
"""


@pytest.fixture(autouse=True)
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("beads.npz", "beads.csv"):
        (tmp_path / name).touch()
    return tmp_path


def read(text: str, *overrides: str) -> Case:
    return read_case(text.encode(), "case.yaml", overrides)


def problems(text: str, *overrides: str) -> list[str]:
    with pytest.raises(CaseError) as caught:
        read(text, *overrides)
    assert str(caught.value) == "\n".join(map(str, caught.value.problems))
    return [str(problem) for problem in caught.value.problems]


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
    assert case.reference.parameters == Table({"U": 1.0, "wall": "y_max"})
    assert case.initial.velocity == ("sin(2*pi*x)", "0")
    assert read(MINIMAL).support == 2.1


@pytest.mark.parametrize("text", [BEADS, SHAPES, MINIMAL])
def test_dump_reads_back_to_an_equal_case(text, files):
    case = read(text)
    dumped = dump_case(case)
    elsewhere = files / "other" / "dir"
    elsewhere.mkdir(parents=True)
    (elsewhere / "effective.yaml").write_text(dumped)
    again = load_case(elsewhere / "effective.yaml")
    assert again == case
    assert hash(again) == hash(case)
    assert dump_case(again) == dumped
    assert pickle.loads(pickle.dumps(case)) == case
    assert "interface" not in yaml.safe_load(dump_case(read(MINIMAL)))


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
        "case.yaml:2: geometry.box.1: expected a number, found 'one'; write it as 0.001 or 1e-3, in m",
        "case.yaml:3: geometry.periodic.0: 'w' is not a choice; known are x, y, z",
        "case.yaml:4: particles.kernal: unknown key; did you mean 'kernel'?",
        "case.yaml:4: particles.spacing: must be above 0, found '-1'",
        "case.yaml:6: fluids.co2.viscosty: unknown key; did you mean 'viscosity'?",
        "case.yaml:7: fluids.water.density: expected a number, found '.inf'; "
        "write it as 0.001 or 1e-3, in kg/m3",
        "case.yaml:7: fluids.water: viscosity and kinematic_viscosity exclude each other; keep one of them",
        "case.yaml:8: flow: 'stoke' is not a choice; did you mean 'stokes'?",
        "case.yaml:9: tme: unknown key; did you mean 'time'?",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title: a\ntitle: b\n", "case.yaml:2: title: given twice, first in line 1; keep one of them"),
        ("a:\n - b: 1\n   b: 2\n", "case.yaml:3: a.0.b: given twice, first in line 2"),
        ("geometry:\n\tbox: [1, 1]\n", "case.yaml:2: not YAML: "),
        ("geometry: {box: [1, 1\n", "case.yaml:2: not YAML: "),
        ("a: &a 1\nb: *a\n", "case.yaml:2: aliases (*name) are not used in cases"),
        ("a: !!python/object:os.system 1\n", "case.yaml:1: tags (!name) are not used in cases"),
        ("a: 1\n---\nb: 1\n", "case.yaml:2: a second document; one case a file"),
        ("? [a]\n: 1\n", "case.yaml:1: a key must be a plain word"),
        ("- 1\n", "case.yaml:1: expected a block of keys, found a list"),
        ("", "case.yaml:1: geometry: missing; give where there is"),
        ("%TAG !e! tag:x\n---\na: 1\n", "case.yaml:1: directives (%) are not used in cases"),
        ("[" * 5000, "case.yaml:1: nested more than 32 deep"),
        ("a: {b: " * 5000, "case.yaml:1: nested more than 32 deep"),
        ("- " * 5000, "case.yaml:1: nested more than 32 deep"),
        ("? " * 5000, "case.yaml:1: nested more than 32 deep"),
        ("".join(" " * k + "a:\n" for k in range(1200)), "case.yaml:34: nested more than 32 deep"),
        ("a" * (MAX_BYTES + 1), "case.yaml: longer than 1000000 bytes; put long lists in a file"),
        ("a: [" + "1," * 200_000 + "]", "case.yaml:1: more than 100000 values; put long lists in a file"),
        ('a: "\\x07"', "case.yaml:1: control characters are not text; remove them"),
        ('a: "\\ud800"', "case.yaml:1: "),  # PyYAML refuses it where it has libyaml, else we do
    ],
)
def test_what_is_not_yaml_for_a_case(text, message):
    assert any(problem.startswith(message) for problem in problems(text))


def test_null_stands_for_an_absent_key():
    """Also where the key has a default."""
    case = read(MINIMAL, "refine=null", "particles.shifting=null", "output=null", "solver={tolerance: null}")
    assert case == read(MINIMAL.replace("refine: [0.08, 0.05]\n", ""))
    assert case.refine == () and read(MINIMAL).refine != ()


NESTED = {
    "lists": lambda n: "[" * n + "]" * n,
    "blocks": lambda n: "{a: " * n + "1" + "}" * n,
    "lines": lambda n: "".join(" " * k + "a:\n" for k in range(n - 1)) + " " * (n - 1) + "a: 1",
    "items": lambda n: "- " * n + "1",
    "items below their key": lambda n: "".join(" " * k + ("a:\n", "-\n")[k % 2] for k in range(n)) + " " * n + "1",
}


@pytest.mark.parametrize("form", NESTED)
def test_the_depth_is_ours_before_yaml_sees_the_text(monkeypatch, form):
    """32 deep is read and 33 is not; 64 and more PyYAML is not even asked about, whose bounds change."""

    def depths(n):
        report = case_yaml.Report()
        case_yaml.parse(NESTED[form](n), case_yaml.Where("a", 1), report)
        return [problem.message for problem in report.problems]

    assert depths(MAX_DEPTH) == [] and depths(MAX_DEPTH + 1) == ["nested more than 32 deep"]
    monkeypatch.setattr(yaml, "parse", lambda *_, **__: pytest.fail("PyYAML was asked"))
    for n in (2 * MAX_DEPTH, 1000, 1001, 100_000 if form in ("lists", "blocks", "items") else 1200):
        assert depths(n) == ["nested more than 32 deep"]


@pytest.mark.parametrize(
    ("written", "title"),
    [
        (f'"{"[" * 50}"', "[" * 50),
        (f"'it''s {'{' * 50}'", f"it's {'{' * 50}"),
        (f"a  # {'[' * 50}", "a"),
        (f'"a \\" {"[" * 50}"', f'a " {"[" * 50}'),
    ],
)
def test_brackets_in_texts_and_comments_do_not_nest(written, title):
    assert read(MINIMAL + f"title: {written}\n").title == title


def test_tabs_say_what_to_do():
    assert problems("geometry:\n\tbox: [1, 1]\n")[0].endswith("; indent with spaces, not tabs")


def test_bytes_that_are_not_text():
    with pytest.raises(CaseError, match=r"case\.yaml:2: not text; save it as UTF-8"):
        read_case(b"title: a\n\xff", "case.yaml")


@pytest.mark.parametrize("name", ["missing.yaml", ".", "nul\0"])
def test_a_case_that_cannot_be_read(name):
    with pytest.raises(CaseError, match="cannot be read"):
        load_case(name)


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
        (MINIMAL, ["refine=[3]"], "refine.0: 3 is not smaller than the box"),
        (MINIMAL, ["time.end=1"], "time: has no meaning in flow: stokes"),
        (MINIMAL, ["time.cfl=1.1"], "must be at most 1"),
        (MINIMAL, ["flow=navier_stokes"], "time: the run would not end; give time.end or time.steady"),
        (MINIMAL, ["flow=navier_stokes"], "drive.axes: needs flow: stokes"),
        (MINIMAL, ["flow=navier_stokes"], "refine: needs flow: stokes"),
        (MINIMAL, ["drive.body_force=[1, 0, 0]"], "drive.axes: makes its own flow"),
        (MINIMAL, ["drive={}"], "drive: drives nothing"),
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
        (MINIMAL, ["reference.kind=sphere_array"], "kind sphere_array needs fraction"),
        (MINIMAL, ["reference.kind=taylor_green"], "kind taylor_green needs speed"),
        (SHAPES, ["geometry.periodic=[z]"], "geometry.periodic: a 2D scene has no axis z"),
        (SHAPES, ["drive.pressure_drop={z: 1}"], "drive.pressure_drop: a 2D scene has no axis z"),
        (SHAPES, ["geometry.walls.y_max.velocity=[0, 1]"], "moves the wall along y"),
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


def test_a_misspelt_key_is_not_reported_missing_too():
    assert len(problems(MINIMAL.replace("spacing", "spacin"))) == 1


def test_text_keeps_the_words_that_yaml_would_convert():
    assert read("title: no\n" + MINIMAL).title == "no"
    assert read("title: 'null'\n" + MINIMAL).title == "null"


@given(st.text(max_size=30))
@settings(max_examples=30, deadline=None)
def test_any_title_survives_the_round_trip(title):
    try:
        case = read(MINIMAL, "title=" + json.dumps(title))
    except CaseError as error:
        assert "control characters" in str(error) or "not YAML" in str(error)
    else:
        assert read(dump_case(case)).title == case.title


@given(st.binary(max_size=60) | st.text("{}[]:-,#&*!|>'\"% \t\nab1.e~?@`\\", max_size=60).map(str.encode))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_a_case_or_a_case_error(data):
    with pytest.raises(CaseError):
        read_case(data, "case.yaml")


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_a_damaged_case_is_a_case_or_a_case_error(data):
    text = data.draw(st.sampled_from([BEADS, SHAPES, MINIMAL]))
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 20)))
    middle = data.draw(
        st.sampled_from(["", "null", "[]", "{}", "-1", "solid", "\n", ": ", "[1, 2]", "1e-400"])
    )
    try:
        case = read(text[:start] + middle + text[end:])
    except CaseError:
        return
    assert read(dump_case(case)) == case


def test_a_hostile_megabyte_is_refused_quickly():
    start = time.process_time()
    for text in (
        "a" * 999_999,
        "[" * 999_999,
        "{a: " * 249_999,
        "- " * 499_999,
        "".join(f"k{i}: 1\n" for i in range(40_000)),
    ):
        assert len(problems(text)) <= 100
    assert time.process_time() - start < 20  # measured 2 s


def test_importing_the_reader_does_not_import_numpy():
    code = "import sys, isphcli.case.load; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_every_key_is_documented_and_the_generated_files_are_fresh():
    for path, text in case_docs.generated().items():
        assert path.read_text(encoding="utf-8") == text, f"{path}: run python -m isphcli.case.docs"


def test_schema_accepts_what_the_reader_accepts_and_refuses_typos():
    validator = jsonschema.Draft202012Validator(case_docs.schema())
    validator.check_schema(case_docs.schema())
    for text in (BEADS, SHAPES, MINIMAL):
        validator.validate(json.loads(json.dumps(_numbers(yaml.safe_load(dump_case(read(text)))))))
        validator.validate(_numbers(yaml.safe_load(text)))
    for bad in ("particles.spacin=1", "particles.spacing=-1", "drive.axes=[w]", "geometry.voxels.file=a"):
        tree = yaml.safe_load(MINIMAL)
        name, value = bad.split("=")
        *above, last = name.split(".")
        block = tree
        for part in above:
            block = block.setdefault(part, {})
        block[last] = yaml.safe_load(value)
        assert not validator.is_valid(tree), bad


def _numbers(tree):
    """What an editor's YAML 1.2 parser makes of `1e-5`, which PyYAML leaves as text."""
    if isinstance(tree, dict):
        return {k: _numbers(v) for k, v in tree.items()}
    if isinstance(tree, list):
        return [_numbers(v) for v in tree]
    try:
        return float(tree) if isinstance(tree, str) else tree
    except ValueError:
        return tree


def test_paths_of_outputs_may_be_anywhere(files):
    assert read(MINIMAL, "output.directory=/tmp/a/../b").output.directory == Path("/tmp/b")
    assert read(MINIMAL, "output.directory=x").output.directory == Path(os.getcwd()) / "x"


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


@pytest.mark.parametrize("block", ["geometry", "particles", "fluids"])
def test_an_empty_required_block_is_a_problem(block):
    """Found by the property test: `geometry: null` once ended in a traceback."""
    text = {"geometry": "{box: [1, 1]}", "particles": "{spacing: 0.1}", "fluids": "{a: {density: 1, viscosity: 1}}"}
    text[block] = "null"
    with pytest.raises(CaseError):
        read_case("".join(f"{k}: {v}\n" for k, v in text.items()).encode(), "case.yaml")
