"""The steps that a check expects are those that the run takes, where the flow is known."""

import numpy as np
import pytest

from isphcli.output.clock import Clock
from isphcli.preflight.check import check
from isphcli.preflight.check_result import Motion
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare
from tests.preflight.cases import DROP, SLIT, read

WIND = ("geometry.periodic=[x, y]", "drive=null", "flow=navier_stokes", "initial={velocity: ['3*cos(0*x)', 0]}")


def taken(case):
    """Names of the limits of the steps of a run."""
    state, stepper, particles = prepare(case, build_geometry(case), Clock())
    loop, rows = TimeLoop(case, stepper, particles.site_volume, 1.0), []
    loop.run(state, stepper.ready(state), lambda *_: None, rows.append, lambda *_: None)
    return [row["limit"] for row in rows]


@pytest.mark.parametrize("sets", [
    ("flow=navier_stokes", "time={end: 0.1, step: 0.01}"),  # beside walls, from a 64th of the step on
    (*WIND, "time={end: 0.05}"),  # as far as cfl lets a wind go
    (*WIND, "time={end: 0.05}", "output={every: 0.007}"),  # and cut where snapshots are due
    ("flow=navier_stokes", "time={end: 1}", "drive={body_force: ['1e-6*sin(50*t)', 0]}", "time.max_steps=60"),
])
def test_steps_of_a_flow_that_is_known(sets):
    case = read(SLIT, *sets)
    limits, said = taken(case), check(case).steps
    assert said.count == len(limits) and said.start == limits.count("start")


def test_a_flow_that_slows_down_takes_longer_steps():
    """A vortex, whose speed falls by e in 1 / (2 nu k^2): the steps of the run to one in ten."""
    vortex = "initial={velocity: ['sin(2*pi*x)*cos(2*pi*y)', '-cos(2*pi*x)*sin(2*pi*y)']}"
    case = read(SLIT, "geometry={box: [1, 1], periodic: [x, y]}", "drive=null", "flow=navier_stokes", vortex,
                "fluids.water={density: 1, viscosity: 0.02}", "time={end: 1}")
    found = check(case)
    assert found.flow.motion.decay == pytest.approx(1.0 / (0.02 * 8 * np.pi**2), rel=0.01)
    assert found.steps.count == pytest.approx(len(taken(case)), rel=0.1)


def test_capillary_limit_is_that_of_the_run():
    case = read(DROP, "time.max_steps=3")
    _, stepper, particles = prepare(case, build_geometry(case), Clock())
    limit = TimeLoop(case, stepper, particles.site_volume, 1.0).lengths.capillary
    assert check(case).steps.limits["capillary"] == pytest.approx(limit, rel=1e-12)


def test_a_steady_state_is_judged_as_the_run_does():
    """A flow that comes near its steady value as exp(-t / T) passes the test of the run: 400 steps at least."""
    steady = check(read(SLIT, "flow=navier_stokes", "time={steady: 1e-2}")).steps
    assert 400 <= steady.count < 2000 and not steady.early
    fewer = check(read(SLIT, "flow=navier_stokes", "time={steady: 1e-2, max_steps: 50}")).steps
    assert fewer.count == 50


def test_speeds_of_a_motion():
    motion = Motion(start=2.0, decay=0.5, driven=3.0, rise=0.1, always=1.0)
    assert motion.speed(0.0) == 3.0 and motion.speed(50.0) == pytest.approx(4.0)
    assert motion.speed(0.5) == pytest.approx(2.0 / np.e + 3.0 + 1.0, rel=0.01) and motion.largest == 4.0
