"""What a comparison needs and does not find is named, and every kind of the language has one."""

import numpy as np
import pytest

from isphcli.case.blocks import REFERENCE_KINDS
from isphcli.case.yaml import CaseError
from isphcli.references.compare import COMPARISONS, compare
from isphcli.references.errors import CompareError
from isphcli.references.parameters import PARAMETERS
from isphcli.references.single_phase import compare_snapshot
from tests.references.results import result_of, the_case


def test_what_is_missing_is_named():
    with pytest.raises(CaseError, match="kind sphere_array needs fraction"):
        the_case("sphere_array", "reference.parameters={}")
    case = the_case("sphere_array")
    with pytest.raises(CompareError, match="no permeability"):
        compare(case, result_of(case))
    case = the_case("lid_driven_cavity", "fluids.water.kinematic_viscosity=0.02")
    with pytest.raises(CompareError, match="Reynolds number 50"):
        compare(case, result_of(case))
    with pytest.raises(CompareError, match="names no reference"):
        compare(the_case("bead_pack"), None)
    case = the_case("taylor_green_3d", "reference.kind=taylor_green")
    with pytest.raises(CompareError, match="2D"):
        compare(case, result_of(case, time=0.0))
    case = the_case("slit")
    with pytest.raises(CompareError, match="no field at a time"):
        compare_snapshot(case, np.zeros((1, 2)), np.zeros((1, 2)), 0.0)
    with pytest.raises(CompareError, match="not finite"):
        compare(case, result_of(case, permeability=float("nan")))
    case = the_case("startup_couette", "flow=stokes", "time=null")
    with pytest.raises(CompareError, match="a steady solve has none"):
        compare(case, result_of(case))


def test_kinds():
    """Every kind of the language is compared, and says what its parameters are."""
    assert set(COMPARISONS) == set(REFERENCE_KINDS) == set(PARAMETERS)
