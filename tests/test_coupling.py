"""The pressure matrix beside walls: its diagonal, its spectrum after scaling, and pores that hardly hold particles."""

from pathlib import Path

import numpy as np
import pytest

from isphcli import linear
from isphcli.case import load_case, read_case
from isphcli.coupling import diagonal, divergence_and_jump
from isphcli.geometry import build_geometry
from isphcli.operators import gradient_p, invert_gradient
from isphcli.output import Clock
from isphcli.run_navier_stokes import prepare

CASES = Path(__file__).parent.parent / "cases"
TOUCH = """
geometry: {box: [1, 1, 1], periodic: [x, y, z], shapes: [{sphere: {centre: [0.5, 0.5, 0.5], radius: 0.5}, is: solid}]}
particles: {spacing: 0.125, jitter: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0, 0]}
time: {end: 1}
"""


def pressure_matrix(case):
    """(matrix (n, n) by probing, configuration) of the start of a case."""
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    config = stepper.configure(state.x)
    ops, one = config.ops, np.eye(len(state.x))
    columns = [divergence_and_jump(ops, config.x, ops.walls.natural, e, gradient_p(ops, e)) for e in one]
    return np.array(columns).T, config


@pytest.fixture(scope="module")
def touching():
    return pressure_matrix(read_case(TOUCH.encode(), "case.yaml"))


def test_the_diagonal_is_that_of_the_matrix(touching):
    matrix, config = touching
    ops, near = config.ops, config.ops.walls.near
    found = diagonal(ops, config.x, ops.walls.natural, ops.grad_p)
    assert near.any() and np.abs(found - np.diag(matrix))[near].max() < 1e-12 * found.max()


def test_rows_divided_by_their_diagonal_suit_the_laplacian(touching):
    """Spheres that touch, jittered: with thin stars that know a gradient and no division the eigenvalues reached 47."""
    matrix, config = touching
    ops, n = config.ops, len(touching[0])
    laplacian = linear.assemble(ops.start, ops.column, ops.lap_p, 0.0, 1.0).toarray()
    scale = np.maximum(diagonal(ops, config.x, ops.walls.natural, ops.grad_p) / np.diag(laplacian), 1.0)
    rows = matrix / scale[:, None]
    values = np.linalg.eigvals(np.linalg.pinv(laplacian, rcond=1e-9) @ (rows - rows.mean(axis=0)))
    values = np.sort(values.real)[1:]  # of the constant: zero
    assert scale.max() > 2 and len(values) == n - 1
    assert values[0] > 0.4 and values[-1] < 2


def test_beads_that_touch_let_the_pressure_be_solved():
    """A corner of the bead pack at 2.5 spacings a bead, two particles of three with a third of their neighbours: the
    solve stalled at a residual of 0.4. No particle may be faster than ten times free fall."""
    box = "[2.4e-3, 2.4e-3, 2.4e-3]"
    case = load_case(CASES / "bead_pack.yaml", [
        f"geometry.box={box}", "geometry.origin=[-1.2e-3, -1.2e-3, -1.2e-3]", "geometry.periodic=[]",
        "particles.spacing=2e-4", "flow=navier_stokes", "drive={body_force: [0, 1.06, 0]}", "time={end: 1}",
        "reference=null"])  # fmt: skip
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    config = stepper.configure(state.x)
    for _ in range(4):
        state, config = stepper.advance(state, config, 1.4e-4)
        assert stepper.reports["pressure"].iterations < 40
        assert np.linalg.norm(state.u, axis=1).max() < 10 * 1.06 * state.time


def test_a_faint_star_knows_no_gradient():
    """One neighbour at the rim of the support, and three in a plane that are almost out of it: nothing is thrown."""
    inverse = np.empty((3, 3))
    assert invert_gradient(np.array([1e-3, 1e-9, 1e-9, 0.0, 0.0, 0.0]), 3, inverse) and not inverse.any()
    assert invert_gradient(np.array([0.5, 0.5, 1e-3, 0.0, 0.0, 0.0]), 3, inverse)
    np.testing.assert_allclose(inverse, np.diag([2.0, 2.0, 0.0]), atol=1e-12)
    assert not invert_gradient(np.array([1.0, 1.0, 0.4, 0.0, 0.0, 0.0]), 3, inverse)
    np.testing.assert_allclose(inverse, np.diag([1.0, 1.0, 2.5]), atol=1e-12)
