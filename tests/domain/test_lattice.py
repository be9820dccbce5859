"""Lattices: they fill their box, go on beyond walls, and are refused where they do not fit."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from isphcli.domain import lattice as module
from isphcli.domain.lattice import BASES, ParticleError, make_lattice

KINDS = {"square": 2, "hexagonal": 2, "cubic": 3, "bcc": 3}
NEAREST = {"square": 1.0, "hexagonal": 1.0, "cubic": 1.0, "bcc": np.sqrt(0.75)}  # over the spacing


def sites(lattice):
    return np.concatenate(list(lattice.slabs()))


def test_every_kind_is_looked_at():
    assert set(KINDS) == set(BASES)


@pytest.mark.parametrize("kind", KINDS)
def test_a_periodic_lattice_fills_its_box(kind):
    """Stretched to fit: whole cells, every site inside, and their volumes add up to that of the box."""
    dim = KINDS[kind]
    upper = np.array([1.0, 1.37, 0.83])[:dim]
    lattice = make_lattice(kind, np.zeros(dim), upper, [True] * dim, 0.1, 0.25)
    x = sites(lattice)
    assert len(x) == lattice.sites and (x > 0).all() and (x < upper).all()
    assert lattice.sites * lattice.site_volume == pytest.approx(upper.prod(), rel=1e-13)
    asked = np.array([0.1, 0.1 * np.sqrt(3), 0.1]) if kind == "hexagonal" else np.full(3, 0.1)
    assert np.abs(lattice.counts - upper / asked[:dim]).max() <= 0.5
    # no other number of cells would be stretched less
    tree = cKDTree(x, boxsize=upper)
    assert tree.query(x, k=2)[0][:, 1] == pytest.approx(0.1 * NEAREST[kind], rel=0.06)


def test_a_lattice_between_walls_has_the_spacing_that_was_asked_for():
    """From half a spacing above the lower face, and a margin beyond both: what is left over is at the upper one."""
    lattice = make_lattice("square", [0, 2], [1, 2.73], [True, False], 0.1, 0.25)
    y = np.unique(np.round(sites(lattice)[:, 1], 9))
    assert np.diff(y) == pytest.approx(0.1, abs=1e-12)
    inside = y[(y > 2) & (y < 2.73)]
    assert inside[0] == pytest.approx(2.05) and len(inside) == 7
    assert y[0] < 2 - 0.25 + 0.1 and y[-1] > 2.73 + 0.25 - 0.1  # no site of the margin is missing
    assert lattice.cell == pytest.approx([0.1, 0.1], rel=1e-12)


def test_an_offset_moves_all_sites():
    """And the margin beyond walls is still full: one more site would lie outside of it."""
    plain = make_lattice("square", [0, 0], [1, 1], [True, False], 0.1, 0.2)
    for offset in ([0.3, 0.2], [0.0, 0.9], [0.1, -0.4]):
        x = sites(make_lattice("square", [0, 0], [1, 1], [True, False], 0.1, 0.2, offset))
        remainder = (x - sites(plain)[0]) / 0.1 - offset
        assert remainder == pytest.approx(np.round(remainder), abs=1e-9)
        assert x[:, 1].min() - 0.1 < -0.2 and x[:, 1].max() + 0.1 > 1.2


@pytest.mark.parametrize("kind", KINDS)
def test_slabs_are_the_lattice_however_thick_they_are(kind, monkeypatch):
    dim = KINDS[kind]
    lattice = make_lattice(kind, np.zeros(dim), np.ones(dim), [True] * dim, 0.1, 0.25)
    whole = sites(lattice)
    monkeypatch.setattr(module, "CLASSIFY_AT_ONCE", 3 * lattice.sites // lattice.counts[0])
    parts = list(lattice.slabs())
    assert len(parts) > 3 and np.array_equal(np.concatenate(parts), whole)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ParticleError, match="axis y"):
        make_lattice("square", [0, 0], [1, 0.05], [True, True], 0.1, 0.25)
    with pytest.raises(ParticleError, match="1e9 sites"):
        make_lattice("cubic", [0, 0, 0], [1, 1, 1], [True] * 3, 1e-4, 2.5e-4)
