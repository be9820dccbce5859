"""The program in examples/ runs small, and finds its physical number."""

import importlib.util

import pytest

from .paths import ROOT


def example(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_porespy_pipeline():
    """Pores and axes arrive as PoreSpy has them. k of a pore space is of the order of D^2 / (32 F), with the diameter D
    of its pores and the formation factor F (Katz and Thompson 1986 have D_c^2 / (226 F) of the narrowest ones): within
    a factor of four."""
    pytest.importorskip("porespy")
    found, diameter = example("porespy_pipeline").main(24, quiet=True)
    assert found.porosity == pytest.approx(0.6, abs=0.03)  # walls are smooth, voxels are not
    expected = diameter**2 / (32.0 * found.summary["formation_factor"])
    assert expected / 4.0 < found.permeability < 4.0 * expected
