"""The volume of each part of a fluid, kept by the level of phi."""

import numpy as np
import pytest

from isphcli.two_phase.cut_cells import cut
from isphcli.two_phase.interface import find_interface
from isphcli.two_phase.kept_volumes import kept_volumes
from tests.two_phase.scenes import drop, scene
from tests.two_phase.test_interface import TWO_DISKS


def passes(stepper, config, phi, volume, count):
    """phi and shares after so many steps in which nothing moves, and the cut cells at the end."""
    x, ops = config.x, config.ops
    for _ in range(count):
        there = cut(stepper.fluids.grid.cells, x, phi, find_interface(ops, config.neighbours, phi, stepper.spacing).fit)
        phi, volume = kept_volumes(there, ops.neighbours, phi, phi.copy(), volume, stepper.spacing)
    return phi, volume, cut(stepper.fluids.grid.cells, x, phi,
                            find_interface(ops, config.neighbours, phi, stepper.spacing).fit)


def test_each_disk_has_its_own_volume_back():
    """One level too low by 0.1 spacings, the other too high: each comes back to what its particles remember, and
    nothing goes from one to the other. Half of what is lacking comes back in a step: 2^-12 is left of 0.1 spacings."""
    _, _, state, stepper, _ = scene(TWO_DISKS)
    config = stepper.configure(state.x, phi=state.phi)
    small, spacing = np.linalg.norm(state.x - 0.2, axis=1) < 0.25, stepper.spacing
    near = np.linalg.norm(stepper.fluids.grid.cells.middle - 0.2, axis=1) < 0.25
    wanted = config.terms.interface.cut.volume
    wrong = state.phi + np.where(small, 0.1, -0.1) * spacing
    there, seen = config.terms.interface.cut, config.ops.neighbours
    phi, volume = kept_volumes(there, seen, state.phi, wrong, state.volume, spacing)
    phi, volume, found = passes(stepper, config, phi, volume, 12)
    for mine in (near, ~near):
        assert found.volume[mine].sum() == pytest.approx(wanted[mine].sum(), rel=1e-4)
    inside = phi > 0.0
    assert volume[inside & small].sum() == pytest.approx(wanted[near].sum(), rel=1e-9)
    assert volume.sum() == pytest.approx(state.volume.sum(), rel=1e-12)


def test_levels_outside_of_the_sample_stay():
    """Of two disks that are too large by a tenth of a spacing that in the sample gives half of it back, the other one
    nothing: what it has too much is no matter of the first one's either."""
    _, _, state, stepper, _ = scene(TWO_DISKS)
    config = stepper.configure(state.x, phi=state.phi)
    wrong, spacing = state.phi + 0.1 * stepper.spacing, stepper.spacing
    seen = config.ops.neighbours
    wrong, shares = kept_volumes(config.terms.interface.cut, seen, state.phi, wrong, state.volume, spacing)
    there = cut(stepper.fluids.grid.cells, config.x, wrong,
                find_interface(config.ops, config.neighbours, wrong, spacing).fit)
    sample = np.zeros(2), np.full(2, 0.45)
    phi, volume = kept_volumes(there._replace(sample=sample), seen, wrong, wrong.copy(), shares, spacing)
    inside, near = (state.x < 0.45).all(axis=1), np.abs(wrong) < spacing
    assert (phi[~inside] == wrong[~inside]).all()
    moved = (wrong - phi)[inside & near] / spacing
    assert moved == pytest.approx(0.05, rel=0.1) and volume.sum() == pytest.approx(state.volume.sum())


def test_a_level_that_is_right_stays():
    """To round-off: nothing is lacking."""
    _, _, state, stepper, _ = scene(drop(jitter=0.1))
    config = stepper.configure(state.x, phi=state.phi)
    phi, volume, _ = passes(stepper, config, state.phi, state.volume, 3)
    assert np.abs(phi - state.phi).max() < 1e-9 * stepper.spacing and volume == pytest.approx(state.volume)


def test_particles_leave_their_shares_where_the_interface_has_passed():
    """A particle on the edge comes to the other fluid because the level has moved past it: the shares of both parts
    are what they were, over other numbers of particles."""
    _, _, state, stepper, _ = scene(drop())
    config = stepper.configure(state.x, phi=state.phi)
    new = state.phi - 0.3 * stepper.spacing
    phi, volume = kept_volumes(config.terms.interface.cut, config.ops.neighbours, state.phi, new, state.volume,
                               stepper.spacing)
    changed = (phi > 0.0) != (state.phi > 0.0)
    assert changed.any()
    for side in (True, False):
        assert volume[(phi > 0.0) == side].sum() == pytest.approx(state.volume[(state.phi > 0.0) == side].sum())


def test_a_splinter_that_vanishes_leaves_its_volume_to_its_fluid():
    """A single particle of the drop's fluid away from it is smoothed out: the drop has its volume then."""
    _, _, state, stepper, _ = scene(drop(radius=0.2))
    spacing, phi = stepper.spacing, state.phi.copy()
    lone = np.linalg.norm(state.x - 0.1, axis=1).argmin()
    r = np.linalg.norm(state.x - state.x[lone], axis=1)
    near = r < 3 * spacing
    phi[near] = np.maximum(phi[near], 0.6 * spacing - r[near])
    config = stepper.configure(state.x, phi=phi)
    from isphcli.two_phase.kept_volumes import first_shares

    volume = first_shares(config.terms.interface.cut, config.ops.neighbours, phi, spacing)
    first = volume[phi > 0.0].sum()
    assert volume[lone] > 0 and (phi > 0.0).sum() == (state.phi > 0.0).sum() + 1
    there, seen = config.terms.interface.cut, config.ops.neighbours
    after, kept = kept_volumes(there, seen, phi, state.phi.copy(), volume, spacing)
    assert after[lone] < 0.0 and kept[after > 0.0].sum() == pytest.approx(first)
