"""The pressure matrix beside walls: its diagonal, its spectrum after scaling."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.operators.apply import divergence
from isphcli.operators.assemble import assemble
from isphcli.operators.div_grad import diagonal, div_grad_rhie_chow, div_grad_weights
from isphcli.output.clock import Clock
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

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
    weights = div_grad_weights(ops, ops.walls.symmetric_laplacian)
    columns = [div_grad_rhie_chow(ops, weights, e, ops.gradient_p(e)) for e in one]
    return np.array(columns).T, config


@pytest.fixture(scope="module")
def touching():
    return pressure_matrix(read_case(TOUCH.encode(), "case.yaml"))


def test_the_diagonal_is_that_of_the_matrix(touching):
    matrix, config = touching
    ops, near = config.ops, config.ops.walls.near_wall
    found = diagonal(ops, div_grad_weights(ops, ops.walls.symmetric_laplacian), ops.grad_p)
    assert near.any() and np.abs(found - np.diag(matrix))[near].max() < 1e-12 * found.max()


def test_rows_divided_by_their_diagonal_suit_the_laplacian(touching):
    """Spheres that touch, jittered: with thin neighbourhoods that know a gradient and no division the
    eigenvalues reached 47."""
    matrix, config = touching
    ops, n = config.ops, len(touching[0])
    laplacian = assemble(ops.start, ops.column, ops.lap_p, 0.0, 1.0).toarray()
    own = diagonal(ops, div_grad_weights(ops, ops.walls.symmetric_laplacian), ops.grad_p)
    scale = np.maximum(own / np.diag(laplacian), 1.0)
    rows = matrix / scale[:, None]
    values = np.linalg.eigvals(np.linalg.pinv(laplacian, rcond=1e-9) @ (rows - rows.mean(axis=0)))
    values = np.sort(values.real)[1:]  # of the constant: zero
    assert scale.max() > 2 and len(values) == n - 1
    assert values[0] > 0.4 and values[-1] < 2


def test_a_kink_at_an_interface_is_no_odd_even_mode():
    """Two straight pieces of pressure that meet on an oblique line, with ten times the density on one side: the
    acceleration across it is the same, that along it differs by ten. S finds nothing of it."""
    flat = TOUCH.replace("box: [1, 1, 1], periodic: [x, y, z]", "box: [1, 1], periodic: [x]")
    flat = flat.replace("[0.5, 0.5, 0.5]", "[0.5, 1.5]").replace("[1, 0, 0]", "[1, 0]").replace("0.125", "0.0625")
    case = read_case(flat.encode(), "case.yaml")
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    ops = stepper.configure(state.x).ops
    normal, along = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    phi, far = (state.x - [0.5, 0.4]) @ normal, (state.x - [0.5, 0.4]) @ along
    rho = np.where(phi > 0.0, 10.0, 1.0)
    p = rho * 2.0 * phi + 3.0 * far
    a = 2.0 * normal + 3.0 / rho[:, None] * along
    i = np.repeat(np.arange(ops.n), np.diff(ops.start))
    t = phi[i] / np.where((phi[i] > 0.0) == (phi[ops.column] > 0.0), 1.0, phi[i] - phi[ops.column])
    t[rho[i] == rho[ops.column]] = 0.5
    symmetric = ops.walls.symmetric_laplacian / (t * rho[i] + (1.0 - t) * rho[ops.column])
    inside = (np.abs(state.x[:, 0] - 0.5) < 0.35) & (state.x[:, 1] > 0.0)  # the line goes round no period
    sums = [div_grad_rhie_chow(ops, div_grad_weights(ops, symmetric, density), p, a) for density in (rho, 1.0)]
    exact, halves = (np.abs(s + divergence(ops, a) - (ops.walls.div * a).sum(axis=1))[inside].max() for s in sums)
    assert exact < 1e-10 * halves
