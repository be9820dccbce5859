"""What a steady case says of its results."""

import pytest

from isphcli.runs.results import Seen
from isphcli.runs.steady_case import AxisResult, _tell
from tests.preflight.cases import SLIT, read


@pytest.mark.parametrize("across, median, told", [(1.1, 4.0, True), (3.1, 4.0, False), (1.1, 2.0, False)])
def test_pores_that_the_flow_sees_narrower_than_the_check(across, median, told):
    """k = porosity width^2 / 12 of a width that no median of throats shows; told once, by the check or by the run."""
    case = read(SLIT)
    h, seen = case.particles.spacing, Seen(throats={"median": median})
    _tell(AxisResult("x", 0.3 * (across * h) ** 2 / 12, {}, []), case, {}, seen, 0.3)
    assert any(f"the flow along x sees pores (sqrt(12 k / porosity)) {across:.3g} particles" in text
               for text in seen.warnings) == told
