"""Periodic images against brute force over all box shifts."""

import itertools

import numpy as np
import pytest

from isphcli.domain.halo import build_halo, wrap


def all_images(x, lower, upper, periodic, support):
    """Every (owner, shift counts) with its image strictly within one support of the box."""
    length = upper - lower
    most = np.ceil(support / length).astype(int) + 1
    reach = [range(-m, m + 1) if p else range(1) for p, m in zip(periodic, most)]
    found = set()
    for counts in itertools.product(*reach):
        if any(counts):
            moved = x + np.array(counts) * length
            # along axes that are not periodic a particle may lie anywhere: dummies beyond the faces do
            near = np.where(periodic, (moved > lower - support) & (moved < upper + support), True).all(axis=1)
            found |= {(int(k), counts) for k in np.flatnonzero(near)}
    return found


SCENES = {
    "plain 2D": ([1.0, 1.0], [True, True], 0.2),
    "one axis": ([1.0, 0.5], [False, True], 0.2),
    "plain 3D": ([1.0, 0.7, 0.9], [True, True, True], 0.2),
    "thinner than a support": ([1.0, 0.15], [True, True], 0.2),
    "several images an axis": ([1.0, 0.06, 0.13], [True, True, True], 0.2),
    "a support is a whole number of boxes": ([1.0, 0.25], [True, True], 0.5),
    "closed": ([1.0, 1.0], [False, False], 0.2),
}


@pytest.mark.parametrize("name", SCENES)
def test_images_are_all_images(name):
    length, periodic, support = SCENES[name]
    dim, periodic = len(length), np.array(periodic)
    lower = np.linspace(-0.3, 0.4, dim)
    upper = lower + length
    x = np.random.default_rng(0).uniform(lower, upper, (60, dim))
    halo = build_halo(x, lower, upper, periodic, support)
    counts = np.round(halo.shift / length).astype(int)
    assert np.allclose(counts * length, halo.shift, atol=1e-12)
    rows = [(int(o), tuple(int(c) for c in row)) for o, row in zip(halo.owner, counts)]
    assert len(set(rows)) == len(rows)
    assert set(rows) == all_images(x, lower, upper, periodic, support)
    assert np.array_equal(halo.owners(60)[:60], np.arange(60))
    assert np.allclose(halo.positions(x)[60:], x[halo.owner] + counts * length, atol=1e-12)


def test_thin_box_keeps_full_neighbourhoods():
    """A lattice one particle thick: every particle sees the neighbours of the infinite lattice."""
    spacing, support = 0.1, 0.21
    x = np.stack([(np.arange(10) + 0.5) * spacing, np.full(10, 0.5 * spacing)], axis=1)
    halo = build_halo(x, np.zeros(2), np.array([1.0, spacing]), np.array([True, True]), support)
    rows = halo.positions(x)
    for i in range(10):
        assert (np.linalg.norm(rows - x[i], axis=1) < support).sum() == 13  # 12 within 2.1 spacings


def test_without_periodic_axes_nothing_is_copied():
    x = np.random.default_rng(0).random((5, 3))
    halo = build_halo(x, np.zeros(3), np.ones(3), np.zeros(3, bool), 0.5)
    assert len(halo.owner) == 0
    assert halo.positions(x) is x


def test_wrap():
    lower, upper, periodic = np.array([-1.0, 0.0]), np.array([1.0, 1.0]), np.array([True, False])
    x = np.array([[1.0, 2.0], [-1.0, -3.0], [5.5, 0.0], [-1.0 - 1e-17, 0.5], [0.999, 0.5]])
    wrapped = wrap(x, lower, upper, periodic)
    assert np.array_equal(wrapped[:, 1], x[:, 1])
    assert wrapped[:, 0] == pytest.approx([-1.0, -1.0, -0.5, -1.0, 0.999])
    assert np.array_equal(x[0], [1.0, 2.0])  # the argument stays


def test_wrap_ends_in_the_box_whatever_the_round_off():
    rng = np.random.default_rng(0)
    for lower, length in rng.uniform(0.01, 1.0, (300, 2)) * [-1.0, 1.0]:
        upper = lower + length
        near = [np.nextafter(lower, -9), np.nextafter(upper, -9), upper, lower - 1e-20, lower + 3 * length]
        x = np.array(near)[:, None] * np.ones(2)
        wrapped = wrap(x, np.full(2, lower), np.full(2, upper), np.ones(2, bool))
        assert np.all((wrapped >= lower) & (wrapped < upper))
