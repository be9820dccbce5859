"""What `test_ranks.py` runs on several processes: mpiexec -n N python -m tests.ranks OUT ENGINE; without
mpiexec, on one.

Each scene leaves its summary, and what the operators make of a field, in OUT/<name>.json and .npz, in the order of the
positions: that is the same however many processes there are.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

BEREA = ["geometry.voxels.crop=[[0,32],[0,32],[0,32]]"]
BARS = """
geometry:
  box: [{length}, 0.6, 1.0]
  periodic: [x, y, z]
  shapes: [{{cylinder: {{axis: y, centre: [0.5, 0.3, 0.5], radius: 0.3}}, is: solid}}]
particles: {{spacing: 0.1}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
measure: [formation_factor]
"""
TUBE = """
geometry:
  box: [2.0, 0.2]
  depth: 0.1  # drag of two plates
  periodic: [x]
particles: {spacing: 0.05}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
"""
FEW = """
geometry:
  box: [0.4, 1.0, 1.0]
  periodic: [x, y, z]
  shapes: [{box: {lower: [-1, 0.0, 0.0], upper: [2, 0.1, 0.1]}, outside: true, is: solid}]
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
"""  # a row of four particles: some processes have none
# positions off their lattice, some of which change their process by it; fields on a grid whose cells are not those of
# the particles, one file of all processes
SCATTERED = BARS.format(length="1.6").replace("spacing: 0.1", "spacing: 0.1, jitter: 0.2") + """
output: {grid: 0.07, format: xdmf}
"""
# Two spacings: spheres that leave gaps of a particle and slip, and voxels of Berea; cuts lie in what is refined
PACK = """
geometry:
  box: [2, 1, 1]
  slip_length: 0.03
  periodic: [x, y, z]
  shapes:
    - {sphere: {centre: [0.5, 0.4, 0.5], radius: 0.45}, is: solid}
    - {sphere: {centre: [1.4, 0.8, 0.1], radius: 0.3}, is: solid}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
drive: {axes: [x]}
solver: {tolerance: 1e-8}
refine: throats
"""
TEXTS = {"thin": BARS.format(length="0.2"), "long": BARS.format(length="2.0"), "few": FEW, "scattered": SCATTERED,
         "tube": TUBE + "output: {grid: 0.035}\n", "pack": PACK}
MIXED = {"pack", "throats"}
FILES = {"berea": ("berea", BEREA), "spheres": ("sphere_array", ["drive.axes=[x]"]), "tubes": ("two_tubes", []),
         "smooth": ("berea", [*BEREA, "geometry.wall_distance=smooth"]),
         "throats": ("berea", ["geometry.voxels.crop=[[20,60],[35,43],[90,98]]", "geometry.voxels.clear_layer=1.2e-5",
                               "refine=throats", "solver.tolerance=1e-8"]),
         "grey": ("grey_blobs", ["geometry.voxels.grey.uncertainty=2000"]),
         # corrected until its own scan is the image, and mirrored at its faces but those of y
         "scan": ("grey_blobs", ["geometry.voxels.grey.blur=0.5", "geometry.periodic=[y]", "drive.axes=[x, y]",
                                 "reference=null"])}


def cases():
    from isphcli.case.load import load_case, read_case
    from tests.paths import CASES

    for name, text in TEXTS.items():
        yield name, read_case(text.encode(), f"{name}.yaml")
    for name, (file, overrides) in FILES.items():
        yield name, load_case(CASES / f"{file}.yaml", tuple(overrides))


def no_solver():
    """An engine whose cycles do nothing."""
    from isphcli.solvers.engine import OneProcess

    class NoSolver(OneProcess):
        def cycle(self, matrix, exchange):
            return lambda b: b

        def block_cycle(self, matrix, exchange, strength):
            return lambda b: b

    return NoSolver()


def applied(case):
    """Positions of the fluid, and the coupled operator times a field of the position, of all processes."""
    import isphcli.runs.steady as steady
    from isphcli.domain.communicator import current

    known, steady.engine_of = steady.engine_of, lambda _: no_solver()
    try:
        of_all = current().gather(applied_to_own(case))
    finally:
        steady.engine_of = known
    return [np.concatenate(part) for part in zip(*of_all)] if of_all is not None else None


def applied_to_own(case):
    """The same of the particles of this process, by an engine that `steady.engine_of` gives."""
    from isphcli.output.clock import Clock
    from isphcli.runs.steady import build_scene
    from isphcli.scene.build_geometry import build_geometry

    scene = build_scene(case, build_geometry(case), case.particles.spacing, Clock())
    x, system = scene.particles.x[: scene.particles.n_fluid], scene.system
    y = x / case.particles.spacing
    u = np.sin(y * [0.3, 0.5, 0.7][: x.shape[1]] + y[:, ::-1])
    found = system.apply(np.concatenate([u.ravel(), np.cos(y @ [0.4, 0.9, 0.2][: x.shape[1]])]))
    return x, *system.split(found)


def applied_two(case):
    """The same of particles of two spacings, half of it in cells that no flow chose, what is added to walls and the
    products of both matrices of the preconditioner among the forces."""
    from isphcli.domain.communicator import current
    from isphcli.domain.mixed_lattice import MixedLattice
    from isphcli.flow.mixed_stokes import MixedStokes
    from isphcli.operators.mixed_weights import build_mixed_operators
    from isphcli.runs.half_in_throats import cells_that_lose, place_two
    from isphcli.scene.build_geometry import build_geometry
    from isphcli.scene.place import lattice_at, place_case

    geometry, spacing = build_geometry(case), case.particles.spacing
    lattice, support = lattice_at(case, geometry, spacing), case.support * spacing
    coarse = place_case(case, geometry, spacing)
    x = coarse.x[: coarse.n_fluid]
    size, dim = geometry.upper - geometry.lower, geometry.dim
    lost = np.exp(4.0 * np.cos(2.0 * np.pi * (x - geometry.lower) / size - [0.4, 0.9, 2.3][:dim]).sum(axis=1))
    particles = place_two(geometry, MixedLattice(lattice, cells_that_lose(lattice, x, lost, 0.5), support, 1), spacing,
                          support)
    share, d = particles.share, particles.spacings
    if share is not None:
        geometry = geometry.within(share.lower, share.upper, support)
    ops, faces = build_mixed_operators(geometry, particles, 0, support)
    system = MixedStokes(ops, faces, d, spacing, no_solver())
    x = particles.x[: ops.n]
    y = 2.0 * np.pi * (x - geometry.lower) / size
    u, q = np.sin(y * [1, 2, 1][:dim] + y[:, ::-1]), np.cos(y @ [1, 1, 2][:dim])
    forces, mass = system._split(system.apply(system._joined(u, q)))
    matrix = faces.conductance(2.0 + q) @ ops.exchange.forward(q)
    rough = system._split(system.precondition(system._joined(u, q)))
    of_all = current().gather((x, np.column_stack([forces, matrix, *rough, d]), mass))
    return [np.concatenate(part) for part in zip(*of_all)] if of_all is not None else None


def reduced():
    """Sums and quantiles of random numbers that are dealt out to the processes, and of the same in one."""
    from isphcli.domain import reduce
    from isphcli.domain.communicator import current

    ranks = current()
    values = np.random.default_rng(3).normal(size=401) * 1e3
    own = values[np.random.default_rng(4).integers(0, ranks.size, 401) == ranks.rank]
    if ranks.size > 1:  # an empty process
        own = np.zeros(0) if ranks.rank == 1 else values if ranks.rank == 0 else own[:0]
    shares = [0.0, 0.05, 0.5, 0.951, 1.0]
    return {"quantiles": reduce.quantiles(own, shares).tolist(), "wanted": np.quantile(values, shares).tolist(),
            "least": float(reduce.least_of_largest(np.abs(own), 0.7)),
            "fewest": float(reduce.least_of_largest(np.abs(values), 0.7)) if ranks.size == 1 else None,
            "sums": [float(reduce.total(own) - values.sum()), float(reduce.mean(own) - values.mean()),
                     float(reduce.largest(own) - values.max()), float(reduce.smallest(own) - values.min()),
                     reduce.count(own > 0) - int((values > 0).sum()), reduce.number(own) - 401,
                     *np.subtract(reduce.totals(own, np.abs(own), len(own)),
                                  [values.sum(), np.abs(values).sum(), 401.0]),
                     *np.subtract(reduce.largest_of_each(own, -own), [values.max(), -values.min()])]}


def kept_by_petsc():
    """How many of two hierarchies, which nothing refers to any more, PETSc holds when a third one is made."""
    import gc
    import weakref

    import scipy.sparse as sp

    from isphcli.domain.communicator import current
    from isphcli.solvers.engine import engine_of

    class Mark:
        """What a matrix of PETSc holds as long as it is there."""

    class Own:
        def numbers(self, n):
            return current().rank * n + np.arange(n)

    marks = []
    for _ in range(3):
        once = engine_of("petsc").cycle(sp.csr_matrix(sp.diags([-1.0, 2.5, -1.0], [-1, 0, 1], (50, 50))), Own())
        gc.collect()
        left = sum(mark() is not None for mark in marks)
        mark = Mark()
        once.matrix.setAttr("mark", mark)
        marks.append(weakref.ref(mark))
        del once, mark
    return left


def main(folder, engine, names="all"):
    from isphcli import api
    from isphcli.domain.communicator import current, join
    from isphcli.output.environment import launched

    join(launched())
    out = Path(folder)
    if current().rank == 0:
        out.mkdir(exist_ok=True)
    first = current().rank == 0
    for name, case in cases():
        if names != "all" and name not in names.split(","):
            continue
        case = replace(case, solver=replace(case.solver, engine=engine), output=replace(case.output, plots=False))
        field = applied_two(case) if name in MIXED else applied(case) if name in (*TEXTS, "berea") else None
        found = api.run(case, out=out / name, quiet=True, check=False)
        if first:
            text = {key: value for key, value in found.summary.items() if key not in ("directory", "pictures")}
            (out / f"{name}.json").write_text(json.dumps(text, default=lambda v: np.asarray(v).tolist()))
            if field is not None:
                np.savez(out / f"{name}.npz", x=field[0], forces=field[1], mass=field[2])
    numbers = reduced()
    if current().size > 1:
        numbers["kept"] = int(current().sum(kept_by_petsc()))
    if first:
        (out / "reduced.json").write_text(json.dumps(numbers))


if __name__ == "__main__":
    main(*sys.argv[1:])
