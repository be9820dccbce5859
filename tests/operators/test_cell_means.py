"""Means over cells: sums of them are integrals, wherever walls cut the lattice."""

import numpy as np
import pytest

from isphcli.domain.lattice import make_lattice
from isphcli.geometry.bodies import Box, Shape, Sphere
from isphcli.geometry.faces import Walls
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.operators.cell_means import directions, means_over_cells
from isphcli.scene.place import place
from isphcli.validation.known_bodies import LevelGeometry, body

CUBES = ("cubic", "bcc")


def flux(geometry, kind, field, spacing=1.0):
    """Integral over the box of a field (velocity, laplacian) of points and wall distances, from cells of a lattice."""
    support = 2.1 * spacing
    lattice = make_lattice(kind, geometry.lower, geometry.upper, geometry.periodic, spacing, support)
    particles = place(geometry, lattice, support)
    fluid = particles.x[: particles.n_fluid]
    values, laplacian = (np.repeat(v[:, None], geometry.dim, axis=1) for v in field(fluid, geometry.distance(fluid)))
    means = means_over_cells(geometry, particles.x, lattice, support, (values, laplacian))
    _, velocity = means.everywhere(fluid)
    return velocity[:, 0].sum() * particles.site_volume, values[:, 0].sum() * particles.site_volume


@pytest.mark.parametrize("kind", ["square", "hexagonal", "cubic", "bcc"])
def test_cells_of_every_lattice_fill_space(kind):
    """The translates of a box spline to a lattice add up to a constant where any of its directions that span space span
    a cell of one site: this is the condition."""
    dim = 3 if kind in CUBES else 2
    lattice = make_lattice(kind, [0.0] * dim, [6.0] * dim, [False] * dim, 1.0, 0.0)
    ways = directions(lattice)
    spanned = [abs(np.linalg.det(np.delete(ways, k, axis=0))) if len(ways) > dim else abs(np.linalg.det(ways))
               for k in range(len(ways))]
    np.testing.assert_allclose(spanned, lattice.site_volume, rtol=1e-12)
    second = ways.T @ ways
    np.testing.assert_allclose(second, np.eye(dim) * second[0, 0], atol=1e-12)  # no direction is preferred


@pytest.mark.parametrize("kind", CUBES)
@pytest.mark.parametrize("name", ["slit 3.4", "slit at 45 degrees", "slit at 27 degrees"])
def test_slits_have_their_flux_at_any_angle(kind, name):
    """u = s (h - s) / 2 between planes: exact, where sums at the particles are up to 2.4 % off."""
    slit = body(name)
    width = slit.level.keywords["width"]
    whole, sums = flux(LevelGeometry(slit), kind, lambda x, s: (s * (width - s) / 2, np.full(len(s), -1.0)))
    exact = width**3 / 12 / slit.level.keywords["period"] * np.prod(slit.size)
    assert whole == pytest.approx(exact, rel=1e-5)
    assert abs(sums / exact - 1) > 2e-4


@pytest.mark.parametrize("width", [0.7, 1.1])
def test_slits_of_one_particle(width):
    """u = s (h - s) / 2: exact where there is one plane of particles between the walls, too, and cells hold both."""
    geometry = ShapeGeometry([0.0, 0.0], [4.0, 5.0], [True, True], shapes=[
        Shape(Box([-1.0, 1.3], [5.0, 1.3 + width]), outside=True)])
    found, _ = flux(geometry, "square", lambda x, s: (s * (width - s) / 2, np.full(len(s), -1.0)))
    assert found == pytest.approx(4.0 * width**3 / 12, rel=1e-6)


@pytest.mark.parametrize(("side", "bound"), [(3.0, 1e-2), (6.0, 2e-3)])
def test_corners(side, bound):
    """u = x (a - x) y (a - y) in a square of faces of the box: in the corners it goes as the product of the distances
    to both walls. The quadratic function leaves 0.9 and 0.16 %, 0.01 % at 12; sums at the particles are 11 and 2.8 %
    off."""
    geometry = ShapeGeometry([0.0, 0.0], [side, side], [False, False])

    def field(x, _):
        a, b = (x * (side - x)).T
        return a * b, -2 * (a + b)

    exact = side**6 / 36
    whole, sums = flux(geometry, "square", field)
    assert whole == pytest.approx(exact, rel=bound)
    assert abs(sums / exact - 1) > 0.02


@pytest.mark.parametrize(("kind", "bound"), [("square", 2e-3), ("hexagonal", 5e-3)])
def test_a_wall_that_bends_away_and_one_that_bends_round(kind, bound):
    """Flow between a cylinder and a pipe round it, 6 spacings apart; sums at the particles are up to 1.3 % off."""
    inner, outer = 3.0, 9.0
    geometry = ShapeGeometry([-10.0, -10.0], [10.0, 10.0], [True, True], shapes=[
        Shape(Sphere([0.3, 0.2], outer), outside=True), Shape(Sphere([0.3, 0.2], inner))])
    log = (outer**2 - inner**2) / np.log(outer / inner)

    def field(x, _):
        r2 = ((x - [0.3, 0.2]) ** 2).sum(axis=1)
        return (outer**2 - r2 + log * 0.5 * np.log(r2 / outer**2)) / 4, np.full(len(x), -1.0)

    exact = np.pi / 8 * (outer**4 - inner**4 - (outer**2 - inner**2) * log)
    assert flux(geometry, kind, field)[0] == pytest.approx(exact, rel=bound)


@pytest.mark.parametrize("slip", [0.0, 0.7])
def test_walls_that_slip(slip):
    """u = s (h - s) / 2 + h b / 2 between planes of slip length b, off the lattice."""
    width = 5.3
    geometry = ShapeGeometry([0.0, 0.0], [4.0, 10.0], [True, True], walls=Walls(slip_length=slip), shapes=[
        Shape(Box([-1.0, 1.3], [5.0, 1.3 + width]), outside=True)])
    found, _ = flux(geometry, "square", lambda x, s: (s * (width - s) / 2 + width * slip / 2, np.full(len(s), -1.0)))
    assert found == pytest.approx(4.0 * (width**3 / 12 + width**2 * slip / 2), rel=1e-9)


@pytest.mark.parametrize("kind", CUBES)
@pytest.mark.parametrize("spacing", [1.0, 0.5])
def test_walls_on_faces_of_voxels(kind, spacing):
    """u = (y - 2) (6 - y) / 2 in a slit of an image: planes of a body-centred lattice are half a spacing apart."""
    labels = np.full((2, 7, 2), -1)
    labels[:, 2:6] = 0
    slit = VoxelGeometry(labels, 1.0, (True, True, True))
    found, _ = flux(slit, kind, lambda x, s: ((x[:, 1] - 2) * (6 - x[:, 1]) / 2, np.full(len(s), -1.0)), spacing)
    assert found == pytest.approx(2.0 * 2.0 * 4.0**3 / 12, rel=1e-9)
