"""Operators applied: the divergence is the trace of the gradient, constants vanish."""

import numpy as np
import pytest

from isphcli.operators.apply import divergence, gradient, laplacian
from tests.operators.clouds import build, jittered


@pytest.mark.parametrize("dim", [2, 3])
def test_divergence_is_the_trace_of_the_gradient(dim):
    x = jittered(dim, 8)
    ops = build(x, 2.1 / 8)
    u = np.random.default_rng(0).normal(size=x.shape)
    trace = np.einsum("nkk->n", gradient(ops, u))
    assert divergence(ops, u) == pytest.approx(trace, abs=1e-11)


@pytest.mark.parametrize("dim", [2, 3])
def test_constants_vanish(dim):
    x = jittered(dim, 8)
    ops = build(x, 2.1 / 8)
    assert np.all(laplacian(ops, np.full((len(x), 2), 3.7)) == 0.0)
    assert np.all(ops.gradient_p(np.full(len(x), 3.7)) == 0.0)
