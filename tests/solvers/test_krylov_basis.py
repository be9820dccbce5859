"""The basis of a Krylov space: orthonormal to single precision, and a solve that reaches more than that."""

import numpy as np
import pytest

from isphcli.operators.assemble import assemble
from isphcli.solvers import krylov_basis
from isphcli.solvers.krylov import Limits, Maps, gmres_from_the_right
from isphcli.solvers.krylov_basis import CHUNK, DoubleBasis, KrylovBasis
from tests.solvers.systems import operators
from tests.threads import on_threads

SIZE = 3 * CHUNK + 7


def filled(count):
    """A basis of vectors that hardly differ: what Gram and Schmidt lose most on."""
    rng = np.random.default_rng(1)
    common, basis = rng.normal(size=SIZE), KrylovBasis(count, SIZE)
    for _ in range(count):
        vector = common + 1e-6 * rng.normal(size=SIZE)
        _, length = basis.orthogonalise(vector)
        basis.append(vector, length)
    return basis


def test_vectors_are_orthonormal():
    basis = filled(6)
    vectors = np.array([basis.combine(np.eye(6)[k]) for k in range(6)])
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(6), atol=3e-7)  # stored to 6e-8


def test_a_vector_is_its_components_and_the_rest():
    basis = filled(4)
    vector = np.random.default_rng(2).normal(size=SIZE)
    rest = vector.copy()
    components, length = basis.orthogonalise(rest)
    assert length == pytest.approx(np.linalg.norm(rest), rel=1e-12)
    np.testing.assert_allclose(basis.combine(components) + rest, vector, atol=1e-12 * np.linalg.norm(vector))


def test_a_double_basis_in_pieces(monkeypatch):
    """The same bits on any number of threads; orthonormal to LEFT, and a vector is its components and the rest, to
    round-off."""
    monkeypatch.setattr(krylov_basis, "PIECE", 500)

    def of_five():
        rng = np.random.default_rng(1)
        common, basis = rng.normal(size=SIZE), DoubleBasis(5, SIZE)
        for _ in range(5):
            vector = common + 1e-6 * rng.normal(size=SIZE)
            rest = vector.copy()
            components, length = basis.orthogonalise(rest)
            np.testing.assert_allclose(basis.combine(components) + rest, vector, atol=1e-14 * np.linalg.norm(vector))
            basis.append(rest, length)
        return np.array([basis.combine(np.eye(5)[k]) for k in range(5)])

    first, *others = on_threads(monkeypatch, of_five)
    assert all(np.array_equal(first, other) for other in others)
    np.testing.assert_allclose(first @ first.T, np.eye(5), atol=krylov_basis.LEFT)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-12])
def test_solves_reach_what_was_asked(tolerance):
    """Beyond single precision too, by starting again from the true residual."""
    _, ops = operators(2, 12, 2.1)
    matrix = assemble(ops.start, ops.column, ops.lap, 100.0, 1.0)
    rhs = np.random.default_rng(0).normal(size=ops.n)
    seen = []
    found, report = gmres_from_the_right(Maps(matrix.dot, lambda v: v), rhs, Limits(tolerance, 100, 400),
                                         watch=lambda *a: seen.append(a))
    assert report.converged and np.linalg.norm(rhs - matrix @ found) <= tolerance * np.linalg.norm(rhs)
    assert [k for k, _ in seen] == list(range(1, report.iterations + 1))
    assert seen[-1][1] == pytest.approx(report.residual, rel=0.1 if tolerance == 1e-6 else 1.0)


def test_an_operator_that_maps_to_a_multiple_ends_after_one_product():
    rhs = np.random.default_rng(3).normal(size=SIZE)
    found, report = gmres_from_the_right(Maps(lambda v: 2.0 * v, lambda v: v), rhs, Limits(1e-6, 10, 10))
    assert report.converged and report.iterations == 1
    np.testing.assert_allclose(found, 0.5 * rhs, atol=1e-6 * np.abs(rhs).max())
