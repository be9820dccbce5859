"""Steady creeping flow: exact channels, published drags, conservation, symmetry, units, throats, pockets."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.geometry.bodies import Shape, Sphere, Spheres
from isphcli.geometry.iso_surface import IsoSurfaceGeometry
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.output.clock import Clock
from isphcli.runs.flow_measures import speed_distribution
from isphcli.runs.steady import NoFlowError, build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from tests.paths import CASES

CHANNEL = """
geometry:
  box: [{w}, {h}]
  periodic: [x, y]
  shapes:
    - {{half_space: {{point: [0, {low}], normal: [0, 1]}}, is: solid}}
    - {{half_space: {{point: [0, {high}], normal: [0, -1]}}, is: solid{lid}}}
particles: {{spacing: {dx}}}
fluids: {{water: {{density: {rho}, kinematic_viscosity: {nu}}}}}
flow: stokes
{drive}
solver: {{tolerance: 1.0e-11}}
"""


def solve(text, axis=0, force=None, **more):
    case = read_case(text.encode(), "case.yaml")
    geometry = build_geometry(case)
    scene = build_scene(case, geometry, case.particles.spacing, Clock(), **more)
    force = np.eye(geometry.dim)[0] if force is None else force
    return scene, solve_axis(case, scene, axis, force, Clock())


def channel(offset, n=16, scale=1.0, lid="", drive="drive: {axes: [x]}"):
    """Unit channel, n spacings high, its walls `offset` spacings off the lattice."""
    dx = scale / n
    return CHANNEL.format(w=4 * dx, h=scale + 6 * dx, low=(2 + offset) * dx, high=(2 + offset) * dx + scale, dx=dx,
                          rho=1000.0, nu=1e-6, lid=lid, drive=drive)


def spheres(n, fraction=0.216, offset=None):
    """Permeability / L^2 of a simple-cubic array over its published value, less one; and the scene."""
    radius = (3 * fraction / (4 * np.pi)) ** (1 / 3)
    text = f"""
geometry:
  box: [1, 1, 1]
  periodic: [x, y, z]
  shapes: [{{sphere: {{centre: [0.5, 0.5, 0.5], radius: {radius}}}, is: solid}}]
particles: {{spacing: {1 / n}{', offset: ' + str(offset) if offset else ''}}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
"""
    scene, flow = solve(text)
    return flow.permeability[0] * 6 * np.pi * radius * {0.216: 7.442, 0.45: 28.1}[fraction] - 1, scene, flow


@pytest.mark.parametrize("offset", [0.0, 0.3, 0.45, -0.3])
def test_poiseuille_and_couette_are_exact_wherever_the_wall_is(offset):
    """Quadratic and linear profiles are reproduced to round-off (the solver stops at 1e-11)."""
    text = channel(offset)
    scene, flow = solve(text)
    y = (scene.particles.x[: scene.particles.n_fluid, 1] * 16 - 2 - offset) / 16
    exact = 0.5 * y * (1 - y) / 1e-6
    assert np.abs(flow.velocity[:, 0] - exact).max() < 1e-9 * exact.max()
    assert np.abs(flow.velocity[:, 1]).max() < 1e-9 * exact.max()
    scene, flow = solve(channel(offset, lid=", velocity: [2.0, 0]", drive=""), None, np.zeros(2))
    assert np.abs(flow.velocity[:, 0] - 2 * y).max() < 1e-10


def test_sphere_array_against_zick_and_homsy():
    """1 % at 24 spacings a cell is asked (issue 2); measured +0.03 %, and +0.2 % at 0.45. The tables have four and
    three digits."""
    error, _, flow = spheres(24)
    assert abs(error) < 1e-3
    # a cube looks the same along every axis: no flow across the drive
    assert np.abs(flow.permeability[1:]).max() < 1e-5 * flow.permeability[0]
    assert abs(spheres(24, 0.45)[0]) < 4e-3


@pytest.mark.slow
def test_sphere_array_converges():
    """Order of the permeability error over 8 to 32 spacings at fraction 0.216, by the largest of three lattices each,
    because errors have both signs: 1.5 is asked, 2.0 measured (0.56, 0.10 and 0.06 %)."""
    n = np.array([(8, 10, 12), (18, 20, 22), (28, 30, 32)])
    errors = [max(abs(spheres(k)[0]) for k in lattices) for lattices in n]
    assert -np.polyfit(np.log(n.mean(axis=1)), np.log(errors), 1)[0] > 1.5


def test_iterations_do_not_grow():
    """Within 20 % from 12 to 24 spacings a cell (benchmarks/iterations.py goes on to 64)."""
    counts = [spheres(k)[2].convergence.iterations for k in (12, 24)]
    assert counts[1] <= 1.2 * counts[0] + 1


def test_a_box_that_stretches_the_lattice_is_no_harder():
    """By +2.1 % along x and -2.1 % along y, as a pack whose box is no multiple of the spacing, and by 3.5 % along both:
    as many iterations, one more or less."""
    text = ("geometry: {box: [%r, %r, 0.72], periodic: [x, y, z], shapes: [{sphere: {centre: [0.3, 0.3, 0.3], "
            "radius: 0.22}, is: solid}]}\nparticles: {spacing: 0.06}\n"
            "fluids: {water: {density: 1, viscosity: 1}}\nflow: stokes\n")
    even, *stretched = (solve(text % (0.72 * (1 + x), 0.72 * (1 + y)))[1].convergence.iterations
                        for x, y in ((0.0, 0.0), (0.021, -0.021), (0.035, 0.035)))
    assert stretched == pytest.approx([even] * 2, abs=1)


def test_flux_is_conserved_between_planes():
    """The divergence is consistent, not a balance: 0.06 % measured. The sum over a layer is not the flux to the last
    digit either, the stencil is two layers wide."""
    _, _, flow = spheres(24)
    assert flow.mass_error < 0.002


def test_mean_speed_is_an_integral_where_walls_cut_cells():
    """Over the mean velocity, on 8 spacings a cell of the sphere array as on 24: 1.0115 and 1.0116. Over the particles,
    which count alike however much of their cells is fluid, it is 1.064 and 1.014."""
    means, alone = [], []
    for flow in (spheres(8)[2], spheres(24)[2]):
        cells, whole = flow.all_cells[1], np.linalg.norm(flow.mean)
        fluid = flow.cell_velocity, np.ones(flow.particles.n_fluid)
        means.append(speed_distribution(*fluid, (cells, np.ones(len(cells)), flow.cells))["mean"] / whole)
        alone.append(speed_distribution(*fluid)["mean"] / whole)
    assert means[0] == pytest.approx(means[1], rel=1e-3)
    assert alone[0] > 1.03 * means[0]


def test_beads_that_touch_against_zick_and_homsy():
    """Body-centred cubic array of touching spheres, 24 spacings a cell: drag 162.9 (four digits). Measured +0.4 %,
    -0.2 % at 32; 14 iterations."""
    radius = 3**0.5 / 4
    text = f"""
geometry:
  box: [1, 1, 1]
  periodic: [x, y, z]
  shapes:
    - {{sphere: {{centre: [0, 0, 0], radius: {radius}}}, is: solid}}
    - {{sphere: {{centre: [0.5, 0.5, 0.5], radius: {radius}}}, is: solid}}
particles: {{spacing: {1 / 24}}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
"""
    scene, flow = solve(text)
    assert flow.permeability[0] * 2 * 6 * np.pi * radius * 162.9 == pytest.approx(1.0, abs=0.01)
    assert 0 < flow.narrow < 0.1 * scene.particles.n_fluid
    assert flow.convergence.iterations < 40


@pytest.mark.slow
def test_permeability_of_a_random_pack_of_beads_converges():
    """31 beads of the pack of the paper, periodic, at 6, 8 and 10 spacings a bead: k 2.241, 2.242, 2.252e-3 bead^2
    (12: 2.258), flux between layers within 2.4, 1.5 and 0.9 %, 22 to 25 iterations. With the balance of
    fluxes it was 2.206, 2.180, 2.184 (2.192, 2.212) and 3.2, 2.2, 1.6 %."""
    centres = np.loadtxt(CASES / "data/bead_centres.csv", delimiter=",", skiprows=1) / 5e-4
    centres = centres[(np.abs(centres) < 1.5).all(axis=1)]
    geometry = ShapeGeometry([-1.5] * 3, [1.5] * 3, [True] * 3, shapes=[Shape(Spheres(centres, 0.5))])
    case = read_case(b"geometry: {box: [3, 3, 3], periodic: [x, y, z]}\nparticles: {spacing: 0.1}\n"
                     b"fluids: {water: {density: 1, viscosity: 1}}\nflow: stokes\n", "c.yaml")
    flows = [solve_axis(case, build_scene(case, geometry, 1 / n, Clock()), 1, np.eye(3)[1], Clock())
             for n in (6, 8, 10)]
    k = np.array([flow.permeability[1] for flow in flows])
    assert (np.abs(k / 2.264e-3 - 1.0) < [0.012, 0.010, 0.007]).all()
    assert (np.array([flow.mass_error for flow in flows]) < [0.03, 0.02, 0.015]).all()
    assert max(flow.convergence.iterations for flow in flows) < 50


def test_units_do_not_matter():
    """The channel in metres and scaled by 2^-20, and by 1e-6: the same numbers after scaling."""
    a = solve(channel(0.3))[1].velocity
    b = solve(channel(0.3, scale=2.0**-20))[1].velocity * 2.0**40
    c = solve(channel(0.3, scale=1e-6))[1].velocity * 1e12
    assert np.abs(a - b).max() <= 1e-12 * np.abs(a).max()
    assert np.abs(a - c).max() <= 1e-9 * np.abs(a).max()


def image_flow(labels, axis=0, periodic=("x",), spacing=1.0, distance="smooth"):
    around = [name in periodic for name in "xyz"]
    if distance == "stairs":
        geometry = VoxelGeometry(labels, 1.0, around)
    else:
        geometry = IsoSurfaceGeometry(labels, None, 1.0, around)
    text = f"""
geometry: {{box: [1, 1, 1]}}
particles: {{spacing: {spacing}}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
solver: {{tolerance: 1.0e-9}}
"""
    case = read_case(text.replace("spacing: 1.0}", "spacing: 0.5}").encode(), "case.yaml")
    scene = build_scene(case, geometry, spacing, Clock())
    return scene, solve_axis(case, scene, axis, np.eye(3)[axis], Clock())


@pytest.mark.parametrize("width", [1, 2, 3, 5])
def test_slit_of_any_number_of_voxels_has_its_exact_flux(width):
    """k = w^3 / (12 h): also one voxel wide, where the point values alone give 50 % too much."""
    labels = np.full((6, width + 3, 6), -1, np.int8)
    labels[:, 1 : 1 + width] = 0
    _, flow = image_flow(labels, periodic="xyz", distance="stairs")
    assert flow.permeability[0] == pytest.approx(width**3 / 12 / (width + 3), rel=1e-7)


def test_square_duct_on_voxels():
    """Q mu / (G a^4) = 0.56230806 (White); 0.1 % at 8 voxels across. The smooth body of these labels has round corners
    and the same area, and a round duct lets more through: up to 7 %."""
    labels = np.full((12, 12, 4), -1, np.int8)
    labels[2:10, 2:10] = 0
    _, flow = image_flow(labels, distance="stairs")
    assert flow.superficial[0] * 144 == pytest.approx(0.56230806 * 4**4, rel=1e-3)
    _, flow = image_flow(labels)
    assert flow.superficial[0] * 144 == pytest.approx(0.56230806 * 4**4, rel=0.07)


@pytest.mark.parametrize(("distance", "open"), [("stairs", True), ("smooth", False)])
def test_one_voxel_throat_isolated_pocket_and_dead_end_are_finite(distance, open):
    """The smooth body of these labels has no throat: there nothing flows, to the tolerance of the solve."""
    labels = np.full((12, 12, 12), -1, np.int8)
    labels[3:9, 3:9, :] = 0
    labels[:, :, 5:7] = -1
    labels[5, 5, 5:7] = 0  # a throat of one voxel
    labels[0, 0, 0] = 0  # a pocket of one
    labels[11, 0:2, 4:6] = 0  # and of four
    labels[9:11, 5, 2] = 0  # a dead end
    scene, flow = image_flow(labels, distance=distance)
    assert scene.system.count == 3  # the only particle of the pocket of one voxel sees nobody, or a dummy or two
    assert np.isfinite(flow.velocity).all() and np.isfinite(flow.pressure).all()
    assert flow.permeability[0] > 1e-4 if open else abs(flow.permeability[0]) < 1e-9
    pocket = scene.system.means.labels != np.argmax(np.bincount(scene.system.means.labels))
    # of nothing that flows the residual is left: the solve stops at 1e-9 of forces of one
    assert np.abs(flow.velocity[pocket]).max() < max(1e-6 * np.abs(flow.velocity).max(), 3e-9)


def test_an_oblique_drive_sees_the_same_disk():
    """The square array of disks is isotropic: k along any direction is that along x."""
    text = """
geometry: {box: [1, 1], periodic: [x, y], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.3}, is: solid}]}
particles: {spacing: 0.0625}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
"""
    straight = solve(text)[1].permeability
    oblique = solve(text, force=np.array([3.0, -2.0]))[1].permeability
    assert oblique[0] == pytest.approx(straight[0], rel=1e-4)


@pytest.mark.parametrize("offset", [[0.0, 0.7, 0.0], [2.0, -2.0, 0.3]])
def test_an_offset_lattice_stays_in_the_box(offset):
    """No particle is lost: k moves by what a lattice moves it, 1 % at 16 spacings a cell."""
    assert abs(spheres(16, offset=offset)[0]) < 0.02


def test_without_walls_there_is_no_steady_flow():
    with pytest.raises(NoFlowError, match="no wall holds the flow"):
        solve("geometry: {box: [1, 1], periodic: [x, y]}\nparticles: {spacing: 0.1}\n"
              "fluids: {water: {density: 1, viscosity: 1}}\nflow: stokes\n")


def test_no_path_is_refused():
    text = """
geometry: {box: [1, 1], periodic: [x, y], shapes: [{box: {lower: [0.4, 0], upper: [0.6, 1]}, is: solid}]}
particles: {spacing: 0.05}
fluids: {water: {density: 1, viscosity: 1}}
flow: stokes
"""
    with pytest.raises(NoFlowError, match="along x"):
        solve(text, needs=(0,))
    solve(text, axis=1, force=np.array([0.0, 1.0]), needs=(1,))


def test_a_body_that_overlaps_the_faces_is_the_same_wherever_the_cell_is_cut():
    """A third of a cell along every axis: the lattice moves with it, so do the numbers (to the tolerance)."""
    def k(centre):
        geometry = ShapeGeometry([0] * 3, [1] * 3, [True] * 3, shapes=[Shape(Sphere(centre, 0.37))])
        case = read_case(b"geometry: {box: [1, 1, 1], periodic: [x, y, z]}\nparticles: {spacing: 0.0833333333333}\n"
                         b"fluids: {water: {density: 1, viscosity: 1}}\nflow: stokes\nsolver: {tolerance: 1.0e-9}\n",
                         "c.yaml")
        scene = build_scene(case, geometry, 1 / 12, Clock())
        return solve_axis(case, scene, 0, np.eye(3)[0], Clock()).permeability[0]

    assert k([0.5] * 3) == pytest.approx(k([0.5 + 1 / 3] * 3), rel=1e-7)
