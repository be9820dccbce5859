"""Parts of particles and cells that lie within a sample, or a section of it."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.domain.lattice import BASES, make_lattice
from isphcli.geometry.extents import POINTS, fluid_part_of_sample, part_of_sample, sections
from isphcli.runs.permeability import fluid_cells
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import place

SLIT = b"""
geometry:
  box: [3, 1]
  periodic: [x, y]
  shapes:
    - {box: {lower: [0.5, 0], upper: [2.5, 0.25]}, is: solid}
    - {box: {lower: [0.5, 0.75], upper: [2.5, 1]}, is: solid}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
"""


def slit():
    """Two blocks with a slit of half the height between them, flat at both ends, between clear layers."""
    geometry = build_geometry(read_case(SLIT, "case.yaml"))
    geometry.sample_lower, geometry.sample_upper = np.array([0.5, 0.0]), np.array([2.5, 1.0])
    return geometry


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.4, 0.5])
@pytest.mark.parametrize("rows", [24, 25])
def test_the_porosity_of_a_sample_with_flat_ends_is_its_own(offset, rows):
    """A half, wherever its ends lie between layers of the lattice; along y the lattice fits the slit. With all of a
    cell at an end or nothing it was 0.56 with sites on both ends, with its part of fluid that lies in front of the rock
    0.516."""
    geometry = slit()
    lattice = make_lattice("square", geometry.lower, geometry.upper, [True, True], 0.125, 0.3, [offset, 0.0])
    lattice = replace(lattice, cell=np.array([3.0 / rows, 0.125]), counts=np.array([rows, 8]))
    cells = fluid_cells(geometry, place(geometry, lattice, 0.3), thick=lattice.thick)
    assert cells * lattice.site_volume / 2.0 == pytest.approx(0.5, rel=1e-7)


def test_of_a_cell_in_front_of_flat_rock_all_fluid_lies_beyond():
    geometry, thick = slit(), np.array([0.2, 0.2])
    x = np.array([[0.45, 0.12], [0.45, 0.5], [0.55, 0.5], [1.5, 0.5], [0.2, 0.5], [2.55, 0.88]])
    assert part_of_sample(geometry, x, thick) == pytest.approx([0.25, 0.25, 0.75, 1.0, 0.0, 0.25])
    for points in (1, POINTS):
        found = fluid_part_of_sample(geometry, x, thick, points)
        assert found == pytest.approx([0.0, 0.25, 0.75, 1.0, 0.0, 0.0])


@pytest.mark.parametrize("kind", BASES)
@pytest.mark.parametrize("offset", [0.0, 0.37, 0.5])
def test_every_section_of_a_lattice_has_its_length_of_it(kind, offset):
    """Layers of a lattice fill a box without gaps: sections of it hold volumes as their lengths, however many of the
    layers have their middles there. Beyond a wall extents count in the section next to it."""
    dim = BASES[kind].shape[1]
    lower, upper = np.zeros(dim), np.ones(dim)
    lattice = make_lattice(kind, lower, upper, [True] * dim, 0.1, 0.3, [offset] * dim)
    x = np.mod(np.concatenate([*lattice.slabs()]), 1.0)
    for axis in range(dim):
        for count in (1, 3, 7):
            section, who, part = sections(x[:, axis], float(lattice.thick[axis]), (0.0, 1.0), count, True)
            held = np.bincount(section, part, count) * lattice.site_volume
            assert held == pytest.approx(np.full(count, 1.0 / count), rel=1e-7)
            assert np.bincount(who, part, len(x)) == pytest.approx(np.ones(len(x)), rel=1e-7)
    section, who, part = sections(np.array([0.02, 0.5, 0.99]), 0.1, (0.0, 1.0), 4, False)
    assert np.bincount(section, part, 4) == pytest.approx([1.0, 0.5, 0.5, 1.0])
