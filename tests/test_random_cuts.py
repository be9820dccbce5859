"""Boxes at random on one to eight processes, which are threads of one: operators do not know where the cuts are.

tests/test_ranks.py has chosen scenes on processes of MPI.
"""

import numpy as np
import pytest

import isphcli.runs.steady as steady
from isphcli.case.load import read_case
from tests.domain.several import on_threads
from tests.ranks import FEW, applied_to_own, no_solver

SCENE = """
geometry:
  box: {box}
  periodic: [x, y, z]
  shapes: [{{sphere: {{centre: {centre}, radius: {radius}}}, is: solid}}]
particles: {{spacing: 0.1, jitter: 0.3, seed: {seed}}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
"""


def scene(seed):
    """An elongated box, many thinner than two supports of 0.21 m along one axis or two, some than one, with a sphere
    somewhere in it."""
    rng = np.random.default_rng(seed)
    box = rng.permutation([rng.integers(6, 16), *rng.integers(2, 7, 2)]) / 10
    radius = 0.45 * np.sort(box)[1 if seed % 2 else 0]
    return read_case(SCENE.format(box=box.tolist(), centre=(rng.random(3) * box).tolist(), radius=radius,
                                  seed=seed).encode(), "scene.yaml")


def in_order(parts):
    x, forces, mass = (np.concatenate(part) for part in zip(*parts))
    order = np.lexsort(np.round(x * 1e6).T)
    return x[order], forces[order], mass[order]


@pytest.mark.parametrize("size", range(1, 9))
def test_the_operator_is_that_of_one_process(size, monkeypatch):
    """To round-off of sums in another order; places are the same. Two boxes each, and a row of four particles: of more
    processes some have none."""
    monkeypatch.setattr(steady, "engine_of", lambda _: no_solver())
    for case in (scene(2 * size), scene(2 * size + 1), read_case(FEW.encode(), "few.yaml")):
        one = in_order([applied_to_own(case)])
        several = in_order(on_threads(size, lambda _, case=case: applied_to_own(case)))
        assert np.array_equal(one[0], several[0])
        for expected, found in zip(one[1:], several[1:]):
            assert np.abs(found - expected).max() <= 1e-13 * np.abs(expected).max()
