"""How much of the CPU time is in kernels that all threads share, and what is left is serial: what threads can give.

usage: PYTHONPATH=. python benchmarks/serial_share.py [steady NAME | moving POINTS] ...

One thread, so that the result does not depend on what else the machine does: a share p in kernels bounds the wall time
on two threads to 1 - p / 2 of that on one. NAME: of benchmarks/stokes.py, its solve alone; POINTS: across the
Taylor-Green vortex of benchmarks/step_cost.py, steps after the second.
"""

import os
import sys
import time

os.environ["NUMBA_NUM_THREADS"] = "1"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


class Share:
    """CPU seconds in `row_threads._share_out`, of ranges that there are several of on several threads."""

    def __init__(self, row_threads):
        self.inside, self.total, plain = 0.0, 0.0, row_threads._share_out

        def timed(call, ranges):
            begin = time.process_time()
            found = plain(call, ranges)
            self.inside += time.process_time() - begin
            return found

        row_threads._share_out = timed

    def of(self, function):
        self.inside, begin = 0.0, time.process_time()
        found = function()
        self.total = time.process_time() - begin
        return found

    def line(self, name):
        p = self.inside / self.total
        return (f"{name:28} {self.total:6.2f} CPU s, {100 * p:.0f} % in kernels: {1 - p / 2:.2f} of the wall on two "
                "threads")


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


def moving(share, points):
    import step_cost

    from isphcli.case.load import read_case
    from isphcli.flow.state import Handover
    from isphcli.output.clock import Clock
    from isphcli.scene.build_geometry import build_geometry
    from isphcli.scene.prepare import prepare

    case = read_case(step_cost.CASE.format(spacing=1.0 / points).encode(), "step_cost.yaml")
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    ready = stepper.ready(state)

    def steps(count, state, ready):
        for _ in range(count):
            found = stepper.advance(state, ready, 0.2 / points)
            state, ready = found.state, Handover(found.config)
        return state, ready

    state, ready = steps(2, state, ready)
    share.of(lambda: steps(4, state, ready))
    print(share.line(f"moving {points}^3, 4 steps"), flush=True)


if __name__ == "__main__":
    from isphcli.domain import row_threads

    asked = sys.argv[1:] or ["steady", "berea c64", "moving", "48"]
    for kind, what in zip(asked[::2], asked[1::2]):
        share = Share(row_threads)
        steady(share, what) if kind == "steady" else moving(share, int(what))
