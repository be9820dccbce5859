"""Sums over particles go through domain/reduce: it is the only place that has to know of other processes.

What else combines the entries of an array in the physics rooms is read from the source and stands in a list here, with
its reason: it runs over components or axes of one particle, or over something that is not spread over processes.
Compiled loops are left out: they take a particle and its neighbours.
"""

import ast

import numpy as np
import pytest

from isphcli.domain import reduce
from tests.paths import ROOT

PACKAGE = ROOT / "isphcli"
ROOMS = ("domain", "operators", "solvers", "flow", "two_phase")
NAMES = {"sum", "mean", "max", "min", "any", "all", "prod", "std", "var", "ptp", "dot", "vdot", "norm", "average",
         "median", "bincount", "count_nonzero", "einsum", "argmin", "argmax"}  # fmt: skip

AXES = "over the axes of the box or the components of a vector"
OWN = "over the components of each particle"
BLOCKS = "over blocks of the scene, of which every process has all"
FLUIDS = "over the two fluids"
MATRIX = "a row of a matrix takes a particle and its neighbours"
WALLS = "over the walls, of which every process has all"
GATHERED = "over points, particles or links that one process will have to gather: there are few, or it is seldom done"
TIMES = "over times at which a force or a wall is looked at"
BINS = "histograms of the particles of this process and those next to a cut, of all of them together"
RANKS = "over the processes, or of this one alone before they are joined"
SCRATCH = "length of scratch arrays, which every process makes for its own rows"
ONE = "of the hierarchy of one process alone"
OFFSETS = "of the offsets of a lattice and the tensors of one particle"
BASIS = "over the vectors of a basis"
PIECES = "of pieces of an array, whose sums or extremes domain/reduce joins"
CELLS = "over the particles that a cell of the process sees, or what of its cells is brought together after"
PARTS = "over the parts of the fluids, of which every process has all"
MIXED = "over the neighbours of a particle and the faces of a cell, or the axes of pairs"
VECTOR = "of one vector (dim,) with each of many, or with itself"
ALLOWED = {
    ("domain.components", "joined.max(initial=-1)"): RANKS,
    ("domain.components", "labels.max(initial=-1)"): RANKS,
    ("domain.cut", "(upto < (share * whole)[:, None]).sum(axis=1)"): BINS,
    ("domain.cut", "counts.sum(axis=1)"): BINS,
    ("domain.cut", "current().sum(counts.reshape(k, BINS))"): BINS,
    ("domain.cut", "current().max(beside)"): BINS,
    ("domain.cut", "np.argmax(brick.upper - brick.lower)"): AXES,
    ("domain.cut", "np.argmax(node.upper - node.lower)"): AXES,
    ("domain.cut", "np.bincount(of[inside] * BINS + bin_of[inside].astype(np.int64), minlength=k * BINS)"): BINS,
    ("domain.cut", "np.isfinite(beside).all(axis=0)"): BINS,
    ("domain.exchange", "want.sum()"): RANKS,
    ("domain.exchange", "math.prod(values.shape[1:])"): SCRATCH,
    ("domain.exchange", "np.bincount(owner, minlength=comm.size)"): RANKS,
    ("domain.lattice", "self.counts.prod()"): AXES,
    ("domain.lattice", "math.prod((len(r) for r in rest))"): AXES,
    ("domain.lattice", "self.cell.prod()"): AXES,
    ("domain.lattice", "np.log10((length + 2.0 * margin) / cell).sum()"): AXES,
    ("domain.migration", "((back[place] - offset[left]) ** 2).sum(axis=1)"): OWN,
    ("domain.migration", "(offset[left] ** 2).sum(axis=1)"): OWN,
    ("domain.migration", "goes.any()"): RANKS,
    ("domain.migration", "np.abs(entry[1]).sum()"): AXES,
    ("domain.migration", "current().max(int(goes.any()))"): RANKS,
    ("domain.migration", "np.all((bricks[:, 0] - reach < self.share.upper + moved) & (bricks[:, 1] + reach > "
                         "self.share.lower + moved), axis=1)"): AXES,
    ("domain.migration", "np.all((image > bricks[process, 0] - reach) & (image < bricks[process, 1] + reach), "
                         "axis=1)"): OWN,
    ("domain.mixed_lattice", "(np.mod(self.chosen - low, self.counts) < many).all(axis=1)"): AXES,
    ("domain.mixed_lattice", "lattice.cell.min()"): AXES,
    ("domain.neighbours", "cells.prod()"): AXES,
    ("domain.neighbours", "column.min()"): SCRATCH,
    ("domain.neighbours", "column.max()"): SCRATCH,
    ("domain.neighbours", "np.diff(start).max(initial=0)"): SCRATCH,
    ("domain.neighbours", "(first[reach:] - first[:-reach]).max(initial=0)"): SCRATCH,
    ("flow.diffusion", "np.any(div != 0.0, axis=1)"): OWN,
    ("flow.diffusion", "np.einsum('nk,nk->n', div[beside], normal)"): OWN,
    ("flow.forces", "np.sum(found, axis=0)"): "over the list of forces",
    ("flow.one_fluid", "force.any()"): AXES,
    ("flow.projection", "ops.neighbours.x @ slope"): OWN,
    ("flow.step", "np.einsum('nk,nk->n', a, b)"): OWN,
    ("flow.step", "slope.any()"): AXES,
    ("domain.row_threads", "math.prod(shape)"): SCRATCH,
    ("flow.shifting", "math.prod(gradients.shape[1:])"): SCRATCH,
    ("flow.shifting", "others.any()"): "whether own rows are taken again, of values that are there",
    ("flow.step_limits", "np.isfinite(part).all()"): PIECES,
    ("flow.step_limits", "np.count_nonzero(_no_numbers(part))"): PIECES,
    ("flow.step_limits", "(np.abs(part) if part.ndim > 1 else part).max(initial=-np.inf)"): PIECES,
    ("flow.step_limits", "weight[rows] @ np.einsum('nk,nk->n', scaled, scaled)"): PIECES,
    ("flow.step_limits", "weight[rows].sum()"): PIECES,
    ("flow.step_limits", "np.einsum('nk,nk->n', scaled, scaled)"): OWN,
    ("flow.step_limits", "bad.any(axis=1)"): OWN,
    ("flow.step_limits", "(new.u ** 2).sum(axis=1)"): OWN,
    ("flow.stokes", "np.einsum('nkm,nm->nk', self.ops.walls.slip, u)"): OWN,
    ("flow.stokes", "forces.max(axis=1)"): OWN,
    ("flow.timed_drive", "self.strongest(time * PASSED).max()"): TIMES,
    ("flow.timed_drive", "np.linalg.norm(vectors, axis=-1)"): AXES,
    ("flow.timed_drive", "np.linalg.norm(vectors, axis=-1).max()"): TIMES,
    ("flow.viscous_solve", "matrix @ exchange.forward(v)"): MATRIX,
    ("flow.viscous_solve", "np.einsum('nkm,nm->nk', slip, u)"): OWN,
    ("flow.viscous_solve", "np.abs(scaled - apply(solution)).reshape(n, dim).max(axis=1)"): OWN,
    ("flow.volume_control", "self.wanted.max()"): BLOCKS,
    ("flow.volume_control", "self.wanted.sum()"): BLOCKS,
    ("flow.volume_control", "surplus ** 2 @ self.wanted"): BLOCKS,
    ("flow.volume_control", "np.prod(self.nodes)"): AXES,
    ("flow.volume_control", "np.prod(np.where(corner, beyond, 1.0 - beyond), axis=1)"): OWN,
    ("operators.cell_means", "(corners ** 2).sum(axis=1)"): BASIS,
    ("operators.cell_means", "step.mean()"): AXES,
    ("operators.cell_means", "(ways ** 2).sum()"): BASIS,
    ("operators.cell_means", "np.any(geometry.slip_length > 0.0)"): WALLS,
    ("operators.cell_means", "np.any(geometry.wall_speed)"): WALLS,
    ("operators.cell_means", "np.array(list(itertools.product((-0.5, 0.5), repeat=len(ways)))) @ ways"): BASIS,
    ("operators.cell_means", "np.sqrt((corners ** 2).sum(axis=1)).max()"): BASIS,
    ("operators.cell_means", "signs @ ways"): BASIS,
    ("operators.div_grad", "np.einsum('qk,qk->q', pair, whole[several])"): OWN,
    ("operators.div_grad", "np.bincount(row[asked], over, n)"): "over the pairs of each row",
    ("operators.conductances", "np.diff(self._ops.start).max(initial=0)"): SCRATCH,
    ("operators.mixed_weights", "(found * beyond).sum(axis=1)"): MIXED,
    ("operators.mixed_weights", "np.any(geometry.slip_length > 0.0)"): WALLS,
    ("operators.mixed_weights", "ops.walls.slip[mixed].any(axis=(1, 2))"): OWN,
    ("operators.mixed_weights", "(functions ** 2 * omega[..., None]).sum(axis=1)"): MIXED,
    ("operators.mixed_weights", "(step ** 2).sum(axis=1)"): MIXED,
    ("operators.mixed_weights", "count[some].max()"): MIXED,
    ("operators.mixed_weights", "found.sum(axis=1)"): MIXED,
    ("operators.mixed_weights", "np.abs(found).sum(axis=1)"): MIXED,
    ("operators.mixed_weights", "np.abs(step[shared]).max(axis=1)"): MIXED,
    ("operators.mixed_weights", "np.bincount(self.first, share, minlength=n)"): MIXED,
    ("operators.mixed_weights", "np.linalg.norm(step, axis=2)"): MIXED,
    ("operators.mixed_weights", "np.linalg.norm(step[over], axis=1)"): MIXED,
    ("operators.mixed_weights", "np.prod([e[a] for a in power], axis=0)"): MIXED,
    ("operators.mixed_weights", "omega.max(axis=1)"): MIXED,
    ("operators.mixed_weights", "weighted @ np.linalg.solve(matrix, (wanted / size)[..., None])"): MIXED,
    ("operators.mixed_weights", "weighted.transpose(0, 2, 1) @ scaled"): MIXED,
    ("operators.protocol", "np.einsum('nkm,nm->nk', self.slip, u)"): OWN,
    ("operators.protocol", "np.einsum('nk,nk->n', self.div, u)"): OWN,
    ("operators.lattice_weights", "counts.max()"): SCRATCH,
    ("operators.lattice_weights", "np.abs(every - step[k, own]).max(axis=1)"): AXES,
    ("operators.lattice_weights", "(ops.pairs.step ** 2).sum(axis=1)"): OFFSETS,
    ("operators.lattice_weights", "((step / edges * unstretched) ** 2).sum(axis=1)"): OFFSETS,
    ("operators.lattice_weights", "np.count_nonzero(near)"): OFFSETS,
    ("operators.lattice_weights", "np.diff(ops.start).max(initial=1)"): OFFSETS,
    ("operators.lattice_weights", "second @ tensors.laplace[0, :6]"): OFFSETS,
    ("operators.lattice_weights", "first @ tensors.laplace[0, 6:]"): OFFSETS,
    ("operators.lattice_weights", "tensors.gradient[0] @ first[:, :dim].T"): OFFSETS,
    ("operators.lattice_weights", "tensors.k_tensor[0] @ second.T"): OFFSETS,
    ("operators.wall_weights", "np.any(slip_length > 0.0)"): WALLS,
    ("operators.wall_scene", "np.any(geometry.slip_length > 0.0)"): WALLS,
    ("solvers.kept_hierarchies", "matrix @ exchange.forward(x)"): MATRIX,
    ("solvers.krylov_basis", "np.abs(more).max(initial=0.0)"): BASIS,
    ("solvers.krylov_basis", "np.abs(left[:-1]).max(initial=0.0)"): BASIS,
    ("solvers.krylov_basis", "coefficients @ known[:, part]"): BASIS,
    ("solvers.krylov_basis", "known[:, part] @ vector[part]"): PIECES,
    ("solvers.krylov_basis", "known[:, part] @ rest"): PIECES,
    ("solvers.krylov_basis", "rest @ rest"): PIECES,
    ("solvers.multigrid", "level.R @ (b - level.A @ x)"): MATRIX,
    ("solvers.multigrid", "level.A @ x"): MATRIX,
    ("solvers.multigrid", "levels.levels[k + 1].A @ y"): MATRIX,
    ("solvers.multigrid", "level.P @ y"): MATRIX,
    ("solvers.multigrid", "self.coarse @ b"): "the coarsest system, of which every process will have all",
    ("solvers.aggregation", "np.bincount(aggregate[inside], near_null[inside] ** 2, count)"): ONE,
    ("solvers.aggregation", "np.diff(matrix.indptr).max(initial=0)"): SCRATCH,
    ("solvers.aggregation", "restriction[rows[0]:rows[1]] @ matrix"): ONE,
    ("solvers.aggregation", "restriction[rows[0]:rows[1]] @ matrix @ prolongation"): ONE,
    ("solvers.pair_cycle", "np.bincount(aggregate[aggregate >= 0], minlength=count)"): ONE,
    ("solvers.pair_cycle", "self.matrix.rows(*rows) @ self.prolongation"): ONE,
    ("solvers.pair_cycle", "self.prolongation[rows[0]:rows[1]].T.tocsr() @ product"): ONE,
    ("two_phase.contact_angle", "owner.max(initial=-1)"): "the number of rows of the table of this process",
    ("two_phase.contact_angle", "(sees[owner] > 0).all(axis=1)"): FLUIDS,
    ("two_phase.interface", "np.einsum('ij,ij->i', fit.slope, fit.slope)"): OWN,
    ("two_phase.kinks", "np.einsum('ick,ik->ic', gradients, self.normal)"): OWN,
    ("two_phase.cut_cells", "np.prod(end - first)"): AXES,
    ("two_phase.cut_cells", "cut.cells.side.sum()"): AXES,
    ("two_phase.cut_cells", "inside.reshape(-1, count).mean(axis=1)"): "over the samples of a cell",
    ("two_phase.cut_cells", "inside.all(axis=1)"): AXES,
    ("two_phase.cut_cells", "np.isfinite(height).all(axis=(1, 2))"): "over the corners of a square",
    ("two_phase.cut_cells", "positive.any(axis=1)"): "over the corners of a square",
    ("two_phase.cut_cells", "positive.all(axis=1)"): "over the corners of a square",
    ("two_phase.cut_cells", "np.argmax(gap)"): GATHERED,
    ("two_phase.cells_in_sight", "((point - middle) ** 2).sum(axis=1)"): OWN,
    ("two_phase.cells_in_sight", "(offsets ** 2).sum(axis=1)"): OFFSETS,
    ("two_phase.cells_in_sight", "((point - there) ** 2).sum(axis=1)"): OWN,
    ("two_phase.cells_in_sight", "self.aside.max(initial=0.0)"): CELLS,
    ("two_phase.cut_cells", "(nearest >= 0).all(axis=1)"): FLUIDS,
    ("two_phase.cut_cells", "cells.side.max()"): AXES,
    ("two_phase.cut_cells", "(nearest < 0).all(axis=1)"): FLUIDS,
    ("two_phase.cut_cells", "(way * way).sum(axis=2)"): AXES,
    ("two_phase.cut_cells", "(way * way).sum(axis=2).argmax(axis=1)"): FLUIDS,
    ("two_phase.kept_volumes", "np.all((x >= sample[0]) & (x <= sample[1]), axis=1)"): AXES,
    ("two_phase.kept_volumes", "np.bincount(place, cut.area[both], len(pair))"): CELLS,
    ("two_phase.kept_volumes", "np.bincount(kin, np.concatenate([self.area[here], self.area[there]]), count)"): PARTS,
    ("two_phase.kept_volumes", "(group == before).all()"): PARTS,
    ("two_phase.kept_volumes", "np.bincount(surrounding[group], lacking, count)"): PARTS,
    ("two_phase.kept_volumes", "np.bincount(one, area, count)"): PARTS,
    ("two_phase.kept_volumes", "np.bincount(other, area, count)"): PARTS,
    ("two_phase.kept_volumes", "alone.all()"): PARTS,
    ("two_phase.kept_volumes", "diagonal.max()"): PARTS,
    ("two_phase.kept_volumes", "reduce.total_by(now[part == gone], None, count).argmax()"): PARTS,
    ("two_phase.kept_volumes", "kin.max()"): PARTS,
    ("two_phase.kept_volumes", "kin.argmax()"): PARTS,
    ("two_phase.interface_rules", "np.mean(density)"): FLUIDS,
    ("two_phase.interface_rules", "np.mean(viscosity)"): FLUIDS,
    ("two_phase.interface_rules", "density.min()"): FLUIDS,
    ("two_phase.interface_rules", "(viscosity / density).min()"): FLUIDS,
    ("two_phase.measures", "(state.u * state.u).sum(axis=1)"): OWN,
    ("two_phase.measures", "np.linalg.norm(flux)"): AXES,
    ("two_phase.measures", "np.prod(self.geometry.upper - self.geometry.lower)"): AXES,
    ("two_phase.measures", "(offset * offset).sum(axis=1)"): OWN,
    ("two_phase.measures", "np.einsum('ncd,nd->nc', gradients[near].reshape(-1, ops.dim, ops.dim), way)"): OWN,
    ("two_phase.measures", "((b - a) ** 2).sum(axis=1)"): OWN,
    ("two_phase.measures", "((points - middle) ** 2).sum(axis=1)"): OWN,
    ("two_phase.measures", "(local * local).sum(axis=1)"): OWN,
    ("two_phase.measures", "np.linalg.norm(local - centre, axis=1)"): OWN,
    ("two_phase.measures", "np.linalg.norm(x[near] - centre, axis=1)"): OWN,
    ("two_phase.measures", "normals @ normals[np.argmin(depth)]"): VECTOR,
    ("two_phase.measures", "wall_normals(self.geometry, at_wall, self.distance) @ normal"): VECTOR,
    ("two_phase.measures", "points @ normal"): VECTOR,
    ("two_phase.measures", "middle @ normal"): VECTOR,
    ("two_phase.measures", "centre @ centre"): VECTOR,
    ("two_phase.measures", "gaps.max(initial=0.0)"): "over the layers across an axis, of which every process has all",
    ("two_phase.measures", "np.argmin(depth)"): GATHERED,
    ("two_phase.measures", "np.ptp(foot)"): GATHERED,
    ("two_phase.measures", "foot.mean()"): GATHERED,
    ("two_phase.measures", "points.mean(axis=0)"): GATHERED,
    ("two_phase.measures", "((points - middle) ** 2).sum(axis=1).mean()"): GATHERED,
    ("two_phase.measures", "(off * off).mean()"): GATHERED,
    ("two_phase.quadratic_fit", "np.einsum('ij,ij->i', gradient, gradient)"): OWN,
    ("two_phase.two_fluids", "self.density.mean()"): FLUIDS,
    ("two_phase.two_fluids", "(self.mu / self.density).max()"): FLUIDS,
    ("two_phase.two_fluids", "(self.mu / self.density).min()"): FLUIDS,
    ("two_phase.two_fluids", "self.drop_force.any()"): AXES,
}


def is_kernel(node):
    return isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(d) for d in node.decorator_list)


def combined(node):
    """Source of what combines entries of arrays below a node, compiled loops left out."""
    if is_kernel(node):
        return
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        yield ast.unparse(node)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in NAMES:
        if ast.unparse(node.func.value) != "reduce":
            yield ast.unparse(node)
    for child in ast.iter_child_nodes(node):
        yield from combined(child)


def of_file(path):
    return set(combined(ast.parse(path.read_text(encoding="utf-8"))))


FILES = {f"{path.parent.name}.{path.stem}": path for room in ROOMS for path in sorted((PACKAGE / room).rglob("*.py"))
         if (room, path.stem) != ("domain", "reduce")}  # fmt: skip


def test_sums_over_particles_go_through_reduce():
    assert {(name, source) for name in FILES for source in of_file(FILES[name])} == set(ALLOWED)


def test_every_exception_has_its_file():
    assert {name for name, _ in ALLOWED} <= FILES.keys()


def test_the_reader_of_sums():
    """It sees methods, numpy's functions and products of vectors, and neither compiled loops nor `reduce`."""
    text = """
@njit(cache=True)
def kernel(u):
    return u.sum()

def speed(u):
    return np.linalg.norm(u), u.T @ u, reduce.mean(u.max(axis=0)), max(1, 2)
"""
    assert set(combined(ast.parse(text))) == {"np.linalg.norm(u)", "u.T @ u", "u.max(axis=0)"}


def test_values():
    """Of four particles, by hand."""
    u = np.array([[1.0, -2.0], [3.0, 0.0], [0.0, 4.0], [-8.0, 2.0]])
    weight = np.array([1.0, 3.0, 2.0, 0.0])
    assert reduce.total(u).tolist() == [-4.0, 4.0] and reduce.total(weight) == 6.0
    assert reduce.mean(u).tolist() == [-1.0, 1.0] and reduce.mean(weight) == 1.5
    assert reduce.mean(u[:, 1], weight) == 1.0
    assert reduce.largest(u) == 4.0 and reduce.smallest(u) == -8.0
    assert reduce.norm(np.array([3.0, 0.0, 4.0])) == 5.0
    assert reduce.dot(weight, u).tolist() == [10.0, 6.0] and reduce.dot(weight, weight) == 14.0
    assert reduce.count(u[:, 0] > 0.0) == 2 and reduce.number(u) == 4
    assert reduce.any_true(u[:, 0] > 2.0) and not reduce.any_true(u[:, 0] > 3.0)
    whole, square, number = reduce.totals(u, weight * weight, len(u))
    assert whole.tolist() == [-4.0, 4.0] and square == 14.0 and number == 4
    assert reduce.largest_of_each(u, weight, weight[:0]) == [4.0, 3.0, -np.inf]
    label = np.array([2, 0, 2, 0])
    assert reduce.total_by(label).tolist() == [2, 0, 2]
    assert reduce.total_by(label, weight, 4).tolist() == [3.0, 0.0, 3.0, 0.0]
    one, other = reduce.totals_by(4, (label, weight), (label[1:], None))
    assert one.tolist() == [3.0, 0.0, 3.0, 0.0] and other.tolist() == [2.0, 0.0, 1.0, 0.0]


def test_sums_by_label_of_no_particles_are_numbers_like_those_of_others():
    """A process without particles adds zeros of the same type: integers in their place were added bit by bit."""
    none = np.zeros(0, np.int64)
    assert reduce.total_by(none, np.zeros(0), 3).dtype == float and reduce.total_by(none, labels=3).dtype == np.int64


def test_largest_by_label():
    found = reduce.largest_by(np.array([2, 0, 2]), np.array([1.0, -5.0, 3.0]), 4)
    assert found.tolist() == [-5.0, -np.inf, 3.0, -np.inf]


def test_the_fewest_values_that_hold_a_share():
    """By sorting; of equal ones all, since one number cannot tell them apart."""
    values = np.random.default_rng(5).random(200) ** 8
    for share in (0.0, 0.5, 0.9, 0.99):
        least = reduce.least_of_largest(values, share)
        chosen, whole = values >= least, values.sum()
        assert least in values and values[chosen].sum() >= share * whole * (1.0 - 1e-12)
        assert share == 0.0 or values[values > least].sum() < share * whole
    assert reduce.least_of_largest(np.array([4.0, 1.0, 4.0, 4.0]), 0.5) == 4.0
    assert reduce.least_of_largest(np.zeros(3), 0.9) == reduce.least_of_largest(np.zeros(0), 0.9) == 0.0


def test_single_precision_is_summed_in_double():
    """Otherwise sums over processes, which add up parts, would differ from those of one in the seventh digit."""
    values = np.full(4097, 0.1, np.float32)
    wanted = 4097 * float(values[0])
    assert reduce.total(values) == pytest.approx(wanted, rel=1e-14)
    assert reduce.totals(values, 1.0)[0] == pytest.approx(wanted, rel=1e-14)
    assert reduce.mean(values) == pytest.approx(float(values[0]), rel=1e-14)
