"""Layers and drops of two fluids, and their runs."""

import numpy as np

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare


def scene(text):
    case = read_case(text.encode(), "case.yaml")
    geometry = build_geometry(case)
    return (case, geometry, *prepare(case, geometry, Clock()))


def run(text):
    """(state, stepper, particles, rows) at the end of a case."""
    case, geometry, state, stepper, particles = scene(text)
    rows = []
    return run_loop(case, geometry, state, stepper, particles, rows.append), stepper, particles, rows


def run_loop(case, geometry, state, stepper, particles, record=lambda _: None):
    """The state at the end of a case that begins from `state`; record: takes the rows of its history."""
    loop = TimeLoop(case, stepper, particles.site_volume, float(np.prod(geometry.upper - geometry.lower)))
    nothing = lambda *_: None  # noqa: E731
    return loop.run(state, stepper.ready(state), nothing, record, nothing)[0]


LAYERS = """
geometry:
  box: [{width}, 1]
  periodic: [x]
  fluid: a
  shapes: [{{half_space: {{point: [0, 0.5], normal: [0, -1]}}, is: b}}]
  walls: {{y_max: {{velocity: [{lid}, 0]}}}}
particles: {{spacing: {dx}}}
fluids: {{a: {{density: {rho}, viscosity: 1}}, b: {{density: 1, viscosity: {mu}}}}}
drive: {drive}
time: {time}
"""


def layers(dx=1 / 16, lid=0, rho=1, mu=1, gx=0, gy=0, time="{end: 1}"):
    drive = f"{{body_force: [{gx}, {gy}]}}" if gx or gy else "null"
    return LAYERS.format(width=6 * dx, dx=dx, lid=lid, rho=rho, mu=mu, drive=drive, time=time)


DROP = """
geometry:
  box: [1, 1]
  periodic: [x, y]
  fluid: b
  shapes: [{{sphere: {{centre: [0.5, 0.5], radius: {radius}}}, is: a}}]
particles: {{spacing: {dx}, support: 2.8, jitter: {jitter}}}
fluids: {{a: {{density: {rho}, viscosity: {mu}}}, b: {{density: 1, viscosity: 0.05}}}}
interface: {{tension: 1, method: {method}}}
time: {time}
"""


def drop(radius=0.3, dx=1 / 24, jitter=0.0, rho=1, mu=0.05, method="jump", time="{end: 0.3}"):
    return DROP.format(radius=radius, dx=dx, jitter=jitter, rho=rho, mu=mu, method=method, time=time)
