"""A case from its text to its end."""

import numpy as np

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare


def run(text, measured=None):
    """(state, configuration, stepper, rows) at the end of a case; rows hold what measured(geometry, state) gives."""
    case = read_case(text.encode(), "case.yaml")
    geometry = build_geometry(case)
    state, stepper, particles = prepare(case, geometry, Clock())
    measure = (lambda state, _: measured(geometry, state)) if measured is not None else lambda *_: {}
    box = float(np.prod(geometry.upper - geometry.lower))
    loop = TimeLoop(case, stepper, particles.site_volume, box, measure)
    rows = []
    nothing = lambda *_: None  # noqa: E731
    state, config = loop.run(state, stepper.ready(state), nothing, rows.append, nothing)
    return state, config, stepper, rows
