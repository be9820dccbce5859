"""Any bytes give a clean error or a valid object; on the command line exit code 2, one message and no files."""

import io
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.case.load import dump_case, read_case
from isphcli.case.yaml import CaseError
from isphcli.cli import main
from isphcli.flow.state import State
from isphcli.geometry.bodies import ShapeError
from isphcli.output import restart
from isphcli.output.restart import RestartError, Saved
from isphcli.scene.sphere_files import read_spheres

BENCHMARK = Path(__file__).parent.parent / "benchmarks" / "bad_inputs.py"
IMAGE = np.array([[[0, 0, 1], [0, 1, 1]], [[0, 0, 0], [0, 0, 1]]], dtype=np.uint8)
CASE = """
geometry: {{voxels: {{file: {file}, labels: {{solid: 1, water: 0}}, voxel_size: 1}}, periodic: [x, y, z]}}
particles: {{spacing: 1}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
"""


def npy(values):
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def header(descr="|u1", shape="(2, 2, 3)", order="False"):
    text = f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def archive(**members):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as z:
        for name, data in members.items():
            z.writestr(f"{name}.npy", data)
    return file.getvalue()


def bomb():
    """A megabyte that says it holds a terabyte."""
    data = bytearray(archive(image=header(shape="(10000, 10000, 10000)") + b"\0" * 10**6))
    size = len(header()) + 10**6
    return bytes(data).replace(size.to_bytes(4, "little"), (2**32 - 2).to_bytes(4, "little"))


def meta(**changed):
    lines = {"NDims": "3", "DimSize": "3 2 2", "ElementType": "MET_UCHAR", "ElementDataFile": "LOCAL"} | changed
    return "".join(f"{k} = {v}\n" for k, v in lines.items()).encode() + IMAGE.tobytes()


BAD_IMAGES = {
    "empty.npy": b"",
    "truncated.npy": npy(IMAGE)[:-3],
    "no_voxels.npy": npy(IMAGE[:0]),
    "too_long.npy": npy(IMAGE) + b"\0",
    "huge_header.npy": header(shape="(100000, 100000, 100000)") + b"\0" * 100,
    "overflowing_header.npy": header(shape="(4294967296, 4294967296, 1)"),
    "negative_size.npy": header(shape="(-2, -2, 3)") + b"\0" * 12,
    "true_size.npy": header(shape="(True, 12)") + b"\7" * 12,
    "float.npy": npy(IMAGE.astype(float)),
    "nan.npy": npy(np.where(IMAGE, np.nan, 0.0)),
    "negative.npy": npy(IMAGE.astype(np.int8) - 1),
    "objects.npy": header(descr="|O") + b"\0" * 96,
    "one_dimension.npy": npy(IMAGE.ravel()),
    "wrong_endian.npy": header(descr=">u2") + IMAGE.astype("<u2").tobytes(),
    "unknown_label.npy": npy(IMAGE * 7),
    "empty.npz": b"",
    "no_member.npz": archive(),
    "truncated.npz": archive(image=npy(IMAGE))[:-30],
    "two.npz": archive(a=npy(IMAGE), b=npy(IMAGE)),
    "bomb.npz": bomb(),
    "truncated.mha": meta()[:-1],
    "huge.mha": meta(DimSize="100000 100000 100000"),
    "negative.mha": meta(DimSize="-3 -2 2"),
    "float.mha": meta(ElementType="MET_FLOAT", DimSize="3 1 1"),
    "short_big_endian.mha": meta(ElementType="MET_SHORT", BinaryDataByteOrderMSB="True", DimSize="3 2 1"),
    "no_data.mhd": meta(ElementDataFile="nowhere.raw"),
    "device.mhd": meta(ElementDataFile="/dev/zero"),
    "text.mhd": b"\x00\xff" * 50,
}


def isph_run(folder, text, *arguments):
    (folder / "case.yaml").write_text(text)
    return CliRunner().invoke(main, ["run", str(folder / "case.yaml"), "--out", str(folder / "out"), "--quiet",
                                     *arguments])


def refused(done, *words):
    assert done.exit_code == 2 and isinstance(done.exception, SystemExit), (done.output, done.exception)
    assert "error" in done.stderr and not done.stdout
    for word in words:
        assert word in done.stderr


@pytest.mark.parametrize("name", BAD_IMAGES)
def test_a_bad_image_is_named_and_refused(tmp_path, name):
    (tmp_path / name).write_bytes(BAD_IMAGES[name])
    refused(isph_run(tmp_path, CASE.format(file=name)), name)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_good_image_runs(tmp_path):
    """What the bad ones differ from."""
    for name, data in (("good.npy", npy(IMAGE)), ("good.npz", archive(image=npy(IMAGE))), ("good.mha", meta())):
        (tmp_path / name).write_bytes(data)
        assert isph_run(tmp_path, CASE.format(file=name), "--overwrite").exit_code == 0


GOOD = """
geometry: {box: [1, 1], periodic: [x]}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
time: {end: 1}
"""
TWO_FLUIDS = """
geometry:
  box: [1, 1]
  periodic: [x]
  fluid: water
  shapes: [{spheres: {random: 3, radius: 0.1, clearance: 0.05, seed: 1}, is: oil}]
particles: {spacing: 0.1}
fluids: {water: {density: 1000, viscosity: 1e-3}, oil: {density: 1, viscosity: 1e-5}}
interface: {tension: 0.07, contact_angle: 30, method: csf}
initial: {flood: {fluid: oil, from: x_min, saturation: 0.2}}
time: {end: 1, capillary: 0.5}
"""
BAD_CASES = {
    "an angle beyond 180": (TWO_FLUIDS.replace("angle: 30", "angle: 181"), "at most 180"),
    "a tension without a size": (TWO_FLUIDS.replace("0.07", "0"), "above 0"),
    "a flood of all and more": (TWO_FLUIDS.replace("saturation: 0.2", "saturation: 1.01"), "at most 1"),
    "a flood of nothing known": (TWO_FLUIDS.replace("fluid: oil, from", "fluid: gas, from"), "gas"),
    "more spheres than anybody draws": (TWO_FLUIDS.replace("random: 3", "random: 10000000"), "at most 10000"),
    "spheres without room": (TWO_FLUIDS.replace("random: 3", "random: 9999"), "smaller ones"),
    "a viscosity that vanishes": (TWO_FLUIDS.replace("1e-3", "5e-324"), "range of numbers"),
    "anchors": ("a: &a [1]\nb: &b [*a, *a]\n", "aliases"),
    "tabs": ("geometry:\n\tbox: [1, 1]\n", "spaces, not tabs"),
    "duplicate keys": (GOOD + "time: {end: 2}\n", "given twice"),
    "a list for a number": (GOOD.replace("0.1", "[0.1]"), "expected number"),
    "text for a number": (GOOD.replace("0.1", "fine"), "expected a number"),
    "infinity": (GOOD.replace("end: 1", "end: 1e999"), "not finite"),
    "nan": (GOOD.replace("0.1", ".nan"), "expected a number"),
    "negative": (GOOD.replace("0.1", "-0.1"), "above 0"),
    "too fine": (GOOD.replace("0.1", "1e-300"), "sites"),
    "a folder without slices": (CASE.format(file="."), "without slices"),
    "a device as an image": (CASE.format(file="/dev/zero"), "no such file"),
    "a tag that runs code": ("!!python/object/apply:os.system ['true']", "tags"),
    "code as a formula": (GOOD + 'initial: {velocity: ["__import__(\'os\')", "0"]}', "unknown function"),
    "nothing": ("", "missing"),
    "deep": ("[" * 1000, "deep"),
}


@pytest.mark.parametrize("name", BAD_CASES)
def test_a_bad_case_is_refused(tmp_path, name):
    text, word = BAD_CASES[name]
    without_line = name in ("spheres without room", "a folder without slices")
    refused(isph_run(tmp_path, text), *(() if without_line else ("case.yaml",)), word)
    assert not (tmp_path / "out").exists()


def test_an_image_in_other_units_than_the_spacing_is_refused(tmp_path):
    """Kilometres and micrometres: 1e25 sites are not even tried; `--check-only` says the same."""
    (tmp_path / "good.npy").write_bytes(npy(IMAGE))
    text = CASE.format(file="good.npy").replace("voxel_size: 1", "voxel_size: 1000")
    text = text.replace("spacing: 1", "spacing: 1e-6")
    refused(isph_run(tmp_path, text), "more than 1e9 sites")
    done = CliRunner().invoke(main, ["validate", "--check-only", str(tmp_path / "case.yaml")])
    assert done.exit_code == 2 and "more than 1e9 sites" in done.output


def test_a_sample_without_fluid_is_not_flooded(tmp_path):
    """All particles are in the clear layers: the only pore of the image lies between the sites of the lattice."""
    image = np.ones((4, 4, 4), np.uint8)
    image[0, 0, 0] = 0
    (tmp_path / "solid.npy").write_bytes(npy(image))
    text = TWO_FLUIDS.replace("spacing: 0.1", "spacing: 4").splitlines()
    text[1:6] = ["geometry: {voxels: {file: solid.npy, labels: {solid: 1, water: 0}, voxel_size: 1, clear_layer: 8}}",
                 "drive: {body_force: [1, 0, 0]}"]
    refused(isph_run(tmp_path, "\n".join(text)), "no fluid particle in the sample")


def test_files_outside_of_the_folder_are_read_and_nothing_else(tmp_path):
    """A case may name an image anywhere; what is there is only ever read as an image."""
    (tmp_path / "inner").mkdir()
    (tmp_path / "secret.npy").write_text("password")
    done = isph_run(tmp_path / "inner", CASE.format(file="../secret.npy"))
    refused(done, "secret.npy", "is not an npy array")
    assert "password" not in done.output


def test_a_formula_without_a_finite_value_is_refused(tmp_path):
    refused(isph_run(tmp_path, GOOD + 'initial: {velocity: ["1/(x - x)", "0"]}'), "is not finite everywhere")


def test_a_damaged_restart_file_is_refused(tmp_path):
    assert isph_run(tmp_path, GOOD + "output: {plots: false}").exit_code == 0
    path = tmp_path / "out" / restart.NAME
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 1
    path.write_bytes(data)
    before = {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    refused(CliRunner().invoke(main, ["run", "--restart", str(tmp_path / "out"), "--quiet"]), str(path))
    assert {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()} == before


state = State(*np.arange(28.0).reshape(4, 7)[:, :6].reshape(3, 4, 2), np.zeros(4), 0.5, 3, 0.1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    restart.save(folder / "whole.npz", Saved(state))
    return folder


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_any_bytes_are_a_restart_file_or_an_error(folder, data):
    whole = (folder / "whole.npz").read_bytes()
    start = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(start, min(len(whole), start + 40)))
    (folder / "r.npz").write_bytes(whole[:start] + data.draw(st.binary(max_size=40)) + whole[end:])
    try:
        found = restart.load(folder / "r.npz", state)
    except RestartError as error:
        assert "r.npz" in str(error)
    else:
        assert np.array_equal(found.state.x, state.x) and found.state.step == 3


@given(st.binary(max_size=80) | st.text("0123456789.,-+einfa#xyz \n\r\t\"", max_size=80).map(str.encode))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_spheres_or_an_error(folder, data):
    (folder / "s.csv").write_bytes(data)
    try:
        centres, radii = read_spheres(folder / "s.csv")
    except ShapeError as error:
        assert "s.csv" in str(error)
    else:
        assert centres.ndim == 2 and np.isfinite(centres).all() and np.all(np.asarray(radii) > 0)


words = st.sampled_from('0 -1 1e999 nan [] {} null solid x [1,2,3] 1e-320 "" &a *a'.split())


@given(st.sampled_from([GOOD, TWO_FLUIDS]), st.lists(st.tuples(st.integers(0, 60), words), min_size=1, max_size=4))
@settings(max_examples=100, deadline=None)
def test_any_words_are_a_case_or_a_case_error(text, changes):
    """Words and numbers of a good case replaced. What is read can be written and read again."""
    for which, word in changes:
        places = list(re.finditer(r"[\w.]+", text))
        at = places[which % len(places)]
        text = text[: at.start()] + word + text[at.end() :]
    try:
        case = read_case(text.encode(), "case.yaml")
    except CaseError as error:
        assert error.problems
    else:
        assert read_case(dump_case(case).encode(), "case.yaml") == case


@pytest.mark.slow
def test_a_sample_of_the_ten_thousand():
    """benchmarks/bad_inputs.py in a process of its own with limited memory: no traceback, no hang."""
    done = subprocess.run([sys.executable, str(BENCHMARK), "--count", "200", "--seed", "7"], capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    counts = re.search(r"^all +(\d+) +(\d+) +0 +0 +0$", done.stdout, re.M)
    assert counts and int(counts[1]) > 130 and int(counts[2]) > 10
