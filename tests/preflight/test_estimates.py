"""Limits, numbers and costs that are known exactly or by how they grow."""

import numpy as np
import pytest

from isphcli.preflight.check import check
from isphcli.preflight.estimates import BYTES_PICTURES, FROM_LABELS, HELD, SECONDS_KERNELS, SECONDS_RUN
from tests.preflight.cases import DROP, SLIT, SPHERE, read


def test_neighbours_of_a_lattice():
    assert check(read(SPHERE)).neighbours == pytest.approx(32, abs=0.5)
    assert check(read(SLIT)).neighbours == pytest.approx(12, abs=0.5)
    bcc = check(read(SPHERE, "particles.lattice=bcc", "particles.support=3"))
    assert bcc.neighbours == pytest.approx(2 * 32 * (3 / 2.1) ** 3, rel=0.02)


def test_flow_and_steps_of_a_slit():
    found = check(read(SLIT, "flow=navier_stokes", "time={end: 1}"))
    assert found.flow.velocity == pytest.approx(0.5**2 / 8, rel=0.2)
    assert found.flow.reynolds == pytest.approx(found.flow.velocity * 0.5, rel=0.2)
    assert found.steps.limits["viscous"] == pytest.approx(8 * 0.0625**2)
    assert found.steps.limits["cfl"] == pytest.approx(0.2 * 0.0625 / found.flow.velocity)


def test_capillary_limit_and_number():
    found = check(read(DROP))
    assert found.steps.limits["capillary"] == pytest.approx(np.sqrt(2 * 0.0625**3 / (2 * np.pi * 2)))
    assert found.flow.capillary == pytest.approx(2 * found.flow.velocity / 2)


def test_initial_velocity():
    box = ("geometry.periodic=[x, y]", "drive=null", "flow=navier_stokes", "time={end: 1}")
    found = check(read(SLIT, *box, "initial={velocity: ['3*cos(0*x)', 0]}"))
    assert found.flow.velocity == pytest.approx(3) and found.flow.source == "initial velocity"
    assert found.throats is None


@pytest.mark.slow
def test_costs_grow_with_the_particles():
    coarse, fine = (
        check(read(SPHERE, "particles.spacing=0.05")),
        check(read(SPHERE, "particles.spacing=0.025")),
    )
    grown = fine.particles["fluid"] / coarse.particles["fluid"]
    # finer particles see less of the sphere
    assert grown < fine.memory["operators"] / coarse.memory["operators"] < 1.2 * grown
    one, refined = (check(read(SPHERE, "particles.spacing=0.05", more))
                    for more in ("drive={axes: [x]}", "refine=[0.025]"))
    assert one.seconds < coarse.seconds < 3 * one.seconds  # the axes share what is made once
    assert 8.0 < refined.memory["operators"] / coarse.memory["operators"] < 8.0 * 1.2
    # eight times the particles, in pores that are twice as wide in them: fewer iterations
    assert 6.0 < (refined.seconds - SECONDS_RUN) / (coarse.seconds - SECONDS_RUN) < 9.0


def test_refine_auto_is_told_by_the_spacings_that_it_is_expected_to_take():
    """1.5 and 2 times finer ones, or where their seconds are more than the budget coarser ones."""
    of = ("particles.spacing=0.05", "drive={axes: [x]}")
    one, both = check(read(SPHERE, *of)), check(read(SPHERE, *of, "refine=auto"))
    seconds = one.seconds - SECONDS_RUN
    assert both.spacings == pytest.approx([0.05, 0.05 / 1.5, 0.025])
    assert 10.0 < (both.seconds - SECONDS_RUN) / seconds < 1 + 1.5**3 + 8  # wider pores take fewer iterations
    assert "refine      auto: spacings 0.05, 0.03333, 0.025 m" in both.text()
    poor = check(read(SPHERE, *of, "refine=auto", f"refine_budget={2 * seconds}"))
    assert poor.spacings == pytest.approx([0.05, 0.075, 0.1]) and poor.seconds < both.seconds / 4


def test_half_the_spacing_in_throats_is_a_second_solve_of_every_axis():
    """Of shapes with eight times the particles, 5 kB each, and matrices that every axis makes anew."""
    of = ("particles.spacing=0.05", "drive={axes: [x]}"), ("particles.spacing=0.05", "refine=throats")
    plain, throats, along = (check(read(SPHERE, *more)) for more in (of[0], of[1], of[0] + of[1]))
    more = sum(along.memory.values()) - sum(plain.memory.values())
    assert more == pytest.approx(8 * 5000 * plain.particles["fluid"])
    assert along.seconds - plain.seconds == pytest.approx(8 * (plain.seconds - SECONDS_RUN))
    assert throats.second.seconds == pytest.approx(3 * along.second.seconds)
    assert "throats: a second solve, of about" in throats.text() and "refine  " not in plain.text()


def test_narrow_pores_cost_more_iterations():
    slits = (f"geometry={{box: [1, {width}, 1], periodic: [x, z]}}" for width in (0.2, 1))
    narrow, wide = (check(read(SPHERE, slit, "drive={axes: [x]}", "particles.spacing=0.05")) for slit in slits)
    assert narrow.throats.median == pytest.approx(4) and wide.throats.median == pytest.approx(20)
    assert narrow.seconds / narrow.particles["fluid"] > 1.2 * wide.seconds / wide.particles["fluid"]


def test_two_fluids_and_walls_cost_more_a_step():
    box = ("time={end: 1, step: 0.01}", "particles.support=2.5")
    alone = ("geometry.shapes=[]", "interface=null", "fluids={water: {density: 1, viscosity: 1}}")
    drop, plain = check(read(DROP, *box)), check(read(DROP, *box, *alone))
    free = check(read(DROP, *box, *alone, "geometry.periodic=[x, y]"))
    assert drop.steps.count == plain.steps.count
    assert drop.seconds > plain.seconds
    assert plain.seconds / plain.steps.count > free.seconds / free.steps.count


def test_a_bubble_between_walls_does_not_fall_with_the_box():
    """Only the difference of the densities moves it, over its own size; one fluid in a closed box rests."""
    closed = ("geometry.periodic=[]", "drive={body_force: [0, -2]}", "fluids.water.viscosity=0.01")
    found = check(read(DROP, *closed, "interface=null", "fluids.oil={density: 3, viscosity: 0.02}"))
    assert found.flow.velocity == pytest.approx(np.sqrt(2 * 2 * (3 - 1) / (3 + 1) * 0.5 * 0.2), rel=0.1)
    rests = check(read(DROP, *closed, "interface=null", "fluids.oil={density: 1, viscosity: 0.02}"))
    assert rests.flow is None or rests.flow.velocity == 0.0


def test_a_drive_that_changes_moves_by_what_it_pushes_over_its_time():
    found = check(read(SLIT, "flow=navier_stokes", "time={end: 1}", "drive={body_force: ['0.5*cos(100*t)', 0]}"))
    assert found.flow.velocity == pytest.approx(0.5 / 100, rel=0.05) and "over its time" in found.flow.source


def test_a_drop_comes_to_rest():
    """From sqrt(sigma / rho R), with the time of the second mode of a drop, R^2 / 5 nu."""
    motion = check(read(DROP, "geometry.periodic=[x, y]")).flow.motion
    assert motion.start == pytest.approx(np.sqrt(2 / 0.2), rel=0.15)
    assert motion.decay == pytest.approx(0.2**2 / (5 * (1 + 2 / 3) / 2), rel=0.25)


def test_pictures_need_memory():
    drawn, plain = (sum(check(read(SLIT, f"output.plots={plots}")).memory.values()) for plots in ("true", "false"))
    assert drawn - plain == pytest.approx(BYTES_PICTURES[False])
    assert check(read(SPHERE)).memory["pictures"] > check(read(SLIT)).memory["pictures"]


@pytest.mark.parametrize("what", ["initial: {flood: {fluid: bubble, from: y_min, saturation: 0.2}}", ""])
def test_a_fluid_that_has_no_sites_yet_falls_over_the_box(what):
    """One that floods the scene; one that is absent moves nothing."""
    found = check(read(f"""
geometry: {{box: [1, 2], fluid: liquid}}
particles: {{spacing: 0.1}}
fluids: {{bubble: {{density: 100, viscosity: 1}}, liquid: {{density: 1000, viscosity: 10}}}}
interface: {{tension: 24.5}}
{what}
drive: {{body_force: [0, -0.98]}}
time: {{end: 0.1}}
"""))
    fastest = 0.98 * 900 / 1100 * 0.1 if what else 0.0  # at the end, with 900 / 1100 of g
    assert found.flow.motion.driven == pytest.approx(fastest)


def test_what_two_fluids_take_before_their_second_step():
    """The first distances, where a flood says which fluid is where, and the passes of a first step whose flux is held:
    as many steps more, however many follow."""
    flood = ("geometry.shapes=[]", "initial={flood: {fluid: oil, from: x_min, saturation: 0.3}}")
    drives = "drive={pressure_drop: {x: 1}}", "drive={superficial_velocity: {x: 0.1}}"
    seconds = np.array([[check(read(DROP, *flood, drive, f"time.max_steps={n}")).seconds for n in (1, 3)]
                        for drive in drives])
    step = (seconds[:, 1] - seconds[:, 0]) / 2
    assert step[1] == pytest.approx(step[0])
    once = seconds[:, 0] - step - SECONDS_RUN - SECONDS_KERNELS
    assert once / step == pytest.approx([FROM_LABELS, FROM_LABELS + HELD])
    one, three = (check(read(DROP, f"time.max_steps={n}")).seconds for n in (1, 3))
    assert one - (three - one) / 2 == pytest.approx(SECONDS_RUN + SECONDS_KERNELS)
