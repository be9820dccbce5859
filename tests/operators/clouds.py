"""Clouds of particles with their operators, and polynomials on them."""

import numpy as np

from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.neighbours import neighbourhood
from isphcli.operators.moments import particle_volumes
from isphcli.operators.pair_weights import build_operators


def jittered(dim, n, jitter=0.1, seed=0):
    """n^dim particles in the unit box, each moved by up to `jitter` spacings an axis."""
    ax = (np.arange(n) + 0.5) / n
    x = np.stack(np.meshgrid(*[ax] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = x + np.random.default_rng(seed).uniform(-jitter, jitter, x.shape) / n
    return wrap(x, np.zeros(dim), np.ones(dim), np.ones(dim, bool))


def neighbours_of(x, support, kind=0, length=1.0):
    """Neighbourhood in a periodic box."""
    dim = x.shape[1]
    halo = build_halo(x, np.zeros(dim), np.full(dim, length), np.ones(dim, bool), support)
    return neighbourhood(halo.positions(x), halo.owners(len(x)), len(x), kind, support)


def build(x, support, kind=0, order=2, length=1.0):
    """Operators in a periodic box."""
    neighbours = neighbours_of(x, support, kind, length)
    return build_operators(neighbours, particle_volumes(neighbours), order)


def free(x, support, kind=0, order=2):
    """Operators of particles alone in space, volumes of a lattice of a third of the support."""
    neighbours = neighbourhood(x, np.arange(len(x), dtype=np.int32), len(x), kind, support)
    return build_operators(neighbours, np.full(len(x), (support / 3) ** x.shape[1]), order)


def quadratic(dim, seed=1):
    """c + b.x + x.H.x / 2 and its gradient as functions of x (n, dim), and its Laplacian."""
    rng = np.random.default_rng(seed)
    h = rng.uniform(-1, 1, (dim, dim))
    h, b, c = h + h.T, rng.uniform(-1, 1, dim), rng.uniform(-1, 1)
    centre = np.full(dim, 0.5)

    def f(x):
        d = x - centre
        return c + d @ b + 0.5 * np.einsum("nk,km,nm->n", d, h, d)

    return f, lambda x: b + (x - centre) @ h, np.trace(h)


def inside(x, support):
    """Particles whose neighbourhoods do not cross a face of the unit box."""
    rows = np.all((x > support) & (x < 1 - support), axis=1)
    assert rows.any()
    return rows
