"""What a steady case says of its results."""

import json
import re

import pytest

from isphcli.output.clock import Clock
from isphcli.runs import steady_case as module
from isphcli.runs.results import Seen
from isphcli.runs.steady_case import AxisResult, _tell
from tests.preflight.cases import SLIT, read


@pytest.mark.parametrize("across, median, told", [(1.1, 4.0, True), (3.1, 4.0, False), (1.1, 2.0, False)])
def test_pores_that_the_flow_sees_narrower_than_the_check(across, median, told):
    """k = porosity width^2 / 12 of a width that no median of throats shows; told once, by the check or by the run."""
    case = read(SLIT)
    h, seen = case.particles.spacing, Seen(throats={"median": median})
    _tell(AxisResult("x", 0.3 * (across * h) ** 2 / 12, {}, []), case, {}, seen, 0.3)
    assert any(f"the flow along x sees pores (tortuosity sqrt(12 k / porosity)) {across:.3g} particles" in text
               for text in seen.warnings) == told


def test_pores_across_the_axis_are_as_wide_as_those_along_it():
    """Slits at 45 degrees have half the permeability of those along the axis, and their flow is as well resolved."""
    case = read(SLIT)
    h, warned = case.particles.spacing, []
    for longer in (1.0, 2**0.5):
        seen = Seen(throats={"median": 4.0})
        _tell(AxisResult("x", 0.5 * 0.3 * (3.1 * h) ** 2 / 12, {}, []), case, {}, seen, 0.3, longer)
        warned.append(bool(seen.warnings))
    assert warned == [True, False]


def test_an_interrupted_ladder_keeps_the_spacings_that_are_solved(tmp_path, monkeypatch):
    """Ctrl-C in the second of three: files of the first, k of the slit, and who interrupted is told."""
    solve = module._solve_spacing

    def interrupted(job, spacing, found, needed):
        if found.flows:
            raise KeyboardInterrupt
        return solve(job, spacing, found, needed)

    monkeypatch.setattr(module, "_solve_spacing", interrupted)
    plain = ("output.plots=false", "output.snapshots=false")
    case = read(SLIT, *plain, "refine=[0.03125, 0.015625]", f"output.directory={tmp_path}")
    with pytest.raises(KeyboardInterrupt) as stopped:
        module.run_steady(case, Clock(), True, None)
    assert stopped.value.results == tmp_path
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["status"] == "interrupted" and summary["permeability_error"] is None
    alone, _ = module.run_steady(read(SLIT, *plain, f"output.directory={tmp_path / 'alone'}"), Clock(), True, None)
    assert summary["permeability"] == alone["permeability"] > 0.0


def test_a_full_disk_does_not_take_the_permeability_with_it(tmp_path, monkeypatch):
    """A slit between plates D apart has k = D^2 / 12 of its width: the error names it where the files cannot be."""

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_write_fields", full)
    with pytest.raises(OSError, match="No space left") as caught:
        module.run_steady(read(SLIT, "output.plots=false", f"output.directory={tmp_path}"), Clock(), True, None)
    found = re.search(r"permeability\s+(\S+) m2", caught.value.found)
    box = read(SLIT).geometry.box
    assert found is not None and float(found[1]) == pytest.approx(box[1] ** 2 / 12, rel=0.01)
