"""Images and cases of them."""

import numpy as np


def rock(shape=(5, 6, 7), porosity=0.6, seed=0):
    """Random labels, 0 fluid and -1 solid."""
    return np.where(np.random.default_rng(seed).random(shape) < porosity, 0, -1).astype(np.int8)


def read(tmp_path, scene):
    from isphcli.case.load import read_case

    text = f"""
geometry: {scene}
particles: {{spacing: 0.1}}
fluids: {{brine: {{density: 1000, viscosity: 1.0e-3}}, co2: {{density: 500, viscosity: 1.0e-4}}}}
drive: {{body_force: [0, 1, 0]}}
time: {{end: 1}}
"""
    return read_case(text.encode(), tmp_path / "case.yaml")
