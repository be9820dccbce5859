"""Pores that hardly hold particles: the pressure is solved, dead ends have none."""

import numpy as np
import pytest

from isphcli.case.load import load_case, read_case
from isphcli.domain.components import pair_components
from isphcli.flow.state import Handover
from isphcli.flow.step_limits import VOLUME
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.operators.moments import extremes_2d, extremes_3d
from isphcli.operators.narrow_pores import extrapolate_pressure
from isphcli.operators.wall_scene import WallScene
from isphcli.output.clock import Clock
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import place_case
from isphcli.scene.prepare import prepare
from tests import moving_ranks
from tests.paths import CASES

PACK = moving_ranks.PACK.replace("time: {end: 1}", "time: {end: 1, steady: 1.0e-3}")
ORIFICE = """
geometry: {box: [1, 1], periodic: [x], shapes: [BARS]}
particles: {spacing: 0.1}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [1, 0]}
time: {end: 1}
"""


@pytest.mark.slow
def test_beads_that_touch_let_the_pressure_be_solved():
    """A corner of the bead pack at 2.5 spacings a bead, two particles of three with a third of their neighbours: the
    solve stalled at a residual of 0.4. No particle may be faster than ten times free fall."""
    box = "[2.4e-3, 2.4e-3, 2.4e-3]"
    case = load_case(CASES / "bead_pack.yaml", [
        f"geometry.box={box}", "geometry.origin=[-1.2e-3, -1.2e-3, -1.2e-3]", "geometry.periodic=[]",
        "particles.spacing=2e-4", "flow=navier_stokes", "drive={body_force: [0, 1.06, 0]}", "time={end: 1}",
        "reference=null"])  # fmt: skip
    state, stepper, _ = prepare(case, build_geometry(case), Clock())
    config = stepper.configure(state.x, phi=state.phi)
    for _ in range(4):
        found = stepper.advance(state, Handover(config), 1.4e-4)
        state, config = found.state, found.config
        assert found.solves["pressure"].iterations < 40
        assert np.linalg.norm(state.u, axis=1).max() < 10 * 1.06 * state.time


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """(state, stepper, limits of its steps) of 111 beads of the pack at 2.4 spacings a bead, room above and below."""
    folder = tmp_path_factory.mktemp("pack")
    centres = np.loadtxt(CASES / "data/bead_centres.csv", delimiter=",", skiprows=1)
    inside = (np.abs(centres) < [1.25e-3, 1e-3, 1.25e-3]).all(axis=1)
    np.savetxt(folder / "beads.csv", centres[inside], delimiter=",", header="x_m,y_m,z_m", comments="")
    (folder / "case.yaml").write_text(PACK)
    case = load_case(folder / "case.yaml", [])
    state, stepper, particles = prepare(case, build_geometry(case), Clock())
    return state, stepper, TimeLoop(case, stepper, particles.site_volume, 1.0).limits


@pytest.mark.slow
def test_moving_particles_between_beads_that_touch(pack):
    """With fluxes in place of the adjoint, and pressure in every dead end, the 22nd step throws one out at 3 km/s."""
    state, stepper, limits = pack
    config, speeds = stepper.configure(state.x, phi=state.phi), []
    for _ in range(45):
        dt = min(limits(state).values())
        found = stepper.advance(state, Handover(config), dt)
        stepper.bounds.check(state, found)
        state, config = found.state, found.config
        speeds.append(stepper.bounds.speed(state.u, 1.0))
    assert np.ptp(speeds[-10:]) < 0.1 * speeds[-1]
    # no pressure is far from what the drive builds up along the scene
    assert np.ptp(state.p) < 1.06 * 2.8e-3


def test_few_neighbours_divergence_is_the_adjoint_of_the_gradient(pack):
    """sum V p div u = - sum V u . grad p for pressures of particles that see few, any velocities."""
    state, stepper, _ = pack
    ops, random = stepper.configure(state.x, phi=state.phi).ops, np.random.default_rng(3)
    narrow = ops.walls.narrow
    u, p = random.normal(size=state.u.shape), random.normal(size=len(narrow)) * narrow
    left = ops.volume * p * ops.total_divergence(u)
    right = (ops.volume[:, None] * u * ops.gradient_p(p)).sum(axis=1)
    assert narrow.sum() > 100 and not narrow.all()
    assert abs(left.sum() + right.sum()) < 1e-12 * np.abs(left).sum()


def test_dead_ends_share_no_pressure(pack):
    """Nothing but drag acts there, what is left of the fluid does not see their pressure, and they take on that of what
    they see; constants of the rest are found in every part that is left."""
    state, stepper, _ = pack
    config = stepper.configure(state.x, phi=state.phi)
    ops, isolated = config.ops, config.ops.walls.isolated
    p = np.random.default_rng(4).normal(size=len(isolated))
    u = np.random.default_rng(5).normal(size=state.u.shape)
    assert 0 < isolated.sum() < 0.1 * len(isolated)
    assert not ops.gradient_p(p * isolated).any() and not ops.gradient_p(p)[isolated].any()
    assert not config.terms.force[isolated].any() and not ops.total_divergence(u)[isolated].any()
    assert (config.means.count[config.means.labels[isolated]] == 1).all()
    seen = np.diff(ops.start) > 0
    level = np.where(isolated, 0.0, 7.0)
    for _ in range(20):
        extrapolate_pressure(ops, level)
    joined = pair_components(ops.start, ops.column)[1]
    wet = np.isin(joined, joined[~isolated])
    np.testing.assert_allclose(level[wet & seen], 7.0, atol=0.1)


SPOT = """
geometry: {box: [12, 12, 12], periodic: [x, y, z]}
particles: {spacing: 1, offset: [0.5, 0.5, 0.5], support: SUPPORT}
fluids: {water: {density: 1, viscosity: 1}}
drive: {body_force: [0, 0, 1.0e-3]}
time: {end: 100}
"""


@pytest.mark.parametrize("support, neighbours", [(1.5, 0), (2.1, 2)])
def test_a_particle_that_sees_nobody_rests(support, neighbours):
    """Beside a slit a field of grey values rises above zero between eight centres that are solid, over less than a
    voxel. The distances of the sites round about, taken from those centres, reach past the spot: it lacks all dummies
    or most. Without neighbours its Laplacian vanished; with two its volume would be 2.8 sites."""
    field = np.full((12, 12, 12), -0.3, np.float32)
    field[7:9, 7:9, 7:9], field[:, :, :4] = -0.02, 1.0
    geometry = IsoSurfaceGeometry(np.where(field > 0, 0, -1).astype(np.int8), ImageField(field), 1.0, (True,) * 3)
    case = read_case(SPOT.replace("SUPPORT", str(support)).encode(), "case.yaml")
    state, stepper, _ = prepare(case, geometry, Clock())
    alone = np.flatnonzero(np.abs(state.x - 8.0).max(axis=1) < 0.1)
    config = stepper.configure(state.x)
    assert len(alone) == 1 and np.diff(config.neighbours.start)[alone] == neighbours
    assert config.ops.walls.isolated.sum() == 1 and (config.ops.volume[alone] > VOLUME[1]) == (neighbours > 0)
    for _ in range(3):
        found = stepper.advance(state, Handover(config), 0.1)
        stepper.bounds.check(state, found)
        state, config = found.state, found.config
    assert not state.u[alone].any() and state.u[:, 2].max() > 0.0
    scene = build_scene(case, geometry, 1.0, Clock())
    flow = solve_axis(case, scene, 2, np.array([0.0, 0.0, 1e-3]), Clock())
    assert not flow.velocity[alone].any() and flow.velocity[:, 2].max() > 1e-3


@pytest.mark.parametrize("name", ["sphere_array", "slit", "lid_driven_cavity", "orifice"])
def test_wide_pores_see_enough(name):
    """Flat and curved walls, an orifice two particles wide: the rules of narrow pores touch the corners alone, where
    the walls of a scene meet or a bar meets one."""
    if name == "orifice":
        sides = ((0, 0.4), (0.6, 1))
        bars = ", ".join(f"{{box: {{lower: [0.4, {a}], upper: [0.6, {b}]}}, is: solid}}" for a, b in sides)
        case = read_case(ORIFICE.replace("BARS", bars).encode(), "case.yaml")
    else:
        case = load_case(CASES / f"{name}.yaml", [])
    geometry = build_geometry(case)
    particles = place_case(case, geometry, case.particles.spacing)
    x = particles.x
    fluid = geometry.phase(x) >= 0
    scene = WallScene(geometry, x[~fluid], case.support * case.particles.spacing, 0, particles.site_volume)
    walls = scene.configure(x[fluid])[0].walls
    corners = 4 if name in ("lid_driven_cavity", "orifice") else 0
    assert walls.near_wall.any() and walls.narrow.sum() == corners and not walls.dead_ends


@pytest.mark.parametrize("dim", [2, 3])
def test_smallest_and_largest_share_are_eigenvalues(dim):
    """Of tensors with one, two and three directions, to round-off of the largest: the angle of the closed form has half
    the digits where two eigenvalues meet, but the eigenvalues do not."""
    random = np.random.default_rng(6)
    for directions in (1, 2, 3, 10):
        for _ in range(20):
            d = random.normal(size=(directions, dim))
            tensor = d.T @ d
            if dim == 2:
                found = extremes_2d(tensor[0, 0], tensor[1, 1], tensor[0, 1])
            else:
                found = extremes_3d(*np.diag(tensor), tensor[1, 2], tensor[0, 2], tensor[0, 1])
            expected = np.linalg.eigvalsh(tensor)[[0, -1]]
            assert found == pytest.approx(expected, abs=1e-7 * expected[1])
