"""The programs in examples/ run small, and find their physical numbers."""

import importlib.util

import pytest

from .paths import ROOT


def example(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_rock():
    """Beside the walls of voxels, at one particle a voxel: 1.01e-12 m2 (`isph run cases/berea.yaml --set
    'geometry.voxels.crop=[[0,40],[0,40],[0,40]]'`). Smooth walls open throats: 11 % more measured."""
    found = example("rock").main(40, quiet=True)
    assert found.permeability == pytest.approx(1.01e-12, rel=0.2)
    low, high = found.permeability_range
    assert low < found.permeability < high


def test_sphere_pack():
    """Kozeny and Carman's constant varies by some 30 % from pack to pack (measured 16 % off). No pack conducts better
    than the bound of Maxwell, Hashin and Shtrikman; Bruggeman's power law of spheres is 3 % less than measured."""
    module = example("sphere_pack")
    found = module.main(20, 6.0, quiet=True)
    porosity = found.porosity
    assert porosity == pytest.approx(0.7, abs=0.01)
    assert found.permeability == pytest.approx(module.kozeny_carman(porosity, 2e-4), rel=0.3)
    factor = found.summary["formation_factor"]
    assert factor > (3 - porosity) / (2 * porosity) and factor == pytest.approx(porosity**-1.5, rel=0.1)
    assert 1.0 < found.summary["tortuosity"] < 1.5  # of packs of spheres 1.1 to 1.5 is told


@pytest.mark.slow
def test_drop_in_a_throat():
    """Oil goes down the pressure, and as much of it is left: 2 % is what volumes of particles at interfaces vary by."""
    found = example("drop_in_throat").main(1.6e-5, 4e-4, quiet=True)
    first, last = found.history[0], found.history[-1]
    assert found.complete and last["centre_x_oil"] - first["centre_x_oil"] > 1.6e-5
    assert last["saturation_oil"] == pytest.approx(first["saturation_oil"], rel=0.02)


def test_porespy_pipeline():
    """Pores and axes arrive as PoreSpy has them. k of a pore space is of the order of D^2 / (32 F), with the diameter D
    of its pores and the formation factor F (Katz and Thompson 1986 have D_c^2 / (226 F) of the narrowest ones): within
    a factor of four."""
    pytest.importorskip("porespy")
    found, diameter = example("porespy_pipeline").main(24, quiet=True)
    assert found.porosity == pytest.approx(0.6, abs=0.03)  # walls are smooth, voxels are not
    expected = diameter**2 / (32.0 * found.summary["formation_factor"])
    assert expected / 4.0 < found.permeability < 4.0 * expected
