"""Cases as text, and how tests read them."""

import pytest

from isphcli.case.blocks import Case
from isphcli.case.load import read_case
from isphcli.case.yaml import CaseError

BEADS = """\
title: CO2 in a brine-saturated bead pack
geometry:
  voxels: {file: beads.npz, labels: {solid: [1, 3], brine: 0, co2: 2}, voxel_size: 23e-6}
  periodic: [y]
particles: {spacing: 2.3e-5, lattice: bcc}
fluids:
  brine: {density: 1000, viscosity: 1.0e-3}
  co2: {density: 500, kinematic_viscosity: 2e-7}
interface: {tension: 0.03, contact_angle: 60}
drive: {body_force: [0, 4.9, 0]}
time: {end: 4.5e-3}
output: {directory: out/beadpack, every: 1.125e-3, fields: [velocity, pressure, phase]}
"""

SHAPES = """\
geometry:
  box: [1, 1]
  shapes:
    - {sphere: {centre: [0.5, 0.5], radius: 1e-1}, is: solid, velocity: [0, 1]}
    - sphere: {centre: [0.2, 0.2], radius: 0.1}
      is: oil
    - {half_space: {point: [0, 0.1], normal: [0, 1]}, is: solid}
    - {box: {lower: [0, 0], upper: [0.1, 0.1]}, is: solid, slip_length: 1e-3}
    - {spheres: {file: beads.csv}, outside: true, is: solid}
  periodic: [x]
  walls: {y_max: {velocity: [1, 0]}}
particles: {spacing: 0.05}
fluids:
  water: {density: 1, viscosity: 1}
  oil: {density: 1, viscosity: 10}
initial: {velocity: ["sin(2*pi*x)", 0]}
time: {steady: 1e-4}
drive: {pressure_drop: {x: 2}}
reference: {kind: couette, tolerance: 0.01, parameters: {wall_velocity: 1e0}}
"""

MINIMAL = """\
geometry: {box: [1, 1, 2], periodic: [x, y, z]}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
drive: {axes: [x, y, z]}
flow: stokes
refine: [0.08, 0.05]
"""


def read(text: str, *overrides: str) -> Case:
    return read_case(text.encode(), "case.yaml", overrides)


def problems(text: str, *overrides: str) -> list[str]:
    with pytest.raises(CaseError) as caught:
        read(text, *overrides)
    assert str(caught.value) == "\n".join(map(str, caught.value.problems))
    return [str(problem) for problem in caught.value.problems]
