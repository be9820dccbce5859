"""The body that a scan shows: its own scan is the image."""

import numpy as np
import pytest

from isphcli.domain.slabs import Slabs
from isphcli.geometry import scan_fit
from isphcli.geometry.grey import field_of_grey, sharpen
from isphcli.geometry.scan_fit import Scanner, apart, fit_scan
from isphcli.geometry.spline import average, spline_coefficients
from tests.domain.several import on_threads
from tests.geometry.fields import waves
from tests.geometry.test_image_brick import own

ROUND = np.ones(3, bool)
UP = 6  # cells along an edge of a voxel, of the images here


def scan(inside, blur=0.0):
    """The scan of a body of cells, bool [z, y, x], UP along an edge of a voxel; blur: voxels."""
    shares = average(2.0 * inside.astype(np.float32) - 1.0, blur * UP, ROUND)
    n = [size // UP for size in shares.shape]
    shares = shares.reshape([k for size in n for k in (size, UP)]).mean(axis=(1, 3, 5))
    return -field_of_grey(shares, 0.0, "above")


def cells(n):
    """Middles (n * UP, ..., 3) of the cells of n^3 voxels, x, y, z, in voxels."""
    return np.moveaxis(np.indices((n * UP,) * 3)[::-1], 0, -1) / UP + 0.5 / UP


def volume(field, n):
    """Of the solid of a field, voxels: its share in the voxels of its own scan."""
    return n**3 * (0.5 - 0.5 * np.mean(Scanner(ROUND, Slabs.whole(field.shape)).scanned(field, 0.0)))


@pytest.fixture(scope="module")
def rough():
    """A random body of pores and grains of 3 voxels, by its cells."""
    return waves(12, 12, 4, 1, 0.45, UP) > 0


def test_the_scan_of_a_ball_holds_its_volume():
    """Of the distance to a ball of radius 4.2: 3^3 plane walls a voxel, of the spline, are 0.006 voxel off."""
    x = np.moveaxis(np.indices((12, 12, 12)), 0, -1) + 0.5 - (6.27, 6.11, 5.9)
    found = volume((np.linalg.norm(x, axis=-1) - 4.2).astype(np.float32), 12)
    assert found == pytest.approx(4 / 3 * np.pi * 4.2**3, rel=4e-3)


def test_walls_of_two_fields_are_apart_by_their_distance():
    """Planes 0.3 voxel apart, one of which also changes half as fast; across the axes at most 1.4 times that."""
    x, y, _ = np.moveaxis(np.indices((9, 12, 12))[::-1], 0, 0).astype(np.float32)
    slabs = Slabs.whole(x.shape)
    assert apart(0.5 * (x - 5.2), x - 5.5, slabs) == pytest.approx(0.3, rel=1e-5)
    across = (x + y) / np.sqrt(2.0)
    assert apart(across - 8.2, across - 8.5, slabs) == pytest.approx(0.3 * np.sqrt(2.0), rel=1e-4)


@pytest.mark.parametrize("blur", [0.0, 0.5])
def test_walls_along_the_voxels_are_found_within_them(blur):
    """Solid from 3 + 1/3 to 8 + 5/6 voxels along x. Sharpened only, a wall is a tenth of a voxel off."""
    x = np.arange(12 * UP) / UP + 0.5 / UP
    inside = np.broadcast_to((x < 3 + 1 / 3) | (x > 8 + 5 / 6), (4 * UP, 4 * UP, 12 * UP))
    spline = spline_coefficients(fit_scan(scan(inside, blur), ROUND).field, ROUND)[0, 0]
    f = (np.roll(spline, 1) + 4 * spline + np.roll(spline, -1)) / 6
    walls = [i + 0.5 + f[i] / (f[i] - f[i + 1]) for i in np.flatnonzero(f[:-1] * f[1:] < 0)]
    assert walls == pytest.approx([3 + 1 / 3, 8 + 5 / 6], abs=0.05)  # 0.05: of straight lines for the spline


@pytest.mark.parametrize(("shape", "better"), [("ball", 4), ("cube", 3)])
def test_small_grains_keep_their_volume(shape, better):
    """A ball of radius 2 and a cube of edge 4 that is turned by 45 degrees: several times better than sharpened."""
    x = cells(9) - (4.77, 4.61, 4.4)
    turned = np.stack([x[..., 0] + x[..., 1], x[..., 0] - x[..., 1], np.sqrt(2) * x[..., 2]], axis=-1) / np.sqrt(2)
    solid = np.linalg.norm(x, axis=-1) < 2.0 if shape == "ball" else np.abs(turned).max(axis=-1) < 2.0
    image, true = scan(~solid), solid.mean() * 9**3
    off = [abs(volume(field, 9) / true - 1) for field in (sharpen(image, 0.0, ROUND), fit_scan(image, ROUND).field)]
    assert off[1] < off[0] / better


@pytest.mark.parametrize("blur", [0.0, 0.5, 0.8])
def test_the_blur_is_found_in_narrow_pores(rough, blur):
    """Voxels of pure fluid are rare there, and the means of the two sides are nearer to each other than fluid and
    solid. By the slopes at the walls 0.5 voxel was taken for 0 to 0.2 and 0.8 for 0.3 to 0.5. 0.15: the square of that
    is a tenth of the variance of 0.5."""
    assert fit_scan(scan(rough, blur), ROUND).blur == pytest.approx(blur, abs=0.15)


def test_the_blur_is_found_where_a_grain_fills_the_middle(monkeypatch):
    """Without a wall in the part that is looked at a blur of 0 was taken, and corrections come to 0.67 from it."""
    monkeypatch.setattr(scan_fit, "SAMPLE", 4)
    image = scan(np.linalg.norm(cells(14) - (7.27, 7.11, 6.9), axis=-1) > 4.5, 0.8)
    assert fit_scan(image, ROUND).blur == pytest.approx(0.8, abs=0.05)


@pytest.mark.parametrize(("blur", "noise"), [(0.0, 0.2), (1.0, 0.1)])
def test_nothing_is_fitted_to_noise(rough, blur, noise):
    """Of 10 and 5 % of the contrast: it is found within a fifth, in half contrasts of pure fluid and solid, and what is
    left where the sharpened image leaves more is no less. What is left once noise is fitted is no measure of it."""
    image = scan(rough, blur)
    noisy = image + noise * np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    found = fit_scan(noisy, ROUND)
    assert found.noise == pytest.approx(noise / image.max(), rel=0.2) and found.is_scan
    assert found.misfit >= min(found.first, 0.8 * noise / image.max())  # 12^3 voxels know it to a sixth


@pytest.mark.parametrize("kind", ["alike", "cut off"])
def test_noise_is_known_though_neighbours_are_alike_or_values_are_cut_off(rough, kind):
    """4 % of the contrast, the same in pairs of voxels as a reconstruction averages it, or with what is brighter than
    solid and darker than fluid cut off, as in an image of 8 bits that uses all of its values. By neighbours it was 0.7
    and 0.6 of that, and k of a pack of grains 12 and 19 % low, with the corrections fitted to the rest of it (32^3)."""
    image = scan(rough)
    noise = np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    if kind == "alike":
        noise = (noise + np.roll(noise, 1, axis=2)) / np.sqrt(2)
    noisy, pure = image + np.float32(0.08) * noise, (image.min(), image.max())
    found = fit_scan(np.clip(noisy, *pure) if kind == "cut off" else noisy, ROUND)
    assert found.noise == pytest.approx(0.08 / pure[1], rel=0.1)


def test_the_wall_is_half_way_between_fluid_and_solid(rough):
    """An image whose zero is a tenth of half the contrast off, as Otsu's threshold may be."""
    image = scan(rough, 0.5)
    found = fit_scan(image + np.float32(0.1), ROUND, centred=True)
    assert found.zero == pytest.approx(0.1 + fit_scan(image, ROUND).zero, abs=0.02)
    assert volume(found.field, 12) == pytest.approx(volume(fit_scan(image, ROUND).field, 12), rel=0.01)


def test_an_average_against_noise_is_taken_out_with_the_blur():
    """Of a ball of radius 4.2 in a box of 12 voxels, with noise of a twentieth of the contrast: a Gaussian of a voxel
    moves its wall by a quarter of a voxel."""
    x = np.linalg.norm(cells(12) - (6.27, 6.11, 5.9), axis=-1)
    noise = np.random.default_rng(0).standard_normal((12,) * 3).astype(np.float32)
    averaged = average(scan(x > 4.2, 0.5) + np.float32(0.1) * noise, 1.0, ROUND)
    true = 4 / 3 * np.pi * 4.2**3
    found = fit_scan(averaged, ROUND)
    assert volume(found.field, 12) == pytest.approx(true, rel=0.03)
    assert abs(volume(averaged, 12) / true - 1.0) > 0.06
    assert found.blur == pytest.approx(np.hypot(0.46, 1.0), abs=0.15)


def test_a_distance_is_no_scan():
    """Cut off at a voxel it has the steps of a scan with a blur of 0.5 voxel, but no body has it as its scan."""
    x = np.linalg.norm(cells(14) - (7.27, 7.11, 6.9), axis=-1)
    cut = np.clip(x[UP // 2 :: UP, UP // 2 :: UP, UP // 2 :: UP] - 4.5, -1.0, 1.0)
    assert not fit_scan(-field_of_grey(cut, 0.0, "above"), ROUND).is_scan
    assert fit_scan(scan(x > 4.5, 0.5), ROUND).is_scan


def test_a_second_mineral_is_not_taken_for_noise_nor_for_walls(rough):
    """A seventh of the volume 1.6 times as bright: corrections, which no body of one solid needs, end at once, and the
    doubt of the walls is that of the mineral, not that of the noise."""
    mineral = waves(12, 6, 3, 2, 0.15, UP) > 0
    image = average(np.where(rough, 0.0, np.where(mineral, 1.6, 1.0)).astype(np.float32), 0.5 * UP, ROUND)
    image = image.reshape(12, UP, 12, UP, 12, UP).mean(axis=(1, 3, 5))
    noisy = image + 0.02 * np.random.default_rng(0).standard_normal(image.shape)
    found, plain = (fit_scan(field_of_grey(v, 0.5, "above"), ROUND) for v in (noisy, np.minimum(noisy, 1.0)))
    assert found.misfit == found.first and found.is_scan
    assert found.off > 2.0 * plain.off


def test_a_threshold_far_from_half_way_leaves_a_scan_a_scan(rough):
    """0.3 and 0.7 of the way: what is above is another body, whose scan the image is but for the noise."""
    image = scan(rough, 0.9)
    noisy = image + 0.1 * np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    for level in (-0.4, 0.0, 0.4):
        found = fit_scan(noisy - np.float32(level * image.max()), ROUND)
        assert found.is_scan and found.blur == pytest.approx(0.9, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("around", [ROUND, np.array([True, False, False]), np.array([False, True, False])])
def test_processes_find_the_field_of_one(rough, around):
    """But for sums in another order, in double precision."""
    image = scan(rough, 0.5)
    whole = fit_scan(image, around)

    def part(ranks):
        slabs = Slabs(image.shape, ranks=ranks)
        found = fit_scan(own(image, slabs), around, slabs)
        return found, apart(own(image, slabs), found.field, slabs)

    found, distances = zip(*on_threads(3, part))
    assert list(distances) == pytest.approx([apart(image, whole.field, Slabs.whole(image.shape))] * 3, rel=1e-5)
    assert [one.blur for one in found] == pytest.approx([whole.blur] * 3, abs=1e-9)
    assert np.concatenate([one.field for one in found]) == pytest.approx(whole.field, abs=1e-6)
