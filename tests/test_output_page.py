"""docs/output.md names every column and every key that a run leaves, and every limit of a step."""

import csv
import inspect
import json
import re

import pytest

from isphcli.case.load import read_case
from isphcli.flow import step_lengths
from isphcli.output.files import SUMMARY_KEYS
from isphcli.runs.run import run_case

from .paths import ROOT

# Walls, reservoirs, tension, a contact angle, a drive in steps, particles that are kept: all columns but `amplitude`,
# `volume_drift` of one fluid and `change`
DRAINED = """
geometry: {box: [4, 1], periodic: [x], fluid: water, shapes: [{box: {lower: [0, 0], upper: [1.5, 1]}, is: gas}]}
particles: {spacing: 0.125}
fluids: {water: {density: 2, viscosity: 0.3}, gas: {density: 1, viscosity: 0.3}}
interface: {tension: 1, contact_angle: 60}
reservoirs: {axis: x, inlet: gas, outlet: water, length: 1}
drive: {steps: {superficial_velocity: [0.1], duration: 0.01}}
time: {end: 0.01, max_steps: 3}
output: {plots: false, every: 0.01}
"""
SLIT = """
geometry: {box: [0.5, 1], periodic: [x]}
particles: {spacing: 0.125}
fluids: {water: {density: 2, viscosity: 0.3}}
drive: {body_force: [1, 0]}
output: {plots: false}
"""
IN_TIME = SLIT + "time: {steady: 1.0e-3, end: 1.0, max_steps: 3}\n"


def cells(page, heading, end="\n## "):
    """First cells of the tables under a heading."""
    part = page.split(f"\n## {heading}", 1)[1].split(end, 1)[0]
    return [row.split(" | ")[0] for row in part.splitlines() if row.startswith("| `")]


def names(cells):
    """What the cells name, `_y` after `centre_x` written out, and <fluid> a pattern."""
    found = set()
    for cell in cells:
        words = [word for word in re.findall(r"`([^`]+)`", cell) if not word.startswith("_")]
        found |= {re.sub(r"<\w+>", r"(water|gas|velocity|pressure|stokes)", word) for word in words}
    return found


def undocumented(columns, documented):
    """Columns that no name of the page fits; those of the other axes are named with that of x."""
    return [column for column in columns
            if not any(re.fullmatch(name, re.sub(r"_[xyz](?=_|$)", "_x", column)) for name in documented)]


@pytest.fixture(scope="module")
def page():
    return (ROOT / "docs/output.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module", params=[DRAINED, SLIT + "flow: stokes\n", IN_TIME], ids=["two", "steady", "one"])
def run(request, tmp_path_factory):
    """Folder of a run; what it leaves is all that counts."""
    folder = tmp_path_factory.mktemp("run") / "out"
    run_case(read_case(request.param.encode(), "case.yaml", (f"output.directory={folder}",)), quiet=True)
    return folder


def header(path):
    with open(path, encoding="utf-8", newline="") as file:
        return next(csv.reader(file))


@pytest.mark.slow
def test_every_column_that_a_run_leaves_is_explained(run, page):
    documented = names(cells(page, "history.csv"))
    assert undocumented(header(run / "history.csv"), documented) == []
    documented = names(cells(page, "profiles.csv and curve.csv"))
    for name in ("profiles.csv", "curve.csv"):
        if (run / name).exists():
            assert undocumented(header(run / name), documented) == [], name


@pytest.mark.slow
def test_every_key_that_a_run_leaves_is_explained(run, page):
    documented, summary = names(cells(page, "summary.json")), json.loads((run / "summary.json").read_text())
    assert undocumented(summary, documented) == []
    # of two fluids those of the history, and what the row of `two_fluids` names besides
    row = next(row for row in page.splitlines() if row.startswith("| `two_fluids`"))
    more = names(cells(page, "history.csv")) | names([row.split(" | ")[1]])
    assert undocumented(summary.get("two_fluids") or {}, more) == []


def test_every_key_of_a_summary_is_explained(page):
    assert set(SUMMARY_KEYS) <= names(cells(page, "summary.json"))


def test_every_limit_of_a_step_is_named(page):
    """On all three pages that list them."""
    source = inspect.getsource(step_lengths)
    found = re.findall(r'found\["(\w+)"\]|found = {"(\w+)"|limit = target, "(\w+)"', source)
    limits = {"".join(names) for names in found}
    assert {"cfl", "start", "step", "end"} < limits
    row = next(row for row in page.splitlines() if row.startswith("| `limit`"))
    assert set(re.findall(r"`(\w+)`", row.split(" | ", 1)[1])) == limits
    for file in ("resolution.md", "method.md"):
        table = (ROOT / "docs" / file).read_text(encoding="utf-8").split("\n| limit | ", 1)[1].split("\n\n")[0]
        assert set(re.findall(r"^\| `(\w+)`", table, re.M)) == limits, file
