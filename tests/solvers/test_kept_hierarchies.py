"""Hierarchies that are kept: solved to the tolerance, kept while they serve, built anew when they do not."""

import numpy as np
import pytest
import scipy.sparse as sp

from isphcli.domain.null_space import ComponentMeans
from isphcli.output.clock import Clock
from isphcli.solvers.kept_hierarchies import REBUILD_MARGIN, REBUILD_RATIO, KeptHierarchies
from isphcli.solvers.krylov import Convergence, SolveError

N = 24


def matrix(stretch=1.0):
    """The five-point Laplacian of N x N points between walls, `stretch` times as strong along the first axis."""
    line = sp.diags_array([2.0, -1.0, -1.0], offsets=[0, 1, -1], shape=(N, N))
    return sp.csr_matrix(stretch * sp.kron(line, sp.eye_array(N)) + sp.kron(sp.eye_array(N), line))


def renumbered():
    """The same Laplacian with its points in any order: a hierarchy of `matrix` joins points that are far apart."""
    order = np.random.default_rng(1).permutation(N * N)
    return matrix()[order][:, order].tocsr()


def kept(tolerance=1e-8, restart=30, max_iterations=60):
    solvers = KeptHierarchies(tolerance, restart, max_iterations, Clock())
    solvers.begin("first state", 0.5)  # what the solver only hands back
    return solvers


def right():
    return np.random.default_rng(0).standard_normal(N * N)


def test_the_solution_is_that_of_a_direct_solve():
    a, b = matrix(), right()
    x, report = kept(1e-11).multigrid("pressure", a, a.dot, b, None)
    assert report.converged
    assert np.abs(x - sp.linalg.spsolve(a.tocsc(), b)).max() < 1e-8 * np.abs(x).max()  # tolerance times condition 600


def test_closed_pores_smaller_than_an_aggregate_take_no_iterations():
    """A pressure is known up to a constant in each closed pore: without `GROUND` a coarse matrix has the round-off of a
    sum of weights in its place, and GMRES stalls at 1e-5 on what dividing by it makes (a 64^3 corner of Berea)."""
    random = np.random.default_rng(2)

    def pore(*shape):
        """Random weights of pairs of neighbours as a matrix whose rows sum up to nothing, and its columns nearly: the
        volumes of particles in disorder differ."""
        number = np.arange(np.prod(shape)).reshape(shape)
        a, b = (np.concatenate(side) for side in zip(*[
            (np.delete(number, -1, k).ravel(), np.delete(number, 0, k).ravel()) for k in range(len(shape))]))
        weight = sp.csr_array((random.uniform(0.5, 1.5, len(a)), (a, b)), shape=(number.size, number.size))
        weight = weight + weight.T
        return sp.diags_array(random.uniform(0.99, 1.01, number.size)) @ (sp.diags_array(weight.sum(axis=1)) - weight)

    def iterations(*pores):
        a = sp.csr_matrix(sp.block_diag(pores))
        means = ComponentMeans(np.repeat(np.arange(len(pores)), [part.shape[0] for part in pores]))
        _, report = kept().multigrid("pressure", a, lambda v: means.remove(a @ v), means.remove(b[: a.shape[0]]), None,
                                     lambda once: lambda v: means.remove(once(v)))
        assert report.converged
        return report.iterations

    b, large = random.standard_normal(9000), pore(90, 90)  # three levels
    assert iterations(large, pore(1, 3), pore(2, 2), pore(2, 4), pore(3, 3), pore(4, 5)) <= iterations(large) + 2


def test_a_hierarchy_serves_while_its_iterations_have_not_grown():
    """Nearly the same matrix takes the kept one; what it is preconditioned with tells by `rebuilt` and `origins`."""
    solvers, a = kept(), matrix()
    _, first = solvers.multigrid("pressure", a, a.dot, right(), None)
    assert solvers.rebuilt and "pressure" in solvers
    assert solvers.origins() == {"pressure": ("first state", 0.5, first.iterations)}
    solvers.begin("second state", 0.25)
    near = matrix(1.01)
    _, second = solvers.multigrid("pressure", near, near.dot, right(), None)
    assert not solvers.rebuilt and second.converged
    assert solvers.origins()["pressure"][0] == "first state"


def test_a_hierarchy_whose_iterations_have_grown_is_dropped_after_the_solve():
    """Particles that have gone elsewhere: the old hierarchy still solves the system, in many more iterations."""
    solvers, a, other = kept(max_iterations=200), matrix(), renumbered()
    _, first = solvers.multigrid("pressure", a, a.dot, right(), None)
    solvers.begin("second state", 0.25)
    _, second = solvers.multigrid("pressure", other, other.dot, right(), None)
    assert second.iterations > max(REBUILD_RATIO * first.iterations, first.iterations + REBUILD_MARGIN)
    assert "pressure" not in solvers and not solvers.rebuilt
    solvers.multigrid("pressure", other, other.dot, right(), None)
    assert solvers.rebuilt and solvers.origins()["pressure"][:2] == ("second state", 0.25)


def test_a_solve_that_misses_its_tolerance_is_repeated_with_a_new_hierarchy():
    """Few iterations: the kept hierarchy of other places does not do, a new one does."""
    a, other = matrix(), renumbered()
    enough = kept()
    _, own = enough.multigrid("pressure", other, other.dot, right(), None)
    solvers = kept(max_iterations=own.iterations + 2)
    solvers.multigrid("pressure", a, a.dot, right(), None)
    solvers.begin("second state", 0.25)
    x, report = solvers.multigrid("pressure", other, other.dot, right(), None)
    assert report.converged and solvers.rebuilt
    assert np.linalg.norm(other @ x - right()) < 1.01e-8 * np.linalg.norm(right())


def test_what_cannot_be_solved_is_reported_with_its_residual():
    solvers, a = kept(1e-12, max_iterations=1), matrix()
    x, report = solvers.multigrid("pressure", a, a.dot, right(), None)
    assert not report.converged and "pressure" not in solvers
    with pytest.raises(SolveError) as caught:
        solvers.record("pressure", report, lambda: right() - a @ x)
    assert caught.value.violation == pytest.approx(right() - a @ x)


def test_the_report_of_a_step_is_that_of_its_hardest_solve():
    solvers = kept()
    for iterations in (3, 7, 5):
        solvers.record("velocity", Convergence(iterations, 1e-9, 1e-8, "converged"), lambda: np.zeros(1))
    assert solvers.solves["velocity"].iterations == 7
    solvers.begin("second state", 0.25)
    assert solvers.solves == {}


def test_rebuilt_from_its_origin_a_hierarchy_has_the_same_bits():
    """The same step takes place again: a solve with the hierarchy of a later matrix is bit for bit that of before."""
    solvers, a, near = kept(), matrix(), matrix(1.01)
    solvers.multigrid("pressure", a, a.dot, right(), None)
    origins = solvers.origins()
    expected, _ = solvers.multigrid("pressure", near, near.dot, right(), None)
    other, taken = kept(), []

    def take(state, dt):
        taken.append((state, dt))
        other.begin(state, dt)
        other.multigrid("pressure", a, a.dot, right(), None)

    other.rebuild(origins, take)
    assert taken == [("first state", 0.5)] and other.origins() == origins
    found, _ = other.multigrid("pressure", near, near.dot, right(), None)
    assert np.array_equal(found, expected)


def test_dropped_hierarchies_are_forgotten():
    solvers, a = kept(), matrix()
    solvers.multigrid("pressure", a, a.dot, right(), None)
    solvers.drop()
    assert "pressure" not in solvers and solvers.origins() == {}
