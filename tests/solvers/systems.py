"""Poisson systems of jittered particles, and their solve."""

import numpy as np

from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.neighbours import neighbourhood
from isphcli.operators.moments import particle_volumes
from isphcli.operators.pair_weights import build_operators
from isphcli.solvers.krylov import Limits, gmres
from isphcli.solvers.multigrid import cycle, hierarchy


def operators(dim, n, ratio):
    """Operators of n^dim jittered particles in the periodic unit box."""
    ax = (np.arange(n) + 0.5) / n
    x = np.stack(np.meshgrid(*[ax] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = x + np.random.default_rng(0).uniform(-0.1, 0.1, x.shape) / n
    x = wrap(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool))
    halo = build_halo(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool), ratio / n)
    rows, owner = halo.positions(x), halo.owners(len(x))
    neighbours = neighbourhood(rows, owner, len(x), 0, ratio / n)
    return x, build_operators(neighbours, particle_volumes(neighbours))


def solve(matrix, rhs, means, tolerance=1e-8, **kw):
    precondition = cycle(hierarchy(matrix))
    return gmres(
        lambda v: means.remove(matrix @ means.remove(v)),
        means.remove(rhs),
        lambda v: means.remove(precondition(v)),
        Limits(tolerance, 40, 200),
        **kw,
    )
