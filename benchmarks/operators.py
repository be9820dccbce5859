"""Cost of neighbours and operators on a jittered periodic lattice: CPU us per particle and ns per pair.

    NUMBA_NUM_THREADS=1 python benchmarks/operators.py [--size N] [--dim 3] [--support 2.1] [--repeats 5]

Medians of process CPU time after one run that compiles. `walls`: the same box with a ball in its middle.
"""

import argparse
import time

import numpy as np

from isphcli.domain.halo import build_halo, wrap
from isphcli.domain.lattice import make_lattice
from isphcli.domain.neighbours import neighbourhood
from isphcli.geometry.bodies import Shape, Sphere
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.operators.apply import divergence, gradient, laplacian
from isphcli.operators.crossings import MEETS_WALL, crossings
from isphcli.operators.moments import particle_volumes
from isphcli.operators.pair_weights import build_operators
from isphcli.operators.wall_scene import WallScene
from isphcli.operators.wall_weights import build_wall_operators
from isphcli.scene.place import place


def timed(function, repeats):
    """(last result, median CPU seconds) without the first, compiling call."""
    result, spent = function(), []
    for _ in range(repeats):
        before = time.process_time()
        result = function()
        spent.append(time.process_time() - before)
    return result, float(np.median(spent))


def report(name, seconds, particles, pairs):
    micro, nano = seconds / particles * 1e6, seconds / max(pairs, 1) * 1e9
    print(f"  {name:28s}{micro:9.3f} us/particle{nano:9.2f} ns/pair", flush=True)


def periodic(dim, n, ratio, repeats):
    ax = (np.arange(n) + 0.5) / n
    x = np.stack(np.meshgrid(*[ax] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = x + np.random.default_rng(0).uniform(-0.1, 0.1, x.shape) / n
    lower, upper, axes, support = np.zeros(dim), np.ones(dim), np.ones(dim, bool), ratio / n
    x = wrap(x, lower, upper, axes)
    halo, t_halo = timed(lambda: build_halo(x, lower, upper, axes, support), repeats)
    rows, owner = halo.positions(x), halo.owners(len(x))
    pairs, t_pairs = timed(lambda: neighbourhood(rows, owner, len(x), 0, support), repeats)
    volume, t_volume = timed(lambda: particle_volumes(pairs), repeats)
    size = len(pairs.row)
    print(
        f"periodic {dim}D, {n}^{dim} particles, {len(rows) - len(x)} images, "
        f"support {ratio}: {size / len(x):.1f} neighbours"
    )
    report("build_halo", t_halo, len(x), size)
    report("neighbourhood", t_pairs, len(x), size)
    report("particle_volumes", t_volume, len(x), size)
    for order in (1, 2):
        ops, t = timed(lambda: build_operators(pairs, volume, order), repeats)  # noqa: B023
        report(f"build_operators order {order}", t, len(x), size)
    u = np.random.default_rng(1).normal(size=x.shape)
    for apply in (laplacian, gradient, divergence):
        report(apply.__name__, timed(lambda: apply(ops, u), repeats)[1], len(x), size)  # noqa: B023


def ball(dim, n, ratio, repeats):
    geometry = ShapeGeometry(
        np.zeros(dim), np.ones(dim), [True] * dim, shapes=[Shape(Sphere([0.5] * dim, 0.35))]
    )
    support = ratio / n
    lattice = make_lattice(
        "square" if dim == 2 else "cubic", geometry.lower, geometry.upper, geometry.periodic, 1 / n, support
    )
    p = place(geometry, lattice, support, 0.1, 1 / n)
    scene = WallScene(geometry, p.x[p.n_fluid:], support, 0, p.site_volume)
    stencils, _ = scene.stencils(p.x[: p.n_fluid], fixed=True)
    links, t_cross = timed(lambda: crossings(geometry, stencils.neighbours, stencils.walls), repeats)
    size = len(links.link)
    crossed = (links.link == MEETS_WALL).mean()
    print(f"walls {dim}D, {p.n_fluid} fluid particles, {p.n_dummy} dummies, {crossed:.0%} wall pairs")
    report("crossings", t_cross, p.n_fluid, size)
    for order in (1, 2):
        _, t = timed(lambda: build_wall_operators(stencils, order), repeats)  # noqa: B023
        report(f"build_wall_operators order {order}", t, p.n_fluid, size)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, help="particles along an edge (default 128 in 2D, 40 in 3D)")
    parser.add_argument("--dim", type=int, choices=(2, 3), action="append", help="default: both")
    parser.add_argument(
        "--support", type=float, action="append", help="support over spacing (default 2.1 and 2.5)"
    )
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    for dim in args.dim or (2, 3):
        for ratio in args.support or (2.1, 2.5):
            periodic(dim, args.size or (128 if dim == 2 else 40), ratio, args.repeats)
            ball(dim, args.size or (128 if dim == 2 else 40), ratio, args.repeats)
