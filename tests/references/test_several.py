"""Comparisons on several processes, each with its own particles, are those of one with all of them."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.references.compare import compare
from tests.domain.several import on_threads
from tests.references.results import lattice, result_of, rows, the_case
from tests.references.test_single_phase import tubes
from tests.references.test_two_phase import DISK, oil_below, two_fluids

SPREAD = ("x", "velocity", "cell_velocity", "pressure", "phase")


def noise(x, seed=0):
    return np.random.default_rng(seed).normal(size=x.shape)


def duct():
    case, h = the_case("square_duct"), 5e-6
    across = np.arange(2e-5 + h / 2, 1e-4, h)
    x = np.stack(np.meshgrid(np.arange(h / 2, 4e-5, h), across, across, indexing="ij"), -1).reshape(-1, 3)
    return case, result_of(case, x, 1.0 + 0.1 * noise(x), spacing=h, permeability={"x": 1e-11})


def cavity():
    case = the_case("lid_driven_cavity")
    x, _ = lattice(case)
    return case, result_of(case, x, noise(x))


def oscillating_slit():
    case = the_case("oscillating_slit")
    x, _ = lattice(case)
    t = np.linspace(0, 0.2, 400)[1:]
    return case, result_of(case, x, 1e-3 * noise(x), time=t[-1],
                           history=rows(time=t, superficial_velocity_x=np.sin(100 * t)))


def flow_split():
    """The tubes lie along z and are cut across by some of the cuts, the wide one along it too."""
    case = the_case("two_tubes", "particles.spacing=1e-5")
    x = np.concatenate(tubes(case, h=1e-5))
    return case, result_of(case, x, 1.0 + 0.1 * noise(x))


def layers(kind, **more):
    case = two_fluids(kind, walls="walls: {y_max: {velocity: [2, 0]}}", **more)
    x, phase = oil_below(case)
    return case, result_of(case, x, noise(x), phase=phase, pressure=noise(x)[:, 0],
                           history=rows(time=np.linspace(0, 1, 50), amplitude=np.cos(np.linspace(0, 9, 50))))


def drop_on_wall():
    case = two_fluids("contact_angle", "{drop: oil}", shape=DISK % "oil")
    x, _ = lattice(case)
    inside = np.hypot(x[:, 0] - 0.5, x[:, 1]) < 0.2
    history = rows(volume_oil=inside.mean(), volume_brine=0.9, centre_y_oil=0.08, contact_angle=80.0)
    return case, result_of(case, x, phase=inside.astype(np.int8), history=history)


SCENES = {
    "duct": duct, "cavity": cavity, "oscillating slit": oscillating_slit, "flow split": flow_split,
    "drop on a wall": drop_on_wall,
    "couette": lambda: layers("two_layer_couette"),
    "poiseuille": lambda: layers("two_layer_poiseuille", drive="drive: {body_force: [1, 0]}"),
    "at rest": lambda: layers("two_layer_hydrostatics", drive="drive: {body_force: [0, -10]}"),
    "wave": lambda: layers("capillary_wave", parameters="{amplitude: 0.01}"),
}


@pytest.mark.parametrize("name", SCENES)
def test_errors_are_those_of_one_process(name):
    """To round-off of sums in another order; the last process has no particles."""
    case, whole = SCENES[name]()
    place = whole.x @ [0.9, 0.5, 0.7][: whole.x.shape[1]]
    owner = (place > np.quantile(place, 0.3)).astype(int) + (place > np.quantile(place, 0.6))

    def own(ranks):
        mine = owner == ranks.rank
        return compare(case, replace(whole, **{key: getattr(whole, key)[mine] for key in SPREAD}))

    expected = compare(case, whole)
    for found in on_threads(4, own):
        assert found.keys() == expected.keys() and found.pop("main") == expected["main"]
        assert found == pytest.approx({key: value for key, value in expected.items() if key != "main"}, rel=1e-9)
