"""`refine: throats`: half the spacing where a flow loses its energy."""

import json
import re

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.case.yaml import CaseError
from isphcli.domain.lattice import make_lattice
from isphcli.output.files import read_history
from isphcli.runs.half_in_throats import cells_that_lose
from isphcli.runs.run import run_case
from isphcli.scene import memory

FLOW = """
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
refine: throats
output: {plots: false}
"""
# A row of spheres whose gaps are two spacings wide, in a wide box
ARRAY = FLOW + """
geometry:
  box: [1, 1, 1]
  periodic: [x, y, z]
  shapes: [{sphere: {centre: [0.5, 0.5, 0.5], radius: 0.372210}, is: solid}]
"""
ZICK_AND_HOMSY = 1.0 / (6.0 * np.pi * 0.372210 * 7.442)  # solid fraction 0.216


def test_a_run_says_the_value_of_both_spacings_and_a_bar_that_holds(tmp_path):
    case = read_case(ARRAY.encode(), "case.yaml", (f"output.directory={tmp_path / 'out'}",))
    run_case(case, quiet=True)
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    coarse, both = (found["permeability_by_spacing"]["x"][key] for key in ("0.125", "0.125 and 0.0625"))
    assert found["permeability"] == both != coarse
    assert abs(both - ZICK_AND_HOMSY) < found["permeability_error"] < 0.05 * both
    assert re.search(r"half the spacing where 90% of the energy is lost \(([\d,]+) particles, of ([\d,]+) of half the "
                     r"spacing everywhere\): the value is that of this second solve", found["message"])
    first, second = read_history(tmp_path / "out" / "history.csv")
    assert (first["spacing"], second["spacing"]) == (0.125, 0.0625)
    # k of eq. 28, a force of one and a viscosity of one
    assert np.isclose(second["superficial_velocity_x"] / first["superficial_velocity_x"], both / coarse, rtol=1e-6)
    assert found["iterations"]["stokes"]["max"] == second["iterations_stokes"] > first["iterations_stokes"]
    # a wide pore: nearly all of it is cut
    assert any("is as cheap and has the narrower bar" in text for text in found["warnings"])


def test_a_second_solve_that_does_not_fit_leaves_the_first_one(tmp_path, monkeypatch):
    """Along each axis the value of the first solve, without a bar."""
    out = f"output.directory={tmp_path / 'out'}"
    case = read_case(ARRAY.encode(), "case.yaml", (out, "drive.axes=[x, y]"))
    monkeypatch.setattr(memory, "BYTES_TWO_SPACINGS", 1e12)
    run_case(case, quiet=True)
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert found["permeability_error"] is None
    assert np.allclose(list(found["permeability"].values()), ZICK_AND_HOMSY, rtol=0.05)
    told = [text for text in found["warnings"] if "no error bar" in text]
    assert [text[:50] for text in told] == [f"refine: throats: no second solve along {a}, so no er" for a in "xy"]
    assert "take a larger particles.spacing" in told[0] and "and refine" not in told[0]


def test_the_fewest_cells_that_hold_a_share_and_lose_more_than_the_mean():
    """Of energies 8, 4, 2, 1, 1 in a row two hold 0.75, and with 4 twice three: neither of them is chosen alone."""
    lattice = make_lattice("cubic", np.zeros(3), [9.0, 1.0, 1.0], [False] * 3, 1.0, 2.0)
    x = np.array([[0.5, 0.5, 0.5], [4.5, 0.5, 0.5], [5.5, 0.5, 0.5], [6.5, 0.5, 0.5], [8.5, 0.5, 0.5]])
    # two cells lie before the box
    assert cells_that_lose(lattice, x, np.array([1.0, 8.0, 4.0, 2.0, 1.0]), 0.7).tolist() == [[6, 2, 2], [7, 2, 2]]
    found = cells_that_lose(lattice, x, np.array([1.0, 8.0, 4.0, 4.0 - 1e-6, 1.0]), 0.65)
    assert found.tolist() == [[6, 2, 2], [7, 2, 2], [8, 2, 2]]
    # 9 of 15.5 hold 0.55, and 3.5 is more than the mean
    assert cells_that_lose(lattice, x, np.array([1.0, 9.0, 3.5, 1.0, 1.0]), 0.55).tolist() == [[6, 2, 2], [7, 2, 2]]
    assert len(cells_that_lose(lattice, x, np.zeros(5), 0.9)) == 0


@pytest.mark.parametrize(("more", "said"), [
    ("particles.jitter=0.1", "throats knows no jitter"),
    ("particles.lattice=bcc", "throats knows no lattice bcc"),
])  # fmt: skip
def test_what_it_does_not_know_is_refused(more, said):
    with pytest.raises(CaseError, match=said):
        read_case(ARRAY.encode(), "case.yaml", (more,))


# Eight spacings across; in the middle cells are not cut
SLIT = FLOW + """
geometry:
  box: [0.5, 1, 0.5]
  periodic: [x, z]
  slip_length: 0.1
"""


@pytest.mark.slow
def test_walls_that_slip(tmp_path):
    """Between plates k = h^2 / 12 + b h / 2: the error of slip is of first order, half of the spacing leaves 0.50 of it
    (measured), and the bar holds it."""
    case = read_case(SLIT.encode(), "case.yaml", (f"output.directory={tmp_path / 'out'}",))
    run_case(case, quiet=True)
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    truth = 1.0 / 12.0 + 0.1 / 2.0
    coarse, both = (abs(found["permeability_by_spacing"]["x"][key] - truth) for key in ("0.125", "0.125 and 0.0625"))
    assert both < 0.55 * coarse < 0.02 * truth
    assert both < found["permeability_error"] < 0.1 * truth and "what slip walls leave" in found["message"]
