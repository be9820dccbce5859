"""Cases that are checked."""

from isphcli.case.blocks import Case
from isphcli.case.load import read_case

SLIT = """\
geometry: {box: [1, 0.5], periodic: [x]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0]}
flow: stokes
"""
SPHERE = """\
geometry:
  box: [1, 1, 1]
  shapes: [{sphere: {centre: [0.5, 0.5, 0.5], radius: 0.4}, is: solid}]
  periodic: [x, y, z]
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
drive: {axes: [x, y, z]}
flow: stokes
"""
IMAGE = """\
geometry: {voxels: {file: rock.npy, labels: {solid: 1, water: 0}, voxel_size: 1e-5}}
particles: {spacing: 1e-5}
fluids: {water: {density: 1000, viscosity: 1e-3}}
drive: {body_force: [1, 0, 0]}
flow: stokes
"""
DROP = """\
geometry: {box: [1, 1], periodic: [x], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.2}, is: oil}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}, oil: {density: 3, viscosity: 2}}
interface: {tension: 2, contact_angle: 60}
time: {end: 1}
"""


def read(text: str, *overrides: str) -> Case:
    return read_case(text.encode(), "case.yaml", overrides)
