"""Scenes that do not fit are refused before they are allocated."""

import pytest

from isphcli import memory
from isphcli.case import read_case
from isphcli.geometry import build_geometry
from isphcli.output import Clock
from isphcli.particles import ParticleError
from isphcli.run_stokes import build_scene

DISK = b"""
geometry: {box: [1, 1, 1], periodic: [x, y, z], shapes: [{sphere: {centre: [0.5, 0.5, 0.5], radius: 0.3}, is: solid}]}
particles: {spacing: 0.125}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
"""


def test_a_clear_layer_of_a_million_kilometres_is_refused(tmp_path):
    import numpy as np

    np.save(tmp_path / "image.npy", np.pad(np.zeros((2, 2, 2), np.uint8), 1, constant_values=1))
    text = f"""
geometry:
  voxels: {{file: {tmp_path}/image.npy, labels: {{solid: 1, water: 0}}, voxel_size: 1.0e-6, clear_layer: 1e9}}
particles: {{spacing: 1.0e-6}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
"""
    with pytest.raises(ParticleError, match=r"clear layers of \d+ voxels need about .* GB"):
        build_geometry(read_case(text.encode(), "case.yaml"))


def test_a_scene_is_refused_where_the_machine_is_full(monkeypatch):
    case = read_case(DISK, "case.yaml")
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    with pytest.raises(ParticleError, match=r"fluid particles need about .* GB of memory, 0.001 GB are free"):
        build_scene(case, build_geometry(case), 0.125, Clock())
    monkeypatch.setattr(memory, "available", lambda: None)  # a system that does not tell
    assert build_scene(case, build_geometry(case), 0.125, Clock()).particles.n_fluid > 100


def test_the_estimate_grows_with_the_scene():
    case = read_case(DISK, "case.yaml")
    small, large = (sum(memory.estimate(case, 3, True, n, 0).values()) - memory.BYTES_PROGRAM for n in (1e5, 1e6))
    assert large == pytest.approx(10 * small)
    assert 2400e6 < large < 3300e6  # measured: 2.5 to 2.9 kB a particle
