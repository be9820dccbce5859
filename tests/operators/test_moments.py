"""Moments of neighbourhoods: volumes, and poor neighbourhoods that stay finite."""

import numpy as np
import pytest

from isphcli.domain.halo import build_halo
from isphcli.domain.neighbours import neighbourhood
from isphcli.operators.apply import gradient, laplacian
from isphcli.operators.moments import invert_gradient, particle_volumes
from tests.operators.clouds import build, free, inside, jittered, quadratic


def test_a_faint_star_knows_no_gradient():
    """One neighbour at the rim of the support, and three in a plane that are almost out of it: nothing is thrown."""
    inverse = np.empty((3, 3))
    assert invert_gradient(np.array([1e-3, 1e-9, 1e-9, 0.0, 0.0, 0.0]), 3, inverse) and not inverse.any()
    assert invert_gradient(np.array([0.5, 0.5, 1e-3, 0.0, 0.0, 0.0]), 3, inverse)
    np.testing.assert_allclose(inverse, np.diag([2.0, 2.0, 0.0]), atol=1e-12)
    assert not invert_gradient(np.array([1.0, 1.0, 0.4, 0.0, 0.0, 0.0]), 3, inverse)
    np.testing.assert_allclose(inverse, np.diag([1.0, 1.0, 2.5]), atol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_inverse_leaves_thin_directions_out(dim):
    """Tensors turned any way, with eigenvalues that are equal, vanish, or lie on either side of a twentieth."""
    random = np.random.default_rng(0)
    for some in ([1.0, 1e-3, 0.3], [1.0, 1e-3, 1e-3], [0.2, 0.2, 0.0], [1e-3, 1.0, 1.0], [1.0, 0.06, 1e-9]):
        turn, _ = np.linalg.qr(random.normal(size=(dim, dim)))
        values, tensor, inverse = np.array(some[:dim]), np.zeros((3, 3)), np.zeros((3, 3))
        tensor[:dim, :dim] = turn * values @ turn.T
        kept = values > 0.05 * values.max()
        assert invert_gradient(tensor[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]], dim, inverse) == (not kept.all())
        expected = turn[:, kept] / values[kept] @ turn[:, kept].T
        # round-off of the tensor over its smallest eigenvalue that is kept
        np.testing.assert_allclose(inverse[:dim, :dim], expected, atol=1e-12 * np.abs(expected).max())



@pytest.mark.parametrize("dim", [2, 3])
def test_volumes_fill_the_box(dim):
    """Sum of 1 / sum_j W_ij over a box: its volume to a few percent; uniform on a lattice."""
    n, support = 10, 2.5 / 10
    for jitter in (0.0, 0.1):
        x = jittered(dim, n, jitter)
        halo = build_halo(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool), support)
        volume = particle_volumes(neighbourhood(halo.positions(x), halo.owners(len(x)), len(x), 0, support))
        assert volume.sum() == pytest.approx(1.0, rel=0.03)
        if jitter == 0.0:
            assert volume == pytest.approx(volume[0], rel=1e-12)


def finite(ops):
    return all(np.isfinite(a).all() for a in (ops.lap, ops.grad, ops.lap_p, ops.grad_p))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_poor_neighbourhoods(dim, order):
    """A line, a pair, an isolated particle, coincident ones, a plane in 3D: finite, counted, no NaN."""
    unit = np.eye(dim)[0]
    line = np.arange(7.0)[:, None] * unit
    scenes = {
        "line": line,
        "oblique line": np.arange(7.0)[:, None] * np.array([0.6, 0.48, 0.64][:dim]),
        "pair": line[:2],
        "alone": line[:1],
        "coincident": np.concatenate([line[:2], line[:2]]),
        "all in one place": np.zeros((5, dim)),
        "two lines": np.concatenate([line, line + np.eye(dim)[1]]),
    }
    for name, x in scenes.items():
        ops = free(x * 1e-6, 2.5e-6, order=order)
        assert finite(ops), name
        if name != "two lines":
            assert ops.deficient == len(x), name
        # a linear function along the line is still differentiated along it
        if name in ("line", "pair", "oblique line"):
            t = x @ (x[-1] - x[0]) / np.linalg.norm(x[-1] - x[0])
            got = gradient(ops, t[:, None])[:, 0] / 1e6
            assert got == pytest.approx(np.broadcast_to((x[-1] - x[0]) / t[-1], got.shape), abs=1e-9), name


def test_plane_in_three_dimensions():
    """Particles in a plane of a 3D scene: counted; gradients in the plane exact, none across."""
    x = np.concatenate([jittered(2, 8), np.full((64, 1), 0.5)], axis=1)
    ops = free(x, 2.5 / 8)
    assert ops.deficient == 64 and finite(ops)
    assert ops.gradient_p(x @ [1.0, 2.0, 3.0]) == pytest.approx(
        np.broadcast_to([1.0, 2.0, 0.0], (64, 3)), abs=1e-10
    )


def test_coincident_particles_in_a_full_neighbourhood():
    """A doubled particle does not act on its twin and takes nothing from the others."""
    x = jittered(2, 8)
    x = np.concatenate([x, x[[27]]])
    ops = build(x, 2.5 / 8)
    assert ops.deficient == 0 and finite(ops)
    rows = inside(x, 2.5 / 8)
    f, df, lap_f = quadratic(2)
    assert laplacian(ops, f(x)[:, None])[rows, 0] == pytest.approx(lap_f, rel=1e-10)
    assert ops.gradient_p(f(x))[rows] == pytest.approx(df(x)[rows], abs=1e-11)
    pair = np.repeat(np.arange(65), np.diff(ops.start))
    twin = ((pair == 27) & (ops.column == 64)) | ((pair == 64) & (ops.column == 27))
    assert twin.sum() == 2 and np.all(ops.lap[twin] == 0.0) and np.all(ops.grad[twin] == 0.0)
