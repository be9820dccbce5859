"""Limits, numbers and costs that are known exactly or by how they grow."""

import numpy as np
import pytest

from isphcli.preflight.check import check
from tests.preflight.cases import DROP, SLIT, SPHERE, read


def test_neighbours_of_a_lattice():
    assert check(read(SPHERE)).neighbours == pytest.approx(32, abs=0.5)
    assert check(read(SLIT)).neighbours == pytest.approx(12, abs=0.5)
    bcc = check(read(SPHERE, "particles.lattice=bcc", "particles.support=3"))
    assert bcc.neighbours == pytest.approx(2 * 32 * (3 / 2.1) ** 3, rel=0.02)


def test_flow_and_steps_of_a_slit():
    report = check(read(SLIT, "flow=navier_stokes", "time={end: 1}"))
    assert report.flow.velocity == pytest.approx(0.5**2 / 8, rel=0.2)
    assert report.flow.reynolds == pytest.approx(report.flow.velocity * 0.5, rel=0.2)
    assert report.steps.limits["viscous accuracy"] == pytest.approx(0.0625**2)
    assert report.steps.limits["cfl"] == pytest.approx(0.2 * 0.0625 / report.flow.velocity)
    assert report.steps.count == pytest.approx(1 / report.steps.limits["cfl"])
    fixed = check(read(SLIT, "flow=navier_stokes", "time={end: 1, step: 0.01}"))
    assert fixed.steps.count == pytest.approx(100)


def test_capillary_limit_and_number():
    report = check(read(DROP))
    assert report.steps.limits["capillary"] == pytest.approx(np.sqrt(2 * 0.0625**3 / (2 * np.pi * 2)))
    assert report.flow.capillary == pytest.approx(2 * report.flow.velocity / 2)


def test_initial_velocity():
    box = ("geometry.periodic=[x, y]", "drive=null", "flow=navier_stokes", "time={end: 1}")
    report = check(read(SLIT, *box, "initial={velocity: ['3*cos(0*x)', 0]}"))
    assert report.flow.velocity == pytest.approx(3) and report.flow.source == "initial velocity"
    assert report.throats is None


def test_costs_grow_with_the_particles():
    coarse, fine = (
        check(read(SPHERE, "particles.spacing=0.05")),
        check(read(SPHERE, "particles.spacing=0.025")),
    )
    grown = fine.particles["fluid"] / coarse.particles["fluid"]
    assert fine.seconds / coarse.seconds == pytest.approx(grown)
    # finer particles see less of the sphere
    assert grown < fine.memory["operators"] / coarse.memory["operators"] < 1.2 * grown
    one = check(read(SPHERE, "particles.spacing=0.05", "drive={axes: [x]}"))
    assert coarse.seconds == pytest.approx(3 * one.seconds)
    refined = check(read(SPHERE, "particles.spacing=0.05", "refine=[0.025]"))
    assert 8.0 < refined.memory["operators"] / coarse.memory["operators"] < 8.0 * 1.2
    assert refined.seconds == pytest.approx(9 * coarse.seconds)
