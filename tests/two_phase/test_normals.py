"""Normals and crossings of the interface, against exact ones."""

import numpy as np
import pytest

from isphcli.two_phase.normals import crossings, find_band, near_interface
from tests.two_phase.scenes import drop, layers, scene


@pytest.mark.parametrize("dim", [2, 3])
def test_the_thinnest_direction_of_a_tensor(dim):
    """That of numpy's eigh to round-off, wherever one stands apart, however thin and however long the tensor is."""
    from isphcli.two_phase.normals import FLAT, _flattest, _flattest_2d

    def thinnest(t, least):
        if dim == 2:
            return _flattest_2d(t[0, 0], t[1, 1], t[0, 1], least)
        return _flattest(t[0, 0], t[1, 1], t[2, 2], t[1, 2], t[0, 2], t[0, 1], least)

    rng, found = np.random.default_rng(0), 0
    for _ in range(300):
        axes, size = np.linalg.qr(rng.normal(size=(dim, dim)))[0], 10.0 ** rng.uniform(-4, 0, dim)
        size[0] *= rng.integers(2)
        values, vectors = np.linalg.eigh(axes * size @ axes.T)
        thin, *normal = thinnest(axes * size @ axes.T, 0.0)
        assert thin == (values[0] < FLAT * values[1]) or abs(values[0] / values[1] - FLAT) < 1e-8
        if thin:
            found += 1
            assert abs(normal[:dim] @ vectors[:, 0]) / np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
    assert 100 < found < 300
    assert not thinnest(np.eye(dim), 0.0)[0] and not thinnest(np.zeros((dim, dim)), 1e-30)[0]


def test_crossings_of_a_flat_interface_are_exact():
    _, _, state, stepper, _ = scene(layers(1 / 16, mu=5))
    config = stepper.configure(state.x, phi=state.phi)
    ops, colour = config.ops, stepper.fluids.colour
    near = near_interface(ops.start, ops.column, colour)
    t = crossings(ops, colour, near)
    i = np.repeat(np.arange(ops.n), np.diff(ops.start))
    unlike = colour[i] != colour[ops.column]
    seen = ops.neighbours
    y = seen.x[i, 1] + t * (seen.x[seen.row, 1] - seen.x[i, 1])
    assert unlike.any() and np.abs(y[unlike] - 0.5).max() < 1e-12


def test_normals_of_a_disk_point_into_it():
    _, _, state, stepper, _ = scene(drop(jitter=0.1))
    config = stepper.configure(state.x, phi=state.phi)
    colour = stepper.fluids.colour
    near = near_interface(config.ops.start, config.ops.column, colour)
    band = find_band(config.ops, colour, near, 1 / 24)
    centre = 0.5 - state.x
    inward = centre / np.linalg.norm(centre, axis=1, keepdims=True)
    strong = band.strength > 0.5 * band.strength.max()
    assert ((band.normal * inward).sum(axis=1)[strong] > 0.95).all()
