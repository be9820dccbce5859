"""Particles on their lattice: fluid, dummy or left out; disorder keeps them in their fluid; flooding."""

from dataclasses import replace

import numpy as np
import pytest

from isphcli.case.load import load_case, read_case
from isphcli.case.yaml import CaseError
from isphcli.domain.lattice import ParticleError, make_lattice
from isphcli.geometry.bodies import Disk, Shape
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import jittered, place, place_case
from tests.paths import CASES

FLOOD = """
geometry: {box: [1, 0.5], periodic: [y]}
particles: {spacing: 0.05}
fluids: {brine: {density: 1000, viscosity: 1}, co2: {density: 500, viscosity: 1}}
time: {end: 1}
"""


def particles_of(text, *overrides):
    case = read_case(text.encode(), "case.yaml", overrides)
    return case, place_case(case, build_geometry(case), case.particles.spacing)


@pytest.mark.parametrize("face, along", [("x_min", 1.0), ("x_max", -1.0), ("y_min", 1.0)])
def test_flooding_turns_the_layers_next_to_a_face(face, along):
    _, particles = particles_of(FLOOD, f"initial.flood={{fluid: co2, from: {face}, saturation: 0.3}}")
    depth = along * particles.x[: particles.n_fluid, "xyz".index(face[0])]
    flooded = particles.phase == 1
    assert flooded.mean() == pytest.approx(0.3, abs=1e-9)  # 6 of 20 layers, 3 of 10
    assert depth[flooded].max() < depth[~flooded].min()


def test_flooding_of_an_image_counts_the_sample():
    """The clear layer in front of the sample is flooded too, and is not counted."""
    case = load_case(CASES / "berea_drainage.yaml", ["geometry.voxels.crop=[[40, 60], [40, 60], [40, 60]]",
                                                     "initial.flood.saturation=0.25"])  # fmt: skip
    geometry = build_geometry(case)
    particles = place_case(case, geometry, case.particles.spacing)
    x = particles.x[: particles.n_fluid]
    sample = np.all((x >= geometry.sample_lower) & (x <= geometry.sample_upper), axis=1)
    assert (particles.phase[sample] == 1).mean() == pytest.approx(0.25, abs=0.05)  # whole layers of 1/20
    assert (particles.phase[x[:, 0] < geometry.sample_lower[0]] == 1).all()
    assert (particles.phase[x[:, 0] > geometry.sample_upper[0]] == 0).all()


def test_reservoirs_of_a_box_lie_at_its_ends():
    """Over what the shapes say, and the sample is what lies between them."""
    sets = ["geometry={box: [1, 0.5], periodic: [x, y], fluid: brine}",
            "reservoirs={axis: x, inlet: co2, outlet: brine, length: 0.2}",
            "geometry.shapes=[{box: {lower: [0.5, 0], upper: [1, 1]}, is: co2}]"]
    case, particles = particles_of(FLOOD, *sets)
    along, geometry = particles.x[: particles.n_fluid, 0], build_geometry(case)
    assert ((particles.phase == 1) == ((along < 0.2) | ((along > 0.5) & (along < 0.8)))).all()
    assert geometry.sample_lower.tolist() == [0.2, 0.0] and geometry.sample_upper.tolist() == [0.8, 0.5]


def test_reservoirs_of_an_image_lie_in_its_clear_layers():
    """Which all hold the first fluid without; an image is driven along their axis whatever else drives it."""
    case = load_case(CASES / "berea_drainage.yaml", [
        "geometry.voxels.crop=[[40, 60], [40, 60], [40, 60]]", "initial=null", "drive={body_force: [0, 0, -9.81]}",
        "reservoirs={axis: x, inlet: co2, outlet: brine}"])  # fmt: skip
    geometry = build_geometry(case)
    particles = place_case(case, geometry, case.particles.spacing)
    along = particles.x[: particles.n_fluid, 0]
    assert geometry.sample_lower[0] == pytest.approx(1.8e-5)
    assert ((particles.phase == 1) == (along < 1.8e-5)).all() and (along > geometry.sample_upper[0]).any()


@pytest.mark.parametrize("override, message", [
    ("initial.flood={fluid: oil, from: x_min, saturation: 0.3}", "'oil' is not a fluid of this case"),
    ("initial.flood={fluid: co2, from: z_min, saturation: 0.3}", "a 2D scene has no axis z"),
    ("initial.flood={fluid: co2, from: x_min, saturation: 30}", "initial.flood.saturation"),
    ("geometry.shapes=[{spheres: {random: 3}, is: co2}]", "spheres placed at random need one"),
    ("fluids.oil={density: 1, viscosity: 1}", "a scene has one or two"),
])  # fmt: skip
def test_what_cannot_be_is_refused(override, message):
    with pytest.raises(CaseError, match=message):
        particles_of(FLOOD, override)


SPACING, SUPPORT = 0.05, 0.125


def bed(radius=0.38, **options):
    """(geometry, its lattice): a large disk between two walls."""
    geometry = ShapeGeometry([0, 0], [1, 1], [True, False], shapes=[Shape(Disk([0.5, 0.5], radius))], **options)
    lattice = make_lattice("square", geometry.lower, geometry.upper, geometry.periodic, SPACING, SUPPORT)
    return geometry, lattice


def test_every_site_is_fluid_or_dummy_or_left_out():
    geometry, lattice = bed()
    particles = place(geometry, lattice, SUPPORT)
    x, n = particles.x, particles.n_fluid
    distance = geometry.distance(x)
    assert n + particles.n_dummy + particles.left_out == lattice.sites and particles.left_out > 0
    assert particles.sites == 20 * 20  # inside the box
    assert (distance[:n] > 0).all() and (geometry.phase(x[:n]) == particles.phase).all()
    # dummies: all solid sites that a particle on the wall could see, and no others
    assert (distance[n:] <= 0).all() and (distance[n:] >= -SUPPORT * (1 + 1e-9)).all()
    sites = np.concatenate(list(lattice.slabs()))
    deep = geometry.distance(sites) < -SUPPORT * (1 + 1e-9)
    assert deep.sum() == particles.left_out


def test_a_second_fluid_has_its_number():
    geometry = ShapeGeometry([0, 0], [1, 1], [True, True], shapes=[Shape(Disk([0.5, 0.5], 0.3), phase=1)])
    lattice = make_lattice("square", geometry.lower, geometry.upper, geometry.periodic, SPACING, SUPPORT)
    particles = place(geometry, lattice, SUPPORT)
    inside = np.linalg.norm(particles.x - 0.5, axis=1) < 0.3
    assert np.array_equal(particles.phase == 1, inside) and particles.n_dummy == 0


def test_disorder_keeps_particles_in_their_fluid():
    """No further than was asked along any axis, nobody in a wall, none lost; the same seed is the same disorder."""
    geometry, lattice = bed()
    at_rest = place(geometry, lattice, SUPPORT)
    moved, again, other = (place(geometry, lattice, SUPPORT, 0.4, SPACING, seed) for seed in (0, 0, 1))
    n = at_rest.n_fluid
    assert moved.n_fluid == n and np.array_equal(moved.phase, at_rest.phase)
    assert np.array_equal(moved.x[n:], at_rest.x[n:])  # dummies stay
    step = moved.x[:n] - at_rest.x[:n]
    step[:, 0] -= np.round(step[:, 0])
    assert np.abs(step).max() <= 0.4 * SPACING * (1 + 1e-9)
    assert (geometry.phase(moved.x[:n]) == moved.phase).all()
    # the few that would have ended in a solid stay where they were
    stayed = (step == 0).all(axis=1)
    assert 0 < stayed.sum() < 0.1 * n and geometry.distance(at_rest.x[:n])[stayed].max() < 0.6 * SPACING
    assert np.array_equal(moved.x, again.x) and not np.array_equal(moved.x, other.x)


def test_a_scene_without_fluid_is_refused():
    geometry, lattice = bed(radius=0.9)
    with pytest.raises(ParticleError, match="no fluid particle"):
        place(geometry, lattice, SUPPORT)


def test_disorder_does_not_depend_on_who_owns_a_particle():
    """A process that owns some particles of a scene moves them as one that owns all does, whatever their order; those
    that would end in the solid stay."""
    sphere = "shapes: [{sphere: {centre: [0.5, 0.25], radius: 0.213}, is: solid}], fluid: brine"
    text = FLOOD.replace("periodic: [y]", f"periodic: [y], {sphere}")
    case, calm = particles_of(text)
    disordered, moved = particles_of(text, "particles.jitter=0.3", "particles.seed=5")
    n = calm.n_fluid
    some = np.random.default_rng(2).permutation(n)[: n // 2]
    share = replace(calm, x=np.concatenate([calm.x[:n][some], calm.x[n:]]), phase=calm.phase[some])
    found = jittered(disordered, build_geometry(case), share, some, case.particles.spacing)
    assert np.array_equal(found.x, np.concatenate([moved.x[:n][some], moved.x[n:]]))
    assert 0 < (moved.x[:n] == calm.x[:n]).all(axis=1).sum() < n // 2
