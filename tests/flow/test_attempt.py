"""Solves that miss their tolerance: the order of the tries, and what ends a run."""

import weakref
from dataclasses import replace

import numpy as np
import pytest

from isphcli.flow import step as step_module
from isphcli.flow.attempt import attempt
from isphcli.flow.state import Handover
from isphcli.flow.step_limits import RunError
from isphcli.solvers import engine
from isphcli.solvers.krylov import SolveError
from tests.flow.steps import VORTEX, scene


def tries(monkeypatch, stepper, failing):
    """Lets the first `failing` solves miss their tolerance; a list of (restart, new hierarchies so far) a solve."""
    real, build, seen, built = engine.gmres, engine.hierarchy, [], []

    def gmres(apply, rhs, precondition, limits, guess):
        seen.append((limits.restart, len(built)))
        solution, convergence = real(apply, rhs, precondition, limits, guess)
        return solution, replace(convergence, reason="out of iterations") if len(seen) <= failing else convergence

    monkeypatch.setattr(engine, "gmres", gmres)
    monkeypatch.setattr(engine, "hierarchy", lambda matrix: built.append(1) or build(matrix))
    return seen


def guessed(terms, nu_max, spacing, rate, right, guess, solvers):
    """In place of `viscous_solve`: the velocity of the step before."""
    return guess


def test_the_order_of_tries(monkeypatch):
    """A pressure solve that misses its tolerance: the kept hierarchy, a new one, more of a new one, half the step."""
    stepper, state, config = scene(VORTEX + "solver: {restart: 40}\n")
    found = attempt(stepper, state, Handover(config), 1e-3)
    state, config = found.state, found.config
    assert set(stepper.solvers._levels) == {"pressure"}
    monkeypatch.setattr(step_module, "viscous_solve", guessed)  # leave only the pressure solves
    seen = tries(monkeypatch, stepper, 0)
    attempt(stepper, state, Handover(config), 1e-3)
    assert seen == [(40, 0)]
    for failing, expected, length in ((1, [(40, 0), (40, 1)], 1e-3),
                                      (2, [(40, 0), (40, 1), (80, 2)], 1e-3),
                                      (3, [(40, 0), (40, 1), (80, 2), (40, 3)], 0.5e-3)):
        monkeypatch.undo()
        stepper.solvers.drop()
        stepper.advance(state, Handover(config), 1e-3)
        monkeypatch.setattr(step_module, "viscous_solve", guessed)
        seen = tries(monkeypatch, stepper, failing)
        assert attempt(stepper, state, Handover(config), 1e-3).dt == length
        assert seen == expected


def test_a_step_holds_one_configuration(monkeypatch):
    """That of its start is gone when that of its end is made. Where the step is tried again it is made again, and the
    step is what it would have been."""
    stepper, state, config = scene(VORTEX)
    monkeypatch.setattr(step_module, "viscous_solve", guessed)  # leave only the pressure solves
    expected, configure, made, alive = attempt(stepper, state, Handover(config), 0.5e-3), stepper.configure, [], []

    def watched(*arguments):
        alive.append([known() is not None for known in made])
        made.append(weakref.ref(found := configure(*arguments)))
        return found

    monkeypatch.setattr(stepper, "configure", watched)
    ready = Handover(watched(state.x))
    stepper.solvers.drop()
    tries(monkeypatch, stepper, 2)
    found = attempt(stepper, state, ready, 1e-3)
    assert alive == [[], [False], [False, False], [False, False, False]]
    assert found.dt == 0.5e-3 and np.array_equal(found.state.p, expected.state.p)


def test_a_system_solved_with_its_diagonal_gets_a_hierarchy(monkeypatch):
    stepper, state, config = scene(VORTEX)
    seen = tries(monkeypatch, stepper, 1)
    stepper.advance(state, Handover(config), 1e-4)
    assert seen[:2] == [(100, 0), (100, 1)] and "velocity" in stepper.solvers


def test_a_solve_that_cannot_be_cured_names_its_system(monkeypatch):
    stepper, state, config = scene(VORTEX)
    tries(monkeypatch, stepper, 10**9)
    with pytest.raises(RunError, match=r"step 1 at time 0: the velocity system.*residual.*4 halvings.*") as caught:
        attempt(stepper, state, Handover(config), 1e-3)
    assert isinstance(caught.value.__cause__, SolveError) and caught.value.violation.shape == (100,)


def test_a_step_without_length_ends_the_run():
    stepper, state, config = scene(VORTEX)
    with pytest.raises(RunError, match="lost in the digits of the time"):
        attempt(stepper, replace(state, time=1.0), Handover(config), 1e-17)
