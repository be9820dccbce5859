"""Counts that a run would find, the terms in use, and scenes that are too large to look at."""

import numpy as np
import pytest

from isphcli.preflight import check as module
from isphcli.preflight.check import check
from isphcli.scene import memory
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import lattice_at, place
from tests.preflight.cases import DROP, IMAGE, SLIT, SPHERE, read


def used(text: str, *overrides: str) -> set[str]:
    return {term.name for term in check(read(text, *overrides)).physics if term.used}


@pytest.mark.parametrize("text", [SLIT, SPHERE, IMAGE, DROP])
@pytest.mark.parametrize("lattice", ["first", "second"])
def test_particles_are_those_of_a_run(text, lattice):
    names = {"first": ("square", "cubic"), "second": ("hexagonal", "bcc")}[lattice]
    case = read(text, f"particles.lattice={names[text in (SPHERE, IMAGE)]}")
    geometry = build_geometry(case)
    particles = place(geometry, lattice_at(case, geometry, case.particles.spacing),
                      case.support * case.particles.spacing)
    found = check(case, geometry).particles
    assert found["fluid"] == particles.n_fluid
    assert found["dummy"] == particles.n_dummy
    assert found["left_out"] == particles.left_out


def test_terms_in_use():
    assert used(SLIT) == {"walls", "periodic halo", "viscosity", "drive"}
    assert used(SLIT, "geometry.slip_length=0.1") == {"walls", "slip", "periodic halo", "viscosity", "drive"}
    walls = used(SLIT, "geometry.walls={y_max: {velocity: [1, 0]}}")
    assert "moving walls" in walls
    assert {"surface tension", "contact angle", "fluid contrasts", "inertia", "shifting"} <= used(DROP)
    assert "shifting" not in used(DROP, "particles.shifting=0")
    open_box = used(DROP, "geometry.periodic=[x, y]")
    assert not {"walls", "contact angle"} & open_box


def test_every_term_says_why():
    assert all(term.why for text in (SLIT, SPHERE, IMAGE, DROP) for term in check(read(text)).physics)


def test_a_lattice_too_large_to_look_at_is_estimated_from_random_points(folder, monkeypatch):
    """10,000 points: the lattice is not looked at, memory and time are told all the same."""
    values = np.zeros((12, 12, 20), np.uint8)
    values[:, :6] = 1
    np.save("rock.npy", values)
    whole = check(read(IMAGE, "geometry.voxels.clear_layer=0", "geometry.periodic=[x]"))
    monkeypatch.setattr(module, "MOST_SITES", 1000)
    found = check(read(IMAGE, "geometry.voxels.clear_layer=0", "geometry.periodic=[x]"))
    assert found.can_run and found.throats is None and whole.throats is not None
    assert any("too many to look at each" in text for text in found.warnings)
    assert found.seconds is not None and "dummies not counted" in found.text()
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    assert "are free" in "".join(check(read(IMAGE, "geometry.periodic=[x]")).errors)


def test_what_surprises_in_the_inputs_is_warned_of(monkeypatch):
    geometry = build_geometry(read(SLIT))
    geometry.warnings = ("12 spheres lie outside the box",)
    assert "12 spheres lie outside the box" in check(read(SLIT), geometry).warnings
