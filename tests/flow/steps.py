"""A vortex and its first step."""

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

VORTEX = """
geometry: {box: [1, 1], periodic: [x, y]}
particles: {spacing: 0.1, jitter: 0.1}
fluids: {water: {density: 1, viscosity: 0.1}}
initial: {velocity: ["sin(2*pi*x)*cos(2*pi*y)", "-cos(2*pi*x)*sin(2*pi*y)"]}
time: {end: 0.1}
"""


def scene(text):
    """(stepper, state, configuration) of a case at its start."""
    case = read_case(text.encode(), "case.yaml")
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    return stepper, state, stepper.configure(state.x, phi=state.phi)
