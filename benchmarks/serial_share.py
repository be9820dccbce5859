"""How much of the CPU time is in kernels that all threads share, and what is left is serial: what threads can give.

usage: PYTHONPATH=. python benchmarks/serial_share.py [machine] [steady NAME | SCENE POINTS] ...

One thread, so that the result does not depend on what else the machine does: a share p in kernels bounds the wall time
on two threads to 1 - p / 2 of that on one. NAME: of benchmarks/stokes.py, its solve alone; SCENE:
moving, walls, drop, of benchmarks/step_cost.py (moving: its vortex), so many points across, steps after the second.

machine: first what two threads give this machine, which must have nothing else to do: of the wall time of one, that of
a kernel in registers and of the triad a = b + s c of `TRIAD` entries. The shares then have a bound more: 1 - p + p t,
with the t of the triad, if all that kernels do were to wait for the memory. And the CPU time of sharing four ranges
without rows with a second thread.
"""

import itertools
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor

os.environ["NUMBA_NUM_THREADS"] = "1"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numba import njit

TRIAD = 40_000_000  # entries of each of three arrays: 0.96 GB, beyond every cache
TURNS = 200_000_000  # of the kernel in registers
REPEATS = 7
LOOPS = 5000  # without rows


@njit(nogil=True)
def triad(a, b, c, begin, end):
    for k in range(begin, end):
        a[k] = b[k] + 3.0 * c[k]


@njit(nogil=True)
def in_registers(begin, end):
    found = 1.0
    for k in range(begin, end):
        found = found * 0.999999 + 1e-9 * k
    return found


def two_over_one(kernel, count, *arguments):
    """Wall time of a kernel of so many entries on two threads over that on one, each the least of some runs."""
    least = {}
    with ThreadPoolExecutor(2) as pool:
        for threads in [1, 2] * (REPEATS + 1):  # the first compiles, and touches the arrays
            ends = np.linspace(0, count, threads + 1).astype(int)
            begin = time.perf_counter()
            list(pool.map(lambda part: kernel(*arguments, *part), itertools.pairwise(ends)))
            least.setdefault(threads, []).append(time.perf_counter() - begin)
    return min(least[2][1:]) / min(least[1][1:])


def machine():
    """Prints what two threads give a kernel in registers and a triad; returns that of the triad."""
    arrays = np.zeros(TRIAD), np.ones(TRIAD), np.ones(TRIAD)
    computing, streaming = two_over_one(in_registers, TURNS), two_over_one(triad, TRIAD, *arrays)
    print(f"two threads over one: {computing:.2f} in registers, {streaming:.2f} a triad of {TRIAD:,}", flush=True)
    print(f"a loop shared by two: {1e6 * hand_over():.0f} CPU us", flush=True)
    return streaming


def hand_over():
    """CPU seconds of a loop without rows that two threads share."""
    from isphcli.domain.row_threads import _share_out

    begin = time.process_time()
    for _ in range(LOOPS):
        _share_out(lambda rows: in_registers(*rows), [(0, 0)] * 4, 2)
    return (time.process_time() - begin) / LOOPS


class Share:
    """CPU seconds in `row_threads._share_out`, of ranges that there are several of on several threads. triad: wall time
    of a triad on two threads over that on one, or None."""

    def __init__(self, row_threads, triad=None):
        self.inside, self.total, self.triad, plain = 0.0, 0.0, triad, row_threads._share_out

        def timed(call, ranges, threads):
            before, begin = self.inside, time.process_time()
            found = plain(call, ranges, threads)
            self.inside = before + time.process_time() - begin  # loops within these are in it
            return found

        row_threads._share_out = timed

    def of(self, function):
        self.inside, begin = 0.0, time.process_time()
        found = function()
        self.total = time.process_time() - begin
        return found

    def line(self, name):
        p = self.inside / self.total
        waiting = "" if self.triad is None else f", {1 - p + p * self.triad:.2f} if kernels were triads"
        return (f"{name:28} {self.total:6.2f} CPU s, {100 * p:.0f} % in kernels: {1 - p / 2:.2f} of the wall on two "
                f"threads{waiting}")


def steady(share, name):
    from stokes import CASES, SCENES

    from isphcli.case.forcing import drives
    from isphcli.case.load import load_case
    from isphcli.output.clock import Clock
    from isphcli.runs.steady import build_scene, solve_axis
    from isphcli.scene.build_geometry import build_geometry

    file, sets = SCENES[name]
    case = load_case(CASES / file, sets)
    geometry = build_geometry(case)
    scene = share.of(lambda: build_scene(case, geometry, case.particles.spacing, Clock()))
    print(share.line(f"{name}, set-up"), flush=True)
    axis, force = drives(case, geometry)[0]
    share.of(lambda: solve_axis(case, scene, axis, force, Clock()))
    print(share.line(f"{name}, solve"), flush=True)


def moving(share, name, points):
    import step_cost

    from isphcli.case.load import read_case
    from isphcli.flow.state import Handover
    from isphcli.output.clock import Clock
    from isphcli.scene.build_geometry import build_geometry
    from isphcli.scene.prepare import prepare

    text, step = step_cost.SCENES["vortex" if name == "moving" else name]
    case = read_case(text.format(spacing=1.0 / points).encode(), "step_cost.yaml")
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    ready = stepper.ready(state)

    def steps(count, state, ready):
        for _ in range(count):
            found = stepper.advance(state, ready, step / points)
            state, ready = found.state, Handover(found.config)
        return state, ready

    state, ready = steps(2, state, ready)
    share.of(lambda: steps(4, state, ready))
    print(share.line(f"{name} {points}^3, 4 steps"), flush=True)


if __name__ == "__main__":
    from isphcli.domain import row_threads

    first = machine() if "machine" in sys.argv else None
    asked = [word for word in sys.argv[1:] if word != "machine"] or ["steady", "berea c64", "moving", "48"]
    for kind, what in zip(asked[::2], asked[1::2]):
        share = Share(row_threads, first)
        steady(share, what) if kind == "steady" else moving(share, kind, int(what))
