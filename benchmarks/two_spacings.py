"""Particles of half the spacing where a flow loses its energy alone (`refine: throats`): k over CPU seconds, against
lattices of one spacing.

usage: PYTHONPATH=. python benchmarks/two_spacings.py bodies [NAME ...]
       PYTHONPATH=. python benchmarks/two_spacings.py bars [NAME ...]
       PYTHONPATH=. python benchmarks/two_spacings.py cubes [NAME ...]
       PYTHONPATH=. python benchmarks/two_spacings.py rock [EDGE] [stairs|smooth] [AXIS]

bodies: exact surfaces of `isphcli.validation.known_bodies` and a throat between wide pores, at three places of the
lattice; mean and root mean square of the errors of k. bars: of how many surfaces the bar holds the truth. cubes: the
labels of such bodies as cubes, against the limit of 3 and 4 particles a voxel edge. rock: a corner of Berea, against
half the spacing everywhere. Two spacings are said as "1 and 2, 0.8": one and two particles a voxel edge, two where 0.8
of the energy is lost; the seconds are those of both solves.
"""

import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
from calibration import case_of

from isphcli.case.load import load_case
from isphcli.output.clock import Clock
from isphcli.runs.expected_error import grain_chord
from isphcli.runs.half_in_throats import in_throats, limit_of_throats
from isphcli.runs.permeability import EDGE, SHARE, extrapolate
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.validation.known_bodies import Body, LevelGeometry, body
from isphcli.validation.known_bodies import bodies as known_bodies

SHARES = 0.5, 0.8, 0.9
PLACES = (0.0, 0.0, 0.0), (0.37, 0.71, 0.13), (0.81, 0.29, 0.57)  # of the lattice, spacings
BODIES = ("throat", "spheres 0.45, 14", "cylinders 0.4, 16", "blobs 11", "blobs 12", "blobs 16", "blobs 18")
CUBES = "blobs 12", "blobs 18"


def throat():
    """A tube of 24 voxels a period whose radius goes from 7 to 1.8 voxels and back: one throat rules it."""

    def level(x):
        radius = 1.8 + 5.2 * np.sin(np.pi * x[:, 0] / 24.0) ** 2
        return radius - np.hypot(*(x[:, k] - np.floor(x[:, k] / 16.0) * 16.0 - 8.2 for k in (1, 2)))

    return Body("throat", "throat", (24, 16, 16), 0, level)


def one_spacing(case, geometry, spacing, axis, keep=False):
    """(k, particles, iterations, CPU seconds), and with `keep` the scene and the flow."""
    begin = time.process_time()
    case = replace(case, particles=replace(case.particles, spacing=spacing))
    scene = build_scene(case, geometry, spacing, Clock(), [axis])
    flow = solve_axis(case, scene, axis, np.eye(3)[axis], Clock())
    found = (float(flow.permeability[axis]), scene.particles.n_fluid, flow.convergence.iterations,
             time.process_time() - begin)
    return (found, (case, scene, flow)) if keep else found


def two_spacings(geometry, kept, seconds, axis, share):
    """As `one_spacing`, and the spread of the flux between layers; kept, seconds: of the larger one."""
    begin, (case, scene, flow) = time.process_time(), kept
    known = scene.system.ops, scene.particles.x[: scene.particles.n_fluid], flow.velocity
    found = in_throats(case, geometry, known, (axis, np.eye(3)[axis]), Clock(), share)
    return (found.permeability, found.particles, found.convergence.iterations,
            seconds + time.process_time() - begin, found.mass_error)


def ladder(case, geometry, voxel, axis, finest):
    """{what: (k, particles, iterations, CPU seconds)} of particles a voxel edge; finest: numbers of one spacing."""
    found = {}
    for n in finest:
        found[f"{n:g}"], kept = one_spacing(case, geometry, voxel / n, axis, keep=True)
        for share in SHARES if 2 * n in finest else ():
            kind = f"{n:g} and {2 * n:g}, {share:g}"
            found[kind] = two_spacings(geometry, kept, found[f"{n:g}"][3], axis, share)[:4]
        del kept
        print(*found.items(), sep="\n", file=sys.stderr, flush=True)
    return found


def case_and_geometry(one, wall):
    with tempfile.TemporaryDirectory() as folder:
        case = case_of(one, wall, Path(folder))
        return case, build_geometry(case)


def load_kernels():
    case, _ = case_and_geometry(throat(), "labels")
    geometry = LevelGeometry(throat())
    (*_, seconds), kept = one_spacing(case, geometry, 1.0, 0, keep=True)
    two_spacings(geometry, kept, seconds, 0, SHARES[0])


def bodies(*names):
    print("| body | particles a voxel edge | error, % | rms, % | particles | iterations | CPU s |")
    print("|---|---|---|---|---|---|---|")
    for name in names or BODIES:
        one = throat() if name == "throat" else body(name)
        case, _ = case_and_geometry(one, "labels")
        geometry, found = LevelGeometry(one), []
        for place in PLACES:
            at = replace(case, particles=replace(case.particles, offset=place))
            found.append(ladder(at, geometry, 1.0, one.axis, (1, 1.5, 2)))
        truth = one.known[0] if one.known else one_spacing(case, geometry, 1 / 4, one.axis)[0]
        for kind in found[0]:
            k, *rest = np.array([of[kind] for of in found]).T
            error = 100.0 * (k / truth - 1.0)
            rms, (n, iterations, seconds) = np.sqrt((error**2).mean()), (values.mean() for values in rest)
            print(f"| {name} | {kind} | {error.mean():+.2f} | {rms:.2f} | {n:.0f} | {iterations:.0f} | {seconds:.2f} |",
                  flush=True)


def bars(*names):
    """Whether error bars of `refine: throats` hold the truth of the exact surfaces at one particle a voxel edge."""
    held = []
    for one in known_bodies():
        if names and one.name not in names:
            continue
        case, _ = case_and_geometry(one, "labels")
        geometry, truth = LevelGeometry(one), one.truth()
        first, kept = one_spacing(case, geometry, 1.0, one.axis, keep=True)
        k, *_, flux = two_spacings(geometry, kept, 0.0, one.axis, SHARE)
        pores = float(one.labels().mean()), grain_chord(geometry, 0.5)
        value, bar = limit_of_throats(first[0], k, 1.0, pores, "smooth", flux)[:2]
        off = abs(value - truth[0])
        held.append((off <= bar + truth[1] * truth[0], off / value, bar / value))
        print(f"{one.name}: one {100 * (first[0] / truth[0] - 1):+.2f} %, two {100 * (k / truth[0] - 1):+.2f} %, bar "
              f"{100 * bar / k:.2f} %", flush=True)
    within, off, wide = np.array(held).T
    print(f"{len(held)} bodies, {100 * within.mean():.0f} % within the bar, median error {100 * np.median(off):.3f} %, "
          f"bar {100 * np.median(wide):.3f} %, bar over error {np.median(wide / np.maximum(off, 1e-6)):.2f}")


def against(found, limit, name, voxel=1.0):
    print(f"{name}: compared with {limit / voxel**2:.5g} voxel^2")
    print("| particles a voxel edge | k, voxel^2 | off by, % | particles | iterations | CPU s |")
    print("|---|---|---|---|---|---|")
    for kind, (k, n, iterations, seconds) in found.items():
        print(f"| {kind} | {k / voxel**2:.5f} | {100 * (k / limit - 1):+.2f} | {n} | {iterations} | {seconds:.2f} |")
    sys.stdout.flush()


def cubes(*names):
    for name in names or CUBES:
        case, geometry = case_and_geometry(body(name), "stairs")
        found = ladder(case, geometry, 1.0, body(name).axis, (1, 2, 3, 4))
        against(found, extrapolate((1 / 3, 1 / 4), [found[n][0] for n in "34"], EDGE)[0], name)


def rock(edge="64", walls="stairs", along="x"):
    case = load_case(Path(__file__).parents[1] / "cases/berea.yaml",
                     [f"geometry.voxels.crop={[[0, int(edge)]] * 3}", f"geometry.wall_distance={walls}"])
    axis, voxel = "xyz".index(along), case.particles.spacing
    found = ladder(case, build_geometry(case, axis), voxel, axis, (1, 2))
    against(found, found["2"][0], f"Berea {edge}^3, {walls}, along {along}", voxel)


if __name__ == "__main__":
    load_kernels()
    {"bodies": bodies, "bars": bars, "cubes": cubes, "rock": rock}[sys.argv[1]](*sys.argv[2:])
