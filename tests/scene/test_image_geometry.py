"""From the image of a case to its geometry: labels, grey values, thresholds, what is said of them."""

from types import SimpleNamespace

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.domain import slabs
from isphcli.geometry.grey import otsu_threshold
from isphcli.geometry.images.image import VoxelError
from isphcli.geometry.iso_surface import IsoSurfaceGeometry
from isphcli.geometry.spline import average
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.scene import image_geometry
from isphcli.scene.build_geometry import build_geometry
from tests.geometry.fields import plane

CASE = """
geometry:
  voxels: {{file: scan.npy, voxel_size: 1.0e-6, {image}}}
  periodic: [x, y, z]
particles: {{spacing: 1.0e-6}}
fluids: {{water: {{density: 1000, viscosity: 1.0e-3}}, gas: {{density: 1, viscosity: 1.0e-5}}}}
drive: {{body_force: [1, 0, 0]}}
time: {{end: 1}}
"""
WALL = 5.3  # voxels along x: a slab of solid begins there and ends where the image is mirrored


def scan(tmp_path, image, *overrides, values=None):
    if values is None:
        values = np.minimum(plane((6, 6, 12), (1, 0, 0), WALL), plane((6, 6, 12), (-1, 0, 0), -11.3))
        values = np.round(1000 + 100 * values).astype(np.uint16)  # bright solid from 5.3 to 11.3 voxels
    np.save(tmp_path / "scan.npy", values)
    return read_case(CASE.format(image=image).encode(), tmp_path / "case.yaml", overrides)


def wall_along_x(geometry):
    start = np.array([[2.0, 3.0, 3.0]]) * 1e-6
    return 2.0 + 7.0 * geometry.crossing(start, start + np.array([7e-6, 0, 0]))[0]


@pytest.mark.parametrize("mirror", ["[]", "[z]", "[x, z]"])
def test_each_process_reads_its_layers(tmp_path, monkeypatch, mirror):
    """Of an image with its mirror image, of more processes than layers too: together they have the whole, cropped."""
    labels = np.random.default_rng(0).integers(0, 4, (4, 3, 6))
    case = scan(tmp_path, "labels: {solid: 1, water: 0, gas: [2, 3]}", "geometry.periodic=[]",
                f"geometry.mirror={mirror}", "geometry.voxels.crop=[[1,5],[0,3],[1,4]]", values=labels)
    whole = image_geometry._layers_of(case, case.geometry.voxels).values
    assert whole.shape == (6 if "z" in mirror else 3, 3, 8 if "x" in mirror else 4)
    for size in (2, 7):
        found = []
        for rank in range(size):
            one = SimpleNamespace(rank=rank, size=size)
            for module in (image_geometry, slabs):
                monkeypatch.setattr(module, "current", lambda one=one: one)
            found.append(image_geometry._layers_of(case, case.geometry.voxels).values)
        assert (np.concatenate(found) == whole).all()


def test_the_wall_of_a_grey_image_is_where_it_has_the_threshold(tmp_path):
    """A ramp of 100 grey values a voxel: the wall moves by a tenth of a voxel with ten of them."""
    geometry = build_geometry(scan(tmp_path, "grey: {threshold: 1000, solid: above}"))
    assert isinstance(geometry, IsoSurfaceGeometry)
    assert wall_along_x(geometry) == pytest.approx(WALL, abs=0.02)
    other = build_geometry(scan(tmp_path, "grey: {threshold: 1010, solid: above}"))
    assert wall_along_x(other) - wall_along_x(geometry) == pytest.approx(0.1, abs=0.01)


def test_solid_below_the_threshold_is_the_other_side(tmp_path):
    x = np.array([[2.0, 3, 3], [8.0, 3, 3]]) * 1e-6
    above = build_geometry(scan(tmp_path, "grey: {threshold: 1000, solid: above}"))
    below = build_geometry(scan(tmp_path, "grey: {threshold: 1000, solid: below}"))
    assert above.phase(x).tolist() == [0, -1] and below.phase(x).tolist() == [-1, 0]


def test_two_fluids_by_their_grey_values(tmp_path):
    image = "grey: {threshold: 1000, solid: above, fluids: {gas: [0, 700], water: [700, 1000]}}"
    geometry = build_geometry(scan(tmp_path, image))
    x = np.array([[1.0, 3, 3], [4.5, 3, 3], [8.0, 3, 3]]) * 1e-6
    assert geometry.phase(x).tolist() == [1, 0, -1]


def test_labels_and_stairs(tmp_path):
    labels = np.zeros((6, 6, 12), np.uint8)
    labels[:, :, 5:11] = 1
    smooth = build_geometry(scan(tmp_path, "labels: {water: 0, solid: 1}", values=labels))
    stairs = build_geometry(scan(tmp_path, "labels: {water: 0, solid: 1}", "geometry.wall_distance=stairs",
                                 values=labels))
    assert isinstance(smooth, IsoSurfaceGeometry) and not smooth.level_walls
    assert type(stairs) is VoxelGeometry and stairs.level_walls
    assert wall_along_x(stairs) == pytest.approx(5.0, abs=1e-12)
    assert wall_along_x(smooth) == pytest.approx(5.0, abs=0.05)


def test_blur_is_taken_out_of_an_image_of_two_grey_values(tmp_path):
    """Nothing is taken out of values that are spread, nor where the case says 0."""
    middles = np.arange(12) + 0.5
    two = np.clip(5.3 - middles, -0.5, 0.5) * np.where(middles > 9, -1, 1)  # shares of two slabs
    two = np.broadcast_to(np.round(1000 - 200 * two), (6, 6, 12)).astype(np.uint16)
    spread = np.round(1000 + 100 * np.random.default_rng(0).standard_normal((6, 6, 12))).astype(np.uint16)
    grey = "grey: {{threshold: 1000, solid: above{}}}"
    for values, blur, out in ((two, "", True), (two, ", blur: 0", False), (spread, "", False)):
        geometry = build_geometry(scan(tmp_path, grey.format(blur), values=values))
        assert ("taken out" in dict(geometry.described)["sharpness"]) is out


@pytest.mark.parametrize(("slope", "least", "most"), [(400, 1e-3, 0.25), (100, 0.0, 0.0)])
def test_the_blur_is_settled_once(tmp_path, slope, least, most):
    """Of shares of solid a number, of a ramp 0: with these another threshold is understood in the same way."""
    middles = np.arange(12) + 0.5
    level = np.minimum(middles - 2.3, 8.3 - middles)
    level = np.clip(level, -0.5, 0.5) if slope == 400 else level
    values = np.broadcast_to(np.round(1000 + slope * level), (6, 6, 12)).astype(np.uint16)
    grey = image_geometry.settled(scan(tmp_path, "grey: {threshold: otsu, solid: above}", values=values))
    assert least <= grey.blur <= most and not isinstance(grey.threshold, str)


def test_a_scan_has_its_wall_half_way_between_fluid_and_solid(tmp_path):
    """Shares of a ball, a seventh of the box: between values of 100 and 300 Otsu's threshold is higher than 200."""
    middles = np.arange(12) + 0.5
    x, y, z = np.meshgrid(middles, middles[:6], middles[:6], indexing="ij")
    shares = np.clip(3.0 - np.sqrt((x - 6) ** 2 + (y - 3) ** 2 + (z - 3) ** 2), 0, 1).T
    values = np.round(100 + 200 * shares).astype(np.uint16)
    settled = image_geometry.settled(scan(tmp_path, "grey: {threshold: otsu, solid: above}", values=values))
    said = dict(build_geometry(scan(tmp_path, "grey: {threshold: otsu, solid: above}", values=values)).described)
    assert f"grey value {settled.threshold:g} (half-way between fluid and solid of the scan; Otsu" in said["wall"]
    assert abs(settled.threshold - 200) < 0.5 * abs(otsu_threshold(values) - 200)


def ball(up=4):
    """Shares of the solid round a ball of fluid of radius 4.3 in 12^3 voxels, by `up` cells along a voxel."""
    middles = (np.arange(12 * up) + 0.5) / up
    x, y, z = np.meshgrid(middles, middles, middles, indexing="ij")
    inside = (x - 6.1) ** 2 + (y - 5.9) ** 2 + (z - 6.2) ** 2 < 4.3**2
    return 1.0 - inside.reshape(12, up, 12, up, 12, up).mean(axis=(1, 3, 5))


@pytest.mark.parametrize(("blur", "words", "least", "most"), [(0.5, "taken out", 0.0, 0.04),
                                                              (1.5, "say blur: auto", 0.3, 1.0)])
def test_a_wide_blur_is_left_in_and_counts_as_doubt_of_the_walls(tmp_path, blur, words, least, most):
    """Of a Gaussian of 1.5 voxels nothing tells whether it is the scanner's: what it moves the walls by is in doubt."""
    values = np.round(1000 * average(ball().astype(np.float32), blur, np.ones(3, bool))).astype(np.uint16)
    found = build_geometry(scan(tmp_path, "grey: {threshold: otsu, solid: above}", values=values))
    assert words in dict(found.described)["sharpness"] and least < found.off < most


@pytest.mark.parametrize("denoise", [0.0, 0.8])
def test_a_scan_has_the_same_wall_where_noise_is_averaged(tmp_path, denoise):
    """A Gaussian of 0.8 voxel would move the wall of the ball by 0.15 voxel, a tenth of its volume."""
    values = np.round(1000 * ball() + 20 * np.random.default_rng(0).standard_normal((12,) * 3) + 200).astype(np.uint16)
    case = scan(tmp_path, f"grey: {{threshold: otsu, solid: above, denoise: {denoise}}}", values=values)
    found = build_geometry(case)
    x = (np.moveaxis(np.indices((24,) * 3), 0, -1).reshape(-1, 3) + 0.5) / 2
    fluid = np.mean(found.phase(x * 1e-6) >= 0) * 12**3
    assert fluid == pytest.approx(4 / 3 * np.pi * 4.3**3, rel=0.02)


@pytest.mark.parametrize(("threshold", "warns"), [(510, False), (350, True)])
def test_a_threshold_far_from_half_way_is_told(tmp_path, threshold, warns):
    values = np.round(1000 * ball()).astype(np.uint16)
    found = build_geometry(scan(tmp_path, f"grey: {{threshold: {threshold}, solid: above}}", values=values))
    assert any("half-way between fluid and solid" in text for text in found.warnings) is warns


@pytest.mark.parametrize(("noise", "denoise", "warns"), [(50, 0.0, False), (200, 0.0, True), (200, 1.0, False),
                                                         (400, 0.0, True)])
def test_noise_that_turns_voxels_is_told(tmp_path, noise, denoise, warns):
    """Of noise of a fifth of the contrast some voxels are on the wrong side; averaged over a voxel none is. Noise of
    two fifths hides that there are two values."""
    values = np.round(1000 * ball() + noise * np.random.default_rng(0).standard_normal((12,) * 3) + 3000)
    found = build_geometry(scan(tmp_path, f"grey: {{threshold: otsu, solid: above, denoise: {denoise}}}",
                                values=values.astype(np.uint16)))
    assert any("denoise: 1" in text for text in found.warnings) is warns


def test_grey_values_of_a_segmented_image_are_told(tmp_path):
    values = np.where(ball() > 0.5, 255, 0).astype(np.uint8)
    found = build_geometry(scan(tmp_path, "grey: {threshold: otsu, solid: above}", values=values))
    assert any("geometry.voxels.labels" in text for text in found.warnings)


def test_what_was_understood_is_said(tmp_path):
    geometry = build_geometry(scan(tmp_path, "grey: {threshold: otsu, solid: above}"))
    said = dict(geometry.described)
    assert "Otsu" in said["wall"] and "sharpness" in said
    assert "solid above" in said["porosity"]


@pytest.mark.parametrize(
    ("image", "words"),
    [
        ("grey: {threshold: 60000, solid: above}", "parts nothing"),
        ("grey: {threshold: 1000, solid: above, blur: auto}", "blur: auto needs the scan of a body of one solid"),
        ("grey: {threshold: 1000, solid: above, fluids: {gas: [0, 700]}}", "belong to no fluid"),
    ],
)
def test_grey_values_that_cannot_be_meant(tmp_path, image, words):
    with pytest.raises(VoxelError, match=words):
        build_geometry(scan(tmp_path, image))


@pytest.mark.parametrize("rim, periodic, warns", [(0, "", True), (1, "", False), (0, ", periodic: [x, y]", False)])
def test_air_around_a_round_core_is_told(tmp_path, rim, periodic, warns):
    """A core of pores and grains, and what is beside it: pore as the air is, or solid."""
    y, x = np.indices((12, 12)) - 5.5
    core = np.random.default_rng(0).integers(0, 2, (10, 12, 12))
    np.save(tmp_path / "core.npy", np.where(x**2 + y**2 < 36, core, rim).astype(np.uint8))
    text = (f"geometry: {{voxels: {{file: {tmp_path / 'core.npy'}, labels: {{solid: 1, water: 0}}, voxel_size: 1}}"
            f"{periodic}}}\nparticles: {{spacing: 1}}\nfluids: {{water: {{density: 1, viscosity: 1}}}}\n"
            "flow: stokes\ndrive: {axes: [z]}\n")
    geometry = build_geometry(read_case(text.encode(), tmp_path / "case.yaml"))
    assert any("round core" in sentence for sentence in geometry.warnings) == warns


def test_grey_values_of_half_precision(tmp_path):
    values = np.where(np.arange(8) < 4, 900.0, 60.0) + np.arange(512).reshape(8, 8, 8) % 5
    np.save(tmp_path / "half.npy", values.astype(np.float16))
    text = (f"geometry: {{voxels: {{file: {tmp_path / 'half.npy'}, grey: {{threshold: otsu, solid: above}}, "
            "voxel_size: 1}}\nparticles: {spacing: 1}\nfluids: {water: {density: 1, viscosity: 1}}\n"
            "flow: stokes\ndrive: {axes: [y]}\n")
    geometry = build_geometry(read_case(text.encode(), tmp_path / "case.yaml"))
    assert np.count_nonzero(geometry.labels < 0) == 256  # clear layers beside them
