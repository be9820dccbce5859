"""Results that are made up, of cases of the repository."""

import numpy as np

from isphcli.case.load import load_case
from isphcli.references.result import Result
from isphcli.scene.build_geometry import build_geometry
from tests.paths import CASES

WRONG = 1.03  # every velocity or permeability 3 % too large


def the_case(name, *overrides):
    return load_case(CASES / f"{name}.yaml", overrides)


def lattice(case):
    """Sites in the middle of the cells of a box, and the spacing."""
    h = case.particles.spacing
    axes = [(np.arange(round(edge / h)) + 0.5) * h for edge in case.geometry.box]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes)), h


def result_of(case, x=None, velocity=None, **more):
    x = lattice(case)[0] if x is None else x
    velocity = np.zeros_like(x) if velocity is None else velocity
    known = dict(x=x, velocity=velocity, cell_velocity=velocity, pressure=np.zeros(len(x)), time=None)
    known |= dict(phase=np.zeros(len(x), np.int8), spacing=case.particles.spacing, geometry=build_geometry(case))
    history = more.get("history", [])
    return Result(**({**known, "history": history, "two_fluids": history[-1] if history else {}} | more))


def rows(**columns):
    """A history: a dict a step; a number is the same in every one."""
    steps = max(np.size(values) for values in columns.values())
    whole = {name: np.broadcast_to(values, steps) for name, values in columns.items()}
    return [{name: float(values[k]) for name, values in whole.items()} for k in range(steps)]
